//! Section 3: the linear filter of Theorem 1 and Figure 2.

use super::world::{FIGURE_2, Setting};
use crate::monte_carlo::Sample;
use crate::papers::{Curve, Effort, Entry, Figure, FigureKind, Measured, Verdict};
use fixtrail_core::riccati::Lossy;
use fixtrail_core::{Matrix, Vector};
use fixtrail_track::mat::Mat;
use fixtrail_track::spec::{EstimatorSpec, LinearStep, ModelSpec, Prior, Shows};

/// Arrival rates of Figure 2.
const RATES: [f64; 10] = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0];
/// Runs of one experiment.
const RUNS: usize = 100;
/// Experiments at the rates that the text has numbers for, in full and for a quick look; a quarter of them at the others.
const EXPERIMENTS: (usize, usize) = (16, 2);
/// Runs of 2000 steps that judge the theorem.
const THEOREM_RUNS: (usize, usize) = (200, 24);

/// What the text prints of Figure 2: p, then the errors of both states.
const PRINTED: [(f64, [f64; 2]); 2] = [(0.1, [0.5527, 0.7445]), (1.0, [0.3231, 0.3557])];

const READING: &str = "Q = B Bᵀ of a scalar noise of variance 1, error per step";

fn experiments(effort: &Effort, p: f64) -> usize {
    let count = effort.experiments(EXPERIMENTS.0, EXPERIMENTS.1);
    if PRINTED.iter().any(|(rate, _)| *rate == p) { count } else { count.div_ceil(4) }
}

fn theorem_runs(effort: &Effort) -> usize {
    if effort.quick { THEOREM_RUNS.1 } else { THEOREM_RUNS.0 }
}

/// Returns how often [`account`] reports progress.
pub fn pieces(effort: &Effort) -> usize {
    let curve: usize = RATES.into_iter().map(|p| experiments(effort, p) * RUNS).sum();
    curve + (SYSTEMS.len() + 1) * theorem_runs(effort)
}

/// Returns the entries and figures of section 3.
pub fn account(effort: &Effort, progress: &(dyn Fn() + Sync)) -> (Vec<Entry>, Vec<Figure>) {
    let setting = Setting::of(FIGURE_2);
    let curve: Vec<[Measured; 2]> = RATES
        .into_iter()
        .map(|p| {
            let contenders = [setting.contender("lmvf", p)];
            let runs = 0..experiments(effort, p) * RUNS;
            let samples = setting.samples(&contenders, &setting.independent(p), (effort, runs), progress).remove(0);
            [0, 1].map(|i| {
                let mean = |runs: &[Sample]| runs.iter().map(|s| s.mean_abs[i]).sum::<f64>() / runs.len() as f64;
                Measured::of(&samples.chunks(RUNS).map(mean).collect::<Vec<_>>())
            })
        })
        .collect();
    let mut entries = theorem(effort, progress);
    for (p, printed) in PRINTED {
        let at = RATES.iter().position(|rate| *rate == p).unwrap_or(0);
        for (i, value) in printed.into_iter().enumerate() {
            let what = format!("mean |error| of state {}, p = {p}", i + 1);
            let mut entry = Entry::number("Figure 2", &what, (value, 4), Verdict::NotReproducible)
                .read_as(READING, curve[at][i])
                .because("by the letter there is no experiment: a 2 × 2 Q does not go with a B of one column");
            // With p = 1 the filter is the Kalman filter.
            if let (true, Some(steady)) = (p == 1.0, steady()) {
                entry = entry.bounded("Kalman filter, steady state", steady[i]);
            }
            entries.push(entry);
        }
    }
    let falls = |i: usize| curve.windows(2).all(|pair| pair[1][i].mean < pair[0][i].mean + 3.0 * pair[0][i].se);
    entries.push(Entry::claim(
        "Figure 2",
        "the error decreases as p grows from 0.1 to 1",
        falls(0) && falls(1),
        "both curves fall from rate to rate".to_owned(),
    ));
    let points = |i: usize| RATES.into_iter().zip(&curve).map(|(p, at)| [p, at[i].mean]).collect();
    let figure = Figure {
        place: "Figure 2".to_owned(),
        caption: format!(
            "Error of the linear filter against the arrival rate; {READING}; {} runs at 0.1 and 1, {} at the others",
            experiments(effort, 1.0) * RUNS,
            experiments(effort, 0.5) * RUNS
        ),
        x: "arrival rate p".to_owned(),
        y: "mean |error|".to_owned(),
        kind: FigureKind::Lines,
        curves: vec![
            Curve { name: "Er1".to_owned(), points: points(0), joined: true },
            Curve { name: "Er2".to_owned(), points: points(1), joined: true },
            Curve {
                name: "printed".to_owned(),
                points: PRINTED.iter().flat_map(|(p, values)| values.map(|v| [*p, v])).collect(),
                joined: false,
            },
        ],
    };
    (entries, vec![figure])
}

