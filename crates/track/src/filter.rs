//! The recursive filter that every Kalman-family tracker shares: start, prediction and update, and a record of how each instant was
//! linearised for smoothers to go back over. What is predicted and updated, one filter or several modes, is a [`Recursion`].
//!
//! A robust filter also notices when its prediction is of no more use, and starts anew from the data:
//!
//! - **Lost**: at 12 of the last 16 instants with measurements more than half of the rows missed their prediction by more than three
//!   standard deviations. Innovations of a filter that is right are independent from instant to instant, and so are outliers: if one
//!   instant in ten is bad, this happens once in 8e8 instants, `Σ_{i≥12} C(16,i) 0.1^i 0.9^(16−i) = 1.3e-9`. Without outliers, at most
//!   2 × 0.0027 by Markov's inequality, less than 1e-24.
//! - **Stale**: after a gap one standard deviation of the prediction bends a measurement by more than the standard deviation of its
//!   innovation, though over the estimate before the gap it was as good as linear, by the measure that ends the search for a start
//!   (`Search`). From there on the linearisation would decide the update, and not the measurement: the filter would be sure of a wrong
//!   place. For a range that is a prediction known to no better than twice the distance to the anchor.
//!
//! A nonlinear start that leaves a target and its mirror image goes on with both, and without an estimate until the
//! data tell which is right.

use crate::error::StepError;
use crate::fix::Status;
use crate::linearised::Linearised;
use crate::model::Model;
use crate::pair::{Pair, Verdict, loss};
use crate::recursion::{Interval, Recursion, Single};
use crate::search::{self, BENT, Found, Search};
use crate::tracker::Step;
use fixtrail_core::estimators::diffuse::Diffuse;
use fixtrail_core::estimators::kalman::{self, Evidence, Robust};
use fixtrail_core::estimators::smoother::Arrive;
use fixtrail_core::{Belief, Row, Vector};

/// Where the filter stands after an instant.
#[derive(Clone, Copy, Debug)]
pub struct Outcome<const N: usize> {
    /// x̂_{k|k}; `None` while the data do not determine it.
    pub belief: Option<Belief<N>>,
    /// What happened.
    pub status: Status,
    /// Normalised innovation squared, where there was a prediction.
    pub nis: Option<f64>,
    /// Scalar measurements behind it.
    pub nis_dof: u32,
}

#[derive(Clone)]
enum State<const N: usize, R: Recursion<N>> {
    /// Nothing has arrived.
    New,
    /// Linear, without a prior: exact diffuse recursion.
    Diffuse(Box<Start<N>>),
    /// Nonlinear, without a prior: Gauss–Newton over a growing window.
    Searching(Box<Search<N>>),
    /// Nonlinear, and one of two: anchors in one line do not tell a target from its mirror image.
    Choosing(Box<Pair<N, R>>),
    /// The state is known.
    Running(R::Known),
}

/// A linear start: the state may be determined already, but not yet well enough for an ordinary covariance.
#[derive(Clone, Copy)]
struct Start<const N: usize> {
    pass: Diffuse<N>,
    /// Instants since the state was determined.
    determined: u32,
}

/// Instants with measurements that the test for a lost track looks back over.
const LOST_WINDOW: u32 = 16;
/// How many of them must miss for the track to be lost.
const LOST_MISSES: u32 = 12;
/// Share of an innovation's standard deviation by which a prediction that is still of use may bend a measurement.
const STALE: f64 = 1.0;

/// Instants after which an ordinary covariance takes over in any case; without process noise nothing else would end the start.
const LONGEST_START: u32 = 64;

/// The instant before.
#[derive(Clone, Copy)]
struct Past<const N: usize> {
    k: u64,
    t_s: Option<f64>,
    drive: Vector<N>,
    nominal: Vector<N>,
}

/// Filter of one target.
#[derive(Clone)]
pub struct Filter<const N: usize, R: Recursion<N> = Single> {
    /// What it filters by.
    pub model: Model<N>,
    recursion: R,
    state: State<N, R>,
    past: Option<Past<N>>,
    rows: Vec<Row<N>>,
    /// Which of the last instants with measurements missed, the newest in the lowest bit.
    misses: u32,
    /// How often it started anew.
    restarts: u64,
}

