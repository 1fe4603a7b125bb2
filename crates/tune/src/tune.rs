//! From a first spec to a tuned one.

use crate::arrival;
use crate::calibrate::{self, Calibration, calibrate};
use crate::knobs::{Place, Setting};
use crate::merit::{Case, Honesty, Merit, Recording, gain_error, honesty, merit, smoothed_rmse};
use crate::search::{Candidate, Effort, Profile, profiles, search};
use crate::structure::Change;
use crate::window::{self, Windows};
use fixtrail_sim::metrics::student_quantile;
use fixtrail_track::link::Learnt;
use fixtrail_track::packet::Kind;
use fixtrail_track::pipeline::track;
use fixtrail_track::spec::{ArrivalSpec, EstimatorSpec, ModelSpec, Receiver, Robust, SensorSpec, Spec};
use fixtrail_track::trackers::LaggedMode;
use fixtrail_track::truth::{TargetTruth, TruthPoint};

/// Gain in the score that a change of structure must bring.
const WORTH_A_CHANGE: f64 = 0.03;
/// The same for stationary motion, which is wrong about a target that stays at the edge of its place.
const WORTH_A_PLACE: f64 = 0.1;
/// The same for the biweight, which alone is safe from outliers of any size, also those that these data lack.
const WORTH_SAFETY: f64 = -0.01;

/// What a tuning may do.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Options {
    /// Leave motion, drift and treatment of outliers as they are: numbers only.
    pub keep_structure: bool,
}

/// Why nothing can be tuned.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum TuneError {
    /// No recording has a packet.
    #[error("has no rows that the spec uses, expected measurements")]
    Empty,
    /// Nothing to turn.
    #[error(
        "`model.kind` is \"linear\", `estimator.kind` has no window and `link` no arrival rate to learn: there is no number to tune"
    )]
    Nothing,
    /// The start itself cannot be run.
    #[error("the spec to start from gives no trail on these data: {0}")]
    Start(String),
}

/// A change of structure that was tried.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tried {
    /// What.
    pub change: Change,
    /// How much it gained.
    pub gain: f64,
    /// The standard error of that, where there is truth enough to tell.
    pub error: Option<f64>,
    /// Whether it was taken.
    pub taken: bool,
}

impl Tried {
    /// The gain with its standard error, for people.
    pub fn gain_text(&self) -> String {
        match self.error {
            Some(error) => format!("{:+.3} ± {error:.3}", self.gain),
            None => format!("{:+.3}", self.gain),
        }
    }
}

/// The outcome.
#[derive(Clone, Debug)]
pub struct Tuned {
    /// The tuned spec, latencies included.
    pub spec: Spec,
    /// Merit of the spec that was given.
    pub before: Merit,
    /// Merit of the tuned one, on the same data.
    pub after: Merit,
    /// Whether truth decided.
    pub with_truth: bool,
    /// Calibration of each sensor, in the order of the spec.
    pub calibrations: Vec<Option<Calibration>>,
    /// Latency of each sensor with the root mean square errors, metres, of smoothed trails at 0.1 s less, at it and at 0.1 s more; empty
    /// without truth.
    pub latencies: Vec<Option<[f64; 3]>>,
    /// What neighbours of the numbers would lose.
    pub profiles: Vec<Profile>,
    /// By how much all standard deviations were scaled in the end, and what for; `None` without truth enough to tell.
    pub honesty: Option<(f64, Honesty)>,
    /// Windows and lags tried, of an estimator that has them.
    pub windows: Windows,
    /// How often what a receiver without time stamps shows is new.
    pub arrival: Option<Learnt>,
    /// Changes of structure tried.
    pub structures: Vec<Tried>,
    /// How many settings were run.
    pub runs: u64,
}

