//! All packets of a target, and the trail made of them.

use crate::link::LinkReport;
use crate::packet::Packet;
use crate::trail::Trail;

/// The packets of one target, in the order of their rows.
#[derive(Clone, Debug, PartialEq)]
pub struct TargetPackets {
    /// The target's id; `None` when the table has no target column.
    pub target: Option<String>,
    /// Its packets.
    pub packets: Vec<Packet>,
}

/// The trail of one target.
#[derive(Clone, Debug, PartialEq)]
pub struct TargetTrail {
    /// The target's id; `None` when the table has no target column.
    pub target: Option<String>,
    /// Its fixes.
    pub trail: Trail,
    /// What the link did with its packets.
    pub link: LinkReport,
}
