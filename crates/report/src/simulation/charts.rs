//! Charts of a simulation.

use super::{Channel, Simulation};
use crate::charts::{extent, figure, quantile, series_class, size};
use crate::svg::{Frame, Scale, TimeAxis, area, line};
use fixtrail_sim::metrics::chi_square_quantile;
use fixtrail_sim::monte_carlo::{Moment, Summary};
use fixtrail_track::registry;
use maud::{Markup, html};

/// Most points of a line over time.
const POINTS: usize = 500;

fn is_linear(simulation: &Simulation<'_>) -> bool {
    registry::layout(&simulation.world.truth).is_linear()
}

fn error_title(simulation: &Simulation<'_>) -> &'static str {
    if is_linear(simulation) { "error of the state" } else { "position error [m]" }
}

/// RMSE against the loss rate.
pub fn by_loss_rate(simulation: &Simulation<'_>) -> Markup {
    let channels = simulation.channels;
    let contenders = channels.first().map_or(0, |c| c.outcome.contenders.len());
    let at = |i: usize| channels.iter().map(move |c| (100.0 * c.loss_rate, c.outcome.contenders[i].rmse));
    let [low, high] = extent(channels.iter().map(|c| 100.0 * c.loss_rate));
    let values = || (0..contenders).flat_map(at).map(|(_, v)| v.mean);
    let bounds =
        || channels.iter().filter_map(|c| Some((100.0 * c.loss_rate, c.outcome.bound.as_ref().ok()?.rms.mean)));
    let y = errors_scale(values().chain(bounds().map(|(_, v)| v)).collect());
    let x = Scale::linear([low, high], Frame::WIDE_X_PX);
    let mut order: Vec<usize> = (0..channels.len()).collect();
    order.sort_by(|a, b| channels[*a].loss_rate.total_cmp(&channels[*b].loss_rate));
    let sorted = |mut points: Vec<(f64, f64)>| {
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        points.into_iter().map(Some).collect::<Vec<_>>()
    };
    let body = html! {
        g class="truth" { path data-name="Cramér–Rao bound" d=(line(&sorted(bounds().collect()), x, y)) {} }
        @for i in 0..contenders {
            @let band: Vec<_> = order.iter().map(|c| {
                let (rate, v) = (100.0 * channels[*c].loss_rate, channels[*c].outcome.contenders[i].rmse);
                Some((rate, (v.mean - 2.0 * v.se).max(y.low), v.mean + 2.0 * v.se))
            }).collect();
            path class={ "band " (series_class(i)) } d=(area(&band, x, y)) {}
            path class={ "line " (series_class(i)) } data-name=(channels[0].outcome.contenders[i].name)
                d=(line(&sorted(at(i).map(|(rate, v)| (rate, v.mean)).collect()), x, y)) {}
        }
    };
    let frame = Frame {
        width: Frame::WIDE,
        height: Frame::HEIGHT,
        x,
        y,
        x_title: "packets lost [%]".to_owned(),
        y_title: format!("RMS of the {}", error_title(simulation)),
        label: "Root mean square error against the loss rate".to_owned(),
        id: "loss-rate".to_owned(),
    };
    let caption = "Root mean square error of each estimator, with two standard errors to either side. Grey: the Cramér–Rao bound of causal \
                   estimates.";
    figure("wide", "What losses cost", &frame.draw(&body, &html! {}), caption)
}

/// All charts of one channel.
pub fn of_channel(simulation: &Simulation<'_>, channel: &Channel<'_>, index: usize) -> Markup {
    html! {
        (over_time(simulation, channel, index))
        (distribution(simulation, channel, index))
        @if let Some(figure) = nees(simulation, channel, index) { (figure) }
        @if let Some(figure) = nis(simulation, channel, index) { (figure) }
    }
}

/// A scale of errors from 0, or logarithmic when the largest would flatten the rest.
fn errors_scale(values: Vec<f64>) -> Scale {
    let (middle, [low, high]) = (quantile(values.iter().copied(), 0.5), extent(values));
    if low > 0.0 && high > 20.0 * middle.max(low) {
        return Scale::log([0.9 * low, 1.1 * high], Frame::Y_PX);
    }
    Scale::linear([0.0, if high > 0.0 { 1.05 * high } else { 1.0 }], Frame::Y_PX)
}

/// Whether instants are numbered: those of a schedule are not equally far apart.
fn numbered(simulation: &Simulation<'_>) -> bool {
    is_linear(simulation) || simulation.world.schedule.is_some()
}

fn time(simulation: &Simulation<'_>) -> TimeAxis {
    match numbered(simulation) {
        true => TimeAxis::index(simulation.world.steps as u64),
        false => TimeAxis::seconds(0.0, simulation.world.steps as f64 * simulation.world.interval_s),
    }
}

/// Where instant `k` stands on the time axis.
fn place(simulation: &Simulation<'_>, k: usize) -> f64 {
    let at = if numbered(simulation) { 1.0 } else { simulation.world.interval_s };
    time(simulation).of(k as f64 * at)
}

/// `over_time` in so few pieces that a line stays light, each the sum over its instants, with the middle of their times.
fn pieces(simulation: &Simulation<'_>, over_time: &[Moment]) -> Vec<(f64, Moment)> {
    let len = over_time.len().div_ceil(POINTS).max(1);
    let sum = |all: &[Moment]| {
        all.iter().fold(Moment::default(), |a, b| Moment {
            count: a.count + b.count,
            square: a.square + b.square,
            claimed: a.claimed + b.claimed,
            nees: a.nees + b.nees,
            nis: a.nis + b.nis,
            nis_dof: a.nis_dof + b.nis_dof,
        })
    };
    let at =
        |piece: usize, count: usize| place(simulation, 1) * (piece * len) as f64 + place(simulation, count + 1) / 2.0;
    over_time.chunks(len).enumerate().map(|(i, all)| (at(i, all.len()), sum(all))).collect()
}

fn ratio(value: f64, count: u64) -> Option<f64> {
    (count > 0).then(|| value / count as f64).filter(|v| v.is_finite())
}

fn over_time(simulation: &Simulation<'_>, channel: &Channel<'_>, index: usize) -> Markup {
    let all = &channel.outcome.contenders;
    let curves: Vec<Vec<(f64, Moment)>> = all.iter().map(|s| pieces(simulation, &s.over_time)).collect();
    let bound: Vec<(f64, f64)> = channel.outcome.bound.as_ref().map_or(Vec::new(), |bound| {
        let len = bound.over_time.len().div_ceil(POINTS).max(1);
        bound.over_time.iter().enumerate().step_by(len).map(|(i, v)| (place(simulation, i + 1), *v)).collect()
    });
    let rms = |m: &Moment| ratio(m.square, m.count).map(f64::sqrt);
    let claimed = |m: &Moment| ratio(m.claimed, m.count).map(f64::sqrt);
    let values = curves.iter().flatten().filter_map(|(_, m)| rms(m)).chain(bound.iter().map(|b| b.1)).collect();
    let (x, y) = (time(simulation).scale(Frame::WIDE_X_PX), errors_scale(values));
    let of = |curve: &[(f64, Moment)], f: &dyn Fn(&Moment) -> Option<f64>| {
        curve.iter().map(|(t, m)| f(m).map(|v| (*t, v))).collect::<Vec<_>>()
    };
    let body = html! {
        g class="truth" {
            path data-name="Cramér–Rao bound" d=(line(&bound.iter().copied().map(Some).collect::<Vec<_>>(), x, y)) {}
        }
        @for (i, (s, curve)) in all.iter().zip(&curves).enumerate() {
            path class={ "line claimed " (series_class(i)) } d=(line(&of(curve, &claimed), x, y)) {}
            path class={ "line " (series_class(i)) } data-name=(s.name) d=(line(&of(curve, &rms), x, y)) {}
        }
    };
    let frame = Frame {
        width: Frame::WIDE,
        height: Frame::HEIGHT,
        x,
        y,
        x_title: time(simulation).title.to_owned(),
        y_title: format!("RMS of the {}", error_title(simulation)),
        label: "Root mean square error over time".to_owned(),
        id: format!("error-{index}"),
    };
    let caption = "Lines: root mean square error over the runs at each instant. Dashed: what the estimator claims; above its line it claims too \
                   much error, below too little. Grey: the Cramér–Rao bound of causal estimates.";
    figure("wide time", "Error over time", &frame.draw(&body, &html! {}), caption)
}

fn distribution(simulation: &Simulation<'_>, channel: &Channel<'_>, index: usize) -> Markup {
    const MARKS: [f64; 4] = [50.0, 60.0, 90.0, 95.0];
    let all = &channel.outcome.contenders;
    let values = || all.iter().flat_map(|s| s.curve.iter().copied());
    let (median, largest) = (quantile(values(), 0.5), quantile(values(), 1.0));
    let log = median > 0.0 && largest > 25.0 * median;
    let x = match log {
        true => Scale::log([quantile(values(), 0.02).max(1e-2 * median), largest], Frame::X_PX),
        false => Scale::linear([0.0, largest], Frame::X_PX),
    };
    let y = Scale::linear([0.0, 100.0], Frame::Y_PX);
    let points = |s: &Summary| {
        let steps = s.curve.len().saturating_sub(1).max(1) as f64;
        s.curve.iter().enumerate().map(|(i, v)| Some((*v, 100.0 * i as f64 / steps))).collect::<Vec<_>>()
    };
    let body = html! {
        @for mark in MARKS { path class="mark-line" d=(format!("M{} {:.1}H{}", x.from, y.at(mark), x.to)) {} }
        @for (i, s) in all.iter().enumerate() { path class={ "line " (series_class(i)) } data-name=(s.name) d=(line(&points(s), x, y)) {} }
    };
    let frame = Frame {
        width: Frame::WIDTH,
        height: Frame::HEIGHT,
        x,
        y,
        x_title: format!("{}{}", error_title(simulation), if log { ", logarithmic" } else { "" }),
        y_title: "share of instants [%]".to_owned(),
        label: "Cumulative distribution of the error".to_owned(),
        id: format!("cdf-{index}"),
    };
    let caption = "Read across from a dashed line (50, 60, 90, 95 %) to a curve, then down: that share of all instants of all runs has a smaller \
                   error.";
    figure("", "How large errors are", &frame.draw(&body, &html! {}), caption)
}

/// A ratio and its degrees of freedom.
#[derive(Clone, Copy)]
struct Judged {
    value: f64,
    dof: f64,
}

/// What makes a ratio of a piece.
type Of<'a> = dyn Fn(&Summary, &Moment) -> Option<Judged> + 'a;

/// A consistency figure over time: a ratio that should be 1, with its band.
struct Ratio<'a> {
    title: &'a str,
    y_title: &'a str,
    id: String,
    caption: &'a str,
    /// Over the page's whole width.
    wide: bool,
    of: &'a Of<'a>,
}

