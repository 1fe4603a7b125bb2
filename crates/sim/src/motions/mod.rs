//! How targets really move, where that is not as a model says.
//!
//! Their names stand in [`fixtrail_track::spec::MOTIONS`].

mod acceleration;
mod bouncing;
mod circle;
mod constant_speed;
mod profile;

use fixtrail_track::spec::MotionSpec;
use rand::Rng;

/// Where a target is and how it moves; axes that it does not have are 0.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Kinematics {
    /// Position, metres.
    pub position_m: [f64; 3],
    /// Velocity, metres per second.
    pub velocity_mps: [f64; 3],
    /// Acceleration, metres per second squared.
    pub acceleration_mps2: [f64; 3],
}

/// A target on its way.
///
/// Every implementation draws from `rng` alone and depends on nothing but its own state, so equal seeds give equal ways.
pub trait Path: Send {
    /// Where it is.
    fn now(&self) -> Kinematics;

    /// Moves on for `dt_s`, a positive number of seconds.
    fn advance(&mut self, dt_s: f64, rng: &mut dyn Rng);
}

/// A target that moves as `spec` says in the first `axes` axes, from `start` where the spec does not say where.
pub fn open(spec: &MotionSpec, axes: usize, start: Kinematics, rng: &mut dyn Rng) -> Box<dyn Path> {
    match *spec {
        MotionSpec::Circle { centre_m, radius_m, speed_mps, start_rad } => {
            Box::new(circle::Circle { centre_m, radius_m, speed_mps, angle_rad: start_rad })
        }
        MotionSpec::ConstantSpeed { velocity_mps, position_sd_m } => {
            Box::new(constant_speed::ConstantSpeed { axes, now: departing(start, velocity_mps), position_sd_m })
        }
        MotionSpec::Acceleration { velocity_mps, acceleration_sd_mps2 } => {
            Box::new(acceleration::Acceleration { axes, now: departing(start, velocity_mps), acceleration_sd_mps2 })
        }
        MotionSpec::Bouncing { area_m, speed_mps, walls } => {
            Box::new(bouncing::Bouncing::new(area_m, speed_mps, walls, start, rng))
        }
        MotionSpec::Profile { velocity_mps, shape, acceleration_mps2, span_s } => Box::new(profile::Profile {
            start: departing(start, velocity_mps),
            shape,
            peak_mps2: acceleration_mps2,
            span_s,
            t_s: 0.0,
        }),
    }
}

/// The start, not accelerating, at the velocity that the spec gives.
fn departing(start: Kinematics, velocity_mps: Option<[f64; 3]>) -> Kinematics {
    Kinematics {
        velocity_mps: velocity_mps.unwrap_or(start.velocity_mps),
        acceleration_mps2: [0.0; 3],
        position_m: start.position_m,
    }
}
