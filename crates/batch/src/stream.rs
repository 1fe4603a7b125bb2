//! A whole file tracked in bounded memory: rows in, trails out, target by target.

use crate::content::AnchorIds;
use crate::gather::{Facts, Gathered, gather};
use crate::grouped::track_grouped;
use crate::input::Input;
use crate::job::{self, Abreast, Done, Job, Worker};
use crate::names::TargetId;
use crate::options::{Counts, ReadOptions};
use crate::ordered::ordered;
use crate::settle::{Settler, Tally};
use crate::store::Room;
use crate::table::TableMeta;
use crate::totals::Totals;
use crate::write::{Encoder, GROUP_ROWS, OutFormat, Output, Piece, Sheet, WriteError, WriteOptions, place};
use fixtrail_track::anchors::Anchors;
use fixtrail_track::chains::Series;
use fixtrail_track::error::BuildError;
use fixtrail_track::packet::Packet;
use fixtrail_track::pipeline::{Pipeline, TrackError, track};
use fixtrail_track::registry;
use fixtrail_track::spec::{Receiver, Spec};
use fixtrail_track::target::{TargetPackets, TargetTrail};
use fixtrail_track::trackers::LaggedMode;
use fixtrail_track::trail::Trail;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

/// What to track, how, and where to.
pub struct FileRun<'a> {
    /// The measurements.
    pub input: &'a Input,
    /// The anchors.
    pub anchors: &'a Anchors,
    /// How they are read.
    pub read: &'a ReadOptions,
    /// How they are tracked.
    pub spec: &'a Spec,
    /// Filter, smoother or both.
    pub lagged: LaggedMode,
    /// Where the trails go.
    pub output: &'a Output,
    /// How they are written: by target.
    pub write: &'a WriteOptions,
}

/// What a run made.
#[derive(Clone, Debug, PartialEq)]
pub struct FileOutcome {
    /// What was seen while reading.
    pub counts: Counts,
    /// What the table was.
    pub meta: TableMeta,
    /// Sums over its targets.
    pub totals: Totals,
}

