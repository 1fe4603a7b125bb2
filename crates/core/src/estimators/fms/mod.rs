//! Finite-memory (FMS) filter and smoother: the best linear unbiased estimates of the newest and of a lagged state from the
//! measurements of a sliding window, and from nothing else.
//!
//! The estimate is that of \[FMS19, eq. (13)\], in the window-initial formulation that needs no inverse of A, Π or Q
//! (`docs/equations.md`). The same answer comes from several algorithms, chosen by regime:
//!
//! | regime | algorithm |
//! |---|---|
//! | time-invariant, nothing lost | [`gain`]: a gain computed once, a dot product per component |
//! | time-invariant, few rows lost | [`lost`]: the lost rows are replaced by what makes their residuals vanish, then the same gain |
//! | varying or long, no lag | [`two_filter`]: a backward filter over the older instants and a forward filter over the newer ones meet |
//! | with a lag or a singular A, long window | [`stacks`]: two-stack sliding aggregation of associative elements |
//! | with a lag or a singular A, short window | [`Diffuse`](super::diffuse::Diffuse): one exact-diffuse pass over the window |
//! | nonlinear | [`newton`]: Gauss–Newton over the window |
//!
//! [`invariant`] and [`varying`] make the choice. The window grows from the first instant until it is full.

pub mod element;
pub mod gain;
pub mod invariant;
pub mod lost;
pub mod newton;
pub mod stacks;
pub mod two_filter;
pub mod varying;
pub mod window;

use crate::linalg::{cholesky, compress};
use crate::types::{Belief, Row};

/// Where the window ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Align {
    /// At the newest measurement z_k.
    Filtered,
    /// At z_{k-1}: the estimate of x_k is a prediction, as in the paper.
    Predicted,
}

/// Windows of at least this many instants are aggregated in stacks instead of passed over at each step: a pass costs M updates and
/// leaps, the stacks about two combinations of elements without a lag, each dearer than a leap, and six with one. The pass keeps more digits where the window is
/// ill-conditioned, so short windows stay with it although the stacks would be quicker from about 9 instants on.
pub const STACKS_FROM: usize = 30;

/// Time-varying windows with room for at least this many instants keep two filters, which cost the same at any length; shorter ones
/// would start their backward filter anew at almost every step.
pub const TWO_FILTER_FROM: usize = 4;

/// Returns the normalised innovation squared of rows that the estimate has already used: from their residuals at the estimate,
/// `eᵀ (I − H P Hᵀ)⁻¹ e` with rows of unit variance, equal to the innovation form `νᵀ S⁻¹ ν`. `None` when there are no rows, or when the
/// other rows of the window did not determine what to expect of these.
///
/// `rows` is overwritten when there are more than N.
///
/// # Panics
/// When N exceeds 12.
pub fn posterior_nis<const N: usize>(belief: &Belief<N>, rows: &mut [Row<N>]) -> Option<f64> {
    const MOST: usize = 12;
    let (q, mut nis) = compress(rows);
    if q == 0 {
        return None;
    }
    let mut d = [0.0; MOST * MOST];
    let mut e = [0.0; MOST];
    for i in 0..q {
        let scale = 1.0 / libm::sqrt(rows[i].var);
        let ph = belief.cov * rows[i].h * scale;
        e[i] = (rows[i].residual - rows[i].h.dot(&belief.mean)) * scale;
        for j in 0..=i {
            let one = if i == j { 1.0 } else { 0.0 };
            d[i * q + j] = one - rows[j].h.dot(&ph) / libm::sqrt(rows[j].var);
        }
    }
    // Below this pivot the subtraction has lost its digits: the row alone determines its own expectation.
    if !cholesky(&mut d[..q * q], q) || (0..q).any(|i| d[i * q + i] < 1e-5) {
        return None;
    }
    for i in 0..q {
        for j in 0..i {
            e[i] -= d[i * q + j] * e[j];
        }
        e[i] /= d[i * q + i];
        nis += e[i] * e[i];
    }
    Some(nis)
}
