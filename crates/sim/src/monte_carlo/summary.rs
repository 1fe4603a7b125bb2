//! What many runs say of one contender.

use super::sample::Sample;
use super::verdict::Verdict;
use crate::metrics::{Histogram, mean_band95};

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

    /// The square root; its error is that of the mean over twice the root.
    pub fn root(self) -> Estimated {
        let mean = self.mean.sqrt();
        Estimated { mean, se: if mean > 0.0 { 0.5 * self.se / mean } else { 0.0 } }
    }
}

/// Shares of the errors whose quantiles are told.
pub const QUANTILES: [f64; 4] = [0.5, 0.6, 0.9, 0.95];

/// Points of a distribution's curve.
const CURVE: usize = 200;

/// All runs at one instant.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Moment {
    /// Runs with an estimate.
    pub count: u64,
    /// Sum of their squared errors.
    pub square: f64,
    /// Sum of the variances that they claim.
    pub claimed: f64,
    /// Sum of NEES over the number of components.
    pub nees: f64,
    /// Sum of NIS.
    pub nis: f64,
    /// Its degrees of freedom.
    pub nis_dof: u64,
}

/// One contender over all runs that it went through to the end with an estimate.
#[derive(Clone, Debug, PartialEq)]
pub struct Summary {
    /// Its name.
    pub name: String,
    /// Whether its estimates know what came after the instant that they describe.
    pub smoothed: bool,
    /// Runs.
    pub runs: usize,
    /// Runs that an error ended.
    pub failed: usize,
    /// The first error.
    pub first_failure: Option<String>,
    /// Instants without an estimate, of all runs.
    pub missing: usize,
    /// Root mean square error: of the position, metres, or of a linear model's state.
    pub rmse: Estimated,
    /// Root mean variance that is claimed for them.
    pub claimed_rms: Option<f64>,
    /// The same errors of all instants and runs together: half of them, 60 %, 90 % and 95 % are smaller. Empty without any.
    pub quantiles: Vec<f64>,
    /// Their distribution: sizes below which evenly spaced shares from 0 to 1 lie.
    pub curve: Vec<f64>,
    /// Mean magnitude of the error of each state component.
    pub mean_abs: Vec<Estimated>,
    /// Sum over the states of the mean squared error.
    pub mse: Estimated,
    /// Sum over the states of the claimed variance.
    pub claimed: Estimated,
    /// Mean NEES over the number of states: 1 for a consistent estimator.
    pub anees: Estimated,
    /// Central 95 % interval of `anees` for a consistent estimator if the instants of a run told no more than one of them: by runs. Instants
    /// are correlated, so the mean of a consistent estimator is inside more often.
    pub anees_band: Option<(f64, f64)>,
    /// Mean NIS over its degrees of freedom.
    pub anis: Option<Estimated>,
    /// Central 95 % interval of `anis` for a consistent filter, whose innovations are independent: by runs and instants.
    pub anis_band: Option<(f64, f64)>,
    /// Share of the instants inside the claimed 50 % and 95 % ellipse.
    pub coverage: [Estimated; 2],
    /// Median over the runs of the root mean square position error, metres.
    pub median_position_m: Option<f64>,
    /// Share of runs that end further off than the scenario allows.
    pub lost_share: Option<Estimated>,
    /// Energy that a run spends on measuring, millijoules.
    pub energy_mj: Option<Estimated>,
    /// Instants of a run at which is measured.
    pub time_steps: Option<Estimated>,
    /// Whether it errs as it claims.
    pub verdict: Verdict,
    /// Number of state components that are compared: the degrees of freedom of NEES.
    pub components: usize,
    /// The runs at each instant from 1 on.
    pub over_time: Vec<Moment>,
}

/// One contender's samples, taken in the order of the runs.
#[derive(Clone, Debug, Default)]
pub struct Collected {
    samples: Vec<Sample>,
    errors: Histogram,
    over_time: Vec<Moment>,
}

