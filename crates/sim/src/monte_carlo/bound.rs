//! What no estimator can do better: the posterior Cramér–Rao bound over the true trajectories.

use super::run::World;
use super::summary::Estimated;
use fixtrail_track::registry;
use fixtrail_track::spec::{Simulated, Start};
use fixtrail_track::tracker::Step;

/// The bound of a scenario's causal estimates, averaged over its runs ([`fixtrail_core::cramer_rao`]).
///
/// Each run's recursion has its Jacobians at the true states of that run, and the arrival rate's share of the information. For a linear model
/// that is the bound itself. For others it is the bound of a run's own trajectory, and its mean is what is shown; the bound over all
/// trajectories, from the mean information, lies below.
#[derive(Clone, Debug, PartialEq)]
pub struct Bound {
    /// Root mean square over instants and runs: of the position, metres, or of a linear model's state.
    pub rms: Estimated,
    /// Mean square of each component of the state.
    pub mean_square: Vec<Estimated>,
    /// Root mean square at each instant from 1 on.
    pub over_time: Vec<f64>,
}

/// Why a scenario has no bound.
pub fn missing(scenario: &Simulated) -> Option<&'static str> {
    if scenario.schedule.is_some() {
        return Some("what is measured depends on the estimates: sensors are chosen as the target goes");
    }
    if scenario.motion.is_some() {
        return Some("targets do not move as the model says");
    }
    (scenario.start == Start::Mean && !scenario.noisy)
        .then_some("targets start at x0 and move without noise, so all is known beforehand")
}

impl World<'_> {
    /// The bound on the variance of each component at each instant from 1 on.
    pub fn bound(&self, arrival: f64) -> Vec<Vec<f64>> {
        let (simulator, scenario, n) = (&self.simulator, self.scenario, self.simulator.n());
        let mut bound = match scenario.start {
            Start::Drawn => simulator.start_cov(),
            Start::Mean => vec![0.0; n * n],
        };
        let mut out = Vec::with_capacity(self.states.len());
        for k in 1..self.states.len() {
            let (from, to) = (&self.states[k - 1], &self.states[k]);
            bound = simulator.bound_moved(k as u64 - 1, scenario.interval_s, from, &bound, scenario.noisy);
            bound = simulator.bound_measured(&Step::new(k as u64, None, &self.sent[k]), to, &bound, arrival);
            out.push((0..n).map(|i| bound[i * n + i]).collect());
        }
        out
    }
}

/// Bounds of runs, taken in their order.
pub struct Bounds {
    shown: usize,
    runs: Vec<Vec<f64>>,
    over_time: Vec<f64>,
}

impl Bounds {
    /// None yet.
    pub fn new(scenario: &Simulated) -> Bounds {
        let layout = registry::layout(&scenario.truth);
        let shown = if layout.is_linear() { layout.n() } else { layout.axes };
        Bounds { shown, runs: Vec::new(), over_time: vec![0.0; scenario.steps] }
    }

    /// Takes the variances of a run's instants.
    pub fn take(&mut self, variances: &[Vec<f64>]) {
        let n = variances.first().map_or(0, Vec::len);
        let mut mean = vec![0.0; n];
        for (sum, at) in self.over_time.iter_mut().zip(variances) {
            *sum += at[..self.shown].iter().sum::<f64>();
            mean.iter_mut().zip(at).for_each(|(m, v)| *m += v / variances.len() as f64);
        }
        self.runs.push(mean);
    }

    /// Their means; `None` without a run.
    pub fn mean(self) -> Option<Bound> {
        let n = self.runs.first()?.len();
        let runs = self.runs.len() as f64;
        let shown = self.shown;
        Some(Bound {
            rms: Estimated::of(self.runs.iter().map(|run| run[..shown].iter().sum())).root(),
            mean_square: (0..n).map(|i| Estimated::of(self.runs.iter().map(move |run| run[i]))).collect(),
            over_time: self.over_time.iter().map(|sum| (sum / runs).sqrt()).collect(),
        })
    }
}
