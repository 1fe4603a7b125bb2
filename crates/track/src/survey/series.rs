//! A target's packets as series: one per kind, anchor and coordinate, in order of time.

use crate::packet::{AnchorId, Content, Kind, Packet};
use std::collections::BTreeMap;

/// What tells one series of a target from another.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Source {
    pub kind: Kind,
    pub anchor: Option<AnchorId>,
    pub reference: Option<AnchorId>,
}

/// The reports of one source.
#[derive(Clone, Debug, Default)]
pub(super) struct Series {
    /// Instants of the reports, ascending, each once.
    pub t_s: Vec<f64>,
    /// Sequence numbers, where every report has one; as long as `t_s`.
    pub seq: Vec<Option<u64>>,
    /// Values (coordinates of a position, components of a linear row), NaN where not measured; as long as `t_s` each.
    pub values: Vec<Vec<f64>>,
}

/// The source of a packet.
pub(super) fn source(content: &Content) -> Source {
    let (anchor, reference) = match content {
        Content::Position(_) | Content::Linear { .. } => (None, None),
        Content::Range { anchor, .. } | Content::Rssi { anchor, .. } | Content::Bearing { anchor, .. } => {
            (Some(*anchor), None)
        }
        Content::Tdoa { anchor, reference, .. } => (Some(*anchor), Some(*reference)),
    };
    Source { kind: content.kind(), anchor, reference }
}

/// The scalar values of a packet.
fn values(content: &Content) -> Vec<f64> {
    match content {
        Content::Position(xyz) => xyz.iter().map(|v| v.unwrap_or(f64::NAN)).collect(),
        Content::Range { value_m, .. } | Content::Tdoa { value_m, .. } => vec![*value_m],
        Content::Rssi { value_dbm, .. } => vec![*value_dbm],
        Content::Bearing { value_rad, .. } => vec![*value_rad],
        Content::Linear { z, .. } => z.iter().map(|v| v.unwrap_or(f64::NAN)).collect(),
    }
}

/// The series of a target. Of several reports of one source at one instant the first counts.
pub(super) fn split(packets: &[Packet]) -> BTreeMap<Source, Series> {
    let mut order: Vec<&Packet> = packets.iter().collect();
    order.sort_by(|a, b| a.t_s.total_cmp(&b.t_s));
    let mut all: BTreeMap<Source, Series> = BTreeMap::new();
    for packet in order {
        let series = all.entry(source(&packet.content)).or_default();
        if series.t_s.last() == Some(&packet.t_s) {
            continue;
        }
        series.t_s.push(packet.t_s);
        series.seq.push(packet.seq);
        let values = values(&packet.content);
        if series.values.len() < values.len() {
            series.values.resize_with(values.len(), || vec![f64::NAN; series.t_s.len() - 1]);
        }
        for (i, column) in series.values.iter_mut().enumerate() {
            column.push(values.get(i).copied().unwrap_or(f64::NAN));
        }
    }
    all
}
