//! Positions and noise as a tracker meets them: how badly the measurements of one moment fit any one point.
//!
//! Unlike differences in time this also sees what stays: biases of anchors, multipath, wrong anchor positions.

use super::noise::sd_from_group_residuals;
use super::stats::{median, quantile};
use crate::anchors::Anchors;
use crate::packet::{AnchorId, Content, Kind, Packet};
use nalgebra::{Matrix4, Vector3, Vector4};
use std::collections::BTreeMap;

/// Enough moments for a median; more cost time and change nothing.
const MOST_MOMENTS: usize = 1000;
pub(super) const FEWEST_MOMENTS: usize = 20;
/// Where the pull of a residual is limited, in standard deviations.
const HUBER: f64 = 1.345;
/// A bias that the ranges of a moment determine worse than this many times the noise of one range is not used.
const MOST_BIAS_GAIN: f64 = 3.0;

/// One measurement between the target and fixed radios.
#[derive(Clone, Copy, Debug)]
pub(super) struct Report {
    pub anchor_m: Vector3<f64>,
    /// The reference of a time difference.
    pub reference_m: Option<Vector3<f64>>,
    pub value: f64,
}

/// What one target's radios said at about one time, each source once.
#[derive(Clone, Debug)]
pub(super) struct Moment {
    pub t_s: f64,
    pub reports: Vec<Report>,
}

/// What is sought of a moment.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sought {
    pub kind: Kind,
    /// 2 keeps the target at `height_m`.
    pub axes: usize,
    pub height_m: f64,
    /// Whether all values may be too long by the same amount.
    pub bias: bool,
}

impl Sought {
    fn unknowns(&self) -> usize {
        self.axes + usize::from(self.bias)
    }
}

/// The point that fits a moment best.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fit {
    pub place_m: Vector3<f64>,
    bias: f64,
    /// Variance of the bias in those of a measurement.
    bias_gain: f64,
    /// Sum of the squared residuals.
    square: f64,
    cost: f64,
}

/// Reports of `kind` that are no more than `within_s` apart, of at least `least` sources, at most a thousand moments. Strengths of one source
/// within a moment are averaged, of others the first counts.
pub(super) fn moments(packets: &[Packet], kind: Kind, anchors: &Anchors, least: usize, within_s: f64) -> Vec<Moment> {
    let mut values: Vec<(f64, (AnchorId, Option<AnchorId>), f64)> = packets
        .iter()
        .filter_map(|p| match p.content {
            Content::Range { anchor, value_m } if kind == Kind::Range => Some((p.t_s, (anchor, None), value_m)),
            Content::Rssi { anchor, value_dbm } if kind == Kind::Rssi => Some((p.t_s, (anchor, None), value_dbm)),
            Content::Bearing { anchor, value_rad } if kind == Kind::Bearing => Some((p.t_s, (anchor, None), value_rad)),
            Content::Tdoa { anchor, reference, value_m } if kind == Kind::Tdoa => {
                Some((p.t_s, (anchor, Some(reference)), value_m))
            }
            _ => None,
        })
        .collect();
    values.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    type Group = (f64, BTreeMap<(AnchorId, Option<AnchorId>), (f64, f64)>);
    let mut groups: Vec<Group> = Vec::new();
    for (t_s, source, value) in values {
        if groups.last().is_none_or(|(start_s, _)| t_s - start_s > within_s) {
            groups.push((t_s, BTreeMap::new()));
        }
        if let Some((_, group)) = groups.last_mut() {
            let entry = group.entry(source).or_insert((0.0, 0.0));
            if kind == Kind::Rssi || entry.1 == 0.0 {
                *entry = (entry.0 + value, entry.1 + 1.0);
            }
        }
    }
    groups.retain(|(_, g)| g.len() >= least);
    let stride = groups.len().div_ceil(MOST_MOMENTS).max(1);
    let place = |id: AnchorId| Vector3::from(anchors.position_m(id));
    let report = |((id, reference), (sum, count)): (&(AnchorId, Option<AnchorId>), &(f64, f64))| Report {
        anchor_m: place(*id),
        reference_m: reference.map(place),
        value: sum / count,
    };
    groups
        .iter()
        .step_by(stride)
        .map(|(t_s, g)| Moment { t_s: *t_s, reports: g.iter().map(report).collect() })
        .collect()
}

