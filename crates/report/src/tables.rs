//! Key figures: the headline, one line per estimator, one line per target.

use crate::charts::series_class;
use crate::format::{count, number, percent, target};
use crate::{Page, Series};
use fixtrail_sim::metrics::{Consistency, Nis, ScoreRow, nis};
use fixtrail_track::fix::Status;
use fixtrail_track::trail::Trail;
use maud::{Markup, html};

/// Rows of the table of targets.
const TARGET_ROWS: usize = 200;

/// A few large numbers about the best (or only) estimator.
pub fn headline(page: &Page<'_>) -> Markup {
    let rmse = |s: &Series<'_>| s.score.and_then(|s| s.overall.errors).map(|e| e.rmse_m);
    let best = page
        .series
        .iter()
        .filter(|s| rmse(s).is_some())
        .min_by(|a, b| rmse(a).unwrap_or(f64::INFINITY).total_cmp(&rmse(b).unwrap_or(f64::INFINITY)));
    let tile = |value: String, unit: &str, what: &str| {
        html! { div class="tile" { b { (value) @if !unit.is_empty() { small { " " (unit) } } } span { (what) } } }
    };
    let errors = best.and_then(|s| s.score).and_then(|s| s.overall.errors.map(|e| (e, &s.overall)));
    html! {
        section class="headline" {
            @if let (Some(best), Some((e, row))) = (best, errors) {
                (tile(number(e.rmse_m), "m", "root mean square error"))
                (tile(number(e.p50_m), "m", "half of the errors are smaller"))
                (tile(number(e.p95_m), "m", "95 of 100 errors are smaller"))
                (tile(row.coverage95.map_or("–".to_owned(), percent), "", "of true positions inside the claimed 95 % region"))
                @if page.series.len() > 1 {
                    p { "of " b { (best.name) } ", the smallest root mean square error of " (page.series.len()) " estimators" }
                }
            } @else if let Some(first) = page.series.first() {
                @let counts = Counts::new(first.trails.iter().map(|t| &t.trail));
                (tile(count(first.trails.len()), "", if first.trails.len() == 1 { "target" } else { "targets" }))
                (tile(count(counts.rows), "", "instants estimated"))
                (tile(percent(counts.share(Status::Updated)), "", "of them from a measurement"))
                @if let Some(nis) = nis(first.trails.iter().map(|t| &t.trail)) {
                    (tile(number(nis.ratio), "", "mean innovation squared; 1 is expected"))
                }
            }
        }
    }
}

/// One line per estimator.
pub fn estimators(page: &Page<'_>) -> Markup {
    let scored = page.series.iter().any(|s| s.score.is_some());
    let worst = page.series.iter().filter_map(|s| Some(s.score?.overall.errors?.rmse_m)).fold(0.0, f64::max);
    html! {
        section class="card" {
            h2 { (if page.series.len() > 1 { "Estimators" } else { "Key figures" }) }
            div class="scroll" { table {
                thead { tr {
                    th { "estimator" }
                    @if scored { (score_heads()) } @else { (count_heads()) }
                } }
                tbody {
                    @for (i, s) in page.series.iter().enumerate() {
                        tr {
                            th { span class={ "swatch " (series_class(i)) } {} (s.name) }
                            @if scored {
                                @match s.score {
                                    Some(score) => (score_cells(&score.overall, Some(worst))),
                                    None => td colspan="9" { "not compared with truth" },
                                }
                            } @else { (count_cells(s.trails.iter().map(|t| &t.trail))) }
                        }
                    }
                }
            } }
            @for (i, s) in page.series.iter().enumerate() { @if let Some(score) = s.score { (verdict(i, s.name, &score.overall)) } }
            @if scored { (how_to_read_scores()) } @else { (how_to_read_counts()) }
            @for s in page.series.iter() { @if let Some(score) = s.score { (unmatched(s.name, &score.without_trail, &score.without_truth)) } }
        }
    }
}

