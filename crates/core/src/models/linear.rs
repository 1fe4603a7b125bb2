//! A linear model given by its matrices.

use crate::types::{Matrix, Transition, Vector};

/// `x_{k+1} = A x_k + B u_k + G w_k`, `cov w = Q`, over one step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Linear<const N: usize> {
    /// A.
    pub a: Matrix<N, N>,
    /// `G Q Gᵀ`, symmetric.
    pub q: Matrix<N, N>,
}

impl<const N: usize> Linear<N> {
    /// Returns one step from `x` under the known input `drive = B u`.
    pub fn leap(&self, x: &Vector<N>, drive: &Vector<N>) -> Transition<N> {
        Transition { next: self.a * x + drive, f: self.a, q: self.q }
    }
}