/// Tunes `base` on `recordings`; `progress` is told of every setting that was run.
///
/// Calibration first, where there is truth: biases and path loss from residuals at known positions. Then a compass search over the numbers,
/// and each change of structure that gains enough with its own search. Without truth the biases are those that a smoothed trail leaves, as
/// far as they make the next measurements more likely.
///
/// # Errors
/// [`TuneError`].
pub fn tune(
    base: &Spec,
    recordings: &[Recording],
    options: &Options,
    progress: &(dyn Fn(u64) + Sync),
) -> Result<Tuned, TuneError> {
    if recordings.iter().all(|r| r.targets.iter().all(|t| t.packets.is_empty())) {
        return Err(TuneError::Empty);
    }
    let unstamped = matches!(base.link.receiver, Receiver::Unstamped { .. });
    let with_truth = recordings.iter().any(|r| !r.truth.is_empty());
    let has_window = matches!(base.estimator, EstimatorSpec::Fms { .. } | EstimatorSpec::Ufir { .. });
    let arrival = if unstamped { arrival::rate(base, recordings) } else { None };
    if Place::all(base).is_empty() && !has_window && arrival.is_none() {
        return Err(TuneError::Nothing);
    }
    let runs = std::sync::atomic::AtomicU64::new(0);
    let tried = |n: u64| {
        runs.fetch_add(n, std::sync::atomic::Ordering::Relaxed);
        progress(n);
    };
    // Numbers first by the filter: a window is chosen for them afterwards.
    let mut start = base.clone();
    let modes = matches!(base.estimator, EstimatorSpec::Imm { .. });
    if (has_window || modes) && !matches!(base.model, ModelSpec::Linear(_)) {
        start.estimator = EstimatorSpec::Ekf;
    }
    if let Some(arrival) = arrival {
        start.link.arrival = Some(ArrivalSpec::Constant(arrival.rate));
    }
    let start = Setting { spec: start, shift_s: vec![0.0; base.sensors.len()] };
    let before = merit(base, recordings, &start.shift_s);
    if !before.score.is_finite() {
        return Err(TuneError::Start(reason(base, recordings)));
    }
    let mut best = Candidate::of(start, recordings);
    tried(2);
    let calibrations = if with_truth {
        calibrated(&mut best, recordings)
    } else {
        // The smoothed trail that this rests on takes every value for new.
        if !unstamped {
            self_calibrated(&mut best, recordings, &tried);
        }
        vec![None; base.sensors.len()]
    };
    let coarse = Effort { shrinks: 1, rounds: 4 };
    best = search(best.clone(), &Place::all(&best.setting.spec), recordings, coarse, &tried);
    let mut latencies = Vec::new();
    if with_truth && !unstamped {
        latencies = find_latencies(&mut best, recordings, &tried);
    }
    let mut structures = Vec::new();
    // Estimators of held values have neither another motion nor errors that last, and use every value.
    if !options.keep_structure && !unstamped {
        for change in Change::all(base) {
            // What is learnt of errors from foretold measurements alone is not told apart from motion.
            if matches!(change, Change::Drift(_)) && !with_truth {
                continue;
            }
            // Modes differ in a noise that stationary motion does not have.
            if matches!((change, base.estimator), (Change::Resident, EstimatorSpec::Imm { .. })) {
                continue;
            }
            let Some(setting) = change.apply(&best.setting, recordings) else { continue };
            let other = Candidate::of(setting, recordings);
            tried(1);
            let places = Place::all(&other.setting.spec);
            let other = search(other, &places, recordings, coarse, &tried);
            let gain = other.merit.score - best.merit.score;
            let worth = match change {
                Change::Resident | Change::Search => WORTH_A_PLACE,
                Change::Redescending => WORTH_SAFETY,
                _ => WORTH_A_CHANGE,
            };
            let error = gain_error(&other.setting.spec, &best.setting.spec, recordings, &best.setting.shift_s);
            // The simpler of two that are within a standard error.
            let sure = worth <= 0.0 || error.is_none_or(|error| gain > error);
            let taken = gain > worth && sure;
            structures.push(Tried { change, gain, error, taken });
            if taken {
                best = other;
            }
        }
    }
    let places = Place::all(&best.setting.spec);
    let fine = Effort { shrinks: 3, rounds: 12 };
    best = search(best, &places, recordings, fine, &tried);
    let profiles = profiles(&best, &places, recordings, &tried);
    let honesty = if with_truth { widen(&mut best.setting, recordings) } else { None };
    let mut spec = best.setting.spec.clone();
    if modes {
        spec.estimator = with_noise_of(base, &spec);
    }
    let mut windows = Windows::default();
    if has_window {
        spec.estimator = base.estimator;
        windows = window::choose(&mut spec, recordings, &best.setting.shift_s, &tried);
    }
    let after = merit(&spec, recordings, &best.setting.shift_s);
    for (sensor, shift_s) in spec.sensors.iter_mut().zip(&best.setting.shift_s) {
        sensor.latency_s += shift_s;
    }
    let runs = runs.into_inner();
    Ok(Tuned {
        spec,
        before,
        after,
        with_truth,
        calibrations,
        latencies,
        profiles,
        honesty,
        windows,
        arrival,
        structures,
        runs,
    })
}

