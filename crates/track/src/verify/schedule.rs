//! `scheduler`: closed loops of filter and sensor scheduling, decision by decision.

use super::json::Json;
use super::{Comparison, Quantity, Scale};
use crate::anchors::Anchors;
use crate::closed_loop::{Accuracy, ClosedLoop, Taken, World};
use crate::error::BuildError;
use crate::packet::Kind;
use crate::spec::{
    ArrivalSpec, Duplicates, EmvfVariant, EstimatorSpec, Hold, LinkSpec, ModelSpec, Prior, Receiver, Robust,
    ScheduleSpec, SensorSpec, Shows, Spec, TurnSpec,
};
use fixtrail_core::Vector;
use fixtrail_core::models::CoordinatedTurn;
use fixtrail_core::schedule::{Choice, Mode, Radio};
use std::collections::BTreeMap;

/// The file's world: a target that turns without noise, and the noise of every measurement written down.
struct Field<'a> {
    sensors: Vec<[f64; 2]>,
    truth: Vector<5>,
    t_s: f64,
    turn: CoordinatedTurn,
    sd: f64,
    noise: &'a [f64],
    came: &'a [f64],
    failures: &'a [(u64, usize)],
}

impl Field<'_> {
    /// Moves the target to `t_s`.
    fn advance(&mut self, t_s: f64) {
        self.truth = self.turn.leap(&self.truth, t_s - self.t_s).next;
        self.t_s = t_s;
    }
}

impl World for Field<'_> {
    fn measure(&mut self, k: u64, t_s: f64, sensor: usize) -> f64 {
        self.advance(t_s);
        let [x, y] = self.sensors[sensor];
        let noise = self.noise.get(k as usize).copied().unwrap_or(f64::NAN);
        (self.truth[0] - x).hypot(self.truth[1] - y) + self.sd * noise
    }

    fn arrives(&mut self, k: u64) -> bool {
        self.came.get(k as usize).is_some_and(|came| *came != 0.0)
    }

    fn failed(&mut self, k: u64) -> Vec<usize> {
        self.failures.iter().filter(|(at, _)| *at == k).map(|(_, sensor)| *sensor).collect()
    }
}

/// Quantities of a step that are numbers, by the file's names.
const KEYS: [&str; 9] = ["t", "dt", "E", "phi", "residual_mJ", "z", "truth_xy", "xhat", "P"];

