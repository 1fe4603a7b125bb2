//! Interacting multiple models \[BBS88\]: a target that moves in one of several modes at a time, each with a Kalman filter of its own.
//!
//! ```text
//! mix       c_j = Σ_i p_ij μ_i                     μ_i|j = p_ij μ_i / c_j
//!           x0_j = Σ_i μ_i|j x_i                   P0_j = Σ_i μ_i|j (P_i + (x_i − x0_j)(x_i − x0_j)ᵀ)
//! predict   (x⁻_j, P⁻_j) of (x0_j, P0_j)           in mode j, linearised at x0_j
//! update    (x_j, P_j) of (x⁻_j, P⁻_j)             rows linearised at x⁻_j
//!           μ_j ∝ c_j L_j                          L_j: likelihood of the rows in mode j
//! belief    x = Σ_j μ_j x_j                        P = Σ_j μ_j (P_j + (x_j − x)(x_j − x)ᵀ)
//! ```
//!
//! p_ij is the probability of mode j after mode i over the interval, [`Switching::over`]; an instant without rows mixes and predicts.
//! Likelihoods are products of the densities of innovations, held as logarithms: only their differences are ever exponentiated.
//!
//! **Outliers.** Under a robust update each mode weighs the rows by its own prediction, as a filter of that mode alone would: what is an
//! outlier to a mode that goes straight on may be a turn to another. Likelihoods must not do the same. A weighted row's variance differs
//! from mode to mode, so its density says nothing; at the row's own variance an outlier would decide for the mode that expects the least,
//! by its square; and even by Huber's density, `c |ν|`, it would. Instead each row may be an outlier, whose density is the same whatever
//! the mode:
//!
//! ```text
//! robust    L_j = Π_i (N(e_ij; 0, s_ij) + ε_i)     ε_i = N(3 √s̄_i; 0, s̄_i)
//! else      L_j = Π_i N(e_ij; 0, s_ij)
//! ```
//!
//! with e_ij and s_ij the innovation of row i and its variance at the row's own noise, given the rows before as mode j used them, and s̄_i
//! the variance by the combined prediction alone. A row that no mode expects within a good three standard deviations leaves the
//! probabilities as they are, and no row changes the odds of two modes by more than 1 + e^4.5 √(s̄_i/s_ij).

use crate::estimators::kalman::{self, Evidence, Innovation, MISFIT, Robust};
use crate::models::{MOST_MODES, Switching};
use crate::types::{Belief, Matrix, Row, StepError, Transition, Vector};

/// The state of all modes, before or after a measurement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Imm<const N: usize> {
    count: usize,
    modes: [Belief<N>; MOST_MODES],
    probabilities: [f64; MOST_MODES],
}

impl<const N: usize> Imm<N> {
    /// Returns the start: every mode holds `belief`, with the share of time that it has in the long run as its probability.
    pub fn start(belief: &Belief<N>, switching: &Switching) -> Self {
        Self { count: switching.count(), modes: [*belief; MOST_MODES], probabilities: switching.stationary() }
    }

    /// What each mode believes.
    pub fn modes(&self) -> &[Belief<N>] {
        &self.modes[..self.count]
    }

    /// Probability of each mode; their sum is 1.
    pub fn probabilities(&self) -> &[f64] {
        &self.probabilities[..self.count]
    }

    /// Returns mean and covariance over all modes.
    pub fn belief(&self) -> Belief<N> {
        matched(self.modes(), self.probabilities())
    }

    /// Returns the modes mixed over an interval in which mode i becomes mode j with probability `p[i][j]`; their motion is still to come.
    pub fn mix(&self, p: &[[f64; MOST_MODES]; MOST_MODES]) -> Self {
        let mut out = *self;
        for j in 0..self.count {
            let came: [f64; MOST_MODES] = core::array::from_fn(|i| p[i][j] * self.probabilities[i]);
            let total: f64 = came[..self.count].iter().sum();
            out.probabilities[j] = total;
            // A mode that cannot be keeps what it believes.
            if total > 0.0 {
                out.modes[j] = matched(self.modes(), &came.map(|w| w / total)[..self.count]);
            }
        }
        out
    }