/// √(2/π) times the steady standard deviations of the Kalman filter of section 3.2: its mean |error| when nothing is lost.
fn steady() -> Option<[f64; 2]> {
    let a = Matrix::<2, 2>::new(0.6, 0.0, 0.8, 0.5);
    let w = Matrix::<2, 2>::new(0.36, 0.30, 0.30, 0.25);
    let lossy = Lossy::new(&a, &w, &[Vector::<2>::new(1.0, 1.0)], &[1.0])?;
    let p = lossy.filtered(&lossy.upper_bound(1.0)?, 1.0);
    Some([0, 1].map(|i| (2.0 / std::f64::consts::PI * p[(i, i)]).sqrt()))
}

/// A scalar system x⁺ = a x + w, z = x + v.
struct Scalar {
    a: f64,
    q: f64,
    r: f64,
    p: f64,
    /// What is said of it.
    place: &'static str,
    claim: &'static str,
}

const SYSTEMS: [Scalar; 2] = [
    Scalar {
        a: 0.2,
        q: 1.0,
        r: 0.01,
        p: 0.5,
        place: "Theorem 1",
        claim: "the filter is the optimal linear one: no linear estimate has a smaller mean square error",
    },
    Scalar {
        a: 0.98,
        q: 0.1,
        r: 10.0,
        p: 0.5,
        place: "eq. (16)",
        claim: "P is the covariance of the estimation error",
    },
];

/// Optimality, the claimed covariance, and the Kalman filter as the case p = 1.
fn theorem(effort: &Effort, progress: &(dyn Fn() + Sync)) -> Vec<Entry> {
    let mut entries = Vec::new();
    let runs = theorem_runs(effort);
    for system in &SYSTEMS {
        let setting = scalar(system);
        let mut exact = setting.contender("lmvf", system.p);
        exact.spec.estimator = EstimatorSpec::Lmmse;
        let contenders = [setting.contender("lmvf", system.p), exact];
        let samples = setting.samples(&contenders, &setting.independent(system.p), (effort, 0..runs), progress);
        let [theirs, best] = &samples[..] else { continue };
        let (a, q, r, p) = (system.a, system.q, system.r, system.p);
        let of = format!("x⁺ = {a} x + w, q = {q}, R = {r}, p = {p}");
        let (ratio, what) = if system.place == "Theorem 1" {
            (
                ratio(theirs, best, |s| s.mean_square[0], |s| s.mean_square[0]),
                "its mean square error over that of the exact linear estimate",
            )
        } else {
            (
                ratio(theirs, theirs, |s| s.mean_square[0], |s| s.claimed[0]),
                "its mean square error over the P that it claims",
            )
        };
        let holds = (ratio.mean - 1.0).abs() < 3.0 * ratio.se;
        let mut entry = Entry::claim(system.place, system.claim, holds, format!("{what}: {of}"));
        entry.what = what.to_owned();
        entry.literal = Some(ratio);
        entries.push(entry.bounded("if it held", 1.0));
    }
    let setting = Setting::of(FIGURE_2);
    let mut kalman = setting.contender("lmvf", 1.0);
    kalman.spec.estimator = EstimatorSpec::Kalman;
    let contenders = [setting.contender("lmvf", 1.0), kalman];
    let samples = setting.samples(&contenders, &setting.independent(1.0), (effort, 0..runs), progress);
    let apart = (samples[0].iter().zip(&samples[1]))
        .flat_map(|(a, b)| a.mean_square.iter().zip(&b.mean_square).map(|(a, b)| (a - b).abs() / b))
        .fold(0.0, f64::max);
    let mut entry = Entry::claim(
        "Remark 2",
        "with p = 1 the filter is the Kalman filter",
        apart < 1e-9,
        "largest relative difference of the mean square errors of any run".to_owned(),
    );
    entry.literal = Some(Measured::exact(apart));
    entries.push(entry);
    entries
}

