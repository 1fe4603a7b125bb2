//! What a contender made of one run, compared with the truth.

use crate::metrics::{chi_square_quantile, nees};
use fixtrail_track::layout::Layout;
use fixtrail_track::simulator::Simulator;

/// A linear run has lost its target when the NEES over the number of states exceeds this on average over its last tenth: errors of ten
/// claimed standard deviations.
pub const LOST_NEES: f64 = 100.0;

/// What a contender made of one run. Errors are those of the estimate of an instant, from instant 1 on.
#[derive(Clone, Debug, PartialEq)]
pub struct Sample {
    /// Mean magnitude of the error of each state component that the truth has.
    pub mean_abs: Vec<f64>,
    /// Mean square of the same.
    pub mean_square: Vec<f64>,
    /// Mean claimed variance of the same.
    pub claimed: Vec<f64>,
    /// Mean of the normalised estimation error squared, over the number of those components.
    pub nees: f64,
    /// Normalised innovations squared over their degrees of freedom, and how many these are.
    pub nis: Option<(f64, u64)>,
    /// Share of the instants whose truth is inside the claimed 50 % and 95 % ellipse of the position, or of a linear model's state.
    pub coverage: [f64; 2],
    /// Root mean square and last distance of the estimated from the true position, metres.
    pub position_m: Option<(f64, f64)>,
    /// Whether the target was lost.
    pub lost: bool,
    /// Instants with an estimate.
    pub estimated: usize,
    /// Instants without one.
    pub missing: usize,
    /// Why the run ended early.
    pub failed: Option<String>,
    /// Energy that was spent on measuring, millijoules.
    pub energy_mj: Option<f64>,
    /// Instants at which was measured.
    pub time_steps: Option<f64>,
    /// What it said of each instant from 1 on; nothing once a summary has taken it.
    pub instants: Vec<Option<Instant>>,
}

impl Sample {
    /// Root of the mean square: of the distance from the true position, metres, or of a linear model's state.
    pub fn rms(&self) -> f64 {
        self.position_m.map_or_else(|| self.mean_square.iter().sum::<f64>().sqrt(), |(rms_m, _)| rms_m)
    }
}

/// One estimate beside the truth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Instant {
    /// Distance from the true position, or from a linear model's state.
    pub error: f64,
    /// Variance that is claimed for it.
    pub claimed: f64,
    /// Normalised estimation error squared over the number of components.
    pub nees: f64,
    /// Normalised innovation squared and its degrees of freedom.
    pub nis: Option<(f64, u32)>,
}

/// An estimate of one instant.
#[derive(Clone, Debug, PartialEq)]
pub struct Told {
    /// Mean.
    pub mean: Vec<f64>,
    /// Covariance.
    pub cov: Vec<f64>,
    /// Normalised innovation squared and its degrees of freedom.
    pub nis: Option<(f64, u32)>,
}

/// What estimates of a scenario are compared by.
pub struct Judge {
    /// Coordinates of the position; 0 in a linear model.
    axes: usize,
    /// Components that the ellipses are of.
    region: usize,
    /// Squared Mahalanobis distances of the 50 % and the 95 % ellipse.
    limits: [f64; 2],
    lost_m: f64,
}

impl Judge {
    /// The judge of a scenario's layout, where a target more than `lost_m` off at the end is lost.
    pub fn new(layout: &Layout, lost_m: f64) -> Judge {
        // As in comparisons of trails: a region of the plane.
        let region = if layout.is_linear() { layout.n() } else { layout.axes.min(2) };
        let limits = [0.5, 0.95].map(|p| chi_square_quantile(region, p));
        Judge { axes: layout.axes, region, limits, lost_m }
    }

    /// Compares estimates with the true states, of which the first components may be known alone.
    pub fn sample(
        &self,
        simulator: &dyn Simulator,
        states: &[Vec<f64>],
        estimates: &[Option<Told>],
        failed: Option<String>,
    ) -> Sample {
        let n = simulator.n();
        let known = states.first().map_or(0, Vec::len);
        let mut sample = Sample {
            mean_abs: vec![0.0; known],
            mean_square: vec![0.0; known],
            claimed: vec![0.0; known],
            nees: 0.0,
            nis: None,
            coverage: [0.0; 2],
            position_m: None,
            lost: false,
            estimated: 0,
            missing: 0,
            failed,
            energy_mj: None,
            time_steps: None,
            instants: Vec::with_capacity(states.len().saturating_sub(1)),
        };
        let (mut square_m2, mut last_m) = (0.0, 0.0);
        let (mut nis, mut nis_dof) = (0.0, 0);
        for (x, told) in states.iter().zip(estimates).skip(1) {
            let Some(Told { mean, cov, nis: innovation }) = told else {
                sample.missing += 1;
                sample.instants.push(None);
                continue;
            };
            sample.estimated += 1;
            let error: Vec<f64> = mean.iter().zip(x).map(|(a, b)| a - b).collect();
            for i in 0..known {
                sample.mean_abs[i] += error[i].abs();
                sample.mean_square[i] += error[i] * error[i];
                sample.claimed[i] += cov[i * n + i];
            }
            let whole = if known == n { simulator.nees(&error, cov) } else { nees(&error, cov, n, known) };
            let own = whole.unwrap_or(f64::INFINITY) / known as f64;
            sample.nees += own;
            let out = if self.region == n { whole } else { nees(&error, cov, n, self.region) };
            for (covered, limit) in sample.coverage.iter_mut().zip(self.limits) {
                *covered += f64::from(u8::from(out.is_some_and(|out| out <= limit)));
            }
            let shown = if self.axes > 0 { self.axes } else { known };
            let square: f64 = error[..shown].iter().map(|e| e * e).sum();
            square_m2 += square;
            last_m = square.sqrt();
            if let Some((value, dof)) = innovation {
                nis += value;
                nis_dof += u64::from(*dof);
            }
            let claimed = (0..shown).map(|i| cov[i * n + i]).sum();
            sample.instants.push(Some(Instant { error: last_m, claimed, nees: own, nis: *innovation }));
        }
        if sample.estimated > 0 {
            let count = sample.estimated as f64;
            let means = sample.mean_abs.iter_mut().chain(&mut sample.mean_square).chain(&mut sample.claimed);
            means.chain(&mut sample.coverage).for_each(|v| *v /= count);
            sample.nees /= count;
            sample.position_m = (self.axes > 0).then(|| ((square_m2 / count).sqrt(), last_m));
            sample.nis = (nis_dof > 0).then(|| (nis / nis_dof as f64, nis_dof));
        }
        sample.lost = sample.failed.is_some() || self.is_lost(&sample);
        sample
    }

    fn is_lost(&self, sample: &Sample) -> bool {
        if self.axes > 0 {
            return !sample.position_m.is_some_and(|(_, last_m)| last_m <= self.lost_m);
        }
        let end = &sample.instants[sample.instants.len() - sample.instants.len().div_ceil(10)..];
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        !(mean(&end.iter().flatten().map(|i| i.nees).collect::<Vec<f64>>()) <= LOST_NEES)
    }
}
