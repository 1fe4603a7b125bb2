//! What ties variables together, and the message it sends to one of them given those from the others.

use super::ARITY;
use super::message::Message;
use crate::linalg::{Lu, definite_inverse, pseudo_inverse, symmetrised};
use crate::types::{Belief, Matrix, Row, Vector};

/// A factor and the variables it ties.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Factor<const N: usize> {
    variables: [usize; ARITY],
    count: usize,
    kind: Kind<N>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind<const N: usize> {
    /// Always the same message: a prior or an observation.
    Fixed(Message<N>),
    Linear(Linear<N>),
    Transition {
        phi: Matrix<N, N>,
        push: Vector<N>,
        q: Matrix<N, N>,
    },
}

/// `Σ a_v x_v + b` is normal noise of mean 0 and covariance `q`.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Linear<const N: usize> {
    a: [Matrix<N, N>; ARITY],
    b: Vector<N>,
    q: Matrix<N, N>,
}

impl<const N: usize> Factor<N> {
    /// What is known of `variable` beforehand.
    pub fn prior(variable: usize, belief: Belief<N>) -> Self {
        Self { variables: [variable; ARITY], count: 1, kind: Kind::Fixed(Message::Moments(belief)) }
    }

    /// A measurement of `variable`: independent rows, linearised at 0, so that their residuals are the measured values. None: lost.
    pub fn observation(variable: usize, rows: &[Row<N>]) -> Self {
        let (mut info, mut eta) = (Matrix::zeros(), Vector::zeros());
        for row in rows {
            let weighed = row.h * (1.0 / row.var);
            info += weighed * row.h.transpose();
            eta += weighed * row.residual;
        }
        Self {
            variables: [variable; ARITY],
            count: 1,
            kind: Kind::Fixed(Message::Information { info: symmetrised(&info), eta }),
        }
    }

    /// `x_to = phi x_from + push + w`, cov w = `q`, which may be singular, as may `phi`. Slot 0 is `from`, slot 1 `to`.
    pub fn transition(from: usize, to: usize, phi: Matrix<N, N>, push: Vector<N>, q: Matrix<N, N>) -> Self {
        Self { variables: [from, to, to], count: 2, kind: Kind::Transition { phi, push, q } }
    }

    /// `Σ a_v x_v + b` is noise of mean 0 and covariance `q`. Slots are the entries of `terms`.
    ///
    /// `None` for fewer than two terms or more than [`ARITY`].
    pub fn linear(terms: &[(usize, Matrix<N, N>)], b: Vector<N>, q: Matrix<N, N>) -> Option<Self> {
        let count = terms.len();
        if !(2..=ARITY).contains(&count) {
            return None;
        }
        let term = |slot: usize| terms[slot.min(count - 1)];
        let a = core::array::from_fn(|slot| term(slot).1);
        Some(Self {
            variables: core::array::from_fn(|slot| term(slot).0),
            count,
            kind: Kind::Linear(Linear { a, b, q }),
        })
    }

    /// The variables, by slot.
    pub fn variables(&self) -> &[usize] {
        &self.variables[..self.count]
    }

    /// The message to `slot` given what the other slots' variables say; `from[slot]` is not looked at. `None` when there is none of the
    /// forms that a [`Message`] has.
    pub(super) fn message(&self, slot: usize, from: &[Message<N>; ARITY]) -> Option<Message<N>> {
        match &self.kind {
            Kind::Fixed(message) => Some(*message),
            Kind::Linear(linear) => linear.message(slot, from, self.count),
            Kind::Transition { phi, push, q } if slot == 1 => onward(phi, push, q, &from[0]),
            Kind::Transition { phi, push, q } => back(phi, push, q, &from[1]),
        }
    }
}

/// Forward: `Φ m + b`, `Φ P Φᵀ + Q`; of partial information `M = Φ⁻ᵀ Λ Φ⁻¹`, `Λ⁺ = (I + M Q)⁻¹ M`, which alone needs Φ⁻¹.
fn onward<const N: usize>(
    phi: &Matrix<N, N>,
    push: &Vector<N>,
    q: &Matrix<N, N>,
    from: &Message<N>,
) -> Option<Message<N>> {
    if let Some(Belief { mean, cov }) = from.belief() {
        let cov = symmetrised(&(phi * cov * phi.transpose() + q));
        return Some(Message::Moments(Belief { mean: phi * mean + push, cov }));
    }
    let Message::Information { info, eta } = from else { return None };
    if info.iter().all(|v| *v == 0.0) {
        return Some(Message::vacuous());
    }
    let inverse = Lu::new(*phi)?;
    let half = inverse.solve_transposed(*info);
    let moved = inverse.solve_transposed(half.transpose());
    let eta = inverse.solve_transposed(*eta) + moved * push;
    let spread = Lu::new(Matrix::identity() + moved * q)?;
    Some(Message::Information { info: symmetrised(&spread.solve(moved)), eta: spread.solve(eta) })
}

