//! What the links of all targets did with their packets.

use crate::figures::{counted, short};
use fixtrail_batch::Totals;
use fixtrail_track::link::LinkReport;
use fixtrail_track::spec::{Receiver, Spec};
use serde_json::{Value, json};

/// What there is to say of them.
pub struct LinkSummary<'a> {
    late_s: Option<f64>,
    link: &'a LinkReport,
    /// Mean, least and largest arrival rate of the targets that learn one, each counting once.
    arrival: Option<(f64, f64, f64)>,
}

impl<'a> LinkSummary<'a> {
    /// The links of a run.
    pub fn of(spec: &Spec, totals: &'a Totals) -> LinkSummary<'a> {
        let late_s = match spec.link.receiver {
            Receiver::Stamped { late_s } => late_s,
            Receiver::Unstamped { .. } => None,
        };
        LinkSummary { late_s, link: &totals.link, arrival: totals.arrival() }
    }

    /// One line, if there is something to say.
    pub fn text(&self) -> Option<String> {
        let mut parts = Vec::new();
        if self.link.too_late > 0 {
            let late = format!(
                "{} not used, over {:?} s late",
                counted(self.link.too_late, "row"),
                self.late_s.unwrap_or(0.0)
            );
            parts.push(match self.link.first_too_late {
                Some(row) => format!("{late} (the first is row {row})"),
                None => late,
            });
        }
        if self.link.copies > 0 {
            parts.push(match self.link.copies {
                1 => "1 copy dropped".to_owned(),
                n => format!("{} dropped", counted(n, "copie")),
            });
        }
        if self.link.repeats > 0 {
            parts.push(format!("{} counted as lost", counted(self.link.repeats, "repeated value")));
        }
        if self.link.stale > 0 {
            parts.push(format!("{} by sequence number counted as lost", counted(self.link.stale, "old value")));
        }
        if let Some((mean, least, most)) = self.arrival {
            let range = if least == most { String::new() } else { format!(" ({} to {})", short(least), short(most)) };
            parts.push(format!("arrival rate estimated as {}{range}", short(mean)));
        }
        (!parts.is_empty()).then(|| format!("link: {}", parts.join(", ")))
    }

    /// One object.
    pub fn json(&self) -> Value {
        let arrival = self.arrival;
        json!({
            "late_s": self.late_s,
            "too_late": self.link.too_late,
            "first_too_late_row": self.link.first_too_late,
            "copies": self.link.copies,
            "repeats": self.link.repeats,
            "stale": self.link.stale,
            "arrival": arrival.map(|(mean, _, _)| mean),
            "arrival_min": arrival.map(|(_, least, _)| least),
            "arrival_max": arrival.map(|(_, _, most)| most),
        })
    }
}
