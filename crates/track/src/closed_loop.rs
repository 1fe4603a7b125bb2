//! A target tracked by sensors that are chosen as it goes: the one arrow that leads back, from the filter to what is measured next.
//!
//! ```text
//!            ┌──────── Plan {sensor, interval} ◄──── Scheduler ◄──── forecasts ───┐
//!            ▼                                                                    │
//!   World: measures, loses ──► what the receiver shows ──► Tracker ──► estimate ──┘
//! ```

use crate::anchors::Anchors;
use crate::error::{BuildError, StepError};
use crate::fix::{Fix, Sink};
use crate::packet::{AnchorId, Content, Packet};
use crate::registry::{self, BuildOptions};
use crate::simulator::Simulator;
use crate::spec::{ArrivalSpec, Duplicates, EstimatorSpec, Receiver, ScheduleSpec, Shows, Spec};
use crate::tracker::{Step, Tracker};
use fixtrail_core::schedule::{Battery, Candidate, Foresight, Plan, Scheduler};

/// What of an estimate a schedule calls its accuracy.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Accuracy {
    /// `trace`: `P_11 + P_22`, the mean square of the position error, m².
    Trace,
    /// `sum`: `P_11 + P_22 + 2 P_12`, the variance of x + y, which is what the paper's `[1 1 0 0 0] P [1 1 0 0 0]ᵀ` is. It depends on where
    /// north is.
    Sum,
}

impl Accuracy {
    /// φ of a covariance, n × n.
    pub fn of(self, cov: &[f64], n: usize) -> f64 {
        match self {
            Accuracy::Trace => cov[0] + cov[n + 1],
            Accuracy::Sum => cov[0] + cov[n + 1] + 2.0 * cov[1],
        }
    }
}

/// The world that sensors are in.
pub trait World {
    /// The range that `sensor` measures at instant `k`, `t_s` seconds from the start; what was measured before is never asked again.
    fn measure(&mut self, k: u64, t_s: f64, sensor: usize) -> f64;

    /// Whether the measurement of instant `k` arrives.
    fn arrives(&mut self, k: u64) -> bool;

    /// The sensors that have failed before the decision that leads to instant `k`.
    fn failed(&mut self, k: u64) -> Vec<usize>;
}

/// What happened from one decision to the next.
#[derive(Clone, Debug, PartialEq)]
pub struct Taken {
    /// Index of the instant, from 1.
    pub k: u64,
    /// Seconds from the start.
    pub t_s: f64,
    /// The sensor in charge before.
    pub from: usize,
    /// The decision.
    pub plan: Plan,
    /// Every candidate, by interval and then by distance.
    pub candidates: Vec<Candidate>,
    /// What was measured.
    pub measured_m: Option<f64>,
    /// Whether it arrived.
    pub arrived: bool,
    /// Mean of the state.
    pub mean: Vec<f64>,
    /// Its covariance, n × n.
    pub cov: Vec<f64>,
    /// Normalised innovation squared and its degrees of freedom.
    pub nis: Option<(f64, u32)>,
}

/// The newest estimate.
#[derive(Clone, Default)]
struct Newest {
    mean: Vec<f64>,
    cov: Vec<f64>,
    nis: Option<(f64, u32)>,
}

impl Sink for Newest {
    fn fix(&mut self, fix: &Fix<'_>) {
        if let Some(estimate) = fix.estimate {
            self.mean = estimate.mean.to_vec();
            self.cov = estimate.cov.to_vec();
            self.nis = fix.nis.filter(|_| fix.nis_dof > 0).map(|nis| (nis, fix.nis_dof));
        }
    }
}

/// Values that a receiver without time stamps may show.
struct Holding {
    shows: Shows,
    /// The two measurements before, the newest first, and whether they arrived.
    before: [(f64, bool); 2],
    /// The last that arrived.
    last: f64,
    /// What was shown last.
    shown: f64,
    /// Whether a value that is shown once more counts as lost.
    detects: bool,
}

impl Holding {
    /// Takes a measurement and says what is shown; `None` of what counts as lost.
    fn show(&mut self, measured: f64, arrived: bool) -> Option<f64> {
        let before = self.shown;
        self.shown = self.holds(measured, arrived);
        (!self.detects || self.shown.to_bits() != before.to_bits()).then_some(self.shown)
    }

    fn holds(&mut self, measured: f64, arrived: bool) -> f64 {
        let [(one, one_arrived), (two, _)] = self.before;
        self.before = [(measured, arrived), (one, one_arrived)];
        if arrived {
            self.last = measured;
            return measured;
        }
        match self.shows {
            Shows::LastReceived => self.last,
            Shows::Zero => 0.0,
            _ if one_arrived => one,
            Shows::Model1 => 0.0,
            Shows::Paper => two,
        }
    }
}

