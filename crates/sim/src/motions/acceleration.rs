//! `acceleration`: a constant velocity, and an acceleration of each interval that is forgotten at its end.

use super::{Kinematics, Path};
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};

/// `x⁺ = x + Δ s + Δ²/2 η`, s constant: the second path of \[FOSB12, sec. 4\], as printed.
pub(super) struct Acceleration {
    pub axes: usize,
    pub now: Kinematics,
    pub acceleration_sd_mps2: f64,
}

impl Path for Acceleration {
    fn now(&self) -> Kinematics {
        self.now
    }

    fn advance(&mut self, dt_s: f64, rng: &mut dyn Rng) {
        for axis in 0..self.axes {
            let normal: f64 = StandardNormal.sample(rng);
            let shift = 0.5 * dt_s * dt_s * self.acceleration_sd_mps2 * normal;
            self.now.position_m[axis] += dt_s * self.now.velocity_mps[axis] + shift;
        }
    }
}
