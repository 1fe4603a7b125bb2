//! `alpha-beta`: fixed gains, one axis at a time.
//!
//! The gains are those that a Kalman filter settles at for the interval since the axis was last measured, the model's noise and the variance
//! of the fix, or those of the spec. The covariance is that of the errors under the spec, for whatever gains were used: at the start, over
//! gaps and at irregular intervals too; at a constant interval it settles at the steady one.
//!
//! ```text
//! P⁻ = Φ P Φᵀ + Q     P = (I − K H) P⁻ (I − K H)ᵀ + K R Kᵀ     K = (α, β/D)
//! start    x = z_1, s = (z_1 − z_0)/D:   P = [[R_1, R_1/D], [R_1/D, (R_0 + R_1 + Q11)/D² − 2 Q13/D + Q33]]
//! ```

use crate::trackers::axes::{AxisFilter, AxisNoise, Judged};
use fixtrail_core::estimators::alpha_beta::{self, Design, Gains};
use fixtrail_core::estimators::fosb::Gauss;
use fixtrail_core::{Belief, Matrix, StepError, Vector};

/// What a spec says of the filter.
#[derive(Clone, Copy, Debug)]
pub struct AlphaBeta {
    /// `alpha`, `beta`.
    pub gains: Option<[f64; 2]>,
    /// `interval_s`.
    pub interval_s: Option<f64>,
}

/// The filter of one axis.
#[derive(Clone, Copy, Debug)]
pub struct AlphaBetaAxis {
    filter: alpha_beta::AlphaBeta<f64>,
    /// Of the errors; while the speed is unknown, of what the motion added since the first measurement.
    cov: Matrix<2, 2>,
    /// Variance of the first measurement, while the speed is unknown.
    first: Option<f64>,
    /// Seconds since the last measurement.
    since_s: f64,
}

impl AlphaBetaAxis {
    /// K for a measurement of variance `r`.
    fn gain(
        &self,
        rules: &AlphaBeta,
        r: f64,
        noise: &dyn Fn(f64) -> AxisNoise,
    ) -> Result<Gains<f64>, fixtrail_core::StepError> {
        // A prior and a first fix, at one instant: no interval, so each by its variance.
        if self.since_s == 0.0 {
            let s = self.cov[(0, 0)] + r;
            return Ok(Gains { alpha: self.cov[(0, 0)] / s, beta_per_s: self.cov[(0, 1)] / s });
        }
        let dt = rules.interval_s.unwrap_or(self.since_s);
        if let Some([alpha, beta]) = rules.gains {
            return Ok(Gains { alpha, beta_per_s: beta / dt });
        }
        let q = noise(dt);
        let design = Design { r, dt, q11: q[(0, 0)], q13: q[(0, 1)], q33: q[(1, 1)] };
        design.kalman().map(|steady| steady.gains()).ok_or(StepError::NotFinite { component: 1 })
    }

    /// Puts the second of two measurements in place of both and takes the speed between them.
    fn begin_moving(&mut self, z: Gauss<f64>, first: f64) -> Result<(), StepError> {
        let d = self.since_s;
        let q = self.cov;
        let across = z.var / d;
        let speed = (first + z.var + q[(0, 0)]) / (d * d) - 2.0 * q[(0, 1)] / d + q[(1, 1)];
        self.filter.update(z.mean, &Gains { alpha: 1.0, beta_per_s: 1.0 / d })?;
        self.cov = Matrix::<2, 2>::new(z.var, across, across, speed);
        self.first = None;
        Ok(())
    }
}

impl AxisFilter for AlphaBetaAxis {
    type Rules = AlphaBeta;

    fn begin(_rules: &AlphaBeta, z: Gauss<f64>) -> Self {
        let filter = alpha_beta::AlphaBeta::start(z.mean, 0.0);
        AlphaBetaAxis { filter, cov: Matrix::zeros(), first: Some(z.var), since_s: 0.0 }
    }

    fn with_prior(belief: &Belief<2>) -> Self {
        let filter = alpha_beta::AlphaBeta::start(belief.mean[0], belief.mean[1]);
        AlphaBetaAxis { filter, cov: belief.cov, first: None, since_s: 0.0 }
    }

    fn predict(&mut self, _rules: &AlphaBeta, dt_s: f64, noise: &AxisNoise) -> Result<(), StepError> {
        self.filter.predict(dt_s)?;
        let phi = Matrix::<2, 2>::new(1.0, dt_s, 0.0, 1.0);
        self.cov = phi * self.cov * phi.transpose() + noise;
        self.since_s += dt_s;
        Ok(())
    }

    fn update(
        &mut self,
        rules: &AlphaBeta,
        z: Gauss<f64>,
        noise: &dyn Fn(f64) -> AxisNoise,
    ) -> Result<Option<Judged>, StepError> {
        if let Some(first) = self.first {
            self.begin_moving(z, first)?;
            self.since_s = 0.0;
            return Ok(None);
        }
        let gains = self.gain(rules, z.var, noise)?;
        let s = self.cov[(0, 0)] + z.var;
        let e = self.filter.update(z.mean, &gains)?;
        let k = Vector::<2>::new(gains.alpha, gains.beta_per_s);
        let rest = Matrix::<2, 2>::new(1.0 - k[0], 0.0, -k[1], 1.0);
        let cov = rest * self.cov * rest.transpose() + k * k.transpose() * z.var;
        self.cov = fixtrail_core::linalg::symmetrised(&cov);
        self.since_s = 0.0;
        Ok(Some(Judged { e, s }))
    }

    fn belief(&self) -> Option<Belief<2>> {
        let mean = Vector::from([self.filter.location, self.filter.speed]);
        self.first.is_none().then_some(Belief { mean, cov: self.cov })
    }
}
