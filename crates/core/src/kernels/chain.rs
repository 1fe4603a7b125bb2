//! One axis: position and its derivatives, the position measured.
//!
//! ```text
//! x⁻ = F x                  F_ij = dt^(j−i)/(j−i)!, upper triangular
//! P⁻ = F P Fᵀ + Q           Q_ij = psd dt^(a+b+1)/(a! b! (a+b+1)),  a = N−1−i, b = N−1−j
//! e = z − x⁻_0   s = P⁻_00 + r   k = P⁻_·0/s
//! x = x⁻ + k e              P_0j = P⁻_0j r/s (no subtraction),  P_ij = P⁻_ij − k_i P⁻_0j for i > 0
//! ```

use super::Real;
use crate::types::{Belief, StepError};

/// The motion over one interval: F and Q of a chain of `N` integrators.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Leap<T, const N: usize> {
    pub(super) drift: Drift<T, N>,
    /// Q, upper triangle.
    q: [[T; N]; N],
}

/// F: its first row, `dt^i/i!`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Drift<T, const N: usize>([T; N]);

impl<const N: usize> Leap<f64, N> {
    /// Returns the motion over `dt_s` seconds driven by white noise of density `psd` at the last derivative.
    ///
    /// # Panics
    /// When `N` is not 1, 2 or 3.
    #[inline]
    pub fn new(psd: f64, dt_s: f64) -> Self {
        Leap::over(psd, dt_s)
    }

    /// Returns the motion over `dt_s` seconds with any noise covariance `q`, of which the upper triangle is taken.
    ///
    /// # Panics
    /// As [`Leap::new`].
    #[inline]
    pub fn with_noise(dt_s: f64, q: &[[f64; N]; N]) -> Self {
        Leap { q: *q, ..Leap::new(0.0, dt_s) }
    }

    /// The same in other numbers.
    #[inline(always)]
    pub fn map<T>(&self, to: impl Fn(f64) -> T) -> Leap<T, N> {
        Leap { drift: Drift(self.drift.0.map(&to)), q: self.q.map(|row| row.map(&to)) }
    }
}

/// Mean and covariance of one axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Chain<T, const N: usize> {
    /// Mean: position, velocity, acceleration.
    pub mean: [T; N],
    /// Covariance, upper triangle; what is below the diagonal means nothing.
    pub cov: [[T; N]; N],
}

impl<T: Real, const N: usize> Chain<T, N> {
    /// Returns the belief after one interval of motion.
    #[inline(always)]
    pub fn predict(&self, leap: &Leap<T, N>) -> Self {
        Chain { mean: leap.moved(&self.mean), cov: leap.spread(&self.cov) }
    }

    /// Returns the belief after a measurement `z` of the position with variance `var`, and the gain. Where `z` is NaN nothing was measured.
    #[inline(always)]
    pub fn update(&self, z: T, var: T) -> (Self, [T; N]) {
        let inverse = (self.cov[0][0] + var).inverse();
        // What the position's row keeps: r/s; all of it where nothing was measured, and then nothing is gained.
        let kept = (var * inverse).where_number(z, z.one());
        let inverse = inverse.where_number(z, z.zero());
        // Of a lost measurement nothing may enter a sum, not even times 0.
        let e = (z - self.mean[0]).where_number(z, z.zero());
        let mut gain = [inverse; N];
        let mut out = *self;
        for i in 0..N {
            gain[i] = self.cov[0][i] * inverse;
            out.mean[i] = self.mean[i] + gain[i] * e;
            out.cov[0][i] = self.cov[0][i] * kept;
        }
        for i in 1..N {
            for j in i..N {
                out.cov[i][j] = self.cov[i][j] - gain[i] * self.cov[0][j];
            }
        }
        (out, gain)
    }
}

impl<T: Real, const N: usize> Leap<T, N> {
    /// Returns the motion of [`Leap::new`], of one track or of each of several.
    ///
    /// # Panics
    /// As [`Leap::new`].
    #[inline(always)]
    pub fn over(psd: T, dt_s: T) -> Self {
        const { assert!(N >= 1 && N <= 3, "a chain of 1, 2 or 3 integrators") };
        let mut step = [dt_s.one(); N];
        for i in 1..N {
            step[i] = (step[i - 1] * dt_s).over(i as f64);
        }
        let mut q = [[dt_s.zero(); N]; N];
        for i in 0..N {
            for j in i..N {
                let (a, b) = (N - 1 - i, N - 1 - j);
                // dt^a/a! · dt^b/b! · dt/(a+b+1), each from the first row of F.
                q[i][j] = (psd * step[a] * step[b] * dt_s).over((a + b + 1) as f64);
            }
        }
        Leap { drift: Drift(step), q }
    }

