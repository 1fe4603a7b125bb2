//! How good a spec is on recordings.

use crate::calibrate::BLOCK_S;
use fixtrail_sim::metrics::{Instant, Kind, chi_square_quantile, judge};
use fixtrail_track::anchors::Anchors;
use fixtrail_track::packet::Packet;
use fixtrail_track::pipeline::track;
use fixtrail_track::predictive;
use fixtrail_track::spec::{EstimatorSpec, Receiver, Spec};
use fixtrail_track::target::{TargetPackets, TargetTrail};
use fixtrail_track::trackers::LaggedMode;
use fixtrail_track::truth::TargetTruth;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// What was recorded once.
#[derive(Clone, Debug)]
pub struct Recording {
    /// Its name, for messages and comments.
    pub name: String,
    /// The anchors of its place.
    pub anchors: Anchors,
    /// The packets of each target, sensed at the times that the spec's latencies say.
    pub targets: Vec<TargetPackets>,
    /// Known positions; empty without truth.
    pub truth: Vec<TargetTruth>,
}

/// Share of instants that the density takes for confusion.
const CONTAMINATION: f64 = 0.05;
/// Variance of a moment of confusion, in the claimed one.
const INFLATION: f64 = 100.0;
/// Standard deviation claimed, metres, where there is no estimate at all.
const IGNORANCE_M: f64 = 300.0;

/// Seconds without a fix that the score looks across as well: a network loses packets, and motion must foretell what they would have said.
const AHEAD_S: f64 = 2.0;
/// Weight of the score without fixes for [`AHEAD_S`].
const AHEAD: f64 = 0.3;

/// Weight of the plain error: that of `−2 ln RMSE`, the mean log density, but for a constant, of a claim of one covariance for all instants.
/// The contaminated density forgives the rare large error that decides an RMSE.
const PLAIN: f64 = 0.5;

/// How good a spec is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Merit {
    /// With truth half the mean log density of the true positions, three parts in ten of them foretold from fixes up to 2 s old, and
    /// half `−2 ln RMSE`; without truth the mean log density of the next measurements. The larger the better. −∞ for a spec that cannot be run.
    pub score: f64,
    /// Root mean square distance from the truth, metres, where there is truth.
    pub rmse_m: Option<f64>,
    /// Root mean square of the innovations over their standard deviation, where there is no truth.
    pub innovation: Option<f64>,
}

impl Merit {
    const WORST: Merit = Merit { score: f64::NEG_INFINITY, rmse_m: None, innovation: None };
}

/// What is added up over the targets of all recordings.
#[derive(Clone, Copy, Debug, Default)]
struct Sum {
    /// Targets, each of the same weight however long.
    weight: f64,
    score: f64,
    squared_m2: f64,
    instants: f64,
    nis: f64,
    scalars: f64,
}

/// Root mean square distance of the smoothed trail from the truth, metres; as [`merit`].
pub fn smoothed_rmse(spec: &Spec, recordings: &[Recording], shift_s: &[f64]) -> Option<f64> {
    let spec = Spec { estimator: EstimatorSpec::Rts, ..spec.clone() };
    let jobs: Vec<(&Recording, &TargetPackets)> =
        recordings.iter().flat_map(|r| r.targets.iter().map(move |t| (r, t))).collect();
    let one = |(recording, target): &(&Recording, &TargetPackets)| {
        let Some(truth) = truth_of(recording, target) else { return Some((0.0, 0.0)) };
        let target = shifted(&spec, target, shift_s);
        let trail = track(&spec, &recording.anchors, &target, LaggedMode::Own).ok()?;
        errors(&spec, Kind::Smoother, trail, truth)
    };
    let parts: Option<Vec<(f64, f64)>> = jobs.par_iter().map(one).collect();
    let (squares, count) = parts?.into_iter().fold((0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1));
    (count > 0.0).then(|| (squares / count).sqrt())
}

/// What estimates foretold of measurements that they had not seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PredictionError {
    /// Mean squared innovation over the variance of the sensor's noise, for a linear model the mean square itself.
    pub mean_square: f64,
    /// Scalars behind it.
    pub scalars: usize,
    /// Scalars that nothing was foretold of.
    pub unforetold: usize,
}

