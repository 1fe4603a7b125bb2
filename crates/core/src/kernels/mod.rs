//! Kalman filters of chains of integrators, as fast as the machine allows.
//!
//! What [`estimators::kalman`](crate::estimators::kalman) does for any model, here for one axis of a random walk, constant velocity or
//! constant acceleration whose position is measured. The transition is upper triangular with known entries, the covariance is symmetric and
//! only its upper triangle is kept: it cannot lose its symmetry. Written once over a [`Real`]: one number, or one of each of several tracks
//! side by side, so that a track's estimates do not depend on how many others it is run with.
//!
//! Nothing is contracted to fused multiply-adds: results are the same on every processor.

mod axes;
mod chain;
mod real;
mod smoother;
mod steady;

pub use axes::Axes;
pub use chain::{Chain, Leap};
pub use real::Real;
pub use smoother::{Past, smooth, smooth_with};
pub use steady::{LONGEST_CYCLE, series};
