//! Results of a simulation as text and as JSON.

use super::Table;
use crate::figures::{counted, percent, short, short_or_dash};
use crate::output::table;
use fixtrail_sim::monte_carlo::{Estimated, LOST_NEES, LongRun, Summary};
use fixtrail_track::registry;
use fixtrail_track::spec::Simulated;
use serde_json::{Map, Value, json};
use std::path::Path;

/// Components of a linear model's state with a column each.
const COLUMNS: usize = 3;

/// A mean with as many digits as its standard error leaves.
fn figure(v: &Estimated) -> String {
    if !(v.mean.is_finite() && v.se.is_finite()) || v.mean.abs() >= 1e7 {
        return short(v.mean);
    }
    // What does not depend on chance: a claimed covariance of a linear model.
    if v.se <= 1e-9 * v.mean.abs() {
        return format!("{:.4}", v.mean);
    }
    let decimals = (1.0 - v.se.log10().floor()).clamp(0.0, 9.0) as usize;
    format!("{:.decimals$} ± {:.decimals$}", v.mean, v.se)
}

/// Everything that the command prints.
pub fn report(world: &Simulated, seed: u64, results: &[Table]) -> String {
    let runs = counted(world.runs as u64, "run");
    let length = match &world.schedule {
        Some(schedule) => format!("{} s with scheduled sensors", short(schedule.duration_s)),
        None => counted(world.steps as u64, "instant"),
    };
    let mut blocks = vec![format!("{runs} of {length} each, seed {seed}")];
    for one in results {
        let mut block = format!("loss rate {}\n{}", short(one.loss_rate), errors(world, one));
        block += &format!("\n\n{}\n{}", consistency(&one.outcome.contenders), verdicts(&one.outcome.contenders));
        if let Some(long_run) = &one.outcome.long_run {
            block += &format!("\n\n{}", in_the_long_run(long_run));
        }
        blocks.push(block);
    }
    let failures = results.iter().flat_map(|t| &t.outcome.contenders).filter_map(|s| {
        let first = s.first_failure.as_ref()?;
        Some(format!("{}: {} failed, the first: {first}", s.name, counted(s.failed as u64, "run")))
    });
    let failures: Vec<String> = failures.collect();
    if !failures.is_empty() {
        blocks.push(failures.join("\n"));
    }
    blocks.push(reading(world, results));
    blocks.join("\n\n")
}

/// How large errors are, with the bound in the last line.
fn errors(world: &Simulated, one: &Table) -> String {
    let layout = registry::layout(&world.truth);
    let all = &one.outcome.contenders;
    let linear = layout.is_linear();
    let unit = if linear { "" } else { "/m" };
    let mut header: Vec<String> = vec![String::new(), format!("RMSE{unit}"), "claimed".to_owned()];
    let columns = if linear && layout.n() <= COLUMNS { layout.n() } else { 0 };
    header.extend(layout.names[..columns].iter().map(|name| format!("mean |{name} error|")));
    if !linear {
        header.push("median run".to_owned());
    }
    header.extend(["50 %", "90 %", "95 %"].map(str::to_owned));
    header.push(if linear { "lost".to_owned() } else { format!("end > {} m off", world.lost_m) });
    let (failed, missing) = (all.iter().any(|s| s.failed > 0), all.iter().any(|s| s.missing > 0));
    let (energy, steps) = (all.iter().any(|s| s.energy_mj.is_some()), all.iter().any(|s| s.time_steps.is_some()));
    let more = [(energy, "energy/mJ"), (steps, "time steps"), (failed, "failed"), (missing, "missing")];
    header.extend(more.iter().filter(|(shown, _)| *shown).map(|(_, name)| (*name).to_owned()));
    let or_dash = |v: &Option<Estimated>| v.as_ref().map_or("–".to_owned(), figure);
    let mut rows: Vec<Vec<String>> = all
        .iter()
        .map(|s| {
            let mut row = vec![s.name.clone(), figure(&s.rmse), short_or_dash(s.claimed_rms)];
            row.extend(s.mean_abs.iter().take(columns).map(figure));
            if !linear {
                row.push(short_or_dash(s.median_position_m));
            }
            row.extend([0, 2, 3].map(|i| short_or_dash(s.quantiles.get(i).copied())));
            row.push(percent(s.verdict.diverges.mean));
            let cells = [or_dash(&s.energy_mj), or_dash(&s.time_steps), s.failed.to_string(), s.missing.to_string()];
            row.extend(cells.into_iter().zip(more).filter(|(_, (shown, _))| *shown).map(|(cell, _)| cell));
            row
        })
        .collect();
    if let Ok(bound) = &one.outcome.bound {
        rows.push(vec!["Cramér–Rao bound".to_owned(), figure(&bound.rms)]);
    }
    table(&header.iter().map(String::as_str).collect::<Vec<_>>(), &rows)
}