/// The prediction error of `spec`'s estimator; `None` for a spec that cannot be run and where nothing is foretold.
pub fn prediction_error(spec: &Spec, recordings: &[Recording], shift_s: &[f64]) -> Option<PredictionError> {
    let mut all = predictive::Score::default();
    for (recording, target) in jobs(recordings) {
        let target = shifted(spec, target, shift_s);
        let trail = track(spec, &recording.anchors, &target, LaggedMode::Own).ok()?;
        all.add(&predictive::score(spec, &recording.anchors, &target, &trail.trail, None).ok()?);
    }
    let (mut sum, mut scalars) = (0.0, 0);
    for (kind, size) in all.sizes() {
        let sd = spec.sensors.iter().find(|s| s.kind == kind).map_or(1.0, |s| s.sd);
        sum += size.scalars as f64 * (size.rms / sd).powi(2);
        scalars += size.scalars;
    }
    (scalars > 0 && sum.is_finite()).then(|| PredictionError {
        mean_square: sum / scalars as f64,
        scalars,
        unforetold: all.unforetold,
    })
}

fn jobs(recordings: &[Recording]) -> impl Iterator<Item = (&Recording, &TargetPackets)> {
    recordings.iter().flat_map(|r| r.targets.iter().map(move |t| (r, t)))
}

/// Trails of the smoother that goes with a filter, each with its recording and target.
fn lagged<'a>(
    spec: &Spec,
    recordings: &'a [Recording],
    shift_s: &[f64],
) -> Option<Vec<(&'a Recording, &'a TargetPackets, TargetTrail)>> {
    let one = |(recording, target): (&'a Recording, &'a TargetPackets)| {
        let moved = shifted(spec, target, shift_s);
        let trail = track(spec, &recording.anchors, &moved, LaggedMode::Both).ok()?;
        let smoothed = trail.trail.smoothed();
        Some((recording, target, TargetTrail { trail: smoothed, ..trail }))
    };
    jobs(recordings).map(one).collect()
}

/// Root mean square distance of the smoothed rows of an estimator with a lag from the truth, metres; `None` without truth.
pub fn lagged_rmse(spec: &Spec, recordings: &[Recording], shift_s: &[f64]) -> Option<f64> {
    let (mut squares, mut count) = (0.0, 0.0);
    for (recording, target, trail) in lagged(spec, recordings, shift_s)? {
        let Some(truth) = truth_of(recording, target) else { continue };
        let (more, of) = errors(spec, Kind::Smoother, trail, truth)?;
        (squares, count) = (squares + more, count + of);
    }
    (count > 0.0).then(|| (squares / count).sqrt())
}

/// Root mean square standard deviation that the smoothed rows of an estimator with a lag claim: of the position, or of all states of a linear
/// model together.
pub fn lagged_sd(spec: &Spec, recordings: &[Recording], shift_s: &[f64]) -> Option<f64> {
    let (mut sum, mut count) = (0.0, 0.0);
    for (_, _, trail) in lagged(spec, recordings, shift_s)? {
        let shown = match fixtrail_track::registry::layout(spec).axes {
            0 => trail.trail.n(),
            axes => axes,
        };
        for row in 0..trail.trail.len() {
            sum += (0..shown).filter_map(|i| trail.trail.cov_at(row, i, i)).sum::<f64>();
            count += 1.0;
        }
    }
    (count > 0.0).then(|| (sum / count).sqrt())
}

/// How much larger the claimed standard deviations ought to be, and on how many independent errors that rests.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Honesty {
    /// Factor by which the 95 % ellipse must grow to hold 95 % of the known positions.
    pub scale: f64,
    /// The same of the recording, or part of a lone one, where it holds least; 0 where none is long enough.
    pub worst: f64,
    /// Share of the known positions inside the ellipse as claimed.
    pub coverage: f64,
    /// Number of errors that are as good as independent: the length of the recordings over the time that an error lasts.
    pub independent: f64,
}

/// A recording with the specs that track it and the positions that each is judged at, in order of time.
pub type Case<'a> = (&'a Recording, Vec<(Spec, Vec<TargetTruth>)>);

