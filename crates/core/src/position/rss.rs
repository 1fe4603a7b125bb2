//! Distance from signal strength.

use crate::sensors::PathLoss;
use core::f64::consts::LN_10;

/// A distance that a signal strength stands for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RssRange {
    /// Median-unbiased: as often too long as too short. Metres.
    pub median_m: f64,
    /// Standard deviation of the logarithm of the distance, `κ = ln 10 σ/(10 n)`.
    pub kappa: f64,
    /// Unbiased in the mean, metres.
    pub unbiased_m: f64,
    /// Variance that goes with `unbiased_m`, m².
    pub var_m2: f64,
}

impl RssRange {
    /// Mean of the median-unbiased distance over the true one: `exp(κ²/2)`.
    pub fn median_bias(&self) -> f64 {
        libm::exp(0.5 * self.kappa * self.kappa)
    }
}

/// Returns the distance at which the log-distance law of \[FOSB12\] expects `rss_dbm`, for a strength with Gaussian noise of `sd_db`.
///
/// ```text
/// median     d = 10^((P₁ − P)/(10 n))
/// unbiased   d_u = d exp(−κ²/2),  var = d_u² (exp(κ²) − 1),  κ = ln 10 σ/(10 n)
/// ```
///
/// The error is log-normal. The variance is formed with `expm1`: for little noise it keeps its digits.
pub fn to_range(law: PathLoss, rss_dbm: f64, sd_db: f64) -> RssRange {
    let per_db = LN_10 / (10.0 * law.exponent);
    let kappa = per_db * sd_db;
    let square = kappa * kappa;
    let median_m = libm::exp((law.at_1m_dbm - rss_dbm) * per_db);
    let unbiased_m = median_m * libm::exp(-0.5 * square);
    RssRange { median_m, kappa, unbiased_m, var_m2: unbiased_m * unbiased_m * libm::expm1(square) }
}
