//! Extended minimum-variance filter for a receiver that holds values: Theorem 2 of \[MVF10\].
//!
//! As [`lmvf`](super::lmvf) with A → Φ, C⁺ → H_n, C → H_c, C⁻A⁻¹ → H_p Φ⁻¹, where h and H of the older instants stay frozen at the states
//! predicted for them, as the paper has it:
//!
//! ```text
//! x̂⁺ = f(x̂) + K (y − q_1 h_n − q_2 h_c − q_3 h_p)
//! ```
//!
//! For a linear model it is therefore not [`lmvf`](super::lmvf). The theorem leaves out that the values expected differ:
//! [`range_mixture`](Options) adds `Σ_{i<j} q_i q_j (h_i − h_j)(h_i − h_j)ᵀ` to D.

use crate::estimators::augmented::{Sensed, Shown};
use crate::estimators::kalman::{Evidence, finite};
use crate::estimators::mixture::{Form, Moment, Part, Step, Used, back, spread, weights};
use crate::types::{Belief, Matrix, StepError, Transition, Vector};

/// What is shown after two losses in a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Variant {
    /// The value before both: the paper's Model 2.
    #[default]
    Model2,
    /// 0: the paper's Model 1. Whether the filter uses it is the caller's choice.
    Model1,
}

/// The filter's options.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct Options {
    /// What is shown after two losses.
    pub variant: Variant,
    /// Whether D counts how far the values expected lie apart.
    pub range_mixture: bool,
}

/// The instant before the last one: its measurement, and Φ to the last.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Before<const N: usize, const M: usize> {
    sensed: Sensed<N, M>,
    phi: Matrix<N, N>,
    q: Matrix<N, N>,
}

/// The filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Emvf<const N: usize, const M: usize> {
    options: Options,
    mean: Vector<N>,
    form: Form<N>,
    moment: Moment<N>,
    last: Sensed<N, M>,
    before: Option<Before<N, M>>,
    arrival: f64,
}

impl<const N: usize, const M: usize> Emvf<N, M> {
    /// Returns the filter at the start: `belief` is x̂_{0|0}, `second_moment` is S_0, γ_0 = p_0 = 1; `sensed` is linearised at
    /// `belief.mean`.
    pub fn start(belief: &Belief<N>, second_moment: &Matrix<N, N>, sensed: &Sensed<N, M>, options: Options) -> Self {
        Self {
            options,
            mean: belief.mean,
            form: Form::Full(belief.cov),
            moment: Moment { mean: Vector::zeros(), second: *second_moment },
            last: *sensed,
            before: None,
            arrival: 1.0,
        }
    }

    /// x̂_{k|k} and P.
    pub fn belief(&self) -> Belief<N> {
        Belief { mean: self.mean, cov: self.form.cov() }
    }

    /// S.
    pub fn second_moment(&self) -> &Matrix<N, N> {
        &self.moment.second
    }

    /// Takes one step: motion, and what is shown after it. `leap` is linearised at the mean, `sensed` at `leap.next`; `arrival` is p_{k+1}.
    ///
    /// # Errors
    /// [`StepError::SecondMoment`], [`StepError::SingularTransition`] when S or Φ⁻¹ is needed and not there;
    /// [`StepError::InnovationVariance`], [`StepError::NotFinite`]. Nothing has changed then.
    pub fn step(
        &mut self,
        leap: &Transition<N>,
        sensed: &Sensed<N, M>,
        shown: &Shown<M>,
        arrival: f64,
    ) -> Result<Used<N, M>, StepError> {
        // Where nothing is shown nothing is used, whatever it would have been.
        let mut q = if shown.count() == 0 { [1.0, 0.0, 0.0] } else { weights(arrival, self.arrival) };
        let last = &self.last;
        let mut parts = [Part::never(); 3];
        parts[0] = Part { q: q[0], g: sensed.h * leap.f, c: Vector::zeros() };
        parts[1] = Part { q: q[1], g: last.h, c: Vector::zeros() };
        let mut noise = sensed.r * q[0] + last.r * q[1];
        let mut oldest = Vector::zeros();
        match &self.before {
            // Without a step before, p_0 = 1 and q_3 = 0.
            Some(before) if q[2] > 0.0 && self.options.variant == Variant::Model2 => {
                let g = back(&before.sensed.h, &before.phi)?;
                noise += (before.sensed.r + g * before.q * g.transpose()) * q[2];
                parts[2] = Part { q: q[2], g, c: Vector::zeros() };
                oldest = before.sensed.expected;
            }
            _ => q[2] = 0.0,
        }
        noise += spread(&parts, &self.moment)?;
        let values = [sensed.expected, last.expected, oldest];
        if self.options.range_mixture {
            for i in 0..3 {
                for j in i + 1..3 {
                    let apart = values[i] - values[j];
                    noise += apart * apart.transpose() * (q[i] * q[j]);
                }
            }
        }
        let j = parts.iter().fold(Matrix::zeros(), |sum, part| sum + part.g * part.q);
        let expected = (0..3).fold(Vector::zeros(), |sum, i| sum + values[i] * q[i]);

        let step = Step { leap, c: sensed.h, j, noise, fresh: q[0] };
        let (d, gain, form) = step.take(&self.form, shown)?;
        let innovation = shown.innovation(&expected);
        let mean = leap.next + gain * innovation;
        let evidence =
            Evidence { nis: shown.normalised(&d, &innovation)?, dof: shown.count(), rejected: 0, misfits: 0 };
        finite(&mean, &form.cov())?;

        self.moment = self.moment.leap(leap, &Vector::zeros());
        self.before = Some(Before { sensed: self.last, phi: leap.f, q: leap.q });
        self.last = *sensed;
        self.arrival = arrival;
        (self.mean, self.form) = (mean, form);
        Ok(Used { j, d, gain, innovation, evidence })
    }
}
