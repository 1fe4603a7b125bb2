//! The one interface of every estimator once its dimensions are erased.

use crate::error::StepError;
use crate::fix::Sink;
use crate::layout::Layout;
use crate::packet::{Content, Packet};

/// Everything the filter may believe about one instant: its packets in canonical order, none when all were lost.
#[derive(Clone, Copy, Debug)]
pub struct Step<'a> {
    /// Index of the instant within the target, from 0, one more than the step before.
    pub k: u64,
    /// The instant in seconds; absent for a lost row of an untimed gap.
    pub t_s: Option<f64>,
    /// What arrived and was sensed at this instant, as far as the link knows.
    pub packets: &'a [Packet],
    /// Everything the receiver shows at this instant, new or old: of a link that knows when packets were sensed the same as `packets`.
    pub held: &'a [Packet],
    /// Probability that what is held was sensed at this instant.
    pub arrival: f64,
}

impl<'a> Step<'a> {
    /// A step of a link that knows when its packets were sensed.
    pub fn new(k: u64, t_s: Option<f64>, packets: &'a [Packet]) -> Step<'a> {
        Step { k, t_s, packets, held: packets, arrival: 1.0 }
    }

    /// Whether nothing arrived: no packet, or only packets whose components were all lost.
    pub fn lost(&self) -> bool {
        self.packets.iter().all(|p| match &p.content {
            Content::Linear { z, .. } => z.iter().all(Option::is_none),
            _ => false,
        })
    }
}

/// One target's estimator.
///
/// Every implementation guarantees: on `Err` its state is unchanged; fixes come in order of the instant they
/// describe; equal steps give equal bytes.
pub trait Tracker: Send {
    /// Names and order of the state.
    fn layout(&self) -> &Layout;

    /// A copy that goes its own way.
    fn boxed_clone(&self) -> Box<dyn Tracker>;

    /// How often a lost track was given up and started anew; 0 of estimators that never do.
    fn restarts(&self) -> u64 {
        0
    }

    /// Takes one instant and hands on the fixes that it settles.
    ///
    /// # Errors
    /// [`StepError`] when the step cannot be taken; nothing has changed then.
    fn step(&mut self, step: &Step<'_>, sink: &mut dyn Sink) -> Result<(), StepError>;

    /// Hands on what is still owed after the last instant.
    ///
    /// # Errors
    /// [`StepError`] when a smoother cannot finish.
    fn finish(&mut self, sink: &mut dyn Sink) -> Result<(), StepError>;
}
