//! Generalised pseudo-Bayes filter of order 1 \[BLK01\] over the two things that a value shown may be: the newest measurement, or the
//! value that is held. Arrivals are unknown; motion and sensors may be nonlinear.
//!
//! ```text
//! came   y ~ N(n̂, cov n)              then d⁺ = n
//! held   y ~ N(d̂, cov d + 1e-9 R)     then d⁺ = z (Hold::Paper) or d (Hold::LastReceived)
//! weights ∝ p N(y; came), (1 − p) N(y; held);  mean and covariance of the mixture go on
//! ```
//!
//! The noise of 1e-9 R keeps the density of a value finite that is already known exactly. It blurs only that: what is shown is known from
//! then on, and d⁺ carries no variance but that of its difference from it.

use crate::estimators::augmented::{Cross, Hold, Joint, Sensed, Shown};
use crate::estimators::kalman::{Evidence, finite};
use crate::linalg::{definite_inverse, symmetrised};
use crate::types::{Belief, Matrix, StepError, Transition, Vector};

/// Share of the measurement noise that a held value is blurred by.
const BLUR: f64 = 1e-9;

/// What [`Gpb1::step`] found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weighed {
    /// Probability that the value came at this step, given everything so far; the prior one where nothing was shown.
    pub fresh: f64,
    /// The innovation of the mixture, normalised by the mixture's covariance.
    pub evidence: Evidence,
}

/// The filter; [`Joint`] is its augmented estimate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gpb1<const N: usize, const M: usize> {
    hold: Hold,
    joint: Joint<N, M>,
}

impl<const N: usize, const M: usize> Gpb1<N, M> {
    /// Returns the filter at the start: `belief` is x̂_{0|0}, z_0 came for certain and is not used any more. `sensed` is linearised at
    /// `belief.mean`.
    pub fn start(belief: &Belief<N>, sensed: &Sensed<N, M>, hold: Hold) -> Self {
        Self { hold, joint: Joint::start(belief, sensed) }
    }

    /// The augmented estimate.
    pub fn joint(&self) -> &Joint<N, M> {
        &self.joint
    }

    /// Takes one step: motion, and what is shown after it. `leap` is linearised at the mean, `sensed` at `leap.next`; `arrival` is p_{k+1}.
    ///
    /// # Errors
    /// [`StepError::InnovationVariance`] when an innovation covariance is not positive definite, [`StepError::NotFinite`]. Nothing has
    /// changed then.
    pub fn step(
        &mut self,
        leap: &Transition<N>,
        sensed: &Sensed<N, M>,
        shown: &Shown<M>,
        arrival: f64,
    ) -> Result<Weighed, StepError> {
        let ahead = self.joint.ahead(leap, sensed, self.hold);
        let held_cov = ahead.dd + sensed.r * BLUR;
        let fresh = Branch::of(ahead.fresh(shown), &ahead.n, &ahead.nn, shown, arrival)?;
        let held = Branch::of(ahead.held(shown), &ahead.d, &held_cov, shown, 1.0 - arrival)?;
        let likelier = fresh.log_weight.max(held.log_weight);
        let (a, b) = (libm::exp(fresh.log_weight - likelier), libm::exp(held.log_weight - likelier));
        let weight = a / (a + b);
        let joint = merged(&fresh.joint, &held.joint, weight);
        finite(&joint.x, &joint.xx)?;

        // The prior mixture's own innovation.
        let (p, q) = (arrival, 1.0 - arrival);
        let apart = ahead.n - ahead.d;
        let cov = symmetrised(&(ahead.nn * p + held_cov * q + apart * apart.transpose() * (p * q)));
        let (inverse, _) = inverted(&cov, shown)?;
        let e = shown.innovation(&(ahead.n * p + ahead.d * q));
        self.joint = joint;
        Ok(Weighed {
            fresh: weight,
            evidence: Evidence { nis: e.dot(&(inverse * e)), dof: shown.count(), rejected: 0, misfits: 0 },
        })
    }
}

/// One hypothesis after the value.
struct Branch<const N: usize, const M: usize> {
    joint: Joint<N, M>,
    log_weight: f64,
}

impl<const N: usize, const M: usize> Branch<N, M> {
    fn of(
        (prior, cross): (Joint<N, M>, Cross<N, M>),
        expected: &Vector<M>,
        cov: &Matrix<M, M>,
        shown: &Shown<M>,
        probability: f64,
    ) -> Result<Self, StepError> {
        let (inverse, log_det) = inverted(cov, shown)?;
        let e = shown.innovation(expected);
        // The constant of the density is the same for both.
        let log_weight = libm::log(probability) - 0.5 * (e.dot(&(inverse * e)) + log_det);
        Ok(Self { joint: prior.given(&cross, &cross.gain(&inverse), &e), log_weight })
    }
}

/// Inverse and log-determinant of the covariance of what is seen.
fn inverted<const M: usize>(cov: &Matrix<M, M>, shown: &Shown<M>) -> Result<(Matrix<M, M>, f64), StepError> {
    let (inverse, log_det) =
        definite_inverse(&shown.decoupled(cov)).ok_or(StepError::InnovationVariance { var: cov[(0, 0)] })?;
    Ok((shown.restricted(&inverse), log_det))
}

/// Mean and covariance of a mixture with weights `w` and `1 − w`.
fn merged<const N: usize, const M: usize>(a: &Joint<N, M>, b: &Joint<N, M>, w: f64) -> Joint<N, M> {
    // A hypothesis without weight may be anything, also not finite.
    if w >= 1.0 {
        return *a;
    }
    if w <= 0.0 {
        return *b;
    }
    let v = 1.0 - w;
    let (x, z, d) = (a.x - b.x, a.z - b.z, a.d - b.d);
    let s = w * v;
    Joint {
        x: a.x * w + b.x * v,
        z: a.z * w + b.z * v,
        d: a.d * w + b.d * v,
        xx: symmetrised(&(a.xx * w + b.xx * v + x * x.transpose() * s)),
        xz: a.xz * w + b.xz * v + x * z.transpose() * s,
        xd: a.xd * w + b.xd * v + x * d.transpose() * s,
        zz: symmetrised(&(a.zz * w + b.zz * v + z * z.transpose() * s)),
        zd: a.zd * w + b.zd * v + z * d.transpose() * s,
        dd: symmetrised(&(a.dd * w + b.dd * v + d * d.transpose() * s)),
    }
}
