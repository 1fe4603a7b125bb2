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
//!
//! Where the gain is kept (see [`series`](super::series())) the covariances are those of one cycle, so that a step leaves nothing behind but
//! its mean: e comes again from the mean of the step before.

use super::chain::Drift;
use super::packed::at;
use super::steady::{Cycle, LONGEST_CYCLE};
use super::{Chain, Leap};

/// A measurement as the way back needs it, besides the mean after it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Taken<const N: usize> {
    /// Covariance after the measurement, upper triangle.
    pub(super) cov: [[f64; N]; N],
    gain: [f64; N],
    /// One over the innovation variance; 0 of a lost measurement.
    weight: f64,
}

impl<const N: usize> Taken<N> {
    pub(super) const EMPTY: Taken<N> = Taken { cov: [[0.0; N]; N], gain: [0.0; N], weight: 0.0 };

    /// A measurement (NaN: lost) of what was predicted, and the mean after it.
    #[inline(always)]
    pub(super) fn of(prior: &Chain<f64, N>, var: f64, z: f64) -> (Self, [f64; N]) {
        let (Chain { mean, cov }, gain) = prior.update(z, var);
        let weight = if z.is_nan() { 0.0 } else { 1.0 / (prior.cov[0][0] + var) };
        (Taken { cov, gain, weight }, mean)
    }

    /// Innovation of a measurement (NaN: lost) at the predicted position over its variance.
    #[inline(always)]
    pub(super) fn pull(&self, predicted: f64, z: f64) -> f64 {
        if z.is_nan() { 0.0 } else { (z - predicted) * self.weight }
    }

    /// λ back over the measurement.
    #[inline(always)]
    pub(super) fn before_mean(&self, lambda: &[f64; N], pull: f64) -> [f64; N] {
        let mut out = *lambda;
        // (I − K H)ᵀ v = v − e_0 (K · v); the first component last, for it comes last from the step after.
        let mut sum = pull;
        for j in (0..N).rev() {
            sum += self.gain[j] * lambda[j];
        }
        out[0] -= sum;
        out
    }
}

/// What the way back needs of one step besides its mean, and how many steps are like it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Past<const N: usize> {
    taken: Taken<N>,
    /// How many steps follow that are like this one and those before it in a cycle of `period`, in turn.
    kept: usize,
    period: usize,
}

impl<const N: usize> Past<N> {
    /// Room for a step.
    pub const EMPTY: Past<N> = Past { taken: Taken::EMPTY, kept: 0, period: 0 };
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
    let count = z.len().min(past.len()).min(out.len());
    let (z, out) = (&z[..count], &mut out[..count]);
    let left = forward(start, leap, var, z, past, out);
    let mut steps = Backward::from(&past[..left]);
    let mut adjoint = Adjoint::NONE;
    for k in (0..count).rev() {
        let taken = steps.step();
        let before = if k > 0 { &out[k - 1] } else { &start.mean };
        let pull = taken.pull(leap.moved(before)[0], z[k]);
        let (mean, cov) = adjoint.correct(&Chain { mean: out[k], cov: taken.cov });
        out[k] = mean;
        covariance(k, &cov);
        adjoint = adjoint.over(taken, pull).earlier(&leap.drift);
    }
}

/// The steps of a series from the last to the first.
struct Backward<'a, const N: usize> {
    /// Those that have not been handed out.
    left: &'a [Past<N>],
    /// How many that are like the last of `left` and those before it come before those, and where in the cycle the next one is.
    kept: usize,
    at: usize,
}

impl<'a, const N: usize> Backward<'a, N> {
    #[inline(always)]
    fn from(left: &'a [Past<N>]) -> Self {
        match left.last() {
            Some(Past { kept, period, .. }) if *kept > 0 => Backward { left, kept: *kept, at: (kept - 1) % period },
            _ => Backward { left, kept: 0, at: 0 },
        }
    }

    /// The next. There must be one.
    #[inline(always)]
    fn step(&mut self) -> &'a Taken<N> {
        let last = self.left.len() - 1;
        let past = &self.left[last];
        if self.kept == 0 {
            *self = Backward::from(&self.left[..last]);
            return &past.taken;
        }
        let like = &self.left[last + 1 - past.period + self.at];
        self.kept -= 1;
        self.at = if self.at == 0 { past.period - 1 } else { self.at - 1 };
        &like.taken
    }
}

