//! What arrived: one row of a measurement table, named parts resolved.

/// Index into [`Anchors`](crate::anchors::Anchors).
pub type AnchorId = u32;

/// One packet of one target. A lost packet or component is a value, never a NaN.
#[derive(Clone, Debug, PartialEq)]
pub struct Packet {
    /// When it was sensed: seconds since the table's epoch. For a linear run without times, `k`.
    pub t_s: f64,
    /// Time index of a linear run (a `k` column, or the row's number).
    pub k: Option<u64>,
    /// What it says.
    pub content: Content,
    /// Standard deviation that came with the packet, in the unit of the value.
    pub sd: Option<f64>,
    /// Sequence number.
    pub seq: Option<u64>,
    /// When it was received: seconds since the table's epoch.
    pub received_s: Option<f64>,
    /// Probability that it was sensed at `t_s`, where a column says so.
    pub arrival: Option<f64>,
    /// Where it stands: line of a text file or row of a Parquet file, from 1, for messages.
    pub line: u64,
}

/// The measurement inside a packet.
#[derive(Clone, Debug, PartialEq)]
pub enum Content {
    /// A position in metres in the local frame; an absent coordinate was not measured.
    Position([Option<f64>; 3]),
    /// A range to an anchor.
    Range {
        /// The anchor.
        anchor: AnchorId,
        /// Distance in metres.
        value_m: f64,
    },
    /// Received signal strength at or from an anchor.
    Rssi {
        /// The anchor.
        anchor: AnchorId,
        /// Strength in dBm.
        value_dbm: f64,
    },
    /// A time difference, as a distance.
    Tdoa {
        /// The anchor.
        anchor: AnchorId,
        /// The reference anchor.
        reference: AnchorId,
        /// `c·(t_anchor − t_reference)` in metres.
        value_m: f64,
    },
    /// A bearing from an anchor.
    Bearing {
        /// The anchor.
        anchor: AnchorId,
        /// Angle in radians, counter-clockwise from the x axis.
        value_rad: f64,
    },
    /// A row of a linear run: `z1 … zq` with lost components absent (all absent: the packet is lost),
    /// and the known input `u1 … up` acting from this instant to the next.
    Linear {
        /// Measurement vector.
        z: Vec<Option<f64>>,
        /// Input vector.
        u: Vec<f64>,
    },
}

/// The kind of a measurement, as tables and specs name it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Kind {
    /// `position`
    Position,
    /// `range`
    Range,
    /// `rssi`
    Rssi,
    /// `tdoa`
    Tdoa,
    /// `bearing`
    Bearing,
    /// `linear`
    Linear,
}

impl Kind {
    /// Every kind with the name that files use.
    pub const NAMES: [(&'static str, Kind); 6] = [
        ("position", Kind::Position),
        ("range", Kind::Range),
        ("rssi", Kind::Rssi),
        ("tdoa", Kind::Tdoa),
        ("bearing", Kind::Bearing),
        ("linear", Kind::Linear),
    ];

    /// The kind called `name`.
    pub fn from_name(name: &str) -> Option<Kind> {
        Self::NAMES.iter().find(|(n, _)| *n == name).map(|(_, k)| *k)
    }

    /// The unit of its values; none of a linear run's.
    pub fn unit(self) -> &'static str {
        match self {
            Kind::Position | Kind::Range | Kind::Tdoa => "m",
            Kind::Rssi => "dB",
            Kind::Bearing => "rad",
            Kind::Linear => "",
        }
    }

    /// The name that files use.
    pub fn name(self) -> &'static str {
        Self::NAMES.iter().find(|(_, k)| *k == self).map_or("", |(n, _)| n)
    }
}

/// What measured: the kind, and the anchors in their order. Two packets of one instant and source are copies.
pub type Source = (Kind, [Option<AnchorId>; 2]);

impl Packet {
    /// A packet that brings a time and what it says, and nothing else.
    pub fn new(t_s: f64, content: Content, line: u64) -> Packet {
        Packet { t_s, k: None, content, sd: None, seq: None, received_s: None, arrival: None, line }
    }

    /// What measured it.
    pub fn source(&self) -> Source {
        (self.content.kind(), self.content.anchors())
    }
}

impl Content {
    /// The measured numbers in order, absent where a component was not measured or lost.
    pub fn values(&self) -> impl Iterator<Item = Option<f64>> + '_ {
        let (several, one): (&[Option<f64>], Option<f64>) = match self {
            Content::Linear { z, .. } => (z, None),
            Content::Position(xyz) => (xyz, None),
            Content::Range { value_m: value, .. }
            | Content::Rssi { value_dbm: value, .. }
            | Content::Tdoa { value_m: value, .. }
            | Content::Bearing { value_rad: value, .. } => (&[], Some(*value)),
        };
        several.iter().copied().chain(one.map(Some))
    }

    /// The anchor and the reference anchor, where there are any.
    pub fn anchors(&self) -> [Option<AnchorId>; 2] {
        match self {
            Content::Range { anchor, .. } | Content::Rssi { anchor, .. } | Content::Bearing { anchor, .. } => {
                [Some(*anchor), None]
            }
            Content::Tdoa { anchor, reference, .. } => [Some(*anchor), Some(*reference)],
            Content::Position(_) | Content::Linear { .. } => [None, None],
        }
    }

    /// The kind of this measurement.
    pub fn kind(&self) -> Kind {
        match self {
            Content::Position(_) => Kind::Position,
            Content::Range { .. } => Kind::Range,
            Content::Rssi { .. } => Kind::Rssi,
            Content::Tdoa { .. } => Kind::Tdoa,
            Content::Bearing { .. } => Kind::Bearing,
            Content::Linear { .. } => Kind::Linear,
        }
    }
}
