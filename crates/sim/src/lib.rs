//! Truth, channels and metrics.
//!
//! [`channels`] lose, delay and repeat packets, [`motions`] move targets otherwise than a model says, [`scenario`] invents a walk and what a
//! network lets through of it, [`metrics`] judges trails, [`monte_carlo`] runs scenarios many times, [`replay`] sends a recording through a
//! channel, [`scheduling`] lets a scheduler choose the sensors, [`papers`] accounts for what three papers print.
//! Randomness is an argument; equal seeds give equal bytes.

pub mod channels;
pub mod metrics;
pub mod monte_carlo;
pub mod motions;
pub mod papers;
pub mod replay;
pub mod scenario;
pub mod scheduling;