/// What known positions say of the claimed covariance; `None` where there is too little to tell.
pub fn honesty(cases: &[Case<'_>], shift_s: &[f64]) -> Option<Honesty> {
    let (mut ratios, mut independent, mut worst) = (Vec::new(), 0.0, 0.0_f64);
    let of_95 = |ratios: &mut [f64]| {
        ratios.sort_by(f64::total_cmp);
        ratios[((ratios.len() - 1) as f64 * 0.95).round() as usize].sqrt()
    };
    for (recording, parts) in cases {
        let mut of_parts = vec![Vec::new(); parts.len()];
        for target in &recording.targets {
            let mut offsets: Vec<[f64; 2]> = Vec::new();
            for ((spec, truth), of_part) in parts.iter().zip(&mut of_parts) {
                let spec = causal(spec);
                let lone = recording.targets.len() == 1 && truth.len() == 1;
                let Some(truth) = truth.iter().find(|t| lone || t.target == target.target) else { continue };
                let moved = shifted(&spec, target, shift_s);
                let trail = track(&spec, &recording.anchors, &moved, LaggedMode::Own).ok()?;
                let truth = [TargetTruth { target: trail.target.clone(), points: truth.points.clone() }];
                let scored = judge(&spec, Kind::Filter, &[trail], &truth).ok()?;
                let instants = &scored.targets.first()?.instants;
                of_part.extend(instants.iter().filter_map(|i| i.nees.map(|n| n / chi_square_quantile(i.dof, 0.95))));
                offsets.extend(instants.iter().filter_map(|i| i.offset_m));
            }
            independent += offsets.len() as f64 / lasting(&offsets);
        }
        for mut of_part in of_parts {
            if of_part.len() >= LEAST_RATIOS {
                worst = worst.max(of_95(&mut of_part));
            }
            ratios.append(&mut of_part);
        }
    }
    if ratios.len() < LEAST_RATIOS {
        return None;
    }
    let scale = of_95(&mut ratios);
    let inside = ratios.iter().filter(|r| **r <= 1.0).count() as f64 / ratios.len() as f64;
    Some(Honesty { scale, worst, coverage: inside, independent })
}

/// Fewer known positions than this say nothing of a 95 % ellipse.
const LEAST_RATIOS: usize = 40;
/// Correlation below which errors count as forgotten.
const FORGOTTEN: f64 = 0.1;

/// Over how many instants an error lasts: 1 + 2 Σ ρ_k, up to the first lag at which it is forgotten.
fn lasting(offsets: &[[f64; 2]]) -> f64 {
    let n = offsets.len();
    let mean = |axis: usize| offsets.iter().map(|o| o[axis]).sum::<f64>() / n.max(1) as f64;
    let centre = [mean(0), mean(1)];
    let at = |i: usize, axis: usize| offsets[i][axis] - centre[axis];
    let product = |lag: usize| -> f64 {
        (0..n - lag).map(|i| at(i, 0) * at(i + lag, 0) + at(i, 1) * at(i + lag, 1)).sum::<f64>() / (n - lag) as f64
    };
    if n < 2 {
        return 1.0;
    }
    let variance = product(0);
    if !(variance > 0.0) {
        return 1.0;
    }
    let mut sum = 1.0;
    for lag in 1..n / 2 {
        let rho = product(lag) / variance;
        if rho < FORGOTTEN {
            break;
        }
        sum += 2.0 * rho;
    }
    sum
}

fn errors(spec: &Spec, kind: Kind, trail: TargetTrail, truth: &TargetTruth) -> Option<(f64, f64)> {
    let truth = TargetTruth { target: trail.target.clone(), points: truth.points.clone() };
    let scored = judge(spec, kind, &[trail], &[truth]).ok()?;
    let errors = scored.targets.first()?.instants.iter().filter_map(Instant::error_m);
    Some(errors.fold((0.0, 0.0), |(sum, count), e| (sum + e * e, count + 1.0)))
}

/// The known positions of a target; of a lone one those of any name.
pub(crate) fn truth_of<'a>(recording: &'a Recording, target: &TargetPackets) -> Option<&'a TargetTruth> {
    let lone = recording.targets.len() == 1 && recording.truth.len() == 1;
    recording.truth.iter().find(|t| lone || t.target == target.target)
}

