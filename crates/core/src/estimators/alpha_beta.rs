//! The α-β filter: location and speed of one axis by fixed gains, and the gains that a Kalman filter and a FOSB filter settle at.
//!
//! ```text
//! xt = x + D s     ν = z − xt     x' = xt + α ν     s' = s + (β/D) ν        3 multiplications, 4 additions
//!
//! q1 = Q11/R    q3 = D √(Q33/R)    κ = (Q11 − D Q13)/R    S = R m²
//! Kalman   (m − 1/m)² = κ + q3 (m + 1/m)     α = 1 − 1/m²     β = q3/m
//! FOSB     (m − 1/m)² = q1 + q3 m            α = 1 − 1/m²     β = q3/m
//! ```
//!
//! Both are the fixed point of the variance recursion at a constant interval: the speed's variance stands still when (D Vs)² = Q33 S, which
//! is β, and the rest is one equation for m = √(S/R). Kalman's is quadratic in v = m + 1/m: `v = q3/2 + √(q3²/4 + 4 + κ)`. For an
//! acceleration that holds over an interval (Q11 = D⁴q/4, Q13 = D³q/2, Q33 = D²q) it is the closed form of \[KAL84\] in the tracking index
//! λ = D²√(q/R). FOSB's is solved by iteration.

use crate::estimators::fosb::{Gauss, check_interval, check_measurement};
use crate::linalg::Lu;
use crate::scalar::Scalar;
use crate::types::{Matrix, StepError, Vector};

/// Most iterations for FOSB's gains; each leaves at most 3/4 of the error's logarithm.
const MOST_ITERATIONS: u32 = 400;

/// Fixed gains.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gains<T> {
    /// α: what of the innovation goes to the location.
    pub alpha: T,
    /// β/D: what of it goes to the speed, per second.
    pub beta_per_s: T,
}

/// The filter of one axis.
///
/// ```
/// use fixtrail_core::estimators::alpha_beta::{AlphaBeta, Design};
///
/// let design = Design { r: 16.0, dt: 1.0, q11: 0.04, q13: 0.08, q33: 0.16 };
/// let gains = design.kalman().unwrap().gains::<f32>();
/// let mut walk = AlphaBeta::<f32>::start(0.0, 0.0);
/// assert_eq!(walk.step(1.0, 10.0, &gains)?, 10.0);
/// assert!((walk.location - 3.6).abs() < 1e-6 && (walk.speed - 0.8).abs() < 1e-6);
/// # Ok::<(), fixtrail_core::StepError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AlphaBeta<T> {
    /// x̂.
    pub location: T,
    /// ŝ.
    pub speed: T,
}

impl<T: Scalar> AlphaBeta<T> {
    /// Returns the filter after its first measurement, the location; `speed` is a guess.
    pub fn start(location: T, speed: T) -> Self {
        AlphaBeta { location, speed }
    }

    /// Goes on by an interval without a measurement.
    ///
    /// # Errors
    /// [`StepError::Interval`] when `dt` is not positive, [`StepError::NotFinite`] when the location is not finite. Nothing has changed then.
    pub fn predict(&mut self, dt: T) -> Result<(), StepError> {
        check_interval(dt)?;
        *self = AlphaBeta { location: self.location + dt * self.speed, ..*self }.check()?;
        Ok(())
    }

    /// Takes a location measured now and returns the innovation ν.
    ///
    /// # Errors
    /// [`StepError::Measurement`] when `z` is not finite, [`StepError::NotFinite`] when the result is not. Nothing has changed then.
    pub fn update(&mut self, z: T, gains: &Gains<T>) -> Result<T, StepError> {
        check_measurement(Gauss { mean: z, var: T::HALF })?;
        let nu = z - self.location;
        let next = AlphaBeta { location: self.location + gains.alpha * nu, speed: self.speed + gains.beta_per_s * nu };
        *self = next.check()?;
        Ok(nu)
    }

    /// Goes on by an interval, takes a location and returns the innovation ν.
    ///
    /// # Errors
    /// As [`AlphaBeta::predict`] and [`AlphaBeta::update`]. Nothing has changed then.
    pub fn step(&mut self, dt: T, z: T, gains: &Gains<T>) -> Result<T, StepError> {
        let mut next = *self;
        next.predict(dt)?;
        let nu = next.update(z, gains)?;
        *self = next;
        Ok(nu)
    }

