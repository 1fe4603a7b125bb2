//! A table that stands in order, tracked while it is read.
//!
//! In order means target by target, by ascending names, each by time; times are seconds, and there is no `k`, latitude or longitude. Nothing
//! that the rest of the table says changes a trail then, so that a target is tracked as soon as the next one begins. That a table is in order
//! shows at its last row only: where it turns out otherwise, or anything is wrong with it, what was written is dropped and the run begins
//! again on the other way, which takes every order and says best what is wrong.

use crate::common::Common;
use crate::content::AnchorIds;
use crate::formats::{self, Joiner};
use crate::gather::Facts;
use crate::input::Input;
use crate::job::{Done, Job, Worker};
use crate::names::{Names, TargetId};
use crate::ordered::ordered;
use crate::record::{self, ABSENT, Shape};
use crate::rows::{Block, Rows};
use crate::settle::Tally;
use crate::stream::{FileOutcome, FileRun, Phase};
use crate::table::TableMeta;
use crate::time::TimeForm;
use crate::totals::Totals;
use crate::write::{Encoder, GROUP_ROWS, OutFormat, Output, Sheet, WriteError, place};
use fixtrail_track::chains::Series;
use fixtrail_track::error::BuildError;
use fixtrail_track::registry;
use fixtrail_track::trackers::LaggedMode;
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Why a run along the table ends early.
enum Halt {
    /// The table is not in order, or something is wrong with it.
    Otherwise,
    /// The trails cannot be written.
    Write(WriteError),
}

impl From<BuildError> for Halt {
    fn from(_: BuildError) -> Halt {
        Halt::Otherwise
    }
}

impl From<WriteError> for Halt {
    fn from(error: WriteError) -> Halt {
        Halt::Write(error)
    }
}

/// Tracks every target of a table that is in order; `None` where it is not, or has an error. No more than about `long` records of a target are kept.
///
/// # Errors
/// [`WriteError`].
pub(crate) fn track_straight(
    run: &FileRun<'_>,
    anchors: &AnchorIds<'_>,
    long: usize,
    progress: &dyn Fn(Phase, u64, u64),
) -> Result<Option<FileOutcome>, WriteError> {
    // The table is read twice and the output taken back where it is not in order.
    let can_return = matches!(run.input, Input::File(path) if path.is_file())
        && matches!(run.output, Output::File(path) if !place::is_direct(path));
    if !can_return || run.write.format == OutFormat::GeoJson {
        return Ok(None);
    }
    let layout = registry::layout(run.spec);
    let meta = TableMeta { time: TimeForm::Seconds, origin: None, has_target: true };
    let has_lagged = run.lagged == LaggedMode::Both;
    let encoder = Encoder::new(run.output.name(), &layout, meta, has_lagged, run.write)?;
    let (series, failed) = (Series::of(run.spec), AtomicBool::new(false));
    let worker = Worker { run, n: layout.n(), encoder: &encoder, series: series.as_ref(), failed: &failed };
    let mut outcome = None;
    let written = place::write(run.output, |to| {
        let mut sheet = Sheet::start(&encoder, to)?;
        let names = Arc::new(Names::default());
        let part = Rows::new(run.input.name(), run.read, anchors, names.clone());
        let mut along = Along {
            worker,
            names,
            long,
            sheet: &mut sheet,
            common: Common::new(run.input.name()),
            facts: None,
            name: Box::default(),
            last: Vec::new(),
            open: Job::default(),
            start: 0,
            ready: VecDeque::new(),
            totals: Totals::default(),
            tally: Tally::default(),
        };
        let reading = &mut |done, total| progress(Phase::Reading, done, total);
        let part = formats::read_parts(run.input, run.read.format, part, &mut along, reading)?;
        along.end()?;
        let Along { common: Common { mut counts, .. }, totals, tally, .. } = along;
        counts.ignored_columns.clone_from(&part.schema.ignored);
        tally.add_to(&mut counts);
        outcome = Some(FileOutcome { counts, meta, totals });
        sheet.finish().map_err(Halt::Write)
    });
    match written {
        Ok(()) => Ok(outcome),
        Err(Halt::Otherwise) => Ok(None),
        Err(Halt::Write(error)) => Err(error),
    }
}

/// What is known while the table goes by.
struct Along<'a, 's, 'e, 't> {
    worker: Worker<'a>,
    names: Arc<Names>,
    long: usize,
    sheet: &'s mut Sheet<'e, 't>,
    common: Common<'a>,
    /// Known from the first block on.
    facts: Option<Arc<Facts<'a>>>,
    /// The target whose records come in.
    name: Box<str>,
    /// The newest record.
    last: Vec<u64>,
    /// Targets that are whole, and what there is of the one after them.
    open: Job,
    /// Where in `open` the target begins whose records come in.
    start: usize,
    ready: VecDeque<Task<'a>>,
    totals: Totals,
    tally: Tally,
}

