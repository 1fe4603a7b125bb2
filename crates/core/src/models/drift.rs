//! Sensor errors that change slowly, as part of the state.

use crate::types::{Transition, Vector};

/// First-order Gauss–Markov components: each has standard deviation `sd` for ever and forgets in `time_s` seconds, `ḃ = −b/τ + w`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drift {
    /// First component of the state that drifts so.
    pub first: usize,
    /// How many do.
    pub count: usize,
    /// Standard deviation of each, in the sensor's unit.
    pub sd: f64,
    /// Time constant τ in seconds.
    pub time_s: f64,
}

impl Drift {
    /// Makes the components of `leap`, a motion over `dt_s` seconds from `x` that leaves them as they are, drift: with `ρ = exp(−dt/τ)`,
    /// `b⁺ = ρ b` and the variance `sd² (1 − ρ²)` on top.
    ///
    /// # Panics
    /// When the state has fewer components.
    pub fn apply<const N: usize>(&self, x: &Vector<N>, dt_s: f64, leap: &mut Transition<N>) {
        let kept = libm::exp(-dt_s / self.time_s);
        // 1 − ρ² without cancellation.
        let var = -self.sd * self.sd * libm::expm1(-2.0 * dt_s / self.time_s);
        for i in self.first..self.first + self.count {
            leap.next[i] = kept * x[i];
            leap.f[(i, i)] = kept;
            leap.q[(i, i)] = var;
        }
    }
}