    /// Returns the modes after their motion; `leap` linearises that of a mode at its mean.
    pub fn predict(&self, mut leap: impl FnMut(usize, &Vector<N>) -> Transition<N>) -> Self {
        let mut out = *self;
        for (j, mode) in out.modes[..self.count].iter_mut().enumerate() {
            *mode = kalman::predict(mode, &leap(j, &mode.mean));
        }
        out
    }

    /// Returns the modes after the rows of one instant, and what those said of the combined prediction.
    ///
    /// `combined` are the rows linearised at the mean of [`Imm::belief`]; `each` those linearised at the mean of every mode, one mode after
    /// the other. `used` is told of every row that an update of the combined prediction would not leave out.
    /// Evidence: `nis` and `misfits` are the combined prediction's, `rejected` counts as the mode that left out the fewest.
    ///
    /// # Errors
    /// As [`kalman::update`], for any mode or the combined prediction.
    ///
    /// # Panics
    /// When there are fewer rows in `each` than in `combined` for every mode.
    pub fn update(
        &self,
        combined: &[Row<N>],
        each: &[Row<N>],
        robust: Robust,
        used: impl FnMut(Innovation),
    ) -> Result<(Self, Evidence), StepError> {
        let prior = self.belief();
        let (_, mut evidence) = kalman::update_noting(&prior, combined, robust, used)?;
        if combined.is_empty() {
            return Ok((*self, evidence));
        }
        let mut out = *self;
        let mut logs = [f64::NEG_INFINITY; MOST_MODES];
        let mut rejected = evidence.dof;
        for j in 0..self.count {
            let rows = &each[j * combined.len()..(j + 1) * combined.len()];
            let mut log_likelihood = 0.0;
            let (mode, of_mode) = kalman::update_judging(&self.modes[j], rows, robust, |judged| {
                let expected = log_normal(judged.e * judged.e / judged.s, judged.s);
                log_likelihood += match robust {
                    Robust::None => expected,
                    _ => log_sum(expected, log_outlier(&prior, &combined[judged.row])),
                };
            })?;
            out.modes[j] = mode;
            logs[j] = libm::log(self.probabilities[j]) + log_likelihood;
            rejected = rejected.min(of_mode.rejected);
        }
        evidence.rejected = rejected;
        let likeliest = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        // Beyond the range of numbers no mode is likelier than another.
        if likeliest > f64::NEG_INFINITY {
            let weights = logs.map(|log| libm::exp(log - likeliest));
            let total: f64 = weights.iter().sum();
            out.probabilities = weights.map(|w| w / total);
        }
        Ok((out, evidence))
    }
}

/// Mean and covariance of a mixture; `weights` add up to 1.
fn matched<const N: usize>(beliefs: &[Belief<N>], weights: &[f64]) -> Belief<N> {
    // Relative to one of them, so that equal means are exactly theirs.
    let origin = beliefs[0].mean;
    let mut mean = origin;
    for (belief, weight) in beliefs.iter().zip(weights) {
        mean += (belief.mean - origin) * *weight;
    }
    let mut cov = Matrix::zeros();
    for (belief, weight) in beliefs.iter().zip(weights) {
        let apart = belief.mean - mean;
        cov += (belief.cov + apart * apart.transpose()) * *weight;
    }
    Belief { mean, cov }
}

/// Logarithm of the normal density at squared distance `fit`, in units of the variance `s`.
fn log_normal(fit: f64, s: f64) -> f64 {
    -0.5 * (fit + libm::log(core::f64::consts::TAU * s))
}

/// Logarithm of what any mode has to give a row that it does not expect, ε.
fn log_outlier<const N: usize>(prior: &Belief<N>, row: &Row<N>) -> f64 {
    log_normal(MISFIT, row.h.dot(&(prior.cov * row.h)) + row.var)
}

/// Returns `log(e^a + e^b)`; `b` is finite.
fn log_sum(a: f64, b: f64) -> f64 {
    a.max(b) + libm::log1p(libm::exp(-(a - b).abs()))
}
