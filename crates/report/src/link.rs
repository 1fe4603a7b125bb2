//! What the network did to the packets, and what that allows.

use crate::Page;
use crate::format::{count, number, shortened, target};
use fixtrail_track::link::LinkReport;
use fixtrail_track::target::TargetTrail;
use fixtrail_track::theory::{Bounds, Source, Theory};
use maud::{Markup, html};

/// The section; nothing when there is neither a theory nor anything to report.
pub fn link(page: &Page<'_>) -> Markup {
    let events = page.series.first().map(|s| events(s.trails)).unwrap_or_default();
    if page.theory.is_none() && events.is_empty() {
        return html! {};
    }
    html! {
        section class="card" {
            h2 { "Link" }
            @if !events.is_empty() { ul { @for event in &events { li { (event) } } } }
            @if let Some((told, source)) = page.theory { (theory(told, *source)) }
        }
    }
}

/// What the links of all targets report, in sentences.
fn events(trails: &[TargetTrail]) -> Vec<String> {
    let sum = |of: fn(&LinkReport) -> u64| trails.iter().map(|t| of(&t.link)).sum::<u64>();
    let packets = |n: u64| format!("{} {}", count(n as usize), if n == 1 { "packet" } else { "packets" });
    let values = |n: u64| format!("{} {}", count(n as usize), if n == 1 { "value" } else { "values" });
    let mut out = Vec::new();
    let too_late = sum(|l| l.too_late);
    if too_late > 0 {
        let first = trails.iter().find_map(|t| Some((t.target.as_deref(), t.link.first_too_late?)));
        let first = first
            .map_or(String::new(), |(id, row)| format!(", the first of {} in row {row}", shortened(target(id), 40)));
        out.push(format!("{} came too late to be used{first}; a larger late_s waits longer", packets(too_late)));
    }
    for (n, what) in [
        (sum(|l| l.copies), "that had come already, used once"),
        (sum(|l| l.repeats), "equal to the one before, counted as lost"),
        (sum(|l| l.stale), "old by the sequence number, counted as lost"),
    ] {
        if n > 0 {
            let noun = if what.starts_with("that") { packets(n) } else { values(n) };
            out.push(format!("{noun} {what}"));
        }
    }
    let learnt: Vec<f64> = trails.iter().filter_map(|t| t.link.arrival).collect();
    if !learnt.is_empty() {
        let (least, most) = learnt.iter().fold((f64::INFINITY, 0.0_f64), |(a, b), p| (a.min(*p), b.max(*p)));
        out.push(match learnt.len() {
            1 => format!("arrival rate learnt on line: {}", number(most)),
            n => {
                format!("arrival rates learnt on line: {} to {} over {} targets", number(least), number(most), count(n))
            }
        });
    }
    out
}

fn theory(told: &Theory, source: Source) -> Markup {
    let cells = |b: &Bounds| {
        html! { @for v in [b.lower, b.upper, b.lossless] { td { (v.map_or("–".to_owned(), number)) } } }
    };
    html! {
        p {
            "Theory, " (told.assumption(source))
            ": " (told.sentences().join("; ")) "."
        }
        div class="scroll" { table {
            thead { tr {
                th { "standard deviation" }
                th { "prediction, at least" } th { "at most" } th { "without loss" }
                th { "estimate, at least" } th { "at most" } th { "without loss" }
            } }
            tbody { @for s in &told.states { tr { th { (s.name) } (cells(&s.predicted)) (cells(&s.filtered)) } } }
        } }
        p class="read" {
            "Bounds on the root mean variance of a Kalman filter in the long run, by the spec's own noise levels, when each instant's \
             packets arrive together or not at all, independently of other instants."
        }
    }
}