/// Why a run failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FileError {
    /// The table cannot be read.
    #[error(transparent)]
    Read(#[from] BuildError),
    /// A target cannot be tracked.
    #[error(transparent)]
    Track(#[from] TrackError),
    /// The trails cannot be written.
    #[error(transparent)]
    Write(#[from] WriteError),
}

/// What a run is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Reads the table: bytes.
    Reading,
    /// Tracks targets and writes their trails: records.
    Tracking,
}

/// Tracks every target of a file and writes their trails, sorted by target, then time.
///
/// Memory does not grow with the number of rows: what does not fit goes to a temporary file beside the output, and is read back target by
/// target. It grows with the number of targets by their names, and by the trail of the longest target where the estimator is a smoother
/// over all of it or takes late packets. The result depends neither on the order of the rows nor on the number of threads. `progress` is told
/// what is done, and how much of how much (0 when unknown).
///
/// # Errors
/// [`FileError`]; what was at the output before is still there then, and nothing else is left behind.
pub fn track_file(run: &FileRun<'_>, progress: &dyn Fn(Phase, u64, u64)) -> Result<FileOutcome, FileError> {
    track_within(run, Room::BOUNDED, progress)
}

fn track_within(run: &FileRun<'_>, room: Room, progress: &dyn Fn(Phase, u64, u64)) -> Result<FileOutcome, FileError> {
    let ids = AnchorIds::new(run.anchors);
    match track_grouped(run, &ids, room, progress)? {
        Some(outcome) => Ok(outcome),
        None => track_sorted(run, &ids, room, progress),
    }
}

/// Tracks a table in any order.
fn track_sorted(
    run: &FileRun<'_>,
    ids: &AnchorIds<'_>,
    room: Room,
    progress: &dyn Fn(Phase, u64, u64),
) -> Result<FileOutcome, FileError> {
    let folder = spill_folder(run.output);
    let reading = &mut |done, total| progress(Phase::Reading, done, total);
    let gathered = gather(run.input, ids, run.read, (room, &folder), reading)?;
    let layout = registry::layout(run.spec);
    let meta = gathered.facts.meta();
    let encoder = Encoder::new(run.output.name(), &layout, meta, run.lagged == LaggedMode::Both, run.write)?;
    let mut writer = Writer {
        run,
        long: room.long,
        n: layout.n(),
        encoder: &encoder,
        series: job::series(run),
        failed: AtomicBool::new(false),
        progress,
        outcome: FileOutcome { counts: gathered.facts.counts.clone(), meta, totals: Totals::default() },
        tally: Tally::default(),
        unsteady: None,
    };
    place::write(run.output, |to| {
        let mut sheet = Sheet::start(&encoder, to)?;
        writer.targets(gathered, &mut sheet)?;
        // What the table says wrong stands before what an estimator makes of it.
        if let Some(error) = writer.tally.refused.take() {
            return Err(FileError::Read(error));
        }
        if let Some(error) = writer.unsteady.take() {
            return Err(FileError::Track(error));
        }
        sheet.finish().map_err(FileError::Write)
    })?;
    let mut outcome = writer.outcome;
    writer.tally.add_to(&mut outcome.counts);
    Ok(outcome)
}

/// Where records go that do not fit into memory: to the output's disk, which must have room anyway.
fn spill_folder(output: &Output) -> PathBuf {
    match output {
        Output::File(path) if !place::is_direct(path) => match path.parent() {
            Some(folder) if folder != Path::new("") => folder.to_owned(),
            _ => PathBuf::from("."),
        },
        _ => std::env::temp_dir(),
    }
}

/// The second half of a run.
struct Writer<'a> {
    run: &'a FileRun<'a>,
    /// Records of a target that may be in memory at once.
    long: usize,
    /// Components of the state.
    n: usize,
    encoder: &'a Encoder<'a>,
    series: Option<Series>,
    /// Nothing more is tracked; the rest of the table is still looked at.
    failed: AtomicBool,
    progress: &'a dyn Fn(Phase, u64, u64),
    outcome: FileOutcome,
    tally: Tally,
    /// The first target in order that could not be tracked.
    unsteady: Option<TrackError>,
}

