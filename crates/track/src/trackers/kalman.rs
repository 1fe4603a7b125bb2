//! `kalman`, `ekf` and `imm`: x̂_{k|k} at every instant.

use crate::error::StepError;
use crate::filter::Filter;
use crate::fix::Sink;
use crate::layout::Layout;
use crate::model::Model;
use crate::recursion::{Recursion, Single};
use crate::tracker::{Step, Tracker};
use crate::trackers::{Meta, emit};

/// The filter alone.
#[derive(Clone)]
pub struct Kalman<const N: usize, R: Recursion<N> = Single> {
    filter: Filter<N, R>,
}

impl<const N: usize, R: Recursion<N>> Kalman<N, R> {
    /// A tracker before its first instant.
    pub fn new(model: Model<N>, recursion: R) -> Self {
        Self { filter: Filter::new(model, recursion) }
    }
}

impl<const N: usize, R: Recursion<N> + 'static> Tracker for Kalman<N, R> {
    fn layout(&self) -> &Layout {
        &self.filter.model.layout
    }

    fn restarts(&self) -> u64 {
        self.filter.restarts()
    }

    fn boxed_clone(&self) -> Box<dyn Tracker> {
        Box::new(self.clone())
    }

    fn step(&mut self, step: &Step<'_>, sink: &mut dyn Sink) -> Result<(), StepError> {
        let outcome = self.filter.step(step, None)?;
        emit(sink, &Meta::of(step, &outcome), outcome.belief.as_ref(), None);
        Ok(())
    }

    fn finish(&mut self, _sink: &mut dyn Sink) -> Result<(), StepError> {
        Ok(())
    }
}
