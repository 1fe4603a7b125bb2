//! Truth, channels and metrics.
//!
//! [`channels`] lose, delay and repeat packets, [`scenario`] invents a walk and what a network lets through of it, [`metrics`] judges trails.
//! Randomness is an argument; equal seeds give equal bytes.

pub mod channels;
pub mod metrics;
pub mod scenario;