    /// Returns F x.
    #[inline(always)]
    pub fn moved(&self, mean: &[T; N]) -> [T; N] {
        let mut out = *mean;
        for i in 0..N {
            for j in i + 1..N {
                out[i] = out[i] + self.drift.0[j - i] * mean[j];
            }
        }
        out
    }

    /// F P Fᵀ + Q, upper triangle of upper triangle.
    #[inline(always)]
    fn spread(&self, cov: &[[T; N]; N]) -> [[T; N]; N] {
        let at = |a: usize, b: usize| if a <= b { cov[a][b] } else { cov[b][a] };
        let mut half = *cov;
        for i in 0..N {
            for b in i..N {
                let mut sum = at(i, b);
                for a in i + 1..N {
                    sum = sum + self.drift.0[a - i] * at(a, b);
                }
                half[i][b] = sum;
            }
        }
        let mut out = half;
        for i in 0..N {
            for j in i..N {
                let mut sum = half[i][j];
                for b in j + 1..N {
                    sum = sum + self.drift.0[b - j] * half[i][b];
                }
                out[i][j] = sum + self.q[i][j];
            }
        }
        out
    }
}

impl<T: Real, const N: usize> Drift<T, N> {
    /// Fᵀ λ.
    #[inline(always)]
    pub(super) fn back(&self, lambda: &[T; N]) -> [T; N] {
        let mut out = *lambda;
        for i in 0..N {
            for j in (0..i).rev() {
                out[i] = out[i] + self.0[i - j] * lambda[j];
            }
        }
        out
    }

    /// Fᵀ Λ F, upper triangle of upper triangle.
    #[inline(always)]
    pub(super) fn back_spread(&self, big: &[[T; N]; N]) -> [[T; N]; N] {
        let at = |a: usize, b: usize| if a <= b { big[a][b] } else { big[b][a] };
        let mut half = *big;
        for a in 0..N {
            for b in a..N {
                let mut sum = at(a, b);
                for c in 0..b {
                    sum = sum + self.0[b - c] * at(a, c);
                }
                half[a][b] = sum;
            }
        }
        let mut out = half;
        for i in 0..N {
            for j in i..N {
                let mut sum = half[i][j];
                for a in 0..i {
                    sum = sum + self.0[i - a] * half[a][j];
                }
                out[i][j] = sum;
            }
        }
        out
    }
}

impl<const N: usize> Chain<f64, N> {
    /// Returns the belief of one track.
    #[inline]
    pub fn of(belief: &Belief<N>) -> Self {
        let mut out = Chain { mean: belief.mean.into(), cov: [[0.0; N]; N] };
        for i in 0..N {
            for j in i..N {
                out.cov[i][j] = belief.cov[(i, j)];
            }
        }
        out
    }

    /// The same in other numbers.
    #[inline(always)]
    pub fn map<T>(&self, to: impl Fn(f64) -> T) -> Chain<T, N> {
        Chain { mean: self.mean.map(&to), cov: self.cov.map(|row| row.map(&to)) }
    }

    /// Returns the belief after a measurement of one track, its gain and the innovation variance.
    ///
    /// # Errors
    /// [`StepError::InnovationVariance`] when `P⁻_00 + var` is not a positive number, [`StepError::NotFinite`] when the result is not finite.
    #[inline]
    pub fn checked_update(&self, z: f64, var: f64) -> Result<(Self, f64), StepError> {
        let s = self.cov[0][0] + var;
        if !(s > 0.0 && s.is_finite()) {
            return Err(StepError::InnovationVariance { var: s });
        }
        let (out, _) = self.update(z, var);
        match (0..N).find(|i| !(out.mean[*i].is_finite() && out.cov[*i][*i].is_finite())) {
            Some(component) => Err(StepError::NotFinite { component }),
            None => Ok((out, s)),
        }
    }

    /// The belief as the other estimators have it.
    pub fn belief(&self) -> Belief<N> {
        let mut belief = Belief { mean: self.mean.into(), cov: nalgebra::zero() };
        for i in 0..N {
            for j in i..N {
                belief.cov[(i, j)] = self.cov[i][j];
                belief.cov[(j, i)] = self.cov[i][j];
            }
        }
        belief
    }
}
