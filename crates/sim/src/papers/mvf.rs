//! \[MVF10\]: the two minimum-variance filters for packet losses, the sensor schedule, Figures 2 and 4–15, Table 1.
//!
//! The experiments are scenarios that a user can run: `examples/scenarios/mvf_*.toml`.

mod linear;
mod losses;
mod schedule;
#[cfg(test)]
mod tests;
mod world;

use super::{Account, Effort, Measured, Paper};

/// Returns the account. `progress` is called [`pieces`] times, from any thread.
pub fn account(effort: &Effort, progress: &(dyn Fn() + Sync)) -> Account {
    let (mut entries, mut figures) = (Vec::new(), Vec::new());
    for part in [linear::account, losses::account, schedule::account] {
        let (more, drawn) = part(effort, progress);
        entries.extend(more);
        figures.extend(drawn);
    }
    Account { paper: Paper::Mvf.name(), title: Paper::Mvf.title(), entries, figures }
}

/// Returns how often [`account`] reports progress.
pub fn pieces(effort: &Effort) -> usize {
    linear::pieces(effort) + losses::pieces(effort) + schedule::pieces(effort)
}

/// The median of `values`, with the standard error that its order statistics give: those about √n/2 places to either side are one standard
/// error off. Infinite values are runs that were lost.
fn median(values: &[f64]) -> Measured {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let count = sorted.len();
    let at = |place: f64| sorted[(place.max(0.0) as usize).min(count - 1)];
    let (middle, away) = ((count - 1) as f64 / 2.0, (count as f64).sqrt() / 2.0);
    let mean = (at(middle.floor()) + at(middle.ceil())) / 2.0;
    let se = (at((middle + away).round()) - at((middle - away).round())) / 2.0;
    Measured { mean, se, spread: 0.0 }
}

/// The share of `count` runs of which `hits` are, with its standard error.
fn share(hits: usize, count: usize) -> Measured {
    // Laplace's rule keeps the error of 0 of n off 0.
    let smooth = (hits as f64 + 1.0) / (count as f64 + 2.0);
    Measured { mean: hits as f64 / count as f64, se: (smooth * (1.0 - smooth) / count as f64).sqrt(), spread: 0.0 }
}
