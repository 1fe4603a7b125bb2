//! What arrived when, and what each estimator made of it.

use super::{Detail, figure, packets_of, quantile};
use crate::format::shortened;
use crate::svg::{Frame, TimeAxis, bars};
use fixtrail_track::fix::Status;
use fixtrail_track::packet::{Content, Packet};
use maud::{Markup, html};
use std::collections::BTreeMap;

const X_PX: [f64; 2] = [170.0, 1084.0];
const ROW: f64 = 24.0;
/// Rows of sensors shown; the busiest first when there are more.
const ROWS: usize = 24;

const STATUSES: [Status; 4] = [Status::Updated, Status::Predicted, Status::Rejected, Status::Unobservable];

/// The figure, or nothing when neither packets nor trails are known.
pub fn timeline(detail: &Detail<'_>) -> Option<Markup> {
    let (sensors, omitted) = sensors(detail);
    let trails: Vec<_> = detail.series().collect();
    if sensors.is_empty() && trails.is_empty() {
        return None;
    }
    let x = detail.time.scale(X_PX);
    let bottom = 10.0 + ROW * (trails.len() + sensors.len()) as f64;
    let middle = |i: usize| 10.0 + ROW * (i as f64 + 0.5);
    let chart = html! {
        svg viewBox=(format!("0 0 {} {:.0}", Frame::WIDE, bottom + 50.0)) role="img" aria-label="Timeline of arrivals"
            data-x=(format!("{} {} {} {} 0", x.low, x.high, x.from, x.to)) {
            g class="grid" { @for (v, _) in x.ticks(8) { path d=(format!("M{:.1} 10V{bottom}", x.at(v))) {} } }
            g class="names" {
                @for (i, name) in trails.iter().map(|t| t.1.name).chain(sensors.iter().map(|s| s.0.as_str())).enumerate() {
                    text x=(X_PX[0] - 10.0) y=(format!("{:.1}", middle(i))) dy="0.35em" text-anchor="end" { (shortened(name, 16)) }
                }
            }
            @for (i, (_, _, trail)) in trails.iter().enumerate() {
                @let times: Vec<_> = (0..trail.len()).filter_map(|row| Some((detail.at(trail, row)?, trail.status[row]))).collect();
                @let step = typical_step(times.iter().map(|t| t.0));
                @for status in STATUSES {
                    path class={ "status " (status.name()) }
                        d=(bars(times.iter().filter(|t| t.1 == status).map(|t| (t.0, t.0 + step)), x, middle(i))) {}
                }
            }
            @for (i, (_, times)) in sensors.iter().enumerate() {
                @let step = typical_step(times.iter().copied());
                path class="arrived" d=(bars(times.iter().map(|t| (*t, t + step)), x, middle(trails.len() + i))) {}
            }
            path class="axis" d=(format!("M{} {bottom}H{}", X_PX[0], X_PX[1])) {}
            g class="ticks" {
                @for (v, label) in x.ticks(8) {
                    text x=(format!("{:.1}", x.at(v))) y=(bottom + 6.0) dy="0.9em" text-anchor="middle" { (label) }
                }
            }
            g class="titles" {
                text class="x" x=(0.5 * (X_PX[0] + X_PX[1])) y=(bottom + 42.0) text-anchor="middle" { (detail.time.title) }
            }
        }
        p class="key" {
            @for status in STATUSES { span class=(status.name()) { (status.name()) } }
            @if !sensors.is_empty() { span class="arrived" { "packet arrived" } }
        }
    };
    let mut caption = "One row per estimator (what happened at each of its instants) and per sensor. A bar is a packet and lasts until the \
                       next is due, so an unbroken bar is a perfect link and a hole is a loss."
        .to_owned();
    if omitted > 0 {
        caption += &format!(" {omitted} sensors with fewer packets are not shown.");
    }
    caption += &format!(
        " Holes shorter than {} {} are too narrow to be seen.",
        crate::format::number(detail.time.length / (X_PX[1] - X_PX[0])),
        detail.time.unit_name
    );
    Some(figure("wide time timeline", "What arrived", &chart, &caption))
}

/// The arrivals of each sensor in units of the time axis, and how many sensors are left out.
fn sensors(detail: &Detail<'_>) -> (Vec<(String, Vec<f64>)>, usize) {
    let mut rows: BTreeMap<(&str, u32, String), Vec<f64>> = BTreeMap::new();
    for packet in packets_of(detail.page, detail.target) {
        let t = time_of(packet, detail.time);
        for key in names(packet, detail) {
            rows.entry(key).or_default().push(t);
        }
    }
    let mut rows: Vec<_> = rows.into_iter().map(|((_, _, name), times)| (name, times)).collect();
    let omitted = rows.len().saturating_sub(ROWS);
    if omitted > 0 {
        rows.sort_by_key(|(_, times)| core::cmp::Reverse(times.len()));
        rows.truncate(ROWS);
    }
    for (_, times) in &mut rows {
        times.sort_by(f64::total_cmp);
    }
    (rows, omitted)
}

fn time_of(packet: &Packet, axis: TimeAxis) -> f64 {
    match (&packet.content, packet.k) {
        (Content::Linear { .. }, Some(k)) => k as f64,
        _ => axis.of(packet.t_s),
    }
}

/// The rows a packet belongs to: (kind, order, name).
fn names<'a>(packet: &Packet, detail: &Detail<'_>) -> Vec<(&'a str, u32, String)> {
    let kind = packet.content.kind().name();
    let anchors = detail.page.anchors;
    let of = |id: u32| if (id as usize) < anchors.len() { anchors.name(id) } else { "?" };
    match &packet.content {
        Content::Position(_) => vec![(kind, 0, kind.to_owned())],
        Content::Range { anchor, .. } | Content::Rssi { anchor, .. } | Content::Bearing { anchor, .. } => {
            vec![(kind, *anchor, format!("{kind} {}", of(*anchor)))]
        }
        Content::Tdoa { anchor, reference, .. } => {
            vec![(kind, *anchor, format!("{kind} {}−{}", of(*anchor), of(*reference)))]
        }
        Content::Linear { z, .. } => z
            .iter()
            .enumerate()
            .filter(|(_, v)| v.is_some())
            .map(|(i, _)| (kind, i as u32, format!("z{}", i + 1)))
            .collect(),
    }
}

/// The median interval between instants; 0 when there are fewer than two.
fn typical_step(times: impl Iterator<Item = f64>) -> f64 {
    let times: Vec<f64> = times.collect();
    quantile(times.windows(2).map(|w| w[1] - w[0]).filter(|d| *d > 0.0), 0.5)
}
