//! The plan: where everything was, seen from above.

use super::{COLOURS, extent, figure, quantile, series_class};
use crate::Page;
use crate::format::shortened;
use crate::svg::{Frame, Scale, dots, line, thinned};
use core::fmt::Write;
use fixtrail_sim::metrics::chi_square_quantile;
use fixtrail_track::packet::Content;
use fixtrail_track::trail::Trail;
use maud::{Markup, html};

const TOP: f64 = 14.0;
const BELOW: f64 = 50.0;
const HEIGHTS: [f64; 2] = [300.0, 620.0];
/// Points of all trails together, and of the raw positions.
const TRAIL_POINTS: usize = 40_000;
const RAW_POINTS: usize = 6_000;
/// Ellipses of all trails together.
const ELLIPSES: usize = 120;
/// Names written beside the ends of trails.
const LABELS: usize = 30;

/// Whether trails are told apart by target rather than by estimator.
pub fn coloured_by_target(page: &Page<'_>) -> bool {
    page.series.len() == 1 && page.series[0].trails.len() > 1
}

/// The figure, or nothing for a model without a plane.
pub fn plan(page: &Page<'_>) -> Option<Markup> {
    if page.layout.axes < 2 {
        return None;
    }
    let (x, y) = scales(page)?;
    let inside = |p: [f64; 2]| (x.low..=x.high).contains(&p[0]) && (y.low..=y.high).contains(&p[1]);
    let trails: Vec<(String, Option<&str>, &Trail)> = page
        .series
        .iter()
        .enumerate()
        .flat_map(|(i, s)| {
            s.trails.iter().enumerate().map(move |(j, t)| {
                let class = if coloured_by_target(page) { format!("t{}", j % COLOURS) } else { series_class(i) };
                (class, t.target.as_deref(), &t.trail)
            })
        })
        .collect();
    let per_trail = TRAIL_POINTS / trails.len().max(1);
    let outside = trails.iter().flat_map(|(_, _, t)| positions(t)).flatten().filter(|p| !inside([p.0, p.1])).count();
    let raw = raw_positions(page);
    let name_ends = coloured_by_target(page) && trails.len() <= LABELS;

    let body = html! {
        g class="truth" {
            @for truth in page.truth {
                @let points: Vec<_> = truth.points.iter().map(|p| Some((p.position_m[0]?, p.position_m[1]?))).collect();
                path d=(polyline(&points, x, y, TRAIL_POINTS / page.truth.len())) {}
            }
        }
        @if !raw.is_empty() { path class="raw dots" d=(dots(&raw, x, y)) {} }
        g class="ellipses" {
            @for (class, _, trail) in &trails {
                path class={ "ellipse " (class) } d=(ellipses(trail, x, y, (ELLIPSES / trails.len()).clamp(1, 40))) {}
            }
        }
        @for (class, target, trail) in &trails {
            g class=(class) {
                path class="line" d=(polyline(&positions(trail), x, y, per_trail)) {
                    @if let Some(target) = target { title { (target) } }
                }
                @if let Some((a, b)) = positions(trail).into_iter().flatten().next_back() {
                    circle class="end" cx=(format!("{:.1}", x.at(a))) cy=(format!("{:.1}", y.at(b))) r="4.5" {}
                }
            }
        }
    };
    let over = html! {
        g class="anchors" {
            @for (i, name) in page.anchors.names().iter().enumerate() {
                @let p = page.anchors.position_m(i as u32);
                @if inside([p[0], p[1]]) {
                    g transform=(format!("translate({:.1} {:.1})", x.at(p[0]), y.at(p[1]))) {
                        title { (name) " at (" (p[0]) ", " (p[1]) ", " (p[2]) ") m" }
                        path class="mark" d="M0 -7L6.5 5H-6.5Z" {}
                        @if page.anchors.len() <= 60 {
                            @let left = x.at(p[0]) > Frame::WIDE - 120.0;
                            text x=(if left { -10 } else { 10 }) dy=(if y.at(p[1]) < TOP + 14.0 { "1.1em" } else { "-0.35em" })
                                text-anchor=(if left { "end" } else { "start" }) { (shortened(name, 18)) }
                        }
                    }
                }
            }
        }
        @if name_ends {
            g class={ "ends" @if trails.len() > COLOURS { " many" } } {
                @for (class, target, trail) in &trails {
                    @if let Some((a, b)) = positions(trail).into_iter().flatten().rfind(|p| inside([p.0, p.1])) {
                        @let left = x.at(a) > Frame::WIDE - 120.0;
                        text class=(class) x=(format!("{:.1}", x.at(a) + if left { -8.0 } else { 8.0 })) y=(format!("{:.1}", y.at(b)))
                            dy="0.35em" text-anchor=(if left { "end" } else { "start" }) {
                            (shortened(target.unwrap_or(""), 18))
                        }
                    }
                }
            }
        }
    };
    let frame = Frame {
        width: Frame::WIDE,
        height: y.from + BELOW,
        x,
        y,
        x_title: "x [m]".to_owned(),
        y_title: "y [m]".to_owned(),
        label: "Plan of trails, anchors and truth".to_owned(),
        id: "plan".to_owned(),
    };
    Some(figure("wide plan", "Plan", &frame.draw(&body, &over), &caption(page, &trails, raw.len(), outside)))
}

