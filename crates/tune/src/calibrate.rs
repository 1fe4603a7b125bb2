//! Biases and path loss from residuals at known positions.

use crate::merit::{Recording, truth_of};
use fixtrail_track::packet::{Content, Kind};
use fixtrail_track::spec::{ModelSpec, SensorSpec, Spec};
use fixtrail_track::truth::{TargetTruth, TruthPoint};
use std::collections::BTreeMap;

/// Known positions further apart than this say nothing of what lies between them, seconds.
const LONGEST_GAP_S: f64 = 2.0;
/// Fewer residuals than this of an anchor are not its own: the others' median stands in.
const LEAST_RESIDUALS: usize = 10;
/// Errors are taken to be independent from block to block of this length, seconds: they come with place and posture.
pub const BLOCK_S: f64 = 10.0;
/// Pull of the mean level on each anchor's, as that of as many blocks.
const LEVEL_BLOCKS: f64 = 1.0;

/// A number with its standard error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimated {
    /// The number.
    pub value: f64,
    /// Its standard error; `None` where there is too little to tell.
    pub error: Option<f64>,
}

/// What calibration says of one sensor.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Calibration {
    /// Bias per anchor.
    pub bias: BTreeMap<String, Estimated>,
    /// Exponent and level at 1 m.
    pub path_loss: Option<[Estimated; 2]>,
    /// Residuals used.
    pub residuals: usize,
    /// Robust standard deviation of what is left.
    pub sd: f64,
}

/// One measurement at a known position.
struct Residual<'a> {
    anchor: &'a str,
    /// Distance from the anchor, metres.
    distance_m: f64,
    value: f64,
    /// Recording and block.
    block: (usize, i64),
}

/// Calibrates the sensor at `index` of `spec`; `None` where it has no anchors or nothing was measured at known positions.
pub fn calibrate(spec: &Spec, index: usize, recordings: &[Recording]) -> Option<Calibration> {
    let sensor = &spec.sensors[index];
    let axes = match &spec.model {
        ModelSpec::Kinematic(m) => m.axes,
        ModelSpec::GaussMarkov(m) => m.axes,
        _ => 2,
    };
    let residuals = residuals(sensor, axes, recordings);
    if residuals.len() < LEAST_RESIDUALS {
        return None;
    }
    match sensor.kind {
        Kind::Range => Some(biases(&residuals)),
        Kind::Rssi => path_loss(&residuals),
        _ => None,
    }
}

fn residuals<'a>(sensor: &SensorSpec, axes: usize, recordings: &'a [Recording]) -> Vec<Residual<'a>> {
    let mut out = Vec::new();
    for (number, recording) in recordings.iter().enumerate() {
        for target in &recording.targets {
            let Some(truth) = truth_of(recording, target) else { continue };
            for packet in &target.packets {
                let (anchor, value) = match packet.content {
                    Content::Range { anchor, value_m } if sensor.kind == Kind::Range => (anchor, value_m),
                    Content::Rssi { anchor, value_dbm } if sensor.kind == Kind::Rssi => (anchor, value_dbm),
                    _ => continue,
                };
                let Some(at) = position(truth, packet.t_s) else { continue };
                let site = recording.anchors.position_m(anchor);
                let rise = match (axes, sensor.height_m) {
                    (3, _) => at[2].unwrap_or(f64::NAN) - site[2],
                    (_, Some(height)) => height - site[2],
                    _ => 0.0,
                };
                let (Some(x), Some(y)) = (at[0], at[1]) else { continue };
                let distance_m = (x - site[0]).hypot(y - site[1]).hypot(rise);
                if !distance_m.is_finite() {
                    continue;
                }
                let block = (number, (packet.t_s / BLOCK_S).floor() as i64);
                out.push(Residual { anchor: recording.anchors.name(anchor), distance_m, value, block });
            }
        }
    }
    out
}

/// The known position at `t_s`, between two points that are close enough in time.
fn position(truth: &TargetTruth, t_s: f64) -> Option<[Option<f64>; 3]> {
    let after = truth.points.partition_point(|p| p.t_s < t_s);
    let (a, b): (&TruthPoint, &TruthPoint) = (truth.points.get(after.checked_sub(1)?)?, truth.points.get(after)?);
    let gap_s = b.t_s - a.t_s;
    if gap_s > LONGEST_GAP_S {
        return None;
    }
    let share = if gap_s > 0.0 { (t_s - a.t_s) / gap_s } else { 0.0 };
    Some(core::array::from_fn(|i| a.position_m[i].zip(b.position_m[i]).map(|(a, b)| a + share * (b - a))))
}

/// Standard deviation of known heights up to which they are one height, metres.
const ONE_HEIGHT_M: f64 = 0.5;

/// The height of targets that are tracked in the plane: the median of the known ones, where they are one height and the anchors are not all
/// at it.
pub fn height(recordings: &[Recording]) -> Option<f64> {
    let points = recordings.iter().flat_map(|r| r.truth.iter().flat_map(|t| &t.points));
    let mut heights: Vec<f64> = points.filter_map(|p| p.position_m[2]).collect();
    let height = median(&mut heights);
    let sites = recordings.iter().flat_map(|r| (0..r.anchors.len() as u32).map(|id| r.anchors.position_m(id)[2]));
    (robust_sd(&heights) <= ONE_HEIGHT_M && sites.into_iter().any(|z| z != height)).then_some(height)
}

/// The median of `values`; NaN of none.
fn median(values: &mut [f64]) -> f64 {
    if values.is_empty() {
        return f64::NAN;
    }
    values.sort_by(f64::total_cmp);
    let n = values.len();
    0.5 * (values[(n - 1) / 2] + values[n / 2])
}

