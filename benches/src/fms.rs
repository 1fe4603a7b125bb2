//! Finite-memory filter and smoother: the paper's model, window and lag, every measurement received.

use crate::input::{measured, path_m};
use crate::race::{Contender, Settings, race};
use fixtrail_core::estimators::fms::Align;
use fixtrail_core::estimators::fms::gain::Shape;
use fixtrail_core::estimators::fms::invariant::{InvariantWindow, Model};
use fixtrail_core::kernels::Sliding;
use fixtrail_core::models::FmsPaper;
use fixtrail_core::storage::Fixed;
use fixtrail_core::{Matrix, Vector};

const WINDOW: usize = 15;
const LAG: usize = 5;
const INTERVAL_S: f64 = 2.0;

/// Fixtrail's window: the doubled ring of its data needs twice the window.
type Window = InvariantWindow<3, Fixed<{ 2 * WINDOW }>>;

fn window(paper: &FmsPaper, lag: usize) -> Result<Window, String> {
    let shape = Shape { window: WINDOW, lag, align: Align::Predicted };
    let model = Model { a: &paper.a, w: &paper.motion().q, b: &[], c: &[paper.c], r: &[paper.r] };
    Window::new(&model, shape).map_err(|e| e.to_string())
}

/// Runs Fixtrail over a series and hands each full window's estimates, newest and lagged, to `take`.
fn slide(paper: &FmsPaper, lag: usize, z: &[[f64; 1]], mut take: impl FnMut(usize, Vector<3>, Vector<3>)) {
    let mut window = window(paper, lag).expect("checked before the race");
    for (k, z) in z.iter().enumerate() {
        window.push(&[Some(z[0])], &[]).expect("room for the window");
        if let Some(at) = (k + 1).checked_sub(WINDOW) {
            let joint = window.estimate();
            let (newest, lagged) = joint.filter.zip(joint.lagged).expect("an observable window");
            take(at, newest.mean, lagged.mean);
        }
    }
}

/// The gain for the state `end` steps after the start of the window, oldest measurement first, by the dense formula with the
/// state at the start as the unknown.
///
/// `Z = O s + Ψ W + V`, `x = Φ s + Θ W`: with `S = ΨQΨᵀ + R`, `N = OᵀS⁻¹O`, `K₂ = ΘQΨᵀS⁻¹`, the best linear unbiased gain is
/// `(Φ − K₂O) N⁻¹OᵀS⁻¹ + K₂`.
fn dense_gain(paper: &FmsPaper, end: usize) -> Option<Matrix<3, WINDOW>> {
    let mut powers = [Matrix::<3, 3>::identity(); WINDOW + 1];
    let mut observe = Matrix::<WINDOW, 3>::zeros();
    for k in 0..WINDOW {
        observe.set_row(k, &(paper.c.transpose() * powers[k]));
        powers[k + 1] = paper.a * powers[k];
    }
    let mut s = Matrix::<WINDOW, WINDOW>::identity() * paper.r;
    let mut cross = Matrix::<3, WINDOW>::zeros();
    for j in 0..WINDOW {
        // What the noise between instants j and j + 1 adds to each measurement and to the estimated state.
        let mut psi = Matrix::<WINDOW, 2>::zeros();
        for k in j + 1..WINDOW {
            psi.set_row(k, &(paper.c.transpose() * powers[k - 1 - j] * paper.g));
        }
        s += psi * paper.q * psi.transpose();
        if j < end {
            cross += powers[end - 1 - j] * paper.g * paper.q * psi.transpose();
        }
    }
    let s = s.cholesky()?;
    let weighted = s.solve(&observe);
    let information = (observe.transpose() * weighted).cholesky()?;
    let second = s.solve(&cross.transpose()).transpose();
    let rest = powers[end] - second * observe;
    Some(rest * information.solve(&weighted.transpose()) + second)
}

/// What one writes with nalgebra alone: the gain times the last measurements, once per step.
fn multiply<const ROWS: usize>(gain: &Matrix<ROWS, WINDOW>, z: &[[f64; 1]], out: &mut [f64]) {
    for (window, out) in z.as_flattened().windows(WINDOW).zip(out.as_chunks_mut::<ROWS>().0) {
        *out = (gain * Vector::<WINDOW>::from_column_slice(window)).into();
    }
}

