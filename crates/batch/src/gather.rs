//! The blocks of a table put together in order.

use crate::common::Common;
use crate::content::AnchorIds;
use crate::formats;
use crate::input::Input;
use crate::names::{Names, TargetId};
use crate::options::{Counts, ReadOptions};
use crate::record::{self, ABSENT, Clock, MOST_ANCHORS, Rule, Shape};
use crate::rows::{Block, Rows};
use crate::schema::{Col, Schema};
use crate::store::{Merge, Room, SortBy, Store};
use crate::table::TableMeta;
use crate::time::{self, TimeForm};
use fixtrail_track::anchors::Anchors;
use fixtrail_track::error::BuildError;
use fixtrail_track::geo::Origin;
use fixtrail_track::packet::{Kind, Packet};
use std::cmp::Ordering;
use std::io;
use std::path::Path;
use std::sync::Arc;

/// A table whose rows are all in, ready to be gone through target by target.
pub(crate) struct Gathered<'a> {
    pub facts: Facts<'a>,
    pub merge: Merge,
}

/// What is known of a table once all its rows are in.
pub(crate) struct Facts<'a> {
    pub schema: Schema<'a>,
    pub anchors: &'a Anchors,
    pub skip_bad_rows: bool,
    names: Arc<Names>,
    /// Place of each target in the order of their names.
    rank: Vec<u32>,
    by_k: ByK,
    rule: Rule,
    /// Shape of the records.
    pub shape: Shape,
    /// Records in all.
    pub records: u64,
    pub clock: Clock,
    pub time: TimeForm,
    pub origin: Option<Origin>,
    pub has_target: bool,
    /// What was counted while the rows came in.
    pub counts: Counts,
}

/// Whose records are ordered by `k`.
enum ByK {
    /// Those of all targets, or of none.
    All(bool),
    /// Those of the targets that have a `k` in every record.
    Of(Vec<bool>),
}

impl ByK {
    fn of(&self, target: TargetId) -> bool {
        match self {
            ByK::All(by_k) => *by_k,
            ByK::Of(targets) => targets.get(target as usize).copied().unwrap_or(true),
        }
    }
}

impl<'a> Facts<'a> {
    /// What is known, before its rows are in, of a table with times in seconds, without a `k` and without latitudes.
    pub fn of_seconds(
        file: &'a Path,
        anchors: &'a Anchors,
        options: &ReadOptions,
        names: Arc<Names>,
        shape: Shape,
    ) -> Facts<'a> {
        let latency = |kind: Kind| options.latency_s.get(&kind).copied().unwrap_or(0.0);
        Facts {
            schema: Schema::new(file),
            anchors,
            skip_bad_rows: options.skip_bad_rows,
            names,
            rank: Vec::new(),
            by_k: ByK::All(false),
            rule: Rule { dates: false, latency_ns: record::latencies_ns(latency) },
            shape,
            records: 0,
            clock: Clock { epoch_unix_s: None, latency_s: Clock::latencies(latency) },
            time: TimeForm::Seconds,
            origin: None,
            has_target: true,
            counts: Counts::default(),
        }
    }

    /// Whether the records of a target are ordered by `k`.
    pub fn by_k(&self, target: TargetId) -> bool {
        self.by_k.of(target)
    }

    /// The name of a target; `None` in a table without a target column.
    pub fn name(&self, target: TargetId) -> Option<String> {
        self.names.name(target).filter(|name| !name.is_empty()).map(String::from)
    }

    /// The packets of records of one target.
    pub fn packets(&self, records: &[u64]) -> Vec<Packet> {
        records.chunks_exact(self.shape.width.max(1)).map(|r| self.shape.packet(r, &self.clock)).collect()
    }

    /// What a writer needs to know.
    pub fn meta(&self) -> TableMeta {
        TableMeta { time: self.time, origin: self.origin, has_target: self.has_target }
    }

    /// Whether two records of a target belong to one instant.
    pub fn same_instant(&self, a: &[u64], b: &[u64], target: TargetId) -> bool {
        let place = if self.by_k(target) { self.shape.k } else { self.shape.t };
        place == 0 || a[place] == b[place]
    }

    /// The next target in order, if there is one.
    pub fn next_target(&self, merge: &Merge) -> Option<TargetId> {
        let Facts { rank, by_k, rule, .. } = self;
        merge.target(&SortBy { rank, by_k: &|t| by_k.of(t), rule })
    }

    /// Appends records of `target`, the next in order, at most about `most`; whether these were its last.
    ///
    /// # Errors
    /// [`BuildError`] when the temporary file cannot be read.
    pub fn take(
        &self,
        merge: &mut Merge,
        target: TargetId,
        most: usize,
        out: &mut Vec<u64>,
    ) -> Result<bool, BuildError> {
        let Facts { rank, by_k, rule, schema, .. } = self;
        let by = SortBy { rank, by_k: &|t| by_k.of(t), rule };
        merge.take(target, most, &by, out).map_err(|e| spill_failed(schema.file, &e))
    }
}

