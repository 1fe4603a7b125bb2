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
    /// Motion from one measurement to the next.
    pub leap: Leap<f64, N>,
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
        let (leap, start) = (problem.leap, Chain::of(&problem.start));
        // Without losses the gains do not depend on the track: one sequence for all.
        let mut gains: Vec<[f64; N]> = Vec::new();
        let mut z = z.chunks_exact(block);
        let mut out = out.chunks_exact_mut(block * N);
        for (z, out) in z.by_ref().zip(out.by_ref()) {
            let lossless = !z.iter().any(|z| z.is_nan());
            if lossless && gains.is_empty() {
                gains = sequence(&leap, &start, problem.var, steps);
            }
            let common = (&leap, &start, problem.var);
            if lossless { shared(simd, common, &gains, z, out) } else { own(simd, common, z, steps, out) }
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

/// Gains of a track without losses.
#[inline(always)]
fn sequence<const N: usize>(leap: &Leap<f64, N>, start: &Chain<f64, N>, var: f64, steps: usize) -> Vec<[f64; N]> {
    let mut belief = *start;
    let next = |_| {
        let gain;
        (belief, gain) = belief.predict(leap).update(0.0, var);
        gain
    };
    (0..steps).map(next).collect()
}

/// As many tracks as fill the registers, each with a covariance of its own.
#[inline(always)]
fn own<S: Simd, const N: usize>(
    simd: S,
    (leap, start, var): (&Leap<f64, N>, &Chain<f64, N>, f64),
    z: &[f64],
    steps: usize,
    out: &mut [f64],
) {
    let splat = |value| Wide::splat(simd, value);
    let (leap, mut belief, var) = (leap.map(splat), start.map(splat), splat(var));
    tiles::<S, N>(
        simd,
        z,
        steps,
        out,
        #[inline(always)]
        |_, z| {
            belief = belief.predict(&leap).update(z, var).0;
            belief.mean
        },
    );
}

/// As many tracks as fill the registers, with the gains of all.
#[inline(always)]
fn shared<S: Simd, const N: usize>(
    simd: S,
    (leap, start, _): (&Leap<f64, N>, &Chain<f64, N>, f64),
    gains: &[[f64; N]],
    z: &[f64],
    out: &mut [f64],
) {
    let splat = |value| Wide::splat(simd, value);
    let (leap, mut mean) = (leap.map(splat), start.map(splat).mean);
    tiles::<S, N>(
        simd,
        z,
        gains.len(),
        out,
        #[inline(always)]
        |k, z| {
            mean = leap.moved(&mean);
            let e = z - mean[0];
            for (mean, gain) in mean.iter_mut().zip(&gains[k]) {
                *mean = *mean + splat(*gain) * e;
            }
            mean
        },
    );
}

/// Turns measurements from tracks in rows to instants in rows and means back, a tile at a time; `step` takes the measurements of an instant.
#[inline(always)]
fn tiles<S: Simd, const N: usize>(
    simd: S,
    z: &[f64],
    steps: usize,
    out: &mut [f64],
    mut step: impl FnMut(usize, Wide<S>) -> [Wide<S>; N],
) {
    let tracks = Wide::<S>::TRACKS;
    let mut tile = [[f64::NAN; MOST]; TILE];
    let mut means = [[[0.0; MOST]; N]; TILE];
    let whole = steps / TILE * TILE;
    for k in (0..whole).step_by(TILE) {
        for track in 0..tracks {
            // Of a length that the compiler knows, so that it unrolls.
            let Some(row) = z[track * steps + k..].first_chunk::<TILE>() else { return };
            for i in 0..TILE {
                tile[i][track] = row[i];
            }
        }
        for i in 0..TILE {
            let mean = step(k + i, Wide::load(simd, &tile[i]));
            for (mean, row) in mean.iter().zip(&mut means[i]) {
                mean.store(row);
            }
        }
        for track in 0..tracks {
            let (rows, _) = out[(track * steps + k) * N..].as_chunks_mut::<N>();
            let Some(rows) = rows.first_chunk_mut::<TILE>() else { return };
            for i in 0..TILE {
                for (out, mean) in rows[i].iter_mut().zip(&means[i]) {
                    *out = mean[track];
                }
            }
        }
    }
    for k in whole..steps {
        for track in 0..tracks {
            tile[0][track] = z[track * steps + k];
        }
        let mean = step(k, Wide::load(simd, &tile[0]));
        for (i, mean) in mean.iter().enumerate() {
            mean.store(&mut means[0][i]);
            for track in 0..tracks {
                out[(track * steps + k) * N + i] = means[0][i][track];
            }
        }
    }
}