/// 1.4826 times the median distance from the median.
fn robust_sd(values: &[f64]) -> f64 {
    let centre = median(&mut values.to_vec());
    1.4826 * median(&mut values.iter().map(|v| (v - centre).abs()).collect::<Vec<_>>())
}

/// The standard error of a median: that of the mean of the blocks' medians, which are taken to be independent.
fn block_error(values: &[(f64, (usize, i64))]) -> Option<f64> {
    let mut blocks: BTreeMap<(usize, i64), Vec<f64>> = BTreeMap::new();
    for (value, block) in values {
        blocks.entry(*block).or_default().push(*value);
    }
    let medians: Vec<f64> = blocks.values_mut().map(|v| median(v)).collect();
    let n = medians.len() as f64;
    if medians.len() < 3 {
        return None;
    }
    let mean = medians.iter().sum::<f64>() / n;
    let var = medians.iter().map(|m| (m - mean).powi(2)).sum::<f64>() / (n - 1.0);
    Some((var / n).sqrt())
}

fn by_anchor<'a>(residuals: &'a [Residual<'a>]) -> BTreeMap<&'a str, Vec<&'a Residual<'a>>> {
    let mut out: BTreeMap<&str, Vec<&Residual<'_>>> = BTreeMap::new();
    for residual in residuals {
        out.entry(residual.anchor).or_default().push(residual);
    }
    out
}

/// The median of value less distance, anchor by anchor.
fn biases(residuals: &[Residual<'_>]) -> Calibration {
    let error = |r: &Residual<'_>| r.value - r.distance_m;
    let overall = median(&mut residuals.iter().map(error).collect::<Vec<_>>());
    let mut bias = BTreeMap::new();
    let mut left = Vec::new();
    for (anchor, own) in by_anchor(residuals) {
        let values: Vec<(f64, (usize, i64))> = own.iter().map(|r| (error(r), r.block)).collect();
        let estimated = if values.len() < LEAST_RESIDUALS {
            Estimated { value: overall, error: None }
        } else {
            Estimated {
                value: median(&mut values.iter().map(|v| v.0).collect::<Vec<_>>()),
                error: block_error(&values),
            }
        };
        left.extend(values.iter().map(|v| v.0 - estimated.value));
        bias.insert(anchor.to_owned(), estimated);
    }
    Calibration { bias, path_loss: None, residuals: residuals.len(), sd: robust_sd(&left) }
}

/// `value = level + bias of the anchor − 10 n log10(distance)` by least squares, the biases of mean 0 and pulled to it.
fn path_loss(residuals: &[Residual<'_>]) -> Option<Calibration> {
    let log = |r: &Residual<'_>| -10.0 * r.distance_m.max(0.1).log10();
    let anchors = by_anchor(residuals);
    // Within each anchor the levels drop out: the slope is that of the deviations from the anchor's means.
    let (mut sxx, mut sxy) = (0.0, 0.0);
    let mut means = BTreeMap::new();
    for (anchor, own) in &anchors {
        let n = own.len() as f64;
        let mx = own.iter().map(|r| log(r)).sum::<f64>() / n;
        let my = own.iter().map(|r| r.value).sum::<f64>() / n;
        sxx += own.iter().map(|r| (log(r) - mx).powi(2)).sum::<f64>();
        sxy += own.iter().map(|r| (log(r) - mx) * (r.value - my)).sum::<f64>();
        means.insert(*anchor, (mx, my));
    }
    if !(sxx > 0.0) {
        return None;
    }
    // Further from free space than this is a sign of too little variety, not of a law.
    let exponent = (sxy / sxx).clamp(0.5, 6.0);
    let level_of = |anchor: &str| means.get(anchor).map_or(0.0, |(mx, my)| my - exponent * mx);
    let level = anchors.keys().map(|a| level_of(a)).sum::<f64>() / anchors.len() as f64;
    let mut bias = BTreeMap::new();
    let mut left = Vec::new();
    let mut blocks: BTreeMap<(usize, i64), (f64, f64)> = BTreeMap::new();
    for (anchor, own) in &anchors {
        let values: Vec<(f64, (usize, i64))> = own.iter().map(|r| (r.value - exponent * log(r), r.block)).collect();
        let count = values.iter().map(|v| v.1).collect::<std::collections::BTreeSet<_>>().len() as f64;
        let value = (level_of(anchor) - level) * count / (count + LEVEL_BLOCKS);
        bias.insert((*anchor).to_owned(), Estimated { value, error: block_error(&values) });
        left.extend(values.iter().map(|v| v.0 - level - value));
        let (mx, _) = means[anchor];
        for r in own {
            let (x, e) = (log(r) - mx, r.value - level - value - exponent * log(r));
            let block = blocks.entry(r.block).or_default();
            *block = (block.0 + x * e, block.1 + x * x);
        }
    }
    // Clustered by block: Σ (Σ x e)² / (Σ x²)².
    let clustered = blocks.values().map(|b| b.0 * b.0).sum::<f64>().sqrt() / sxx;
    let exponent = Estimated { value: exponent, error: (blocks.len() > 2).then_some(clustered) };
    let spread = bias.values().filter_map(|b| b.error).map(|e| e * e).sum::<f64>().sqrt() / anchors.len() as f64;
    let level = Estimated { value: level, error: (spread > 0.0).then_some(spread) };
    Some(Calibration { bias, path_loss: Some([exponent, level]), residuals: residuals.len(), sd: robust_sd(&left) })
}
