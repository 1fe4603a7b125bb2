//! What an estimate costs against the size of the problem, and what a live target takes of memory.

use crate::input::{measured, path_m};
use crate::race::Settings;
use fixtrail_core::estimators::alpha_beta::AlphaBeta;
use fixtrail_core::estimators::emvf::Emvf;
use fixtrail_core::estimators::fms::Align;
use fixtrail_core::estimators::fms::gain::Shape;
use fixtrail_core::estimators::fms::invariant::{InvariantWindow, Model};
use fixtrail_core::estimators::fms::varying::Varying;
use fixtrail_core::estimators::fosb::FosbAxes;
use fixtrail_core::estimators::gpb1::Gpb1;
use fixtrail_core::estimators::imm::Imm;
use fixtrail_core::estimators::lmmse::Lmmse;
use fixtrail_core::estimators::lmvf::Lmvf;
use fixtrail_core::estimators::ufir::Ufir;
use fixtrail_core::kernels::{Axes, Chain, Dense, FixedLag, Leap, Packed};
use fixtrail_core::models::FmsPaper;
use fixtrail_core::storage::Store;
use fixtrail_core::{Belief, Matrix, Vector};
use fixtrail_lanes::{Integrators, Linear, Problem, filter, integrators, linear};
use std::cell::Cell;
use std::hint::black_box;
use std::thread;
use std::time::Instant;

/// Storage that counts what it lends.
#[derive(Clone, Copy)]
struct Heap;

thread_local! {
    static LENT: Cell<usize> = const { Cell::new(0) };
}

impl Store for Heap {
    type Of<T: Copy> = Vec<T>;

    fn filled<T: Copy>(len: usize, value: T) -> Option<Vec<T>> {
        LENT.set(LENT.get() + len * size_of::<T>());
        Some(vec![value; len])
    }
}

/// Bytes of a value, and of what it has borrowed from [`Heap`].
fn bytes<T>(make: impl FnOnce() -> T) -> usize {
    LENT.set(0);
    let value = make();
    let lent = LENT.get();
    drop(value);
    size_of::<T>() + lent
}

/// Median time of `steps` estimates, ns each.
fn time(settings: &Settings, steps: usize, mut run: impl FnMut()) -> f64 {
    let mut ns: Vec<f64> = (0..settings.rounds)
        .map(|_| {
            let start = Instant::now();
            run();
            start.elapsed().as_secs_f64() * 1e9 / steps as f64
        })
        .collect();
    ns.sort_by(f64::total_cmp);
    ns[ns.len() / 2]
}

fn title(text: &str, cells: &[String]) {
    print!("\n{text:<52}");
    row(cells);
}

fn row(cells: &[String]) {
    cells.iter().for_each(|cell| print!(" {cell:>8}"));
    println!();
}

fn line(name: &str, ns: impl IntoIterator<Item = f64>) {
    print!("  {name:<50}");
    row(&ns.into_iter().map(|ns| if ns.is_nan() { String::new() } else { format!("{ns:.1}") }).collect::<Vec<_>>());
}

fn line_of(name: &str, bytes: &[usize]) {
    print!("  {name:<50}");
    row(&bytes.iter().map(usize::to_string).collect::<Vec<_>>());
}

/// Loses measurements evenly, at any rate, shifted by track.
fn losing(lost: f64, track: usize, z: &mut [f64]) {
    if lost > 0.0 {
        for (k, z) in z.iter_mut().enumerate() {
            let before = ((k + track) as f64 * lost).floor();
            if ((k + track + 1) as f64 * lost).floor() > before {
                *z = f64::NAN;
            }
        }
    }
}

fn series(steps: usize, seed: u64) -> Vec<f64> {
    measured(steps, seed, 0.05, |k| [path_m(k as f64 * 2.0 / 300.0)[0]]).into_iter().map(|[z]| z).collect()
}

/// The general kernel, `N` states and `Q` measured components.
fn general<const N: usize, const Q: usize>(settings: &Settings) -> f64 {
    let a = Matrix::<N, N>::from_fn(|i, j| if i == j { 0.95 } else { 0.02 / (1 + i + j) as f64 });
    let rows = std::array::from_fn(|i| std::array::from_fn(|j| if i == j { 1.0 } else { 0.1 }));
    let start = Packed::of(&Belief { mean: Vector::zeros(), cov: Matrix::identity() });
    let problem = Linear { motion: Dense::new(&a, &(Matrix::identity() * 0.1)), rows, vars: [0.2; Q], start };
    let z: Vec<f64> = series(settings.steps * Q, settings.seed);
    let mut out = vec![0.0; settings.steps * N];
    time(settings, settings.steps, || linear(&problem, black_box(&z), settings.steps, &mut out))
}

