//! What section 4.2 says of filters under loss, with ranges to the nearest sensor ten times a second: every filter sees the same.

use super::world::{Setting, TURN};
use super::{median, share};
use crate::monte_carlo::Sample;
use crate::papers::{Curve, Effort, Entry, Figure, FigureKind, Measured};

/// Runs at each arrival rate, in full and for a quick look.
const RUNS: (usize, usize) = (2000, 100);

/// Arrival rates of the figures, and one more where Model 1 meets double losses.
const RATES: [f64; 5] = [1.0, 0.98, 0.95, 0.9, 0.8];

/// The contenders, as the scenario names them.
const NAMES: [&str; 6] = [
    "ekf, told nothing",
    "ekf, told nothing, 0 for what is lost",
    "emvf, paper's S0",
    "emvf, model 1, zero, paper's S0",
    "emvf, model 1, skip, paper's S0",
    "ekf, losses known",
];
const HELD: usize = 0;
const ZERO: usize = 1;
const MODEL_2: usize = 2;
const MODEL_1_ZERO: usize = 3;
const MODEL_1_SKIP: usize = 4;
const KNOWN: usize = 5;

fn runs(effort: &Effort) -> usize {
    effort.runs.unwrap_or(if effort.quick { RUNS.1 } else { RUNS.0 }).max(20)
}

/// Returns how often [`account`] reports progress.
pub fn pieces(effort: &Effort) -> usize {
    (RATES.len() + 4) * runs(effort)
}

/// Distances of all runs of one contender, m; infinite where it failed.
fn rms_m(samples: &[Sample]) -> Vec<f64> {
    samples.iter().map(|s| position(s).0).collect()
}

fn last_m(samples: &[Sample]) -> Vec<f64> {
    samples.iter().map(|s| position(s).1).collect()
}

fn position(sample: &Sample) -> (f64, f64) {
    match (&sample.failed, sample.position_m) {
        (None, Some(found)) if found.0.is_finite() => found,
        _ => (f64::INFINITY, f64::INFINITY),
    }
}

/// Share of runs that end more than 10 m off.
fn lost(samples: &[Sample]) -> Measured {
    let last = last_m(samples);
    share(last.iter().filter(|m| !(**m <= 10.0)).count(), last.len())
}

/// Share of runs in which `a` is nearer to the target than `b`.
fn wins(a: &[f64], b: &[f64]) -> Measured {
    share(a.iter().zip(b).filter(|(a, b)| a < b).count(), a.len())
}

/// A ratio of two medians, with the errors of both.
fn over(a: Measured, b: Measured) -> Measured {
    let mean = a.mean / b.mean;
    Measured { mean, se: mean * ((a.se / a.mean).powi(2) + (b.se / b.mean).powi(2)).sqrt(), spread: 0.0 }
}

/// A claim judged by one number.
fn judged(place: &str, claim: &str, holds: bool, (what, measured): (&str, Measured), reason: String) -> Entry {
    let mut entry = Entry::claim(place, claim, holds, reason);
    entry.what = what.to_owned();
    entry.literal = Some(measured);
    entry
}

/// Samples of every contender: all rates, then the forced losses.
pub(super) struct Losses {
    /// By rate, then by contender.
    pub(super) by_rate: Vec<Vec<Vec<Sample>>>,
    /// After one forced loss at instant 8: the error there, and at the end.
    single: [Vec<Vec<Sample>>; 2],
    /// After forced losses at instants 8 and 9: the error at 9, and at the end.
    double: [Vec<Vec<Sample>>; 2],
}

/// Runs the experiments.
pub(super) fn run(effort: &Effort, progress: &(dyn Fn() + Sync)) -> Losses {
    let setting = Setting::of(TURN).turn_noise(0.002, 0);
    let count = (effort, 0..runs(effort));
    let contenders = |p: f64| NAMES.map(|name| setting.contender(name, p));
    let by_rate = (RATES.into_iter())
        .map(|p| setting.samples(&contenders(p), &setting.independent(p), count.clone(), progress))
        .collect();
    // Filters are told the rate of Figure 5, at which the paper's loss happens.
    let forced = |lost: &[usize], p: f64| {
        let mut until = setting.clone();
        until.simulated.steps = lost[lost.len() - 1];
        [&until, &setting].map(|s| s.samples(&contenders(p), &s.losing(lost), count.clone(), progress))
    };
    Losses { by_rate, single: forced(&[8], 0.98), double: forced(&[8, 9], 0.95) }
}

