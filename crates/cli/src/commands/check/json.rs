//! A survey as JSON.

use super::promise;
use crate::data::{Data, DataArguments};
use fixtrail_track::survey::{KindSurvey, Late, Loss, Quantiles, Survey, TargetSurvey};
use fixtrail_track::theory::{Bounds, Source, Theory};
use serde_json::{Value, json};

/// Everything that `check --json` prints.
pub fn report(arguments: &DataArguments, data: &Data, survey: &Survey) -> Value {
    let counts = &data.table.counts;
    json!({
        "input": arguments.input.to_string_lossy(),
        "spec": data.spec.as_ref().ok().and_then(|s| s.path.as_ref()).map(|p| p.to_string_lossy()),
        "rows": counts.rows,
        "duplicates": counts.duplicates,
        "out_of_order": counts.out_of_order,
        "skipped_bad_rows": counts.skipped_bad,
        "ignored_columns": counts.ignored_columns,
        "unused_kinds": data.unused,
        "targets": survey.targets.iter().map(target).collect::<Vec<_>>(),
        "kinds": survey.kinds.iter().map(|k| kind(k, survey)).collect::<Vec<_>>(),
        "anchors": survey.anchors.iter()
            .map(|a| json!({ "anchor": a.name, "rows": a.rows, "share": a.share })).collect::<Vec<_>>(),
        "geometry": survey.geometry.as_ref().map(|g| json!({
            "anchors_heard": g.count,
            "spread_m": g.spread_m,
            "heights_m": g.heights_m,
            "collinear": g.is_collinear(),
            "coplanar": g.is_coplanar(),
        })),
        "loss": survey.loss.as_ref().map(loss),
        "findings": survey.findings.iter()
            .map(|f| json!({ "severity": f.severity.name(), "text": f.text })).collect::<Vec<_>>(),
        "theory": promise(data, survey).map(|told| told.map_or_else(
            |why| json!({ "not_defined_because": why }),
            |(told, source)| theory(&told, source),
        )),
        "proposed_spec": data.spec.as_ref().ok().filter(|s| s.path.is_none()).map(|s| &s.text),
        "no_spec_because": data.spec.as_ref().err().map(ToString::to_string),
    })
}

fn target(t: &TargetSurvey) -> Value {
    json!({
        "target": t.target,
        "rows": t.rows,
        "instants": t.instants,
        "start_s": t.start_s,
        "end_s": t.end_s,
        "interval_s": t.interval_s.as_ref().map(quantiles),
        "period_s": t.period_s,
        "silences": {
            "count": t.silences.count,
            "missing_instants": t.silences.missing,
            "longest_s": t.silences.longest_s,
            "longest_at_s": t.silences.longest_at_s,
        },
        "loss": t.loss.as_ref().map(loss),
        "late": late(&t.late),
    })
}

fn quantiles(q: &Quantiles) -> Value {
    json!({ "min": q.min, "p05": q.p05, "p50": q.p50, "p95": q.p95, "max": q.max })
}

fn late(l: &Late) -> Value {
    json!({
        "overtaken": l.overtaken,
        "worst_s": l.worst_s,
        "needed_late_s": l.needed_late_s(),
        "delay_s": l.delay_s.as_ref().map(quantiles),
    })
}

fn loss(l: &Loss) -> Value {
    json!({
        "by": l.basis.name(),
        "expected": l.expected,
        "lost": l.lost,
        "rate": l.rate(),
        "bursts": l.bursts,
        "mean_burst": l.mean_burst(),
        "mean_burst_if_independent": l.geometric_mean_burst(),
        "longest_burst": l.longest_burst,
        "bursty": l.is_bursty(),
    })
}

fn theory(t: &Theory, source: Source) -> Value {
    let bounds = |b: &Bounds| json!({ "lower": b.lower, "upper": b.upper, "lossless": b.lossless });
    json!({
        "arrival": t.arrival,
        "arrival_by": source.text(),
        "interval_s": t.interval_s,
        "spectral_radius": t.spectral_radius,
        "critical_rate": { "lower": t.critical.lower, "upper": t.critical.upper },
        "error": t.verdict.name(),
        "states": t.states.iter()
            .map(|s| json!({ "state": s.name, "predicted_sd": bounds(&s.predicted), "filtered_sd": bounds(&s.filtered) }))
            .collect::<Vec<_>>(),
        "says": t.sentences(),
    })
}

fn kind(k: &KindSurvey, survey: &Survey) -> Value {
    json!({
        "kind": k.kind.name(),
        "rows": k.rows,
        "rows_with_sd": k.with_sd,
        "typical": k.typical,
        "jitter_sd": k.quick_sd,
        "jitter_sd_z": k.quick_sd_z,
        "misfit_sd": k.fit_sd,
        "misfit_height_m": k.fit_height_m,
        "common_bias_m": k.fit_bias_m,
        "path_loss": k.law.map(|l| json!({ "exponent": l.exponent, "at_1m_dbm": l.at_1m_dbm, "fitted": l.fitted })),
        "speed_m_s": k.speed,
        "acceleration_psd": k.psd,
        "outliers": k.outliers,
        "worst_outlier": k.worst_outlier.as_ref().map(|w| json!({
            "target": w.target,
            "anchor": w.anchor.and_then(|id| survey.anchors.get(id as usize)).map(|a| &a.name),
            "t_s": w.t_s,
            "off": w.off,
        })),
    })
}