/// Reads every row of `input`; what takes more room than there is goes to a temporary file in `folder`.
///
/// # Errors
/// [`BuildError`] for anything that cannot be understood; contradictions between rows are found later, target by target.
pub(crate) fn gather<'a>(
    input: &'a Input,
    anchors: &'a AnchorIds<'a>,
    options: &'a ReadOptions,
    (room, folder): (Room, &'a Path),
    progress: &mut dyn FnMut(u64, u64),
) -> Result<Gathered<'a>, BuildError> {
    let file = input.name();
    if anchors.anchors.len() > MOST_ANCHORS {
        let what = format!("has {} anchors, expected at most {MOST_ANCHORS}", anchors.anchors.len());
        return Err(BuildError::new(file, None, None, what));
    }
    let names = Arc::new(Names::default());
    let part = Rows::new(file, options, anchors, names.clone());
    let mut gather = Gather::new(file, options, names, Store::new(room, folder));
    let part = formats::read_parts(input, options.format, part, &mut |block| gather.join(block), progress)?;
    gather.finish(part.schema, anchors.anchors)
}

/// The earliest position of a table.
struct Earliest {
    instant: u64,
    target: TargetId,
    position: [f64; 3],
    origin: Origin,
}

struct Gather<'a> {
    file: &'a Path,
    options: &'a ReadOptions,
    names: Arc<Names>,
    store: Store,
    /// Names in order, as far as they have been needed.
    sorted: Sorted,
    /// Newest time of each target, and rows so far where they are numbered.
    newest: Vec<u64>,
    numbered: Vec<u64>,
    lacks_k: Vec<bool>,
    /// Whether all records are ordered by `k`, once some have been.
    by_k: Option<bool>,
    rule: Rule,
    common: Common<'a>,
    earliest_ns: Option<i64>,
    earliest: Option<Earliest>,
}

/// Names of targets, and their places in order.
#[derive(Default)]
struct Sorted {
    names: Vec<Box<str>>,
    rank: Vec<u32>,
}

impl Sorted {
    fn renew(&mut self, names: &Names) {
        if names.len() == self.names.len() {
            return;
        }
        self.names = names.list();
        let mut order: Vec<u32> = (0..self.names.len() as u32).collect();
        order.sort_by(|a, b| self.names[*a as usize].cmp(&self.names[*b as usize]));
        self.rank.resize(order.len(), 0);
        for (place, target) in order.into_iter().enumerate() {
            self.rank[target as usize] = place as u32;
        }
    }
}

