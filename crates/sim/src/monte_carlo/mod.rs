//! Many runs of one scenario: targets, measurements, a channel, and every contender's estimate of every instant.
//!
//! A run depends on the scenario's seed and its own number alone, and sums are taken in the order of the runs: the result does not depend
//! on the number of threads.

mod bound;
mod long_run;
mod received;
mod run;
mod sample;
mod summary;
mod verdict;

pub use bound::Bound;
pub use long_run::LongRun;
pub use received::{Arrival, Reception, Shown, receive};
pub use run::World;
pub(crate) use run::{field, streams};
pub use sample::{Instant, LOST_NEES, Sample};
pub(crate) use sample::{Judge, Told};
pub use summary::{Estimated, Moment, QUANTILES, Summary};
pub use verdict::{Claim, Verdict};

use self::bound::Bounds;
use self::summary::Collected;
use crate::channels::{DesignError, Variant};
use crate::scheduling::scheduled;
use fixtrail_track::error::BuildError;
use fixtrail_track::spec::{ArrivalSpec, Contender, Receiver, Simulated};
use rayon::prelude::*;

/// Why a scenario cannot be run.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ScenarioError {
    /// Its channel cannot exist.
    #[error(transparent)]
    Channel(#[from] DesignError),
    /// Its numbers make no estimator.
    #[error(transparent)]
    Build(#[from] BuildError),
}

/// What the runs of a scenario over one channel say.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// One for each contender.
    pub contenders: Vec<Summary>,
    /// What no causal estimate can do better, or why that is not known.
    pub bound: Result<Bound, &'static str>,
    /// What theory says in the long run, where the scenario is linear.
    pub long_run: Option<LongRun>,
    /// What each run says of each contender.
    pub runs: Vec<Vec<Sample>>,
}

/// Runs a scenario over one channel. `progress` is called once for each run done, from any thread.
///
/// # Errors
/// [`ScenarioError`] of the first run that has one. An estimator that fails within a run is counted, not an error.
pub fn monte_carlo(
    scenario: &Simulated,
    channel: &Variant,
    seed: u64,
    progress: &(dyn Fn() + Sync),
) -> Result<Vec<Summary>, ScenarioError> {
    outcome(scenario, channel, seed, progress).map(|outcome| outcome.contenders)
}

/// As [`monte_carlo`], with the bound and what each run says.
///
/// # Errors
/// As [`monte_carlo`].
pub fn outcome(
    scenario: &Simulated,
    channel: &Variant,
    seed: u64,
    progress: &(dyn Fn() + Sync),
) -> Result<Outcome, ScenarioError> {
    let contenders: Vec<Contender> = scenario.contenders.iter().map(|c| informed(c, channel)).collect();
    let no_bound = bound::missing(scenario);
    let arrival = 1.0 - channel.loss_rate;
    let run = |number: usize| -> Result<(Vec<Sample>, Vec<Vec<f64>>), ScenarioError> {
        if let Some(schedule) = &scenario.schedule {
            let of = |c: &Contender| {
                let schedule = c.schedule.as_ref().unwrap_or(schedule);
                scheduled(scenario, c, schedule, channel, seed, number as u64)?.sample(scenario)
            };
            let samples = contenders.iter().map(of).collect::<Result<_, _>>()?;
            progress();
            return Ok((samples, Vec::new()));
        }
        let world = World::new(scenario, channel, seed, number as u64)?;
        let samples = contenders.iter().map(|c| world.estimate(c)).collect::<Result<_, _>>()?;
        let bound = if no_bound.is_none() { world.bound(arrival) } else { Vec::new() };
        progress();
        Ok((samples, bound))
    };
    let mut collected = vec![Collected::default(); contenders.len()];
    let mut bounds = Bounds::new(scenario);
    // Whatever is kept of every instant is summed up in the order of the runs, some of them at a time: room for all would be too much.
    let at_once = 32 * rayon::current_num_threads();
    for first in (0..scenario.runs).step_by(at_once) {
        let last = scenario.runs.min(first + at_once);
        let runs: Vec<_> = (first..last).into_par_iter().map(run).collect();
        for one in runs {
            let (samples, bound) = one?;
            collected.iter_mut().zip(samples).for_each(|(c, sample)| c.take(sample));
            if no_bound.is_none() {
                bounds.take(&bound);
            }
        }
    }
    let (summaries, samples): (Vec<Summary>, Vec<Vec<Sample>>) =
        contenders.iter().zip(collected).map(|(c, all)| all.summary(&c.name, c.smoothed)).unzip();
    let mut by_contender: Vec<_> = samples.into_iter().map(Vec::into_iter).collect();
    let runs = (0..scenario.runs).map(|_| by_contender.iter_mut().filter_map(Iterator::next).collect()).collect();
    let bound = match no_bound {
        Some(why) => Err(why),
        None => bounds.mean().ok_or("there are no runs"),
    };
    Ok(Outcome { contenders: summaries, bound, long_run: LongRun::of(scenario, arrival), runs })
}

/// The contender, told the channel's arrival rate where its spec says nothing.
pub fn informed(contender: &Contender, channel: &Variant) -> Contender {
    let mut contender = contender.clone();
    let link = &mut contender.spec.link;
    if link.arrival.is_none() && matches!(link.receiver, Receiver::Unstamped { .. }) {
        link.arrival = Some(ArrivalSpec::Constant(1.0 - channel.loss_rate));
    }
    contender
}
