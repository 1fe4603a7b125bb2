//! One run of a target whose sensors are chosen as it goes.

use crate::channels::{Channel, Variant};
use crate::monte_carlo::{Judge, Sample, ScenarioError, Told, field, streams};
use fixtrail_track::anchors::Anchors;
use fixtrail_track::closed_loop::{ClosedLoop, Taken, World};
use fixtrail_track::packet::{AnchorId, Content, Packet};
use fixtrail_track::registry;
use fixtrail_track::simulator::Simulator;
use fixtrail_track::spec::{Contender, ScheduleSpec, Simulated, Start};
use fixtrail_track::tracker::Step;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

/// What became of one run.
#[derive(Clone, Debug, PartialEq)]
pub struct Scheduled {
    /// The sensors.
    pub anchors: Anchors,
    /// Every decision and what followed, from instant 1 on.
    pub taken: Vec<Taken>,
    /// The state at instant 0 and at each of those.
    pub states: Vec<Vec<f64>>,
    /// φ at each of them.
    pub accuracy: Vec<f64>,
    /// Energy spent, mJ.
    pub energy_mj: f64,
    /// Why the run ended early.
    pub failed: Option<String>,
}

impl Scheduled {
    /// Distance of the estimated from the true position at each instant from 1 on, m.
    pub fn errors_m(&self) -> impl Iterator<Item = f64> + '_ {
        self.taken.iter().zip(&self.states[1..]).map(|(t, x)| (t.mean[0] - x[0]).hypot(t.mean[1] - x[1]))
    }

    /// What is to be said of the run.
    ///
    /// # Errors
    /// [`ScenarioError`] when the numbers of the scenario make no model.
    pub(crate) fn sample(&self, scenario: &Simulated) -> Result<Sample, ScenarioError> {
        let simulator = registry::simulator(&scenario.truth, &self.anchors)?;
        let told = |t: &Taken| Some(Told { mean: t.mean.clone(), cov: t.cov.clone(), nis: t.nis });
        let estimates: Vec<Option<Told>> = std::iter::once(None).chain(self.taken.iter().map(told)).collect();
        let judge = Judge::new(&registry::layout(&scenario.truth), scenario.lost_m);
        let mut sample = judge.sample(&*simulator, &self.states, &estimates, self.failed.clone());
        sample.energy_mj = Some(self.energy_mj);
        sample.time_steps = Some(self.taken.len() as f64);
        Ok(sample)
    }

    /// Times at which another sensor took over.
    pub fn handovers(&self) -> usize {
        self.taken.iter().filter(|t| t.plan.chosen.is_some_and(|c| c.sensor != t.from)).count()
    }
}

/// The world of one run: a target, its sensors and the network.
struct Run<'a> {
    simulator: &'a dyn Simulator,
    noisy: bool,
    anchors: &'a Anchors,
    failures: &'a [(u64, usize)],
    motion: Pcg64,
    noise: Pcg64,
    network: Pcg64,
    channel: Box<dyn Channel>,
    /// Instants and states so far; the last may lie at the instant that is being measured.
    times_s: Vec<f64>,
    states: Vec<Vec<f64>>,
}

impl Run<'_> {
    /// Moves the target to instant `k`.
    fn advance(&mut self, k: u64, t_s: f64) {
        if self.states.len() as u64 > k {
            return;
        }
        let last = self.states.len() - 1;
        let motion = &mut self.motion;
        let mut normal = || StandardNormal.sample(motion);
        let noise: Option<&mut dyn FnMut() -> f64> = if self.noisy { Some(&mut normal) } else { None };
        let next = self.simulator.leap(last as u64, t_s - self.times_s[last], &self.states[last], noise);
        self.states.push(next);
        self.times_s.push(t_s);
    }
}

impl World for Run<'_> {
    fn measure(&mut self, k: u64, t_s: f64, sensor: usize) -> f64 {
        self.advance(k, t_s);
        let content = Content::Range { anchor: sensor as AnchorId, value_m: 0.0 };
        let packet = Packet::new(t_s, content, k + 1);
        let step = Step::new(k, Some(t_s), std::slice::from_ref(&packet));
        let noise = &mut self.noise;
        let values = self.simulator.measure(&step, &self.states[k as usize], &mut || StandardNormal.sample(noise));
        values.first().copied().unwrap_or(f64::NAN)
    }

    fn arrives(&mut self, _k: u64) -> bool {
        // What is late has missed its decision.
        self.channel.transmit(&mut self.network).delays_s().first().is_some_and(|delay_s| *delay_s == 0.0)
    }

    fn failed(&mut self, k: u64) -> Vec<usize> {
        self.failures.iter().filter(|(at, _)| *at == k).map(|(_, sensor)| *sensor).collect()
    }
}

/// Runs a contender under its schedule. Run `number` of a seed has the same field, start and network for every contender.
///
/// # Errors
/// [`ScenarioError`] when the numbers of the scenario make no model, estimator or channel. A filter that fails on the way is in the result.
pub fn scheduled(
    scenario: &Simulated,
    contender: &Contender,
    schedule: &ScheduleSpec,
    channel: &Variant,
    seed: u64,
    number: u64,
) -> Result<Scheduled, ScenarioError> {
    let [mut motion, noise, network, mut place] = streams(seed, number);
    let anchors = scenario.field.as_ref().map(|f| field(f, &mut place)).unwrap_or_default();
    let simulator = registry::simulator(&scenario.truth, &anchors)?;
    let mut normal = || StandardNormal.sample(&mut motion);
    let start = simulator.start(match scenario.start {
        Start::Drawn => Some(&mut normal),
        Start::Mean => None,
    });
    let mut run = Run {
        simulator: &*simulator,
        noisy: scenario.noisy,
        anchors: &anchors,
        failures: &schedule.failures,
        motion,
        noise,
        network,
        channel: channel.open()?,
        times_s: vec![0.0],
        states: vec![start],
    };
    let mut closed = ClosedLoop::new(&contender.spec, schedule, run.anchors, contender.shows, &mut run)?;
    let (mut taken, mut accuracy, mut failed) = (Vec::new(), Vec::new(), None);
    loop {
        match closed.advance(&mut run) {
            Ok(None) => break,
            Ok(Some(one)) => {
                // Nothing is measured while the target coasts.
                run.advance(one.k, one.t_s);
                accuracy.push(closed.accuracy());
                taken.push(one);
            }
            Err(e) => {
                failed = Some(e.to_string());
                break;
            }
        }
    }
    let energy_mj = closed.scheduler().spent_mj();
    let mut states = run.states;
    states.truncate(taken.len() + 1);
    Ok(Scheduled { anchors, taken, states, accuracy, energy_mj, failed })
}
