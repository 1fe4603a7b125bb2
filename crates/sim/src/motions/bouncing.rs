//! `bouncing`: straight on until the wall of a rectangle, then on in another direction.

use super::{Kinematics, Path};
use fixtrail_track::spec::Walls;
use rand::{Rng, RngExt};

/// Most walls met in one step.
const MOST_WALLS: usize = 10_000;

/// A target between walls.
pub(super) struct Bouncing {
    area_m: [f64; 2],
    speed_mps: f64,
    walls: Walls,
    position_m: [f64; 2],
    /// Of length 1.
    heading: [f64; 2],
}

impl Bouncing {
    /// A target in a random direction; at the wall when it starts beyond it.
    pub(super) fn new(area_m: [f64; 2], speed_mps: f64, walls: Walls, start: Kinematics, rng: &mut dyn Rng) -> Self {
        let position_m = core::array::from_fn(|i| start.position_m[i].clamp(0.0, area_m[i]));
        let mut out = Bouncing { area_m, speed_mps, walls, position_m, heading: [1.0, 0.0] };
        out.turn(rng);
        out
    }

    /// Whether a direction leads away from every wall that is touched.
    fn leads_inside(&self, heading: [f64; 2]) -> bool {
        (0..2).all(|i| {
            (self.position_m[i] > 0.0 || heading[i] > 0.0) && (self.position_m[i] < self.area_m[i] || heading[i] < 0.0)
        })
    }

    /// Any direction that leads inside; at least one in four does.
    fn turn(&mut self, rng: &mut dyn Rng) {
        loop {
            let (sin, cos) = rng.random_range(0.0..core::f64::consts::TAU).sin_cos();
            self.heading = [cos, sin];
            if self.leads_inside(self.heading) {
                return;
            }
        }
    }

    /// Distance to the nearest wall ahead, and the axis that ends there.
    fn wall_ahead(&self) -> Option<(f64, usize)> {
        let to_wall = |i: usize| {
            let wall = if self.heading[i] > 0.0 { self.area_m[i] } else { 0.0 };
            (self.heading[i] != 0.0).then(|| (((wall - self.position_m[i]) / self.heading[i]).max(0.0), i))
        };
        (0..2).filter_map(to_wall).min_by(|a, b| a.0.total_cmp(&b.0))
    }
}

impl Path for Bouncing {
    fn now(&self) -> Kinematics {
        let ([x, y], [cos, sin], v) = (self.position_m, self.heading, self.speed_mps);
        Kinematics { position_m: [x, y, 0.0], velocity_mps: [v * cos, v * sin, 0.0], acceleration_mps2: [0.0; 3] }
    }

    fn advance(&mut self, dt_s: f64, rng: &mut dyn Rng) {
        let mut rest_m = self.speed_mps * dt_s;
        for _ in 0..MOST_WALLS {
            let Some((distance_m, axis)) = self.wall_ahead() else { return };
            let go_m = rest_m.min(distance_m);
            for i in 0..2 {
                // Rounding must not lead through a wall.
                self.position_m[i] = (self.position_m[i] + go_m * self.heading[i]).clamp(0.0, self.area_m[i]);
            }
            rest_m -= go_m;
            if !(distance_m <= go_m) {
                return;
            }
            // At the wall, to the bit.
            self.position_m[axis] = if self.heading[axis] > 0.0 { self.area_m[axis] } else { 0.0 };
            match self.walls {
                Walls::Random => self.turn(rng),
                Walls::Mirror => self.heading[axis] = -self.heading[axis],
            }
            if rest_m <= 0.0 {
                return;
            }
        }
    }
}
