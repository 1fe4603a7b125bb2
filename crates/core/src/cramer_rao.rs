//! The posterior Cramér–Rao bound: no estimator has a smaller mean squared error \[TMN98\].
//!
//! ```text
//! P⁻ = F P Fᵀ + Q,   P = (P⁻¹ + λ Hᵀ R⁻¹ H)⁻¹
//! ```
//!
//! The recursion of the information `J = P⁻¹` for Gaussian noises, in covariances so that Q may be singular. F and H are the Jacobians *at the
//! true states*. When an instant's measurements arrive together with probability λ, the information that they carry on average counts: the
//! information-reduction bound, which lies below the error of every causal estimator whatever it knows of the losses \[TZM12\]. With λ = 1 and a
//! linear model P is the covariance of the Kalman filter.

use crate::estimators::kalman::{joseph, propagate};
use crate::types::{Matrix, Row};

/// Returns the bound after an interval of motion with Jacobian `f` and process noise `q`, `F P Fᵀ + Q`.
pub fn moved<const N: usize>(bound: &Matrix<N, N>, f: &Matrix<N, N>, q: &Matrix<N, N>) -> Matrix<N, N> {
    propagate(bound, f, q)
}

/// Returns the bound after an instant's independent `rows`, linearised at the true state, that arrive together with probability `arrival`.
///
/// A part λ of the information `h hᵀ/r` is that of a row with the variance r/λ.
pub fn measured<const N: usize>(bound: &Matrix<N, N>, rows: &[Row<N>], arrival: f64) -> Matrix<N, N> {
    let mut out = *bound;
    if !(arrival > 0.0) {
        return out;
    }
    for row in rows {
        let var = row.var / arrival;
        let ph = out * row.h;
        out = joseph(&out, &row.h, var, &ph, row.h.dot(&ph) + var);
    }
    out
}
