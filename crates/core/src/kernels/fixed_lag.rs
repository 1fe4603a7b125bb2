//! The fixed-lag smoother of a chain: modified Bryson–Frazier \[BIE73\] over the last `L` steps.
//!
//! The estimate of x_{k−L} given z_0 … z_k is that of the fixed-interval smoother of a series that ends at k: λ and Λ start at 0 behind z_k
//! and go back over `L` measurements and intervals, as [`smooth`](super::smooth()) says. Nothing is inverted, and nothing of the way back is kept.

use super::chain::Drift;
use super::smoother::{Adjoint, Taken};
use super::{Chain, Leap};

/// A filter that remembers `L` steps, and the smoothed state `L` steps before the newest.
#[derive(Clone, Copy, Debug)]
pub struct FixedLag<const N: usize, const L: usize> {
    /// At the newest step.
    belief: Chain<f64, N>,
    /// Before the oldest step that is remembered.
    lagged: Chain<f64, N>,
    /// The last `L` steps in a ring.
    steps: [Step<N>; L],
    /// Where the oldest step is, and the next will be.
    head: usize,
    /// How many steps there are.
    len: usize,
}

/// A step that is remembered.
#[derive(Clone, Copy, Debug)]
struct Step<const N: usize> {
    /// The motion that led to it.
    drift: Drift<f64, N>,
    /// The mean after it.
    mean: [f64; N],
    taken: Taken<N>,
    /// Innovation over its variance.
    pull: f64,
}

impl<const N: usize, const L: usize> FixedLag<N, L> {
    /// Starts before the first interval.
    pub fn new(start: &Chain<f64, N>) -> Self {
        const { assert!(L > 0, "a lag of no steps is the filter") };
        let empty = Step { drift: Leap::new(0.0, 0.0).drift, mean: [0.0; N], taken: Taken::EMPTY, pull: 0.0 };
        FixedLag { belief: *start, lagged: *start, steps: [empty; L], head: 0, len: 0 }
    }

    /// Takes one step: an interval of motion, then a measurement `z` of the position with variance `var` (NaN: lost).
    #[inline(always)]
    pub fn push(&mut self, leap: &Leap<f64, N>, var: f64, z: f64) {
        let prior = self.belief.predict(leap);
        let (taken, mean) = Taken::of(&prior, var, z);
        let step = &mut self.steps[self.head];
        if self.len == L {
            self.lagged = Chain { mean: step.mean, cov: step.taken.cov };
        } else {
            self.len += 1;
        }
        self.belief = Chain { mean, cov: taken.cov };
        *step = Step { drift: leap.drift, mean, taken, pull: taken.pull(prior.mean[0], z) };
        self.head = if self.head + 1 == L { 0 } else { self.head + 1 };
    }

    /// The belief at the newest step.
    pub fn filtered(&self) -> &Chain<f64, N> {
        &self.belief
    }

    /// Returns the smoothed mean `L` steps before the newest, the start's where it is that old; `None` where it is younger.
    #[inline(always)]
    pub fn mean(&self) -> Option<[f64; N]> {
        if self.len < L {
            return None;
        }
        let mut lambda = [0.0; N];
        for step in self.newest_first() {
            lambda = step.drift.back(&step.taken.before_mean(&lambda, step.pull));
        }
        Some(Adjoint { lambda, big: [[0.0; N]; N] }.mean(&self.lagged))
    }

    /// Returns the covariance of [`FixedLag::mean`], upper triangle.
    #[inline(always)]
    pub fn cov(&self) -> Option<[[f64; N]; N]> {
        if self.len < L {
            return None;
        }
        let mut adjoint = Adjoint::NONE;
        for step in self.newest_first() {
            adjoint = adjoint.over(&step.taken, step.pull).earlier(&step.drift);
        }
        Some(adjoint.correct(&self.lagged).1)
    }

    #[inline(always)]
    fn newest_first(&self) -> impl Iterator<Item = &Step<N>> {
        let (newer, older) = self.steps.split_at(self.head);
        newer.iter().rev().chain(older.iter().rev())
    }
}
