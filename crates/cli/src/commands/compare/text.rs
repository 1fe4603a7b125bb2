//! A comparison for people and for programs.

use super::Arguments;
use super::entries::{Entry, Knows, Measure};
use super::verdict::{Ranked, Verdict};
use crate::data::SpecText;
use crate::figures::{percent, short, short_or_dash};
use crate::output::table;
use crate::scores;
use fixtrail_batch::Table;
use fixtrail_track::packet::Kind;
use fixtrail_track::predictive::Size;
use serde_json::{Value, json};
use std::collections::BTreeSet;

/// Marks the best of a column.
const BEST: &str = " *";

/// The table and the verdict.
pub fn text(entries: &[Entry], measure: Measure<'_>, verdict: &Verdict) -> String {
    let name = |(i, entry): (usize, &Entry)| {
        let note = match entry.note() {
            "" => String::new(),
            note => format!(" ({note})"),
        };
        format!("{}{note}{}", entry.name, if verdict.is_best(i) { BEST } else { "" })
    };
    let kinds = kinds(entries);
    let header: Vec<String> = match measure {
        Measure::Truth { .. } => ["", "RMSE/m", "50 %", "90 %", "in 95 %", "NEES", "expected", "verdict", "µs/instant"]
            .map(str::to_owned)
            .to_vec(),
        Measure::Prediction => {
            let name = |size: &str, kind: &Kind| format!("{size} {}{}", kind.name(), per(*kind));
            let sizes = kinds.iter().flat_map(|kind| [name("RMS", kind), name("median", kind)]);
            let end = ["ν²/S", "values", "not foretold", "µs/instant"].map(str::to_owned);
            ["".to_owned(), "score".to_owned()].into_iter().chain(sizes).chain(end).collect()
        }
    };
    let rows: Vec<Vec<String>> = entries
        .iter()
        .enumerate()
        .map(|(i, entry)| {
            let mut cells = vec![name((i, entry))];
            cells.extend(truth_cells(entry));
            cells.extend(prediction_cells(entry, &kinds));
            cells.push(short(entry.us_per_instant()));
            cells
        })
        .collect();
    let header: Vec<&str> = header.iter().map(String::as_str).collect();
    let sentences: Vec<String> = verdict.sentences.iter().map(|s| format!("  {s}")).collect();
    format!("{}\n\n{}", table(&header, &rows), sentences.join("\n"))
}

fn per(kind: Kind) -> String {
    if kind.unit().is_empty() { String::new() } else { format!("/{}", kind.unit()) }
}

/// The kinds that any entry foretold.
fn kinds(entries: &[Entry]) -> BTreeSet<Kind> {
    entries.iter().filter_map(|e| e.foretold.as_ref()).flat_map(|f| f.sizes().map(|(kind, _)| kind)).collect()
}

fn truth_cells(entry: &Entry) -> Vec<String> {
    let Some(row) = entry.score.as_ref().map(|s| &s.overall) else { return Vec::new() };
    let errors = row.errors.as_ref();
    vec![
        short_or_dash(errors.map(|e| e.rmse_m)),
        short_or_dash(errors.map(|e| e.p50_m)),
        short_or_dash(errors.map(|e| e.p90_m)),
        row.coverage95.map_or("–".to_owned(), percent),
        short_or_dash(row.mean_nees),
        row.nees_dof.to_string(),
        scores::consistency(row.consistency).to_owned(),
    ]
}

fn prediction_cells(entry: &Entry, kinds: &BTreeSet<Kind>) -> Vec<String> {
    let Some(foretold) = &entry.foretold else { return Vec::new() };
    let sizes: Vec<(Kind, Size)> = foretold.sizes().collect();
    let size = |kind: &Kind| sizes.iter().find(|(k, _)| k == kind).map(|(_, size)| size);
    let mut cells = vec![short_or_dash(foretold.mean_log_density())];
    let both = |kind| [size(kind).map(|s| s.rms), size(kind).map(|s| s.median)].map(short_or_dash);
    cells.extend(kinds.iter().flat_map(both));
    cells.push(short_or_dash(foretold.mean_nis()));
    cells.push(foretold.scalars.to_string());
    cells.push(foretold.unforetold.to_string());
    cells
}

/// One object with everything.
pub fn json(
    arguments: &Arguments,
    table: &Table,
    spec: &SpecText,
    entries: &[Entry],
    measure: Measure<'_>,
    verdict: &Verdict,
) -> Value {
    let entry = |(i, e): (usize, &Entry)| {
        let mut row = e.score.as_ref().map_or(json!({}), |s| scores::json_row(&s.overall));
        if let Some(foretold) = &e.foretold {
            let sizes = foretold.sizes().map(|(kind, s)| {
                (kind.name().to_owned(), json!({ "values": s.scalars, "rms": s.rms, "median": s.median }))
            });
            row["score"] = json!(foretold.mean_log_density());
            row["mean_nis"] = json!(foretold.mean_nis());
            row["values"] = json!(foretold.scalars);
            row["not_foretold"] = json!(foretold.unforetold);
            row["innovations"] = Value::Object(sizes.collect());
        }
        row["name"] = json!(e.name);
        row["uses_later_data"] = json!(e.knows == Knows::Later);
        row["filter_of_a_smoother"] = json!(e.knows == Knows::OwnFilter);
        row["best"] = json!(verdict.is_best(i));
        row["seconds"] = json!(e.seconds);
        row["us_per_instant"] = json!(e.us_per_instant());
        row
    };
    let ranking = |ranked: &Ranked| {
        let name = |i: &usize| entries[ranked.among[*i]].name.as_str();
        let r = &ranked.ranking;
        json!({
            "order": r.order.iter().map(name).collect::<Vec<_>>(),
            "mean_losses": r.means,
            "instants": r.instants,
            "not_ranked": r.left_out.iter().map(name).collect::<Vec<_>>(),
            "behind_the_best": r.differences.iter().map(|d| json!({
                "mean": d.mean, "standard_error": d.standard_error, "blocks": d.blocks, "block": d.block,
            })).collect::<Vec<_>>(),
        })
    };
    json!({
        "input": arguments.data.input.to_string_lossy(),
        "spec": spec.path.as_ref().map(|p| p.to_string_lossy()),
        "proposed_spec": spec.path.is_none().then_some(&spec.text),
        "rows": table.counts.rows,
        "targets": table.targets.len(),
        "measured_by": match measure {
            Measure::Truth { .. } => "truth",
            Measure::Prediction => "prediction",
        },
        "estimators": entries.iter().enumerate().map(entry).collect::<Vec<_>>(),
        "ranking": ranking(&verdict.all),
        "ranking_without_later_data": verdict.causal.as_ref().map(ranking),
        "verdict": verdict.sentences,
        "report": arguments.report.as_ref().map(|p| p.to_string_lossy()),
    })
}