/// The modes of `base`, their noise by the same factor as the model's.
fn with_noise_of(base: &Spec, tuned: &Spec) -> EstimatorSpec {
    let mut estimator = base.estimator;
    let noise = |spec: &Spec| match &spec.model {
        ModelSpec::Kinematic(m) => m.noise.first().copied(),
        ModelSpec::Turn(m) => Some(m.noise[0]),
        _ => None,
    };
    if let (EstimatorSpec::Imm { modes }, Some(before), Some(after)) = (&mut estimator, noise(base), noise(tuned)) {
        let by = if before > 0.0 { after / before } else { 1.0 };
        modes.iter_mut().flatten().for_each(|mode| mode.noise.iter_mut().for_each(|v| *v *= by));
    }
    estimator
}

/// Latencies that are tried first, seconds.
const LATENCIES: [f64; 9] = [-0.4, -0.2, 0.0, 0.1, 0.2, 0.3, 0.5, 0.8, 1.2];
/// Share of the smoothed trail's error that a latency must take away.
const WORTH_A_LATENCY: f64 = 0.02;

/// The latency of each sensor, by the smoothed trail, which has no delay of its own: the one with the least root mean square error.
fn find_latencies(best: &mut Candidate, recordings: &[Recording], tried: &dyn Fn(u64)) -> Vec<Option<[f64; 3]>> {
    let mut found = Vec::new();
    for i in 0..best.setting.shift_s.len() {
        let rmse = |at: f64| {
            let mut shift_s = best.setting.shift_s.clone();
            shift_s[i] = at;
            tried(1);
            smoothed_rmse(&best.setting.spec, recordings, &shift_s).unwrap_or(f64::INFINITY)
        };
        let now = rmse(0.0);
        let least = |candidates: &[f64], start: (f64, f64)| {
            candidates.iter().map(|at| (*at, rmse(*at))).fold(start, |a, b| if b.1 < a.1 { b } else { a })
        };
        let mut at = least(&LATENCIES, (0.0, now));
        for step in [0.1, 0.05, 0.025] {
            at = least(&[at.0 - step, at.0 + step], at);
        }
        let worth = at.1 < (1.0 - WORTH_A_LATENCY) * now;
        found.push(worth.then(|| [rmse(at.0 - 0.1), at.1, rmse(at.0 + 0.1)]));
        if worth {
            let mut setting = best.setting.clone();
            setting.shift_s[i] = at.0;
            *best = Candidate::of(setting, recordings);
        }
    }
    found
}

/// Parts that a lone recording is cut into, to judge each by what the others say.
const BLOCKS: usize = 3;

/// Each recording with the specs that are judged on it: biases and path loss are those of the other recordings, or of the other parts where
/// there is one recording only. Judged where they were calibrated, errors would look smaller than they will be elsewhere.
fn held_out<'a>(spec: &Spec, recordings: &'a [Recording]) -> Vec<Case<'a>> {
    let known: Vec<&Recording> = recordings.iter().filter(|r| !r.truth.is_empty()).collect();
    if let [recording] = known[..] {
        return vec![(recording, blocks(spec, recording))];
    }
    let by_others = |judged: usize| {
        let others: Vec<Recording> =
            known.iter().enumerate().filter(|(i, _)| *i != judged).map(|(_, r)| (*r).clone()).collect();
        recalibrated(spec, &others)
    };
    known.iter().enumerate().map(|(i, r)| (*r, vec![(by_others(i), r.truth.clone())])).collect()
}

