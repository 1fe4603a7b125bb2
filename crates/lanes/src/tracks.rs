//! Kalman filters of chains of integrators, many tracks side by side.

use crate::tiles::tiles;
use crate::wide::Wide;
use fixtrail_core::Belief;
use fixtrail_core::kernels::{Chain, Leap};
use pulp::{Arch, Simd, WithSimd};

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
            let lossless = complete(z);
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

/// Whether nothing is lost. Blocks without a branch, so that they are compared as wide as the machine can.
#[inline(always)]
fn complete(z: &[f64]) -> bool {
    let lost = |z: &[f64]| z.iter().fold(false, |lost, z| lost | z.is_nan());
    let (blocks, rest) = z.as_chunks::<64>();
    !blocks.iter().any(|block| lost(block)) && !lost(rest)
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
    tiles::<S, 1, N>(
        simd,
        z,
        steps,
        out,
        #[inline(always)]
        |_, [z]| {
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
    tiles::<S, 1, N>(
        simd,
        z,
        gains.len(),
        out,
        #[inline(always)]
        |k, [z]| {
            mean = leap.moved(&mean);
            let e = z - mean[0];
            for (mean, gain) in mean.iter_mut().zip(&gains[k]) {
                *mean = *mean + splat(*gain) * e;
            }
            mean
        },
    );
}
