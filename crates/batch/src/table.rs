//! A measurement table in memory.

use crate::anchors::read_anchors;
use crate::content::AnchorIds;
use crate::gather::{Facts, Gathered, gather};
use crate::input::Input;
use crate::options::{Counts, ReadOptions};
use crate::settle::{Settler, Tally};
use crate::store::Room;
use crate::time::TimeForm;
use fixtrail_track::anchors::Anchors;
use fixtrail_track::error::BuildError;
use fixtrail_track::geo::Origin;
use fixtrail_track::target::TargetPackets;
use std::path::Path;

/// A measurement table: who said what and when.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    /// Packets of each target, sorted by target id (byte order), then time, then in canonical order; no two are equal.
    pub targets: Vec<TargetPackets>,
    /// The anchors that packets refer to.
    pub anchors: Anchors,
    /// How times are written and what second 0 is.
    pub time: TimeForm,
    /// Origin of the local frame when positions came as latitude and longitude: the earliest position (of the first target
    /// in order when several are as early, then the southernmost), at height 0 if it has none.
    pub origin: Option<Origin>,
    /// Whether there is a target column.
    pub has_target: bool,
    /// What was seen while reading.
    pub counts: Counts,
}

/// What a writer needs to know about the table a trail came from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TableMeta {
    /// How times are written and what second 0 is.
    pub time: TimeForm,
    /// Origin of the local frame, if positions are latitude and longitude.
    pub origin: Option<Origin>,
    /// Whether there is a target column.
    pub has_target: bool,
}

impl Table {
    /// The part that writers need.
    pub fn meta(&self) -> TableMeta {
        TableMeta { time: self.time, origin: self.origin, has_target: self.has_target }
    }
}

impl From<&Table> for TableMeta {
    fn from(table: &Table) -> TableMeta {
        table.meta()
    }
}

/// Returns the measurements of `input`.
///
/// `anchors` names the anchors table; without it `anchors.csv` beside the input is used if it is there. `progress` is
/// called now and then with bytes done and bytes in all (0 when unknown).
///
/// # Errors
/// [`BuildError`] with file, line, column, value and expectation, for anything that cannot be understood. With
/// `skip_bad_rows` only for what concerns the table as a whole: its header, its form of time, its encoding as a file.
pub fn read_table(
    input: &Input,
    anchors: Option<&Path>,
    options: &ReadOptions,
    progress: &mut dyn FnMut(u64, u64),
) -> Result<Table, BuildError> {
    let anchors = read_anchors(input, anchors)?;
    let ids = AnchorIds::new(&anchors);
    let Gathered { facts, mut merge } = gather(input, &ids, options, (Room::UNLIMITED, Path::new("")), progress)?;
    let (mut targets, mut tally, mut records) = (Vec::new(), Tally::default(), Vec::new());
    while let Some(id) = facts.next_target(&merge) {
        records.clear();
        facts.take(&mut merge, id, usize::MAX, &mut records)?;
        let mut packets = facts.packets(&records);
        Settler::new(&facts, id).settle(&mut packets, &facts, &mut tally);
        if !packets.is_empty() {
            targets.push(TargetPackets { target: facts.name(id), packets });
        }
    }
    let Facts { time, origin, has_target, mut counts, .. } = facts;
    tally.add_to(&mut counts);
    match tally.refused {
        Some(error) => Err(error),
        None => Ok(Table { targets, anchors, time, origin, has_target, counts }),
    }
}
