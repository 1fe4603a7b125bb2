//! The maths of Fixtrail: motion models, sensors and estimators for targets seen through a lossy network.
//!
//! `no_std`, no heap, `f64`; the smallest filters in `f32` and fixed point too. Nothing here knows of files, clocks,
//! networks or logs: time is an argument, storage is lent by the caller, and a lost packet is an empty slice of rows.
#![no_std]

pub mod arrival;
pub mod cramer_rao;
pub mod estimators;
pub mod graph;
pub mod kernels;
pub mod linalg;
pub mod models;
pub mod position;
pub mod riccati;
pub mod scalar;
pub mod schedule;
pub mod sensors;
pub mod storage;
mod types;

pub use types::{Belief, Matrix, Row, StepError, Transition, Vector};