/// Ratio of two means over the same runs, with the standard error of a ratio.
fn ratio(a: &[Sample], b: &[Sample], of_a: fn(&Sample) -> f64, of_b: fn(&Sample) -> f64) -> Measured {
    let count = a.len() as f64;
    let mean = |samples: &[Sample], of: fn(&Sample) -> f64| samples.iter().map(of).sum::<f64>() / count;
    let (above, below) = (mean(a, of_a), mean(b, of_b));
    let ratio = above / below;
    let square: f64 = a.iter().zip(b).map(|(a, b)| (of_a(a) - ratio * of_b(b)).powi(2)).sum();
    Measured { mean: ratio, se: (square / (count - 1.0) / count).sqrt() / below, spread: 0.0 }
}

/// The setting of a scalar system: Figure 2's with other matrices, its start drawn.
fn scalar(system: &Scalar) -> Setting {
    let one = |v: f64| Mat { rows: 1, cols: 1, data: vec![v] };
    let mut setting = Setting::of(FIGURE_2);
    let base = LinearStep {
        a: one(system.a),
        b: Mat { rows: 1, cols: 0, data: Vec::new() },
        g: one(1.0),
        c: one(1.0),
        q: one(system.q),
        r: one(system.r),
    };
    let stationary = system.q / (1.0 - system.a * system.a);
    let prior = Prior { mean: vec![0.0], cov: one(stationary), second_moment: None };
    let simulated = &mut setting.simulated;
    simulated.steps = 2000;
    simulated.start = fixtrail_track::spec::Start::Drawn;
    let contenders = simulated.contenders.iter_mut().map(|c| {
        c.shows = Shows::Paper;
        &mut c.spec
    });
    for spec in contenders.chain([&mut simulated.truth]) {
        if let ModelSpec::Linear(linear) = &mut spec.model {
            (linear.base, linear.prior) = (base.clone(), Some(prior.clone()));
        }
    }
    setting
}

#[cfg(test)]
mod tests {
    #[test]
    fn steady_errors_are_those_of_the_riccati_equation() {
        // P⁻ = A P Aᵀ + W, P = P⁻ − P⁻CᵀCP⁻/(C P⁻ Cᵀ + 1), iterated to its end.
        let (a, w) = ([[0.6, 0.0], [0.8, 0.5]], [[0.36, 0.30], [0.30, 0.25]]);
        let mut p = [[0.1, 0.0], [0.0, 0.1]];
        for _ in 0..1000 {
            let mut prior = w;
            for i in 0..2 {
                for j in 0..2 {
                    for k in 0..2 {
                        for l in 0..2 {
                            prior[i][j] += a[i][k] * p[k][l] * a[j][l];
                        }
                    }
                }
            }
            let pc = [prior[0][0] + prior[0][1], prior[1][0] + prior[1][1]];
            let s = pc[0] + pc[1] + 1.0;
            for i in 0..2 {
                for j in 0..2 {
                    p[i][j] = prior[i][j] - pc[i] * pc[j] / s;
                }
            }
        }
        for i in 0..2 {
            let steady = (2.0 / std::f64::consts::PI * p[i][i]).sqrt();
            assert!((steady - super::steady().unwrap()[i]).abs() < 1e-9, "{i}: {steady}");
        }
    }
}