impl Collected {
    /// Takes the sample of the next run.
    pub fn take(&mut self, mut sample: Sample) {
        if sample.failed.is_none() {
            self.over_time.resize(sample.instants.len().max(self.over_time.len()), Moment::default());
            for (moment, instant) in self.over_time.iter_mut().zip(&sample.instants) {
                let Some(instant) = instant else { continue };
                self.errors.add(instant.error);
                moment.count += 1;
                moment.square += instant.error * instant.error;
                moment.claimed += instant.claimed;
                moment.nees += instant.nees;
                if let Some((nis, dof)) = instant.nis {
                    moment.nis += nis;
                    moment.nis_dof += u64::from(dof);
                }
            }
        }
        sample.instants = Vec::new();
        self.samples.push(sample);
    }

    /// What they say together, and the samples.
    pub fn summary(self, name: &str, smoothed: bool) -> (Summary, Vec<Sample>) {
        let samples = self.samples.iter();
        let good = samples.clone().filter(|s| s.failed.is_none() && s.estimated > 0);
        let n = samples.clone().next().map_or(0, |s| s.mean_abs.len());
        // A run that failed has lost its target.
        let position = |s: &Sample| match (&s.failed, s.position_m) {
            (None, Some((rms_m, _))) => rms_m,
            _ => f64::INFINITY,
        };
        let planar = good.clone().any(|s| s.position_m.is_some());
        let mut rms: Vec<f64> = samples.clone().map(position).collect();
        rms.sort_by(f64::total_cmp);
        let middle = |v: &[f64]| (v[(v.len() - 1) / 2] + v[v.len() / 2]) / 2.0;
        let some = |values: Vec<f64>| (!values.is_empty()).then(|| Estimated::of(values.into_iter()));
        let dof: u64 = good.clone().filter_map(|s| s.nis).map(|(_, dof)| dof).sum();
        let scaled = |band: Option<(f64, f64)>, dof: usize| band.map(|(a, b)| (a / dof as f64, b / dof as f64));
        let claims = self.over_time.iter().map(|m| m.claimed).sum::<f64>();
        let points: Vec<f64> = (0..=CURVE).map(|i| i as f64 / CURVE as f64).collect();
        let summary = Summary {
            name: name.to_owned(),
            smoothed,
            runs: samples.len(),
            failed: samples.clone().filter(|s| s.failed.is_some()).count(),
            first_failure: samples.clone().find_map(|s| s.failed.clone()),
            missing: samples.clone().map(|s| s.missing).sum(),
            rmse: Estimated::of(good.clone().map(|s| s.rms() * s.rms())).root(),
            claimed_rms: (self.errors.count() > 0).then(|| (claims / self.errors.count() as f64).sqrt()),
            quantiles: self.errors.quantiles(&QUANTILES),
            curve: self.errors.quantiles(&points),
            mean_abs: (0..n).map(|i| Estimated::of(good.clone().map(move |s| s.mean_abs[i]))).collect(),
            mse: Estimated::of(good.clone().map(|s| s.mean_square.iter().sum())),
            claimed: Estimated::of(good.clone().map(|s| s.claimed.iter().sum())),
            anees: Estimated::of(good.clone().map(|s| s.nees)),
            anees_band: scaled(mean_band95(good.clone().count(), n), n),
            anis: some(good.clone().filter_map(|s| s.nis).map(|(nis, _)| nis).collect()),
            anis_band: scaled(mean_band95(1, dof as usize), dof as usize),
            coverage: [0, 1].map(|i| Estimated::of(good.clone().map(move |s| s.coverage[i]))),
            median_position_m: planar.then(|| middle(&rms)),
            lost_share: planar.then(|| Estimated::of(samples.clone().map(|s| f64::from(u8::from(s.lost))))),
            energy_mj: some(good.clone().filter_map(|s| s.energy_mj).collect()),
            time_steps: some(good.clone().filter_map(|s| s.time_steps).collect()),
            verdict: Verdict::of(samples.clone()),
            components: n,
            over_time: self.over_time,
        };
        (summary, self.samples)
    }
}
