//! Kalman filters of any linear model, many tracks side by side.

use crate::tiles::tiles;
use crate::wide::Wide;
use fixtrail_core::kernels::{Dense, Packed};
use pulp::{Arch, Simd, WithSimd};

/// What all tracks have in common: `N` states, `Q` measured components whose noise is uncorrelated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Linear<const N: usize, const Q: usize> {
    /// Motion from one measurement to the next.
    pub motion: Dense<f64, N>,
    /// Rows of C.
    pub rows: [[f64; N]; Q],
    /// Variance of each component.
    pub vars: [f64; Q],
    /// Where every track starts, before the first interval.
    pub start: Packed<f64, N>,
}

/// Filters tracks of `steps` instants each, `z[(track * steps + k) * Q + i]` (NaN: lost), and writes every mean after its update. What does not
/// fill a track is left alone.
///
/// # Panics
/// When `steps` or `Q` is 0, or `out` has not `N` numbers for each `Q` of `z`.
pub fn linear<const N: usize, const Q: usize>(problem: &Linear<N, Q>, z: &[f64], steps: usize, out: &mut [f64]) {
    assert!(steps > 0 && Q > 0, "tracks without a measurement");
    assert_eq!(out.len() * Q, z.len() * N, "room for {N} numbers an instant");
    Arch::new().dispatch(Tracks { problem, z, steps, out });
}

/// A call that is compiled once for every set of vector instructions.
struct Tracks<'a, const N: usize, const Q: usize> {
    problem: &'a Linear<N, Q>,
    z: &'a [f64],
    steps: usize,
    out: &'a mut [f64],
}

impl<const N: usize, const Q: usize> WithSimd for Tracks<'_, N, Q> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Tracks { problem, z, steps, out } = self;
        let Linear { motion, rows, vars, start } = problem;
        let block = Wide::<S>::TRACKS * steps;
        let mut z = z.chunks_exact(block * Q);
        let mut out = out.chunks_exact_mut(block * N);
        let splat = |value| Wide::splat(simd, value);
        let many = (motion.map(splat), rows.map(|row| row.map(splat)), vars.map(splat));
        for (z, out) in z.by_ref().zip(out.by_ref()) {
            let mut belief = start.map(splat);
            tiles::<S, Q, N>(
                simd,
                z,
                steps,
                out,
                #[inline(always)]
                |_, z| {
                    belief = belief.predict(&many.0);
                    for i in 0..Q {
                        belief = belief.measure(&many.1[i], z[i], many.2[i]).0;
                    }
                    belief.mean
                },
            );
        }
        // What fills no block runs alone.
        let tracks = z.remainder().chunks_exact(steps * Q).zip(out.into_remainder().chunks_exact_mut(steps * N));
        for (z, out) in tracks {
            let mut belief = *start;
            for (z, out) in z.as_chunks::<Q>().0.iter().zip(out.as_chunks_mut::<N>().0) {
                belief = belief.predict(motion);
                for i in 0..Q {
                    belief = belief.measure(&rows[i], z[i], vars[i]).0;
                }
                *out = belief.mean;
            }
        }
    }
}
