//! Few lost rows in a time-invariant window: the exact estimate from the full-window gain.
//!
//! `W = S⁻¹ − S⁻¹O(OᵀS⁻¹O)⁻¹OᵀS⁻¹` maps the window's data to their smoothing errors. With the lost rows m set to zero (and known inputs
//! removed), the data `z_m = −W_mm⁻¹ (W z)_m` make the lost rows' smoothing errors vanish; the full-window gain applied to them gives
//! the best linear unbiased estimate from the rows received, with covariance `P + K_m W_mm⁻¹ K_mᵀ`.
//!
//! W is built column by column by the exact-diffuse pass and its adjoint; built by normal equations it would lose ten digits.

use crate::estimators::diffuse::{Diffuse, Joint, Taken};
use crate::estimators::fms::gain::{Column, Gain, Invariant};
use crate::linalg::symmetrised;
use crate::storage::Store;
use crate::types::{Belief, Matrix, Row, StepError, Vector};

/// Most lost rows that the correction takes; beyond, a pass over the window is as cheap.
pub const MOST_LOST: usize = 16;

/// Pivots of `W_mm` below this, relative to its lossless bound, leave the decision to a pass over the window.
const PIVOT: f64 = 1e-5;

/// The smoothing-error matrix W of a full window, in the coordinates of the raw measurements.
#[derive(Clone)]
pub struct LostRows<S: Store> {
    w: S::Of<f64>,
    size: usize,
}

impl<S: Store> LostRows<S> {
    /// Designs W for `window` instants; `unwhiten` is the lower-triangular factor L of R (row by row), so that raw = L · white.
    /// `Ok(None)` when the store has no room.
    ///
    /// # Errors
    /// As [`Diffuse::update`].
    pub fn design<const N: usize>(
        model: &Invariant<'_, N>,
        window: usize,
        unwhiten: &[f64],
    ) -> Result<Option<Self>, StepError> {
        let q = model.rows.len();
        let size = window * q;
        let (Some(mut w), Some(mut taken), Some(mut e)) =
            (S::filled(size * size, 0.0), S::filled(size, Taken::<N>::zero()), S::filled(size, 0.0))
        else {
            return Ok(None);
        };
        let mut pass = Diffuse::start();
        for i in 0..window {
            if i > 0 {
                pass.leap(&model.leap.f, &Vector::zeros(), &model.leap.q);
            }
            for (r, h) in model.rows.iter().enumerate() {
                taken.as_mut()[i * q + r] = pass.update(&Row { h: *h, residual: 0.0, var: 1.0 })?;
            }
        }
        let inverse = pass.info.right_solve(&Matrix::<N, N>::identity());
        let (w_all, taken, e) = (w.as_mut(), taken.as_ref(), e.as_mut());
        for column in 0..size {
            let mut a = Vector::<N>::zeros();
            let mut sigma = Vector::<N>::zeros();
            for (i, t) in taken.iter().enumerate() {
                if i > 0 && i % q == 0 {
                    a = model.leap.f * a;
                }
                let unit = if i == column { 1.0 } else { 0.0 };
                e[i] = unit - t.h.dot(&a);
                a += t.gain * e[i];
                sigma += t.e_x * (e[i] / t.f);
            }
            let s = inverse * inverse.tr_mul(&sigma);
            let mut r = Vector::<N>::zeros();
            for (i, t) in taken.iter().enumerate().rev() {
                let u = (e[i] - t.e_x.dot(&s)) / t.f - t.gain.dot(&r);
                w_all[column * size + i] = u;
                r += t.h * u;
                if i % q == 0 {
                    r = model.leap.f.tr_mul(&r);
                }
            }
        }
        // W_raw = L⁻ᵀ W_white L⁻¹ per pair of instants: solve with Lᵀ along rows, then along columns.
        for line in 0..size {
            for block in 0..window {
                back_substitute(unwhiten, q, |i| line * size + block * q + i, w_all);
            }
        }
        for line in 0..size {
            for block in 0..window {
                back_substitute(unwhiten, q, |i| (block * q + i) * size + line, w_all);
            }
        }
        Ok(Some(Self { w, size }))
    }

    /// Returns the estimate for data whose lost entries (indices `lost`, at most [`MOST_LOST`]) are zero and whose known inputs are
    /// removed. `None` when the rows received come near to not determining it; a pass over the window decides then.
    pub fn correct<const N: usize, G: Store>(
        &self,
        gain: &Gain<N, G>,
        z: &[f64],
        lost: &[usize],
        bound: impl Fn(usize) -> f64,
    ) -> Option<(Column<N>, Joint<N>)> {
        let w = self.w.as_ref();
        let m = lost.len();
        let mut l = [[0.0; MOST_LOST]; MOST_LOST];
        let mut v = [0.0; MOST_LOST];
        for (i, &row) in lost.iter().enumerate() {
            let line = &w[row * self.size..(row + 1) * self.size];
            v[i] = line.iter().zip(z).map(|(w, z)| w * z).sum();
            for j in 0..=i {
                let mut sum = line[lost[j]];
                for k in 0..j {
                    sum -= l[i][k] * l[j][k];
                }
                if i == j {
                    if !(sum > PIVOT * bound(row)) {
                        return None;
                    }
                    l[i][i] = libm::sqrt(sum);
                } else {
                    l[i][j] = sum / l[j][j];
                }
            }
        }
        // Y = L⁻¹ K_mᵀ and L⁻¹ v, forward together; then the mean moves by −K_m W_mm⁻¹ v = −Yᵀ L⁻¹ v.
        let zero = (Vector::<N>::zeros(), Vector::<N>::zeros());
        let mut y = [zero; MOST_LOST];
        let mut mean = zero;
        let mut cov = [Matrix::<N, N>::zeros(); 3];
        for i in 0..m {
            let (mut g, mut g_lag) = gain.z.as_ref()[lost[i]];
            for k in 0..i {
                g -= y[k].0 * l[i][k];
                g_lag -= y[k].1 * l[i][k];
                v[i] -= v[k] * l[i][k];
            }
            let d = 1.0 / l[i][i];
            v[i] *= d;
            y[i] = (g * d, g_lag * d);
            mean.0 -= y[i].0 * v[i];
            mean.1 -= y[i].1 * v[i];
            cov[0] += y[i].0 * y[i].0.transpose();
            cov[1] += y[i].1 * y[i].1.transpose();
            cov[2] += y[i].0 * y[i].1.transpose();
        }
        let grown = |belief: &Option<Belief<N>>, by: &Matrix<N, N>| {
            belief.as_ref().map(|b| Belief { mean: b.mean, cov: symmetrised(&(b.cov + by)) })
        };
        let joint = Joint {
            filter: grown(&gain.joint.filter, &cov[0]),
            lagged: grown(&gain.joint.lagged, &cov[1]),
            cross: gain.joint.cross + cov[2],
        };
        Some((mean, joint))
    }
}

/// Solves `Lᵀ x = b` in place, `b` at `at(0) … at(q − 1)` of `data`.
fn back_substitute(l: &[f64], q: usize, at: impl Fn(usize) -> usize, data: &mut [f64]) {
    for i in (0..q).rev() {
        let mut sum = data[at(i)];
        for k in i + 1..q {
            sum -= l[k * q + i] * data[at(k)];
        }
        data[at(i)] = sum / l[i * q + i];
    }
}
