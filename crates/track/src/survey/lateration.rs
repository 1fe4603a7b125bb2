//! Noise of ranges as a tracker meets it: how badly the ranges of one moment fit any one point.
//!
//! Unlike differences in time this also sees what stays: biases of anchors, multipath, wrong anchor positions.

use super::noise::sd_from_group_residuals;
use crate::anchors::Anchors;
use crate::packet::{AnchorId, Content, Packet};
use nalgebra::{Matrix3, Vector3};
use std::collections::BTreeMap;

/// Enough groups for a median; more cost time and change nothing.
const MOST_GROUPS: usize = 1000;
const FEWEST_GROUPS: usize = 20;

/// The ranges of one moment: anchor positions and distances.
type Moment = Vec<(Vector3<f64>, f64)>;

/// Sets of ranges to different anchors that are no more than `within_s` apart and more than `axes`, at most a thousand.
pub(super) fn moments(packets: &[Packet], anchors: &Anchors, axes: usize, within_s: f64) -> Vec<Moment> {
    let mut ranges: Vec<(f64, AnchorId, f64)> = packets
        .iter()
        .filter_map(|p| match p.content {
            Content::Range { anchor, value_m } => Some((p.t_s, anchor, value_m)),
            _ => None,
        })
        .collect();
    ranges.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut groups: Vec<BTreeMap<AnchorId, f64>> = Vec::new();
    let mut start_s = f64::NEG_INFINITY;
    for (t_s, anchor, value_m) in ranges {
        if t_s - start_s > within_s {
            groups.push(BTreeMap::new());
            start_s = t_s;
        }
        if let Some(group) = groups.last_mut() {
            group.entry(anchor).or_insert(value_m);
        }
    }
    groups.retain(|g| g.len() > axes);
    let stride = groups.len().div_ceil(MOST_GROUPS).max(1);
    let place = |(id, r): (&AnchorId, &f64)| (Vector3::from(anchors.position_m(*id)), *r);
    groups.iter().step_by(stride).map(|g| g.iter().map(place).collect()).collect()
}

/// Standard deviation of ranges about the points that fit them best.
///
/// `axes` 2 keeps the target at `height_m`. `None` when there are too few moments.
pub(super) fn residual_sd(moments: &[Moment], axes: usize, height_m: f64) -> Option<f64> {
    // Moments of one size share their degrees of freedom; the most frequent size speaks for all.
    let mut by_size: BTreeMap<usize, Vec<f64>> = BTreeMap::new();
    for ranges in moments {
        if let Some(square) = least_squares(ranges, axes, height_m) {
            let dof = ranges.len() - axes;
            by_size.entry(dof).or_default().push((square / dof as f64).sqrt());
        }
    }
    let (dof, rms) = by_size.iter().max_by_key(|(_, rms)| rms.len())?;
    (rms.len() >= FEWEST_GROUPS).then(|| sd_from_group_residuals(rms, *dof)).flatten()
}

/// Sum of the squared residuals of the point that fits `ranges` best (Levenberg and Marquardt); `None` when nothing fits.
fn least_squares(ranges: &[(Vector3<f64>, f64)], axes: usize, height_m: f64) -> Option<f64> {
    let centre = ranges.iter().map(|(p, _)| p).sum::<Vector3<f64>>() / ranges.len() as f64;
    let reach = ranges.iter().map(|(_, r)| r.abs()).fold(0.0, f64::max);
    let cost = |x: &Vector3<f64>| ranges.iter().map(|(p, r)| ((x - p).norm() - r).powi(2)).sum::<f64>();
    // The cost has several valleys: start on a cross about the anchors.
    let starts = [(0.0, 0.0), (0.7, 0.0), (-0.7, 0.0), (0.0, 0.7), (0.0, -0.7)];
    let mut x = starts
        .map(|(dx, dy)| {
            let z = if axes == 2 { height_m } else { centre.z - 0.1 * reach };
            Vector3::new(centre.x + dx * reach, centre.y + dy * reach, z)
        })
        .into_iter()
        .min_by(|a, b| cost(a).total_cmp(&cost(b)))?;
    let mut damping = 1e-3;
    let mut square = cost(&x);
    for _ in 0..50 {
        let (mut normal, mut right) = (Matrix3::<f64>::zeros(), Vector3::zeros());
        for (p, r) in ranges {
            let away = x - p;
            let distance = away.norm().max(1e-9);
            let mut h = away / distance;
            if axes == 2 {
                h.z = 0.0;
            }
            normal += h * h.transpose();
            right += h * (r - distance);
        }
        if axes == 2 {
            normal[(2, 2)] = 1.0;
        }
        let step = (normal + Matrix3::from_diagonal_element(damping)).cholesky()?.solve(&right);
        let (next, lower) = (x + step, cost(&(x + step)));
        if lower < square {
            let settled = square - lower <= 1e-9 * square;
            (x, square, damping) = (next, lower, damping * 0.1);
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
    square.is_finite().then_some(square)
}
