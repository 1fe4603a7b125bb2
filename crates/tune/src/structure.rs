//! What a spec may become besides other numbers: another motion, drifting errors, another treatment of outliers.

use crate::knobs::Setting;
use crate::merit::Recording;
use fixtrail_track::packet::Kind;
use fixtrail_track::spec::{DriftSpec, GaussMarkovSpec, Lasting, MAX_STATE, ModelSpec, Prior, Robust, Spec};

/// One change of structure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Change {
    /// Stationary motion about the place of anchors and truth.
    Resident,
    /// A start that is looked for in the data instead of a prior that says no more than the place.
    Search,
    /// Errors of each anchor that last, of the sensor at that place in the spec.
    Drift(usize),
    /// Huber's weight on all sensors.
    Huber,
    /// The biweight on all sensors.
    Redescending,
}

impl Change {
    /// All, in the order in which they are tried.
    pub fn all(spec: &Spec) -> Vec<Change> {
        let mut out = Vec::new();
        let drifting = |kind: Kind| matches!(kind, Kind::Range | Kind::Rssi);
        // Outliers first: they would pass for motion or for errors that last.
        out.extend([Change::Redescending, Change::Huber]);
        out.extend((0..spec.sensors.len()).filter(|i| drifting(spec.sensors[*i].kind)).map(Change::Drift));
        out.extend([Change::Resident, Change::Search]);
        out
    }

    /// How the change is called in messages.
    pub fn name(self) -> &'static str {
        match self {
            Change::Resident => "stationary motion (`gauss-markov`)",
            Change::Search => "the start searched in the data (no `x0`)",
            Change::Drift(_) => "errors that last (`drift`)",
            Change::Huber => "`robust = \"huber\"`",
            Change::Redescending => "`robust = \"redescending\"`",
        }
    }

    /// The setting with the change; `None` where it makes no sense or is there already.
    pub fn apply(self, setting: &Setting, recordings: &[Recording]) -> Option<Setting> {
        let mut out = setting.clone();
        match self {
            Change::Resident => out.spec.model = ModelSpec::GaussMarkov(resident(&setting.spec, recordings)?),
            Change::Search => {
                let ModelSpec::GaussMarkov(model) = &mut out.spec.model else { return None };
                let prior = model.prior.take();
                prior.filter(|p| is_vague(p, model))?;
            }
            Change::Drift(i) => {
                let sensor = &mut out.spec.sensors[i];
                let drift = sensor.drift.get_or_insert(DriftSpec { each: None, shared: None });
                if drift.each.is_some() {
                    return None;
                }
                // Half of the error's variance lasts.
                sensor.sd *= 0.5f64.sqrt();
                drift.each = Some(Lasting { sd: sensor.sd, time_s: 30.0 });
                if states(&out.spec, recordings) > MAX_STATE {
                    return None;
                }
            }
            Change::Huber => robust(&mut out.spec, Robust::Huber(1.345))?,
            Change::Redescending => robust(&mut out.spec, Robust::Redescending(4.685))?,
        }
        Some(out)
    }
}

fn robust(spec: &mut Spec, robust: Robust) -> Option<()> {
    let same = |r: Robust| core::mem::discriminant(&r) == core::mem::discriminant(&robust);
    if spec.sensors.iter().all(|s| same(s.robust)) {
        return None;
    }
    spec.sensors.iter_mut().for_each(|s| s.robust = robust);
    Some(())
}

/// Number of states, errors that last included.
fn states(spec: &Spec, recordings: &[Recording]) -> usize {
    let anchors = recordings.iter().map(|r| r.anchors.len()).max().unwrap_or(0);
    let errors = |drift: DriftSpec| drift.each.map_or(0, |_| anchors) + drift.shared.map_or(0, |_| 1);
    let lasting: usize = spec.sensors.iter().filter_map(|s| s.drift).map(errors).sum();
    fixtrail_track::registry::layout(spec).n() + lasting
}

/// Share of the place from which on a prior of the start says nothing that the place does not.
const VAGUE: f64 = 0.5;

/// Whether the prior of a stationary target says no more of its start than its place does.
fn is_vague(prior: &Prior, model: &GaussMarkovSpec) -> bool {
    (0..model.axes).all(|i| prior.cov.at(i, i).sqrt() >= VAGUE * model.spread_m[i])
}

/// Stationary motion about the middle of the box of anchors and known positions, as wide as a uniform distribution over it.
fn resident(spec: &Spec, recordings: &[Recording]) -> Option<GaussMarkovSpec> {
    let ModelSpec::Kinematic(model) = &spec.model else { return None };
    if model.order != 2 {
        return None;
    }
    let axes = model.axes;
    let mut bounds = [[f64::INFINITY, f64::NEG_INFINITY]; 3];
    let mut take = |axis: usize, v: f64| bounds[axis] = [bounds[axis][0].min(v), bounds[axis][1].max(v)];
    let mut speeds = Vec::new();
    for recording in recordings {
        for id in 0..recording.anchors.len() as u32 {
            let at = recording.anchors.position_m(id);
            (0..axes).for_each(|axis| take(axis, at[axis]));
        }
        for truth in &recording.truth {
            for point in &truth.points {
                (0..axes)
                    .filter_map(|axis| point.position_m[axis].map(|v| (axis, v)))
                    .for_each(|(axis, v)| take(axis, v));
            }
            for pair in truth.points.windows(2) {
                let dt_s = pair[1].t_s - pair[0].t_s;
                let step = (0..axes.min(2)).map(|axis| Some(pair[1].position_m[axis]? - pair[0].position_m[axis]?));
                let step: Option<Vec<f64>> = step.collect();
                if let Some(step) = step.filter(|_| dt_s > 0.0 && dt_s < 2.0) {
                    speeds.push(step.iter().map(|s| s * s).sum::<f64>() / (dt_s * dt_s));
                }
            }
        }
    }
    if !bounds[..axes].iter().all(|[least, most]| most > least) {
        return None;
    }
    let half: Vec<f64> = bounds[..axes].iter().map(|[least, most]| 0.5 * (most - least)).collect();
    // A box without depth, anchors along a wall, still leaves room to move in.
    let widest = half.iter().copied().fold(0.0, f64::max);
    let spread: Vec<f64> = half.iter().map(|h| (h / 3f64.sqrt()).max(0.1 * widest)).collect();
    let mean_square = speeds.iter().sum::<f64>() / speeds.len().max(1) as f64;
    let speed = if mean_square > 0.0 { (0.5 * mean_square).sqrt() } else { 0.5 };
    let speed = speed.clamp(1e-3 * widest, widest).max(1e-6);
    Some(GaussMarkovSpec {
        axes,
        centre_m: bounds[..axes].iter().map(|[least, most]| 0.5 * (least + most)).collect(),
        spread_m: spread,
        speed_mps: vec![speed; axes],
        prior: model.prior.clone(),
    })
}
