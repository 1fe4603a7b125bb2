//! A table that keeps the rows of each target together, tracked target by target out of the file itself.
//!
//! A first look finds where the rows of each target stand; then each target is read, tracked and written, in the order of their names.
//! Nothing is kept or spilled but the places. Times must be seconds, and there must be no `k` and no latitude, for those have a meaning in the
//! whole table alone. Where a table turns out otherwise, or anything is wrong with it, what was written is dropped and the run begins again on
//! the other way, which takes every table and says best what is wrong.

use crate::common::Common;
use crate::content::AnchorIds;
use crate::formats::Part;
use crate::formats::spans::{Reading, Span, Spans};
use crate::gather::Facts;
use crate::input::Input;
use crate::job::{Done, Job, Worker};
use crate::names::{Names, TargetId};
use crate::ordered::ordered;
use crate::record::{self, ABSENT};
use crate::rows::{Block, Rows, Seen};
use crate::schema::Col;
use crate::settle::Tally;
use crate::store::Room;
use crate::stream::{FileOutcome, FileRun, Phase};
use crate::table::TableMeta;
use crate::time::TimeForm;
use crate::totals::Totals;
use crate::write::{Encoder, GROUP_ROWS, OutFormat, Output, Sheet, WriteError, place};
use fixtrail_track::chains::Series;
use fixtrail_track::error::BuildError;
use fixtrail_track::registry;
use fixtrail_track::trackers::LaggedMode;
use std::fs::File;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Why a run ends early.
enum Halt {
    /// The table is not of this kind, or something is wrong with it.
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

/// Tracks every target of a table that keeps their rows together; `None` where it does not, or is of another kind, or has an error. Targets
/// have no more rows than `room` says.
///
/// # Errors
/// [`WriteError`].
pub(crate) fn track_grouped(
    run: &FileRun<'_>,
    anchors: &AnchorIds<'_>,
    room: Room,
    progress: &dyn Fn(Phase, u64, u64),
) -> Result<Option<FileOutcome>, WriteError> {
    // The table is read twice, and the output taken back where that was in vain.
    let (Input::File(path), Output::File(to)) = (run.input, run.output) else { return Ok(None) };
    if !path.is_file() || place::is_direct(to) || run.write.format == OutFormat::GeoJson {
        return Ok(None);
    }
    match track(run, path, anchors, room, progress) {
        Ok(outcome) => Ok(Some(outcome)),
        Err(Halt::Otherwise) => Ok(None),
        Err(Halt::Write(error)) => Err(error),
    }
}

fn track(
    run: &FileRun<'_>,
    path: &Path,
    anchors: &AnchorIds<'_>,
    room: Room,
    progress: &dyn Fn(Phase, u64, u64),
) -> Result<FileOutcome, Halt> {
    let names = Arc::new(Names::default());
    let mut part = Rows::new(path, run.read, anchors, names.clone());
    let column = |part: &Rows<'_>| part.schema.place(Col::Target);
    let reading = &mut |done, total| progress(Phase::Reading, done, total);
    let spans = Spans::of(run.input, run.read.format, &mut part, column, (&names, room.fewest_rows), reading)?
        .ok_or(Halt::Otherwise)?;
    let shape = part.schema.shape();
    if shape.k > 0 || shape.t == 0 {
        return Err(Halt::Otherwise);
    }
    let facts = Facts::of_seconds(path, anchors.anchors, run.read, names, shape);
    let targets = by_name(&spans.list, &facts);
    let rows: u64 = spans.list.iter().map(|s| s.lines).sum();
    let jobs = jobs(&targets, room.long).ok_or(Halt::Otherwise)?;

    let layout = registry::layout(run.spec);
    let meta = TableMeta { time: TimeForm::Seconds, origin: None, has_target: true };
    let has_lagged = run.lagged == LaggedMode::Both;
    let encoder = Encoder::new(run.output.name(), &layout, meta, has_lagged, run.write)?;
    let (series, failed) = (Series::of(run.spec), AtomicBool::new(false));
    let worker = Worker { run, n: layout.n(), encoder: &encoder, series: series.as_ref(), failed: &failed };
    let desk = Desk { worker, facts: &facts, spans: &spans };
    let keep = || Kept { part: part.fork(), file: None, reading: Reading::default(), words: Vec::new() };

    let (mut common, mut totals, mut tally) = (Common::new(path), Totals::default(), Tally::default());
    let mut jobs = jobs.into_iter();
    place::write(run.output, |to| {
        let mut sheet = Sheet::start(&encoder, to)?;
        let next = || Ok(jobs.next());
        let work = |kept: &mut Kept<'_>, job: Range<usize>| desk.job(kept, &targets[job]);
        let take = |worked: Option<(Block, Done)>| -> Result<(), Halt> {
            let (mut block, done) = worked.ok_or(Halt::Otherwise)?;
            common.add(&mut block)?;
            tally.add(done.tally);
            totals.add(&done.totals);
            match done.encoded {
                Some(encoded) if tally.refused.is_none() && done.unsteady.is_none() => sheet.append(encoded?)?,
                _ => return Err(Halt::Otherwise),
            }
            progress(Phase::Tracking, totals.packets, rows);
            Ok(())
        };
        ordered(rayon::current_num_threads(), keep, next, work, take)?;
        // Which bad row was the first shows in the order of the file alone, and a table without a good row has something wrong.
        if common.counts.skipped_bad > 0 || totals.packets == 0 {
            return Err(Halt::Otherwise);
        }
        sheet.finish().map_err(Halt::Write)
    })?;
    let mut counts = common.counts;
    counts.ignored_columns.clone_from(&part.schema.ignored);
    tally.add_to(&mut counts);
    Ok(FileOutcome { counts, meta, totals })
}

/// A target and its spans, in the order of the file.
type Target = (TargetId, Vec<Span>);

/// The targets in the order of their names.
fn by_name(spans: &[Span], facts: &Facts<'_>) -> Vec<Target> {
    let mut targets: Vec<Target> = Vec::new();
    for span in spans {
        let id = span.target as usize;
        if targets.len() <= id {
            targets.resize_with(id + 1, Default::default);
        }
        targets[id].0 = span.target;
        targets[id].1.push(*span);
    }
    targets.sort_by_cached_key(|(target, _)| facts.name(*target));
    targets
}

/// Targets in jobs of as many rows as are written together; `None` where one has more than `long`.
fn jobs(targets: &[Target], long: usize) -> Option<Vec<Range<usize>>> {
    let (mut jobs, mut start, mut lines) = (Vec::new(), 0, 0);
    for (i, (_, spans)) in targets.iter().enumerate() {
        let of_target = spans.iter().map(|s| s.lines).sum::<u64>();
        if of_target > long as u64 {
            return None;
        }
        lines += of_target;
        if lines >= GROUP_ROWS as u64 || i + 1 == targets.len() {
            jobs.push(start..i + 1);
            (start, lines) = (i + 1, 0);
        }
    }
    Some(jobs)
}

/// What a thread keeps.
struct Kept<'a> {
    part: Rows<'a>,
    /// The table, opened once more: where a file is read is not shared.
    file: Option<File>,
    reading: Reading,
    words: Vec<u64>,
}