/// Backward by the matrix-inversion lemma: `Λ' = Φᵀ (I + Λ Q)⁻¹ Λ Φ`, `η' = Φᵀ (I + Λ Q)⁻¹ (η − Λ b)`; of moments `Φᵀ (P + Q)⁻¹ Φ`.
/// Neither Q nor Φ is inverted.
fn back<const N: usize>(
    phi: &Matrix<N, N>,
    push: &Vector<N>,
    q: &Matrix<N, N>,
    from: &Message<N>,
) -> Option<Message<N>> {
    let (info, eta) = match from {
        Message::Information { info, eta } => {
            let spread = Lu::new(Matrix::identity() + info * q)?;
            (spread.solve(*info), spread.solve(eta - info * push))
        }
        Message::Moments(Belief { mean, cov }) => {
            let (inverse, _) = definite_inverse(&(cov + q))?;
            (inverse, inverse * (mean - push))
        }
    };
    Some(Message::Information { info: symmetrised(&(phi.transpose() * info * phi)), eta: phi.transpose() * eta })
}

impl<const N: usize> Linear<N> {
    /// In moments where all others are determined, else by elimination from the joint information.
    fn message(&self, slot: usize, from: &[Message<N>; ARITY], count: usize) -> Option<Message<N>> {
        let (mut sum, mut cov) = (self.b, self.q);
        let mut open = [false; ARITY];
        for other in (0..count).filter(|other| *other != slot) {
            match from[other].belief() {
                Some(belief) => {
                    sum += self.a[other] * belief.mean;
                    cov += self.a[other] * belief.cov * self.a[other].transpose();
                }
                None => open[other] = true,
            }
        }
        let a = &self.a[slot];
        if !open.contains(&true) {
            // a x = −sum with covariance cov.
            if let Some(inverse) = Lu::new(*a) {
                let half = inverse.solve(cov);
                let cov = symmetrised(&inverse.solve(half.transpose()));
                return Some(Message::Moments(Belief { mean: inverse.solve(-sum), cov }));
            }
        }
        let (weight, _) = definite_inverse(&cov)?;
        // Joint information of the target and of what is open, block by block.
        let held: [bool; ARITY] = core::array::from_fn(|i| i == slot || open[i]);
        let mut info = [[Matrix::<N, N>::zeros(); ARITY]; ARITY];
        let mut eta = [Vector::<N>::zeros(); ARITY];
        for i in (0..count).filter(|i| held[*i]) {
            let side = self.a[i].transpose() * weight;
            eta[i] = -(side * sum);
            for j in (0..count).filter(|j| held[*j]) {
                info[i][j] = side * self.a[j];
            }
            if let (true, Message::Information { info: own, eta: pull }) = (open[i], &from[i]) {
                info[i][i] += own;
                eta[i] += pull;
            }
        }
        for gone in (0..count).filter(|i| open[*i]) {
            let pivot = symmetrised(&info[gone][gone]);
            let (inverse, _) = pseudo_inverse(&pivot, pivot.trace() * NOTHING);
            let (row, pull) = (info[gone], eta[gone]);
            for i in (0..count).filter(|i| held[*i] && *i != gone) {
                let side = info[i][gone] * inverse;
                eta[i] -= side * pull;
                for j in (0..count).filter(|j| held[*j] && *j != gone) {
                    info[i][j] -= side * row[j];
                }
            }
            // Blocks of it are not looked at again.
            for i in 0..count {
                info[i][gone] = Matrix::zeros();
                info[gone][i] = Matrix::zeros();
            }
            eta[gone] = Vector::zeros();
        }
        let out = info[slot][slot];
        // What elimination leaves of rounding is no information.
        let before = (a.transpose() * weight * a).trace();
        if out.trace() <= before * NOTHING {
            return Some(Message::vacuous());
        }
        Some(Message::Information { info: symmetrised(&out), eta: eta[slot] })
    }
}

/// Share of the information before an elimination below which what is left is rounding.
const NOTHING: f64 = 1e-13;
