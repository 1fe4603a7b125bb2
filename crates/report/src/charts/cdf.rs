//! The distribution of the errors.

use super::{figure, quantile, series_class};
use crate::Page;
use crate::svg::{Frame, Scale, line};
use maud::{Markup, html};

/// Points of one curve.
const STEPS: usize = 400;
const MARKS: [f64; 4] = [0.5, 0.6, 0.9, 0.95];

/// The figure, or nothing without truth.
pub fn cdf(page: &Page<'_>) -> Option<Markup> {
    let curves: Vec<(String, &str, Vec<f64>)> = page
        .series
        .iter()
        .enumerate()
        .filter_map(|(i, s)| {
            let mut errors: Vec<f64> =
                s.score?.targets.iter().flat_map(|t| &t.instants).filter_map(|i| i.error_m()).collect();
            errors.sort_by(f64::total_cmp);
            (!errors.is_empty()).then(|| (series_class(i), s.name, errors))
        })
        .collect();
    let all = || curves.iter().flat_map(|c| c.2.iter().copied());
    let (median, largest) = (quantile(all(), 0.5), quantile(all(), 1.0));
    if curves.is_empty() {
        return None;
    }
    let log = median > 0.0 && largest > 25.0 * median;
    let x = if log {
        Scale::log([quantile(all(), 0.02).max(1e-3 * median), largest], Frame::X_PX)
    } else {
        Scale::linear([0.0, largest], Frame::X_PX)
    };
    let y = Scale::linear([0.0, 100.0], Frame::Y_PX);
    let body = html! {
        @for mark in MARKS { path class="mark-line" d=(format!("M{} {:.1}H{}", x.from, y.at(100.0 * mark), x.to)) {} }
        @for (class, name, errors) in &curves {
            @let points: Vec<_> = (0..=STEPS).map(|i| {
                let p = i as f64 / STEPS as f64;
                Some((errors[(p * (errors.len() - 1) as f64).round() as usize], 100.0 * p))
            }).collect();
            path class={ "line " (class) } data-name=(name) d=(line(&points, x, y)) {}
        }
    };
    let over = html! {
        g class="marks" {
            @for (i, mark) in MARKS.into_iter().enumerate() {
                // In pairs, one below and one above its line, so that 90 and 95 % do not meet.
                text x=(x.from + 6.0) y=(format!("{:.1}", y.at(100.0 * mark))) dy=(if i % 2 == 0 { "1.05em" } else { "-0.3em" }) { (format!("{:.0} %", 100.0 * mark)) }
            }
        }
    };
    let frame = Frame {
        width: Frame::WIDTH,
        height: Frame::HEIGHT,
        x,
        y,
        x_title: format!("position error [m]{}", if log { ", logarithmic" } else { "" }),
        y_title: "share of instants [%]".to_owned(),
        label: "Cumulative distribution of the position error".to_owned(),
        id: "cdf".to_owned(),
    };
    let caption = "Read across from a dashed line (50, 60, 90, 95 %) to a curve, then down: that share of all truth instants has a smaller \
                   error. A curve further left is better; a long flat end means rare large errors.";
    Some(figure("", "How large errors are", &frame.draw(&body, &over), caption))
}