impl<const N: usize, R: Recursion<N>> Filter<N, R> {
    /// A filter before its first instant.
    pub fn new(model: Model<N>, recursion: R) -> Self {
        Self { model, recursion, state: State::New, past: None, rows: Vec::new(), misses: 0, restarts: 0 }
    }

    /// How often the filter has started anew because it was lost or its prediction had become useless.
    pub fn restarts(&self) -> u64 {
        self.restarts
    }

    /// Whether a row that does not fit is treated as such, and a lost track started anew.
    fn is_robust(&self) -> bool {
        self.model.robust != Robust::None
    }

    /// Takes one instant. Appends to `record`, when a smoother asks for it, every instant whose linearisation is now settled, in order.
    ///
    /// # Errors
    /// [`StepError`]; nothing has changed then.
    pub fn step(&mut self, step: &Step<'_>, record: Option<&mut Vec<Linearised<N>>>) -> Result<Outcome<N>, StepError> {
        let unknown = self.model.prior.is_none() || self.restarts > 0;
        if matches!(self.state, State::New) && unknown && self.model.nonlinear {
            self.state = State::Searching(Box::new(Search::new()?));
        }
        match &mut self.state {
            State::Searching(search) => {
                let dt_s = self.past.map_or(0.0, |p| interval(p.t_s, step.t_s));
                let keeps = record.is_some();
                let found = search.step(&self.model, step, dt_s, record)?;
                let nominal = search.newest();
                match found {
                    Some(Found { belief, rival: None, settled: true }) => {
                        self.state = State::Running(self.recursion.begin(&belief));
                    }
                    Some(Found { belief, rival: Some(rival), settled: true }) => {
                        let records = if keeps { search.records(&self.model) } else { Default::default() };
                        let filters = [(belief, nominal), (rival.belief, rival.newest)]
                            .map(|(belief, nominal)| self.going_on(step, &belief, nominal));
                        let pair = Pair::new(filters, rival.lead, rival.mirror, records);
                        self.state = State::Choosing(Box::new(pair));
                    }
                    _ => {}
                }
                self.remember(step, nominal);
                Ok(started(found.filter(|f| f.rival.is_none()).map(|f| f.belief), step))
            }
            State::Choosing(_) => self.choose(step, record),
            State::Running(_) => self.run(step, record),
            State::New if !unknown => self.run(step, record),
            State::New | State::Diffuse(_) => self.start(step, record),
        }
    }

    /// Appends the instants whose linearisation was still open when the data ended.
    pub fn finish(&mut self, record: &mut Vec<Linearised<N>>) {
        match &mut self.state {
            State::Searching(search) => search.finish(&self.model, record),
            State::Choosing(pair) => record.extend((0..pair.waiting()).map(|_| Linearised::forgotten())),
            State::New | State::Diffuse(_) | State::Running(_) => {}
        }
    }

    /// A filter like this one that knows the state of the instant.
    fn going_on(&self, step: &Step<'_>, belief: &Belief<N>, nominal: Vector<N>) -> Self {
        let mut filter = Self::new(self.model.clone(), self.recursion.clone());
        filter.state = State::Running(self.recursion.begin(belief));
        filter.restarts = self.restarts;
        filter.remember(step, nominal);
        filter
    }

    /// One step of two filters of which one is right: the estimate is that of the one that turns out to be, and none before.
    fn choose(
        &mut self,
        step: &Step<'_>,
        mut record: Option<&mut Vec<Linearised<N>>>,
    ) -> Result<Outcome<N>, StepError> {
        let State::Choosing(pair) = &mut self.state else { return self.run(step, record) };
        let (verdict, outcome) = pair.step(step, record.as_deref_mut())?;
        match verdict {
            Verdict::Open => {
                self.remember(step, Vector::zeros());
                Ok(started(None, step))
            }
            Verdict::Right(place) => {
                let State::Choosing(pair) = std::mem::replace(&mut self.state, State::New) else {
                    return Ok(outcome);
                };
                let (filter, waiting) = pair.take(place);
                (self.state, self.past, self.misses) = (filter.state, filter.past, filter.misses);
                if let Some(record) = record {
                    record.extend(waiting);
                }
                Ok(outcome)
            }
            Verdict::Neither => {
                let (waiting, mut own) = (pair.waiting(), Vec::new());
                let outcome = self.restart(step, record.is_some().then_some(&mut own))?;
                if let Some(record) = record {
                    record.extend((0..waiting).map(|_| Linearised::forgotten()));
                    record.append(&mut own);
                }
                Ok(outcome)
            }
        }
    }