/// The parts of a recording, each with the spec that the others calibrate.
fn blocks(spec: &Spec, recording: &Recording) -> Vec<(Spec, Vec<TargetTruth>)> {
    let times = || recording.truth.iter().flat_map(|t| t.points.iter().map(|p| p.t_s));
    let (first, last) = (times().fold(f64::INFINITY, f64::min), times().fold(f64::NEG_INFINITY, f64::max));
    let block = |t_s: f64| (((t_s - first) / (last - first) * BLOCKS as f64) as usize).min(BLOCKS - 1);
    let truth = |keep: &dyn Fn(usize) -> bool| -> Vec<TargetTruth> {
        let some = |t: &TargetTruth| {
            let points = t.points.iter().filter(|p| keep(block(p.t_s))).copied().collect();
            TargetTruth { target: t.target.clone(), points }
        };
        recording.truth.iter().map(some).collect()
    };
    let one = |judged: usize| {
        let others = Recording { truth: truth(&|b| b != judged), ..recording.clone() };
        (recalibrated(spec, &[others]), truth(&|b| b == judged))
    };
    (0..BLOCKS).map(one).collect()
}

/// The spec with the biases and path loss of `recordings`, where they have enough to tell.
fn recalibrated(spec: &Spec, recordings: &[Recording]) -> Spec {
    let mut out = spec.clone();
    for i in 0..out.sensors.len() {
        if let Some(calibration) = calibrate(spec, i, recordings) {
            put(&mut out.sensors[i], &calibration);
        }
    }
    out
}

/// Puts biases and path loss into a sensor.
fn put(sensor: &mut SensorSpec, calibration: &Calibration) {
    sensor.bias = calibration.bias.iter().map(|(anchor, b)| (anchor.clone(), b.value)).collect();
    if let (Some([exponent, level]), Some(law)) = (calibration.path_loss, &mut sensor.path_loss) {
        (law.exponent, law.at_1m_dbm) = (exponent.value, level.value);
    }
}

/// Scales all noise, of motion and of sensors, so that the 95 % ellipse holds 95 % of known positions that sensors were not calibrated at: a share
/// more for what so few independent errors leave open, Student's quantile over the normal's, or as much as the recording asks for, or part of a lone
/// one, where it holds least. The gains, and so the trail, stay as they are.
fn widen(setting: &mut Setting, recordings: &[Recording]) -> Option<(f64, Honesty)> {
    let found = honesty(&held_out(&setting.spec, recordings), &setting.shift_s)?;
    let dof = (found.independent - 1.0).max(1.0);
    let few = found.scale * student_quantile(dof, 0.975) / student_quantile(f64::INFINITY, 0.975);
    let scale = few.max(found.worst).clamp(0.5, 5.0);
    let prior = match &mut setting.spec.model {
        ModelSpec::Kinematic(m) => {
            m.noise.iter_mut().for_each(|v| *v *= scale * scale);
            &mut m.prior
        }
        ModelSpec::Turn(m) => {
            m.noise.iter_mut().for_each(|v| *v *= scale * scale);
            m.turn_noise *= scale * scale;
            &mut m.prior
        }
        ModelSpec::GaussMarkov(m) => {
            m.spread_m.iter_mut().chain(&mut m.speed_mps).for_each(|v| *v *= scale);
            &mut m.prior
        }
        // It has no known positions.
        ModelSpec::Linear(_) => return None,
    };
    // The start would weigh more beside noise that has grown.
    prior.iter_mut().flat_map(|prior| &mut prior.cov.data).for_each(|v| *v *= scale * scale);
    for sensor in &mut setting.spec.sensors {
        sensor.sd *= scale;
        sensor.drift.iter_mut().flat_map(|drift| drift.all_mut()).for_each(|lasting| lasting.sd *= scale);
        sensor.robust = match sensor.robust {
            Robust::None => Robust::None,
            Robust::Gate(gate) => Robust::Gate(gate / (scale * scale)),
            Robust::Huber(c) => Robust::Huber(c / scale),
            Robust::Redescending(c) => Robust::Redescending(c / scale),
        };
    }
    Some((scale, found))
}

