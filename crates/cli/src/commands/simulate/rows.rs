//! Results run by run, for `--results`.

use super::Table;
use fixtrail_batch::{Cell, Holds, Plain};

/// One row per channel, run and contender.
pub fn table(results: &[Table]) -> Plain {
    let columns = [
        ("loss_rate", Holds::Numbers),
        ("run", Holds::Counts),
        ("contender", Holds::Names),
        ("rmse", Holds::Numbers),
        ("last_error", Holds::Numbers),
        ("mse", Holds::Numbers),
        ("claimed", Holds::Numbers),
        ("nees", Holds::Numbers),
        ("nis", Holds::Numbers),
        ("coverage50", Holds::Numbers),
        ("coverage95", Holds::Numbers),
        ("lost", Holds::Counts),
        ("missing", Holds::Counts),
        ("energy_mj", Holds::Numbers),
        ("time_steps", Holds::Numbers),
        ("failed", Holds::Names),
    ];
    let number = |v: Option<f64>| v.map_or(Cell::Absent, Cell::Number);
    let mut rows = Vec::new();
    for one in results {
        for (run, samples) in one.outcome.runs.iter().enumerate() {
            for (sample, summary) in samples.iter().zip(&one.outcome.contenders) {
                let any = |v: f64| number((sample.estimated > 0).then_some(v));
                rows.push(vec![
                    Cell::Number(one.loss_rate),
                    Cell::Count(run as u64),
                    Cell::Name(summary.name.clone()),
                    any(sample.rms()),
                    number(sample.position_m.map(|(_, last_m)| last_m)),
                    any(sample.mean_square.iter().sum()),
                    any(sample.claimed.iter().sum()),
                    any(sample.nees),
                    number(sample.nis.map(|(nis, _)| nis)),
                    any(sample.coverage[0]),
                    any(sample.coverage[1]),
                    Cell::Count(u64::from(sample.lost)),
                    Cell::Count(sample.missing as u64),
                    number(sample.energy_mj),
                    number(sample.time_steps),
                    sample.failed.clone().map_or(Cell::Absent, Cell::Name),
                ]);
            }
        }
    }
    Plain { columns: columns.map(|(name, holds)| (name.to_owned(), holds)).to_vec(), rows }
}
