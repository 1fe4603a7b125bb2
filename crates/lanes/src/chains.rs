//! Kalman filters of chains of integrators, many tracks side by side, each at instants of its own.

use crate::tiles::tiles;
use crate::wide::{MOST, Wide};
use fixtrail_core::kernels::{Chain, Leap, Real};
use pulp::{Arch, Simd, WithSimd};

/// What all tracks have in common.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Integrators {
    /// Density of the white noise at the last derivative.
    pub psd: f64,
    /// Variance of a measurement.
    pub var: f64,
    /// Whether the first instant of the call has an interval before it.
    pub goes_on: bool,
}

/// Filters some instants of tracks, `steps` of each: takes what is known of each of them to its newest instant.
///
/// `input[(track * steps + k) * 2..]` are the seconds since the instant before and the measurement (NaN: lost).
/// `out[(track * steps + k) * M..]` are, after the update, the mean, the upper triangle of the covariance row by row, and of the measurement
/// its innovation (NaN: lost) and the variance of that. Where a track has fewer instants, what stands behind them does not matter to these.
///
/// # Panics
/// When `steps` is 0, `M` is not `N + N(N+1)/2 + 2`, or `input` and `out` have not as many numbers as `tracks` ask for.
pub fn integrators<const N: usize, const M: usize>(
    problem: &Integrators,
    tracks: &mut [Chain<f64, N>],
    input: &[f64],
    steps: usize,
    out: &mut [f64],
) {
    const { assert!(M == N + N * (N + 1) / 2 + 2, "as many numbers as an estimate and its innovation have") };
    assert!(steps > 0, "tracks without a step");
    assert_eq!(input.len(), tracks.len() * steps * 2, "two numbers an instant");
    assert_eq!(out.len(), tracks.len() * steps * M, "room for {M} numbers an instant");
    Arch::new().dispatch(Tracks::<N, M> { problem, tracks, input, steps, out });
}

/// How many tracks are side by side on this machine.
pub fn side_by_side() -> usize {
    struct Width;
    impl WithSimd for Width {
        type Output = usize;

        fn with_simd<S: Simd>(self, _: S) -> usize {
            Wide::<S>::TRACKS
        }
    }
    Arch::new().dispatch(Width)
}

/// A call that is compiled once for every set of vector instructions.
struct Tracks<'a, const N: usize, const M: usize> {
    problem: &'a Integrators,
    tracks: &'a mut [Chain<f64, N>],
    input: &'a [f64],
    steps: usize,
    out: &'a mut [f64],
}

impl<const N: usize, const M: usize> WithSimd for Tracks<'_, N, M> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Tracks { problem, tracks, input, steps, out } = self;
        let block = Wide::<S>::TRACKS * steps;
        let mut tracks = tracks.chunks_exact_mut(Wide::<S>::TRACKS);
        let mut input = input.chunks_exact(block * 2);
        let mut out = out.chunks_exact_mut(block * M);
        let (psd, var) = (Wide::splat(simd, problem.psd), Wide::splat(simd, problem.var));
        for ((tracks, input), out) in tracks.by_ref().zip(input.by_ref()).zip(out.by_ref()) {
            let mut belief = load(simd, tracks);
            tiles::<S, 2, M>(
                simd,
                input,
                steps,
                out,
                #[inline(always)]
                |k, [dt_s, z]| instant(&mut belief, problem.goes_on || k > 0, (psd, var), (dt_s, z)),
            );
            store(&belief, tracks);
        }
        // What fills no block runs alone.
        let each = input.remainder().chunks_exact(steps * 2).zip(out.into_remainder().chunks_exact_mut(steps * M));
        for (belief, (input, out)) in tracks.into_remainder().iter_mut().zip(each) {
            for (k, ([dt_s, z], out)) in input.as_chunks::<2>().0.iter().zip(out.as_chunks_mut::<M>().0).enumerate() {
                *out = instant(belief, problem.goes_on || k > 0, (problem.psd, problem.var), (*dt_s, *z));
            }
        }
    }
}

/// What is known of tracks, side by side.
#[inline(always)]
fn load<S: Simd, const N: usize>(simd: S, tracks: &[Chain<f64, N>]) -> Chain<Wide<S>, N> {
    let blank = Wide::splat(simd, 0.0);
    let mut belief = Chain { mean: [blank; N], cov: [[blank; N]; N] };
    for i in 0..N {
        belief.mean[i] = Wide::gather(
            simd,
            tracks,
            #[inline(always)]
            |track| track.mean[i],
        );
        for j in i..N {
            belief.cov[i][j] = Wide::gather(
                simd,
                tracks,
                #[inline(always)]
                |track| track.cov[i][j],
            );
        }
    }
    belief
}

/// The opposite of [`load`].
#[inline(always)]
fn store<S: Simd, const N: usize>(belief: &Chain<Wide<S>, N>, tracks: &mut [Chain<f64, N>]) {
    let mut row = [0.0; MOST];
    for i in 0..N {
        belief.mean[i].store(&mut row);
        for (number, track) in row.iter().zip(tracks.iter_mut()) {
            track.mean[i] = *number;
        }
        for j in i..N {
            belief.cov[i][j].store(&mut row);
            for (number, track) in row.iter().zip(tracks.iter_mut()) {
                track.cov[i][j] = *number;
            }
        }
    }
}

/// Takes a belief over an interval, unless it is the first instant, and through a measurement.
#[inline(always)]
fn instant<T: Real, const N: usize, const M: usize>(
    belief: &mut Chain<T, N>,
    moves: bool,
    (psd, var): (T, T),
    (dt_s, z): (T, T),
) -> [T; M] {
    if moves {
        *belief = belief.predict(&Leap::over(psd, dt_s));
    }
    let (e, s) = (z - belief.mean[0], belief.cov[0][0] + var);
    *belief = belief.update(z, var).0;
    let mut out = [s; M];
    out[..N].copy_from_slice(&belief.mean);
    let mut at = N;
    for i in 0..N {
        for j in i..N {
            out[at] = belief.cov[i][j];
            at += 1;
        }
    }
    out[at] = e;
    out
}