pub(super) fn closed_loops(root: &Json<'_>) -> Result<Vec<Quantity>, BuildError> {
    let inputs = root.get("inputs")?;
    let tolerance = root.get("tolerance")?;
    let (abs, rel) = (tolerance.get("abs")?.number()?, tolerance.get("rel")?.number()?);
    let compare = |name: &str| Comparison::new(name, Scale::Mixed { floor: abs / rel }, rel);

    let spec = spec(&inputs)?;
    let schedule = schedule(&inputs)?;
    let point = |at: &Json<'_>| match at.numbers()?.as_slice() {
        [x, y] => Ok([*x, *y]),
        other => Err(at.fail(format!("has {} coordinates, expected 2", other.len()))),
    };
    let sensors: Vec<[f64; 2]> = inputs.get("sensors")?.list()?.iter().map(point).collect::<Result<_, _>>()?;
    let mut anchors = Anchors::default();
    for (i, [x, y]) in sensors.iter().enumerate() {
        anchors.add(&i.to_string(), [*x, *y, 0.0]);
    }
    let truth = inputs.get("truth0")?.numbers()?;
    if truth.len() != 5 || schedule.failures.iter().any(|(_, sensor)| *sensor >= sensors.len()) {
        return Err(inputs.fail("has a truth or failures that do not fit"));
    }
    let (noise, came) = (inputs.get("v")?.numbers()?, inputs.get("gamma")?.numbers()?);
    let mut world = Field {
        sensors,
        truth: Vector::from_fn(|i, _| truth[i]),
        t_s: 0.0,
        turn: CoordinatedTurn::new([0.0; 2], 0.0).map_err(|e| inputs.fail(e.to_string()))?,
        sd: inputs.get("R")?.number()?.sqrt(),
        noise: &noise,
        came: &came,
        failures: &schedule.failures,
    };
    let mut run = ClosedLoop::new(&spec, &schedule, &anchors, Shows::Paper, &mut world)?;

    let expected = root.get("expected")?;
    let steps = expected.get("steps")?.list()?;
    let mut numbers = KEYS.map(compare);
    // Decisions are compared as numbers too: where one differs the deviation is far beyond any tolerance.
    let mut decisions = compare("decisions");
    let mut candidates = compare("candidates");
    let mut taken = 0;
    for step in &steps {
        let advanced = run.advance(&mut world).map_err(|e| step.fail(e.to_string()))?;
        let Some(ours) = advanced else { break };
        world.advance(ours.t_s);
        taken += 1;
        let residual: Vec<f64> = run.scheduler().sensors().iter().map(|s| s.residual_mj).collect();
        let values = |key: &str| -> Option<Vec<f64>> {
            Some(match key {
                "t" => vec![ours.t_s],
                "dt" => vec![ours.plan.interval_s],
                "E" => vec![ours.plan.chosen.map_or(0.0, |c| c.energy_mj)],
                "phi" => vec![run.accuracy()],
                "residual_mJ" => residual.iter().copied().filter(|v| v.is_finite()).collect(),
                "z" => vec![ours.measured_m?],
                "truth_xy" => vec![world.truth[0], world.truth[1]],
                "xhat" => ours.mean.clone(),
                _ => ours.cov.clone(),
            })
        };
        for (key, numbers) in KEYS.iter().zip(&mut numbers) {
            let theirs = step.optional(if *key == "phi" { "phi_posterior" } else { key });
            let theirs = theirs.map(|at| super::mvf::flat_known(&at)).transpose()?.filter(|v| !v.is_empty());
            let ours = values(key).filter(|v| !v.is_empty());
            numbers.add_optional(ours.as_deref(), theirs.as_deref());
        }
        decisions.add(&decided(&ours, run.scheduler().group()), &decided_by(step)?);
        candidates.add(&foreseen(&ours), &foreseen_by(step)?);
    }
    // Where nobody counts energy there is none left to compare.
    let counted = !schedule.residual_mj.is_empty();
    let numbers = KEYS.iter().zip(numbers).filter(|(key, _)| counted || **key != "residual_mJ").map(|(_, found)| found);
    let mut out: Vec<Quantity> = numbers.chain([decisions, candidates]).map(Comparison::done).collect();
    let mut totals = compare("totals");
    totals.add(
        &[taken as f64, run.scheduler().spent_mj()],
        &[expected.get("n_steps")?.number()?, expected.get("total_energy_mJ")?.number()?],
    );
    // The run is over where the file's is.
    let over = run.advance(&mut world).map_err(|e| expected.fail(e.to_string()))?.is_none();
    totals.add(&[f64::from(u8::from(over))], &[1.0]);
    out.push(totals.done());
    Ok(out)
}

/// Mode, sensor, hand-off, the sensor before and the group.
fn decided(taken: &Taken, group: &[usize]) -> Vec<f64> {
    let mode = match taken.plan.mode {
        Mode::Satisfied => 0.0,
        Mode::Weighed => 1.0,
        Mode::Coasting => 2.0,
    };
    let sensor = taken.plan.chosen.map_or(-1.0, |c| c.sensor as f64);
    let mut out = vec![mode, sensor, f64::from(u8::from(taken.plan.handoff)), taken.from as f64];
    out.extend(group.iter().map(|i| *i as f64));
    out
}

fn decided_by(step: &Json<'_>) -> Result<Vec<f64>, BuildError> {
    let mode = step.get("mode")?;
    let mode = match mode.text()? {
        "satisfied" => 0.0,
        "fallback" => 1.0,
        "coast" => 2.0,
        other => return Err(mode.fail(format!("is {other:?}, expected satisfied, fallback or coast"))),
    };
    let handoff = step.get("handoff")?.value.as_bool().unwrap_or(false);
    let mut out = vec![mode, step.get("j")?.number()?, f64::from(u8::from(handoff)), step.get("from_node")?.number()?];
    out.extend(step.get("group")?.numbers()?);
    Ok(out)
}