/// The way forward: means into `out`, the steps that are not like others into `past`. Returns how many those are.
#[inline(always)]
fn forward<const N: usize>(
    start: &Chain<f64, N>,
    leap: &Leap<f64, N>,
    var: f64,
    z: &[f64],
    past: &mut [Past<N>],
    out: &mut [[f64; N]],
) -> usize {
    let mut belief = *start;
    let (mut k, mut left) = (0, 0);
    while k < z.len() {
        let mut cycle = Cycle::new(&belief.cov);
        let mut period = None;
        while k < z.len() && period.is_none() {
            let (taken, mean) = Taken::of(&belief.predict(leap), var, z[k]);
            (past[left], out[k]) = (Past { taken, kept: 0, period: 0 }, mean);
            belief = Chain { mean, cov: taken.cov };
            (left, k) = (left + 1, k + 1);
            if z[k - 1].is_nan() {
                break;
            }
            period = cycle.closes(&belief.cov);
        }
        let Some(period) = period else { continue };
        let mut gains = [[0.0; N]; LONGEST_CYCLE];
        for (gain, step) in gains.iter_mut().zip(&past[left - period..left]) {
            *gain = step.taken.gain;
        }
        let kept = leap.keep(&gains[..period], &mut belief.mean, &z[k..], &mut out[k..]);
        (past[left - 1].kept, past[left - 1].period) = (kept, period);
        k += kept;
        // Within the cycle the covariance has gone on by the steps taken of it.
        if !kept.is_multiple_of(period) {
            belief.cov = past[left - period + kept % period - 1].taken.cov;
        }
    }
    left
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
    pub(super) fn over(&self, taken: &Taken<N>, pull: f64) -> Self {
        let gain = &taken.gain;
        let mut out = Adjoint { lambda: taken.before_mean(&self.lambda, pull), big: self.big };
        // With t = Λ K the first row of Λ loses t, and its corner twice t_0 less K · t.
        let mut corner = taken.weight;
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

#[cfg(test)]
mod tests {
    extern crate std;

    use super::*;
    use std::vec;
    use std::vec::Vec;

    /// The same without a kept gain.
    fn plain<const N: usize>(start: &Chain<f64, N>, leap: &Leap<f64, N>, var: f64, z: &[f64]) -> Vec<[u64; N]> {
        let mut belief = *start;
        let mut steps = Vec::new();
        for z in z {
            let prior = belief.predict(leap);
            let (taken, mean) = Taken::of(&prior, var, *z);
            belief = Chain { mean, cov: taken.cov };
            steps.push((taken, mean, taken.pull(prior.mean[0], *z)));
        }
        let mut adjoint = Adjoint::NONE;
        let mut out = Vec::new();
        for (taken, mean, pull) in steps.iter().rev() {
            out.push(adjoint.correct(&Chain { mean: *mean, cov: taken.cov }).0.map(f64::to_bits));
            adjoint = adjoint.over(taken, *pull).earlier(&leap.drift);
        }
        out.reverse();
        out
    }

    fn keeps_every_bit<const N: usize>() {
        let (mut kept, mut cycles) = (0, 0);
        for case in 0..60 {
            let (psd, var) = (0.3 + f64::from(case), 0.5 + 0.01 * f64::from(case * case));
            let leap = Leap::new(psd, 0.7);
            let mut cov = [[0.0; N]; N];
            (0..N).for_each(|i| cov[i][i] = 4.0);
            let start = Chain { mean: [1.0; N], cov };
            // Losses now and then, in a row, at the end, and none at all.
            let lost = |k: i32| case % 3 > 0 && (k % 140 == 120 || k % 311 < 3) || case % 3 == 2 && k > 900;
            let z: Vec<f64> =
                (0..905).map(|k| if lost(k) { f64::NAN } else { 9.0 * (f64::from(k * k) * 0.37).sin() }).collect();
            let mut past = vec![Past::EMPTY; z.len()];
            let mut out = vec![[0.0; N]; z.len()];
            smooth(&start, &leap, var, &z, &mut past, &mut out);
            let bits: Vec<[u64; N]> = out.iter().map(|mean| mean.map(f64::to_bits)).collect();
            assert_eq!(bits, plain(&start, &leap, var, &z), "case {case}");
            kept += past.iter().map(|past| past.kept).sum::<usize>();
            cycles += past.iter().filter(|past| past.kept > 0 && past.period > 1).count();
        }
        assert!(kept > 20_000 && (N == 1 || cycles > 5), "{kept} steps kept, {cycles} in cycles");
    }

    #[test]
    fn kept_gains_smooth_to_the_same_bits() {
        keeps_every_bit::<1>();
        keeps_every_bit::<2>();
        keeps_every_bit::<3>();
    }
}
