//! What theory says of a scenario in the long run: the steady state of the Riccati recursions.

use fixtrail_track::spec::{EstimatorSpec, Simulated, Span};
use fixtrail_track::theory::{Theory, smoothed, theory};

/// The long run of a linear scenario at one loss rate.
#[derive(Clone, Debug, PartialEq)]
pub struct LongRun {
    /// Prediction and filter.
    pub theory: Theory,
    /// Lags of the contenders, then all later data (`None`): standard deviation of each component, nothing lost.
    pub lags: Vec<(Option<u32>, Vec<f64>)>,
}

impl LongRun {
    /// The long run where targets move as a linear model says; `None` of others.
    pub fn of(scenario: &Simulated, arrival: f64) -> Option<LongRun> {
        if scenario.motion.is_some() || !scenario.noisy {
            return None;
        }
        let interval_s = Some(scenario.interval_s);
        let theory = theory(&scenario.truth, interval_s, arrival).ok()?;
        let of_contenders = scenario.contenders.iter().filter_map(|c| lag(&c.spec.estimator, scenario.interval_s));
        let mut lags: Vec<u32> = of_contenders.filter(|lag| *lag > 0).collect();
        lags.sort_unstable();
        lags.dedup();
        let lags: Vec<Option<u32>> = lags.into_iter().map(Some).chain([None]).collect();
        let found = smoothed(&scenario.truth, interval_s, &lags).ok()?;
        Some(LongRun { theory, lags: lags.into_iter().zip(found).filter_map(|(lag, sds)| Some((lag, sds?))).collect() })
    }
}

/// The lag of an estimator in instants.
fn lag(estimator: &EstimatorSpec, interval_s: f64) -> Option<u32> {
    match estimator {
        EstimatorSpec::FixedLagKalman { lag } | EstimatorSpec::Fms { lag, .. } => match lag {
            Span::Instants(lag) => u32::try_from(*lag).ok(),
            // Due at exactly the lag.
            Span::Seconds(lag_s) => Some((lag_s / interval_s - 1e-9).ceil().max(0.0) as u32),
        },
        _ => None,
    }
}
