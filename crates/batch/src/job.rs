//! Targets tracked and their trails encoded, some at a time.

use crate::gather::Facts;
use crate::names::TargetId;
use crate::record;
use crate::settle::{Settler, Tally};
use crate::stream::FileRun;
use crate::totals::Totals;
use crate::write::{Encoded, Encoder, Piece, Sheaf, WriteError};
use fixtrail_track::chains::Series;
use fixtrail_track::pipeline::{TrackError, track};
use fixtrail_track::target::{TargetPackets, TargetTrail};
use fixtrail_track::trackers::LaggedMode;
use fixtrail_track::trail::Trail;
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
    /// Components of the state.
    pub n: usize,
    pub encoder: &'a Encoder<'a>,
    pub series: Option<&'a Series>,
    /// Nothing more is tracked; the rest of the table is still looked at.
    pub failed: &'a AtomicBool,
}

impl Worker<'_> {
    pub fn job(&self, job: &Job, facts: &Facts<'_>) -> Done {
        let mut done = Done::default();
        let mut sheaf = Ok(Sheaf::of(self.encoder, job.records.len() / facts.shape.width));
        // One trail after the other, each written while it is at hand.
        let mut write = |trail: &TargetTrail, totals: &mut Totals| {
            totals.add_target(trail);
            if let Ok(open) = &mut sheaf
                && let Err(error) = open.add(&Piece::whole(trail))
            {
                sheaf = Err(error);
            }
        };
        for (target, range) in &job.targets {
            let records = &job.records[range.clone()];
            done.totals.packets += (records.len() / facts.shape.width) as u64;
            let has_failed = || self.failed.load(Ordering::Relaxed);
            match self.at_once(facts, *target, records) {
                Some(Ok(trail)) => write(&trail, &mut done.totals),
                Some(Err(error)) => {
                    done.unsteady.get_or_insert(error);
                }
                None => {
                    let mut packets = facts.packets(records);
                    Settler::new(facts, *target).settle(&mut packets, facts, &mut done.tally);
                    if packets.is_empty() || done.tally.refused.is_some() || done.unsteady.is_some() || has_failed() {
                        continue;
                    }
                    let packets = TargetPackets { target: facts.name(*target), packets };
                    match track(self.run.spec, self.run.anchors, &packets, self.run.lagged) {
                        Ok(trail) => write(&trail, &mut done.totals),
                        Err(error) => {
                            done.unsteady.get_or_insert(error);
                        }
                    }
                }
            }
        }
        if done.tally.refused.is_none() && done.unsteady.is_none() && !self.failed.load(Ordering::Relaxed) {
            done.encoded = Some(sheaf.and_then(Sheaf::encoded));
        }
        done
    }

    /// The trail of a target by [`Series`], where that is possible: every record an instant of its own with all coordinates.
    fn at_once(&self, facts: &Facts<'_>, target: TargetId, records: &[u64]) -> Option<Result<TargetTrail, TrackError>> {
        let (series, shape) = (self.series?, &facts.shape);
        let is_local = facts.origin.is_none() && facts.clock.epoch_unix_s.is_none();
        if !(is_local && shape.is_plain() && shape.kind().is_some() && shape.n_values() >= series.axes()) {
            return None;
        }
        let rows = records.len() / shape.width;
        let (mut t_s, mut positions) = (Vec::with_capacity(rows), Vec::with_capacity(rows * series.axes()));
        let mut before = f64::NEG_INFINITY;
        for r in records.chunks_exact(shape.width) {
            let now = f64::from_bits(r[1]);
            let values = &r[2..2 + series.axes()];
            // Two records of an instant are a copy or a contradiction.
            if !(now > before) || values.contains(&record::ABSENT) {
                return None;
            }
            before = now;
            t_s.push(now);
            positions.extend(values.iter().map(|bits| f64::from_bits(*bits)));
        }
        let name = facts.name(target);
        let mut trail = Trail::new(self.n, self.run.lagged == LaggedMode::Both);
        Some(match series.track(&t_s, &positions, &mut trail) {
            Ok(()) => Ok(TargetTrail { target: name, trail, link: Default::default() }),
            Err((row, error)) => Err(TrackError::Step {
                target: name.unwrap_or_else(|| "-".to_owned()),
                line: record::line(&records[row * shape.width..]),
                error,
            }),
        })
    }
}