fn ratio_figure(simulation: &Simulation<'_>, channel: &Channel<'_>, wanted: &Ratio<'_>) -> Option<Markup> {
    let all = &channel.outcome.contenders;
    let curves: Vec<Vec<(f64, Option<Judged>)>> = all
        .iter()
        .map(|s| pieces(simulation, &s.over_time).into_iter().map(|(t, m)| (t, (wanted.of)(s, &m))).collect())
        .collect();
    let widest = curves.iter().max_by_key(|c| c.iter().filter(|(_, v)| v.is_some()).count())?;
    let band: Vec<Option<(f64, f64, f64)>> = widest
        .iter()
        .map(|(t, v)| {
            let dof = (*v)?.dof;
            let at = |p: f64| chi_square_quantile(dof as usize, p) / dof;
            Some((*t, at(0.025), at(0.975)))
        })
        .collect();
    if band.iter().all(Option::is_none) {
        return None;
    }
    let [least, most] = extent(band.iter().flatten().flat_map(|b| [b.1, b.2]));
    let values = || curves.iter().flatten().filter_map(|(_, v)| v.map(|v| v.value)).filter(|v| *v > 0.0);
    // One wild contender must not flatten the rest.
    let low = quantile(values(), 0.005).min(least).max(1e-2) / 1.1;
    let high = (1.1 * quantile(values(), 0.995).max(most)).min(1e3);
    let (width, x_px, class) = size(wanted.wide);
    let x = time(simulation).scale(x_px);
    let log = high > 5.0 * low;
    let y = if log { Scale::log([low, high], Frame::Y_PX) } else { Scale::linear([low, high], Frame::Y_PX) };
    let body = html! {
        path class="expected" d=(area(&band, x, y)) {}
        path class="mark-line" d=(format!("M{} {:.1}H{}", x.from, y.at(1.0), x.to)) {}
        @for (i, (s, curve)) in all.iter().zip(&curves).enumerate() {
            @let points: Vec<_> = curve.iter().map(|(t, v)| v.map(|v| (*t, v.value))).collect();
            path class={ "line " (series_class(i)) } data-name=(s.name) d=(line(&points, x, y)) {}
        }
    };
    let frame = Frame {
        width,
        height: Frame::HEIGHT,
        x,
        y,
        x_title: time(simulation).title.to_owned(),
        y_title: format!("{}{}", wanted.y_title, if log { ", logarithmic" } else { "" }),
        label: wanted.title.to_owned(),
        id: wanted.id.clone(),
    };
    Some(figure(class, wanted.title, &frame.draw(&body, &html! {}), wanted.caption))
}