    /// How little an instant's rows were expected, minus twice the logarithm of their density; 0 of a filter that
    /// does not know the state.
    ///
    /// # Errors
    /// [`StepError`].
    pub(crate) fn surprise(&mut self, step: &Step<'_>) -> Result<f64, StepError> {
        let (State::Running(known), Some(past)) = (&self.state, self.past) else { return Ok(0.0) };
        let over = Interval { k: past.k, dt_s: interval(past.t_s, step.t_s), drive: past.drive };
        let expected = R::belief(&self.recursion.predict(&self.model, known, &over));
        self.rows.clear();
        self.model.sensing.rows(step, &expected.mean, &mut self.rows);
        let mut sum = 0.0;
        let robust = self.model.robust;
        kalman::update_noting(&expected, &self.rows, Robust::None, |i| sum += loss(robust, i.e * i.e / i.s) + i.s.ln())
            .map_err(StepError::Core)?;
        Ok(sum)
    }

    /// Gives up what is known and takes the instant as the first one of a new start. The prior belongs to the first start alone.
    fn restart(&mut self, step: &Step<'_>, record: Option<&mut Vec<Linearised<N>>>) -> Result<Outcome<N>, StepError> {
        let before = (std::mem::replace(&mut self.state, State::New), self.past.take(), self.misses);
        self.misses = 0;
        self.restarts += 1;
        let outcome = self.step(step, record);
        if outcome.is_err() {
            (self.state, self.past, self.misses) = before;
            self.restarts -= 1;
        }
        outcome
    }

    fn remember(&mut self, step: &Step<'_>, nominal: Vector<N>) {
        self.past = Some(Past { k: step.k, t_s: step.t_s, drive: self.model.drive(step), nominal });
    }

    /// One step of a filter that knows the state, or has a prior for its first instant.
    fn run(&mut self, step: &Step<'_>, record: Option<&mut Vec<Linearised<N>>>) -> Result<Outcome<N>, StepError> {
        let mut arrive = None;
        let prior = match (&self.state, self.past) {
            (State::Running(known), Some(past)) => {
                let over = Interval { k: past.k, dt_s: interval(past.t_s, step.t_s), drive: past.drive };
                if record.is_some() {
                    let mean = R::belief(known).mean;
                    let leap = self.model.motion.leap(over.k, over.dt_s, &over.drive, &mean);
                    // f(x̂) + F (x̄ − x̂) − x̄⁺ with x̄⁺ = f(x̂).
                    arrive = Some(Arrive { f: leap.f, offset: leap.f * (past.nominal - mean), q: leap.q });
                }
                self.recursion.predict(&self.model, known, &over)
            }
            (State::Running(known), None) => known.clone(),
            _ => {
                let prior = self.model.prior.as_ref();
                let prior = prior.ok_or_else(|| StepError::Misfit("a filter without a prior".to_owned()))?;
                self.recursion.begin(prior)
            }
        };
        let expected = R::belief(&prior);
        if self.is_stale(step, &expected) {
            return self.restart(step, record);
        }
        let mut used = Vec::new();
        let keep = record.is_some().then_some(&mut used);
        let (known, evidence) = self.recursion.update(&self.model, step, &prior, &mut self.rows, keep)?;
        let mut misses = self.misses;
        if evidence.dof > 0 {
            misses = (misses << 1 | u32::from(2 * evidence.misfits > evidence.dof)) & ((1 << LOST_WINDOW) - 1);
        }
        if self.is_robust() && misses.count_ones() >= LOST_MISSES {
            return self.restart(step, record);
        }
        self.misses = misses;
        if let Some(record) = record {
            record.push(Linearised { nominal: expected.mean, arrive, rows: used, forgotten: false });
        }
        let belief = R::belief(&known);
        self.state = State::Running(known);
        self.remember(step, expected.mean);
        Ok(judged(belief, &evidence))
    }

