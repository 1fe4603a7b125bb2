//! Many runs of one scenario: targets, measurements, a channel, and every contender's estimate of every instant.
//!
//! A run depends on the scenario's seed and its own number alone, and sums are taken in the order of the runs: the result does not depend
//! on the number of threads.

mod received;
mod run;
mod summary;

pub use received::{Arrival, Reception, Shown, receive};
pub(crate) use run::field;
pub use run::{Sample, World};
pub use summary::{Estimated, Summary};

use crate::channels::{DesignError, Variant};
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
    let contenders: Vec<Contender> = scenario.contenders.iter().map(|c| informed(c, channel)).collect();
    let runs: Vec<Result<Vec<Sample>, ScenarioError>> = (0..scenario.runs as u64)
        .into_par_iter()
        .map(|number| {
            let world = World::new(scenario, channel, seed, number)?;
            let samples = contenders.iter().map(|c| world.estimate(c)).collect();
            progress();
            samples
        })
        .collect();
    let runs: Vec<Vec<Sample>> = runs.into_iter().collect::<Result<_, _>>()?;
    Ok(contenders.iter().enumerate().map(|(i, c)| Summary::of(&c.name, runs.iter().map(|run| &run[i]))).collect())
}

/// The contender, told the channel's arrival rate where its spec says nothing.
fn informed(contender: &Contender, channel: &Variant) -> Contender {
    let mut contender = contender.clone();
    let link = &mut contender.spec.link;
    if link.arrival.is_none() && matches!(link.receiver, Receiver::Unstamped { .. }) {
        link.arrival = Some(ArrivalSpec::Constant(1.0 - channel.loss_rate));
    }
    contender
}
