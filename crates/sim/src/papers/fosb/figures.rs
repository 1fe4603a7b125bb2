//! Figures 5–11 of \[FOSB12\].

use super::claims::Response;
use super::experiment::{ESTIMATORS, Filters, Heading, Setting, Target, distances, quantile, run};
use crate::papers::{Curve, Effort, Figure, FigureKind, normal};
use fixtrail_core::estimators::fosb::Noise;
use std::f64::consts::TAU;

/// Points of a distribution.
const STEPS: usize = 200;
/// Runs behind Figure 9b.
const RUNS: usize = 1000;
/// Samples of Figures 9b and 11.
const FIRST: usize = 500;

/// Our curves for every figure.
pub fn figures(effort: &Effort) -> Vec<Figure> {
    let mut out = vec![
        distribution(effort, "Figure 5", "path 1", &[0.1, 1.0, 4.0], |dt| Setting::first(dt, 0.16)),
        distribution(effort, "Figure 6", "path 2", &[0.1, 1.0, 4.0], Setting::second),
        start(),
    ];
    out.extend(accelerating(effort));
    out.push(distribution(effort, "Figure 9a", "path 3, reflected at the walls", &[1.0, 2.0], |dt| {
        Setting::third(dt, Heading::Reflected)
    }));
    out.push(along_the_way(effort));
    out.extend(trajectories(effort));
    out
}

fn curve(name: &str, points: impl Iterator<Item = [f64; 2]>) -> Curve {
    Curve { name: name.to_owned(), points: points.collect(), joined: true }
}

/// Distributions of the errors at several intervals.
fn distribution(effort: &Effort, place: &str, path: &str, intervals: &[f64], of: impl Fn(f64) -> Setting) -> Figure {
    let mut curves = Vec::new();
    for dt in intervals {
        for (name, sorted) in ESTIMATORS.iter().zip(distances(effort, &of(*dt), 0)) {
            // Raw errors do not depend on the interval.
            if *name == ESTIMATORS[0] && *dt != intervals[0] {
                continue;
            }
            let label = if *name == ESTIMATORS[0] { (*name).to_owned() } else { format!("{name}, Δ = {dt} s") };
            let at = |i: usize| i as f64 / STEPS as f64;
            curves.push(curve(&label, (0..=STEPS).map(|i| [quantile(&sorted, at(i)), 100.0 * at(i)])));
        }
    }
    Figure {
        place: place.to_owned(),
        caption: format!("Share of 10 000 samples with a smaller error, {path}: one run, as in the paper."),
        x: "error distance [m]".to_owned(),
        y: "share of samples [%]".to_owned(),
        kind: FigureKind::Lines,
        curves,
    }
}

fn start() -> Figure {
    let mut curves = vec![curve("truth", [[0.0, 2.0], [50.0, 2.0]].into_iter())];
    for (var, text) in [(1.0, "1"), (0.16, "0.4")] {
        let response = Response::new(var, 501);
        for (filter, name) in ESTIMATORS[1..].iter().enumerate() {
            let points = response.speed.iter().enumerate().map(|(k, s)| [0.1 * k as f64, s[filter]]);
            curves.push(curve(&format!("{name}, told 0 ± {text} m/s"), points));
        }
    }
    Figure {
        place: "Figure 7".to_owned(),
        caption: "Mean of the speed estimate on path 2, Δ = 0.1 s, from a first guess of 0. The paper does not print what it told the filters \
                  of that guess."
            .to_owned(),
        x: "time [s]".to_owned(),
        y: "speed [m/s]".to_owned(),
        kind: FigureKind::Lines,
        curves,
    }
}

/// Figure 8 for a trajectory of our own.
fn accelerating(effort: &Effort) -> Vec<Figure> {
    let (dt, amplitude, omega): (f64, f64, f64) = (0.1, 0.2, TAU / 50.0);
    let noise = |sigma: f64| Noise::Acceleration { q: sigma * sigma };
    let mut curves: Vec<Vec<Curve>> = vec![Vec::new(); 2];
    for (sigma, name) in [(0.1, "σ = 0.1"), (1.0, "σ = 1")] {
        let setting = Setting { noise: noise(sigma), r: 9.0, ..Setting::second(dt) };
        let mut rng = super::stream(effort, 40, 0);
        let truth = |k: usize| {
            let phase = omega * dt * k as f64;
            [-amplitude / (omega * omega) * phase.sin(), -amplitude / omega * phase.cos()]
        };
        let mut filters = Filters::start(&setting, [truth(0)[0]; 2], [truth(0)[1]; 2], sigma * sigma);
        let (mut location, mut speed) = (Vec::new(), Vec::new());
        for k in 1..1000 {
            let z = truth(k)[0] + 3.0 * normal(&mut rng);
            filters.step([z; 2]);
            location.push([dt * k as f64, filters.locations()[0][0] - truth(k)[0]]);
            speed.push([dt * k as f64, filters.speeds()[0][0] - truth(k)[1]]);
        }
        curves[0].push(curve(name, location.into_iter()));
        curves[1].push(curve(name, speed.into_iter()));
    }
    let caption = "Errors of the Kalman filter told a small and a large σ, Δ = 0.1 s, R = 9 m². The paper's trajectory is not in its text: \
                   ours has a sinusoidal acceleration of 0.2 m/s² and 50 s.";
    ["location error [m]", "speed error [m/s]"]
        .into_iter()
        .zip(["d, g", "e, h"])
        .zip(curves)
        .map(|((y, part), curves)| Figure {
            place: format!("Figure 8 {part}"),
            caption: caption.to_owned(),
            x: "time [s]".to_owned(),
            y: y.to_owned(),
            kind: FigureKind::Lines,
            curves,
        })
        .collect()
}

