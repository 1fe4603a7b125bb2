//! Results of a simulation as text and as JSON.

use super::Table;
use crate::figures::{counted, percent, short, short_or_dash};
use crate::output::table;
use fixtrail_sim::monte_carlo::{Estimated, Summary};
use fixtrail_track::registry;
use fixtrail_track::spec::Simulated;
use serde_json::{Value, json};
use std::path::Path;

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
    let mut blocks = vec![format!("{runs} of {} each, seed {seed}", counted(world.steps as u64, "instant"))];
    for one in results {
        blocks.push(format!("loss rate {}\n{}", short(one.loss_rate), lines(world, &one.lines)));
    }
    let failures = results.iter().flat_map(|t| &t.lines).filter_map(|s| {
        let first = s.first_failure.as_ref()?;
        Some(format!("{}: {} failed, the first: {first}", s.name, counted(s.failed as u64, "run")))
    });
    let failures: Vec<String> = failures.collect();
    if !failures.is_empty() {
        blocks.push(failures.join("\n"));
    }
    blocks.join("\n\n")
}

fn lines(world: &Simulated, all: &[Summary]) -> String {
    let layout = registry::layout(&world.truth);
    let mut header: Vec<String> = vec![String::new()];
    if layout.is_linear() {
        header.extend(layout.names.iter().map(|name| format!("mean |{name} error|")));
    } else {
        header.push("median RMSE/m".to_owned());
        header.push("end > 10 m off".to_owned());
    }
    header.extend(["MSE", "claimed", "ANEES/n", "failed"].map(str::to_owned));
    let rows: Vec<Vec<String>> = all
        .iter()
        .map(|s| {
            let mut row = vec![s.name.clone()];
            if layout.is_linear() {
                row.extend(s.mean_abs.iter().map(figure));
            } else {
                row.push(short_or_dash(s.median_position_m));
                row.push(s.lost_share.map_or("–".to_owned(), |v| percent(v.mean)));
            }
            row.extend([figure(&s.mse), figure(&s.claimed), figure(&s.anees), s.failed.to_string()]);
            row
        })
        .collect();
    let header: Vec<&str> = header.iter().map(String::as_str).collect();
    table(&header, &rows)
}

/// The same for programs.
pub fn json(world: &Simulated, seed: u64, results: &[Table]) -> Value {
    let estimated = |v: &Estimated| json!({ "mean": finite(v.mean), "se": finite(v.se) });
    json!({
        "runs": world.runs,
        "steps": world.steps,
        "seed": seed,
        "channels": results.iter().map(|t| json!({
            "loss_rate": t.loss_rate,
            "contenders": t.lines.iter().map(|s| json!({
                "name": s.name,
                "failed": s.failed,
                "first_failure": s.first_failure,
                "missing": s.missing,
                "mean_abs": s.mean_abs.iter().map(estimated).collect::<Vec<_>>(),
                "mse": estimated(&s.mse),
                "claimed": estimated(&s.claimed),
                "anees": estimated(&s.anees),
                "median_position_m": s.median_position_m.and_then(finite),
                "lost_share": s.lost_share.as_ref().map(estimated),
            })).collect::<Vec<_>>(),
        })).collect::<Vec<_>>(),
    })
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