/// A job and what it needs to know.
struct Task<'a> {
    worker: Worker<'a>,
    facts: Arc<Facts<'a>>,
    job: Job,
}

impl<'a> Along<'a, '_, '_, '_> {
    /// What is known of the table, if records of `shape` can be those of one in order.
    fn facts(&mut self, shape: Shape) -> Result<Arc<Facts<'a>>, Halt> {
        match &self.facts {
            Some(facts) if facts.shape == shape => Ok(facts.clone()),
            None if shape.k == 0 && shape.t > 0 => {
                let run = self.worker.run;
                let facts =
                    Facts::of_straight(run.input.name(), run.anchors, run.read, self.names.clone(), shape);
                Ok(self.facts.insert(Arc::new(facts)).clone())
            }
            _ => Err(Halt::Otherwise),
        }
    }

    /// The next target begins; the one before is whole.
    fn begin(&mut self, target: TargetId, facts: &Arc<Facts<'a>>) -> Result<(), Halt> {
        self.close(facts);
        let name = self.names.name(target).unwrap_or_default();
        // The first has to have a name; `""` comes before all.
        if name <= self.name {
            return Err(Halt::Otherwise);
        }
        self.name = name;
        Ok(())
    }

    /// Ends the newest target, and makes a job of the whole ones once they are enough.
    fn close(&mut self, facts: &Arc<Facts<'a>>) {
        let end = self.open.records.len();
        if end > self.start {
            self.open.targets.push((record::target(&self.open.records[self.start..]), self.start..end));
            self.start = end;
        }
        if end >= GROUP_ROWS * facts.shape.width {
            self.hand_on(facts);
        }
    }

    fn hand_on(&mut self, facts: &Arc<Facts<'a>>) {
        let job = std::mem::take(&mut self.open);
        self.start = 0;
        self.ready.push_back(Task { worker: self.worker, facts: facts.clone(), job });
    }

    /// The table is over.
    fn end(&mut self) -> Result<(), Halt> {
        // A table without a good row has something wrong.
        let facts = self.facts.clone().ok_or(Halt::Otherwise)?;
        self.close(&facts);
        if !self.open.targets.is_empty() {
            self.hand_on(&facts);
        }
        let mut left = std::mem::take(&mut self.ready);
        let work = |(): &mut (), task| Self::work(task);
        ordered(rayon::current_num_threads(), || (), || Ok(left.pop_front()), work, |done| self.done(done))
    }
}

impl<'a> Joiner for Along<'a, '_, '_, '_> {
    type Block = Block;
    type Job = Task<'a>;
    type Done = Done;
    type Error = Halt;

    fn join(&mut self, mut block: Block) -> Result<(), Halt> {
        self.common.add(&mut block)?;
        if self.common.has_dates() || self.common.is_geodetic() || !block.numbered.is_empty() {
            return Err(Halt::Otherwise);
        }
        let Block { words, shape, .. } = block;
        if words.is_empty() {
            return Ok(());
        }
        let facts = self.facts(shape)?;
        let last = std::mem::take(&mut self.last);
        let mut before: &[u64] = &last;
        let mut taken = 0;
        for (at, r) in (0..).step_by(shape.width).zip(words.chunks_exact(shape.width)) {
            if r[shape.t] == ABSENT {
                return Err(Halt::Otherwise);
            }
            if before.is_empty() || record::target(before) != record::target(r) {
                self.open.records.extend_from_slice(&words[taken..at]);
                taken = at;
                self.begin(record::target(r), &facts)?;
            } else if !(f64::from_bits(before[shape.t]) < f64::from_bits(r[shape.t])) && !facts.in_order(before, r) {
                return Err(Halt::Otherwise);
            }
            before = r;
        }
        self.open.records.extend_from_slice(&words[taken..]);
        self.last = before.to_vec();
        if self.open.records.len() - self.start > self.long.saturating_mul(shape.width) {
            return Err(Halt::Otherwise);
        }
        Ok(())
    }

    fn job(&mut self) -> Option<Task<'a>> {
        self.ready.pop_front()
    }

    fn work(Task { worker, facts, job }: Task<'a>) -> Done {
        worker.job(&job, &facts)
    }

    fn done(&mut self, done: Done) -> Result<(), Halt> {
        self.tally.add(done.tally);
        self.totals.add(&done.totals);
        match done.encoded {
            Some(encoded) if self.tally.refused.is_none() && done.unsteady.is_none() => {
                Ok(self.sheet.append(encoded?)?)
            }
            _ => Err(Halt::Otherwise),
        }
    }
}
