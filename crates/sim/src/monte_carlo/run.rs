//! One run: a target, its measurements, and what a contender makes of what arrives.

use super::ScenarioError;
use super::received::{Arrival, Reception, Shown, receive};
use crate::channels::Variant;
use fixtrail_track::anchors::Anchors;
use fixtrail_track::error::StepError;
use fixtrail_track::fix::{Fix, Sink};
use fixtrail_track::packet::{Content, Packet};
use fixtrail_track::pipeline::{Pipeline, Until};
use fixtrail_track::registry;
use fixtrail_track::simulator::{Simulator, filled};
use fixtrail_track::spec::{Contender, FieldSpec, ModelSpec, Receiver, Shows, Simulated, Start};
use fixtrail_track::tracker::Step;
use fixtrail_track::trackers::LaggedMode;
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

/// What one run sends, and what becomes of it.
pub struct World<'a> {
    scenario: &'a Simulated,
    simulator: Box<dyn Simulator>,
    /// The anchors of the run.
    pub anchors: Anchors,
    /// The state at each instant.
    pub states: Vec<Vec<f64>>,
    /// The measurements of each instant, as packets that carry their time.
    pub sent: Vec<Vec<Packet>>,
    /// What arrived.
    pub reception: Reception,
}

/// What a contender made of one run. Errors are those of x̂_{k|k}, from instant 1 on.
#[derive(Clone, Debug, PartialEq)]
pub struct Sample {
    /// Mean magnitude of the error of each state component.
    pub mean_abs: Vec<f64>,
    /// Mean square of the same.
    pub mean_square: Vec<f64>,
    /// Mean claimed variance of the same.
    pub claimed: Vec<f64>,
    /// Mean of the normalised estimation error squared, over the number of states.
    pub nees: f64,
    /// Root mean square and last distance of the estimated from the true position, metres.
    pub position_m: Option<(f64, f64)>,
    /// Instants without an estimate.
    pub missing: usize,
    /// Why the run ended early.
    pub failed: Option<String>,
}

/// The last fix.
#[derive(Default)]
struct Newest {
    estimate: Option<(Vec<f64>, Vec<f64>)>,
}

impl Sink for Newest {
    fn fix(&mut self, fix: &Fix<'_>) {
        self.estimate = fix.estimate.map(|e| (e.mean.to_vec(), e.cov.to_vec()));
    }
}

/// Every fix by its instant.
struct All {
    estimates: Vec<Option<(Vec<f64>, Vec<f64>)>>,
}

impl Sink for All {
    fn fix(&mut self, fix: &Fix<'_>) {
        if let Some(at) = self.estimates.get_mut(fix.k as usize) {
            *at = fix.estimate.map(|e| (e.mean.to_vec(), e.cov.to_vec()));
        }
    }
}

