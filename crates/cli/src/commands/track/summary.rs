//! What a run did, for people and for programs.

use super::link::LinkSummary;
use super::{Arguments, Outcome};
use crate::data::SpecText;
use crate::figures::{counted, grouped, short};
use crate::scores;
use fixtrail_batch::Table;
use fixtrail_sim::metrics::nis;
use fixtrail_track::fix::Status;
use fixtrail_track::survey::{Severity, Survey};
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;

/// Everything there is to say about a run.
pub struct Summary<'a> {
    pub arguments: &'a Arguments,
    pub table: &'a Table,
    pub survey: Option<&'a Survey>,
    pub spec: &'a SpecText,
    pub unused: &'a BTreeMap<String, u64>,
    pub outcome: &'a Outcome,
}

const STATUSES: [Status; 4] = [Status::Updated, Status::Predicted, Status::Rejected, Status::Unobservable];

impl Summary<'_> {
    fn count(&self, status: Status) -> u64 {
        self.outcome.trails.iter().flat_map(|t| &t.trail.status).filter(|s| **s == status).count() as u64
    }

    fn fixes(&self) -> u64 {
        self.outcome.trails.iter().map(|t| t.trail.len() as u64).sum()
    }

    fn link(&self) -> LinkSummary {
        LinkSummary::of(&self.spec.spec, &self.outcome.trails)
    }

    fn restarts(&self) -> u64 {
        self.outcome.trails.iter().map(|t| t.trail.restarts).sum()
    }

    fn rows_per_s(&self) -> Option<f64> {
        let used: usize = self.table.targets.iter().map(|t| t.packets.len()).sum();
        (self.outcome.seconds > 0.0).then(|| used as f64 / self.outcome.seconds)
    }

    /// A few lines for standard error.
    pub fn text(&self) -> String {
        let mut lines = self.arguments.data.reading(self.table, self.unused);
        lines.extend(self.link().text());
        // Findings that spoil the trail; `check` tells the rest.
        for finding in self.survey.iter().flat_map(|s| &s.findings).filter(|f| f.severity == Severity::Problem) {
            lines.push(format!("{}: {}", finding.severity.name(), finding.text));
        }
        let by_status: Vec<String> = STATUSES
            .into_iter()
            .map(|status| (self.count(status), status))
            .filter(|(n, _)| *n > 0)
            .map(|(n, status)| format!("{} {}", grouped(n), status.name()))
            .collect();
        let rate = self.rows_per_s().map_or(String::new(), |r| format!(" ({} rows/s)", grouped(r as u64)));
        lines.push(format!(
            "{}: {} by `{}` in {} s{rate}: {}",
            self.arguments.output.display(),
            match self.fixes() {
                1 => "1 fix".to_owned(),
                n => format!("{} fixes", grouped(n)),
            },
            self.spec.spec.estimator.name(),
            short(self.outcome.seconds),
            by_status.join(", ")
        ));
        if self.restarts() > 0 {
            lines.push(format!(
                "{}, lost or out of sight for long: the track was started anew",
                counted(self.restarts(), "time")
            ));
        }
        if let Some(report) = &self.arguments.report {
            lines.push(format!("{}: the report, opens in any browser", report.display()));
        }
        lines.join("\n")
    }

    /// The comparison with truth.
    pub fn scores(&self) -> Option<String> {
        let score = self.outcome.score.as_ref()?;
        let mut text = scores::text("errors against truth", score);
        if let Some((_, Some(smoothed))) = &self.outcome.smoother {
            text += &format!("\n\n{}", scores::text("errors against truth, smoothed", smoothed));
        }
        Some(text)
    }

    /// One object with everything.
    pub fn json(&self) -> Value {
        let counts = &self.table.counts;
        let fixes: Map<String, Value> =
            STATUSES.into_iter().map(|s| (s.name().to_owned(), json!(self.count(s)))).collect();
        let innovations = nis(self.outcome.trails.iter().map(|t| &t.trail));
        json!({
            "input": self.arguments.data.input.to_string_lossy(),
            "output": self.arguments.output.to_string_lossy(),
            "spec": self.spec.path.as_ref().map(|p| p.to_string_lossy()),
            "proposed_spec": self.spec.path.is_none().then_some(&self.spec.text),
            "estimator": self.spec.spec.estimator.name(),
            "rows": counts.rows,
            "targets": self.table.targets.len(),
            "duplicates": counts.duplicates,
            "out_of_order": counts.out_of_order,
            "skipped_bad_rows": counts.skipped_bad,
            "first_bad_row": counts.first_bad,
            "ignored_columns": counts.ignored_columns,
            "unused_kinds": self.unused,
            "link": self.link().json(),
            "fixes": fixes,
            "restarts": self.restarts(),
            "origin": self.table.origin.as_ref().map(|o| json!({ "lat": o.lat_deg, "lon": o.lon_deg, "alt": o.alt_m })),
            "seconds": self.outcome.seconds,
            "rows_per_s": self.rows_per_s(),
            "nis_ratio": innovations.as_ref().map(|n| n.ratio),
            "nis_band95": innovations.as_ref().map(|n| n.band95),
            "truth": self.outcome.score.as_ref().map(scores::json),
            "truth_smoothed": self.outcome.smoother.as_ref().and_then(|(_, s)| s.as_ref()).map(scores::json),
            "report": self.arguments.report.as_ref().map(|p| p.to_string_lossy()),
        })
    }
}
