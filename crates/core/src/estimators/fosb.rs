//! Forward and one-step-backward (FOSB) tracking \[FOSB12\]: one axis, its location and its speed, by messages on a factor graph.
//!
//! ```text
//! x⁺ = x + D s + u,  var u = Q11      s⁺ = s + w,  var w = Q33      z = x + v,  var v = R
//!
//! t = D Vs     p = (Vx + Q11) + D t     S = p + R     xt = x + D s     ν = z − xt     e = ν/S
//! x' = xt + p e     Vx' = R (p/S)                                      location at k+1              steps 7–9
//! s' = s + t e      Vs' = Vs ((Vx + Q11 + R)/S) + Q33                  forward speed at k+1         steps 5, 6, 10, 11
//! refined speed of k: mean s', variance Vs' − Q33                      known D late                 step 11
//! ```
//!
//! This is a gain form of the paper's steps 5 to 11: 10 multiplications, 9 additions and a division; 12, 13 and 1 with what gaps and the checks
//! of range take. Every variance is a sum or a product of positive numbers, so none loses digits or its sign, in `f32` and in fixed point too. The literal steps
//! divide by D² and overflow there. Errata of the paper: `docs/equations.md`.
//!
//! It is the Kalman filter of the two states whose covariance of location and speed is set to 0 after every update, and whose noises have no
//! covariance. What that ignores makes the location variance up to 1.5 times too small and the speed variance 2 to 70 times too large in a
//! matched steady state ([`alpha_beta::Steady::moments`](crate::estimators::alpha_beta::Steady::moments) has the true ones): gate with
//! neither as it is.
//!
//! # Gaps
//!
//! A missed epoch is a [`Fosb::predict`] without an update. To drop the covariance of location and speed there as well would lose more with
//! every missed epoch, so it is kept until the next update, and only then dropped: n predictions and an update are the Kalman filter's. The
//! covariance is held as the reach L of the speed, x = x̂ + L (s − ŝ) + e with var e = c independent of s, so that a gap is one long interval and
//! still subtracts nothing:
//!
//! ```text
//! speed noise at an epoch    V⁺ = V + Q33     L⁺ = L V/V⁺     c⁺ = c + L² Q33 V/V⁺
//! interval                   L⁺ = L + D       c⁺ = c + Q11
//! update                     the equations above with L for D and c for Vx + Q11; then L = 0, c = Vx'
//! ```

use crate::scalar::Scalar;
use crate::types::StepError;

/// A normal distribution of one number: what a message of the graph carries.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gauss<T> {
    /// Mean.
    pub mean: T,
    /// Variance.
    pub var: T,
}

/// What drives the motion of one axis over one interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Noise<T> {
    /// Noise on location and speed, eq. (13): variances per step, whatever the interval is.
    Speed {
        /// Variance that a step adds to the location.
        q11: T,
        /// Variance that a step adds to the speed.
        q33: T,
    },
    /// An acceleration of variance `q` that holds over the interval, eq. (15): Q11 = D⁴q/4, Q33 = D²q. Their covariance D³q/2 is ignored.
    Acceleration {
        /// Variance of the acceleration.
        q: T,
    },
}

impl<T: Scalar> Noise<T> {
    /// Returns (Q11, Q33) of an interval.
    pub fn over(&self, dt: T) -> (T, T) {
        match *self {
            Noise::Speed { q11, q33 } => (q11, q33),
            Noise::Acceleration { q } => {
                let square = dt * dt;
                let half = square * T::HALF;
                (half * half * q, square * q)
            }
        }
    }
}

/// The filter of one axis.
///
/// ```
/// use fixtrail_core::estimators::fosb::{Fosb, Gauss, Noise};
///
/// let noise = Noise::Acceleration { q: 0.16 };
/// let mut walk = Fosb::start(Gauss { mean: 0.0, var: 16.0 }, Gauss { mean: 0.0, var: 4.0 });
/// let step = walk.step(1.0, &noise, Gauss { mean: 3.0, var: 16.0 })?;
/// assert!(step.location.mean > 0.0 && step.location.var < 16.0);
/// assert_eq!(step.refined.unwrap().mean, step.speed.mean);
/// # Ok::<(), fixtrail_core::StepError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fosb<T> {
    /// x̂, at the time of the last prediction or update.
    location: T,
    /// c: the location's variance given the speed.
    rest: T,
    /// ŝ.
    speed: T,
    /// V, without the noise of the last interval.
    speed_var: T,
    /// Speed noise of the last interval.
    fresh: T,
    /// L; 0 after an update.
    reach: T,
}