impl<'a> Gather<'a> {
    fn new(file: &'a Path, options: &'a ReadOptions, names: Arc<Names>, store: Store) -> Gather<'a> {
        let latency = |kind: Kind| options.latency_s.get(&kind).copied().unwrap_or(0.0);
        Gather {
            file,
            options,
            names,
            store,
            sorted: Sorted::default(),
            newest: Vec::new(),
            numbered: Vec::new(),
            lacks_k: Vec::new(),
            by_k: None,
            rule: Rule { dates: false, latency_ns: record::latencies_ns(latency) },
            common: Common::new(file),
            earliest_ns: None,
            earliest: None,
        }
    }

    fn join(&mut self, mut block: Block) -> Result<(), BuildError> {
        self.common.add(&mut block)?;
        self.rule.dates = self.common.has_dates();
        let targets = self.names.len();
        self.newest.resize(targets, 0);
        self.lacks_k.resize(targets, false);
        self.number_rows(&mut block);
        self.look_at(&block);
        let Block { words, shape, .. } = block;
        for words in words.chunks(self.store.run_words(&shape)) {
            if self.store.append(words, &shape) && self.store.is_bounded() {
                self.sorted.renew(&self.names);
                let by_k = *self.by_k.get_or_insert(!self.lacks_k.contains(&true));
                let by = SortBy { rank: &self.sorted.rank, by_k: &|_| by_k, rule: &self.rule };
                self.store.close(&by).map_err(|e| spill_failed(self.file, &e))?;
            }
        }
        Ok(())
    }

    /// Rows were numbered within their block: the numbers go on from those before.
    fn number_rows(&mut self, block: &mut Block) {
        if block.numbered.is_empty() {
            return;
        }
        self.numbered.resize(self.newest.len(), 0);
        let k = block.shape.k;
        for r in block.words.chunks_exact_mut(block.shape.width.max(1)) {
            if block.shape.kind_of(r) == Kind::Linear && r[k] != ABSENT {
                r[k] += self.numbered[record::target(r) as usize];
            }
        }
        for (target, rows) in &block.numbered {
            self.numbered[*target as usize] += rows;
        }
    }

    /// What shows in the whole table alone: rows out of order, the earliest date and position, and who has a `k`.
    fn look_at(&mut self, block: &Block) {
        let shape = &block.shape;
        let is_geodetic = self.common.is_geodetic();
        for r in block.words.chunks_exact(shape.width.max(1)) {
            let target = record::target(r) as usize;
            self.lacks_k[target] |= shape.k == 0 || r[shape.k] == ABSENT;
            if shape.t == 0 || r[shape.t] == ABSENT {
                continue;
            }
            let instant = self.rule.instant(r[shape.t], || shape.kind_of(r));
            let newest = &mut self.newest[target];
            if instant < *newest {
                self.common.counts.out_of_order += 1;
            } else {
                *newest = instant;
            }
            if self.rule.dates {
                let ns = r[shape.t] as i64;
                self.earliest_ns = Some(self.earliest_ns.map_or(ns, |before| before.min(ns)));
            }
            if is_geodetic {
                self.look_at_position(shape, r, instant);
            }
        }
    }

    /// Keeps the earliest position of the table; of several as early that of the first target, then the smallest, whatever their order.
    fn look_at_position(&mut self, shape: &Shape, r: &[u64], instant: u64) {
        if self.earliest.as_ref().is_some_and(|e| e.instant < instant) {
            return;
        }
        let Some([Some(lat_deg), Some(lon_deg), alt]) = shape.position(r) else { return };
        let position = [lat_deg, lon_deg, alt.unwrap_or(0.0)];
        let target = record::target(r);
        let is_first = self.earliest.as_ref().is_none_or(|e| {
            let names = |t: TargetId| self.names.name(t);
            let by_place = || position.iter().zip(&e.position).map(|(a, b)| a.total_cmp(b)).find(|o| o.is_ne());
            let order = instant
                .cmp(&e.instant)
                .then_with(|| if target == e.target { Ordering::Equal } else { names(target).cmp(&names(e.target)) })
                .then_with(|| by_place().unwrap_or(Ordering::Equal));
            order.is_lt()
        });
        if is_first {
            let origin = Origin { lat_deg, lon_deg, alt_m: alt.unwrap_or(0.0) };
            self.earliest = Some(Earliest { instant, target, position, origin });
        }
    }

    fn finish(mut self, schema: Schema<'a>, anchors: &'a Anchors) -> Result<Gathered<'a>, BuildError> {
        let file = self.file;
        let has_dates = self.common.has_dates();
        let is_geodetic = self.common.is_geodetic();
        let Common { anchored, offset_s, mut counts, .. } = self.common;
        if self.store.records == 0 && counts.skipped_bad > 0 {
            let first = counts.first_bad.unwrap_or_default();
            let what = format!("has no good row, expected at least one; the first: {first}");
            return Err(BuildError::new(file, None, None, what));
        }
        if let (true, Some(line)) = (is_geodetic, anchored) {
            let what = "refers to an anchor in metres while positions are latitudes and longitudes, expected one frame for both";
            return Err(schema.at(line, Col::Anchor, what));
        }
        self.sorted.renew(&self.names);
        let by_k = match self.by_k {
            Some(true) if self.lacks_k.contains(&true) => {
                let what = "is missing in some rows, expected a time index in all or in none";
                return Err(BuildError::new(file, None, Some(&schema.name(schema.place(Col::K), "k")), what));
            }
            Some(by_k) => ByK::All(by_k),
            None => ByK::Of(self.lacks_k.iter().map(|lacks| !lacks).collect()),
        };
        let time = if has_dates {
            TimeForm::Rfc3339 {
                epoch_unix_s: self.earliest_ns.map_or(0, time::whole_second),
                offset_s: offset_s.flatten().unwrap_or(0),
            }
        } else if schema.has(Col::T) {
            TimeForm::Seconds
        } else {
            TimeForm::Index
        };
        let epoch_unix_s = match time {
            TimeForm::Rfc3339 { epoch_unix_s, .. } => Some(epoch_unix_s),
            TimeForm::Seconds | TimeForm::Index => None,
        };
        let latency = |kind: Kind| self.options.latency_s.get(&kind).copied().unwrap_or(0.0);
        let clock = Clock { epoch_unix_s, latency_s: Clock::latencies(latency) };
        let records = self.store.records;
        let rank = self.sorted.rank;
        let by = SortBy { rank: &rank, by_k: &|t| by_k.of(t), rule: &self.rule };
        let merge = self.store.merge(&by).map_err(|e| spill_failed(file, &e))?;
        counts.ignored_columns.clone_from(&schema.ignored);
        let has_target = schema.has(Col::Target);
        let facts = Facts {
            schema,
            anchors,
            skip_bad_rows: self.options.skip_bad_rows,
            names: self.names,
            rank,
            by_k,
            rule: self.rule,
            shape: merge.shape,
            records,
            clock,
            time,
            origin: self.earliest.map(|e| e.origin),
            has_target,
            counts,
        };
        Ok(Gathered { facts, merge })
    }
}

/// The error of a temporary file that cannot be written or read.
fn spill_failed(file: &Path, error: &io::Error) -> BuildError {
    let what = format!("does not fit into memory, and the temporary file for the rest fails: {error}");
    BuildError::new(file, None, None, what)
}
