//! The whole system in one function: a packet goes through the link to the tracker, and fixes come out.

use crate::anchors::Anchors;
use crate::error::{BuildError, StepError};
use crate::fix::Sink;
use crate::link::Link;
use crate::packet::Packet;
use crate::registry::{self, BuildOptions};
use crate::spec::{Receiver, Spec};
use crate::target::{TargetPackets, TargetTrail};
use crate::tracker::{Step, Tracker};
use crate::trackers::LaggedMode;
use crate::trail::Trail;

/// One target's way from packets to fixes.
pub struct Pipeline {
    link: Link,
    tracker: Box<dyn Tracker>,
}

impl Pipeline {
    /// The pipeline of one target before its first packet.
    ///
    /// # Errors
    /// [`BuildError`] when the spec does not make an estimator.
    pub fn new(spec: &Spec, anchors: &Anchors, lagged: LaggedMode) -> Result<Self, BuildError> {
        let tracker = registry::build(spec, anchors, &BuildOptions { lagged })?;
        Ok(Self { link: Link::new(&spec.link, spec.model.prior().is_some()), tracker })
    }

    /// Takes one packet; the fixes that it settles go to `sink`.
    ///
    /// # Errors
    /// [`StepError`] when a step cannot be taken.
    pub fn push(&mut self, packet: Packet, sink: &mut dyn Sink) -> Result<(), StepError> {
        let Self { link, tracker } = self;
        link.push(packet, |step| tracker.step(step, sink))
    }

    /// Hands on what a listener would be told now: the fixes of all instants that late packets may still change, and of what follows them
    /// up to `until` though nothing of it arrived. The run itself goes on unchanged.
    ///
    /// # Errors
    /// [`StepError`] when a step cannot be taken.
    pub fn now(&self, until: Until, sink: &mut dyn Sink) -> Result<(), StepError> {
        let (mut reader, mut tracker) = (self.link.reader().clone(), self.tracker.boxed_clone());
        let mut newest_s = f64::NEG_INFINITY;
        for slot in self.link.waiting() {
            newest_s = slot.t_s;
            reader.read(slot, |step| tracker.step(step, sink))?;
        }
        match until {
            Until::Newest => Ok(()),
            Until::Row(k) => reader.skip_to(k + 1, |step| tracker.step(step, sink)),
            Until::Time(t_s) if t_s > newest_s => tracker.step(&Step::new(reader.next_k(), Some(t_s), &[]), sink),
            Until::Time(_) => Ok(()),
        }
    }

    /// How often a lost track was given up and started anew.
    pub fn restarts(&self) -> u64 {
        self.tracker.restarts()
    }

    /// The link, for what it has counted and what waits in it.
    pub fn link(&self) -> &Link {
        &self.link
    }

    /// Ends the run: what waits in the link and what the tracker owes goes to `sink`.
    ///
    /// # Errors
    /// [`StepError`] when a step cannot be taken.
    pub fn finish(&mut self, sink: &mut dyn Sink) -> Result<(), StepError> {
        let Self { link, tracker } = self;
        link.flush(|step| tracker.step(step, sink))?;
        tracker.finish(sink)
    }
}

/// How far [`Pipeline::now`] looks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Until {
    /// To the newest instant of which something arrived.
    Newest,
    /// To a row of a linear run.
    Row(u64),
    /// To a time, seconds.
    Time(f64),
}

/// Why a target could not be tracked.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TrackError {
    /// The spec does not make an estimator.
    #[error(transparent)]
    Build(#[from] BuildError),
    /// A step could not be taken.
    #[error("target `{target}`, row {line}: {error}")]
    Step {
        /// The target's id, `-` when the table has none.
        target: String,
        /// The row that completed the step.
        line: u64,
        /// What went wrong.
        error: StepError,
    },
}

/// Tracks one target from its packets, sorted by time. A spec with `late_s` takes them in the order in which they came.
///
/// # Errors
/// [`TrackError`] when the spec does not make an estimator or a step cannot be taken.
pub fn track(
    spec: &Spec,
    anchors: &Anchors,
    packets: &TargetPackets,
    lagged: LaggedMode,
) -> Result<TargetTrail, TrackError> {
    let mut pipeline = Pipeline::new(spec, anchors, lagged)?;
    let mut trail = Trail::new(registry::layout(spec).n(), lagged == LaggedMode::Both);
    let named = |line: u64| {
        move |error: StepError| TrackError::Step {
            target: packets.target.clone().unwrap_or_else(|| "-".to_owned()),
            line,
            error,
        }
    };
    let mut line = 0;
    for packet in arriving(spec, packets) {
        line = packet.line;
        pipeline.push(packet.clone(), &mut trail).map_err(named(line))?;
    }
    pipeline.finish(&mut trail).map_err(named(line))?;
    trail.restarts = pipeline.restarts();
    Ok(TargetTrail { target: packets.target.clone(), trail, link: pipeline.link.report() })
}

/// The packets that a spec has sensors for, in the order in which its link takes them.
pub(crate) fn arriving<'a>(spec: &Spec, packets: &'a TargetPackets) -> Vec<&'a Packet> {
    let mut arriving: Vec<&Packet> = packets.packets.iter().filter(|p| spec.uses(p.content.kind())).collect();
    if let Receiver::Stamped { late_s: Some(_) } = spec.link.receiver {
        // When a packet came: by its reception time where the table has them, else by its row.
        let timed = arriving.iter().any(|p| p.received_s.is_some());
        let came = |p: &Packet| if timed { p.received_s.unwrap_or(p.t_s) } else { 0.0 };
        arriving.sort_by(|a, b| came(a).total_cmp(&came(b)).then(a.line.cmp(&b.line)));
    }
    arriving
}