fn caption(page: &Page<'_>, trails: &[(String, Option<&str>, &Trail)], raw: usize, outside: usize) -> String {
    let mut text = String::from("Coloured lines are the estimated trails; the dot is where a trail ends. ");
    if !page.truth.is_empty() {
        text += "The broad grey line is the truth. ";
    }
    if !page.anchors.is_empty() {
        text += "Triangles are anchors. ";
    }
    if raw > 0 {
        text += "Small grey dots are measured positions. ";
    }
    text += "Shaded ellipses, drawn at equal intervals of time, should contain the target 95 times in 100: a long one means that \
             little arrived, or from one direction only.";
    if outside > 0 {
        let _ = write!(text, " {outside} estimates far from everything else lie outside the plan.");
    }
    let rows: usize = trails.iter().map(|t| t.2.len()).sum();
    if rows > TRAIL_POINTS {
        let _ =
            write!(text, " Of {rows} rows those are drawn that move a line visibly, evenly thinned to {TRAIL_POINTS}.");
    }
    text
}

fn positions(trail: &Trail) -> Vec<Option<(f64, f64)>> {
    (0..trail.len()).map(|row| trail.mean(row).map(|m| (m[0], m[1]))).collect()
}

fn raw_positions(page: &Page<'_>) -> Vec<(f64, f64)> {
    let all: Vec<_> = page
        .packets
        .iter()
        .flat_map(|t| &t.packets)
        .filter_map(|p| match p.content {
            Content::Position([Some(x), Some(y), _]) => Some((x, y)),
            _ => None,
        })
        .collect();
    let every = all.len().div_ceil(RAW_POINTS).max(1);
    all.into_iter().step_by(every).collect()
}

/// Equal scales on both axes, around anchors, truth and all but the wildest hundredth of the trails.
fn scales(page: &Page<'_>) -> Option<(Scale, Scale)> {
    let interval = |axis: usize| {
        let fixed = (0..page.anchors.len()).map(|i| page.anchors.position_m(i as u32)[axis]);
        let truth = page.truth.iter().flat_map(|t| &t.points).filter_map(|p| p.position_m[axis]);
        let trail = || {
            page.series
                .iter()
                .flat_map(|s| s.trails)
                .flat_map(|t| (0..t.trail.len()).filter_map(move |row| t.trail.mean(row).map(|m| m[axis])))
        };
        let [low, high] = [quantile(trail(), 0.01), quantile(trail(), 0.99)];
        let all = extent(trail());
        // A trail that strays by no more than its own width is shown whole.
        let reach = high - low;
        let tame = [all[0].max(low - reach), all[1].min(high + reach)];
        extent(fixed.chain(truth).chain(tame))
    };
    let ([x0, x1], [y0, y1]) = (interval(0), interval(1));
    if !(x0.is_finite() && y0.is_finite()) {
        return None;
    }
    let pad = 0.04 * (x1 - x0).max(y1 - y0).max(0.1);
    let (mut dx, mut dy) = (x1 - x0 + 2.0 * pad, y1 - y0 + 2.0 * pad);
    let width = Frame::WIDE_X_PX[1] - Frame::WIDE_X_PX[0];
    let height = (width * dy / dx).clamp(HEIGHTS[0], HEIGHTS[1]);
    let per_m = (width / dx).min(height / dy);
    (dx, dy) = (width / per_m, height / per_m);
    let (cx, cy) = (0.5 * (x0 + x1), 0.5 * (y0 + y1));
    Some((
        Scale::linear([cx - 0.5 * dx, cx + 0.5 * dx], Frame::WIDE_X_PX),
        Scale::linear([cy - 0.5 * dy, cy + 0.5 * dy], [TOP + height, TOP]),
    ))
}

fn polyline(points: &[Option<(f64, f64)>], x: Scale, y: Scale, max: usize) -> String {
    // Thinned where they are seen: in units of the drawing.
    let drawn: Vec<_> = points.iter().map(|p| p.map(|(a, b)| (x.at(a), y.at(b)))).collect();
    let same = |s: Scale| Scale { low: s.from, high: s.to, ..s };
    line(&thinned(&drawn, max), same(x), same(y))
}

/// At most `wanted` 95 % ellipses at equal intervals of rows, as one path of arcs.
fn ellipses(trail: &Trail, x: Scale, y: Scale, wanted: usize) -> String {
    let per_m = (x.to - x.from) / (x.high - x.low);
    let radius = chi_square_quantile(2, 0.95).sqrt() * per_m;
    let mut out = String::new();
    for i in 0..wanted {
        let row = trail.len() * (2 * i + 1) / (2 * wanted);
        let (Some(m), Some(a), Some(b), Some(d)) =
            (trail.mean(row), trail.cov_at(row, 0, 0), trail.cov_at(row, 0, 1), trail.cov_at(row, 1, 1))
        else {
            continue;
        };
        let spread = (0.25 * (a - d).powi(2) + b * b).sqrt();
        let (long, short) = (0.5 * (a + d) + spread, (0.5 * (a + d) - spread).max(0.0));
        let angle = 0.5 * (2.0 * b).atan2(a - d);
        let (rx, ry) = (radius * long.sqrt(), radius * short.sqrt());
        // The drawing's y points down.
        let (ex, ey) = (rx * angle.cos(), -rx * angle.sin());
        let (cx, cy) = (x.at(m[0]), y.at(m[1]));
        if ![rx, ry, cx, cy].iter().all(|v| v.is_finite()) || rx > 3.0 * Frame::WIDE {
            continue;
        }
        let tilt = -angle.to_degrees();
        // Writing to a string cannot fail.
        let _ = write!(
            out,
            "M{:.1} {:.1}A{rx:.1} {ry:.1} {tilt:.1} 1 0 {:.1} {:.1}A{rx:.1} {ry:.1} {tilt:.1} 1 0 {:.1} {:.1}Z",
            cx + ex,
            cy + ey,
            cx - ex,
            cy - ey,
            cx + ex,
            cy + ey
        );
    }
    out
}