    fn check(self) -> Result<Self, StepError> {
        if !self.location.is_finite() {
            return Err(StepError::NotFinite { component: 0 });
        }
        if !self.speed.is_finite() {
            return Err(StepError::NotFinite { component: 1 });
        }
        Ok(self)
    }
}

/// What gains are designed for: one axis whose location is measured at a constant interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Design {
    /// Variance of the measurement, positive.
    pub r: f64,
    /// Interval D in seconds, positive.
    pub dt: f64,
    /// Variance an interval adds to the location.
    pub q11: f64,
    /// Covariance it adds between location and speed.
    pub q13: f64,
    /// Variance it adds to the speed.
    pub q33: f64,
}

impl Design {
    /// Returns the design of an acceleration of variance `q` that holds over the interval, \[FOSB12, eq. (15)\].
    pub fn acceleration(r: f64, dt: f64, q: f64) -> Self {
        Design { r, dt, q11: dt * dt * dt * dt * q / 4.0, q13: dt * dt * dt * q / 2.0, q33: dt * dt * q }
    }

    /// Returns the steady state of the Kalman filter, or `None` when the numbers are not those of a design.
    pub fn kalman(&self) -> Option<Steady> {
        let (_, q3) = self.relative()?;
        let kappa = (self.q11 - self.dt * self.q13) / self.r;
        let v = 0.5 * q3 + libm::sqrt(0.25 * q3 * q3 + 4.0 + kappa);
        let less = libm::sqrt(kappa + q3 * v);
        let m = 0.5 * (v + less);
        let (alpha, beta, s) = (less / m, q3 / m, self.r * m * m);
        let p12 = libm::sqrt(self.q33 * s);
        let across = p12 * (1.0 - alpha);
        let speed = (alpha * p12 - self.q13) / self.dt;
        let cov = Matrix::<2, 2>::new(self.r * alpha, across, across, speed);
        Some(Steady { design: *self, alpha, beta, innovation_var: s, cov })
    }

    /// Returns the steady state of the FOSB filter, which ignores Q13, or `None` when the numbers are not those of a design.
    ///
    /// `cov` is what the filter reports. Its errors are another matter: [`Steady::moments`].
    pub fn fosb(&self) -> Option<Steady> {
        let (q1, q3) = self.relative()?;
        // With w = m² − 1 the equation is w² = q1 (1 + w) + q3 (1 + w)^1.5: the right side grows by a power below 1.5.
        let mut w = libm::sqrt(q1 + q3);
        for _ in 0..MOST_ITERATIONS {
            let next = libm::sqrt((1.0 + w) * (q1 + q3 * libm::sqrt(1.0 + w)));
            let settled = (next - w).abs() <= f64::EPSILON * next;
            w = next;
            if settled {
                break;
            }
        }
        let m = libm::sqrt(1.0 + w);
        let (alpha, s) = (w / (1.0 + w), self.r * (1.0 + w));
        let cov = Matrix::<2, 2>::new(self.r * alpha, 0.0, 0.0, libm::sqrt(self.q33 * s) / self.dt);
        Some(Steady { design: *self, alpha, beta: q3 / m, innovation_var: s, cov })
    }

    /// Returns the steady state under gains chosen by hand, its covariance that of the errors when the design is right.
    ///
    /// `None` when the numbers are not those of a design or the gains let errors grow: stable are α > 0, β > 0, 2α + β < 4.
    pub fn fixed(&self, alpha: f64, beta: f64) -> Option<Steady> {
        self.relative()?;
        let mut out = Steady { design: *self, alpha, beta, innovation_var: self.r, cov: Matrix::zeros() };
        let Moments { mse_x, mse_s, cov_xs } = out.moments(Truth::Matched)?;
        out.cov = Matrix::<2, 2>::new(mse_x, cov_xs, cov_xs, mse_s);
        let (d, q) = (self.dt, self.q11);
        out.innovation_var = mse_x + 2.0 * d * cov_xs + d * d * mse_s + q + self.r;
        Some(out)
    }

