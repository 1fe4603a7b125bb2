//! \[FOSB12\]: the error distances of section 4, Figures 5–11 and what the text says of them.

mod claims;
mod experiment;
mod figures;
mod operations;

use super::{Account, Effort, Entry, Measured, Paper, Verdict, WITHIN};
use experiment::{ESTIMATORS, Heading, SHARES, Setting, numbers};
use fixtrail_core::Matrix;
use fixtrail_core::Vector;
use fixtrail_core::estimators::alpha_beta::{Moments, Truth};
use rand_pcg::Pcg64;
use rayon::prelude::*;
use statrs::distribution::{ContinuousCDF, FisherSnedecor};

/// Runs of each setting, in full and for a quick look.
const RUNS: usize = 400;
const QUICK: usize = 20;

/// One of the paper's paths: its printed numbers and the readings of its text.
struct Path {
    name: &'static str,
    /// Error distances in metres: 90 % and 60 % without tracking, of the Kalman filter, of FOSB.
    printed: [f64; 6],
    literal: Setting,
    /// How else the text may be read.
    reading: Option<(&'static str, Setting)>,
    /// Why the numbers are as they are.
    reason: &'static str,
}

fn paths() -> [Path; 3] {
    [
        Path {
            name: "path 1",
            printed: [8.67, 5.40, 4.80, 2.98, 4.72, 2.92],
            literal: Setting::first(1.0, 0.16),
            reading: Some(("0.4 is the variance of u, not its standard deviation", Setting::first(1.0, 0.4))),
            reason: "the printed distances of 90 % are high against their own of 60 %",
        },
        Path {
            name: "path 2",
            printed: [8.67, 5.40, 4.72, 2.94, 4.61, 2.87],
            literal: Setting::second(1.0),
            reading: None,
            reason: "the printed distances of 90 % are high against their own of 60 %",
        },
        Path {
            name: "path 3",
            printed: [4.63, 2.87, 3.04, 1.90, 3.03, 1.90],
            literal: Setting::third(1.0, Heading::Reflected),
            reading: Some(("a new random heading at each wall", Setting::third(1.0, Heading::RandomAtWalls))),
            reason: "by the letter the target is reflected at walls, as a billiard ball is",
        },
    ]
}

/// Returns the account. `progress` is called [`pieces`] times, from any thread.
pub fn account(effort: &Effort, progress: &(dyn Fn() + Sync)) -> Account {
    let count = effort.experiments(RUNS, QUICK);
    let mut entries = claims::of_the_equations();
    entries.extend(operations::entries());
    for path in paths() {
        let of = |setting: &Setting| -> Vec<[f64; 6]> {
            let run = |number| {
                let numbers = numbers(effort, setting, number);
                progress();
                numbers
            };
            (0..count).into_par_iter().map(run).collect()
        };
        let literal = of(&path.literal);
        let reading = path.reading.as_ref().map(|(text, setting)| (*text, of(setting)));
        entries.extend(error_distances(&path, &literal, reading.as_ref()));
    }
    entries.extend(claims::of_the_simulations(effort, progress));
    let figures = figures::figures(effort);
    Account { paper: Paper::Fosb.name(), title: Paper::Fosb.title(), entries, figures }
}

/// Returns how often [`account`] reports progress.
pub fn pieces(effort: &Effort) -> usize {
    let settings: usize = paths().iter().map(|p| 1 + usize::from(p.reading.is_some())).sum();
    settings * effort.experiments(RUNS, QUICK) + claims::pieces(effort)
}

fn stream(effort: &Effort, part: u64, run: usize) -> Pcg64 {
    super::stream(effort, Paper::Fosb, part, 0, run)
}

/// The entries of a path's six numbers, and of the six together.
fn error_distances(path: &Path, literal: &[[f64; 6]], reading: Option<&(&str, Vec<[f64; 6]>)>) -> Vec<Entry> {
    let column = |of: &[[f64; 6]], i: usize| Measured::of(&of.iter().map(|n| n[i]).collect::<Vec<_>>());
    let design = path.literal.design();
    let moments = |filter: usize| match filter {
        0 => Some(Moments { mse_x: path.literal.r, mse_s: 0.0, cov_xs: 0.0 }),
        1 => design.kalman().and_then(|s| s.moments(Truth::ConstantSpeed)),
        _ => design.fosb().and_then(|s| s.moments(Truth::ConstantSpeed)),
    };
    let mut out = Vec::new();
    for (i, printed) in path.printed.into_iter().enumerate() {
        let (filter, share) = (i / 2, SHARES[i % 2]);
        let what = format!("{}, {}, {:.0} % of errors below, m", path.name, ESTIMATORS[filter], 100.0 * share);
        let mut entry = Entry::number("section 4", &what, (printed, 2), Verdict::NotReproducible)
            .literally(column(literal, i))
            .because(path.reason);
        if let Some((text, numbers)) = reading {
            entry = entry.read_as(text, column(numbers, i));
        }
        // Between walls the speed is constant; what turns add has no closed form.
        let turns = path.literal.heading != Heading::Straight && filter > 0;
        if let Some(moments) = moments(filter).filter(|_| !turns) {
            entry = entry.bounded("exact, in the long run", moments.distance_quantile(share));
        }
        out.push(entry);
    }
    if let Some(p) = together(literal, &path.printed) {
        let mut entry = Entry::claim(
            "section 4",
            &format!("{}, the six numbers come from one run", path.name),
            p > CHANCE,
            "chance that the six of one run are further from ours, given how they vary together; rejected below 0.0027"
                .to_owned(),
        )
        .literally(Measured::exact(p));
        if let Some((text, numbers)) = reading {
            let p = together(numbers, &path.printed).unwrap_or(0.0);
            entry = entry.holds_read_as(text, Measured::exact(p), p > CHANCE);
        }
        out.push(entry);
    }
    out
}

/// The chance of a normal number beyond [`WITHIN`] standard deviations.
const CHANCE: f64 = 0.0027;
const _: () = assert!(WITHIN == 3.0);

/// Returns the chance that a run of the same experiment lies further from the mean of `runs` than `printed`: Hotelling's T² of a new
/// sample, the rounding of the print added to the covariance. `None` for too few runs.
fn together(runs: &[[f64; 6]], printed: &[f64; 6]) -> Option<f64> {
    let (n, k) = (runs.len() as f64, 6.0);
    let vectors: Vec<Vector<6>> = runs.iter().map(|r| Vector::from(*r)).collect();
    let mean: Vector<6> = vectors.iter().sum::<Vector<6>>() / n;
    let mut cov: Matrix<6, 6> = vectors.iter().map(|v| (v - mean) * (v - mean).transpose()).sum::<Matrix<6, 6>>();
    cov /= n - 1.0;
    cov += Matrix::identity() * (0.01 * 0.01 / 12.0);
    let off = Vector::from(*printed) - mean;
    let square = off.dot(&cov.cholesky()?.solve(&off));
    let f = square * n * (n - k) / (k * (n * n - 1.0));
    let law = FisherSnedecor::new(k, n - k).ok().filter(|_| n > k)?;
    Some(1.0 - law.cdf(f))
}
