//! What a page of estimators compared with one another has besides their trails: the table, and which is best.

use crate::charts::series_class;
use crate::format::{count, number};
use crate::tables::{how_to_read_scores, score_cells, score_heads, unmatched, verdict};
use crate::{Page, Series};
use fixtrail_sim::metrics::Losses;
use fixtrail_track::packet::Kind;
use fixtrail_track::predictive;
use maud::{Markup, html};
use std::collections::BTreeSet;

/// A comparison of the series of a page.
#[derive(Clone, Copy, Debug)]
pub struct Comparison<'a> {
    /// One for each series of the page, in their order.
    pub entries: &'a [Entry<'a>],
    /// Which is best, in sentences without a full stop.
    pub sentences: &'a [String],
}

/// What is known of an estimator besides its trails.
#[derive(Clone, Copy, Debug)]
pub struct Entry<'a> {
    /// A remark beside its name: that it uses later data. May be empty.
    pub note: &'a str,
    /// Whether it is the best of its sort.
    pub best: bool,
    /// Microseconds it took for each instant.
    pub us_per_instant: f64,
    /// How well it foretold the measurements, where there is no truth.
    pub foretold: Option<&'a predictive::Score>,
    /// What each instant cost it, one list for each of the series' trails.
    pub losses: &'a [Losses],
}

impl Comparison<'_> {
    /// Whether estimators are measured by what they foretold.
    pub fn is_predictive(&self) -> bool {
        self.entries.iter().any(|e| e.foretold.is_some())
    }
}

/// A few large numbers about the best estimator, measured by what it foretold.
pub fn headline(page: &Page<'_>, comparison: &Comparison<'_>) -> Markup {
    let best = comparison.entries.iter().zip(page.series).find(|(entry, _)| entry.best);
    let Some((entry, series)) = best else { return html! {} };
    let Some(foretold) = entry.foretold else { return html! {} };
    let tile = |value: String, unit: &str, what: &str| {
        html! { div class="tile" { b { (value) @if !unit.is_empty() { small { " " (unit) } } } span { (what) } } }
    };
    let or_dash = |v: Option<f64>| v.map_or("–".to_owned(), number);
    html! {
        section class="headline" {
            (tile(or_dash(foretold.mean_log_density()), "", "score: mean log density of the next measurement"))
            @if let Some((kind, size)) = foretold.sizes().next() {
                (tile(number(size.rms), kind.unit(), &format!("root mean square innovation, {}", kind.name())))
                (tile(number(size.median), kind.unit(), &format!("half of the innovations are smaller, {}", kind.name())))
            }
            (tile(or_dash(foretold.mean_nis()), "", "mean squared innovation over its variance; 1 is expected"))
            @if page.series.len() > 1 {
                p { "of " b { (series.name) } ", the best score of " (page.series.len()) " estimators" }
            }
        }
    }
}

/// One line per estimator, and which is best.
pub fn table(page: &Page<'_>, comparison: &Comparison<'_>) -> Markup {
    let predictive = comparison.is_predictive();
    let worst = page.series.iter().filter_map(|s| Some(s.score?.overall.errors?.rmse_m)).fold(0.0, f64::max);
    let foretold = comparison.entries.iter().filter_map(|e| e.foretold);
    let kinds: BTreeSet<Kind> = foretold.flat_map(|f| f.sizes().map(|(kind, _)| kind)).collect();
    html! {
        section class="card" {
            h2 { "Estimators" }
            div class="scroll" { table class={ "compared" @if predictive { " foretold" } } {
                thead { tr {
                    th { "estimator" }
                    @if predictive { (foretold_heads(&kinds)) } @else { (time_head()) (score_heads()) }
                } }
                tbody {
                    @for (i, (s, entry)) in page.series.iter().zip(comparison.entries).enumerate() {
                        tr {
                            th { (name(i, s, entry)) }
                            @if predictive {
                                (foretold_cells(entry, &kinds))
                            } @else {
                                td { (number(entry.us_per_instant)) }
                                @match s.score {
                                    Some(score) => (score_cells(&score.overall, Some(worst))),
                                    None => td colspan="9" { "not compared with truth" },
                                }
                            }
                        }
                    }
                }
            } }
            @for sentence in comparison.sentences { p class="verdict" { (capitalised(sentence)) "." } }
            @for (i, s) in page.series.iter().enumerate() { @if let Some(score) = s.score { (verdict(i, s.name, &score.overall)) } }
            @if predictive { (how_to_read_foretold()) } @else { (how_to_read_scores()) }
            p class="read" {
                "A difference counts in its standard errors, taken from blocks of time as long as said above: what one instant says is \
                 much like what the next one says. Times are per instant by the clock, all processors at work, and no benchmark."
            }
            @if let Some(score) = page.series.first().and_then(|s| s.score) {
                (unmatched("All", &score.without_trail, &score.without_truth))
            }
        }
    }
}

fn name(index: usize, series: &Series<'_>, entry: &Entry<'_>) -> Markup {
    html! {
        span class={ "swatch " (series_class(index)) } {} (series.name)
        @if entry.best { " " span class="badge good" { "best" } }
        @if !entry.note.is_empty() { small { (entry.note) } }
    }
}

fn time_head() -> Markup {
    html! { th { "time [µs]" } }
}

fn foretold_heads(kinds: &BTreeSet<Kind>) -> Markup {
    let unit = |kind: &Kind| if kind.unit().is_empty() { String::new() } else { format!(" [{}]", kind.unit()) };
    html! {
        th { "score" }
        @for kind in kinds { th { "RMS " (kind.name()) (unit(kind)) } th { "median " (kind.name()) (unit(kind)) } }
        th { "ν²/S" } th { "values" } th { "not foretold" } (time_head())
    }
}

fn foretold_cells(entry: &Entry<'_>, kinds: &BTreeSet<Kind>) -> Markup {
    let or_dash = |v: Option<f64>| v.map_or("–".to_owned(), number);
    let size = |kind: &Kind| entry.foretold.and_then(|f| f.sizes().find(|(k, _)| k == kind)).map(|(_, size)| size);
    html! {
        td { (or_dash(entry.foretold.and_then(predictive::Score::mean_log_density))) }
        @for kind in kinds {
            td { (or_dash(size(kind).map(|s| s.rms))) }
            td { (or_dash(size(kind).map(|s| s.median))) }
        }
        td { (or_dash(entry.foretold.and_then(predictive::Score::mean_nis))) }
        td { (count(entry.foretold.map_or(0, |f| f.scalars))) }
        td { (count(entry.foretold.map_or(0, |f| f.unforetold))) }
        td { (number(entry.us_per_instant)) }
    }
}

fn how_to_read_foretold() -> Markup {
    html! { p class="read" {
        "Every measured value is foretold from the last estimate before its instant, which has not seen it. The score is the mean \
         logarithm of the density that was foretold at the value that came, with room for one outlier in twenty: larger is better, \
         and neither a wrong estimate nor a wrong covariance gets a large one. Innovations are what came less what was foretold; \
         ν²/S is their square over the variance foretold, 1 if that is right. Without truth nothing is known about the error itself."
    } }
}

fn capitalised(sentence: &str) -> String {
    let mut letters = sentence.chars();
    letters.next().map_or(String::new(), |first| first.to_uppercase().chain(letters).collect())
}
