//! The target of the finite-memory paper.

use super::Linear;
use crate::types::{Matrix, Vector};

/// Position, velocity and acceleration on one axis, position measured: model (16) of \[FMS19\], as printed.
///
/// The noise input has `T/2` in its first row, where integrating an acceleration step would give `T²/2`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FmsPaper {
    /// `[[1, T, T²/2], [0, 1, T], [0, 0, 1]]`.
    pub a: Matrix<3, 3>,
    /// `[[T/2, 0], [1, 0], [0, 1]]`.
    pub g: Matrix<3, 2>,
    /// `diag(0.173², 0.01²)`.
    pub q: Matrix<2, 2>,
    /// `[1, 0, 0]`, as a column.
    pub c: Vector<3>,
    /// `0.05²`.
    pub r: f64,
}

impl FmsPaper {
    /// Returns the model for a sampling interval of `interval_s` seconds; the paper's is 2.
    pub fn new(interval_s: f64) -> FmsPaper {
        let t = interval_s;
        FmsPaper {
            a: Matrix::<3, 3>::new(1.0, t, t * t / 2.0, 0.0, 1.0, t, 0.0, 0.0, 1.0),
            g: Matrix::<3, 2>::new(t / 2.0, 0.0, 1.0, 0.0, 0.0, 1.0),
            q: Matrix::<2, 2>::new(0.173 * 0.173, 0.0, 0.0, 0.01 * 0.01),
            c: Vector::from([1.0, 0.0, 0.0]),
            r: 0.05 * 0.05,
        }
    }

    /// Returns the motion with `G Q Gᵀ` formed.
    pub fn motion(&self) -> Linear<3> {
        Linear { a: self.a, q: self.g * self.q * self.g.transpose() }
    }
}
