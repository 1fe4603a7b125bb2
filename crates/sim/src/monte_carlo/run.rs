//! One run: a target, its measurements, and what a contender makes of what arrives.

use super::ScenarioError;
use super::received::{Arrival, Reception, Shown, receive};
use super::sample::{Judge, Sample, Told};
use crate::channels::Variant;
use crate::motions::{self, Kinematics};
use fixtrail_track::anchors::Anchors;
use fixtrail_track::error::StepError;
use fixtrail_track::fix::{Estimate, Fix, Sink};
use fixtrail_track::layout::Layout;
use fixtrail_track::packet::{Content, Packet};
use fixtrail_track::pipeline::{Pipeline, Until};
use fixtrail_track::registry;
use fixtrail_track::simulator::{Simulator, filled};
use fixtrail_track::spec::{Contender, FieldSpec, ModelSpec, MotionSpec, Receiver, Shows, Simulated, Start};
use fixtrail_track::tracker::Step;
use fixtrail_track::trackers::LaggedMode;
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

/// What one run sends, and what becomes of it.
pub struct World<'a> {
    pub(super) scenario: &'a Simulated,
    pub(super) simulator: Box<dyn Simulator>,
    judge: Judge,
    /// The anchors of the run.
    pub anchors: Anchors,
    /// The state at each instant; its first components where the motion has no more.
    pub states: Vec<Vec<f64>>,
    /// The measurements of each instant, as packets that carry their time.
    pub sent: Vec<Vec<Packet>>,
    /// What arrived.
    pub reception: Reception,
}

/// The last fix, or the last smoothed one.
struct Newest {
    half: Half,
    told: Option<Told>,
}

/// Every fix by the instant that it describes.
struct All<'a> {
    half: Half,
    /// The number of a fix's instant in the scenario.
    instant: &'a dyn Fn(u64, Option<f64>) -> usize,
    told: Vec<Option<Told>>,
}

/// Which half of a fix counts.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Half {
    /// Its own estimate.
    Own,
    /// That of the smoother beside it.
    Lagged,
}

impl Half {
    /// What a fix says, and of which instant.
    fn of(self, fix: &Fix<'_>) -> Option<(u64, Option<f64>, Option<Told>)> {
        let told = |estimate: Option<Estimate<'_>>, nis: Option<(f64, u32)>| {
            estimate.map(|e| Told { mean: e.mean.to_vec(), cov: e.cov.to_vec(), nis })
        };
        let nis = fix.nis.filter(|_| fix.nis_dof > 0).map(|nis| (nis, fix.nis_dof));
        match self {
            Half::Own => Some((fix.k, fix.t_s, told(fix.estimate, nis))),
            Half::Lagged => fix.lagged.map(|lagged| (lagged.k, lagged.t_s, told(lagged.estimate, None))),
        }
    }
}

impl Newest {
    fn new(half: Half) -> Newest {
        Newest { half, told: None }
    }
}

impl Sink for Newest {
    fn fix(&mut self, fix: &Fix<'_>) {
        self.told = self.half.of(fix).and_then(|(.., told)| told);
    }
}

impl Sink for All<'_> {
    fn fix(&mut self, fix: &Fix<'_>) {
        let Some((k, t_s, told)) = self.half.of(fix) else { return };
        if let Some(at) = self.told.get_mut((self.instant)(k, t_s)) {
            *at = told;
        }
    }
}