/// What all jobs share.
struct Desk<'a> {
    worker: Worker<'a>,
    facts: &'a Facts<'a>,
    spans: &'a Spans,
}

impl Desk<'_> {
    /// Reads, tracks and encodes some targets; `None` where something is other than expected.
    fn job(&self, kept: &mut Kept<'_>, targets: &[Target]) -> Option<(Block, Done)> {
        let (Kept { part, reading, file, words }, shape) = (kept, &self.facts.shape);
        let file = match file {
            Some(file) => file,
            None => file.insert(File::open(self.facts.schema.file).ok()?),
        };
        part.use_room(std::mem::take(words));
        for span in targets.iter().flat_map(|(_, spans)| spans) {
            self.spans.read(span, (self.facts.schema.file, file), reading, part).ok()?;
        }
        let mut block = part.cut();
        let is_other = |seen: &Option<Seen>| seen.as_ref().is_some_and(|seen| seen.form);
        if is_other(&block.times) || is_other(&block.positions) || !block.numbered.is_empty() || block.shape != *shape {
            return None;
        }
        let mut job = Job { records: std::mem::take(&mut block.words), targets: Vec::new() };
        let mut start = 0;
        for (target, _) in targets {
            let rows = job.records[start..].chunks_exact(shape.width);
            let end = start + shape.width * rows.take_while(|r| record::target(r) == *target).count();
            if end > start {
                block.counts.out_of_order += late(&job.records[start..end], shape.width, shape.t)?;
                job.targets.push((*target, start..end));
            }
            start = end;
        }
        // A row of another target than the glance at its line told.
        if start < job.records.len() {
            return None;
        }
        let done = self.worker.job(&job, self.facts);
        *words = job.records;
        Some((block, done))
    }
}

/// How many records of a target are older than one before; `None` where one has no time.
fn late(records: &[u64], width: usize, t: usize) -> Option<u64> {
    let (mut newest, mut count) = (f64::NEG_INFINITY, 0);
    for r in records.chunks_exact(width) {
        if r[t] == ABSENT {
            return None;
        }
        let t_s = f64::from_bits(r[t]);
        count += u64::from(t_s < newest);
        newest = newest.max(t_s);
    }
    Some(count)
}
