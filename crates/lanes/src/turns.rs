//! Extended Kalman filters of targets that turn, ranges measured, many tracks side by side.

use crate::tiles::tiles;
use crate::wide::Wide;
use fixtrail_core::kernels::{Packed, Turn};
use pulp::{Arch, Simd, WithSimd};

/// What all tracks have in common.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ranging<'a> {
    /// Motion from one measurement to the next.
    pub motion: Turn<f64>,
    /// Where distances are measured to, metres: step k has the anchor k modulo their number.
    pub anchors_m: &'a [[f64; 2]],
    /// Variance of a distance, m².
    pub var: f64,
}

/// Filters tracks of `steps` distances each (NaN: lost), each from its own start, and writes every mean after its update. What does not fill a track,
/// or has no start, is left alone.
///
/// # Panics
/// When `steps` is 0, there is no anchor, or `out` has not 5 numbers for each of `z`.
pub fn range(problem: &Ranging<'_>, starts: &[Packed<f64, 5>], z: &[f64], steps: usize, out: &mut [f64]) {
    assert!(steps > 0, "tracks without a step");
    assert!(!problem.anchors_m.is_empty(), "distances to no anchor");
    assert_eq!(out.len(), z.len() * 5, "room for 5 numbers a step");
    let tracks = starts.len().min(z.len() / steps);
    let (z, out) = (&z[..tracks * steps], &mut out[..tracks * steps * 5]);
    Arch::new().dispatch(Tracks { problem, starts: &starts[..tracks], z, steps, out });
}

/// A call that is compiled once for every set of vector instructions.
struct Tracks<'a> {
    problem: &'a Ranging<'a>,
    starts: &'a [Packed<f64, 5>],
    z: &'a [f64],
    steps: usize,
    out: &'a mut [f64],
}

impl WithSimd for Tracks<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Tracks { problem, starts, z, steps, out } = self;
        let Ranging { motion, anchors_m, var } = *problem;
        let block = Wide::<S>::TRACKS * steps;
        let mut starts = starts.chunks_exact(Wide::<S>::TRACKS);
        let mut z = z.chunks_exact(block);
        let mut out = out.chunks_exact_mut(block * 5);
        let splat = |value| Wide::splat(simd, value);
        let (turn, many_var) = (motion.map(splat), splat(var));
        for ((starts, z), out) in starts.by_ref().zip(z.by_ref()).zip(out.by_ref()) {
            let mut belief = gathered(simd, starts);
            tiles::<S, 1, 5>(
                simd,
                z,
                steps,
                out,
                #[inline(always)]
                |k, [z]| {
                    let [x, y] = anchors_m[k % anchors_m.len()];
                    belief = belief.predict(&turn).range(&[splat(x), splat(y)], z, many_var).0;
                    belief.mean
                },
            );
        }
        // What fills no block runs alone.
        let tracks = z.remainder().chunks_exact(steps).zip(out.into_remainder().chunks_exact_mut(steps * 5));
        for (start, (z, out)) in starts.remainder().iter().zip(tracks) {
            let mut belief = *start;
            for (k, (z, out)) in z.iter().zip(out.as_chunks_mut::<5>().0).enumerate() {
                belief = belief.predict(&motion).range(&anchors_m[k % anchors_m.len()], *z, var).0;
                *out = belief.mean;
            }
        }
    }
}

/// Beliefs of as many tracks as fill the registers.
#[inline(always)]
fn gathered<S: Simd, const N: usize>(simd: S, tracks: &[Packed<f64, N>]) -> Packed<Wide<S>, N> {
    let mut out = Packed { mean: [Wide::splat(simd, 0.0); N], cov: [[Wide::splat(simd, 0.0); N]; N] };
    for i in 0..N {
        out.mean[i] = Wide::gather(
            simd,
            tracks,
            #[inline(always)]
            |track| track.mean[i],
        );
        for j in i..N {
            out.cov[i][j] = Wide::gather(
                simd,
                tracks,
                #[inline(always)]
                |track| track.cov[i][j],
            );
        }
    }
    out
}
