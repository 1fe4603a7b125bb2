//! A tracker whose state holds more than is shown: errors of sensors stand behind what describes the target.

use crate::error::StepError;
use crate::fix::{Estimate, Fix, Lagged, Sink};
use crate::layout::Layout;
use crate::tracker::{Step, Tracker};

/// Hands on the first components of another tracker's estimates. Of a Gaussian that is the marginal: their own means and covariances.
pub struct Marginal {
    tracker: Box<dyn Tracker>,
    layout: Layout,
    /// Components of the other's state.
    n: usize,
    cov: Vec<f64>,
    lagged_cov: Vec<f64>,
}

impl Marginal {
    /// The components in `layout` of `tracker`, whose state has `n`.
    pub fn new(tracker: Box<dyn Tracker>, layout: Layout, n: usize) -> Self {
        Self { tracker, layout, n, cov: Vec::new(), lagged_cov: Vec::new() }
    }
}

struct Front<'a> {
    sink: &'a mut dyn Sink,
    shown: usize,
    n: usize,
    cov: &'a mut Vec<f64>,
    lagged_cov: &'a mut Vec<f64>,
}

impl Sink for Front<'_> {
    fn fix(&mut self, fix: &Fix<'_>) {
        let (shown, n) = (self.shown, self.n);
        let estimate = fix.estimate.map(|e| front(&e, shown, n, self.cov));
        let lagged = fix
            .lagged
            .map(|lagged| Lagged { estimate: lagged.estimate.map(|e| front(&e, shown, n, self.lagged_cov)), ..lagged });
        self.sink.fix(&Fix { estimate, lagged, ..*fix });
    }
}

fn front<'a>(estimate: &Estimate<'a>, shown: usize, n: usize, room: &'a mut Vec<f64>) -> Estimate<'a> {
    room.clear();
    room.extend(estimate.cov.chunks_exact(n).take(shown).flat_map(|row| &row[..shown]));
    Estimate { mean: &estimate.mean[..shown], cov: room }
}

impl Tracker for Marginal {
    fn layout(&self) -> &Layout {
        &self.layout
    }

    fn restarts(&self) -> u64 {
        self.tracker.restarts()
    }

    fn boxed_clone(&self) -> Box<dyn Tracker> {
        Box::new(Marginal::new(self.tracker.boxed_clone(), self.layout.clone(), self.n))
    }

    fn step(&mut self, step: &Step<'_>, sink: &mut dyn Sink) -> Result<(), StepError> {
        let Self { tracker, layout, n, cov, lagged_cov } = self;
        tracker.step(step, &mut Front { sink, shown: layout.n(), n: *n, cov, lagged_cov })
    }

    fn finish(&mut self, sink: &mut dyn Sink) -> Result<(), StepError> {
        let Self { tracker, layout, n, cov, lagged_cov } = self;
        tracker.finish(&mut Front { sink, shown: layout.n(), n: *n, cov, lagged_cov })
    }
}
