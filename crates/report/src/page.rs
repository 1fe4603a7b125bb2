//! The page around tables and charts.

use crate::charts::{COLOURS, Detail, cdf, errors, foretold, nis, plan, series_class, states, timeline};
use crate::format::{count, shortened, target};
use crate::{Comparison, Page, comparison, link, tables};
use maud::{DOCTYPE, Markup, PreEscaped, html};

/// Targets whose charts over time are drawn.
const DETAILS: usize = 4;

/// The page as one HTML document that refers to nothing outside itself.
///
/// Light or dark as the reader's system wishes; static without scripts, with a cursor and switches where they run. Long series are
/// thinned so that the file stays below about 3 MB (the captions say how).
pub fn render(page: &Page<'_>) -> String {
    document(page, None)
}

/// As [`render`], for estimators compared with one another: which is best, by how much, and how long each took.
pub fn render_comparison(page: &Page<'_>, comparison: &Comparison<'_>) -> String {
    document(page, Some(comparison))
}

fn document(page: &Page<'_>, compared: Option<&Comparison<'_>>) -> String {
    let shown = detailed_targets(page);
    let omitted = page.targets().len() - shown.len();
    let body = html! {
        @match compared {
            Some(c) if c.is_predictive() => (comparison::headline(page, c)),
            _ => (tables::headline(page)),
        }
        @match compared {
            Some(c) => (comparison::table(page, c)),
            None => (tables::estimators(page)),
        }
        @if !page.notes.is_empty() {
            section class="card notes" { @for note in page.notes { p { (note) } } }
        }
        (legend(page))
        section class="charts" {
            @if let Some(figure) = plan::plan(page) { (figure) }
        }
        (link::link(page))
        (tables::targets(page))
        @for (i, id) in shown.iter().enumerate() {
            @if page.targets().len() > 1 { h2 class="target" { "Target " (target(*id)) } }
            section class="charts" { (details(page, compared, *id, i)) }
        }
        @if omitted > 0 {
            p class="read" {
                "Charts over time are drawn for the " (shown.len()) " targets with the "
                (if has_scores(page) { "largest errors" } else { "longest trails" }) "; "
                (count(omitted)) " are left out."
            }
        }
    };
    shell(page.title, page.subtitle, &body)
}

/// The document around a page's body.
pub fn shell(title: &str, subtitle: &str, body: &Markup) -> String {
    let document = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta name="color-scheme" content="light dark";
                title { (title) }
                style { (PreEscaped(include_str!("assets/style.css"))) }
            }
            body {
                header {
                    p class="brand" { (logo()) "Fixtrail" }
                    h1 { (title) }
                    p class="subtitle" { (subtitle) }
                }
                main { (body) }
                footer { "Made by Fixtrail " (env!("CARGO_PKG_VERSION")) ". This file holds everything it shows and loads nothing." }
                script { (PreEscaped(include_str!("assets/script.js"))) }
            }
        }
    };
    document.into_string()
}

fn details(page: &Page<'_>, compared: Option<&Comparison<'_>>, id: Option<&str>, index: usize) -> Markup {
    let detail = Detail::new(page, id, index);
    // The distribution is of all targets; it stands below the first one's errors.
    let first = index == 0;
    let errors = errors::errors(&detail, first).or_else(|| foretold::foretold(&detail, compared?, first));
    let mut half: Vec<Markup> = Vec::new();
    if first {
        half.extend(cdf::cdf(page));
    }
    half.extend(states::states(&detail));
    let neighbours = half.len() + usize::from(errors.is_some() && !first);
    html! {
        @if let Some(figure) = errors { (figure) }
        @for figure in half { (figure) }
        @if let Some(figure) = nis::nis(&detail, neighbours.is_multiple_of(2)) { (figure) }
        @if let Some(figure) = timeline::timeline(&detail) { (figure) }
    }
}

fn has_scores(page: &Page<'_>) -> bool {
    page.series.iter().any(|s| s.score.is_some())
}

/// The targets with the largest 95 % error, or the longest trails without truth.
fn detailed_targets<'a>(page: &Page<'a>) -> Vec<Option<&'a str>> {
    let scores = has_scores(page);
    let weight = |id: Option<&str>| {
        page.series
            .iter()
            .filter_map(|s| {
                if scores { Some(s.target_score(id)?.row.errors?.p95_m) } else { Some(s.trail(id)?.len() as f64) }
            })
            .fold(-1.0, f64::max)
    };
    let mut ids: Vec<_> = page.targets().into_iter().map(|id| (weight(id), id)).collect();
    ids.sort_by(|a, b| b.0.total_cmp(&a.0));
    ids.into_iter().take(DETAILS).map(|(_, id)| id).collect()
}

/// Switches for what the charts show; labels only where scripts do not run.
fn legend(page: &Page<'_>) -> Markup {
    let entry = |class: &str, label: &str| {
        html! { button type="button" aria-pressed="true" data-switch=(class) { span class={ "swatch " (class) } {} (shortened(label, 40)) } }
    };
    let by_target = plan::coloured_by_target(page);
    html! {
        nav class="legend" aria-label="Legend" {
            @if by_target {
                @let trails = page.series[0].trails;
                @if trails.len() <= COLOURS {
                    @for (i, t) in trails.iter().enumerate() { (entry(&format!("t{i}"), target(t.target.as_deref()))) }
                }
            } @else {
                @for (i, s) in page.series.iter().enumerate() { (entry(&series_class(i), s.name)) }
            }
            @if !page.truth.is_empty() { (entry("truth", "truth")) }
            @if page.layout.axes > 1 { (entry("ellipses", "95 % ellipses")) }
            @if !page.anchors.is_empty() && page.layout.axes > 1 { (entry("anchors", "anchors")) }
        }
    }
}

fn logo() -> Markup {
    html! {
        svg class="logo" viewBox="0 0 32 32" aria-hidden="true" {
            path class="trail" d="M4 25C11 25 9 13 16 13" {}
            path class="gap" d="M18.5 12.4L24 9" {}
            circle cx="27" cy="7.4" r="3.4" {}
        }
    }
}
