//! The values that models, sensors and estimators exchange.

use nalgebra::{SMatrix, SVector};

/// A column of `N` numbers.
pub type Vector<const N: usize> = SVector<f64, N>;
/// An `R × C` matrix.
pub type Matrix<const R: usize, const C: usize> = SMatrix<f64, R, C>;

/// Mean and covariance of a state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Belief<const N: usize> {
    /// Mean.
    pub mean: Vector<N>,
    /// Covariance, symmetric and positive semidefinite.
    pub cov: Matrix<N, N>,
}

/// One interval of motion, linearised about a state `x`: `f(x + δ) ≈ next + f δ`, plus noise of covariance `q`.
///
/// For a linear model at `x = 0`, `next` is the known input `B u`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transition<const N: usize> {
    /// `f(x)`.
    pub next: Vector<N>,
    /// Jacobian of f at x.
    pub f: Matrix<N, N>,
    /// Covariance `G Q Gᵀ` added over the interval.
    pub q: Matrix<N, N>,
}

/// One scalar measurement linearised about a state `x`: `z − h(x) = residual = hᵀδ + v`, `var v = var`.
///
/// Correlated components become rows of unit variance by [`whiten`](crate::linalg::whiten). A lost measurement is an absent row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row<const N: usize> {
    /// Gradient of the measurement.
    pub h: Vector<N>,
    /// Measured less expected at the linearisation point.
    pub residual: f64,
    /// Noise variance, positive.
    pub var: f64,
}

/// Why a step cannot be taken. The estimator's state is unchanged.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum StepError {
    /// An innovation variance is not a positive finite number.
    #[error("the innovation variance is {var}, expected a positive finite number")]
    InnovationVariance {
        /// The offending variance.
        var: f64,
    },
    /// The state or its covariance left the range of numbers.
    #[error("the estimate is no longer finite (state component {component})")]
    NotFinite {
        /// Index of the first offending component.
        component: usize,
    },
    /// An interval that is not positive.
    #[error("the interval is {dt}, expected a positive finite number")]
    Interval {
        /// The offending interval.
        dt: f64,
    },
    /// A process noise variance that is negative or not a number.
    #[error("the variance of the process noise is {var}, expected a finite number of at least 0")]
    ProcessNoise {
        /// The offending variance.
        var: f64,
    },
    /// A measurement that is not a number.
    #[error("the measurement is {value}, expected a finite number")]
    Measurement {
        /// The offending value.
        value: f64,
    },
    /// A measurement noise variance that is not positive.
    #[error("the variance of the measurement is {var}, expected a positive finite number")]
    MeasurementVariance {
        /// The offending variance.
        var: f64,
    },
    /// The unconditional second moment of the state left the range of numbers while the gain depends on it.
    #[error(
        "the second moment of the state is no longer finite; while values may be old the gain depends on it: no linear filter follows an \
         unstable system whose arrivals it does not know"
    )]
    SecondMoment,
    /// A transition cannot be run backwards.
    #[error(
        "the transition of the step before is singular, and the filter needs its inverse for a value two steps old"
    )]
    SingularTransition,
    /// A window is longer than the storage lent for it.
    #[error("the window holds {capacity} entries, {needed} are needed")]
    WindowFull {
        /// Entries that fit.
        capacity: usize,
        /// Entries needed.
        needed: usize,
    },
}
