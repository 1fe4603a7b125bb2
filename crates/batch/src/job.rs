//! Targets tracked and their trails encoded, some at a time.

use crate::gather::Facts;
use crate::names::TargetId;
use crate::record;
use crate::settle::{Settler, Tally};
use crate::stream::FileRun;
use crate::totals::Totals;
use crate::write::{Encoded, Encoder, GROUP_ROWS, Piece, Sheaf, WriteError};
use fixtrail_track::chains::{Positions, Room, Series, side_by_side};
use fixtrail_track::error::StepError;
use fixtrail_track::pipeline::{TrackError, track};
use fixtrail_track::target::{TargetPackets, TargetTrail};
use fixtrail_track::trackers::LaggedMode;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};

/// Records of some targets.
#[derive(Default)]
pub(crate) struct Job {
    pub records: Vec<u64>,
    pub targets: Vec<(TargetId, Range<usize>)>,
}

/// What became of a job.
#[derive(Default)]
pub(crate) struct Done {
    pub totals: Totals,
    pub tally: Tally,
    pub encoded: Option<Result<Encoded, WriteError>>,
    pub unsteady: Option<TrackError>,
}

/// What runs jobs, the same for all of them.
#[derive(Clone, Copy)]
pub(crate) struct Worker<'a> {
    pub run: &'a FileRun<'a>,
    pub encoder: &'a Encoder<'a>,
    pub series: Option<&'a Series>,
    /// Nothing more is tracked; the rest of the table is still looked at.
    pub failed: &'a AtomicBool,
}

/// How targets of a run are tracked side by side, where that is possible.
pub(crate) fn series(run: &FileRun<'_>) -> Option<Series> {
    Series::of(run.spec).filter(|_| run.lagged != LaggedMode::Both)
}

/// Targets that are tracked side by side: what a thread keeps from one job to the next.
#[derive(Default)]
pub(crate) struct Abreast {
    /// Each with its place among the records of the job.
    targets: Vec<(TargetId, Range<usize>)>,
    t_s: Vec<f64>,
    positions: Vec<f64>,
    room: Room,
}

/// What becomes of a job while it is under way.
struct Doing<'a> {
    done: Done,
    sheaf: Result<Sheaf<'a>, WriteError>,
}

impl Doing<'_> {
    /// A trail, written while it is at hand.
    fn write(&mut self, trail: &TargetTrail) {
        self.done.totals.add_target(trail);
        if let Ok(open) = &mut self.sheaf
            && let Err(error) = open.add(&Piece::whole(trail))
        {
            self.sheaf = Err(error);
        }
    }

    fn take(&mut self, tracked: Result<TargetTrail, TrackError>) {
        match tracked {
            Ok(trail) => self.write(&trail),
            Err(error) => {
                self.done.unsteady.get_or_insert(error);
            }
        }
    }
}

impl Worker<'_> {
    pub fn job(&self, job: &Job, facts: &Facts<'_>, abreast: &mut Abreast) -> Done {
        let sheaf = Ok(Sheaf::of(self.encoder, job.records.len() / facts.shape.width));
        let mut doing = Doing { done: Done::default(), sheaf };
        let has_failed = || self.failed.load(Ordering::Relaxed);
        for (target, range) in &job.targets {
            let records = &job.records[range.clone()];
            doing.done.totals.packets += (records.len() / facts.shape.width) as u64;
            if self.series.is_some_and(|series| abreast.add(facts, series.axes(), (*target, range.clone()), records)) {
                if abreast.targets.len() == side_by_side() || abreast.t_s.len() >= GROUP_ROWS {
                    self.abreast(job, facts, abreast, &mut doing);
                }
                continue;
            }
            self.abreast(job, facts, abreast, &mut doing);
            let mut packets = facts.packets(records);
            let Done { tally, unsteady, .. } = &mut doing.done;
            Settler::new(facts, *target).settle(&mut packets, facts, tally);
            if packets.is_empty() || tally.refused.is_some() || unsteady.is_some() || has_failed() {
                continue;
            }
            let packets = TargetPackets { target: facts.name(*target), packets };
            doing.take(track(self.run.spec, self.run.anchors, &packets, self.run.lagged));
        }
        self.abreast(job, facts, abreast, &mut doing);
        let Doing { mut done, sheaf } = doing;
        if done.tally.refused.is_none() && done.unsteady.is_none() && !has_failed() {
            done.encoded = Some(sheaf.and_then(Sheaf::encoded));
        }
        done
    }

    /// Tracks the targets that wait for it.
    fn abreast(&self, job: &Job, facts: &Facts<'_>, abreast: &mut Abreast, doing: &mut Doing<'_>) {
        let Abreast { targets, t_s, positions, room } = abreast;
        let width = facts.shape.width;
        let (Some(series), Some(longest)) = (self.series, targets.iter().map(|(_, range)| range.len() / width).max())
        else {
            return;
        };
        let (axes, mut start) = (series.axes(), 0);
        let of_target = |(_, range): &(TargetId, Range<usize>)| {
            let from = start;
            start += range.len() / width;
            Positions { t_s: &t_s[from..start], positions: &positions[axes * from..axes * start] }
        };
        let all: Vec<Positions<'_>> = targets.iter().map(of_target).collect();
        let mut next = targets.iter();
        let mut take = |trail, end: Result<(), (usize, StepError)>| {
            let Some((target, range)) = next.next() else { return };
            let name = facts.name(*target);
            doing.take(match end {
                Ok(()) => Ok(TargetTrail { target: name, trail, link: Default::default() }),
                Err((row, error)) => Err(TrackError::Step {
                    target: name.unwrap_or_else(|| "-".to_owned()),
                    line: record::line(&job.records[range.start + row * width..]),
                    error,
                }),
            });
        };
        // All are taken to be as long as the longest.
        if longest * targets.len() <= 2 * t_s.len() {
            series.track(&all, room, &mut take);
        } else {
            all.chunks(1).for_each(|one| series.track(one, room, &mut take));
        }
        targets.clear();
        t_s.clear();
        positions.clear();
    }
}

impl Abreast {
    /// Adds a target if every record is an instant of its own with all coordinates; whether it was so.
    fn add(
        &mut self,
        facts: &Facts<'_>,
        axes: usize,
        (target, range): (TargetId, Range<usize>),
        records: &[u64],
    ) -> bool {
        let shape = &facts.shape;
        let is_local = facts.origin.is_none() && facts.clock.epoch_unix_s.is_none();
        if !(is_local && shape.is_plain() && shape.kind().is_some() && shape.n_values() >= axes) {
            return false;
        }
        let (rows, instants) = (records.len() / shape.width, self.t_s.len());
        self.t_s.reserve(rows);
        self.positions.reserve(rows * axes);
        let mut before = f64::NEG_INFINITY;
        for r in records.chunks_exact(shape.width) {
            let now = f64::from_bits(r[1]);
            let values = &r[2..2 + axes];
            // Two records of an instant are a copy or a contradiction.
            if !(now > before) || values.contains(&record::ABSENT) {
                self.t_s.truncate(instants);
                self.positions.truncate(instants * axes);
                return false;
            }
            before = now;
            self.t_s.push(now);
            self.positions.extend(values.iter().map(|bits| f64::from_bits(*bits)));
        }
        self.targets.push((target, range));
        true
    }
}