/// What one measurement made known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step<T> {
    /// Location at the time of the measurement, given all up to it.
    pub location: Gauss<T>,
    /// Speed at the time of the measurement, foretold.
    pub speed: Gauss<T>,
    /// Speed at the epoch before, given all up to the measurement; `None` where there is no epoch before.
    pub refined: Option<Gauss<T>>,
    /// Location before the measurement.
    pub predicted: Gauss<T>,
    /// Measured less predicted location, and the variance S expected of it.
    pub innovation: Gauss<T>,
}

/// The three messages of the paper's steps 1 to 3, taken literally: two different ones for the speed at the start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LiteralStart<T> {
    /// Ĝ_0: the location, as a rule z_0 and R_0.
    pub location: Gauss<T>,
    /// F̂ᵍ_0: the speed that step 4 foretells the next location by.
    pub forward: Gauss<T>,
    /// F̂_0: the speed that step 5 goes on from.
    pub refined: Gauss<T>,
}

impl<T: Scalar> Fosb<T> {
    /// Returns the filter after its first measurement: `location` is z_0 and R_0, `speed` a guess and how far it may be off.
    ///
    /// Unlike [`Fosb::start_literal`], the next measurement already tells of the speed.
    pub fn start(location: Gauss<T>, speed: Gauss<T>) -> Self {
        Fosb {
            location: location.mean,
            rest: location.var,
            speed: speed.mean,
            speed_var: speed.var,
            fresh: T::ZERO,
            reach: T::ZERO,
        }
    }

    /// Returns the filter after z_1 when steps 1 to 4 of the paper are taken literally, and what z_1 made known.
    ///
    /// z_1 then changes the location alone: the speed at 1 is `start.refined` with the interval's noise, whatever z_1 is.
    ///
    /// # Errors
    /// As [`Fosb::step`].
    pub fn start_literal(
        start: &LiteralStart<T>,
        dt: T,
        noise: &Noise<T>,
        z: Gauss<T>,
    ) -> Result<(Self, Step<T>), StepError> {
        let mut out = Self::start(start.location, start.forward);
        let mut step = out.step(dt, noise, z)?;
        out.speed = start.refined.mean;
        out.speed_var = start.refined.var + noise.over(dt).1;
        step.speed = Gauss { mean: out.speed, var: out.speed_var };
        step.refined = None;
        Ok((out, step))
    }

    /// Location at the time of the last prediction or update.
    pub fn location(&self) -> Gauss<T> {
        let known = self.rest + self.reach * (self.reach * self.speed_var);
        Gauss { mean: self.location, var: known }
    }

    /// Speed at the time of the last prediction or update.
    pub fn speed(&self) -> Gauss<T> {
        Gauss { mean: self.speed, var: self.speed_var + self.fresh }
    }

    /// Covariance of location and speed: 0 after an update.
    pub fn covariance(&self) -> T {
        self.reach * self.speed_var
    }

    /// Goes on by an interval. Without an update before the next prediction it is a missed epoch.
    ///
    /// # Errors
    /// [`StepError::Interval`] when `dt` is not positive, [`StepError::ProcessNoise`] when a variance is negative,
    /// [`StepError::NotFinite`] when the result is not finite. Nothing has changed then.
    pub fn predict(&mut self, dt: T, noise: &Noise<T>) -> Result<(), StepError> {
        let next = self.predicted(dt, noise)?;
        *self = next;
        Ok(())
    }

    /// Takes a location measured now: its value and its variance R.
    ///
    /// # Errors
    /// [`StepError::Measurement`] when the value is not finite, [`StepError::MeasurementVariance`] when R is not positive and finite,
    /// [`StepError::NotFinite`] when the result is not finite. Nothing has changed then.
    pub fn update(&mut self, z: Gauss<T>) -> Result<Step<T>, StepError> {
        let (next, step) = self.updated(z)?;
        *self = next;
        Ok(step)
    }

    /// Goes on by an interval and takes a measurement.
    ///
    /// # Errors
    /// As [`Fosb::predict`] and [`Fosb::update`]. Nothing has changed then.
    pub fn step(&mut self, dt: T, noise: &Noise<T>, z: Gauss<T>) -> Result<Step<T>, StepError> {
        let (next, step) = self.predicted(dt, noise)?.updated(z)?;
        *self = next;
        Ok(step)
    }

    fn predicted(&self, dt: T, noise: &Noise<T>) -> Result<Self, StepError> {
        check_interval(dt)?;
        let (q11, q33) = noise.over(dt);
        for var in [q11, q33] {
            if !(var >= T::ZERO && var.is_finite()) {
                return Err(StepError::ProcessNoise { var: var.to_f64() });
            }
        }
        let mut next = *self;
        next.speed_var = self.speed_var + self.fresh;
        // Right after an update there is nothing to split, and no division.
        if self.reach > T::ZERO && self.fresh > T::ZERO {
            let kept = self.speed_var / next.speed_var;
            next.rest = next.rest + self.reach * (self.reach * (self.fresh * kept));
            next.reach = self.reach * kept;
        }
        next.reach = next.reach + dt;
        next.rest = next.rest + q11;
        next.fresh = q33;
        next.location = self.location + dt * self.speed;
        check(next.location(), next.speed())?;
        Ok(next)
    }