/// Standard deviation of the measurements about the points that fit them best; `None` when there are too few moments.
pub(super) fn residual_sd(moments: &[Moment], sought: Sought) -> Option<f64> {
    // Moments of one size share their degrees of freedom; the most frequent size speaks for all.
    let mut by_size: BTreeMap<usize, Vec<f64>> = BTreeMap::new();
    for moment in moments {
        let dof = moment.reports.len().saturating_sub(sought.unknowns());
        if let (true, Some(fit)) = (dof > 0, least_squares(&moment.reports, sought, f64::INFINITY)) {
            by_size.entry(dof).or_default().push((fit.square / dof as f64).sqrt());
        }
    }
    let (dof, rms) = by_size.iter().max_by_key(|(_, rms)| rms.len())?;
    (rms.len() >= FEWEST_MOMENTS).then(|| sd_from_group_residuals(rms, *dof)).flatten()
}

/// By how much all ranges are too long: the median over those moments that determine it, where three of four say it is so.
pub(super) fn common_bias(moments: &[Moment], sought: Sought, sd: f64) -> Option<f64> {
    let sought = Sought { bias: true, ..sought };
    let mut found: Vec<(f64, f64)> = moments
        .iter()
        .filter(|m| m.reports.len() > sought.unknowns())
        .filter_map(|m| least_squares(&m.reports, sought, HUBER * sd.max(1e-3)))
        .filter(|fit| fit.bias_gain.is_finite())
        .map(|fit| (fit.bias_gain, fit.bias))
        .collect();
    // The better determined half.
    found.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    found.truncate(found.len().div_ceil(2));
    found.retain(|(gain, _)| *gain <= MOST_BIAS_GAIN * MOST_BIAS_GAIN);
    if found.len() < FEWEST_MOMENTS / 2 {
        return None;
    }
    let sorted = super::stats::ascending(found.into_iter().map(|(_, bias)| bias));
    quantile(&sorted, 0.25).filter(|low| *low > 0.0)?;
    median(sorted)
}

/// What a point predicts for a report, and the gradient.
fn expected(kind: Kind, x: &Vector3<f64>, report: &Report) -> (f64, Vector3<f64>) {
    let from = |p: &Vector3<f64>| {
        let away = x - p;
        let distance = away.norm().max(1e-9);
        (distance, away / distance)
    };
    match (kind, &report.reference_m) {
        (Kind::Bearing, _) => {
            let away = x - report.anchor_m;
            let square = (away.x * away.x + away.y * away.y).max(1e-9);
            (away.y.atan2(away.x), Vector3::new(-away.y, away.x, 0.0) / square)
        }
        (_, Some(reference)) => {
            let ((far, away), (near, back)) = (from(&report.anchor_m), from(reference));
            (far - near, away - back)
        }
        _ => from(&report.anchor_m),
    }
}

/// A residual; that of a direction is the shorter way round.
fn residual(kind: Kind, value: f64, expected: f64) -> f64 {
    let off = value - expected;
    if kind == Kind::Bearing { off.sin().atan2(off.cos()) } else { off }
}

/// The cost of a residual whose pull ends growing at `limit`, and its weight.
fn huber(residual: f64, limit: f64) -> (f64, f64) {
    let size = residual.abs();
    if size <= limit { (size * size, 1.0) } else { (limit * (2.0 * size - limit), limit / size) }
}

