//! What a run did, for people and for programs.

use super::Arguments;
use super::link::LinkSummary;
use crate::data::SpecText;
use crate::figures::{counted, grouped, short};
use crate::scores;
use fixtrail_batch::{Counts, Totals};
use fixtrail_sim::metrics::{Nis, Score};
use fixtrail_track::fix::Status;
use fixtrail_track::geo::Origin;
use fixtrail_track::survey::{Severity, Survey};
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;

/// Everything there is to say about a run.
pub struct Summary<'a> {
    pub arguments: &'a Arguments,
    pub counts: &'a Counts,
    pub origin: Option<Origin>,
    pub survey: Option<&'a Survey>,
    pub spec: &'a SpecText,
    pub unused: &'a BTreeMap<String, u64>,
    pub totals: &'a Totals,
    /// The comparison with truth, of the filter and of the smoother beside it.
    pub scores: [Option<&'a Score>; 2],
    pub seconds: f64,
}

const STATUSES: [Status; 4] = [Status::Updated, Status::Predicted, Status::Rejected, Status::Unobservable];

impl Summary<'_> {
    fn link(&self) -> LinkSummary<'_> {
        LinkSummary::of(&self.spec.spec, self.totals)
    }

    fn rows_per_s(&self) -> Option<f64> {
        (self.seconds > 0.0).then(|| self.totals.packets as f64 / self.seconds)
    }

    /// A few lines for standard error.
    pub fn text(&self) -> String {
        let mut lines = self.arguments.data.reading(self.counts, self.totals.targets, self.unused);
        lines.extend(self.link().text());
        // Findings that spoil the trail; `check` tells the rest.
        for finding in self.survey.iter().flat_map(|s| &s.findings).filter(|f| f.severity == Severity::Problem) {
            lines.push(format!("{}: {}", finding.severity.name(), finding.text));
        }
        let by_status: Vec<String> = STATUSES
            .into_iter()
            .map(|status| (self.totals.count(status), status))
            .filter(|(n, _)| *n > 0)
            .map(|(n, status)| format!("{} {}", grouped(n), status.name()))
            .collect();
        let rate = self.rows_per_s().map_or(String::new(), |r| format!(" ({} rows/s)", grouped(r as u64)));
        lines.push(format!(
            "{}: {} by `{}` in {} s{rate}: {}",
            self.arguments.output.display(),
            match self.totals.fixes() {
                1 => "1 fix".to_owned(),
                n => format!("{} fixes", grouped(n)),
            },
            self.spec.spec.estimator.name(),
            short(self.seconds),
            by_status.join(", ")
        ));
        if self.totals.restarts > 0 {
            lines.push(format!(
                "{}, lost or out of sight for long: the track was started anew",
                counted(self.totals.restarts, "time")
            ));
        }
        if let Some(report) = &self.arguments.report {
            lines.push(format!("{}: the report, opens in any browser", report.display()));
        }
        lines.join("\n")
    }

    /// The comparison with truth.
    pub fn scores(&self) -> Option<String> {
        let [score, smoothed] = self.scores;
        let mut text = scores::text("errors against truth", score?);
        if let Some(smoothed) = smoothed {
            text += &format!("\n\n{}", scores::text("errors against truth, smoothed", smoothed));
        }
        Some(text)
    }

    /// One object with everything.
    pub fn json(&self) -> Value {
        let counts = self.counts;
        let fixes: Map<String, Value> =
            STATUSES.into_iter().map(|s| (s.name().to_owned(), json!(self.totals.count(s)))).collect();
        let (instants, dof, sum) = self.totals.innovations;
        let innovations = Nis::of(instants, dof, sum);
        json!({
            "input": self.arguments.data.input.to_string_lossy(),
            "output": self.arguments.output.to_string_lossy(),
            "spec": self.spec.path.as_ref().map(|p| p.to_string_lossy()),
            "proposed_spec": self.spec.path.is_none().then_some(&self.spec.text),
            "estimator": self.spec.spec.estimator.name(),
            "rows": counts.rows,
            "targets": self.totals.targets,
            "duplicates": counts.duplicates,
            "out_of_order": counts.out_of_order,
            "skipped_bad_rows": counts.skipped_bad,
            "first_bad_row": counts.first_bad,
            "ignored_columns": counts.ignored_columns,
            "unused_kinds": self.unused,
            "link": self.link().json(),
            "fixes": fixes,
            "restarts": self.totals.restarts,
            "origin": self.origin.map(|o| json!({ "lat": o.lat_deg, "lon": o.lon_deg, "alt": o.alt_m })),
            "seconds": self.seconds,
            "rows_per_s": self.rows_per_s(),
            "nis_ratio": innovations.as_ref().map(|n| n.ratio),
            "nis_band95": innovations.as_ref().map(|n| n.band95),
            "truth": self.scores[0].map(scores::json),
            "truth_smoothed": self.scores[1].map(scores::json),
            "report": self.arguments.report.as_ref().map(|p| p.to_string_lossy()),
        })
    }
}