fn nees(simulation: &Simulation<'_>, channel: &Channel<'_>, index: usize) -> Option<Markup> {
    let steps = simulation.world.steps.div_ceil(POINTS).max(1) as f64;
    let wanted = Ratio {
        title: "Errors in units of what is claimed",
        y_title: "ANEES [1]",
        id: format!("nees-{index}"),
        wide: false,
        caption: "Normalised estimation error squared over its degrees of freedom, mean over the runs at each instant. Runs are independent: a \
                  consistent estimator is in the grey chi-square band at 95 of 100 instants; above is optimistic, below pessimistic.",
        of: &|s, m| {
            let dof = m.count as f64 / steps * s.components as f64;
            Some(Judged { value: ratio(m.nees, m.count)?, dof })
        },
    };
    ratio_figure(simulation, channel, &wanted)
}

fn nis(simulation: &Simulation<'_>, channel: &Channel<'_>, index: usize) -> Option<Markup> {
    let wanted = Ratio {
        title: "Innovations in units of what is expected",
        y_title: "ANIS [1]",
        id: format!("nis-{index}"),
        wide: true,
        caption: "Normalised innovation squared over its degrees of freedom, mean over the runs at each instant, with its grey 95 % chi-square \
                  band. A filter that knows the noise and what has arrived is inside; it needs no truth.",
        of: &|_, m| Some(Judged { value: ratio(m.nis, m.nis_dof)?, dof: m.nis_dof as f64 }),
    };
    ratio_figure(simulation, channel, &wanted)
}
