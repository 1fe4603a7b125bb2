//! \[FMS19\]: Table 1, Table 2, Figures 1–4 and what the text says of them.

mod claims;
mod experiment;
mod figures;

use super::{Account, Effort, Entry, Measured, Paper, Verdict};
use experiment::{Design, ESTIMATORS, Numbers, RUNS, Shape, experiment};
use rand_pcg::Pcg64;
use rayon::prelude::*;

/// Experiments for each shape, in full and for a quick look.
const EXPERIMENTS: usize = 400;
const QUICK: usize = 20;

/// Table 2 as printed, metres: a row for each of [`ESTIMATORS`], a column for each of [`Shape::ALL`].
const TABLE_2: [[f64; 4]; 3] =
    [[0.0062, 0.0060, 0.0059, 0.0059], [0.0477, 0.0441, 0.0408, 0.0445], [0.0505, 0.0456, 0.0415, 0.0481]];

/// The reading that Table 2 fits.
const MEAN_OF_RUNS: &str = "magnitude of the mean error over the 30 runs, a₀ = 0.2 m/s²";

/// Returns the account. `progress` is called [`pieces`] times, from any thread.
pub fn account(effort: &Effort, progress: &(dyn Fn() + Sync)) -> Account {
    let design = Design::new();
    let count = effort.experiments(EXPERIMENTS, QUICK);
    let numbers: Vec<Vec<Numbers>> = Shape::ALL
        .into_iter()
        .map(|shape| {
            let of = |number| {
                let numbers = experiment(&design, effort, shape, number).numbers(shape);
                progress();
                numbers
            };
            (0..count).into_par_iter().map(of).collect()
        })
        .collect();
    let mut entries = claims::of_the_algorithm(&design, effort);
    entries.extend(claims::of_the_cost(&design));
    entries.extend(table_2(&design, &numbers));
    let jumping: Vec<(&str, Vec<Numbers>)> = Shape::ALL
        .into_iter()
        .zip(&numbers)
        .filter(|(shape, _)| !shape.jumps().is_empty())
        .map(|(shape, numbers)| (shape.name(), numbers.clone()))
        .collect();
    entries.extend(claims::of_the_simulations(&design, &jumping));
    let figures = Shape::ALL.into_iter().flat_map(|shape| figures::figures(&design, effort, shape)).collect();
    Account { paper: Paper::Fms.name(), title: Paper::Fms.title(), entries, figures }
}

/// Returns how often [`account`] reports progress.
pub fn pieces(effort: &Effort) -> usize {
    Shape::ALL.len() * effort.experiments(EXPERIMENTS, QUICK)
}

fn stream(effort: &Effort, part: u64, experiment: usize, run: usize) -> Pcg64 {
    super::stream(effort, Paper::Fms, part, experiment, run)
}

fn table_2(design: &Design, numbers: &[Vec<Numbers>]) -> Vec<Entry> {
    // Mean magnitude of the mean over the runs of unit normal errors.
    let hidden = (2.0 / std::f64::consts::PI / RUNS as f64).sqrt();
    let mut out = Vec::new();
    for (j, estimator) in ESTIMATORS.iter().enumerate() {
        let floor = design.deviations()[j];
        for (i, shape) in Shape::ALL.into_iter().enumerate() {
            let printed = TABLE_2[j][i];
            let of =
                |f: fn(&Numbers) -> [f64; 3]| Measured::of(&numbers[i].iter().map(|n| f(n)[j]).collect::<Vec<_>>());
            let what = format!("position error, {estimator}, {}, m", shape.name());
            let mut reason = format!(
                "no linear unbiased estimate from the same data has a smaller root mean square error than the bound; the magnitude of a \
                 mean over 30 runs hides noise down to {hidden:.2} of it"
            );
            if shape == Shape::Random {
                reason += "; here the acceleration has random knots every 50 steps and 0.16 m/s² from peak to peak, fitted to the column";
            }
            out.push(
                Entry::number("Table 2", &what, (printed, 4), Verdict::NotReproducible)
                    .literally(of(|n| n.rms))
                    .read_as(MEAN_OF_RUNS, of(|n| n.of_mean))
                    .bounded("standard deviation by theory", floor)
                    .because(reason),
            );
        }
    }
    out
}
