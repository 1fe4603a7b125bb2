//! Sensors: each turns a measured value and a state into a [`Row`](crate::Row), value and gradient from one call.
//!
//! `var` is the variance of the value's noise, positive; it is passed on as it is.

mod linear;
mod position;
mod range;

pub use linear::linear;
pub use position::position;
pub use range::range;
