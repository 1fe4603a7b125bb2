//! The paper's scenarios, and runs of them.

use crate::channels::{TracePacket, Variant};
use crate::monte_carlo::{Sample, World};
use crate::papers::Effort;
use crate::scheduling::{Scheduled, scheduled};
use fixtrail_track::spec::{
    ArrivalSpec, ChannelSpec, Contender, LossSpec, ModelSpec, Receiver, Scenario, ScheduleSpec, Simulated,
    World as Kind, parse_scenario,
};
use rayon::prelude::*;
use std::path::Path;

/// Section 3.2 and Figure 2.
pub const FIGURE_2: &str = include_str!("../../../../../examples/scenarios/mvf_figure2.toml");
/// Section 4.2 with ranges to the nearest sensor, ten a second.
pub const TURN: &str = include_str!("../../../../../examples/scenarios/mvf_turn.toml");
/// Section 4.2 with the schedule.
pub const SCHEDULE: &str = include_str!("../../../../../examples/scenarios/mvf_schedule.toml");

/// A scenario whose contenders are told their channel's arrival rate.
#[derive(Clone)]
pub struct Setting {
    pub simulated: Simulated,
    channel: ChannelSpec,
}

impl Setting {
    /// The scenario of a text.
    ///
    /// # Panics
    /// When the text is not one of the constants above, all of which a test parses.
    #[allow(clippy::expect_used)]
    pub fn of(text: &str) -> Setting {
        let none = &mut |_: &Path| Err(std::io::ErrorKind::NotFound.into());
        let Scenario { world, channel, .. } =
            parse_scenario(text, Path::new("scenario"), none).expect("a committed scenario");
        let Kind::Simulated(simulated) = world else { unreachable!("a committed scenario is simulated") };
        Setting { simulated: *simulated, channel }
    }

    /// The contender of a name, told that packets arrive at the rate `p`.
    ///
    /// # Panics
    /// When the scenario has none of that name.
    #[allow(clippy::expect_used)]
    pub fn contender(&self, name: &str, p: f64) -> Contender {
        let found = self.simulated.contenders.iter().find(|c| c.name == name);
        let mut contender = found.expect("a contender of the committed scenario").clone();
        if let Receiver::Unstamped { .. } = contender.spec.link.receiver {
            contender.spec.link.arrival = Some(ArrivalSpec::Constant(p));
        }
        contender
    }

    /// With another noise of the turn rate: `variance · dt^power` in every step.
    pub fn turn_noise(mut self, variance: f64, power: u8) -> Setting {
        let specs = self.simulated.contenders.iter_mut().map(|c| &mut c.spec).chain([&mut self.simulated.truth]);
        for spec in specs {
            if let ModelSpec::Turn(turn) = &mut spec.model {
                (turn.turn_noise, turn.per_step) = (variance, Some(power));
            }
        }
        self
    }

    /// A channel of independent losses.
    ///
    /// # Panics
    /// When `p` is not an arrival rate above 0.
    #[allow(clippy::expect_used)]
    pub fn independent(&self, p: f64) -> Variant {
        let spec = ChannelSpec { loss: LossSpec::Bernoulli { loss_rates: vec![1.0 - p] }, ..self.channel.clone() };
        Variant::all(&spec, self.simulated.interval_s, None).expect("a loss rate from 0 to 1").remove(0)
    }

    /// A channel that loses the packets of the instants `lost`, from 1, of the first 100 and no others.
    ///
    /// # Panics
    /// Never: such a trace exists.
    #[allow(clippy::expect_used)]
    pub fn losing(&self, lost: &[usize]) -> Variant {
        let loss = LossSpec::Trace { file: String::new(), link: None };
        let packet = |k| {
            let received = !lost.contains(&k);
            TracePacket { received, delay_s: 0.0, copies: u32::from(received) }
        };
        let packets = (1..=100).map(packet).collect();
        let spec = ChannelSpec { loss, ..self.channel.clone() };
        Variant::all(&spec, self.simulated.interval_s, Some(packets)).expect("a trace without delays").remove(0)
    }

    /// Samples of every contender in `runs` runs: outer by contender, inner by run.
    ///
    /// # Panics
    /// When a contender of a committed scenario makes no estimator.
    #[allow(clippy::expect_used)]
    pub fn samples(
        &self,
        contenders: &[Contender],
        channel: &Variant,
        (effort, runs): (&Effort, std::ops::Range<usize>),
        progress: &(dyn Fn() + Sync),
    ) -> Vec<Vec<Sample>> {
        let by_run: Vec<Vec<Sample>> = runs
            .into_par_iter()
            .map(|run| {
                let world =
                    World::new(&self.simulated, channel, effort.seed, run as u64).expect("a committed scenario");
                let samples =
                    contenders.iter().map(|c| world.estimate(c).expect("a contender of a committed scenario"));
                let samples = samples.collect();
                progress();
                samples
            })
            .collect();
        transposed(by_run, contenders.len())
    }

    /// Scheduled runs of every contender: outer by contender, inner by run.
    ///
    /// # Panics
    /// As [`Setting::samples`].
    #[allow(clippy::expect_used)]
    pub fn scheduled(
        &self,
        contenders: &[(Contender, ScheduleSpec)],
        channel: &Variant,
        (effort, runs): (&Effort, usize),
        progress: &(dyn Fn() + Sync),
    ) -> Vec<Vec<Scheduled>> {
        let by_run: Vec<Vec<Scheduled>> = (0..runs)
            .into_par_iter()
            .map(|run| {
                let each = contenders.iter().map(|(contender, schedule)| {
                    scheduled(&self.simulated, contender, schedule, channel, effort.seed, run as u64)
                        .expect("a contender of a committed scenario")
                });
                let each = each.collect();
                progress();
                each
            })
            .collect();
        transposed(by_run, contenders.len())
    }

    /// The schedule of the scenario.
    ///
    /// # Panics
    /// When it has none.
    #[allow(clippy::expect_used)]
    pub fn schedule(&self) -> ScheduleSpec {
        self.simulated.schedule.clone().expect("a committed schedule")
    }
}

fn transposed<T>(by_run: Vec<Vec<T>>, contenders: usize) -> Vec<Vec<T>> {
    let mut out: Vec<Vec<T>> = (0..contenders).map(|_| Vec::with_capacity(by_run.len())).collect();
    for run in by_run {
        out.iter_mut().zip(run).for_each(|(of, sample)| of.push(sample));
    }
    out
}
