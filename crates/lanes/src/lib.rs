//! Many tracks of one model at once, a number of each of several in a vector register; or many instants of one series.
//!
//! Tracks lie one after the other, `z[track * steps + k]`, and so do their estimates, `out[(track * steps + k) * N + i]`. What a machine has
//! (AVX2, AVX-512) is used without being asked for at compile time; nothing is contracted, so the estimates are the same bits on all
//! machines, and the same as of each track alone ([`fixtrail_core::kernels::series`]).

mod chains;
mod fir;
mod linear;
mod tiles;
mod tracks;
mod turns;
mod wide;

pub use chains::{Integrators, integrators, side_by_side};
pub use fir::convolve;
pub use linear::{Linear, linear};
pub use tracks::{Problem, filter};
pub use turns::{Ranging, range};
