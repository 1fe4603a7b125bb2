//! Window and lag of estimators with a finite memory.

use crate::merit::{Recording, lagged_rmse, lagged_sd, prediction_error};
use fixtrail_track::spec::{EstimatorSpec, Span, Spec};

/// Windows that are tried, in instants.
const WINDOWS: [usize; 12] = [3, 4, 5, 6, 8, 10, 13, 17, 23, 30, 40, 60];
/// Lags that are tried, in instants, as far as they lie in the window.
const LAGS: [usize; 15] = [0, 1, 2, 3, 4, 5, 6, 8, 10, 13, 17, 23, 30, 40, 59];
/// By how much more than the best a shorter lag may err: what it would gain comes later.
const WORTH_A_DELAY: f64 = 0.02;

/// What was tried.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Windows {
    /// Windows in instants, with the mean squared prediction error in variances of the sensor's noise.
    pub windows: Vec<(usize, f64)>,
    /// Lags in instants, with the root mean square error of the smoothed position, or what stands for it; empty for a filter.
    pub lags: Vec<(usize, f64)>,
    /// Whether the lags were judged by known positions; else by the standard deviation that is claimed.
    pub by_truth: bool,
}

/// Puts the best window into `spec`, and then the best lag.
///
/// The window has the least mean squared prediction error, the mean of `(z − C x̂)²` of measurements that the estimate has not seen: with the
/// wrong noise it has a finite optimum, and it is that of the true error since `E[(z − C x̂)²] = C P Cᵀ + R` (notes on windows). The lag is the
/// smallest whose smoothed positions err by at most 2 % more than the best one's; without known positions, whose claimed standard deviation is
/// larger by at most 2 %.
pub(crate) fn choose(spec: &mut Spec, recordings: &[Recording], shift_s: &[f64], tried: &dyn Fn(u64)) -> Windows {
    let mut out = Windows::default();
    let mut least_unforetold = usize::MAX;
    let mut found = Vec::new();
    for window in WINDOWS {
        let error = prediction_error(&with(spec, window, 0), recordings, shift_s);
        tried(1);
        if let Some(error) = &error {
            least_unforetold = least_unforetold.min(error.unforetold);
        }
        found.push((window, error));
    }
    for (window, error) in found {
        // A window too short to know the state foretells the easy part.
        let fair = error.filter(|e| 100 * (e.unforetold - least_unforetold) <= e.scalars);
        out.windows.push((window, fair.map_or(f64::INFINITY, |e| e.mean_square)));
    }
    let Some(window) = least(&out.windows).map(|(window, _)| window) else { return out };
    *spec = with(spec, window, 0);
    if !matches!(spec.estimator, EstimatorSpec::Fms { .. }) {
        return out;
    }
    for lag in LAGS.into_iter().filter(|lag| *lag < window) {
        let spec = with(spec, window, lag);
        let error = lagged_rmse(&spec, recordings, shift_s);
        tried(1);
        out.by_truth |= error.is_some();
        let error = error.or_else(|| lagged_sd(&spec, recordings, shift_s));
        out.lags.push((lag, error.unwrap_or(f64::INFINITY)));
    }
    if let Some((_, best)) = least(&out.lags) {
        let near = out.lags.iter().find(|(_, error)| *error <= (1.0 + WORTH_A_DELAY) * best);
        *spec = with(spec, window, near.map_or(0, |(lag, _)| *lag));
    }
    out
}

fn with(spec: &Spec, window: usize, lag: usize) -> Spec {
    let mut spec = spec.clone();
    match &mut spec.estimator {
        EstimatorSpec::Fms { window: w, lag: l, .. } => (*w, *l) = (Span::Instants(window), Span::Instants(lag)),
        EstimatorSpec::Ufir { window: w } => *w = Span::Instants(window),
        _ => {}
    }
    spec
}

fn least(of: &[(usize, f64)]) -> Option<(usize, f64)> {
    of.iter().copied().filter(|(_, error)| error.is_finite()).min_by(|a, b| a.1.total_cmp(&b.1))
}
