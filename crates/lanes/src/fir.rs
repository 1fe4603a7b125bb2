//! Finite impulse responses of a whole series: what a time-invariant finite-memory filter or smoother is once its gain is designed.

use pulp::{Arch, Simd, WithSimd, bytemuck};

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
        // As many sums as leave room for measurements and a gain in the sixteen registers of AVX2.
        let Series { gain, z, out } = self;
        let k = if N <= 3 { whole::<S, N, 3>(simd, gain, z, out) } else { whole::<S, N, 2>(simd, gain, z, out) };
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

/// Writes as many instants as fill `DEEP` registers at a time, and returns how many these were.
#[inline(always)]
fn whole<S: Simd, const N: usize, const DEEP: usize>(
    simd: S,
    gain: &[[f64; N]],
    z: &[f64],
    out: &mut [[f64; N]],
) -> usize {
    let wide = DEEP * S::F64_LANES;
    let mut k = 0;
    while k + wide <= out.len() {
        let mut sums = [[simd.splat_f64s(0.0); N]; DEEP];
        for (j, gain) in gain.iter().enumerate() {
            let (z, _) = S::as_simd_f64s(&z[k + j..k + j + wide]);
            for (i, gain) in gain.iter().enumerate() {
                let gain = simd.splat_f64s(*gain);
                for deep in 0..DEEP {
                    sums[deep][i] = simd.add_f64s(sums[deep][i], simd.mul_f64s(gain, z[deep]));
                }
            }
        }
        for (sums, out) in sums.iter().zip(out[k..k + wide].chunks_exact_mut(S::F64_LANES)) {
            rows::<S, N>(sums, out);
        }
        k += wide;
    }
    k
}

/// Turns numbers of several instants, a register for each component, to rows.
#[inline(always)]
fn rows<S: Simd, const N: usize>(sums: &[S::f64s; N], out: &mut [[f64; N]]) {
    let numbers: &[f64] = bytemuck::cast_slice(sums);
    // Of a length that the compiler knows, so that it shuffles registers; more rows than these are quicker through memory.
    if let (4, true, Some(out)) = (S::F64_LANES, N <= 3, out.first_chunk_mut::<4>()) {
        for i in 0..N {
            for lane in 0..4 {
                out[lane][i] = numbers[i * 4 + lane];
            }
        }
        return;
    }
    for (lane, out) in out.iter_mut().enumerate() {
        for (i, out) in out.iter_mut().enumerate() {
            *out = numbers[i * S::F64_LANES + lane];
        }
    }
}
