//! The whole system in one function: a packet goes through the link to the tracker, and fixes come out.

use crate::anchors::Anchors;
use crate::error::{BuildError, StepError};
use crate::fix::Sink;
use crate::link::Link;
use crate::packet::Packet;
use crate::registry::{self, BuildOptions};
use crate::spec::Spec;
use crate::target::{TargetPackets, TargetTrail};
use crate::tracker::Tracker;
use crate::trackers::LaggedMode;
use crate::trail::Trail;

/// One target's way from packets to fixes.
pub struct Pipeline {
    link: Link,
    tracker: Box<dyn Tracker>,
}

impl Pipeline {
    /// A pipeline before its first packet.
    pub fn new(tracker: Box<dyn Tracker>) -> Self {
        Self { link: Link::default(), tracker }
    }

    /// Takes one packet; the fixes that it settles go to `sink`.
    ///
    /// # Errors
    /// [`StepError`] when a step cannot be taken.
    pub fn push(&mut self, packet: Packet, sink: &mut dyn Sink) -> Result<(), StepError> {
        let Self { link, tracker } = self;
        link.push(packet, |step| tracker.step(step, sink))
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

/// Tracks one target from its sorted packets.
///
/// # Errors
/// [`TrackError`] when the spec does not make an estimator or a step cannot be taken.
pub fn track(
    spec: &Spec,
    anchors: &Anchors,
    packets: &TargetPackets,
    lagged: LaggedMode,
) -> Result<TargetTrail, TrackError> {
    let mut pipeline = Pipeline::new(registry::build(spec, anchors, &BuildOptions { lagged })?);
    let mut trail = Trail::new(registry::layout(spec).n(), lagged == LaggedMode::Both);
    let named = |line: u64| {
        move |error: StepError| TrackError::Step {
            target: packets.target.clone().unwrap_or_else(|| "-".to_owned()),
            line,
            error,
        }
    };
    let mut line = 0;
    for packet in packets.packets.iter().filter(|p| spec.uses(p.content.kind())) {
        line = packet.line;
        pipeline.push(packet.clone(), &mut trail).map_err(named(line))?;
    }
    pipeline.finish(&mut trail).map_err(named(line))?;
    Ok(TargetTrail { target: packets.target.clone(), trail })
}
