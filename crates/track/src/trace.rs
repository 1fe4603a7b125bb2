//! What a real network did to the packets it was given.

/// What became of one packet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TracePacket {
    /// Whether it arrived.
    pub received: bool,
    /// Time from sending to the arrival of the first copy, seconds; says nothing of a lost packet.
    pub delay_s: f64,
    /// Number of copies that arrived, at least 1; says nothing of a lost packet.
    pub copies: u32,
}

/// The packets of one link, lost ones included, in the order in which they were sent.
#[derive(Clone, Debug, PartialEq)]
pub struct TraceLink {
    /// The link's id.
    pub link: String,
    /// Its packets.
    pub packets: Vec<TracePacket>,
}
