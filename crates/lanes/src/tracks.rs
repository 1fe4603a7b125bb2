//! Kalman filters of chains of integrators, many tracks side by side.

use crate::wide::Wide;
use fixtrail_core::Belief;
use fixtrail_core::kernels::{Chain, Leap};
use pulp::{Arch, Simd, WithSimd};

/// Most tracks side by side: two registers of AVX-512.
const MOST: usize = 16;
/// Steps of a tile: what of the tracks is turned from rows to columns at a time.
const TILE: usize = 8;

/// What all tracks have in common.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Problem<const N: usize> {
    /// Density of the noise at the last derivative.
    pub psd: f64,
    /// Interval between two measurements, s.
    pub dt_s: f64,
    /// Variance of a measurement.
    pub var: f64,
    /// Where every track starts, before the first interval.
    pub start: Belief<N>,
}

/// Filters tracks of `steps` measurements each (NaN: lost) and writes every mean after its update. What does not fill a track is left alone.
///
/// # Panics
/// When `steps` is 0, or `out` has not `N` numbers for each of `z`.
pub fn filter<const N: usize>(problem: &Problem<N>, z: &[f64], steps: usize, out: &mut [f64]) {
    assert!(steps > 0, "tracks without a step");
    assert_eq!(out.len(), z.len() * N, "room for {N} numbers a step");
    Arch::new().dispatch(Tracks { problem, z, steps, out });
}

/// A call that is compiled once for every set of vector instructions.
struct Tracks<'a, const N: usize> {
    problem: &'a Problem<N>,
    z: &'a [f64],
    steps: usize,
    out: &'a mut [f64],
}

impl<const N: usize> WithSimd for Tracks<'_, N> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Tracks { problem, z, steps, out } = self;
        let block = Wide::<S>::TRACKS * steps;
        let (leap, start) = (Leap::<f64, N>::new(problem.psd, problem.dt_s), Chain::of(&problem.start));
        let mut z = z.chunks_exact(block);
        let mut out = out.chunks_exact_mut(block * N);
        for (z, out) in z.by_ref().zip(out.by_ref()) {
            wide(simd, (&leap, &start, problem.var), z, steps, out);
        }
        // What fills no block runs alone.
        let (z, out) = (z.remainder().chunks_exact(steps), out.into_remainder().chunks_exact_mut(steps * N));
        for (z, out) in z.zip(out) {
            let mut belief = start;
            for (z, out) in z.iter().zip(out.as_chunks_mut::<N>().0) {
                belief = belief.predict(&leap).update(*z, problem.var).0;
                *out = belief.mean;
            }
        }
    }
}

/// As many tracks as fill the registers.
#[inline(always)]
fn wide<S: Simd, const N: usize>(
    simd: S,
    (leap, start, var): (&Leap<f64, N>, &Chain<f64, N>, f64),
    z: &[f64],
    steps: usize,
    out: &mut [f64],
) {
    let tracks = Wide::<S>::TRACKS;
    let splat = |value| Wide::splat(simd, value);
    let (leap, mut belief, var) = (leap.map(splat), start.map(splat), splat(var));
    let mut tile = [[0.0; MOST]; TILE];
    let mut means = [[[0.0; MOST]; N]; TILE];
    let mut k = 0;
    while k < steps {
        let count = TILE.min(steps - k);
        for track in 0..tracks {
            let row = &z[track * steps + k..track * steps + k + count];
            for (column, z) in tile.iter_mut().zip(row) {
                column[track] = *z;
            }
        }
        for (z, means) in tile[..count].iter().zip(&mut means) {
            belief = belief.predict(&leap).update(Wide::load(simd, z), var).0;
            for (mean, row) in belief.mean.iter().zip(means) {
                mean.store(row);
            }
        }
        for track in 0..tracks {
            let row = &mut out[(track * steps + k) * N..(track * steps + k + count) * N];
            for (out, means) in row.as_chunks_mut::<N>().0.iter_mut().zip(&means) {
                for i in 0..N {
                    out[i] = means[i][track];
                }
            }
        }
        k += count;
    }
}
