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

use super::{Chain, Leap};

/// What the way back needs of one step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Past<const N: usize> {
    /// Mean and covariance after the measurement.
    filtered: Chain<f64, N>,
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
        let prior = belief.predict(leap);
        let gain;
        (belief, gain) = prior.update(*z, var);
        let weight = if z.is_nan() { 0.0 } else { 1.0 / (prior.cov[0][0] + var) };
        let pull = if z.is_nan() { 0.0 } else { (z - prior.mean[0]) * weight };
        *past = Past { filtered: belief, gain, pull, weight };
    }
    let count = z.len().min(past.len()).min(out.len());
    let mut adjoint = Adjoint { lambda: [0.0; N], big: [[0.0; N]; N] };
    for k in (0..count).rev() {
        let Past { filtered, gain, pull, weight } = &past[k];
        let (mean, cov) = adjoint.correct(filtered);
        out[k] = mean;
        covariance(k, &cov);
        adjoint = adjoint.before(gain, *pull, *weight).earlier(leap);
    }
}

/// λ and Λ; of Λ the upper triangle.
#[derive(Clone, Copy)]
struct Adjoint<const N: usize> {
    lambda: [f64; N],
    big: [[f64; N]; N],
}

/// An entry of a symmetric matrix of which the upper triangle is kept.
#[inline(always)]
fn at<const N: usize>(m: &[[f64; N]; N], i: usize, j: usize) -> f64 {
    if i <= j { m[i][j] } else { m[j][i] }
}

impl<const N: usize> Adjoint<N> {
    /// The smoothed mean and covariance of a filtered belief.
    #[inline(always)]
    fn correct(&self, filtered: &Chain<f64, N>) -> ([f64; N], [[f64; N]; N]) {
        let p = &filtered.cov;
        let mut mean = filtered.mean;
        let mut half = [[0.0; N]; N];
        for i in 0..N {
            for a in 0..N {
                mean[i] -= at(p, i, a) * self.lambda[a];
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
        (mean, cov)
    }

    /// Back over a measurement.
    #[inline(always)]
    fn before(&self, gain: &[f64; N], pull: f64, weight: f64) -> Self {
        let mut out = *self;
        // (I − K H)ᵀ v = v − e_0 (K · v); with t = Λ K the first row of Λ loses t, and its corner twice t_0 less K · t.
        let mut corner = weight;
        for j in 0..N {
            out.lambda[0] -= gain[j] * self.lambda[j];
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
        out.lambda[0] -= pull;
        out.big[0][0] += corner;
        out
    }

    /// Back over an interval.
    #[inline(always)]
    fn earlier(&self, leap: &Leap<f64, N>) -> Self {
        Adjoint { lambda: leap.back(&self.lambda), big: leap.back_spread(&self.big) }
    }
}