fn foreseen(taken: &Taken) -> Vec<f64> {
    let each = taken.candidates.iter();
    each.flat_map(|c| [c.interval_s, c.rank as f64, c.sensor as f64, c.accuracy, c.energy_mj]).collect()
}

fn foreseen_by(step: &Json<'_>) -> Result<Vec<f64>, BuildError> {
    let mut out = Vec::new();
    for candidate in step.get("candidates")?.list()? {
        for key in ["T", "rank", "j", "phi", "E"] {
            out.push(candidate.get(key)?.number()?);
        }
    }
    Ok(out)
}

/// Model, sensor, estimator and link of the file.
fn spec(inputs: &Json<'_>) -> Result<Spec, BuildError> {
    let kind = inputs.get("estimator")?;
    let arrival = Some(ArrivalSpec::Constant(inputs.get("p_assumed")?.number()?));
    let (estimator, link) = match kind.text()? {
        "EKF_SKIP" => (EstimatorSpec::Ekf, LinkSpec::default()),
        "EMVF_M2" => (
            EstimatorSpec::Emvf { variant: EmvfVariant::Model2, range_mixture: false },
            LinkSpec { receiver: Receiver::Unstamped { hold: Hold::Paper }, arrival, duplicates: Duplicates::Keep },
        ),
        other => return Err(kind.fail(format!("is {other:?}, expected EKF_SKIP or EMVF_M2"))),
    };
    let prior = Prior {
        mean: inputs.get("m0")?.numbers()?,
        cov: inputs.get("P0")?.shaped(5, 5)?,
        second_moment: Some(inputs.get("S0")?.shaped(5, 5)?),
    };
    if prior.mean.len() != 5 {
        return Err(inputs.fail("has an m0 that is not of 5 entries"));
    }
    let sensor = SensorSpec {
        kind: Kind::Range,
        sd: inputs.get("R")?.number()?.sqrt(),
        path_loss: None,
        bias: BTreeMap::new(),
        drift: None,
        height_m: None,
        latency_s: 0.0,
        robust: Robust::None,
    };
    Ok(Spec {
        model: ModelSpec::Turn(TurnSpec {
            noise: [0.0; 2],
            turn_noise: inputs.get("W44")?.number()?,
            per_step: Some(0),
            prior: Some(prior),
        }),
        estimator,
        link,
        sensors: vec![sensor],
        columns: BTreeMap::new(),
        anchors: None,
        side_m: None,
    })
}

fn schedule(inputs: &Json<'_>) -> Result<ScheduleSpec, BuildError> {
    let number = |key: &str| inputs.get(key)?.number();
    let energy = inputs.get("energy")?;
    let part = |key: &str| energy.get(key)?.number();
    let accuracy = inputs.get("accuracy")?;
    let failure = |pair: &Json<'_>| match pair.list()?.as_slice() {
        // The file counts decisions from 0, and decision 0 leads to instant 1.
        [decision, sensor] => Ok((decision.count()? as u64 + 1, sensor.count()?)),
        other => Err(pair.fail(format!("has {} entries, expected 2", other.len()))),
    };
    Ok(ScheduleSpec {
        choice: Choice::Cost { enough: number("phi0")?, weight: number("w")? },
        intervals_s: inputs.get("T_set")?.numbers()?,
        group: inputs.get("M")?.count()?,
        range_m: number("r_sense")?,
        accuracy: match accuracy.text()? {
            "sum" => Accuracy::Sum,
            "trace" => Accuracy::Trace,
            other => return Err(accuracy.fail(format!("is {other:?}, expected sum or trace"))),
        },
        duration_s: number("T_end")?,
        residual_mj: inputs.optional("residual_mJ").map_or_else(|| Ok(Vec::new()), |at| at.numbers())?,
        radio: Radio {
            sense_mj_per_bit: part("es")?,
            receive_mj_per_bit: part("er")?,
            send_mj_per_bit: part("et")?,
            amplify_mj_per_bit: part("ed")?,
            path_exponent: part("alpha")?,
            sensed_bits: part("bs")?,
            sent_bits: part("bc")?,
            free_self: energy.get("free_self")?.value.as_bool().unwrap_or(false),
        },
        failures: inputs.get("failures")?.list()?.iter().map(failure).collect::<Result<_, _>>()?,
    })
}
