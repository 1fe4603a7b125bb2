//! Error over time, beside what was claimed.

use super::{Detail, extent, figure, quantile, series_class, size};
use crate::svg::{Frame, Scale, area, envelope, envelope_band, line};
use maud::{Markup, html};

/// The figure, over the page's whole width if `wide`, or nothing without truth.
pub fn errors(detail: &Detail<'_>, wide: bool) -> Option<Markup> {
    let scored: Vec<_> = detail
        .page
        .series
        .iter()
        .enumerate()
        .filter_map(|(i, s)| Some((series_class(i), s.name, s.target_score(detail.target)?)))
        .collect();
    let all = || scored.iter().flat_map(|(_, _, s)| s.instants.iter().filter_map(|i| i.error_m()));
    let [_, largest] = extent(all());
    if !largest.is_finite() {
        return None;
    }
    let claimed = scored.iter().flat_map(|(_, _, s)| s.instants.iter().filter_map(|i| i.radius95_m));
    // One wild value must not flatten the rest.
    let usual = quantile(all(), 0.995).max(quantile(claimed, 0.9));
    let top = largest.max(quantile(all(), 0.5)).min(4.0 * usual).max(1.15 * usual);
    let (width, x_px, class) = size(wide);
    let x = detail.time.scale(x_px);
    let y = Scale::linear([0.0, top], Frame::Y_PX);
    let body = html! {
        @for (class, _, score) in &scored {
            @let band = score.instants.iter().map(|i| i.radius95_m.map(|r| (detail.time.of(i.t_s), 0.0, r))).collect();
            path class={ "band " (class) } d=(area(&envelope_band(band), x, y)) {}
        }
        @for (class, name, score) in &scored {
            @let points = score.instants.iter().map(|i| i.error_m().map(|e| (detail.time.of(i.t_s), e))).collect();
            path class={ "line " (class) } data-name=(name) d=(line(&envelope(points), x, y)) {}
        }
    };
    let frame = Frame {
        width,
        height: Frame::HEIGHT,
        x,
        y,
        x_title: detail.time.title.to_owned(),
        y_title: "position error [m]".to_owned(),
        label: "Position error over time with claimed 95 % radius".to_owned(),
        id: format!("errors-{}", detail.id),
    };
    let mut caption =
        "Lines: distance between estimate and truth at each truth instant. Shade: radius of the claimed 95 % ellipse \
                       towards the truth. A line above its shade is an instant whose truth lies outside the ellipse; \
                       that should happen in 5 of 100."
            .to_owned();
    if largest > top {
        caption += &format!(" The largest error, {} m, is above the chart.", crate::format::number(largest));
    }
    Some(figure(class, "Error over time", &frame.draw(&body, &html! {}), &caption))
}
