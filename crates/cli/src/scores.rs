//! Trails against truth: the table, and the same as JSON.

use crate::figures::{counted, percent, short, short_or_dash};
use crate::output::table;
use fixtrail_sim::metrics::{self, Kind, Score, ScoreRow};
use fixtrail_track::fix::{Estimate, Fix, Sink};
use fixtrail_track::spec::{EstimatorSpec, Spec};
use fixtrail_track::target::TargetTrail;
use fixtrail_track::trackers::LaggedMode;
use fixtrail_track::trail::Trail;
use serde_json::{Value, json};

/// How the rows of a trail that `spec` makes in `mode` are to be read between its fixes.
pub fn kind(spec: &Spec, mode: LaggedMode) -> Kind {
    match (mode, spec.estimator) {
        (LaggedMode::Own, EstimatorSpec::Rts | EstimatorSpec::FixedLagKalman { .. }) => Kind::Smoother,
        _ => Kind::Filter,
    }
}

/// The smoother's half of trails that hold both, its rows at the times they describe.
pub fn smoothers(trails: &[TargetTrail]) -> Vec<TargetTrail> {
    trails
        .iter()
        .map(|t| TargetTrail { target: t.target.clone(), trail: smoother(&t.trail), link: t.link.clone() })
        .collect()
}

fn smoother(both: &Trail) -> Trail {
    let n = both.n();
    let mut alone = Trail::new(n, false);
    let Some(columns) = &both.lagged else { return alone };
    for row in 0..both.len() {
        let (Some(k), Some(status)) = (columns.k[row], columns.status[row]) else { continue };
        let full = both.lagged(row).map(|(mean, packed)| {
            let entry = |i: usize| packed[Trail::packed_index(n, (i / n).min(i % n), (i / n).max(i % n))];
            (mean, (0..n * n).map(entry).collect::<Vec<f64>>())
        });
        let estimate = full.as_ref().map(|(mean, cov)| Estimate { mean, cov });
        alone.fix(&Fix { k, t_s: columns.t_s[row], estimate, status, nis: None, nis_dof: 0, lagged: None });
    }
    alone
}

/// The columns of a comparison.
pub const HEADER: [&str; 10] =
    ["", "instants", "RMSE/m", "50 %", "60 %", "90 %", "95 %", "coverage", "NEES", "95 % band"];

/// One line of a comparison.
pub fn line(name: &str, row: &ScoreRow) -> Vec<String> {
    let errors = row.errors.as_ref();
    let metres = |f: &dyn Fn(&metrics::Errors) -> f64| short_or_dash(errors.map(f));
    vec![
        name.to_owned(),
        row.instants.to_string(),
        metres(&|e| e.rmse_m),
        metres(&|e| e.p50_m),
        metres(&|e| e.p60_m),
        metres(&|e| e.p90_m),
        metres(&|e| e.p95_m),
        row.coverage95.map_or("–".to_owned(), percent),
        short_or_dash(row.mean_nees),
        row.nees_band95.map_or("–".to_owned(), |(low, high)| format!("{low:.2} … {high:.2}")),
    ]
}

/// The name of a target for people.
fn name(target: Option<&str>) -> String {
    target.unwrap_or("–").to_owned()
}

/// The comparison as a table with its verdicts.
pub fn text(title: &str, score: &Score) -> String {
    let mut rows: Vec<Vec<String>> = score.targets.iter().map(|t| line(&name(t.target.as_deref()), &t.row)).collect();
    let mut verdicts: Vec<String> =
        score.targets.iter().map(|t| format!("  {}: {}", name(t.target.as_deref()), t.row.verdict)).collect();
    if score.targets.len() > 1 {
        rows.push(line("all", &score.overall));
        verdicts.push(format!("  all: {}", score.overall.verdict));
    }
    let mut out = format!("{title}\n{}\n{}", table(&HEADER, &rows), verdicts.join("\n"));
    if score.overall.missing > 0 {
        out += &format!("\n  {} without an estimate", counted(score.overall.missing as u64, "truth instant"));
    }
    for (targets, without) in [(&score.without_trail, "trail"), (&score.without_truth, "truth")] {
        if !targets.is_empty() {
            let names: Vec<String> = targets.iter().map(|t| name(t.as_deref())).collect();
            out += &format!("\n  no {without}: {}", names.join(", "));
        }
    }
    if let Some(nis) = &score.overall.nis {
        let (low, high) = nis.band95;
        out += &format!(
            "\n  innovations: {} times as large as claimed, squared (a consistent filter: {} to {})",
            short(nis.ratio),
            short(low),
            short(high)
        );
    }
    out
}

/// The comparison as JSON.
pub fn json(score: &Score) -> Value {
    json!({
        "targets": score.targets.iter().map(|t| {
            let mut row = json_row(&t.row);
            row["target"] = json!(t.target);
            row
        }).collect::<Vec<_>>(),
        "overall": json_row(&score.overall),
        "without_trail": score.without_trail,
        "without_truth": score.without_truth,
    })
}

/// One line of a comparison as JSON.
pub fn json_row(row: &ScoreRow) -> Value {
    let mut value = json!({
        "instants": row.instants,
        "missing": row.missing,
        "incomplete": row.incomplete,
        "coverage95": row.coverage95,
        "mean_nees": row.mean_nees,
        "nees_dof": row.nees_dof,
        "nees_band95": row.nees_band95,
        "nis_ratio": row.nis.as_ref().map(|n| n.ratio),
        "nis_band95": row.nis.as_ref().map(|n| n.band95),
        "consistency": consistency(row.consistency),
        "verdict": row.verdict,
    });
    if let Some(e) = &row.errors {
        value["rmse_m"] = json!(e.rmse_m);
        value["mean_m"] = json!(e.mean_m);
        value["p50_m"] = json!(e.p50_m);
        value["p60_m"] = json!(e.p60_m);
        value["p90_m"] = json!(e.p90_m);
        value["p95_m"] = json!(e.p95_m);
        value["max_m"] = json!(e.max_m);
        value["bias_m"] = json!(e.bias_m);
        value["rmse_3d_m"] = json!(e.rmse_3d_m);
    }
    value
}

pub fn consistency(c: metrics::Consistency) -> &'static str {
    match c {
        metrics::Consistency::OverConfident => "over-confident",
        metrics::Consistency::Consistent => "consistent",
        metrics::Consistency::UnderConfident => "under-confident",
        metrics::Consistency::NotJudged => "not judged",
    }
}
