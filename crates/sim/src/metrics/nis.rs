//! Normalised innovation squared: what a filter's own surprises say about it.

use super::stats::mean_band95;
use fixtrail_track::trail::Trail;

/// Innovations of trails, summed up. A consistent filter has a ratio near 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Nis {
    /// Instants that have an innovation.
    pub instants: usize,
    /// Scalar measurements behind them.
    pub dof: usize,
    /// Sum of the NIS over the sum of its degrees of freedom: 1 is expected.
    pub ratio: f64,
    /// Central 95 % interval of `ratio` if the filter is consistent; innovations of a consistent filter are independent.
    pub band95: (f64, f64),
}

/// The innovation statistics of `trails` together; `None` when no instant has any.
pub fn nis<'a>(trails: impl IntoIterator<Item = &'a Trail>) -> Option<Nis> {
    let (mut instants, mut dof, mut sum) = (0, 0, 0.0);
    for trail in trails {
        for (value, n) in trail.nis.iter().zip(&trail.nis_dof) {
            if let (Some(value), true) = (value, *n > 0) {
                instants += 1;
                dof += *n as usize;
                sum += value;
            }
        }
    }
    Nis::of(instants, dof, sum)
}

impl Nis {
    /// The statistics of `instants` with `dof` scalar measurements whose normalised innovations squared add up to `sum`; `None` without any.
    pub fn of(instants: usize, dof: usize, sum: f64) -> Option<Nis> {
        let (low, high) = mean_band95(1, dof)?;
        let scale = 1.0 / dof as f64;
        Some(Nis { instants, dof, ratio: sum * scale, band95: (low * scale, high * scale) })
    }
}