/// The merit of `spec` on `recordings`; `shift_s` moves the times of each sensor's packets, in the order of the spec's sensors.
pub fn merit(spec: &Spec, recordings: &[Recording], shift_s: &[f64]) -> Merit {
    let spec = causal(spec);
    let jobs: Vec<(&Recording, &TargetPackets)> =
        recordings.iter().flat_map(|r| r.targets.iter().map(move |t| (r, t))).collect();
    // Collected in order, so that the sum does not depend on the threads.
    let parts: Option<Vec<Sum>> = jobs.par_iter().map(|(r, t)| one(&spec, r, t, shift_s)).collect();
    let Some(parts) = parts else { return Merit::WORST };
    let sum = parts.iter().fold(Sum::default(), |a, b| Sum {
        weight: a.weight + b.weight,
        score: a.score + b.score,
        squared_m2: a.squared_m2 + b.squared_m2,
        instants: a.instants + b.instants,
        nis: a.nis + b.nis,
        scalars: a.scalars + b.scalars,
    });
    if !(sum.weight > 0.0) || !sum.score.is_finite() {
        return Merit::WORST;
    }
    Merit {
        score: sum.score / sum.weight,
        rmse_m: (sum.instants > 0.0).then(|| (sum.squared_m2 / sum.instants).sqrt()),
        innovation: (sum.scalars > 0.0).then(|| (sum.nis / sum.scalars).sqrt()),
    }
}

/// The spec with the filter of its smoother: the search scores what was known at the time.
fn causal(spec: &Spec) -> Spec {
    let mut spec = spec.clone();
    if matches!(spec.estimator, EstimatorSpec::Rts | EstimatorSpec::FixedLagKalman { .. }) {
        spec.estimator = EstimatorSpec::Ekf;
    }
    spec
}

/// Packets with the times of each sensor moved.
fn shifted(spec: &Spec, target: &TargetPackets, shift_s: &[f64]) -> TargetPackets {
    let moved = |packet: &Packet| {
        let mut packet = packet.clone();
        let sensor = spec.sensors.iter().position(|s| s.kind == packet.content.kind());
        packet.t_s -= sensor.and_then(|i| shift_s.get(i)).copied().unwrap_or(0.0);
        packet
    };
    TargetPackets { target: target.target.clone(), packets: target.packets.iter().map(moved).collect() }
}

/// The part of one target; `None` for a spec that cannot be run.
fn one(spec: &Spec, recording: &Recording, target: &TargetPackets, shift_s: &[f64]) -> Option<Sum> {
    let moved;
    let target = if shift_s.iter().all(|s| *s == 0.0) {
        target
    } else {
        moved = shifted(spec, target, shift_s);
        &moved
    };
    let with_truth = !recording.truth.is_empty();
    let truth = truth_of(recording, target);
    if with_truth && truth.is_none() {
        return Some(Sum::default());
    }
    let trail = track(spec, &recording.anchors, target, LaggedMode::Own).ok()?;
    match truth {
        Some(truth) => of_truth(spec, target, trail, truth),
        None => {
            let score = match spec.link.receiver {
                Receiver::Stamped { .. } => {
                    predictive::score(spec, &recording.anchors, target, &trail.trail, None).ok()?
                }
                Receiver::Unstamped { .. } => {
                    predictive::score_held(spec, &recording.anchors, target, &trail.trail).ok()?
                }
            };
            let all = (score.scalars + score.unforetold) as f64;
            let Some(mean) = score.mean_log_density() else { return Some(Sum::default()) };
            // What nothing was foretold of counts as foretold with a hundred times the usual spread.
            let sum = mean * score.scalars as f64 + (mean - 100f64.ln()) * score.unforetold as f64;
            let nis = score.mean_nis().unwrap_or(0.0) * score.scalars as f64;
            Some(Sum { weight: 1.0, score: sum / all, nis, scalars: score.scalars as f64, ..Sum::default() })
        }
    }
}

/// One known position and what a trail says of it.
struct Known {
    t_s: f64,
    /// Three parts in ten of it foretold from fixes up to 2 s old.
    log_density: f64,
    /// Squared distance, square metres, where there is an estimate.
    squared_m2: Option<f64>,
}

fn known(spec: &Spec, target: &TargetPackets, trail: TargetTrail, truth: &TargetTruth) -> Option<Vec<Known>> {
    let from_s = target.packets.iter().map(|p| p.t_s).fold(f64::INFINITY, f64::min);
    let truth = [TargetTruth { target: trail.target.clone(), points: truth.points.clone() }];
    let rare = TargetTrail { trail: trail.trail.thinned(AHEAD_S), ..trail.clone() };
    let ahead = judge(spec, Kind::Filter, &[rare], &truth).ok()?;
    let scored = judge(spec, Kind::Filter, &[trail], &truth).ok()?;
    let both = scored.targets.first()?.instants.iter().zip(&ahead.targets.first()?.instants);
    let counts = |instant: &Instant| !instant.incomplete && instant.t_s >= from_s;
    let one = |(instant, ahead): (&Instant, &Instant)| Known {
        t_s: instant.t_s,
        log_density: (1.0 - AHEAD) * log_density(instant) + AHEAD * log_density(ahead),
        squared_m2: instant.error_m().map(|error| error * error),
    };
    Some(both.filter(|(instant, _)| counts(instant)).map(one).collect())
}

