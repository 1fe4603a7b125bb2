//! One tracker per target, all processors at work, the same result whatever their number.

use crate::table::Table;
use fixtrail_track::target::{TargetPackets, TargetTrail};
use rayon::prelude::*;

/// Returns the trail that `make` makes of each target, in the order of the table.
///
/// Targets run in parallel on the current rayon pool. `progress` is called with the number of packets of each target as
/// it is done, from any thread.
///
/// # Errors
/// The error of the first target (in the order of the table) that has one, whatever the number of threads.
pub fn run_tracks<F, E>(table: &Table, make: F, progress: &(dyn Fn(u64) + Sync)) -> Result<Vec<TargetTrail>, E>
where
    F: Fn(&TargetPackets) -> Result<TargetTrail, E> + Sync,
    E: Send,
{
    let trails: Vec<Result<TargetTrail, E>> = table
        .targets
        .par_iter()
        .map(|target| {
            let trail = make(target);
            progress(target.packets.len() as u64);
            trail
        })
        .collect();
    trails.into_iter().collect()
}
