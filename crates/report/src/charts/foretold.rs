//! Predictive score over time.

use super::{Detail, extent, figure, quantile, series_class, size};
use crate::comparison::Comparison;
use crate::svg::{Frame, Scale, line};
use fixtrail_sim::metrics::Losses;
use maud::{Markup, html};

/// Intervals of time that a line has a point for.
const BINS: usize = 150;

/// A line over time, broken where nothing was foretold.
type Points = Vec<Option<(f64, f64)>>;

/// The figure, over the page's whole width if `wide`, or nothing where nothing was foretold.
pub fn foretold(detail: &Detail<'_>, comparison: &Comparison<'_>, wide: bool) -> Option<Markup> {
    if !comparison.is_predictive() {
        return None;
    }
    let lines: Vec<(String, &str, Points)> = detail
        .page
        .series
        .iter()
        .zip(comparison.entries)
        .enumerate()
        .filter_map(|(i, (s, entry))| {
            let at = s.trails.iter().position(|t| t.target.as_deref() == detail.target)?;
            Some((series_class(i), s.name, binned(detail, entry.losses.get(at)?)))
        })
        .collect();
    let values = || lines.iter().flat_map(|(_, _, points)| points.iter().flatten().map(|p| p.1));
    let [low, high] = extent(values());
    if !low.is_finite() {
        return None;
    }
    // One wild interval must not flatten the rest.
    let usual = quantile(values(), 0.02);
    let bottom = low.max(usual - 0.5 * (high - usual));
    let pad = (0.05 * (high - bottom)).max(1e-3);
    let (width, x_px, class) = size(wide);
    let x = detail.time.scale(x_px);
    let y = Scale::linear([bottom - pad, high + pad], Frame::Y_PX);
    let body = html! {
        @for (class, name, points) in &lines {
            path class={ "line " (class) } data-name=(name) d=(line(points, x, y)) {}
        }
    };
    let frame = Frame {
        width,
        height: Frame::HEIGHT,
        x,
        y,
        x_title: detail.time.title.to_owned(),
        y_title: "score [1]".to_owned(),
        label: "Mean log density of the next measurements over time".to_owned(),
        id: format!("foretold-{}", detail.id),
    };
    let mut caption = format!(
        "Mean log density of the values that came next, in {BINS} equal intervals of time; higher is better. Where a line falls below \
         the others its estimator did not expect what came, or was not sure enough of what it expected."
    );
    if low < bottom {
        caption += " Some intervals lie below the chart.";
    }
    Some(figure(class, "Score over time", &frame.draw(&body, &html! {}), &caption))
}

/// The mean score in each interval of time; `None` where nothing was foretold.
fn binned(detail: &Detail<'_>, losses: &Losses) -> Points {
    let mut bins = vec![(0.0, 0.0, 0.0); BINS];
    for (k, loss) in losses.iter().enumerate() {
        let Some(loss) = loss else { continue };
        let t = if detail.page.layout.is_linear() { k as f64 } else { detail.time.of(loss.t) };
        let share = t / detail.time.length.max(f64::MIN_POSITIVE);
        let bin = &mut bins[((share * BINS as f64) as usize).min(BINS - 1)];
        *bin = (bin.0 + loss.weight * t, bin.1 - loss.sum, bin.2 + loss.weight);
    }
    bins.into_iter().map(|(t, sum, weight)| (weight > 0.0).then(|| (t / weight, sum / weight))).collect()
}