    /// Returns (Q11/R, D √(Q33/R)), or `None` when the numbers are not those of a design.
    fn relative(&self) -> Option<(f64, f64)> {
        let Design { r, dt, q11, q13, q33 } = *self;
        let sound = r > 0.0 && dt > 0.0 && q11 >= 0.0 && q33 >= 0.0 && q13 * q13 <= q11 * q33 * (1.0 + 1e-9);
        let out = (q11 / r, dt * libm::sqrt(q33 / r));
        (sound && [r, dt, q13, out.0, out.1].iter().all(|v| v.is_finite())).then_some(out)
    }
}

/// A filter of constant gains at a constant interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Steady {
    /// What it is designed for.
    pub design: Design,
    /// α.
    pub alpha: f64,
    /// β.
    pub beta: f64,
    /// Variance S that the filter expects of the innovation.
    pub innovation_var: f64,
    /// Covariance of location and speed after an update as the filter reports it; FOSB's speed is the forward one.
    pub cov: Matrix<2, 2>,
}

/// How the truth moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Truth {
    /// As designed, with Q13.
    Matched,
    /// At a constant speed, with Q11 on the location alone: the simulations (33) and (34) of \[FOSB12\].
    ConstantSpeed,
}

/// Second moments of the errors of location and speed after an update.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moments {
    /// Mean squared error of the location.
    pub mse_x: f64,
    /// Mean squared error of the speed.
    pub mse_s: f64,
    /// Mean product of the two errors.
    pub cov_xs: f64,
}

impl Moments {
    /// Returns the quantile of the distance from the truth in the plane, for two independent axes of these moments: Rayleigh's.
    pub fn distance_quantile(&self, probability: f64) -> f64 {
        libm::sqrt(-2.0 * self.mse_x * libm::log1p(-probability))
    }
}

impl Steady {
    /// The gains as numbers of the filter.
    pub fn gains<T: Scalar>(&self) -> Gains<T> {
        Gains { alpha: T::from_f64(self.alpha), beta_per_s: T::from_f64(self.beta / self.design.dt) }
    }

    /// Returns the moments of the errors in the long run, exactly, or `None` when errors do not die out.
    ///
    /// The error follows `e⁺ = (I − K H)(Φ e − w) + K v`, so its covariance solves
    /// `M = F M Fᵀ + (I − K H) Q (I − K H)ᵀ + K R Kᵀ`, F = (I − K H) Φ, K = (α, β/D): three linear equations, in units where D is 1.
    pub fn moments(&self, truth: Truth) -> Option<Moments> {
        let (a, b) = (self.alpha, self.beta);
        // The triangle of stability of an α-β filter.
        if !(a > 0.0 && b > 0.0 && 2.0 * a + b < 4.0) {
            return None;
        }
        let d = self.design.dt;
        let (q11, q13, q33) = match truth {
            Truth::Matched => (self.design.q11, d * self.design.q13, d * d * self.design.q33),
            Truth::ConstantSpeed => (self.design.q11, 0.0, 0.0),
        };
        let f = Matrix::<2, 2>::new(1.0 - a, 1.0 - a, -b, 1.0 - b);
        let rest = Matrix::<2, 2>::new(1.0 - a, 0.0, -b, 1.0);
        let gain = Vector::<2>::new(a, b);
        let added =
            rest * Matrix::<2, 2>::new(q11, q13, q13, q33) * rest.transpose() + gain * gain.transpose() * self.design.r;
        // Unknowns M11, M12, M22.
        let pairs = [(0, 0), (0, 1), (1, 1)];
        let system = Matrix::<3, 3>::from_fn(|row, col| {
            let ((i, j), (k, l)) = (pairs[row], pairs[col]);
            let twice = if k == l { 0.0 } else { f[(i, l)] * f[(j, k)] };
            f64::from(u8::from(row == col)) - f[(i, k)] * f[(j, l)] - twice
        });
        let known = Vector::<3>::from_fn(|row, _| added[pairs[row]]);
        let m = Lu::new(system)?.solve(known);
        Some(Moments { mse_x: m[0], cov_xs: m[1] / d, mse_s: m[2] / (d * d) })
    }
}