/// Errors at each of the first samples, over many runs of one trajectory.
fn along_the_way(effort: &Effort) -> Figure {
    let setting = Setting::third(1.0, Heading::Reflected);
    let runs = if effort.quick { RUNS / 10 } else { RUNS };
    let mut way = Vec::with_capacity(FIRST);
    run(effort, &setting, 0, FIRST, |target, _, _| way.push(*target));
    let mut squares = vec![[0.0; 3]; FIRST];
    let mut rng = super::stream(effort, 41, 0);
    for _ in 0..runs {
        let mut filters: Option<Filters> = None;
        for (target, square) in way.iter().zip(&mut squares) {
            let z = target.location.map(|x| x + setting.r.sqrt() * normal(&mut rng));
            let filters = match &mut filters {
                Some(filters) => {
                    filters.step(z);
                    filters
                }
                none => none.insert(Filters::start(&setting, z, target.velocity, setting.noise.over(1.0).1)),
            };
            let [kalman, fosb] = filters.locations();
            for (sum, at) in square.iter_mut().zip([z, kalman, fosb]) {
                *sum += (at[0] - target.location[0]).powi(2) + (at[1] - target.location[1]).powi(2);
            }
        }
    }
    let curves = ESTIMATORS
        .iter()
        .enumerate()
        .map(|(j, name)| curve(name, squares.iter().enumerate().map(|(k, s)| [k as f64, (s[j] / runs as f64).sqrt()])))
        .collect();
    Figure {
        place: "Figure 9b".to_owned(),
        caption: format!(
            "Root mean square error over {runs} runs along the first {FIRST} samples of one trajectory; the peaks are its corners."
        ),
        x: "sample k".to_owned(),
        y: "RMSE [m]".to_owned(),
        kind: FigureKind::Lines,
        curves,
    }
}

/// What one sample shows: where the target is, how fast, what was measured, and the two estimates of both.
struct Sample {
    target: Target,
    z: [f64; 2],
    locations: [[f64; 2]; 2],
    speeds: [[f64; 2]; 2],
}

/// A place that a sample shows.
type View = fn(&Sample) -> [f64; 2];

/// Figures 10 and 11.
fn trajectories(effort: &Effort) -> Vec<Figure> {
    let setting = Setting::third(1.0, Heading::Reflected);
    let mut all = Vec::new();
    run(effort, &setting, 0, 4500, |target, z, filters| {
        all.push(Sample { target: *target, z, locations: filters.locations(), speeds: filters.speeds() });
    });
    let plan = |place: &str, what: &str, of: &[Sample], at: View| Figure {
        place: place.to_owned(),
        caption: format!("{what}, path 3."),
        x: "x [m]".to_owned(),
        y: "y [m]".to_owned(),
        kind: FigureKind::Plan,
        curves: vec![curve(what, of.iter().map(at))],
    };
    let (late, first) = (&all[3500..], &all[..FIRST]);
    let views: [(&str, View); 4] = [
        ("The trajectory", |s| s.target.location),
        ("As observed", |s| s.z),
        ("As the Kalman filter has it", |s| s.locations[0]),
        ("As FOSB has it", |s| s.locations[1]),
    ];
    let mut out = Vec::new();
    for (letter, (what, at)) in ["a", "b", "c", "d"].into_iter().zip(views) {
        out.push(plan(&format!("Figure 10{letter}"), &format!("{what}, samples 3500 to 4500"), late, at));
    }
    for (letter, (what, at)) in ["a", "d", "g", "j"].into_iter().zip(views) {
        out.push(plan(&format!("Figure 11{letter}"), &format!("{what}, the first 500 samples"), first, at));
    }
    for (axis, letters) in [(0, "b, e, h, k"), (1, "c, f, i, l")] {
        let line = |name: &str, f: &dyn Fn(usize) -> f64| curve(name, (1..FIRST).map(|k| [k as f64, f(k)]));
        out.push(Figure {
            place: format!("Figure 11{letters}"),
            caption: "The speed observed is the difference of two measured locations; its standard deviation is √(2R)/Δ = 3 m/s.".to_owned(),
            x: "sample k".to_owned(),
            y: format!("speed in {} [m/s]", ["x", "y"][axis]),
            kind: FigureKind::Lines,
            curves: vec![
                line("observed", &|k| first[k].z[axis] - first[k - 1].z[axis]),
                line("Kalman filter", &|k| first[k].speeds[0][axis]),
                line("FOSB", &|k| first[k].speeds[1][axis]),
                line("truth", &|k| first[k].target.velocity[axis]),
            ],
        });
    }
    out
}