/// The point that fits `reports` best (Levenberg and Marquardt); `None` when nothing fits.
pub(super) fn least_squares(reports: &[Report], sought: Sought, limit: f64) -> Option<Fit> {
    let radios = || reports.iter().flat_map(|r| [Some(r.anchor_m), r.reference_m]).flatten();
    let centre = radios().sum::<Vector3<f64>>() / radios().count() as f64;
    let reach = match sought.kind {
        Kind::Range => reports.iter().map(|r| r.value.abs()).fold(0.0, f64::max),
        _ => radios().map(|p| (p - centre).norm()).fold(0.0, f64::max),
    };
    let start = |x: f64, y: f64| {
        let z = if sought.axes == 2 { sought.height_m } else { centre.z - 0.1 * reach };
        Vector3::new(x, y, z)
    };
    let cost = |x: &Vector3<f64>| cost(reports, sought.kind, x, 0.0, limit);
    // The cost has several valleys: start on a cross about the anchors.
    let cross = [(0.0, 0.0), (0.7, 0.0), (-0.7, 0.0), (0.0, 0.7), (0.0, -0.7)];
    let mut starts: Vec<Vector3<f64>> =
        cross.iter().map(|(dx, dy)| start(centre.x + dx * reach, centre.y + dy * reach)).collect();
    if sought.kind == Kind::Range {
        // Ranges lead home from the best of them.
        let best = starts.into_iter().min_by(|a, b| cost(a).total_cmp(&cost(b)))?;
        return descend(reports, sought, limit, best);
    }
    // Close to an anchor the curves of time differences crowd.
    starts.extend(radios().map(|p| start(0.5 * (p.x + centre.x), 0.5 * (p.y + centre.y))));
    let fits = starts.into_iter().filter_map(|x| descend(reports, sought, limit, x));
    fits.min_by(|a, b| a.cost.total_cmp(&b.cost))
}

fn cost(reports: &[Report], kind: Kind, x: &Vector3<f64>, bias: f64, limit: f64) -> f64 {
    reports.iter().map(|r| huber(residual(kind, r.value - bias, expected(kind, x, r).0), limit).0).sum()
}

fn descend(reports: &[Report], sought: Sought, limit: f64, mut x: Vector3<f64>) -> Option<Fit> {
    let free = [true, true, sought.axes == 3, sought.bias];
    let linearised = |x: &Vector3<f64>, bias: f64| {
        let (mut normal, mut right) = (Matrix4::<f64>::zeros(), Vector4::zeros());
        for r in reports {
            let (value, gradient) = expected(sought.kind, x, r);
            let off = residual(sought.kind, r.value - bias, value);
            let mut h = gradient.push(1.0);
            (0..4).filter(|i| !free[*i]).for_each(|i| h[i] = 0.0);
            let weight = huber(off, limit).1;
            normal += h * h.transpose() * weight;
            right += h * (off * weight);
        }
        (normal, right)
    };
    let held = |mut normal: Matrix4<f64>, scale: f64, damping: f64| {
        for i in 0..4 {
            normal[(i, i)] = if free[i] { normal[(i, i)] + damping * scale } else { 1.0 };
        }
        normal.cholesky()
    };
    let mut bias = 0.0;
    let mut damping = 1e-3;
    let mut lowest = cost(reports, sought.kind, &x, bias, limit);
    for _ in 0..50 {
        let (normal, right) = linearised(&x, bias);
        let scale = normal.diagonal().max().max(1e-300);
        let step = held(normal, scale, damping)?.solve(&right);
        let (there, shift) = (x + step.xyz(), bias + step.w);
        let lower = cost(reports, sought.kind, &there, shift, limit);
        if lower < lowest {
            let settled = lowest - lower <= 1e-9 * lowest;
            (x, bias, lowest, damping) = (there, shift, lower, damping * 0.1);
            if settled {
                break;
            }
        } else {
            damping *= 10.0;
            if damping > 1e6 {
                break;
            }
        }
    }
    let square = cost(reports, sought.kind, &x, bias, f64::INFINITY);
    let bias_gain = held(linearised(&x, bias).0, 0.0, 0.0).map_or(f64::INFINITY, |c| c.inverse()[(3, 3)]);
    lowest.is_finite().then_some(Fit { place_m: x, bias, bias_gain, square, cost: lowest })
}
