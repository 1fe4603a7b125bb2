//! `constant-speed`: a constant velocity, and a noise that moves the position alone.

use super::{Kinematics, Path};
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};

/// `x⁺ = x + Δ s + u`, the first path of \[FOSB12, sec. 4\]. The noise is one of each step, whatever its length.
pub(super) struct ConstantSpeed {
    pub axes: usize,
    pub now: Kinematics,
    pub position_sd_m: f64,
}

impl Path for ConstantSpeed {
    fn now(&self) -> Kinematics {
        self.now
    }

    fn advance(&mut self, dt_s: f64, rng: &mut dyn Rng) {
        for axis in 0..self.axes {
            let normal: f64 = StandardNormal.sample(rng);
            self.now.position_m[axis] += dt_s * self.now.velocity_mps[axis] + self.position_sd_m * normal;
        }
    }
}