/// Whether errors are as claimed.
fn consistency(all: &[Summary]) -> String {
    let band = |band: Option<(f64, f64)>| band.map_or("–".to_owned(), |(a, b)| format!("{a:.3} – {b:.3}"));
    let header = ["", "ANEES/n", "95 % band", "ANIS/m", "95 % band", "in 50 %", "in 95 %"];
    let rows: Vec<Vec<String>> = all
        .iter()
        .map(|s| {
            vec![
                s.name.clone(),
                figure(&s.anees),
                band(s.anees_band),
                s.anis.as_ref().map_or("–".to_owned(), figure),
                band(s.anis_band),
                percent(s.coverage[0].mean),
                percent(s.coverage[1].mean),
            ]
        })
        .collect();
    table(&header, &rows)
}

fn verdicts(all: &[Summary]) -> String {
    let lines: Vec<String> = all
        .iter()
        .map(|s| {
            let note = if s.smoothed { " (smoothed)" } else { "" };
            format!("  {}{note}: {}", s.name, s.verdict.sentence)
        })
        .collect();
    lines.join("\n")
}

/// Steady states, as standard deviations.
fn in_the_long_run(long_run: &LongRun) -> String {
    let mut header = vec!["long run, standard deviation".to_owned(), "predicted".to_owned(), "filtered".to_owned()];
    header.extend(long_run.lags.iter().map(|(lag, _)| match lag {
        Some(lag) => format!("lag {lag}"),
        None => "lag ∞".to_owned(),
    }));
    header.push("filtered, with these losses".to_owned());
    let rows: Vec<Vec<String>> = long_run
        .theory
        .states
        .iter()
        .enumerate()
        .map(|(i, state)| {
            let mut row = vec![
                state.name.clone(),
                short_or_dash(state.predicted.lossless),
                short_or_dash(state.filtered.lossless),
            ];
            row.extend(long_run.lags.iter().map(|(_, sds)| short(sds[i])));
            row.push(match (state.filtered.lower, state.filtered.upper) {
                (Some(low), Some(high)) if high - low <= 1e-6 * high => short(high),
                (Some(low), Some(high)) => format!("{} – {}", short(low), short(high)),
                (Some(low), None) => format!("at least {}", short(low)),
                _ => "without bound".to_owned(),
            });
            row
        })
        .collect();
    table(&header.iter().map(String::as_str).collect::<Vec<_>>(), &rows)
}

/// What the figures mean.
fn reading(world: &Simulated, results: &[Table]) -> String {
    let linear = registry::layout(&world.truth).is_linear();
    let mut out = vec![
        "± is a standard error over the runs; percentiles are of the errors of all runs and instants together.",
        "ANEES/n and ANIS/m are 1 for a consistent estimator. The band of ANEES is by runs, because the instants of a run",
        "are correlated; that of ANIS by runs and instants, whose innovations are independent then. The verdict is by the",
        "99 % interval of ANEES over the runs.",
    ]
    .into_iter()
    .map(str::to_owned)
    .collect::<Vec<String>>();
    if linear {
        out.push(format!(
            "Errors are those of the whole state. Lost: squared errors of {LOST_NEES} times what is claimed in a run's last tenth."
        ));
    }
    match results.first().map(|t| &t.outcome.bound) {
        Some(Ok(_)) => out.push("The Cramér–Rao bound is for causal estimates; a smoother may go below.".to_owned()),
        Some(Err(why)) => out.push(format!("There is no Cramér–Rao bound: {why}.")),
        None => {}
    }
    out.join("\n")
}

