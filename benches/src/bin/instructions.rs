//! One kernel, a number of steps: what `scripts/instructions` counts the instructions of.
//!
//! ```text
//! instructions KERNEL STEPS      without arguments: the kernels, one a line
//! ```

use fixtrail_core::estimators::fms::Align;
use fixtrail_core::estimators::fms::gain::Shape;
use fixtrail_core::estimators::fms::invariant::{InvariantWindow, Model};
use fixtrail_core::estimators::kalman::{Robust, predict, update};
use fixtrail_core::kernels::{Axes, Chain, Dense, FixedLag, Leap, Packed, Sliding, Turn};
use fixtrail_core::models::{CoordinatedTurn, FmsPaper, Integrators};
use fixtrail_core::sensors::position;
use fixtrail_core::storage::Fixed;
use fixtrail_core::{Belief, Matrix, Vector};
use std::hint::black_box;
use std::process::ExitCode;

type Run = fn(usize);

const KERNELS: [(&str, Run); 13] = [
    ("chain", chain),
    ("axes", axes),
    ("fixed lag n=3 d=5", fixed_lag),
    ("dense n=3 q=1", dense::<3, 1>),
    ("dense n=4 q=2", dense::<4, 2>),
    ("turn and range", turn),
    ("kalman n=3 q=1", kalman),
    ("sliding gain n=3 M=15", sliding::<3>),
    ("sliding gain n=6 M=15", sliding::<6>),
    ("3x15 product of nalgebra", product),
    ("fms push n=3 M=15", |steps| fms(steps, 0, false)),
    ("fms push and estimate n=3 M=15", |steps| fms(steps, 0, true)),
    ("fms push and estimate n=3 M=15 d=5", |steps| fms(steps, 5, true)),
];

/// The measurement of step k.
fn z(k: usize) -> f64 {
    black_box((k % 64) as f64)
}

fn start<const N: usize>() -> Belief<N> {
    Belief { mean: Vector::zeros(), cov: Matrix::identity() * 25.0 }
}

fn chain(steps: usize) {
    let (mut belief, leap) = (Chain::of(&start::<3>()), Leap::<f64, 3>::new(0.01, 2.0));
    for k in 0..steps {
        belief = black_box(&belief).predict(&leap).checked_update(z(k), 0.0025).expect("finite data").0;
    }
    black_box(belief);
}

fn axes(steps: usize) {
    let (one, leap) = (Chain::of(&start::<2>()), Leap::<f64, 2>::new(0.1, 1.0));
    let mut belief = Axes { means: [one.mean; 2], cov: one.cov };
    for k in 0..steps {
        belief = black_box(&belief).predict(&leap).update(&[z(k), z(k + 1)], 0.25);
    }
    black_box(belief);
}

fn fixed_lag(steps: usize) {
    let (mut lagged, leap) = (FixedLag::<3, 5>::new(&Chain::of(&start())), Leap::<f64, 3>::new(0.01, 2.0));
    for k in 0..steps {
        lagged.push(&leap, 0.0025, z(k));
        black_box(lagged.mean());
    }
}

fn dense<const N: usize, const Q: usize>(steps: usize) {
    let (a, q) = (Matrix::<N, N>::from_fn(|i, j| if i <= j { 0.9 } else { 0.0 }), Matrix::identity() * 0.1);
    let motion = black_box(Dense::new(&a, &q));
    let rows: [[f64; N]; Q] = black_box(std::array::from_fn(|i| std::array::from_fn(|j| f64::from(u8::from(i == j)))));
    let mut belief = Packed::of(&start::<N>());
    for k in 0..steps {
        let mut next = black_box(&belief).predict(&motion);
        let mut least = f64::INFINITY;
        for row in &rows {
            let s;
            (next, s) = next.measure(row, z(k), 0.25);
            least = least.min(s);
        }
        belief = next.checked(least).expect("finite data");
    }
    black_box(belief);
}

fn turn(steps: usize) {
    let motion = CoordinatedTurn::new([0.1, 0.1], 0.01).expect("sound densities");
    let (mut belief, motion) = (Packed::of(&start::<5>()), Turn::new(&motion, 0.1));
    for k in 0..steps {
        let (next, s) = black_box(&belief).predict(&motion).range(&[-60.0, 60.0], 80.0 + z(k) / 64.0, 0.01);
        belief = next.checked(s).expect("finite data");
    }
    black_box(belief);
}

fn kalman(steps: usize) {
    let motion = Integrators::<3>::new(3, 1, [0.01, 0.0, 0.0]).expect("a sound model");
    let leap = motion.leap(&Vector::zeros(), 2.0);
    let mut belief = start::<3>();
    for k in 0..steps {
        let mut leap = leap;
        leap.next = leap.f * black_box(&belief).mean;
        let prior = predict(&belief, &leap);
        belief = update(&prior, &[position(&prior.mean, 0, z(k), 0.0025)], Robust::None).expect("finite data").0;
    }
    black_box(belief);
}

fn sliding<const N: usize>(steps: usize) {
    let mut window = Sliding::<N, 15>::new(&black_box([[0.1; N]; 15]));
    for k in 0..steps {
        black_box(window.push(z(k)));
    }
}

fn product(steps: usize) {
    let (gain, window) = (black_box(Matrix::<3, 15>::repeat(0.1)), Vector::<15>::repeat(1.0));
    for _ in 0..steps {
        black_box(gain * black_box(&window));
    }
}

fn fms(steps: usize, lag: usize, estimate: bool) {
    let paper = FmsPaper::new(2.0);
    let shape = Shape { window: 15, lag, align: Align::Predicted };
    let model = Model { a: &paper.a, w: &paper.motion().q, b: &[], c: &[paper.c], r: &[paper.r] };
    let mut window = InvariantWindow::<3, Fixed<30>>::new(&model, shape).expect("room for the window");
    for k in 0..steps {
        window.push(&[Some(z(k))], &[]).expect("room for the window");
        if estimate && k >= 14 {
            black_box(&window.estimate());
        }
    }
    black_box(&window);
}

fn main() -> ExitCode {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [name, steps] = &args[..] else {
        KERNELS.iter().for_each(|(name, _)| println!("{name}"));
        return ExitCode::SUCCESS;
    };
    match (KERNELS.iter().find(|(known, _)| known == name), steps.parse()) {
        (Some((_, run)), Ok(steps)) => run(steps),
        _ => {
            eprintln!("usage: instructions KERNEL STEPS");
            return ExitCode::from(2);
        }
    }
    ExitCode::SUCCESS
}