    fn updated(&self, z: Gauss<T>) -> Result<(Self, Step<T>), StepError> {
        check_measurement(z)?;
        let t = self.reach * self.speed_var;
        let p = self.rest + self.reach * t;
        let s = p + z.var;
        if !s.is_finite() {
            return Err(StepError::NotFinite { component: 0 });
        }
        let inverse = s.inverse();
        let nu = z.mean - self.location;
        // The innovation first: in fixed point a small gain has few digits.
        let e = nu.times(inverse);
        let location = Gauss { mean: self.location + p * e, var: z.var * p.times(inverse) };
        let speed = self.speed + t * e;
        let refined = Gauss { mean: speed, var: self.speed_var * (self.rest + z.var).times(inverse) };
        let ahead = Gauss { mean: speed, var: refined.var + self.fresh };
        check(location, ahead)?;
        let step = Step {
            location,
            speed: ahead,
            // No interval since the last update: no epoch lies before.
            refined: (self.reach > T::ZERO).then_some(refined),
            predicted: Gauss { mean: self.location, var: p },
            innovation: Gauss { mean: nu, var: s },
        };
        Ok((Self::start(location, ahead), step))
    }
}

/// Checks that location and speed are within the range of numbers.
fn check<T: Scalar>(location: Gauss<T>, speed: Gauss<T>) -> Result<(), StepError> {
    for (component, known) in [location, speed].into_iter().enumerate() {
        if !(known.mean.is_finite() && known.var.is_finite()) {
            return Err(StepError::NotFinite { component });
        }
    }
    Ok(())
}

/// Checks that an interval is positive and finite.
pub(crate) fn check_interval<T: Scalar>(dt: T) -> Result<(), StepError> {
    if dt > T::ZERO && dt.is_finite() { Ok(()) } else { Err(StepError::Interval { dt: dt.to_f64() }) }
}

/// Checks that a value is finite and its variance positive and finite.
pub(crate) fn check_measurement<T: Scalar>(z: Gauss<T>) -> Result<(), StepError> {
    if !z.mean.is_finite() {
        return Err(StepError::Measurement { value: z.mean.to_f64() });
    }
    if !(z.var > T::ZERO && z.var.is_finite()) {
        return Err(StepError::MeasurementVariance { var: z.var.to_f64() });
    }
    Ok(())
}

/// The filters of `A` axes that share their instants.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FosbAxes<T, const A: usize> {
    /// One filter per axis.
    pub axes: [Fosb<T>; A],
}

impl<T: Scalar, const A: usize> FosbAxes<T, A> {
    /// Returns the filters after the first fix; [`Fosb::start`] per axis.
    pub fn start(location: &[Gauss<T>; A], speed: &[Gauss<T>; A]) -> Self {
        FosbAxes { axes: core::array::from_fn(|i| Fosb::start(location[i], speed[i])) }
    }

    /// Goes on by an interval on every axis.
    ///
    /// # Errors
    /// As [`Fosb::predict`]; no axis has changed then.
    pub fn predict(&mut self, dt: T, noise: &[Noise<T>; A]) -> Result<(), StepError> {
        let mut next = self.axes;
        for (axis, noise) in next.iter_mut().zip(noise) {
            axis.predict(dt, noise)?;
        }
        self.axes = next;
        Ok(())
    }

    /// Takes a fix: a measurement on every axis.
    ///
    /// # Errors
    /// As [`Fosb::update`]; no axis has changed then.
    pub fn update(&mut self, z: &[Gauss<T>; A]) -> Result<[Step<T>; A], StepError> {
        let mut next = self.axes;
        // The filler is overwritten on every axis before anything is returned.
        let none = Gauss { mean: T::ZERO, var: T::ZERO };
        let mut steps = [Step { location: none, speed: none, refined: None, predicted: none, innovation: none }; A];
        for i in 0..A {
            steps[i] = next[i].update(z[i])?;
        }
        self.axes = next;
        Ok(steps)
    }

    /// Goes on by an interval and takes a fix.
    ///
    /// # Errors
    /// As [`Fosb::step`]; no axis has changed then.
    pub fn step(&mut self, dt: T, noise: &[Noise<T>; A], z: &[Gauss<T>; A]) -> Result<[Step<T>; A], StepError> {
        let mut next = *self;
        next.predict(dt, noise)?;
        let steps = next.update(z)?;
        *self = next;
        Ok(steps)
    }
}