fn of_truth(spec: &Spec, target: &TargetPackets, trail: TargetTrail, truth: &TargetTruth) -> Option<Sum> {
    let known = known(spec, target, trail, truth)?;
    let mut sum = Sum::default();
    for instant in &known {
        sum.score += instant.log_density;
        if let Some(squared_m2) = instant.squared_m2 {
            sum.squared_m2 += squared_m2;
            sum.instants += 1.0;
        }
    }
    if !known.is_empty() {
        let rmse_m = if sum.instants > 0.0 { (sum.squared_m2 / sum.instants).sqrt() } else { IGNORANCE_M };
        let mean = sum.score / known.len() as f64;
        sum.score = (1.0 - PLAIN) * mean - PLAIN * 2.0 * rmse_m.max(f64::MIN_POSITIVE).ln();
        sum.weight = 1.0;
    }
    Some(sum)
}

/// Recording, target and block of time.
type Block = (usize, usize, i64);

/// The score with truth, block by block: the mean log density, and of `−2 ln RMSE` what the block adds to it to first order,
/// `−ln M − (m − M)/M` with the mean squared error m of the block and M of the target. `None` for a spec that cannot be run.
fn by_blocks(spec: &Spec, recordings: &[Recording], shift_s: &[f64]) -> Option<BTreeMap<Block, f64>> {
    let spec = causal(spec);
    let mut out = BTreeMap::new();
    for (r, recording) in recordings.iter().enumerate() {
        for (i, target) in recording.targets.iter().enumerate() {
            let Some(truth) = truth_of(recording, target) else { continue };
            let moved = shifted(&spec, target, shift_s);
            let trail = track(&spec, &recording.anchors, &moved, LaggedMode::Own).ok()?;
            let known = known(&spec, &moved, trail, truth)?;
            let mean = |of: &[&Known]| {
                let squares: Vec<f64> = of.iter().filter_map(|k| k.squared_m2).collect();
                squares.iter().sum::<f64>() / squares.len() as f64
            };
            let whole = mean(&known.iter().collect::<Vec<_>>());
            let mut blocks: BTreeMap<i64, Vec<&Known>> = BTreeMap::new();
            known.iter().for_each(|k| blocks.entry((k.t_s / BLOCK_S).floor() as i64).or_default().push(k));
            for (block, own) in blocks {
                let density = own.iter().map(|k| k.log_density).sum::<f64>() / own.len() as f64;
                let score = (1.0 - PLAIN) * density - PLAIN * (whole.ln() + mean(&own) / whole - 1.0);
                if score.is_finite() {
                    out.insert((r, i, block), score);
                }
            }
        }
    }
    Some(out)
}

/// The standard error of the gain in score of one spec over another, by the spread of what blocks of 10 s gain, which are taken to be
/// independent; `None` where there are fewer than three.
pub fn gain_error(better: &Spec, than: &Spec, recordings: &[Recording], shift_s: &[f64]) -> Option<f64> {
    let (a, b) = (by_blocks(better, recordings, shift_s)?, by_blocks(than, recordings, shift_s)?);
    let gains: Vec<f64> = a.iter().filter_map(|(block, score)| Some(score - b.get(block)?)).collect();
    let n = gains.len() as f64;
    let mean = gains.iter().sum::<f64>() / n;
    let var = gains.iter().map(|g| (g - mean).powi(2)).sum::<f64>() / (n - 1.0);
    (gains.len() > 2).then(|| (var / n).sqrt())
}

/// `ln(0.95 N(e; 0, P) + 0.05 N(e; 0, 100 P))` of the error at one instant.
fn log_density(instant: &Instant) -> f64 {
    let dof = instant.dof as f64;
    let normal = -0.5 * dof * std::f64::consts::TAU.ln();
    let (Some(nees), Some(log_det)) = (instant.nees, instant.log_det) else {
        return normal - dof * IGNORANCE_M.ln() - 0.5 * dof;
    };
    let wide = -0.5 * nees / INFLATION;
    let good = (1.0 - CONTAMINATION) * (-0.5 * nees - wide).exp();
    normal - 0.5 * log_det + wide + (good + CONTAMINATION * INFLATION.powf(-0.5 * dof)).ln()
}