/// One line per target and estimator, the worst (or longest) first; nothing for a single target.
pub fn targets(page: &Page<'_>) -> Markup {
    let ids = page.targets();
    if ids.len() < 2 {
        return html! {};
    }
    let scored = page.series.iter().any(|s| s.score.is_some());
    let mut rows: Vec<(f64, Markup)> = Vec::new();
    for id in ids {
        for (i, s) in page.series.iter().enumerate() {
            let Some(trail) = s.trail(id) else { continue };
            let score = s.target_score(id);
            let rank = match score.and_then(|t| t.row.errors) {
                Some(e) => e.rmse_m,
                None if scored => -1.0,
                None => trail.len() as f64,
            };
            rows.push((rank, html! {
                tr {
                    th { (target(id)) }
                    @if page.series.len() > 1 { td class="text name" { span class={ "swatch " (series_class(i)) } {} (s.name) } }
                    @if scored {
                        @match score {
                            Some(t) => (score_cells(&t.row, None)),
                            None => td colspan="9" { "no truth" },
                        }
                    } @else { (count_cells([trail])) }
                }
            }));
        }
    }
    rows.sort_by(|a, b| b.0.total_cmp(&a.0));
    let omitted = rows.len().saturating_sub(TARGET_ROWS);
    rows.truncate(TARGET_ROWS);
    html! {
        section class="card" {
            h2 { "Targets" }
            div class="scroll tall" { table class="sortable" {
                thead { tr {
                    th { "target" }
                    @if page.series.len() > 1 { th class="text" { "estimator" } }
                    @if scored { (score_heads()) } @else { (count_heads()) }
                } }
                tbody { @for (_, row) in &rows { (row) } }
            } }
            p class="read" {
                (if scored { "Largest root mean square error first." } else { "Longest trail first." })
                " Click a heading to sort."
                @if omitted > 0 { " " (count(omitted)) " further rows are not shown." }
            }
        }
    }
}

/// Heads of [`score_cells`].
pub fn score_heads() -> Markup {
    html! {
        th { "RMSE [m]" } th { "median [m]" } th { "90 % [m]" } th { "95 % [m]" } th { "max [m]" }
        th { "inside 95 %" } th { "NEES" } th { "NIS" } th { "verdict" }
    }
}

/// The cells of one comparison with truth; a bar as long as its error over `bar_to`.
pub fn score_cells(row: &ScoreRow, bar_to: Option<f64>) -> Markup {
    let e = row.errors;
    let metres = |f: fn(&fixtrail_sim::metrics::Errors) -> f64| e.as_ref().map_or("–".to_owned(), |e| number(f(e)));
    let (class, word) = badge(row.consistency);
    let band = |(low, high): (f64, f64)| format!("{} – {}", number(low), number(high));
    let scale = 1.0 / row.nees_dof.max(1) as f64;
    html! {
        td {
            (metres(|e| e.rmse_m))
            @if let (Some(worst), Some(e)) = (bar_to, e) {
                @if worst > 0.0 { i class="bar" { i style=(format!("width:{:.0}%", 100.0 * e.rmse_m / worst)) {} } }
            }
        }
        td { (metres(|e| e.p50_m)) }
        td { (metres(|e| e.p90_m)) }
        td { (metres(|e| e.p95_m)) }
        td { (metres(|e| e.max_m)) }
        td { (row.coverage95.map_or("–".to_owned(), percent)) }
        td { @match (row.mean_nees, row.nees_band95) {
            (Some(mean), Some((low, high))) => { (number(mean * scale)) small { (band((low * scale, high * scale))) } },
            _ => "–",
        } }
        td { (nis_cell(row.nis)) }
        td class="text" {
            span class={ "badge " (class) } { (word) }
            @if row.missing > 0 { small { (count(row.missing)) " instants missing" } }
        }
    }
}

fn badge(consistency: Consistency) -> (&'static str, &'static str) {
    match consistency {
        Consistency::OverConfident => ("bad", "over-confident"),
        Consistency::Consistent => ("good", "consistent"),
        Consistency::UnderConfident => ("mild", "under-confident"),
        Consistency::NotJudged => ("none", "not judged"),
    }
}

