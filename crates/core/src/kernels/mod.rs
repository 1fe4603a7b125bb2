//! Kalman filters as fast as the machine allows.
//!
//! What [`estimators::kalman`](crate::estimators::kalman) does for any model, here with only the upper triangle of the covariance, which cannot lose
//! its symmetry, and with what is known of a model's entries:
//!
//! | | motion | measured |
//! |---|---|---|
//! | [`Chain`], [`Axes`], [`series()`], [`smooth()`], [`FixedLag`] | random walk, constant velocity, constant acceleration: [`Leap`] | the position |
//! | [`Packed`] | any linear motion: [`Dense`]; a coordinated turn: [`Turn`] | any row; a distance |
//! | [`Sliding`] | none: a finite-memory gain that was designed before | one number |
//!
//! Written once over a [`Real`]: one number, or one of each of several tracks side by side, so that a track's estimates do not depend on how
//! many others it is run with. Nothing is contracted to fused multiply-adds: results are the same on every processor.

mod arc;
mod axes;
mod chain;
mod dense;
mod fixed_lag;
mod packed;
mod range;
mod real;
mod sliding;
mod smoother;
mod steady;
mod turn;

pub use arc::Arc;
pub use axes::Axes;
pub use chain::{Chain, Leap};
pub use dense::Dense;
pub use fixed_lag::FixedLag;
pub use packed::{Motion, Packed};
pub use real::Real;
pub use sliding::Sliding;
pub use smoother::{Past, smooth, smooth_with};
pub use steady::{LONGEST_CYCLE, series};
pub use turn::Turn;
