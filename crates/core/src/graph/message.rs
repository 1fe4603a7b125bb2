//! What travels along an edge: a normal distribution, or what little of one is known.

use crate::linalg::{Lu, cholesky, definite_inverse, symmetrised};
use crate::types::{Belief, Matrix, Vector};

/// A message about a variable.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Message<const N: usize> {
    /// Mean and covariance, which may be singular.
    Moments(Belief<N>),
    /// `exp(−½ xᵀ info x + etaᵀ x)`: the information may be singular, and 0 says nothing.
    Information {
        /// Λ, symmetric and positive semidefinite.
        info: Matrix<N, N>,
        /// η = Λ · mean, where there is a mean.
        eta: Vector<N>,
    },
}

impl<const N: usize> Message<N> {
    /// A message that says nothing: what an edge carries before anything is sent.
    pub fn vacuous() -> Self {
        Message::Information { info: Matrix::zeros(), eta: Vector::zeros() }
    }

    /// Mean and covariance, or `None` when the message does not determine the variable.
    pub fn belief(&self) -> Option<Belief<N>> {
        match self {
            Message::Moments(belief) => Some(*belief),
            Message::Information { info, eta } => {
                let cov = inverse(info)?;
                Some(Belief { mean: cov * eta, cov })
            }
        }
    }

    /// Both messages as one.
    ///
    /// Information adds. With moments (m, P) it is `P' = (I + P Λ)⁻¹ P, m' = (I + P Λ)⁻¹ (m + P η)`, which inverts neither P nor Λ; two pairs
    /// of moments are weighed by `P_1 (P_1 + P_2)⁻¹`. `None` when both are moments and certain of the same direction.
    pub fn times(&self, other: &Self) -> Option<Self> {
        Some(match (self, other) {
            (Message::Information { info: a, eta: x }, Message::Information { info: b, eta: y }) => {
                Message::Information { info: a + b, eta: x + y }
            }
            (Message::Moments(belief), Message::Information { info, eta })
            | (Message::Information { info, eta }, Message::Moments(belief)) => {
                let weigh = Lu::new(Matrix::identity() + belief.cov * info)?;
                // m' − m, so that a large mean costs no digits.
                let mean = belief.mean + weigh.solve(belief.cov * (eta - info * belief.mean));
                Message::Moments(Belief { mean, cov: symmetrised(&weigh.solve(belief.cov)) })
            }
            (Message::Moments(a), Message::Moments(b)) => {
                let (inverse, _) = definite_inverse(&(a.cov + b.cov))?;
                let gain = a.cov * inverse;
                let mean = a.mean + gain * (b.mean - a.mean);
                Message::Moments(Belief { mean, cov: symmetrised(&(gain * b.cov)) })
            }
        })
    }
}

/// Share of a direction's information that the others must leave of it for the variable to count as determined: below, fewer than six digits of
/// it are right.
const LEAST: f64 = 1e-10;

/// Returns the inverse of an information matrix in units where its diagonal is 1, or `None` when it is singular to rounding.
fn inverse<const N: usize>(info: &Matrix<N, N>) -> Option<Matrix<N, N>> {
    let mut unit = Vector::<N>::zeros();
    for i in 0..N {
        if !(info[(i, i)] > 0.0) {
            return None;
        }
        unit[i] = 1.0 / libm::sqrt(info[(i, i)]);
    }
    let scaled = Matrix::<N, N>::from_fn(|i, j| info[(i, j)] * unit[i] * unit[j]);
    let mut factor = scaled;
    if !cholesky(factor.as_mut_slice(), N) || (0..N).any(|i| factor[(i, i)] * factor[(i, i)] < LEAST) {
        return None;
    }
    let (inverse, _) = definite_inverse(&scaled)?;
    Some(symmetrised(&Matrix::<N, N>::from_fn(|i, j| inverse[(i, j)] * unit[i] * unit[j])))
}