/// One target, its filter and the sensors around it.
pub struct ClosedLoop {
    tracker: Box<dyn Tracker>,
    simulator: Box<dyn Simulator>,
    scheduler: Scheduler<Box<[Battery]>>,
    accuracy: Accuracy,
    duration_s: f64,
    /// What is shown where the receiver knows nothing of losses.
    holding: Option<Holding>,
    arrival: f64,
    k: u64,
    t_s: f64,
    newest: Newest,
}

impl ClosedLoop {
    /// A target at its prior: the nearest sensor measures it at instant 0, and the estimate there is the prior.
    ///
    /// # Errors
    /// [`BuildError`] when the spec has no prior, its estimator cannot foretell its covariance, or the schedule suits the field not.
    pub fn new(
        spec: &Spec,
        schedule: &ScheduleSpec,
        anchors: &Anchors,
        shows: Shows,
        world: &mut dyn World,
    ) -> Result<ClosedLoop, BuildError> {
        let fail = |key: &str, what: &str| BuildError::new("spec", None, Some(key), what.to_owned());
        if !foretells(&spec.estimator) {
            let what = format!(
                "is {:?}, whose covariance depends on what will be measured, expected `ekf`, `emvf` or `lmmse` under a schedule",
                spec.estimator.name()
            );
            return Err(fail("estimator.kind", &what));
        }
        let simulator = registry::simulator(spec, anchors)?;
        let prior =
            spec.model.prior().ok_or_else(|| fail("model.x0", "is missing, expected where the target starts"))?;
        let [x, y] = [prior.mean[0], prior.mean[1]];
        let sensors: Box<[Battery]> = (0..anchors.len() as u32)
            .map(|id| {
                let [x, y, _] = anchors.position_m(id);
                Battery { position_m: [x, y], residual_mj: schedule.residual_of(id as usize), alive: true }
            })
            .collect();
        let scheduler = Scheduler::new(sensors, schedule.radio, &schedule.policy(), [x, y])
            .map_err(|e| fail("schedule", &e.to_string()))?;
        let arrival = match (&spec.link.arrival, spec.link.receiver) {
            (Some(ArrivalSpec::Constant(p)), _) => *p,
            (None, Receiver::Stamped { .. }) => 1.0,
            _ => return Err(fail("link.arrival", "is not one number, expected one under a schedule")),
        };
        let mut tracker = registry::build(spec, anchors, &BuildOptions::default())?;
        let task = scheduler.task() as AnchorId;
        let measured = world.measure(0, 0.0, scheduler.task());
        let holding = match spec.link.receiver {
            Receiver::Stamped { .. } => None,
            Receiver::Unstamped { .. } => {
                let detects = spec.link.duplicates == Duplicates::Detect;
                Some(Holding {
                    shows,
                    before: [(measured, true), (measured, true)],
                    last: measured,
                    shown: measured,
                    detects,
                })
            }
        };
        // The prior stands at instant 0 with its measurement in it: nothing is told there, but for filters that may be shown it again.
        let content = if matches!(spec.estimator, EstimatorSpec::Emvf { .. } | EstimatorSpec::Lmmse) {
            Content::Range { anchor: task, value_m: measured }
        } else {
            Content::Position([None; 3])
        };
        let mut newest = Newest::default();
        let packet = packet(0, 0.0, content);
        tracker
            .step(&Step::new(0, Some(0.0), std::slice::from_ref(&packet)), &mut newest)
            .map_err(|e| fail("model", &e.to_string()))?;
        Ok(ClosedLoop {
            tracker,
            simulator,
            scheduler,
            accuracy: schedule.accuracy,
            duration_s: schedule.duration_s,
            holding,
            arrival,
            k: 0,
            t_s: 0.0,
            newest,
        })
    }

    /// The scheduler: energy spent and left.
    pub fn scheduler(&self) -> &Scheduler<Box<[Battery]>> {
        &self.scheduler
    }

    /// φ of the newest estimate.
    pub fn accuracy(&self) -> f64 {
        self.accuracy.of(&self.newest.cov, self.simulator.n())
    }

