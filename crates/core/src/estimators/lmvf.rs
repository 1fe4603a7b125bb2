//! Linear minimum-variance filter for a receiver that holds values: Theorem 1 of \[MVF10\], for [`Hold::Paper`].
//!
//! [`Hold::Paper`]: super::augmented::Hold::Paper
//!
//! ```text
//! G_1 = C⁺A,  G_2 = C,  G_3 = C⁻A⁻¹  (C⁻, A⁻ of the step before; formed only when q_3 > 0)
//! noise = q_1 R⁺ + q_2 R + q_3 R⁻ + q_3 G_3 W⁻ G_3ᵀ
//! x̂⁺ = A x̂ + b + K (y − J x̂ − …),   S⁺ = A S Aᵀ + W                           (13), after (17)
//! ```
//!
//! It is not the optimal filter, and P is not its error covariance: the theorem neglects that values already used are shown again.
//! [`lmmse`](super::lmmse) is. The paper's S_0 = P_0 is S_0 = P_0 + m_0m_0ᵀ for m_0 = 0 only; the caller says which.

use crate::estimators::augmented::{Sensed, Shown};
use crate::estimators::kalman::{Evidence, finite};
use crate::estimators::mixture::{Form, Moment, Part, Step, Used, back, spread, weights};
use crate::linalg::semidefinite_factor;
use crate::types::{Belief, Matrix, StepError, Transition, Vector};

/// The instant before the last one.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Before<const N: usize, const M: usize> {
    sensed: Sensed<N, M>,
    /// How it led to the last.
    f: Matrix<N, N>,
    q: Matrix<N, N>,
    drive: Vector<N>,
}

/// The filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lmvf<const N: usize, const M: usize> {
    mean: Vector<N>,
    form: Form<N>,
    moment: Moment<N>,
    last: Sensed<N, M>,
    before: Option<Before<N, M>>,
    arrival: f64,
}

impl<const N: usize, const M: usize> Lmvf<N, M> {
    /// Returns the filter at the start: `belief` is x̂_{0|0}, `second_moment` is S_0, γ_0 = p_0 = 1. With `square_root` the covariance is
    /// carried as a triangular factor, which keeps its digits where variances differ by many orders.
    pub fn start(belief: &Belief<N>, second_moment: &Matrix<N, N>, sensed: &Sensed<N, M>, square_root: bool) -> Self {
        let form = match square_root {
            false => Form::Full(belief.cov),
            true => Form::Root(semidefinite_factor(&belief.cov)),
        };
        let moment = Moment { mean: belief.mean, second: *second_moment };
        Self { mean: belief.mean, form, moment, last: *sensed, before: None, arrival: 1.0 }
    }

    /// x̂_{k|k} and P.
    pub fn belief(&self) -> Belief<N> {
        Belief { mean: self.mean, cov: self.form.cov() }
    }

    /// S. Not finite any more once it left the range of numbers, which is no error while p = 1.
    pub fn second_moment(&self) -> &Matrix<N, N> {
        &self.moment.second
    }

    /// Takes one step: motion, and what is shown after it. `leap` is linearised at the mean, `sensed` at `leap.next`; `arrival` is p_{k+1}.
    ///
    /// # Errors
    /// [`StepError::SecondMoment`], [`StepError::SingularTransition`] when S or A⁻¹ is needed and not there;
    /// [`StepError::InnovationVariance`], [`StepError::NotFinite`]. Nothing has changed then.
    pub fn step(
        &mut self,
        leap: &Transition<N>,
        sensed: &Sensed<N, M>,
        shown: &Shown<M>,
        arrival: f64,
    ) -> Result<Used<N, M>, StepError> {
        // Where nothing is shown nothing is used, whatever it would have been.
        let q = if shown.count() == 0 { [1.0, 0.0, 0.0] } else { weights(arrival, self.arrival) };
        let drive = leap.next - leap.f * self.mean;
        let last = &self.last;
        let mut parts = [Part::never(); 3];
        parts[0] = Part { q: q[0], g: sensed.h * leap.f, c: sensed.h * drive };
        parts[1] = Part { q: q[1], g: last.h, c: Vector::zeros() };
        let mut noise = sensed.r * q[0] + last.r * q[1];
        // Without a step before, p_0 = 1 and q_3 = 0.
        if let (true, Some(before)) = (q[2] > 0.0, &self.before) {
            let g = back(&before.sensed.h, &before.f)?;
            noise += (before.sensed.r + g * before.q * g.transpose()) * q[2];
            parts[2] = Part { q: q[2], g, c: -(g * before.drive) };
        }
        noise += spread(&parts, &self.moment)?;
        let j = parts.iter().fold(Matrix::zeros(), |sum, part| sum + part.g * part.q);
        let expected = parts.iter().fold(Vector::zeros(), |sum, part| sum + (part.g * self.mean + part.c) * part.q);

        let step = Step { leap, c: sensed.h, j, noise, fresh: q[0] };
        let (d, gain, form) = step.take(&self.form, shown)?;
        let innovation = shown.innovation(&expected);
        let mean = leap.next + gain * innovation;
        finite(&mean, &form.cov())?;

        let evidence =
            Evidence { nis: shown.normalised(&d, &innovation)?, dof: shown.count(), rejected: 0, misfits: 0 };
        self.moment = self.moment.leap(leap, &drive);
        self.before = Some(Before { sensed: self.last, f: leap.f, q: leap.q, drive });
        self.last = *sensed;
        self.arrival = arrival;
        (self.mean, self.form) = (mean, form);
        Ok(Used { j, d, gain, innovation, evidence })
    }
}
