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
        // The remembered covariance is that of the last loss or start: until it is renewed nothing is equal to it by chance.
        let (mut remembered, mut since, mut renewal) = (belief.cov, 0, 1);
        let mut period = None;
        while k < count && period.is_none() {
            let gain;
            (belief, gain) = belief.predict(leap).update(z[k], var);
            out[k] = belief.mean;
            if z[k].is_nan() {
                k += 1;
                break;
            }
            k += 1;
            gains[since % LONGEST_CYCLE] = gain;
            since += 1;
            if same(&belief.cov, &remembered) {
                period = (since <= LONGEST_CYCLE).then_some(since);
            } else if since == renewal {
                (remembered, since, renewal) = (belief.cov, 0, renewal.saturating_mul(2));
            }
        }
        let Some(period) = period else { continue };
        // Gains of one cycle stand in order, the covariance is that at its end.
        let from = k;
        let mut mean = belief.mean;
        'kept: loop {
            for gain in &gains[..period] {
                if k == count || z[k].is_nan() {
                    break 'kept;
                }
                mean = leap.moved(&mean);
                let e = z[k] - mean[0];
                for i in 0..N {
                    mean[i] += gain[i] * e;
                }
                out[k] = mean;
                k += 1;
            }
        }
        if k > from {
            first_kept = first_kept.or(Some(from));
        }
        // Within the cycle the covariance has gone on by the steps taken of it.
        for _ in 0..(k - from) % period {
            belief = belief.predict(leap).update(0.0, var).0;
        }
        belief.mean = mean;
    }
    (belief, first_kept)
}

/// Whether two upper triangles are equal, bit for bit.
#[inline(always)]
fn same<const N: usize>(a: &[[f64; N]; N], b: &[[f64; N]; N]) -> bool {
    (0..N).all(|i| (i..N).all(|j| a[i][j].to_bits() == b[i][j].to_bits()))
}