/// Why a spec does not run.
fn reason(spec: &Spec, recordings: &[Recording]) -> String {
    for recording in recordings {
        for target in &recording.targets {
            if let Err(error) = track(spec, &recording.anchors, target, LaggedMode::Own) {
                return format!("{}: {error}", recording.name);
            }
        }
    }
    "truth and measurements have no target or no time in common".to_owned()
}

/// Biases and path loss at known positions, and the noise they leave.
fn calibrated(best: &mut Candidate, recordings: &[Recording]) -> Vec<Option<Calibration>> {
    let mut setting = best.setting.clone();
    let height_m = calibrate::height(recordings);
    let planar = fixtrail_track::registry::layout(&setting.spec).axes == 2;
    for sensor in
        setting.spec.sensors.iter_mut().filter(|s| planar && matches!(s.kind, Kind::Range | Kind::Rssi | Kind::Tdoa))
    {
        sensor.height_m = height_m.or(sensor.height_m);
    }
    let spec = &setting.spec;
    let all: Vec<Option<Calibration>> = (0..spec.sensors.len()).map(|i| calibrate(spec, i, recordings)).collect();
    for (sensor, calibration) in setting.spec.sensors.iter_mut().zip(&all) {
        let Some(calibration) = calibration else { continue };
        put(sensor, calibration);
        if calibration.sd > 0.0 {
            sensor.sd = calibration.sd;
        }
    }
    *best = Candidate::of(setting, recordings);
    all
}

/// Most rounds of calibration by a smoothed trail.
const MOST_ROUNDS: usize = 6;

/// Biases that a smoothed trail leaves in the ranges, round by round as long as the next measurements become more likely.
fn self_calibrated(best: &mut Candidate, recordings: &[Recording], tried: &dyn Fn(u64)) {
    if !best.setting.spec.sensors.iter().any(|s| s.kind == Kind::Range) {
        return;
    }
    for _ in 0..MOST_ROUNDS {
        let Some(pretended) = smoothed(&best.setting.spec, recordings) else { return };
        let mut setting = best.setting.clone();
        for i in 0..setting.spec.sensors.len() {
            if setting.spec.sensors[i].kind != Kind::Range {
                continue;
            }
            let Some(calibration) = calibrate(&best.setting.spec, i, &pretended) else { continue };
            setting.spec.sensors[i].bias = calibration.bias.into_iter().map(|(a, b)| (a, b.value)).collect();
        }
        let next = Candidate::of(setting, recordings);
        tried(2);
        if next.merit.score <= best.merit.score + 1e-3 {
            return;
        }
        *best = next;
    }
}

/// The recordings with their smoothed trails for truth.
fn smoothed(spec: &Spec, recordings: &[Recording]) -> Option<Vec<Recording>> {
    let spec = Spec { estimator: EstimatorSpec::Rts, ..spec.clone() };
    let axes = fixtrail_track::registry::layout(&spec).axes;
    let mut out = Vec::new();
    for recording in recordings {
        let mut truth = Vec::new();
        for target in &recording.targets {
            let trail = track(&spec, &recording.anchors, target, LaggedMode::Own).ok()?.trail;
            let point = |row: usize| {
                let (t_s, mean) = (trail.t_s[row]?, trail.mean(row)?);
                Some(TruthPoint { t_s, position_m: core::array::from_fn(|i| (i < axes).then(|| mean[i])) })
            };
            truth.push(TargetTruth {
                target: target.target.clone(),
                points: (0..trail.len()).filter_map(point).collect(),
            });
        }
        out.push(Recording { truth, ..recording.clone() });
    }
    Some(out)
}