impl<'a> World<'a> {
    /// Run `number` of a scenario.
    ///
    /// # Errors
    /// [`ScenarioError`] when its numbers make no model or channel.
    pub fn new(scenario: &'a Simulated, channel: &Variant, seed: u64, number: u64) -> Result<World<'a>, ScenarioError> {
        // One stream per purpose and run: what one draws never moves another.
        let stream = |purpose: u64| Pcg64::new(u128::from(seed), u128::from(number) * 4 + u128::from(purpose));
        let (mut motion, mut noise, mut network, mut place) = (stream(0), stream(1), stream(2), stream(3));
        let mut normal = || StandardNormal.sample(&mut motion);
        let anchors = scenario.field.as_ref().map(|f| field(f, &mut place)).unwrap_or_default();
        let simulator = registry::simulator(&scenario.truth, &anchors)?;
        let mut states = Vec::with_capacity(scenario.steps + 1);
        states.push(simulator.start(match scenario.start {
            Start::Drawn => Some(&mut normal),
            Start::Mean => None,
        }));
        for k in 0..scenario.steps {
            let noise: Option<&mut dyn FnMut() -> f64> = if scenario.noisy { Some(&mut normal) } else { None };
            let next = simulator.leap(k as u64, scenario.interval_s, &states[k], noise);
            states.push(next);
        }
        let mut normal = || StandardNormal.sample(&mut noise);
        let sent = (states.iter().enumerate())
            .map(|(k, x)| {
                let mut packets = templates(scenario, &anchors, k, x);
                let values = simulator.measure(&Step::new(k as u64, None, &packets), x, &mut normal);
                let each = values.len() / packets.len().max(1);
                for (packet, values) in packets.iter_mut().zip(values.chunks(each.max(1))) {
                    packet.content = filled(&packet.content, values);
                }
                packets
            })
            .collect();
        let mut channel = channel.open()?;
        let reception = receive(channel.as_mut(), scenario.steps + 1, scenario.interval_s, &mut network);
        Ok(World { scenario, simulator, anchors, states, sent, reception })
    }

    /// Feeds a contender with what it receives, and compares its estimate of each instant with the truth.
    ///
    /// # Errors
    /// [`ScenarioError`] when its spec makes no estimator.
    pub fn estimate(&self, contender: &Contender) -> Result<Sample, ScenarioError> {
        let mut pipeline = Pipeline::new(&contender.spec, &self.anchors, LaggedMode::Own)?;
        let count = self.states.len();
        let mut all = All { estimates: vec![None; count] };
        let failed = match contender.spec.link.receiver {
            Receiver::Unstamped { .. } => self.show(&mut pipeline, contender.shows, &mut all),
            Receiver::Stamped { late_s } => self.tell(&mut pipeline, contender.shows, late_s.is_some(), &mut all),
        };
        Ok(self.judge(&all.estimates, failed.err().map(|e| e.to_string())))
    }

    /// Feeds a receiver that shows what it holds.
    fn show(&self, pipeline: &mut Pipeline, shows: Shows, all: &mut All) -> Result<(), StepError> {
        for packet in self.held(shows) {
            pipeline.push(packet, all)?;
        }
        pipeline.finish(all)
    }

    /// Feeds a receiver that is told when its packets were sensed. What the paper's channel shows again it has already; without `late` it
    /// has no use for what is not in time.
    fn tell(&self, pipeline: &mut Pipeline, shows: Shows, late: bool, all: &mut All) -> Result<(), StepError> {
        let shown = self.reception.shown(shows);
        let mut known = vec![false; self.states.len()];
        known[0] = true;
        let is_linear = matches!(self.scenario.truth.model, ModelSpec::Linear(_));
        if let (false, Some(first)) = (is_linear, self.sent[0].first()) {
            // The prior stands at instant 0, of which nothing is told: an instant with a packet that measures nothing.
            pipeline.push(Packet { content: Content::Position([None; 3]), ..first.clone() }, &mut Newest::default())?;
        }
        for k in 0..self.states.len() {
            let came: Vec<usize> = match (shows, shown[k]) {
                (Shows::Paper, Shown::Sensed(at)) => vec![at],
                (Shows::Paper, Shown::Zero) => Vec::new(),
                _ => self.reception.arrived[k].iter().map(|arrival| arrival.sensed).collect(),
            };
            for sensed in came.into_iter().filter(|sensed| late || *sensed == k) {
                if !std::mem::replace(&mut known[sensed], true) {
                    for packet in &self.sent[sensed] {
                        pipeline.push(packet.clone(), &mut Newest::default())?;
                    }
                }
            }
            let until = if is_linear { Until::Row(k as u64) } else { Until::Time(self.time_s(k)) };
            let mut newest = Newest::default();
            pipeline.now(until, &mut newest)?;
            all.estimates[k] = newest.estimate;
        }
        Ok(())
    }

    fn time_s(&self, k: usize) -> f64 {
        k as f64 * self.scenario.interval_s
    }

    fn judge(&self, estimates: &[Option<(Vec<f64>, Vec<f64>)>], failed: Option<String>) -> Sample {
        let n = self.simulator.n();
        let axes = registry::layout(&self.scenario.truth).axes;
        let mut sample = Sample {
            mean_abs: vec![0.0; n],
            mean_square: vec![0.0; n],
            claimed: vec![0.0; n],
            nees: 0.0,
            position_m: None,
            missing: 0,
            failed,
        };
        let (mut count, mut square_m2, mut last_m) = (0.0, 0.0, 0.0);
        for (x, estimate) in self.states.iter().zip(estimates).skip(1) {
            let Some((mean, cov)) = estimate else {
                sample.missing += 1;
                continue;
            };
            count += 1.0;
            let error: Vec<f64> = mean.iter().zip(x).map(|(a, b)| a - b).collect();
            for i in 0..n {
                sample.mean_abs[i] += error[i].abs();
                sample.mean_square[i] += error[i] * error[i];
                sample.claimed[i] += cov[i * n + i];
            }
            sample.nees += self.simulator.nees(&error, cov).unwrap_or(f64::INFINITY) / n as f64;
            let distance_m2: f64 = error[..axes].iter().map(|e| e * e).sum();
            square_m2 += distance_m2;
            last_m = distance_m2.sqrt();
        }
        if count > 0.0 {
            let means = sample.mean_abs.iter_mut().chain(&mut sample.mean_square).chain(&mut sample.claimed);
            means.for_each(|v| *v /= count);
            sample.nees /= count;
            sample.position_m = (axes > 0).then(|| ((square_m2 / count).sqrt(), last_m));
        }
        sample
    }
}

/// Sensors anywhere in the field.
pub(crate) fn field(spec: &FieldSpec, rng: &mut Pcg64) -> Anchors {
    let mut anchors = Anchors::default();
    for i in 0..spec.sensors {
        let [x, y] = spec.size_m.map(|side| rng.random_range(0.0..side));
        anchors.add(&format!("S{i}"), [x, y, 0.0]);
    }
    anchors
}

/// The packets of an instant before they say anything.
fn templates(scenario: &Simulated, anchors: &Anchors, k: usize, x: &[f64]) -> Vec<Packet> {
    let t_s = k as f64 * scenario.interval_s;
    let packet = |content: Content| Packet {
        t_s,
        k: matches!(content, Content::Linear { .. }).then_some(k as u64),
        content,
        sd: None,
        seq: None,
        received_s: None,
        arrival: None,
        line: k as u64 + 1,
    };
    if let ModelSpec::Linear(linear) = &scenario.truth.model {
        let z = vec![Some(0.0); linear.base.c.rows];
        return vec![packet(Content::Linear { z, u: vec![0.0; linear.base.b.cols] })];
    }
    let axes = registry::layout(&scenario.truth).axes;
    let Some(field) = &scenario.field else {
        return vec![packet(Content::Position(std::array::from_fn(|i| (i < axes).then_some(0.0))))];
    };
    let mut near: Vec<(f64, u32)> = (0..anchors.len() as u32)
        .map(|id| (x[..axes].iter().zip(anchors.position_m(id)).map(|(a, b)| (a - b).powi(2)).sum(), id))
        .collect();
    near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut ids: Vec<u32> = near.iter().take(field.nearest).map(|(_, id)| *id).collect();
    ids.sort_unstable();
    ids.into_iter().map(|anchor| packet(Content::Range { anchor, value_m: 0.0 })).collect()
}

/// Number of values in a content.
fn values(content: &Content) -> usize {
    match content {
        Content::Position(p) => p.iter().flatten().count(),
        Content::Linear { z, .. } => z.len(),
        _ => 1,
    }
}

impl World<'_> {
    /// What arrived, in the order of arrival, with time of sensing, sequence number and time of reception.
    pub fn received(&self) -> Vec<Packet> {
        let copies = |arrival: &Arrival| {
            let Arrival { sensed, at_s } = *arrival;
            let numbered = move |p: &Packet| Packet { seq: Some(sensed as u64), received_s: Some(at_s), ..p.clone() };
            self.sent[sensed].iter().map(numbered).collect::<Vec<Packet>>()
        };
        self.reception.arrived.iter().flatten().flat_map(copies).collect()
    }

    /// What a receiver without time stamps shows at each instant.
    pub fn held(&self, shows: Shows) -> Vec<Packet> {
        let shown = self.reception.shown(shows);
        (shown.into_iter().enumerate()).flat_map(|(k, shown)| self.shown_at(k, shown)).collect()
    }

    fn shown_at(&self, k: usize, shown: Shown) -> Vec<Packet> {
        let content = |i: usize, asked: &Content| match shown {
            Shown::Zero => filled(asked, &vec![0.0; values(asked)]),
            Shown::Sensed(at) => value_of(&self.sent[at][i].content, asked),
        };
        let packets = self.sent[k].iter().enumerate();
        packets.map(|(i, asked)| Packet { content: content(i, &asked.content), ..asked.clone() }).collect()
    }
}

/// The value of one content as if it were the other's measurement: a receiver without time stamps does not know whose it is.
fn value_of(held: &Content, asked: &Content) -> Content {
    match (held, asked) {
        (Content::Range { value_m, .. }, Content::Range { anchor, .. }) => {
            Content::Range { anchor: *anchor, value_m: *value_m }
        }
        _ => held.clone(),
    }
}