fn many(settings: &Settings, tracks: usize, steps: usize, lost: f64) -> f64 {
    shared(settings, tracks, steps, lost, 1)
}

/// Tracks side by side, as many on each thread.
fn shared(settings: &Settings, tracks: usize, steps: usize, lost: f64, threads: usize) -> f64 {
    let start = Belief { mean: Vector::zeros(), cov: Matrix::identity() * 25.0 };
    let problem = Problem::<3> { leap: Leap::new(0.01, 2.0), var: 0.0025, start };
    let mut z = Vec::new();
    for track in 0..tracks {
        let mut one = series(steps, settings.seed + track as u64 % 64);
        losing(lost, track, &mut one);
        z.extend(one);
    }
    let mut out = vec![0.0; z.len() * 3];
    let part = tracks.div_ceil(threads) * steps;
    time(settings, tracks * steps, || {
        thread::scope(|scope| {
            let mut parts = black_box(&z).chunks(part).zip(out.chunks_mut(3 * part));
            let own = parts.next();
            for (z, out) in parts {
                scope.spawn(|| filter(&problem, z, steps, out));
            }
            if let Some((z, out)) = own {
                filter(&problem, z, steps, out);
            }
        });
    })
}

/// Tracks of position and velocity at instants of their own, 64 instants a call, at most so many tracks a call.
fn own_instants(settings: &Settings, tracks: usize, at_once: usize) -> f64 {
    const STEPS: usize = 64;
    let instants = settings.steps / STEPS / tracks * STEPS;
    let track = |track: usize| {
        let z = series(instants, settings.seed + track as u64);
        z.into_iter().enumerate().map(move |(k, z)| [1.0 + 0.1 * ((k + track) % 7) as f64, z]).collect::<Vec<_>>()
    };
    let all: Vec<Vec<[f64; 2]>> = (0..tracks).map(track).collect();
    let start = Chain { mean: [0.0; 2], cov: [[25.0, 0.0], [0.0, 1.0]] };
    let (mut input, mut out) = (Vec::new(), vec![0.0; 7 * STEPS * at_once]);
    time(settings, tracks * instants, || {
        for tracks in all.chunks(at_once) {
            let mut beliefs = vec![start; tracks.len()];
            for k in (0..instants).step_by(STEPS) {
                input.clear();
                tracks.iter().for_each(|track| input.extend_from_slice(track[k..k + STEPS].as_flattened()));
                let problem = Integrators { psd: 0.01, var: 0.0025, goes_on: k > 0 };
                integrators::<2, 7>(
                    &problem,
                    &mut beliefs,
                    black_box(&input),
                    STEPS,
                    &mut out[..7 * STEPS * tracks.len()],
                );
                black_box(&out);
            }
        }
    })
}

fn shape(window: usize) -> Shape {
    Shape { window, lag: 0, align: Align::Predicted }
}

fn window(window: usize) -> InvariantWindow<3, Heap> {
    let paper = FmsPaper::new(2.0);
    let model = Model { a: &paper.a, w: &paper.motion().q, b: &[], c: &[paper.c], r: &[paper.r] };
    InvariantWindow::new(&model, shape(window)).expect("a sound model")
}

fn finite_memory(settings: &Settings, length: usize, lost: f64) -> f64 {
    let mut held = window(length);
    let steps = (settings.steps / 16).max(2 * length);
    let mut z = series(steps, settings.seed);
    losing(lost, 0, &mut z);
    // Some rounds are enough where an estimate takes microseconds.
    let few = Settings { rounds: settings.rounds.min(9), ..*settings };
    let mut run = || {
        for z in &z {
            held.push(&[(!z.is_nan()).then_some(*z)], &[]).expect("room for the window");
            black_box(held.estimate());
        }
    };
    // The window is full from here on.
    run();
    time(&few, steps, run)
}

