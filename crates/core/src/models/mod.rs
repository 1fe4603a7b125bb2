//! Motion models: each turns a state and an interval into a [`Transition`](crate::Transition).
//!
//! Kinematic models are stated in continuous time and discretised exactly for the interval at hand, so irregular
//! sampling needs nothing special; `leap(x, a)` followed by `leap(x, b)` is `leap(x, a + b)` for the linear ones.

mod coordinated_turn;
mod drift;
mod fms_paper;
mod gauss_markov;
mod integrators;
mod linear;
mod switching;

pub use coordinated_turn::{CoordinatedTurn, TurnNoise};
pub use drift::Drift;
pub use fms_paper::FmsPaper;
pub use gauss_markov::GaussMarkov;
pub use integrators::Integrators;
pub use linear::Linear;
pub use switching::{MOST_MODES, Switching};

/// Why a model cannot be built.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum DesignError {
    /// The number of modelled derivatives is not 1, 2 or 3.
    #[error("the order of the chain of integrators is {order}, expected 1, 2 or 3")]
    Order {
        /// The offending order.
        order: usize,
    },
    /// The number of axes is not 1, 2 or 3.
    #[error("the number of axes is {axes}, expected 1, 2 or 3")]
    Axes {
        /// The offending number.
        axes: usize,
    },
    /// The state does not hold `order` derivatives of `axes` axes.
    #[error("the state has {found} components, expected at least {expected}")]
    StateSize {
        /// Components of the state.
        found: usize,
        /// `order · axes`.
        expected: usize,
    },
    /// A stationary law without a place or without a positive spread.
    #[error("axis {axis} has a centre that is not finite, or a standard deviation of 0")]
    Stationary {
        /// Which axis, from 0.
        axis: usize,
    },
    /// A noise density is negative, infinite or not a number.
    #[error("noise density {index} is {psd}, expected a finite number of at least 0")]
    NoiseDensity {
        /// Which density, from 0.
        index: usize,
        /// The offending density.
        psd: f64,
    },
    /// The number of modes of motion is not between 1 and [`MOST_MODES`].
    #[error("there are {count} modes of motion, expected 1 to {MOST_MODES}")]
    Modes {
        /// The offending number.
        count: usize,
    },
    /// A mode of motion cannot last that long.
    #[error("mode {mode} lasts {mean_s} s on average, expected a finite number from 1e-9")]
    Duration {
        /// Which mode, from 0.
        mode: usize,
        /// The offending mean.
        mean_s: f64,
    },
}

/// Rejects the first density that is negative or not finite.
fn check_densities(psd: &[f64]) -> Result<(), DesignError> {
    match psd.iter().position(|q| !(q.is_finite() && *q >= 0.0)) {
        Some(index) => Err(DesignError::NoiseDensity { index, psd: psd[index] }),
        None => Ok(()),
    }
}
