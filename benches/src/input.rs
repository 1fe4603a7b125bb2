//! The input of all workloads: a smooth path and seeded noise.

use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;
use std::f64::consts::TAU;

/// Where the target is after `t` of its rounds: a figure that fills 80 m by 70 m.
pub fn path_m(t: f64) -> [f64; 2] {
    [40.0 * (TAU * t).sin(), 35.0 * (TAU * 1.4 * t + 0.5).sin()]
}

/// Measurements of what `expected` says at each step, with noise of standard deviation `sd`.
pub fn measured<const Q: usize>(
    steps: usize,
    seed: u64,
    sd: f64,
    expected: impl Fn(usize) -> [f64; Q],
) -> Vec<[f64; Q]> {
    let mut rng = Pcg64::seed_from_u64(seed);
    (0..steps).map(|k| expected(k).map(|value| value + sd * rng.sample::<f64, _>(StandardNormal))).collect()
}
