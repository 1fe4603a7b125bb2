//! `profile`: an acceleration over time, a step, a ramp or a triangle.

use super::{Kinematics, Path};
use fixtrail_track::spec::Shape;
use rand::Rng;

/// A target on a line that is bent by the acceleration of its profile; exact at every instant.
pub(super) struct Profile {
    /// At time 0.
    pub start: Kinematics,
    pub shape: Shape,
    pub peak_mps2: [f64; 3],
    pub span_s: [f64; 2],
    pub t_s: f64,
}

/// A profile of height 1 and length `length_s`, `s` after its beginning: itself, its integral, and the integral of that.
fn unit(shape: Shape, length_s: f64, s: f64) -> [f64; 3] {
    let (t, half) = (length_s, 0.5 * length_s);
    if s <= 0.0 {
        return [0.0; 3];
    }
    if s > t {
        let [_, v, p] = unit(shape, t, t);
        return [0.0, v, p + v * (s - t)];
    }
    match shape {
        Shape::Step => [1.0, s, s * s / 2.0],
        Shape::Ramp => [s / t, s * s / (2.0 * t), s.powi(3) / (6.0 * t)],
        Shape::Triangle if s <= half => unit(Shape::Ramp, half, s),
        Shape::Triangle => {
            let (h, s) = (half, s - half);
            let p = h * h / 6.0 + h / 2.0 * s + s * s / 2.0 - s.powi(3) / (6.0 * h);
            [1.0 - s / h, h / 2.0 + s - s * s / (2.0 * h), p]
        }
    }
}

impl Path for Profile {
    fn now(&self) -> Kinematics {
        let [from_s, until_s] = self.span_s;
        let [a, v, p] = unit(self.shape, until_s - from_s, self.t_s - from_s);
        let at = |f: &dyn Fn(usize) -> f64| core::array::from_fn(f);
        Kinematics {
            position_m: at(&|i| {
                self.start.position_m[i] + self.start.velocity_mps[i] * self.t_s + self.peak_mps2[i] * p
            }),
            velocity_mps: at(&|i| self.start.velocity_mps[i] + self.peak_mps2[i] * v),
            acceleration_mps2: at(&|i| self.peak_mps2[i] * a),
        }
    }

    fn advance(&mut self, dt_s: f64, _rng: &mut dyn Rng) {
        self.t_s += dt_s;
    }
}
