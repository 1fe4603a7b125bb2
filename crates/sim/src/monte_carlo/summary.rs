//! What many runs say of one contender.

use super::run::Sample;

/// A mean over independent runs with its standard error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimated {
    /// The mean.
    pub mean: f64,
    /// Its standard error; 0 with a single run.
    pub se: f64,
}

impl Estimated {
    /// The mean of `values` in their order; NaN when there is none.
    pub fn of(values: impl Iterator<Item = f64> + Clone) -> Estimated {
        let count = values.clone().count() as f64;
        let mean = values.clone().sum::<f64>() / count;
        let square: f64 = values.map(|v| (v - mean) * (v - mean)).sum();
        let se = if count > 1.0 { (square / (count - 1.0) / count).sqrt() } else { 0.0 };
        Estimated { mean, se }
    }
}

/// One contender over all runs that it went through to the end.
#[derive(Clone, Debug, PartialEq)]
pub struct Summary {
    /// Its name.
    pub name: String,
    /// Runs.
    pub runs: usize,
    /// Runs that an error ended, and the first error.
    pub failed: usize,
    /// The first error.
    pub first_failure: Option<String>,
    /// Instants without an estimate, of all runs.
    pub missing: usize,
    /// Mean magnitude of the error of each state component.
    pub mean_abs: Vec<Estimated>,
    /// Sum over the states of the mean squared error.
    pub mse: Estimated,
    /// Sum over the states of the claimed variance.
    pub claimed: Estimated,
    /// Mean NEES over the number of states: 1 for a consistent estimator.
    pub anees: Estimated,
    /// Median over the runs of the root mean square position error, metres.
    pub median_position_m: Option<f64>,
    /// Share of runs that end more than 10 m off.
    pub lost_share: Option<Estimated>,
}

/// A target is lost when its estimate ends this far off.
const LOST_M: f64 = 10.0;

impl Summary {
    /// The summary of a contender's samples in the order of the runs.
    pub fn of<'a>(name: &str, samples: impl Iterator<Item = &'a Sample> + Clone) -> Summary {
        let good = samples.clone().filter(|s| s.failed.is_none());
        let n = samples.clone().next().map_or(0, |s| s.mean_abs.len());
        // A run that failed has lost its target.
        let position = |s: &Sample| match (&s.failed, s.position_m) {
            (None, Some((rms_m, last_m))) => (rms_m, last_m),
            _ => (f64::INFINITY, f64::INFINITY),
        };
        let planar = good.clone().any(|s| s.position_m.is_some());
        let mut rms: Vec<f64> = samples.clone().map(|s| position(s).0).collect();
        rms.sort_by(f64::total_cmp);
        let middle = |v: &[f64]| (v[(v.len() - 1) / 2] + v[v.len() / 2]) / 2.0;
        let lost = |s: &Sample| f64::from(u8::from(!(position(s).1 <= LOST_M)));
        Summary {
            name: name.to_owned(),
            runs: samples.clone().count(),
            failed: samples.clone().filter(|s| s.failed.is_some()).count(),
            first_failure: samples.clone().find_map(|s| s.failed.clone()),
            missing: samples.clone().map(|s| s.missing).sum(),
            mean_abs: (0..n).map(|i| Estimated::of(good.clone().map(move |s| s.mean_abs[i]))).collect(),
            mse: Estimated::of(good.clone().map(|s| s.mean_square.iter().sum())),
            claimed: Estimated::of(good.clone().map(|s| s.claimed.iter().sum())),
            anees: Estimated::of(good.clone().map(|s| s.nees)),
            median_position_m: planar.then(|| middle(&rms)),
            lost_share: planar.then(|| Estimated::of(samples.clone().map(lost))),
        }
    }
}
