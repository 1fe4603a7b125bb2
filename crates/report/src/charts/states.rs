//! Components of the state over time, for models without a plane.

use super::{Detail, extent, figure, quantile};
use crate::svg::{Frame, Scale, area, envelope, envelope_band, line};
use maud::{Markup, html};

/// Components shown.
const COMPONENTS: usize = 6;

/// One figure per component of a linear model or of a model with one axis; none for a model in the plane.
pub fn states(detail: &Detail<'_>) -> Vec<Markup> {
    let layout = detail.page.layout;
    if layout.axes > 1 {
        return Vec::new();
    }
    (0..layout.n().min(COMPONENTS)).filter_map(|i| component(detail, i)).collect()
}

fn component(detail: &Detail<'_>, i: usize) -> Option<Markup> {
    let layout = detail.page.layout;
    let name = &layout.names[i];
    let unit = match (layout.axes, i) {
        (0, _) => "unit of the model",
        (_, 0) => "m",
        (_, 1) if layout.has_velocity => "m/s",
        (_, 2) if name == "ax" => "m/s²",
        _ => "unit of the model",
    };
    let bands: Vec<_> = detail
        .series()
        .map(|(class, series, trail)| {
            let rows: Vec<Option<(f64, f64, f64)>> = (0..trail.len())
                .map(|row| {
                    let sd = trail.cov_at(row, i, i)?.max(0.0).sqrt();
                    Some((detail.at(trail, row)?, trail.mean(row)?[i], sd))
                })
                .collect();
            (class, series.name, rows)
        })
        .collect();
    let means = || bands.iter().flat_map(|b| b.2.iter().flatten().map(|r| r.1));
    let truth: Vec<Option<(f64, f64)>> = match (layout.axes, i, detail.page.truth_of(detail.target)) {
        (1, 0, Some(t)) => t.points.iter().map(|p| Some((detail.time.of(p.t_s), p.position_m[0]?))).collect(),
        _ => Vec::new(),
    };
    let [low, high] = extent(means().chain(truth.iter().flatten().map(|p| p.1)));
    if !low.is_finite() {
        return None;
    }
    let margin = 2.0 * quantile(bands.iter().flat_map(|b| b.2.iter().flatten().map(|r| r.2)), 0.9);
    let x = detail.time.scale(Frame::X_PX);
    let y = Scale::linear([low - margin, high + margin], Frame::Y_PX);
    let body = html! {
        @if !truth.is_empty() { g class="truth" { path d=(line(&envelope(truth), x, y)) {} } }
        @for (class, _, rows) in &bands {
            @let band = rows.iter().map(|r| r.map(|(t, m, sd)| (t, m - 2.0 * sd, m + 2.0 * sd))).collect();
            path class={ "band " (class) } d=(area(&envelope_band(band), x, y)) {}
        }
        @for (class, series, rows) in &bands {
            @let points = rows.iter().map(|r| r.map(|(t, m, _)| (t, m))).collect();
            path class={ "line " (class) } data-name=(series) d=(line(&envelope(points), x, y)) {}
        }
    };
    let frame = Frame {
        width: Frame::WIDTH,
        height: Frame::HEIGHT,
        x,
        y,
        x_title: detail.time.title.to_owned(),
        y_title: format!("{name} [{unit}]"),
        label: format!("State component {name} over time"),
        id: format!("state-{i}-{}", detail.id),
    };
    let omitted = layout.n().saturating_sub(COMPONENTS);
    let mut caption = "Line: estimate. Shade: two standard deviations to either side, as claimed.".to_owned();
    if omitted > 0 && i + 1 == COMPONENTS {
        caption += &format!(" {omitted} further components are not shown.");
    }
    Some(figure("time", &format!("State {name}"), &frame.draw(&body, &html! {}), &caption))
}
