//! All targets of a table tracked by one spec: what `track` and `compare` share.

use crate::data::SpecText;
use crate::failure::Failure;
use crate::progress::Progress;
use fixtrail_batch::{Table, run_tracks};
use fixtrail_track::pipeline::{TrackError, track};
use fixtrail_track::target::TargetTrail;
use fixtrail_track::trackers::LaggedMode;
use std::time::Instant;

/// What a run made.
pub struct Tracked {
    /// One trail per target, in the order of the table.
    pub trails: Vec<TargetTrail>,
    /// How long it took by the clock.
    pub seconds: f64,
}

/// Tracks every target of a table, called `input` in messages.
///
/// # Errors
/// [`Failure::Bad`] when the spec does not make an estimator, [`Failure::Run`] when a step cannot be taken.
pub fn tracks(
    input: &str,
    table: &Table,
    spec: &SpecText,
    mode: LaggedMode,
    bar: &Progress,
) -> Result<Tracked, Failure> {
    let started = Instant::now();
    let one = |target: &_| track(&spec.spec, &table.anchors, target, mode);
    let trails = run_tracks(table, one, &|n| bar.add(n)).map_err(|e| match e {
        TrackError::Build(e) => Failure::from(spec.rename(e)),
        step => Failure::Run(format!("{input}: {step}")),
    })?;
    Ok(Tracked { trails, seconds: started.elapsed().as_secs_f64() })
}
