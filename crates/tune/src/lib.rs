//! The numbers of a spec from recordings: calibration of the sensors, search for what describes noise and motion, and the tuned spec as
//! commented text.
//!
//! With truth the merit of a spec is half the mean logarithm of the density that the causal trail claims for the true positions, so that the
//! claimed covariance counts, and half the plain error; without truth it is the density of the next measurements
//! ([`predictive`](fixtrail_track::predictive)). Both densities forgive a moment of confusion.

mod arrival;
mod calibrate;
mod knobs;
mod merit;
mod search;
mod structure;
mod tune;
mod window;
mod write;

pub use merit::{Merit, Recording};
pub use structure::Change;
pub use tune::{Options, Tried, TuneError, Tuned, tune};
pub use window::Windows;
pub use write::write;