/// The same for programs.
pub fn json(world: &Simulated, seed: u64, results: &[Table]) -> Value {
    json!({
        "runs": world.runs,
        "steps": world.steps,
        "seed": seed,
        "channels": results.iter().map(|t| json!({
            "loss_rate": t.loss_rate,
            "contenders": t.outcome.contenders.iter().map(contender).collect::<Vec<_>>(),
            "bound": bound(t),
            "long_run": t.outcome.long_run.as_ref().map(long_run),
        })).collect::<Vec<_>>(),
    })
}

fn estimated(v: &Estimated) -> Value {
    json!({ "mean": finite(v.mean), "se": finite(v.se) })
}

fn contender(s: &Summary) -> Value {
    let quantile = |i: usize| s.quantiles.get(i).copied().and_then(finite);
    let band = |band: Option<(f64, f64)>| band.map(|(low, high)| [low, high]);
    json!({
        "name": s.name,
        "smoothed": s.smoothed,
        "failed": s.failed,
        "first_failure": s.first_failure,
        "missing": s.missing,
        "rmse": estimated(&s.rmse),
        "claimed_rms": s.claimed_rms.and_then(finite),
        "p50": quantile(0),
        "p60": quantile(1),
        "p90": quantile(2),
        "p95": quantile(3),
        "mean_abs": s.mean_abs.iter().map(estimated).collect::<Vec<_>>(),
        "mse": estimated(&s.mse),
        "claimed": estimated(&s.claimed),
        "anees": estimated(&s.anees),
        "anees_band95": band(s.anees_band),
        "anis": s.anis.as_ref().map(estimated),
        "anis_band95": band(s.anis_band),
        "coverage50": estimated(&s.coverage[0]),
        "coverage95": estimated(&s.coverage[1]),
        "median_position_m": s.median_position_m.and_then(finite),
        "lost_share": s.lost_share.as_ref().map(estimated),
        "diverges": estimated(&s.verdict.diverges),
        "energy_mj": s.energy_mj.as_ref().map(estimated),
        "time_steps": s.time_steps.as_ref().map(estimated),
        "claim": s.verdict.claim.name(),
        "factor": s.verdict.factor.as_ref().map(estimated),
        "verdict": s.verdict.sentence,
    })
}

fn bound(t: &Table) -> Value {
    match &t.outcome.bound {
        Ok(bound) => json!({
            "rms": estimated(&bound.rms),
            "mean_square": bound.mean_square.iter().map(estimated).collect::<Vec<_>>(),
        }),
        Err(why) => json!({ "missing": why }),
    }
}

fn long_run(long_run: &LongRun) -> Value {
    let states = long_run.theory.states.iter().enumerate().map(|(i, state)| {
        let lags: Map<String, Value> = long_run
            .lags
            .iter()
            .map(|(lag, sds)| (lag.map_or("all".to_owned(), |lag| lag.to_string()), json!(sds[i])))
            .collect();
        let of =
            |b: &fixtrail_track::theory::Bounds| json!({ "lower": b.lower, "upper": b.upper, "lossless": b.lossless });
        json!({ "name": state.name, "predicted": of(&state.predicted), "filtered": of(&state.filtered), "lag": lags })
    });
    json!({ "arrival": long_run.theory.arrival, "states": states.collect::<Vec<_>>() })
}

/// JSON has no infinity.
fn finite(v: f64) -> Option<f64> {
    v.is_finite().then_some(v)
}

/// What a channel made of a recording.
pub fn replayed(packets: u64, lost: u64, longest_burst: u64, folder: &Path) -> String {
    format!(
        "{} sent, {} lost ({}), at most {longest_burst} in a row; what arrived is in {}",
        counted(packets, "packet"),
        lost,
        percent(lost as f64 / (packets as f64).max(1.0)),
        folder.join("measurements.csv").display()
    )
}