/// The verdict in words, and how much of the truth it rests on.
pub fn verdict(index: usize, name: &str, row: &ScoreRow) -> Markup {
    let (class, word) = badge(row.consistency);
    let sentence = row.verdict.strip_prefix(word).unwrap_or(&row.verdict).trim_start_matches([':', ' ']);
    html! {
        p class="verdict" {
            span class={ "swatch " (series_class(index)) } {} b { (name) } " " span class={ "badge " (class) } { (word) } " " (sentence) "."
            @if row.missing > 0 {
                " " (count(row.missing)) " of " (count(row.missing + row.instants)) " truth instants have no estimate."
            }
            @if row.incomplete > 0 { " " (count(row.incomplete)) " truth instants lack a coordinate." }
            @if let Some(rmse) = row.errors.and_then(|e| e.rmse_3d_m) { " With height, the root mean square error is " (number(rmse)) " m." }
        }
    }
}

fn nis_cell(nis: Option<Nis>) -> Markup {
    html! { @match nis {
        Some(n) => { (number(n.ratio)) small { (number(n.band95.0)) " – " (number(n.band95.1)) } },
        None => "–",
    } }
}

/// What the columns mean.
pub fn how_to_read_scores() -> Markup {
    html! { p class="read" {
        "Errors are distances to the truth at its instants. NEES and NIS are divided by their expected value, so 1 is right, more is \
         over-confident and less under-confident; below each stands its 95 % band if instants were independent. Errors at \
         neighbouring truth instants are not, so a consistent estimator can leave the NEES band somewhat."
    } }
}

/// How often each status occurs.
struct Counts {
    rows: usize,
    of: [usize; 4],
}

const STATUSES: [Status; 4] = [Status::Updated, Status::Predicted, Status::Rejected, Status::Unobservable];

impl Counts {
    fn new<'a>(trails: impl IntoIterator<Item = &'a Trail>) -> Counts {
        let mut out = Counts { rows: 0, of: [0; 4] };
        for status in trails.into_iter().flat_map(|t| &t.status) {
            out.rows += 1;
            out.of[STATUSES.iter().position(|s| s == status).unwrap_or(0)] += 1;
        }
        out
    }

    fn share(&self, status: Status) -> f64 {
        self.of[STATUSES.iter().position(|s| *s == status).unwrap_or(0)] as f64 / self.rows.max(1) as f64
    }
}

fn count_heads() -> Markup {
    html! { th { "instants" } @for s in STATUSES { th { (s.name()) } } th { "NIS" } th { "verdict" } }
}

fn count_cells<'a>(trails: impl IntoIterator<Item = &'a Trail> + Clone) -> Markup {
    let counts = Counts::new(trails.clone());
    let nis = nis(trails);
    let (class, word) = match nis {
        None => ("none", "not judged"),
        Some(n) if n.ratio > n.band95.1 => ("bad", "surprised more than expected"),
        Some(n) if n.ratio < n.band95.0 => ("mild", "surprised less than expected"),
        Some(_) => ("good", "as surprised as expected"),
    };
    html! {
        td { (count(counts.rows)) }
        @for s in STATUSES { td { (percent(counts.share(s))) } }
        td { (nis_cell(nis)) }
        td class="text" { span class={ "badge " (class) } { (word) } }
    }
}

fn how_to_read_counts() -> Markup {
    html! { p class="read" {
        "Updated: a measurement was used. Predicted: nothing usable arrived. Rejected: everything was gated out. Unobservable: no \
         estimate. NIS is the mean squared innovation over its expected value, with its 95 % band: more than 1 means noise levels set \
         too small, less means too large. Without truth nothing is known about the error itself."
    } }
}

/// Targets that only one of trail and truth has.
pub fn unmatched(series: &str, without_trail: &[Option<String>], without_truth: &[Option<String>]) -> Markup {
    let names = |ids: &[Option<String>]| {
        let shown: Vec<&str> = ids.iter().take(5).map(|id| target(id.as_deref())).collect();
        let more = ids.len() - shown.len();
        format!("{}{}", shown.join(", "), if more > 0 { format!(" and {more} more") } else { String::new() })
    };
    html! {
        @if !without_trail.is_empty() { p class="read" { (series) ": truth without a trail: " (names(without_trail)) "." } }
        @if !without_truth.is_empty() { p class="read" { (series) ": trails without truth: " (names(without_truth)) "." } }
    }
}
