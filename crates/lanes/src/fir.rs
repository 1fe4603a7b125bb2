//! Finite impulse responses of a whole series: what a time-invariant finite-memory filter or smoother is once its gain is designed.

use crate::wide::Wide;
use pulp::{Arch, Simd, WithSimd};

/// Most instants at a time: two registers of AVX-512.
const MOST: usize = 16;

/// Writes `Σ_j gain[j] z[k + j]` for every k with a whole window: `N` numbers each, the oldest measurement has the first gain. Sums run from the oldest to
/// the newest, for every instant alike.
///
/// A gain is a column of the matrix that [`fixtrail_core::estimators::fms::gain`] designs. What is beyond the shorter of the series and the room for it is left
/// alone.
///
/// # Panics
/// When there is no gain.
pub fn convolve<const N: usize>(gain: &[[f64; N]], z: &[f64], out: &mut [[f64; N]]) {
    assert!(!gain.is_empty(), "a window without a gain");
    let count = (z.len() + 1).saturating_sub(gain.len()).min(out.len());
    Arch::new().dispatch(Series { gain, z, out: &mut out[..count] });
}

struct Series<'a, const N: usize> {
    gain: &'a [[f64; N]],
    z: &'a [f64],
    out: &'a mut [[f64; N]],
}

impl<const N: usize> WithSimd for Series<'_, N> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Series { gain, z, out } = self;
        let wide = Wide::<S>::TRACKS;
        let mut k = 0;
        let mut room = [[0.0; MOST]; N];
        while k + wide <= out.len() {
            let mut sums = [Wide::splat(simd, 0.0); N];
            for (j, gain) in gain.iter().enumerate() {
                let z = Wide::load(simd, &z[k + j..k + j + wide]);
                for (sum, gain) in sums.iter_mut().zip(gain) {
                    *sum = *sum + Wide::splat(simd, *gain) * z;
                }
            }
            for (sum, row) in sums.iter().zip(&mut room) {
                sum.store(row);
            }
            for (i, out) in out[k..k + wide].iter_mut().enumerate() {
                for (out, row) in out.iter_mut().zip(&room) {
                    *out = row[i];
                }
            }
            k += wide;
        }
        for (k, out) in out.iter_mut().enumerate().skip(k) {
            *out = [0.0; N];
            for (gain, z) in gain.iter().zip(&z[k..]) {
                for (out, gain) in out.iter_mut().zip(gain) {
                    *out += gain * z;
                }
            }
        }
    }
}
