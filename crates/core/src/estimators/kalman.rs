//! Kalman filter and extended Kalman filter: one implementation, linear and nonlinear models differ in who linearises.
//!
//! ```text
//! x⁻ = f(x)              P⁻ = F P Fᵀ + Q
//! e  = z − h(x⁻)         s  = hᵀP⁻h + r        k = P⁻h/s
//! x  = x⁻ + k e          P  = (I − k hᵀ) P⁻ (I − k hᵀ)ᵀ + k r kᵀ
//! ```
//!
//! Measurements of one instant are taken one scalar row at a time, all linearised at the prediction; correlated components are
//! whitened before. The Joseph form keeps the covariance positive semidefinite.

use crate::linalg::symmetrised;
use crate::types::{Belief, Matrix, Row, StepError, Transition, Vector};

/// What an update does with a row that does not fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Robust {
    /// Uses every row as it is.
    None,
    /// Leaves a row out when `e²/s` exceeds the threshold.
    Gate(f64),
}

/// What the measurements of one instant said of the prediction.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Evidence {
    /// Normalised innovation squared `Σ e²/s`, rejected rows included.
    pub nis: f64,
    /// Number of scalar rows behind `nis`.
    pub dof: u32,
    /// Rows left out.
    pub rejected: u32,
    /// Logarithm of the density of the rows used, given everything before.
    pub log_likelihood: f64,
}

/// Returns the belief after one interval of motion: `next` is the mean, `F P Fᵀ + Q` the covariance.
pub fn predict<const N: usize>(posterior: &Belief<N>, transition: &Transition<N>) -> Belief<N> {
    let cov = transition.f * posterior.cov * transition.f.transpose() + transition.q;
    Belief { mean: transition.next, cov: symmetrised(&cov) }
}

/// Returns the belief after the rows of one instant, linearised at `prior.mean`, and their evidence.
///
/// # Errors
/// [`StepError::InnovationVariance`] when `hᵀP⁻h + r` is not a positive number, [`StepError::NotFinite`] when the result is not
/// finite.
pub fn update<const N: usize>(
    prior: &Belief<N>,
    rows: &[Row<N>],
    robust: Robust,
) -> Result<(Belief<N>, Evidence), StepError> {
    update_noting(prior, rows, robust, |_| {})
}

/// As [`update`]; `used` is told the index of every row that was not left out.
///
/// # Errors
/// As [`update`].
pub fn update_noting<const N: usize>(
    prior: &Belief<N>,
    rows: &[Row<N>],
    robust: Robust,
    mut used: impl FnMut(usize),
) -> Result<(Belief<N>, Evidence), StepError> {
    let mut cov = prior.cov;
    let mut correction = Vector::<N>::zeros();
    let mut evidence = Evidence::default();
    for (i, row) in rows.iter().enumerate() {
        let ph = cov * row.h;
        let s = row.h.dot(&ph) + row.var;
        if !(s > 0.0 && s.is_finite()) {
            return Err(StepError::InnovationVariance { var: s });
        }
        let e = row.residual - row.h.dot(&correction);
        let fit = e * e / s;
        evidence.nis += fit;
        evidence.dof += 1;
        if let Robust::Gate(limit) = robust
            && fit > limit
        {
            evidence.rejected += 1;
            continue;
        }
        used(i);
        evidence.log_likelihood -= 0.5 * (fit + libm::log(core::f64::consts::TAU * s));
        let gain = ph / s;
        correction += gain * e;
        cov = joseph(&cov, &row.h, row.var, &gain);
    }
    let mean = prior.mean + correction;
    finite(&mean, &cov)?;
    Ok((Belief { mean, cov }, evidence))
}

/// Returns `(I − k hᵀ) P (I − k hᵀ)ᵀ + k r kᵀ`, symmetric, for the gain `k = P h / (hᵀP h + r)`.
pub(crate) fn joseph<const N: usize>(p: &Matrix<N, N>, h: &Vector<N>, var: f64, gain: &Vector<N>) -> Matrix<N, N> {
    let size = h.norm_squared();
    if size == 0.0 {
        return *p;
    }
    let left = p - gain * (h.transpose() * p);
    let lh = left * h;
    let mut out = *p;
    for j in 0..N {
        for i in 0..=j {
            // Both orders of the product are averaged: the result is symmetric to the bit.
            let a = left[(i, j)] - lh[i] * gain[j];
            let b = left[(j, i)] - lh[j] * gain[i];
            let v = 0.5 * (a + b) + var * gain[i] * gain[j];
            out[(i, j)] = v;
            out[(j, i)] = v;
        }
    }
    // Along h the exact result is known without subtraction, P⁺h = k r: put it there, or a small r would drown in rounding.
    let mut d = gain * var;
    d.gemv(-1.0, &out, h, 1.0);
    let along = h.dot(&d) / (size * size);
    for j in 0..N {
        for i in 0..=j {
            let v = out[(i, j)] + (d[i] * h[j] + h[i] * d[j]) / size - along * (h[i] * h[j]);
            out[(i, j)] = v;
            out[(j, i)] = v;
        }
    }
    out
}

/// Checks that mean and variances are numbers.
pub(crate) fn finite<const N: usize>(mean: &Vector<N>, cov: &Matrix<N, N>) -> Result<(), StepError> {
    for i in 0..N {
        if !(mean[i].is_finite() && cov[(i, i)].is_finite()) {
            return Err(StepError::NotFinite { component: i });
        }
    }
    Ok(())
}
