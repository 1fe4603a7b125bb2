//! `fosb`: the message-passing filter, one axis at a time; beside it the speed of the instant before.
//!
//! Its variances are too small for locations, up to 1.5 times, and too large for speeds: no gate of this project judges by them.

use crate::spec::FosbNoise;
use crate::trackers::axes::{AxisFilter, AxisNoise, Judged};
use fixtrail_core::estimators::fosb::{Fosb, Gauss, Noise};
use fixtrail_core::{Belief, Matrix, StepError, Vector};

/// Variance of a speed of which nothing is known, m²/s². The filter subtracts no variances: from here it is exact that the first speed is
/// (z_1 − z_0)/D with variance (R_0 + R_1 + Q11)/D², to the last digit for intervals from a microsecond.
const UNKNOWN: f64 = 1e30;

/// What a spec says of the filter.
#[derive(Clone, Copy, Debug)]
pub struct FosbRules {
    /// `q`, or `q11` and `q33`.
    pub noise: FosbNoise,
    /// `speed_sd`.
    pub speed_sd: Option<f64>,
}

/// The filter of one axis.
#[derive(Clone, Copy, Debug)]
pub struct FosbAxis {
    filter: Fosb<f64>,
    speed_known: bool,
    refined: Option<Gauss<f64>>,
}

impl AxisFilter for FosbAxis {
    type Rules = FosbRules;

    fn begin(rules: &FosbRules, z: Gauss<f64>) -> Self {
        let speed = Gauss { mean: 0.0, var: rules.speed_sd.map_or(UNKNOWN, |sd| sd * sd) };
        FosbAxis { filter: Fosb::start(z, speed), speed_known: rules.speed_sd.is_some(), refined: None }
    }

    fn with_prior(belief: &Belief<2>) -> Self {
        let [location, speed] = [0, 1].map(|i| Gauss { mean: belief.mean[i], var: belief.cov[(i, i)] });
        FosbAxis { filter: Fosb::start(location, speed), speed_known: true, refined: None }
    }

    fn predict(&mut self, rules: &FosbRules, dt_s: f64, noise: &AxisNoise) -> Result<(), StepError> {
        let noise = match rules.noise {
            FosbNoise::Model => Noise::Speed { q11: noise[(0, 0)], q33: noise[(1, 1)] },
            FosbNoise::Speed { q11, q33 } => Noise::Speed { q11, q33 },
            FosbNoise::Acceleration { q } => Noise::Acceleration { q },
        };
        self.refined = None;
        self.filter.predict(dt_s, &noise)
    }

    fn update(
        &mut self,
        _rules: &FosbRules,
        z: Gauss<f64>,
        _noise: &dyn Fn(f64) -> AxisNoise,
    ) -> Result<Option<Judged>, StepError> {
        let step = self.filter.update(z)?;
        let judged = self.speed_known.then_some(Judged { e: step.innovation.mean, s: step.innovation.var });
        self.refined = step.refined;
        self.speed_known |= step.refined.is_some();
        Ok(judged)
    }

    fn belief(&self) -> Option<Belief<2>> {
        let (x, s, across) = (self.filter.location(), self.filter.speed(), self.filter.covariance());
        self.speed_known.then(|| Belief {
            mean: Vector::from([x.mean, s.mean]),
            cov: Matrix::<2, 2>::new(x.var, across, across, s.var),
        })
    }

    fn refined(&self) -> Option<Gauss<f64>> {
        self.refined
    }
}
