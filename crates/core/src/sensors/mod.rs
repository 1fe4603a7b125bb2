//! Sensors: each turns a measured value and a state into a [`Row`](crate::Row), value and gradient from one call.
//!
//! `var` is the variance of the value's noise, positive; it is passed on as it is.

mod bearing;
mod linear;
mod position;
mod range;
mod rssi;
mod tdoa;

pub use bearing::bearing;
pub use linear::linear;
pub use position::position;
pub use range::range;
pub use rssi::{PathLoss, rssi};
pub use tdoa::{Pair, tdoa};
