//! `circle`: round a centre at constant speed.

use super::{Kinematics, Path};
use rand::Rng;

/// `p = c + r (cos φ, sin φ)`, `φ̇ = v/r`.
pub(super) struct Circle {
    pub centre_m: [f64; 2],
    pub radius_m: f64,
    pub speed_mps: f64,
    pub angle_rad: f64,
}

impl Path for Circle {
    fn now(&self) -> Kinematics {
        let (sin, cos) = self.angle_rad.sin_cos();
        let ([x, y], r, v) = (self.centre_m, self.radius_m, self.speed_mps);
        Kinematics {
            position_m: [x + r * cos, y + r * sin, 0.0],
            velocity_mps: [-v * sin, v * cos, 0.0],
            acceleration_mps2: [-v * v / r * cos, -v * v / r * sin, 0.0],
        }
    }

    fn advance(&mut self, dt_s: f64, _rng: &mut dyn Rng) {
        self.angle_rad += self.speed_mps / self.radius_m * dt_s;
    }
}
