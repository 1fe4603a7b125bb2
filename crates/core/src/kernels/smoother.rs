//! The fixed-interval smoother of a chain, without inverting a covariance: modified Bryson–Frazier \[BIE73\].
//!
//! ```text
//! forward    x_k, P_k after z_k, and of the update: gain K_k, e_k/s_k, 1/s_k
//! backward   λ = 0, Λ = 0 at the end; smoothed x_k − P_k λ, covariance P_k − P_k Λ P_k; then over z_k
//!            λ ← (I − K H)ᵀ λ − Hᵀ e/s      Λ ← (I − K H)ᵀ Λ (I − K H) + Hᵀ H/s      (a lost z_k changes neither)
//!            and over the interval before it
//!            λ ← Fᵀ λ                       Λ ← Fᵀ Λ F
//! ```
//!
//! H picks the position, so that the first line changes one component of λ and one row of Λ.

use super::chain::Drift;
use super::packed::at;
use super::{Chain, Leap};

/// What the way back needs of one step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Past<const N: usize> {
    /// Mean and covariance after the measurement.
    pub(super) filtered: Chain<f64, N>,
    gain: [f64; N],
    /// Innovation over its variance; 0 of a lost measurement.
    pull: f64,
    /// One over the innovation variance; 0 of a lost measurement.
    weight: f64,
}

impl<const N: usize> Past<N> {
    /// Room for a step.
    pub const EMPTY: Past<N> =
        Past { filtered: Chain { mean: [0.0; N], cov: [[0.0; N]; N] }, gain: [0.0; N], pull: 0.0, weight: 0.0 };

    /// A step from its prediction and measurement (NaN: lost).
    #[inline(always)]
    pub(super) fn of(prior: &Chain<f64, N>, var: f64, z: f64) -> Self {
        let (filtered, gain) = prior.update(z, var);
        let weight = if z.is_nan() { 0.0 } else { 1.0 / (prior.cov[0][0] + var) };
        let pull = if z.is_nan() { 0.0 } else { (z - prior.mean[0]) * weight };
        Past { filtered, gain, pull, weight }
    }

    /// λ back over the measurement.
    #[inline(always)]
    pub(super) fn before_mean(&self, lambda: &[f64; N]) -> [f64; N] {
        let mut out = *lambda;
        // (I − K H)ᵀ v = v − e_0 (K · v); the first component last, for it comes last from the step after.
        let mut sum = self.pull;
        for j in (0..N).rev() {
            sum += self.gain[j] * lambda[j];
        }
        out[0] -= sum;
        out
    }
}

/// Smooths a series: each step predicts, then takes one of `z` (NaN: lost); `out` gets the mean of every step given all of `z`. `past` is room
/// for as many steps.
///
/// What is beyond the shortest of the three is left alone.
#[inline(always)]
pub fn smooth<const N: usize>(
    start: &Chain<f64, N>,
    leap: &Leap<f64, N>,
    var: f64,
    z: &[f64],
    past: &mut [Past<N>],
    out: &mut [[f64; N]],
) {
    smooth_with(start, leap, var, z, past, out, |_, _| ());
}

/// As [`smooth`]; `covariance` is told each step's number and covariance (upper triangle), from the last to the first.
#[inline(always)]
pub fn smooth_with<const N: usize>(
    start: &Chain<f64, N>,
    leap: &Leap<f64, N>,
    var: f64,
    z: &[f64],
    past: &mut [Past<N>],
    out: &mut [[f64; N]],
    mut covariance: impl FnMut(usize, &[[f64; N]; N]),
) {
    let mut belief = *start;
    for (z, past) in z.iter().zip(past.iter_mut()) {
        *past = Past::of(&belief.predict(leap), var, *z);
        belief = past.filtered;
    }
    let count = z.len().min(past.len()).min(out.len());
    let mut adjoint = Adjoint::NONE;
    for k in (0..count).rev() {
        let (mean, cov) = adjoint.correct(&past[k].filtered);
        out[k] = mean;
        covariance(k, &cov);
        adjoint = adjoint.over(&past[k]).earlier(&leap.drift);
    }
}

/// λ and Λ; of Λ the upper triangle.
#[derive(Clone, Copy)]
pub(super) struct Adjoint<const N: usize> {
    pub(super) lambda: [f64; N],
    pub(super) big: [[f64; N]; N],
}

impl<const N: usize> Adjoint<N> {
    /// Behind the last measurement.
    pub(super) const NONE: Adjoint<N> = Adjoint { lambda: [0.0; N], big: [[0.0; N]; N] };

    /// The smoothed mean of a filtered belief.
    #[inline(always)]
    pub(super) fn mean(&self, filtered: &Chain<f64, N>) -> [f64; N] {
        let mut mean = filtered.mean;
        for i in 0..N {
            for a in 0..N {
                mean[i] -= at(&filtered.cov, i, a) * self.lambda[a];
            }
        }
        mean
    }

    /// The smoothed mean and covariance of a filtered belief.
    #[inline(always)]
    pub(super) fn correct(&self, filtered: &Chain<f64, N>) -> ([f64; N], [[f64; N]; N]) {
        let p = &filtered.cov;
        let mut half = [[0.0; N]; N];
        for i in 0..N {
            for a in 0..N {
                for b in 0..N {
                    half[i][b] += at(p, i, a) * at(&self.big, a, b);
                }
            }
        }
        let mut cov = *p;
        for i in 0..N {
            for j in i..N {
                for b in 0..N {
                    cov[i][j] -= half[i][b] * at(p, b, j);
                }
            }
        }
        (self.mean(filtered), cov)
    }

    /// Back over a measurement.
    #[inline(always)]
    pub(super) fn over(&self, past: &Past<N>) -> Self {
        let gain = &past.gain;
        let mut out = Adjoint { lambda: past.before_mean(&self.lambda), big: self.big };
        // With t = Λ K the first row of Λ loses t, and its corner twice t_0 less K · t.
        let mut corner = past.weight;
        for j in 0..N {
            let mut t = 0.0;
            for a in 0..N {
                t += at(&self.big, j, a) * gain[a];
            }
            corner += gain[j] * t;
            out.big[0][j] -= t;
            if j == 0 {
                corner -= t;
            }
        }
        out.big[0][0] += corner;
        out
    }

    /// Back over an interval.
    #[inline(always)]
    pub(super) fn earlier(&self, drift: &Drift<f64, N>) -> Self {
        Adjoint { lambda: drift.back(&self.lambda), big: drift.back_spread(&self.big) }
    }
}