impl Writer<'_> {
    /// Jobs of many targets run side by side; a target that is long runs alone, in parts.
    fn targets(&mut self, mut gathered: Gathered<'_>, sheet: &mut Sheet<'_, '_>) -> Result<(), FileError> {
        let Gathered { facts, merge } = &mut gathered;
        let facts: &Facts<'_> = facts;
        let width = facts.shape.width.max(1);
        let mut long: Option<(TargetId, Vec<u64>)> = None;
        loop {
            let Writer { run, long: most, encoder, series, failed, progress, outcome, tally, unsteady, .. } = self;
            let worker = Worker { run, encoder, series: series.as_ref(), failed };
            let next = || -> Result<Option<Job>, FileError> {
                let mut job = Job { records: Vec::new(), targets: Vec::new() };
                while long.is_none() && job.records.len() < GROUP_ROWS * width {
                    let Some(target) = facts.next_target(merge) else { break };
                    let start = job.records.len();
                    if facts.take(merge, target, *most, &mut job.records)? {
                        job.targets.push((target, start..job.records.len()));
                    } else {
                        long = Some((target, job.records.split_off(start)));
                    }
                }
                Ok((!job.targets.is_empty()).then_some(job))
            };
            let take = |done: Done| -> Result<(), FileError> {
                tally.add(done.tally);
                outcome.totals.add(&done.totals);
                if unsteady.is_none() {
                    *unsteady = done.unsteady;
                }
                if tally.refused.is_some() || unsteady.is_some() {
                    failed.store(true, Ordering::Relaxed);
                } else if let Some(encoded) = done.encoded {
                    sheet.append(encoded?)?;
                }
                progress(Phase::Tracking, outcome.totals.packets, facts.records);
                Ok(())
            };
            ordered(
                rayon::current_num_threads(),
                Abreast::default,
                next,
                |abreast, job| worker.job(&job, facts, abreast),
                take,
            )?;
            match long.take() {
                None => return Ok(()),
                Some((target, records)) => self.long(facts, merge, (target, records), sheet)?,
            }
        }
    }

    /// A target whose first records are `records`, and of which there are more.
    fn long(
        &mut self,
        facts: &Facts<'_>,
        merge: &mut crate::store::Merge,
        (target, mut records): (TargetId, Vec<u64>),
        sheet: &mut Sheet<'_, '_>,
    ) -> Result<(), FileError> {
        let width = facts.shape.width.max(1);
        let is_whole = self.run.write.format == OutFormat::GeoJson
            || matches!(self.run.spec.link.receiver, Receiver::Stamped { late_s: Some(_) });
        let mut settler = Settler::new(facts, target);
        let mut whole = TargetPackets { target: facts.name(target), packets: Vec::new() };
        let mut pipeline = match is_whole {
            true => None,
            false => Some(Pipeline::new(self.run.spec, self.run.anchors, self.run.lagged).map_err(TrackError::Build)?),
        };
        let mut line = 0;
        let mut is_last = false;
        loop {
            let mut later = Vec::new();
            if !is_last {
                // The newest instant may have more records.
                let newest = &records[records.len() - width..];
                let rows = records.chunks_exact(width).rev();
                let open = rows.take_while(|r| facts.same_instant(r, newest, target)).count();
                later = records.split_off(records.len() - open * width);
            }
            let mut packets = facts.packets(&records);
            self.outcome.totals.packets += packets.len() as u64;
            settler.settle(&mut packets, facts, &mut self.tally);
            if self.tally.refused.is_some() || self.unsteady.is_some() {
                self.failed.store(true, Ordering::Relaxed);
            } else if let Some(pipeline) = &mut pipeline {
                let mut part = self.part(&whole.target);
                let pushed = push(pipeline, packets, self.run.spec, &mut part.trail, &mut line, is_last);
                if let Err(error) = pushed {
                    let target = whole.target.clone().unwrap_or_else(|| "-".to_owned());
                    self.unsteady = Some(TrackError::Step { target, line, error });
                }
                self.outcome.totals.add_rows(&part);
                for piece in Piece::cut(&part) {
                    sheet.append(self.encoder.encode(&[piece])?)?;
                }
            } else {
                whole.packets.append(&mut packets);
            }
            (self.progress)(Phase::Tracking, self.outcome.totals.packets, facts.records);
            if is_last {
                break;
            }
            records = later;
            is_last = facts.take(merge, target, self.long, &mut records)?;
        }
        if self.failed.load(Ordering::Relaxed) {
            return Ok(());
        }
        match pipeline {
            Some(pipeline) => {
                self.outcome.totals.targets += 1;
                self.outcome.totals.restarts += pipeline.restarts();
                self.outcome.totals.add_link(&pipeline.link().report());
            }
            None => {
                let trail = track(self.run.spec, self.run.anchors, &whole, self.run.lagged)?;
                self.outcome.totals.add_target(&trail);
                match self.run.write.format {
                    OutFormat::GeoJson => sheet.append(self.encoder.encode(&[Piece::whole(&trail)])?)?,
                    _ => Piece::cut(&trail).try_for_each(|piece| sheet.append(self.encoder.encode(&[piece])?))?,
                }
            }
        }
        Ok(())
    }

    /// A trail for a part of a target's fixes.
    fn part(&self, target: &Option<String>) -> TargetTrail {
        let trail = Trail::new(self.n, self.run.lagged == LaggedMode::Both);
        TargetTrail { target: target.clone(), trail, link: Default::default() }
    }
}

/// Pushes packets through a pipeline, and ends it after the last.
fn push(
    pipeline: &mut Pipeline,
    packets: Vec<Packet>,
    spec: &Spec,
    trail: &mut Trail,
    line: &mut u64,
    is_last: bool,
) -> Result<(), fixtrail_track::error::StepError> {
    for packet in packets.into_iter().filter(|p| spec.uses(p.content.kind())) {
        *line = packet.line;
        pipeline.push(packet, trail)?;
    }
    if is_last { pipeline.finish(trail) } else { Ok(()) }
}

#[cfg(test)]
mod tests;
