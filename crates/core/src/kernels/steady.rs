//! A whole series of one track, with the gain kept once it no longer changes.
//!
//! Without losses and with one interval the covariance is a sequence of its own: it runs into a fixed point of the arithmetic, or into a
//! cycle of values that differ in the last bits. Once a covariance has come again, bit for bit, all that follow will, and only the mean has to
//! be carried on with the gains of that cycle. The estimates are the same bits as without the shortcut.
//!
//! Cycles are found as by Brent: each covariance is compared with one that is remembered, and what is remembered is renewed after twice as
//! many steps each time.

use super::{Chain, Leap};

/// Longest cycle that is kept.
pub const LONGEST_CYCLE: usize = 32;

/// Runs a series: each step predicts, then takes one of `z` (NaN: lost), and writes the mean. Returns the belief after the last and the first
/// step, from 0, that was taken with a kept gain.
///
/// `out` and `z` are equally long; what is beyond the shorter is left alone.
#[inline(always)]
pub fn series<const N: usize>(
    start: &Chain<f64, N>,
    leap: &Leap<f64, N>,
    var: f64,
    z: &[f64],
    out: &mut [[f64; N]],
) -> (Chain<f64, N>, Option<usize>) {
    let mut belief = *start;
    let mut first_kept = None;
    let mut gains = [[0.0; N]; LONGEST_CYCLE];
    let count = z.len().min(out.len());
    let mut k = 0;
    while k < count {
        let mut cycle = Cycle::new(&belief.cov);
        let mut period = None;
        while k < count && period.is_none() {
            let gain;
            (belief, gain) = belief.predict(leap).update(z[k], var);
            out[k] = belief.mean;
            k += 1;
            if z[k - 1].is_nan() {
                break;
            }
            gains[cycle.since % LONGEST_CYCLE] = gain;
            period = cycle.closes(&belief.cov);
        }
        let Some(period) = period else { continue };
        // Gains of one cycle stand in order, the covariance is that at its end.
        let kept = leap.keep(&gains[..period], &mut belief.mean, &z[k..count], &mut out[k..count]);
        if kept > 0 {
            first_kept = first_kept.or(Some(k));
        }
        k += kept;
        // Within the cycle the covariance has gone on by the steps taken of it.
        for _ in 0..kept % period {
            belief.cov = belief.predict(leap).update(0.0, var).0.cov;
        }
    }
    (belief, first_kept)
}

/// Looks for a covariance that comes again, bit for bit.
pub(super) struct Cycle<const N: usize> {
    remembered: [[f64; N]; N],
    /// Steps since the remembered one.
    pub(super) since: usize,
    renewal: usize,
}

impl<const N: usize> Cycle<N> {
    /// Remembers the covariance of the last loss or start: until it is renewed nothing is equal to it by chance.
    #[inline(always)]
    pub(super) fn new(cov: &[[f64; N]; N]) -> Self {
        Cycle { remembered: *cov, since: 0, renewal: 1 }
    }

    /// Takes the covariance of the next step; the length of the cycle that it closes, if it is one that is kept.
    #[inline(always)]
    pub(super) fn closes(&mut self, cov: &[[f64; N]; N]) -> Option<usize> {
        self.since += 1;
        if same(cov, &self.remembered) {
            return (self.since <= LONGEST_CYCLE).then_some(self.since);
        }
        if self.since == self.renewal {
            *self = Cycle { remembered: *cov, since: 0, renewal: self.renewal.saturating_mul(2) };
        }
        None
    }
}

impl<const N: usize> Leap<f64, N> {
    /// Carries a mean on with the gains of a cycle in turn, up to the first loss; how many steps that are.
    #[inline(always)]
    pub(super) fn keep(&self, gains: &[[f64; N]], mean: &mut [f64; N], z: &[f64], out: &mut [[f64; N]]) -> usize {
        let mut k = 0;
        let mut now = *mean;
        'kept: loop {
            for gain in gains {
                if k == z.len() || z[k].is_nan() {
                    break 'kept;
                }
                now = self.moved(&now);
                let e = z[k] - now[0];
                for i in 0..N {
                    now[i] += gain[i] * e;
                }
                out[k] = now;
                k += 1;
            }
        }
        *mean = now;
        k
    }
}

/// Whether two upper triangles are equal, bit for bit.
#[inline(always)]
fn same<const N: usize>(a: &[[f64; N]; N], b: &[[f64; N]; N]) -> bool {
    (0..N).all(|i| (i..N).all(|j| a[i][j].to_bits() == b[i][j].to_bits()))
}
