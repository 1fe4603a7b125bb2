//! Order statistics: what a survey can say of data that may hold anything.

/// A standard deviation is this many times the median absolute deviation of a normal variable.
pub(super) const MAD_TO_SD: f64 = 1.482_602_218_505_602;

/// The `p` quantile of values in ascending order, interpolated; `None` of nothing.
pub(super) fn quantile(sorted: &[f64], p: f64) -> Option<f64> {
    let last = sorted.len().checked_sub(1)?;
    let place = p * last as f64;
    let below = place.floor() as usize;
    let above = (below + 1).min(last);
    Some(sorted[below] + (sorted[above] - sorted[below]) * (place - below as f64))
}

/// The values in ascending order.
pub(super) fn ascending(values: impl IntoIterator<Item = f64>) -> Vec<f64> {
    let mut sorted: Vec<f64> = values.into_iter().collect();
    sorted.sort_unstable_by(f64::total_cmp);
    sorted
}

/// The median; `None` of nothing.
pub(super) fn median(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    quantile(&ascending(values), 0.5)
}

/// The standard deviation of normal values of mean 0 with the same median magnitude; gross outliers hardly move it.
pub(super) fn robust_sd(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    median(values.into_iter().map(f64::abs)).map(|m| m * MAD_TO_SD)
}

/// Quantiles of a set of values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quantiles {
    /// Smallest value.
    pub min: f64,
    /// 5 % quantile.
    pub p05: f64,
    /// Median.
    pub p50: f64,
    /// 95 % quantile.
    pub p95: f64,
    /// Largest value.
    pub max: f64,
}

impl Quantiles {
    /// The quantiles of `values`; `None` of nothing.
    pub(super) fn of(values: impl IntoIterator<Item = f64>) -> Option<Quantiles> {
        let sorted = ascending(values);
        let at = |p| quantile(&sorted, p);
        Some(Quantiles { min: at(0.0)?, p05: at(0.05)?, p50: at(0.5)?, p95: at(0.95)?, max: at(1.0)? })
    }
}