    /// Decides, measures and updates once; `None` when the time is over.
    ///
    /// # Errors
    /// [`StepError`] of the filter.
    pub fn advance(&mut self, world: &mut dyn World) -> Result<Option<Taken>, StepError> {
        // A nanosecond of slack: the time is a sum of decimal numbers.
        if self.t_s >= self.duration_s - 1e-9 {
            return Ok(None);
        }
        let k = self.k + 1;
        for sensor in world.failed(k) {
            self.scheduler.fail(sensor);
        }
        let now_m = [self.newest.mean[0], self.newest.mean[1]];
        let mut candidates = Vec::new();
        let mut foresight = Forecasts {
            tracker: &*self.tracker,
            simulator: &*self.simulator,
            from: &self.newest,
            accuracy: self.accuracy,
            arrival: self.arrival,
            k,
            t_s: self.t_s,
            ahead: None,
        };
        let plan = self.scheduler.plan(now_m, &mut foresight, |c| candidates.push(*c))?;
        let t_s = self.t_s + plan.interval_s;
        let from = self.scheduler.task();

        let chosen = plan.chosen.map(|c| (c.sensor, world.measure(k, t_s, c.sensor), world.arrives(k)));
        // While coasting the slot is the sensor's in charge, and stays empty.
        let sensor = chosen.map_or(from, |(sensor, ..)| sensor) as AnchorId;
        let shown = match (&mut self.holding, chosen) {
            (Some(holding), Some((_, measured, arrived))) => holding.show(measured, arrived),
            (None, Some((_, measured, true))) => Some(measured),
            _ => None,
        };
        let slot = packet(k, t_s, Content::Range { anchor: sensor, value_m: shown.unwrap_or(0.0) });
        let held = std::slice::from_ref(&slot);
        let step = Step {
            k,
            t_s: Some(t_s),
            packets: if shown.is_some() { held } else { &[] },
            held: if self.holding.is_some() || shown.is_some() { held } else { &[] },
            arrival: self.arrival,
        };
        let mut newest = Newest::default();
        self.tracker.step(&step, &mut newest)?;
        self.scheduler.settle(&plan);
        (self.k, self.t_s, self.newest) = (k, t_s, newest.clone());
        Ok(Some(Taken {
            k,
            t_s,
            from,
            plan,
            candidates,
            measured_m: chosen.map(|(_, measured, _)| measured),
            arrived: chosen.is_some_and(|(.., arrived)| arrived),
            mean: newest.mean,
            cov: newest.cov,
            nis: newest.nis,
        }))
    }
}

/// Whether an estimator's covariance at the next instant is known before the measurement is.
fn foretells(estimator: &EstimatorSpec) -> bool {
    matches!(estimator, EstimatorSpec::Kalman | EstimatorSpec::Ekf | EstimatorSpec::Emvf { .. } | EstimatorSpec::Lmmse)
}

fn packet(k: u64, t_s: f64, content: Content) -> Packet {
    Packet::new(t_s, content, k + 1)
}

/// Forecasts by a copy of the filter that is fed with what it expects to be measured.
struct Forecasts<'a> {
    tracker: &'a dyn Tracker,
    simulator: &'a dyn Simulator,
    from: &'a Newest,
    accuracy: Accuracy,
    arrival: f64,
    k: u64,
    t_s: f64,
    /// The last interval asked for, and the state after it.
    ahead: Option<(f64, Vec<f64>)>,
}

impl Forecasts<'_> {
    fn ahead(&mut self, interval_s: f64) -> &[f64] {
        if self.ahead.as_ref().is_none_or(|(of, _)| *of != interval_s) {
            let state = self.simulator.leap(self.k - 1, interval_s, &self.from.mean, None);
            self.ahead = Some((interval_s, state));
        }
        self.ahead.as_ref().map_or(&[], |(_, state)| state)
    }
}

impl Foresight for Forecasts<'_> {
    type Error = StepError;

    fn position_m(&mut self, interval_s: f64) -> Result<[f64; 2], StepError> {
        let state = self.ahead(interval_s);
        Ok([state[0], state[1]])
    }

    fn accuracy(&mut self, interval_s: f64, sensor: usize) -> Result<f64, StepError> {
        let t_s = self.t_s + interval_s;
        let mut expected = packet(self.k, t_s, Content::Range { anchor: sensor as AnchorId, value_m: 0.0 });
        let step = Step::new(self.k, Some(t_s), std::slice::from_ref(&expected));
        let simulator = self.simulator;
        let values = simulator.measure(&step, self.ahead(interval_s), &mut || 0.0);
        expected.content = crate::simulator::filled(&expected.content, &values);
        let held = std::slice::from_ref(&expected);
        let step = Step { k: self.k, t_s: Some(t_s), packets: held, held, arrival: self.arrival };
        let mut newest = Newest::default();
        self.tracker.boxed_clone().step(&step, &mut newest)?;
        Ok(self.accuracy.of(&newest.cov, self.simulator.n()))
    }
}
