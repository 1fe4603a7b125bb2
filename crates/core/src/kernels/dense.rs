//! Any linear motion, nothing known of its entries.
//!
//! ```text
//! x⁻ = A x        P⁻ = (A P) Aᵀ + Q, upper triangle
//! ```

use super::packed::{Packed, at};
use super::{Motion, Real};
use crate::types::{Matrix, Transition};

/// A linear motion over one interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dense<T, const N: usize> {
    /// A.
    a: [[T; N]; N],
    /// Q, upper triangle.
    q: [[T; N]; N],
}

impl<const N: usize> Dense<f64, N> {
    /// Returns the motion `x⁺ = A x + noise(Q)`; of `q` the upper triangle is taken.
    #[inline]
    pub fn new(a: &Matrix<N, N>, q: &Matrix<N, N>) -> Self {
        let rows = |m: &Matrix<N, N>| core::array::from_fn(|i| core::array::from_fn(|j| m[(i, j)]));
        Dense { a: rows(a), q: rows(q) }
    }

    /// The same in other numbers.
    #[inline(always)]
    pub fn map<T>(&self, to: impl Fn(f64) -> T) -> Dense<T, N> {
        Dense { a: self.a.map(|row| row.map(&to)), q: self.q.map(|row| row.map(&to)) }
    }
}

impl<const N: usize> From<&Transition<N>> for Dense<f64, N> {
    fn from(leap: &Transition<N>) -> Self {
        Dense::new(&leap.f, &leap.q)
    }
}

impl<T: Real, const N: usize> Motion<T, N> for Dense<T, N> {
    #[inline(always)]
    fn after(&self, belief: &Packed<T, N>) -> Packed<T, N> {
        let (Dense { a, q }, Packed { mean, cov }) = (self, belief);
        let mut out = Packed { mean: *mean, cov: *q };
        for i in 0..N {
            let mut sum = a[i][0] * mean[0];
            for k in 1..N {
                sum = sum + a[i][k] * mean[k];
            }
            out.mean[i] = sum;
            // Row i of A P.
            let mut half = *mean;
            for b in 0..N {
                let mut sum = a[i][0] * at(cov, 0, b);
                for k in 1..N {
                    sum = sum + a[i][k] * at(cov, k, b);
                }
                half[b] = sum;
            }
            for j in i..N {
                let mut sum = half[0] * a[j][0];
                for k in 1..N {
                    sum = sum + half[k] * a[j][k];
                }
                out.cov[i][j] = sum + q[i][j];
            }
        }
        out
    }
}
