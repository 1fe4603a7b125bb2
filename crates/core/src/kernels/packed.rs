//! Any belief, its covariance symmetric by construction, measured one row at a time.
//!
//! ```text
//! s = hᵀP h + r   k = P h/s        x ← x + k e        P_ij ← P_ij − k_i (P h)_j,  j ≥ i
//! ```
//!
//! Components of a vector whose noise is uncorrelated are rows taken one after the other: nothing is inverted but a number. What the
//! subtraction loses is a part `hᵀP h/r` of a unit in the last place: a row that knows its quantity a million times better than the belief
//! costs 6 to 12 of 16 digits, and belongs to [`estimators::kalman`](crate::estimators::kalman), which puts it right.

use super::Real;
use crate::types::{Belief, StepError};

/// Mean and covariance of a state of `N` components.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Packed<T, const N: usize> {
    /// Mean.
    pub mean: [T; N],
    /// Covariance, upper triangle; what is below the diagonal means nothing.
    pub cov: [[T; N]; N],
}

/// An entry of a symmetric matrix of which the upper triangle is kept.
#[inline(always)]
pub(super) fn at<T: Copy, const N: usize>(m: &[[T; N]; N], i: usize, j: usize) -> T {
    if i <= j { m[i][j] } else { m[j][i] }
}

/// A motion over one interval, linearised where the belief is.
pub trait Motion<T, const N: usize> {
    /// Returns the belief after it.
    fn after(&self, belief: &Packed<T, N>) -> Packed<T, N>;
}

impl<T: Real, const N: usize> Packed<T, N> {
    /// Returns the belief after one interval of motion.
    #[inline(always)]
    pub fn predict(&self, motion: &impl Motion<T, N>) -> Self {
        motion.after(self)
    }

    /// Returns the belief after a row with innovation `e` and variance `var`, and the innovation variance. Where `e` is NaN nothing was
    /// measured.
    ///
    /// `h` is the row's gradient in the first `A` components, in the others it is 0. The innovation is that of the mean as it is: of
    /// the second row of an instant, what the first has moved is to be taken off before.
    #[inline(always)]
    pub fn update<const A: usize>(&self, h: &[T; A], e: T, var: T) -> (Self, T) {
        const { assert!(A >= 1 && A <= N, "a gradient in components of the state") };
        let mut ph = self.mean;
        for i in 0..N {
            let mut sum = at(&self.cov, 0, i) * h[0];
            for a in 1..A {
                sum = sum + at(&self.cov, a, i) * h[a];
            }
            ph[i] = sum;
        }
        let mut s = ph[0] * h[0];
        for a in 1..A {
            s = s + ph[a] * h[a];
        }
        let s = s + var;
        // Of a lost measurement nothing may enter a sum, not even times 0.
        let inverse = s.inverse().where_number(e, e.zero());
        let e = e.where_number(e, e.zero());
        let mut out = *self;
        for i in 0..N {
            let gain = ph[i] * inverse;
            out.mean[i] = self.mean[i] + gain * e;
            for j in i..N {
                out.cov[i][j] = self.cov[i][j] - gain * ph[j];
            }
        }
        (out, s)
    }

    /// Returns the belief after a measurement `z` of `c · x` with variance `var`, and the innovation variance; `c` as `h` in
    /// [`Packed::update`]. Where `z` is NaN nothing was measured.
    #[inline(always)]
    pub fn measure<const A: usize>(&self, c: &[T; A], z: T, var: T) -> (Self, T) {
        let mut expected = c[0] * self.mean[0];
        for a in 1..A {
            expected = expected + c[a] * self.mean[a];
        }
        self.update(c, z - expected, var)
    }
}

impl<const N: usize> Packed<f64, N> {
    /// Returns the belief of one track; of the covariance the upper triangle is taken.
    #[inline]
    pub fn of(belief: &Belief<N>) -> Self {
        let mut out = Packed { mean: belief.mean.into(), cov: [[0.0; N]; N] };
        for i in 0..N {
            for j in i..N {
                out.cov[i][j] = belief.cov[(i, j)];
            }
        }
        out
    }

    /// The same in other numbers.
    #[inline(always)]
    pub fn map<T>(&self, to: impl Fn(f64) -> T) -> Packed<T, N> {
        Packed { mean: self.mean.map(&to), cov: self.cov.map(|row| row.map(&to)) }
    }

    /// The belief as the other estimators have it.
    pub fn belief(&self) -> Belief<N> {
        Belief { mean: self.mean.into(), cov: crate::types::Matrix::from_fn(|i, j| at(&self.cov, i, j)) }
    }

    /// Checks a belief after rows whose smallest innovation variance was `s`, and returns it.
    ///
    /// # Errors
    /// [`StepError::InnovationVariance`] when `s` is not a positive number, [`StepError::NotFinite`] when the belief is not finite.
    #[inline]
    pub fn checked(self, s: f64) -> Result<Self, StepError> {
        if !(s > 0.0 && s.is_finite()) {
            return Err(StepError::InnovationVariance { var: s });
        }
        match (0..N).find(|i| !(self.mean[*i].is_finite() && self.cov[*i][*i].is_finite())) {
            Some(component) => Err(StepError::NotFinite { component }),
            None => Ok(self),
        }
    }
}