/// The same product written out, where the compiler cannot take two steps at once, which no window that is pushed to allows. Without nalgebra, whose
/// product is no longer inlined, and takes twice the time, once it is used twice.
fn multiply_one<const ROWS: usize>(gain: &[[f64; ROWS]; WINDOW], z: &[[f64; 1]], out: &mut [f64]) {
    for (window, out) in z.as_flattened().windows(WINDOW).zip(out.as_chunks_mut::<ROWS>().0) {
        let mut sum = [0.0; ROWS];
        for (gain, z) in gain.iter().zip(window) {
            for (sum, gain) in sum.iter_mut().zip(gain) {
                *sum += gain * z;
            }
        }
        *out = sum;
        std::hint::black_box(out);
    }
}

/// Pushes a series into a window, one measurement at a time.
fn glide<const ROWS: usize>(gain: &Matrix<ROWS, WINDOW>, z: &[f64], out: &mut [[f64; ROWS]]) {
    let mut window = Sliding::new(&columns(gain));
    let mut out = out.iter_mut();
    for z in z {
        if let Some(estimate) = window.push(*z)
            && let Some(out) = out.next()
        {
            *out = estimate;
        }
    }
}

/// A gain, measurement by measurement.
fn columns<const ROWS: usize>(gain: &Matrix<ROWS, WINDOW>) -> [[f64; ROWS]; WINDOW] {
    std::array::from_fn(|j| gain.column(j).into())
}

/// The model (16) with a window of 15 and a lag of 5, the estimates from z_{i-15} … z_{i-1}.
pub fn paper(settings: &Settings) -> Result<(), String> {
    let paper = FmsPaper::new(INTERVAL_S);
    window(&paper, 0)?;
    window(&paper, LAG)?;
    let unobservable = "the paper's window does not determine the state";
    let filter = dense_gain(&paper, WINDOW).ok_or(unobservable)?;
    let smoother = dense_gain(&paper, WINDOW - LAG).ok_or(unobservable)?;
    let mut both = Matrix::<6, WINDOW>::zeros();
    both.fixed_rows_mut::<3>(0).copy_from(&filter);
    both.fixed_rows_mut::<3>(3).copy_from(&smoother);
    // One estimate per step: the first needs a whole window.
    let z = measured(settings.steps + WINDOW - 1, settings.seed, 0.05, |k| [path_m(k as f64 * INTERVAL_S / 300.0)[0]]);

    let filters = [
        Contender::new("fixtrail", |out| {
            let out = out.as_chunks_mut::<3>().0;
            slide(&paper, 0, &z, |at, newest, _| out[at] = newest.into());
        }),
        Contender::new("fixtrail, sliding gain", |out| {
            glide(&filter, z.as_flattened(), out.as_chunks_mut::<3>().0);
        }),
        Contender::new("fixtrail, a whole series", |out| {
            fixtrail_lanes::convolve(&columns(&filter), z.as_flattened(), out.as_chunks_mut::<3>().0);
        }),
        Contender::new("3x15 product, one step at a time", |out| multiply_one(&columns(&filter), &z, out)),
        Contender::new("nalgebra 0.35, 3x15 product", |out| multiply(&filter, &z, out)),
    ];
    race("fms filter, n=3 M=15", 3, settings, &filters)?;
    let pairs = [
        Contender::new("fixtrail", |out| {
            let out = out.as_chunks_mut::<6>().0;
            slide(&paper, LAG, &z, |at, newest, lagged| {
                out[at][..3].copy_from_slice(newest.as_slice());
                out[at][3..].copy_from_slice(lagged.as_slice());
            });
        }),
        Contender::new("fixtrail, sliding gain", |out| {
            glide(&both, z.as_flattened(), out.as_chunks_mut::<6>().0);
        }),
        Contender::new("fixtrail, a whole series", |out| {
            fixtrail_lanes::convolve(&columns(&both), z.as_flattened(), out.as_chunks_mut::<6>().0);
        }),
        Contender::new("6x15 product, one step at a time", |out| multiply_one(&columns(&both), &z, out)),
        Contender::new("nalgebra 0.35, 6x15 product", |out| multiply(&both, &z, out)),
    ];
    race("fms filter and smoother, n=3 M=15 d=5", 6, settings, &pairs)
}