    /// Whether motion since the last estimate has made a prediction too wide for the measurements to be linear over it.
    fn is_stale(&mut self, step: &Step<'_>, prior: &Belief<N>) -> bool {
        if !(self.is_robust() && self.model.nonlinear) || step.packets.is_empty() {
            return false;
        }
        let State::Running(before) = &self.state else { return false };
        let before = R::belief(before);
        !search::is_nearly_linear(&self.model, step, prior, STALE, &mut self.rows)
            && search::is_nearly_linear(&self.model, step, &before, BENT, &mut self.rows)
    }

    /// One step of a linear filter that does not know the state yet, or not well.
    fn start(&mut self, step: &Step<'_>, record: Option<&mut Vec<Linearised<N>>>) -> Result<Outcome<N>, StepError> {
        let zero = Vector::zeros();
        let mut start = match &self.state {
            State::Diffuse(start) => **start,
            _ => Start { pass: Diffuse::start(), determined: 0 },
        };
        let mut arrive = None;
        if let Some(past) = self.past {
            let leap = self.model.motion.leap(past.k, interval(past.t_s, step.t_s), &past.drive, &zero);
            start.pass.leap(&leap.f, &leap.next, &leap.q);
            arrive = Some(Arrive { f: leap.f, offset: leap.next, q: leap.q });
        }
        self.rows.clear();
        self.model.sensing.rows(step, &zero, &mut self.rows);
        let predicted = if start.determined > 0 { start.pass.solve().filter } else { None };
        for row in &self.rows {
            start.pass.update(row).map_err(StepError::Core)?;
        }
        let found = start.pass.solve().filter;
        if let Some(record) = record {
            record.push(Linearised { nominal: zero, arrive, rows: self.rows.clone(), forgotten: false });
        }
        let mut outcome = started(found, step);
        if let (Some(prior), Some(_), false) = (predicted, found, self.rows.is_empty()) {
            for row in &mut self.rows {
                row.residual -= row.h.dot(&prior.mean);
            }
            if let Ok((_, evidence)) = kalman::update(&prior, &self.rows, Robust::None) {
                outcome.nis = Some(evidence.nis);
                outcome.nis_dof = evidence.dof;
            }
        }
        self.state = match found {
            Some(belief) if start.is_over() => State::Running(self.recursion.begin(&belief)),
            Some(_) => State::Diffuse(Box::new(Start { determined: start.determined + 1, ..start })),
            None => State::Diffuse(Box::new(start)),
        };
        self.remember(step, zero);
        Ok(outcome)
    }
}

impl<const N: usize> Start<N> {
    /// Whether an ordinary covariance can take over from a determined state.
    fn is_over(&self) -> bool {
        // Where the data will never see the whole first state, what they see of it has been forgotten by the motion.
        self.determined >= LONGEST_START || !self.pass.determines_start() || self.pass.may_collapse()
    }
}

/// Seconds between two instants; 0 where a linear run has no times.
pub(crate) fn interval(from_s: Option<f64>, to_s: Option<f64>) -> f64 {
    match (from_s, to_s) {
        (Some(a), Some(b)) => b - a,
        _ => 0.0,
    }
}

fn started<const N: usize>(found: Option<Belief<N>>, step: &Step<'_>) -> Outcome<N> {
    let status = match found {
        None => Status::Unobservable,
        Some(_) if step.lost() => Status::Predicted,
        Some(_) => Status::Updated,
    };
    Outcome { belief: found, status, nis: None, nis_dof: 0 }
}

fn judged<const N: usize>(belief: Belief<N>, evidence: &Evidence) -> Outcome<N> {
    let status = match evidence {
        Evidence { dof: 0, .. } => Status::Predicted,
        Evidence { dof, rejected, .. } if dof == rejected => Status::Rejected,
        _ => Status::Updated,
    };
    let nis = (evidence.dof > 0).then_some(evidence.nis);
    Outcome { belief: Some(belief), status, nis, nis_dof: evidence.dof }
}