/// Prints all tables.
pub fn tables(settings: &Settings) {
    let names = |of: &[usize]| of.iter().map(usize::to_string).collect::<Vec<_>>();
    let percent = |of: &[f64]| of.iter().map(|p| format!("{:.0} %", 100.0 * p)).collect::<Vec<_>>();

    title("general kernel, one series, states", &names(&[2, 3, 4, 6, 9]));
    let s = settings;
    line(
        "1 measured, ns a step",
        [general::<2, 1>(s), general::<3, 1>(s), general::<4, 1>(s), general::<6, 1>(s), general::<9, 1>(s)],
    );
    line(
        "2 measured",
        [general::<2, 2>(s), general::<3, 2>(s), general::<4, 2>(s), general::<6, 2>(s), general::<9, 2>(s)],
    );
    line("3 measured", [f64::NAN, general::<3, 3>(s), general::<4, 3>(s), general::<6, 3>(s), general::<9, 3>(s)]);

    let tracks = [8, 64, 512, 4096];
    title("side by side, n=3 q=1, tracks", &names(&tracks));
    for lost in [0.0, 0.2] {
        line(&format!("{:.0} % lost, ns an estimate", 100.0 * lost), tracks.map(|tracks| many(s, tracks, 100, lost)));
    }
    let lengths = [10, 100, 1000, 10_000];
    title("side by side, 8 tracks, steps", &names(&lengths));
    line("nothing lost, ns an estimate", lengths.map(|steps| many(s, 8, steps, 0.0)));
    line("20 % lost", lengths.map(|steps| many(s, 8, steps, 0.2)));
    let rates = [0.0, 0.01, 0.1, 0.3, 0.6];
    title("side by side, 64 tracks x 800, lost", &percent(&rates));
    line("ns an estimate", rates.map(|lost| many(s, 64, 800, lost)));

    let threads = [1, 2];
    title("side by side, 512 tracks x 800, threads", &names(&threads));
    for lost in [0.0, 0.2] {
        let of = |threads| shared(s, 512, 800, lost, threads);
        line(&format!("{:.0} % lost, ns an estimate", 100.0 * lost), threads.map(of));
    }

    let at_once = [1, 2, 4, 8, 16];
    title("at instants of their own, n=2, tracks at once", &names(&at_once));
    line("estimates with their covariances, ns each", at_once.map(|at_once| own_instants(s, 16, at_once)));

    let windows = [5, 15, 29, 60, 200, 1000];
    title("fms, n=3, push and estimate, window", &names(&windows));
    for lost in [0.0, 0.1, 0.3] {
        line(&format!("{:.0} % lost, ns an estimate", 100.0 * lost), windows.map(|m| finite_memory(s, m, lost)));
    }

    title("bytes of a live target, states", &names(&[2, 3, 4, 6]));
    let size = |name: &str, of: [usize; 4]| line_of(name, &of);
    macro_rules! each {
        ($name:literal, |$n:ident| $value:expr) => {
            size(
                $name,
                [
                    {
                        const $n: usize = 2;
                        $value
                    },
                    {
                        const $n: usize = 3;
                        $value
                    },
                    {
                        const $n: usize = 4;
                        $value
                    },
                    {
                        const $n: usize = 6;
                        $value
                    },
                ],
            )
        };
    }
    each!("kalman, ekf: Belief", |N| size_of::<Belief<N>>());
    each!("kernels: Packed", |N| size_of::<Packed<f64, N>>());
    each!("imm, two modes", |N| size_of::<Imm<N>>());
    each!("lmvf (held values, 2 measured)", |N| size_of::<Lmvf<N, 2>>());
    each!("lmmse (held values, 2 measured)", |N| size_of::<Lmmse<N, 2>>());
    each!("emvf (held values, 2 measured)", |N| size_of::<Emvf<N, 2>>());
    each!("gpb1 (held values, 2 measured)", |N| size_of::<Gpb1<N, 2>>());
    each!("varying window of 15", |N| bytes(|| Varying::<N, Heap>::new(16)));
    each!("ufir window of 15", |N| bytes(|| Ufir::<N, Heap>::new(16)));
    title("bytes of a live target", &names(&[]));
    let one = |name: &str, bytes: usize| line_of(name, &[bytes]);
    one("kernels: Chain of 3", size_of::<Chain<f64, 3>>());
    one("kernels: Axes, 2 of 2", size_of::<Axes<f64, 2, 2>>());
    one("kernels: FixedLag of 3, lag 5", size_of::<FixedLag<3, 5>>());
    one("alpha-beta, one axis", size_of::<AlphaBeta<f64>>());
    one("fosb, two axes", size_of::<FosbAxes<f64, 2>>());
    for m in [15, 60, 1000] {
        one(&format!("fms, 3 states, window of {m}, its gains among them"), bytes(|| window(m)));
    }
}
