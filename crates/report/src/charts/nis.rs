//! Normalised innovation squared over time, with the band where it should be.

use super::{Detail, extent, figure, quantile, size};
use crate::format::percent;
use crate::svg::{Frame, Scale, area, dots, envelope, envelope_band};
use core::fmt::Write;
use fixtrail_sim::metrics::chi_square_quantile;
use maud::{Markup, html};
use std::collections::BTreeMap;

/// The figure, over the page's whole width if `wide`, or nothing when no trail has innovations.
pub fn nis(detail: &Detail<'_>, wide: bool) -> Option<Markup> {
    let mut bands: BTreeMap<u32, (f64, f64)> = BTreeMap::new();
    let mut values = Vec::new();
    for (class, series, trail) in detail.series() {
        let points: Vec<(f64, f64, u32)> = (0..trail.len())
            .filter_map(|row| {
                let dof = trail.nis_dof[row];
                Some((detail.at(trail, row)?, trail.nis[row].filter(|v| dof > 0 && v.is_finite())?, dof))
            })
            .collect();
        for (_, _, dof) in &points {
            bands.entry(*dof).or_insert_with(|| {
                (chi_square_quantile(*dof as usize, 0.025), chi_square_quantile(*dof as usize, 0.975))
            });
        }
        if !points.is_empty() {
            values.push((class, series.name, points));
        }
    }
    let widest = values.iter().max_by_key(|(_, _, points)| points.len())?;
    let [_, upper] = extent(bands.values().map(|b| b.1));
    let all = || values.iter().flat_map(|(_, _, points)| points.iter().map(|p| p.1));
    let top = (1.1 * quantile(all(), 0.995)).clamp(1.25 * upper, 5.0 * upper);
    let above = all().filter(|v| *v > top).count();
    let (width, x_px, class) = size(wide);
    let x = detail.time.scale(x_px);
    let y = Scale::linear([0.0, top], Frame::Y_PX);
    let band: Vec<_> = widest.2.iter().map(|(t, _, dof)| bands.get(dof).map(|(low, high)| (*t, *low, *high))).collect();
    let body = html! {
        path class="expected" d=(area(&envelope_band(band), x, y)) {}
        @for (class, name, points) in &values {
            @let drawn: Vec<_> = envelope(points.iter().map(|p| Some((p.0, p.1))).collect()).into_iter().flatten().collect();
            path class={ "dots " (class) } data-name=(name) d=(dots(&drawn, x, y)) {}
        }
    };
    let frame = Frame {
        width,
        height: Frame::HEIGHT,
        x,
        y,
        x_title: detail.time.title.to_owned(),
        y_title: "NIS [1]".to_owned(),
        label: "Normalised innovation squared over time".to_owned(),
        id: format!("nis-{}", detail.id),
    };
    let mut caption = "Normalised innovation squared: how surprising each instant's measurements were to the filter. If its noise \
                       levels are right, 95 of 100 dots fall into the grey band (chi-square, for the number of measurements of \
                       the instant)."
        .to_owned();
    for (_, name, points) in &values {
        let inside = points.iter().filter(|(_, v, dof)| bands.get(dof).is_some_and(|(l, h)| v >= l && v <= h)).count();
        let _ = write!(caption, " {name}: {} inside.", percent(inside as f64 / points.len() as f64));
    }
    if above > 0 {
        let _ = write!(caption, " Values above the chart: {above}.");
    }
    Some(figure(class, "Surprise over time", &frame.draw(&body, &html! {}), &caption))
}