impl<'a> World<'a> {
    /// Run `number` of a scenario.
    ///
    /// # Errors
    /// [`ScenarioError`] when its numbers make no model or channel.
    pub fn new(scenario: &'a Simulated, channel: &Variant, seed: u64, number: u64) -> Result<World<'a>, ScenarioError> {
        let [mut motion, mut noise, mut network, mut place] = streams(seed, number);
        let anchors = scenario.field.as_ref().map(|f| field(f, &mut place)).unwrap_or_default();
        let simulator = registry::simulator(&scenario.truth, &anchors)?;
        let layout = registry::layout(&scenario.truth);
        let states = match &scenario.motion {
            None => modelled(scenario, &*simulator, &mut motion),
            Some(spec) => moved(scenario, spec, &layout, &*simulator, &mut motion),
        };
        let mut normal = || StandardNormal.sample(&mut noise);
        let sent = (states.iter().enumerate())
            .map(|(k, x)| {
                let mut packets = templates(scenario, &anchors, k, x);
                // Sensors see nothing of what a motion does not have.
                let mut whole = x.clone();
                whole.resize(simulator.n(), 0.0);
                let values = simulator.measure(&Step::new(k as u64, None, &packets), &whole, &mut normal);
                let each = values.len() / packets.len().max(1);
                for (packet, values) in packets.iter_mut().zip(values.chunks(each.max(1))) {
                    packet.content = filled(&packet.content, values);
                }
                packets
            })
            .collect();
        let mut channel = channel.open()?;
        let reception = receive(channel.as_mut(), scenario.steps + 1, scenario.interval_s, &mut network);
        Ok(World { scenario, simulator, judge: Judge::new(&layout, scenario.lost_m), anchors, states, sent, reception })
    }

    /// Feeds a contender with what it receives, and compares its estimate of each instant with the truth.
    ///
    /// # Errors
    /// [`ScenarioError`] when its spec makes no estimator.
    pub fn estimate(&self, contender: &Contender) -> Result<Sample, ScenarioError> {
        // A smoother's own rows are smoothed; of others the half beside the filter is.
        let half = match contender.smoothed && !contender.spec.estimator.is_smoother() {
            true => Half::Lagged,
            false => Half::Own,
        };
        let mode = if half == Half::Lagged { LaggedMode::Both } else { LaggedMode::Own };
        let mut pipeline = Pipeline::new(&contender.spec, &self.anchors, mode)?;
        let by_number = |k: u64, _: Option<f64>| k as usize;
        let by_time =
            |k: u64, t_s: Option<f64>| t_s.map_or(k as usize, |t_s| (t_s / self.scenario.interval_s).round() as usize);
        let is_told = matches!(contender.spec.link.receiver, Receiver::Stamped { .. });
        let instant: &dyn Fn(u64, Option<f64>) -> usize =
            if is_told && !self.is_linear() { &by_time } else { &by_number };
        let mut all = All { half, instant, told: vec![None; self.states.len()] };
        let failed = match contender.spec.link.receiver {
            Receiver::Unstamped { .. } => self.show(&mut pipeline, contender.shows, &mut all),
            Receiver::Stamped { late_s } => {
                let take = |at: usize, k: usize| late_s.is_some() || at == k;
                match contender.smoothed {
                    true => self.tell_smoother(&mut pipeline, contender.shows, take, &mut all),
                    false => self.tell(&mut pipeline, contender.shows, take, &mut all),
                }
            }
        };
        let failed = failed.err().map(|e| e.to_string());
        Ok(self.judge.sample(&*self.simulator, &self.states, &all.told, failed))
    }

    /// Feeds a receiver that shows what it holds.
    fn show(&self, pipeline: &mut Pipeline, shows: Shows, all: &mut All<'_>) -> Result<(), StepError> {
        for packet in self.held(shows) {
            pipeline.push(packet, all)?;
        }
        pipeline.finish(all)
    }

    fn is_linear(&self) -> bool {
        matches!(self.scenario.truth.model, ModelSpec::Linear(_))
    }

    /// The instants whose packets come at each instant to a receiver that is told when they were sensed, each once, as far as it can use
    /// them by `take(sensed, now)`. What the paper's channel shows again it has already.
    fn news(&self, shows: Shows, take: impl Fn(usize, usize) -> bool) -> Vec<Vec<usize>> {
        let shown = self.reception.shown(shows);
        let mut known = vec![false; self.states.len()];
        known[0] = true;
        let come = |k: usize| match (shows, shown[k]) {
            (Shows::Paper, Shown::Sensed(at)) => vec![at],
            (Shows::Paper, Shown::Zero) => Vec::new(),
            _ => self.reception.arrived[k].iter().map(|arrival| arrival.sensed).collect(),
        };
        (0..self.states.len())
            .map(|k| {
                let usable = come(k).into_iter().filter(|at| take(*at, k));
                usable.filter(|at| !std::mem::replace(&mut known[*at], true)).collect()
            })
            .collect()
    }

    /// Feeds a receiver that is told when its packets were sensed, and asks it at each instant.
    fn tell(
        &self,
        pipeline: &mut Pipeline,
        shows: Shows,
        take: impl Fn(usize, usize) -> bool,
        all: &mut All<'_>,
    ) -> Result<(), StepError> {
        if let (false, Some(first)) = (self.is_linear(), self.sent[0].first()) {
            // The prior stands at instant 0, of which nothing is told: an instant with a packet that measures nothing.
            let nothing = Packet { content: Content::Position([None; 3]), ..first.clone() };
            pipeline.push(nothing, &mut Newest::new(all.half))?;
        }
        for (k, came) in self.news(shows, take).into_iter().enumerate() {
            for packet in came.into_iter().flat_map(|at| &self.sent[at]) {
                pipeline.push(packet.clone(), &mut Newest::new(all.half))?;
            }
            let until = if self.is_linear() { Until::Row(k as u64) } else { Until::Time(self.time_s(k)) };
            let mut newest = Newest::new(all.half);
            pipeline.now(until, &mut newest)?;
            all.told[k] = newest.told;
        }
        Ok(())
    }

    /// Feeds a smoother whose receiver is told when its packets were sensed; its fixes stand at the instants that they describe.
    fn tell_smoother(
        &self,
        pipeline: &mut Pipeline,
        shows: Shows,
        take: impl Fn(usize, usize) -> bool,
        all: &mut All<'_>,
    ) -> Result<(), StepError> {
        let last = self.states.len() - 1;
        for (k, came) in self.news(shows, take).into_iter().enumerate() {
            // An instant of which nothing is told is estimated too. A linear run fills its gaps, but for the last; others need a packet that
            // measures nothing: of a kind that no scenario has a sensor for, so that what comes late is no copy of it.
            if let Some(first) = self.sent[k].first() {
                let nothing = match &first.content {
                    Content::Linear { z, u } if k == last && !came.contains(&k) => {
                        Some(Content::Linear { z: vec![None; z.len()], u: u.clone() })
                    }
                    Content::Linear { .. } => None,
                    _ => Some(Content::Bearing { anchor: 0, value_rad: 0.0 }),
                };
                if let Some(content) = nothing {
                    pipeline.push(Packet { content, ..first.clone() }, all)?;
                }
            }
            for packet in came.into_iter().flat_map(|at| &self.sent[at]) {
                pipeline.push(packet.clone(), all)?;
            }
        }
        pipeline.finish(all)
    }

    fn time_s(&self, k: usize) -> f64 {
        k as f64 * self.scenario.interval_s
    }
}

/// States of a target that moves as the model says.
fn modelled(scenario: &Simulated, simulator: &dyn Simulator, rng: &mut Pcg64) -> Vec<Vec<f64>> {
    let mut normal = || StandardNormal.sample(rng);
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
    states
}

/// What the model's state has of a target that moves otherwise: position, velocity and acceleration, as far as they go.
fn moved(
    scenario: &Simulated,
    spec: &MotionSpec,
    layout: &Layout,
    simulator: &dyn Simulator,
    rng: &mut Pcg64,
) -> Vec<Vec<f64>> {
    let axes = layout.axes;
    let start = match scenario.start {
        Start::Drawn => simulator.start(Some(&mut || StandardNormal.sample(rng))),
        Start::Mean => simulator.start(None),
    };
    let of = |order: usize| {
        let there = axes > 0 && layout.names.get(order * axes).is_some_and(|name| name == ["x", "vx", "ax"][order]);
        core::array::from_fn(|axis| if there && axis < axes { start[order * axes + axis] } else { 0.0 })
    };
    let start = Kinematics { position_m: of(0), velocity_mps: of(1), acceleration_mps2: of(2) };
    let orders = 1 + usize::from(layout.has_velocity) + usize::from(layout.names.iter().any(|name| name == "ax"));
    let mut path = motions::open(spec, axes, start, rng);
    (0..=scenario.steps)
        .map(|k| {
            if k > 0 {
                path.advance(scenario.interval_s, rng);
            }
            let Kinematics { position_m, velocity_mps, acceleration_mps2 } = path.now();
            let all = [position_m, velocity_mps, acceleration_mps2];
            all.iter().take(orders).flat_map(|order| &order[..axes]).copied().collect()
        })
        .collect()
}

/// Chance of a run: of its motion, its measurements, its network and its places. One stream for each: what one draws never moves another.
pub(crate) fn streams(seed: u64, number: u64) -> [Pcg64; 4] {
    std::array::from_fn(|purpose| Pcg64::new(u128::from(seed), u128::from(number) * 4 + purpose as u128))
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
    let packet = |content: Content| {
        let k_of_linear = matches!(content, Content::Linear { .. }).then_some(k as u64);
        Packet { k: k_of_linear, ..Packet::new(t_s, content, k as u64 + 1) }
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
