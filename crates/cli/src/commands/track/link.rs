//! What the links of all targets did with their packets.

use crate::figures::{counted, short};
use fixtrail_track::spec::{Receiver, Spec};
use fixtrail_track::target::TargetTrail;
use serde_json::{Value, json};

/// Sums over targets.
pub struct LinkSummary {
    late_s: Option<f64>,
    too_late: u64,
    first_too_late: Option<u64>,
    copies: u64,
    repeats: u64,
    stale: u64,
    /// Arrival rates of the targets that learn one.
    arrivals: Vec<f64>,
}

impl LinkSummary {
    /// The links of `trails`.
    pub fn of(spec: &Spec, trails: &[TargetTrail]) -> LinkSummary {
        let late_s = match spec.link.receiver {
            Receiver::Stamped { late_s } => late_s,
            Receiver::Unstamped { .. } => None,
        };
        let sum = |count: fn(&TargetTrail) -> u64| trails.iter().map(count).sum();
        LinkSummary {
            late_s,
            too_late: sum(|t| t.link.too_late),
            first_too_late: trails.iter().filter_map(|t| t.link.first_too_late).min(),
            copies: sum(|t| t.link.copies),
            repeats: sum(|t| t.link.repeats),
            stale: sum(|t| t.link.stale),
            arrivals: trails.iter().filter_map(|t| t.link.arrival).collect(),
        }
    }

    /// Mean, least and largest arrival rate, each target counting once.
    fn arrival(&self) -> Option<(f64, f64, f64)> {
        let mean = self.arrivals.iter().sum::<f64>() / self.arrivals.len() as f64;
        let least = self.arrivals.iter().copied().reduce(f64::min)?;
        let most = self.arrivals.iter().copied().reduce(f64::max)?;
        Some((mean, least, most))
    }

    /// One line, if there is something to say.
    pub fn text(&self) -> Option<String> {
        let mut parts = Vec::new();
        if self.too_late > 0 {
            let late =
                format!("{} not used, over {:?} s late", counted(self.too_late, "row"), self.late_s.unwrap_or(0.0));
            parts.push(match self.first_too_late {
                Some(row) => format!("{late} (the first is row {row})"),
                None => late,
            });
        }
        if self.copies > 0 {
            parts.push(match self.copies {
                1 => "1 copy dropped".to_owned(),
                n => format!("{} dropped", counted(n, "copie")),
            });
        }
        if self.repeats > 0 {
            parts.push(format!("{} counted as lost", counted(self.repeats, "repeated value")));
        }
        if self.stale > 0 {
            parts.push(format!("{} by sequence number counted as lost", counted(self.stale, "old value")));
        }
        if let Some((mean, least, most)) = self.arrival() {
            let range = if least == most { String::new() } else { format!(" ({} to {})", short(least), short(most)) };
            parts.push(format!("arrival rate estimated as {}{range}", short(mean)));
        }
        (!parts.is_empty()).then(|| format!("link: {}", parts.join(", ")))
    }

    /// One object.
    pub fn json(&self) -> Value {
        let arrival = self.arrival();
        json!({
            "late_s": self.late_s,
            "too_late": self.too_late,
            "first_too_late_row": self.first_too_late,
            "copies": self.copies,
            "repeats": self.repeats,
            "stale": self.stale,
            "arrival": arrival.map(|(mean, _, _)| mean),
            "arrival_min": arrival.map(|(_, least, _)| least),
            "arrival_max": arrival.map(|(_, _, most)| most),
        })
    }
}
