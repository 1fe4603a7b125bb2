//! A table that keeps the rows of each target together, tracked target by target out of the file itself.
//!
//! A first look finds where the rows of each target stand; then each target is read, tracked and written, in the order of their names.
//! Nothing is spilled, and nothing kept but the places, and of Parquet the row groups that are in use. Times must be seconds, and there must be no `k` and no latitude, for those have a meaning in the
//! whole table alone. Where a table turns out otherwise, or anything is wrong with it, what was written is dropped and the run begins again on
//! the other way, which takes every table and says best what is wrong.

mod loaded;

use crate::common::Common;
use crate::content::AnchorIds;
use crate::formats::Part;
use crate::formats::parquet::{Reader, groups::Groups};
use crate::formats::spans::{Reading, Span, Spans};
use crate::gather::Facts;
use crate::input::Input;
use crate::job::{self, Abreast, Done, Job, Worker};
use crate::names::{Names, TargetId};
use crate::options::Counts;
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
use fixtrail_track::error::BuildError;
use fixtrail_track::registry;
use fixtrail_track::trackers::LaggedMode;
use loaded::Loaded;
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
        match error {
            // What the table says wrong stands before it.
            WriteError::NotFinite { .. } => Halt::Otherwise,
            error => Halt::Write(error),
        }
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
    let found = Found::of(run, &mut part, (&names, room.fewest_rows), progress)?.ok_or(Halt::Otherwise)?;
    let shape = part.schema.shape();
    if shape.k > 0 || shape.t == 0 {
        return Err(Halt::Otherwise);
    }
    let facts = Facts::of_seconds(path, anchors.anchors, run.read, names, shape);
    let targets = by_name(found.list(), &facts);
    let rows: u64 = found.list().iter().map(|s| s.lines).sum();
    let jobs = jobs(found.list(), &targets, room.long).ok_or(Halt::Otherwise)?;
    let desk = Desk::new(found, &facts);
    let mut pieces = desk.pieces(&targets, jobs, room).ok_or(Halt::Otherwise)?.into_iter();

    let layout = registry::layout(run.spec);
    let meta = TableMeta { time: TimeForm::Seconds, origin: None, has_target: true };
    let has_lagged = run.lagged == LaggedMode::Both;
    let encoder = Encoder::new(run.output.name(), &layout, meta, has_lagged, run.write)?;
    let (series, failed) = (job::series(run), AtomicBool::new(false));
    let worker = Worker { run, encoder: &encoder, series: series.as_ref(), failed: &failed };
    let keep = || Kept {
        part: part.fork(),
        reading: Reading::default(),
        reader: None,
        words: Vec::new(),
        abreast: Abreast::default(),
    };

    let (mut common, mut totals, mut tally) = (Common::new(path), Totals::default(), Tally::default());
    place::write(run.output, |to| {
        let mut sheet = Sheet::start(&encoder, to)?;
        let next = || Ok(pieces.next());
        let work = |kept: &mut Kept<'_>, piece: Piece| desk.work(&worker, kept, &targets, piece);
        let take = |worked: Option<(Vec<Block>, Option<Done>)>| -> Result<(), Halt> {
            let (mut seen, done) = worked.ok_or(Halt::Otherwise)?;
            seen.iter_mut().try_for_each(|block| common.add(block))?;
            let Some(done) = done else { return Ok(()) };
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

/// A target and the numbers of its spans, in the order of the file.
type Target = (TargetId, Vec<usize>);

/// The targets in the order of their names.
fn by_name(spans: &[Span], facts: &Facts<'_>) -> Vec<Target> {
    let mut targets: Vec<Target> = Vec::new();
    for (i, span) in spans.iter().enumerate() {
        let id = span.target as usize;
        if targets.len() <= id {
            targets.resize_with(id + 1, Default::default);
        }
        targets[id].0 = span.target;
        targets[id].1.push(i);
    }
    targets.sort_by_cached_key(|(target, _)| facts.name(*target));
    targets
}

/// Targets in jobs of as many rows as are written together; `None` where one has more than `long`.
fn jobs(spans: &[Span], targets: &[Target], long: usize) -> Option<Vec<Range<usize>>> {
    let (mut jobs, mut start, mut lines) = (Vec::new(), 0, 0);
    for (i, (_, of_target)) in targets.iter().enumerate() {
        let of_target = of_target.iter().map(|i| spans[*i].lines).sum::<u64>();
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

/// Where rows stand, and how they are read.
enum Found<S, G> {
    /// As lines of text.
    Lines(S),
    /// As rows of row groups.
    Groups(G),
}

impl<'a> Found<Spans, Groups<'a>> {
    /// Looks through the table and gives `part` its columns; `None` where rows of a target do not stand together.
    ///
    /// # Errors
    /// [`BuildError`] as [`Spans::of`] and [`Groups::of`] have it.
    fn of(
        run: &FileRun<'a>,
        part: &mut Rows<'_>,
        targets: (&Names, u64),
        progress: &dyn Fn(Phase, u64, u64),
    ) -> Result<Option<Self>, BuildError> {
        let (input, format) = (run.input, run.read.format);
        let column = |part: &Rows<'_>| part.schema.place(Col::Target);
        let reading = &mut |done, total| progress(Phase::Reading, done, total);
        if let Some(groups) = Groups::of(input, format, part, column, targets, reading)? {
            return Ok(Some(Found::Groups(groups)));
        }
        Ok(Spans::of(input, format, part, column, targets, reading)?.map(Found::Lines))
    }

    /// The spans.
    fn list(&self) -> &[Span] {
        match self {
            Found::Lines(spans) => &spans.list,
            Found::Groups(groups) => &groups.list,
        }
    }
}

/// Pieces of work before which a row group is loaded, at most: what is there must not grow with the machine.
const MOST_AHEAD: usize = 8;

/// A piece of the work.
enum Piece {
    /// Loads a row group.
    Load(usize),
    /// Tracks some targets.
    Track(Range<usize>),
}

/// What a thread keeps.
struct Kept<'a> {
    part: Rows<'a>,
    reading: Reading,
    reader: Option<Reader>,
    words: Vec<u64>,
    abreast: Abreast,
}

/// What all pieces share.
struct Desk<'a> {
    facts: &'a Facts<'a>,
    found: Found<Spans, Loaded<'a>>,
}

impl<'a> Desk<'a> {
    fn new(found: Found<Spans, Groups<'a>>, facts: &'a Facts<'a>) -> Desk<'a> {
        let found = match found {
            Found::Lines(spans) => Found::Lines(spans),
            Found::Groups(groups) => Found::Groups(Loaded::new(groups, facts.shape.width)),
        };
        Desk { facts, found }
    }

    /// The work in its order; `None` where there is no room for it.
    fn pieces(&self, targets: &[Target], jobs: Vec<Range<usize>>, room: Room) -> Option<Vec<Piece>> {
        let Found::Groups(loaded) = &self.found else { return Some(jobs.into_iter().map(Piece::Track).collect()) };
        let spans = |job: &Range<usize>| targets[job.clone()].iter().flat_map(|(_, spans)| spans.iter().copied());
        // Another thread reads what comes next while targets are tracked.
        let ahead = rayon::current_num_threads().min(MOST_AHEAD);
        let loads = loaded.order(jobs.iter().map(spans), (ahead, room.loaded_words))?;
        let with_loads = |(loads, job): (Vec<usize>, _)| loads.into_iter().map(Piece::Load).chain([Piece::Track(job)]);
        Some(loads.into_iter().zip(jobs).flat_map(with_loads).collect())
    }

    /// Does a piece of the work; `None` where something is other than expected.
    fn work(
        &self,
        worker: &Worker<'_>,
        kept: &mut Kept<'_>,
        targets: &[Target],
        piece: Piece,
    ) -> Option<(Vec<Block>, Option<Done>)> {
        let mut seen = Vec::new();
        match (piece, &self.found) {
            (Piece::Track(job), _) => {
                let job = self.job(kept, &targets[job], &mut seen)?;
                let done = worker.job(&job, self.facts, &mut kept.abreast);
                kept.words = job.records;
                Some((seen, Some(done)))
            }
            (Piece::Load(group), Found::Groups(loaded)) => {
                loaded.load(group, &mut kept.reader, &mut kept.part, &mut seen).ok()?;
                seen.iter().all(|block| self.expects(block)).then_some((seen, None))
            }
            (Piece::Load(_), Found::Lines(_)) => Some((seen, None)),
        }
    }

    /// Whether a block is as all others.
    fn expects(&self, block: &Block) -> bool {
        let is_other = |seen: &Option<Seen>| seen.as_ref().is_some_and(|seen| seen.form);
        let is_plain = !is_other(&block.times) && !is_other(&block.positions) && block.numbered.is_empty();
        is_plain && block.shape == self.facts.shape
    }

    /// Reads some targets; what was seen is added to `seen`. `None` as [`work`](Desk::work).
    fn job(&self, kept: &mut Kept<'_>, targets: &[Target], seen: &mut Vec<Block>) -> Option<Job> {
        let Kept { part, reading, reader, words, .. } = kept;
        let (shape, mut records) = (&self.facts.shape, std::mem::take(words));
        let mut spans = targets.iter().flat_map(|(_, spans)| spans.iter().copied());
        match &self.found {
            Found::Lines(lines) => {
                part.use_room(records);
                spans.try_for_each(|span| lines.read(span, self.facts.schema.file, reading, part)).ok()?;
                let mut block = part.cut();
                records = std::mem::take(&mut block.words);
                seen.push(block);
            }
            Found::Groups(loaded) => {
                records.clear();
                for span in spans {
                    loaded.read(&loaded.groups.list[span], reader, part, seen, &mut records).ok()??;
                }
            }
        }
        if !seen.iter().all(|block| self.expects(block)) {
            return None;
        }
        let mut job = Job { records, targets: Vec::new() };
        let (mut start, mut out_of_order) = (0, 0);
        for (target, _) in targets {
            let rows = job.records[start..].chunks_exact(shape.width);
            let end = start + shape.width * rows.take_while(|r| record::target(r) == *target).count();
            if end > start {
                out_of_order += late(&job.records[start..end], shape.width, shape.t)?;
                job.targets.push((*target, start..end));
            }
            start = end;
        }
        // A row of another target than a glance told.
        if start < job.records.len() {
            return None;
        }
        seen.push(Block { counts: Counts { out_of_order, ..Counts::default() }, ..Block::default() });
        Some(job)
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