/// Returns the entries on filters under loss.
pub fn account(effort: &Effort, progress: &(dyn Fn() + Sync)) -> (Vec<Entry>, Vec<Figure>) {
    let losses = run(effort, progress);
    let at = |p: f64| &losses.by_rate[RATES.iter().position(|rate| *rate == p).unwrap_or(0)];
    let mut entries = Vec::new();

    let same = (at(1.0)[KNOWN].iter().zip(&at(1.0)[MODEL_2]).zip(&at(1.0)[MODEL_1_ZERO]))
        .filter(|((ekf, _), _)| position(ekf).0 < 10.0)
        .flat_map(|((ekf, two), one)| [two, one].map(|other| (position(other).0 - position(ekf).0).abs()))
        .fold(0.0, f64::max);
    entries.push(judged(
        "Figures 4, 8",
        "with p = 1 the extended Kalman filter, Model 1 and Model 2 have approximately the same trajectory",
        same < 1e-6,
        ("largest difference of the RMSE of a run, m", Measured::exact(same)),
        "runs that lose the target aside, in which rounding grows".to_owned(),
    ));

    let starts = lost(&at(0.98)[HELD]);
    entries.push(
        judged(
            "Figure 5",
            "with p = 0.98 the extended Kalman filter starts to diverge once a packet is lost",
            starts.mean > 0.05 + 3.0 * starts.se,
            ("share of runs that end more than 10 m off: takes what it is shown for new", starts),
            "so it does, if nobody tells it of losses".to_owned(),
        )
        .because(format!(
            "fed with 0 for what is lost {:.0} %; told of losses {:.1} %, as without any",
            100.0 * lost(&at(0.98)[ZERO]).mean,
            100.0 * lost(&at(0.98)[KNOWN]).mean
        )),
    );
    for (name, which) in [("Model 2", MODEL_2), ("Model 1", MODEL_1_ZERO)] {
        let gone = lost(&at(0.98)[which]);
        entries.push(judged(
            "Figure 5",
            &format!("with p = 0.98 {name} can still track the target"),
            // Without losses 1 to 2 % of the runs are lost.
            gone.mean < 0.03 + 3.0 * gone.se,
            ("share of runs that end more than 10 m off", gone),
            "judged as tracking when at most 3 % of the runs end more than 10 m off: 1 % do without any loss"
                .to_owned(),
        ));
    }
    let error = |which: usize| median(&last_m(&losses.single[0][which]));
    let (held, zero) = (over(error(HELD), error(MODEL_2)), over(error(ZERO), error(MODEL_2)));
    // "Much higher": three times.
    entries.push(
        judged(
            "Figure 9",
            "after a loss at k = 8 the extended Kalman filter has a much higher error than Models 1 and 2",
            held.mean > 3.0,
            ("median error at k = 8 over that of Model 2: takes the old value for new", held),
            String::new(),
        )
        .holds_read_as("the filter is fed with 0 for what is lost", zero, zero.mean > 3.0)
        .because(format!(
            "medians: {:.2} m, with 0 {:.1} m, Model 2 {:.2} m, Model 1 {:.2} m; told of the loss {:.2} m",
            error(HELD).mean,
            error(ZERO).mean,
            error(MODEL_2).mean,
            error(MODEL_1_ZERO).mean,
            error(KNOWN).mean
        )),
    );
    let of = |p: f64, which: usize| rms_m(&at(p)[which]);
    let better = wins(&of(0.95, MODEL_2), &of(0.95, MODEL_1_ZERO));
    let other = wins(&of(0.95, MODEL_2), &of(0.95, MODEL_1_SKIP));
    entries.push(
        judged(
            "Figures 6, 10",
            "with p = 0.95 Model 2 has a smaller error than Model 1",
            better.mean > 0.5,
            ("share of runs in which Model 2 has the smaller RMSE, Model 1 fed with 0", better),
            String::new(),
        )
        .holds_read_as("Model 1 leaves the 0 out", other, other.mean > 0.5)
        .because(format!(
            "median RMSE {:.2} m, Model 1 {:.2} m, leaving the 0 out {:.2} m",
            median(&of(0.95, MODEL_2)).mean,
            median(&of(0.95, MODEL_1_ZERO)).mean,
            median(&of(0.95, MODEL_1_SKIP)).mean
        )),
    );
    let after = |which: usize| median(&last_m(&losses.double[0][which]));
    let (zero, skip) = (over(after(MODEL_1_ZERO), after(MODEL_2)), over(after(MODEL_1_SKIP), after(MODEL_2)));
    entries.push(
        judged(
            "Figure 10",
            "Model 1 cannot deal with two losses in a row, Model 2 can",
            zero.mean > 1.0 + 3.0 * zero.se,
            ("median error after losses at k = 8 and 9, Model 1 over Model 2", zero),
            String::new(),
        )
        .because(format!(
            "Model 2 {:.2} m, Model 1 {:.2} m; where Model 1 leaves the 0 out {:.2} m, {:.2} of Model 2",
            after(MODEL_2).mean,
            after(MODEL_1_ZERO).mean,
            after(MODEL_1_SKIP).mean,
            skip.mean
        )),
    );
    let medians: Vec<Measured> = RATES.into_iter().map(|p| median(&of(p, MODEL_2))).collect();
    let grows = medians.windows(2).all(|pair| pair[1].mean > pair[0].mean);
    entries.push(Entry::claim(
        "Figures 8–11",
        "the error becomes smaller as p grows",
        grows,
        format!(
            "median RMSE of Model 2, m: {}",
            RATES.iter().zip(&medians).map(|(p, m)| format!("{:.2} at p = {p}", m.mean)).collect::<Vec<_>>().join(", ")
        ),
    ));
    let (two, known) = (median(&of(0.95, MODEL_2)), median(&of(0.95, KNOWN)));
    let superior = over(two, known);
    entries.push(
        judged(
            "section 4.2.4",
            "compared with the extended Kalman filter, the new filter tracks better",
            superior.mean < 1.0,
            ("median RMSE at p = 0.95 of Model 2 over that of a filter told of losses", superior),
            String::new(),
        )
        .holds_read_as(
            "the Kalman filter is told nothing of losses",
            over(two, median(&of(0.95, HELD))),
            two.mean < median(&of(0.95, HELD)).mean,
        )
        .because(
            "a repeated value, a sequence number or a silent sensor tells of a loss; who is told needs no new filter",
        ),
    );
    let curves = NAMES
        .iter()
        .enumerate()
        .map(|(i, name)| Curve {
            name: (*name).to_owned(),
            points: RATES.into_iter().map(|p| [p, median(&of(p, i)).mean]).filter(|p| p[1].is_finite()).collect(),
            joined: true,
        })
        .collect();
    let figure = Figure {
        place: "Figures 8–11, all rates".to_owned(),
        caption: format!(
            "Median over {} runs of the RMSE, ranges to the nearest of 20 random sensors ten times a second",
            runs(effort)
        ),
        x: "arrival rate p".to_owned(),
        y: "median RMSE, m".to_owned(),
        kind: FigureKind::Logarithmic,
        curves,
    };
    (entries, vec![figure])
}

/// Median RMSE of every contender and share of runs that end more than 10 m off, by arrival rate.
#[cfg(test)]
pub(super) fn table(effort: &Effort) -> Vec<(f64, Vec<(Measured, Measured)>)> {
    let losses = run(effort, &|| ());
    let of = |samples: &Vec<Vec<Sample>>| samples.iter().map(|s| (median(&rms_m(s)), lost(s))).collect();
    RATES.into_iter().zip(&losses.by_rate).map(|(p, samples)| (p, of(samples))).collect()
}
