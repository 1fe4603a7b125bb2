//! The simulations of \[FOSB12, section 4\]: a target in the plane, its location measured, and what a Kalman filter and FOSB make of it.

use super::stream;
use crate::papers::{Effort, normal};
use fixtrail_core::estimators::alpha_beta::Design;
use fixtrail_core::estimators::fosb::{FosbAxes, Gauss, Noise};
use fixtrail_core::estimators::kalman::{Robust, predict, update};
use fixtrail_core::{Belief, Matrix, Row, Transition, Vector};
use rand::RngExt;
use rand_pcg::Pcg64;
use std::f64::consts::TAU;

/// Samples of one run.
pub const SAMPLES: usize = 10_000;
/// Side of the square of the third path, metres.
pub const SIDE_M: f64 = 50.0;
/// The order of every triple here.
pub const ESTIMATORS: [&str; 3] = ["no tracking", "Kalman filter", "FOSB"];
/// The probabilities of the printed error distances.
pub const SHARES: [f64; 2] = [0.9, 0.6];

/// What the target does at a wall, or with its heading.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Heading {
    /// There is no wall.
    Straight,
    /// It is reflected at a wall, as a billiard ball is.
    Reflected,
    /// It goes on from a wall with a new random heading.
    RandomAtWalls,
    /// It has a new random heading at every step: (35) with an angle of its own for each k.
    RandomAlways,
}

/// What is simulated, and what the filters believe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setting {
    /// Number of its streams of chance; settings with equal numbers are driven by the same chance.
    pub part: u64,
    /// Interval, seconds.
    pub dt: f64,
    /// Speed, m/s: of each axis without walls, of the target within them.
    pub speed: f64,
    /// Where the target heads.
    pub heading: Heading,
    /// Variance that a step adds to each coordinate.
    pub jitter: f64,
    /// What the filters believe of the motion.
    pub noise: Noise<f64>,
    /// R, m².
    pub r: f64,
}

impl Setting {
    /// The first path, (33): `u` is the variance of its u.
    pub fn first(dt: f64, u: f64) -> Setting {
        let noise = Noise::Speed { q11: 0.16, q33: 0.16 };
        Setting { part: 1, dt, speed: 2.0, heading: Heading::Straight, jitter: u, noise, r: 16.0 }
    }

    /// The second path, (34): a standard deviation of 0.4 m/s².
    pub fn second(dt: f64) -> Setting {
        let noise = Noise::Acceleration { q: 0.16 };
        Setting { part: 2, dt, speed: 2.0, heading: Heading::Straight, jitter: noise.over(dt).0, noise, r: 16.0 }
    }

    /// The third path, (35).
    pub fn third(dt: f64, heading: Heading) -> Setting {
        let noise = Noise::Acceleration { q: 0.16 };
        Setting { part: 3 + heading as u64, dt, speed: 1.36, heading, jitter: noise.over(dt).0, noise, r: 4.5 }
    }

    /// What the filters believe, as a design of gains; FOSB ignores its q13.
    pub fn design(&self) -> Design {
        match self.noise {
            Noise::Speed { q11, q33 } => Design { r: self.r, dt: self.dt, q11, q13: 0.0, q33 },
            Noise::Acceleration { q } => Design::acceleration(self.r, self.dt, q),
        }
    }
}

/// The target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Target {
    /// Where it is.
    pub location: [f64; 2],
    /// Its velocity, the noise of the step apart.
    pub velocity: [f64; 2],
    /// Steps since it met a wall.
    pub since_wall: usize,
}

impl Target {
    fn start(setting: &Setting, rng: &mut Pcg64) -> Target {
        let velocity = match setting.heading {
            Heading::Straight => [setting.speed; 2],
            _ => heading(setting.speed, rng),
        };
        let middle = if setting.heading == Heading::Straight { 0.0 } else { 0.5 * SIDE_M };
        Target { location: [middle; 2], velocity, since_wall: usize::MAX }
    }

    fn step(&mut self, setting: &Setting, rng: &mut Pcg64) {
        if setting.heading == Heading::RandomAlways {
            self.velocity = heading(setting.speed, rng);
        }
        for (x, v) in self.location.iter_mut().zip(self.velocity) {
            *x += setting.dt * v + setting.jitter.sqrt() * normal(rng);
        }
        self.since_wall = self.since_wall.saturating_add(1);
        if setting.heading == Heading::Straight || self.location.iter().all(|x| (0.0..=SIDE_M).contains(x)) {
            return;
        }
        self.since_wall = 0;
        let wall = self.location;
        for (x, v) in self.location.iter_mut().zip(&mut self.velocity) {
            let inside = x.clamp(0.0, SIDE_M);
            if inside != *x {
                // What lies behind the wall is folded back.
                *x = (2.0 * inside - *x).clamp(0.0, SIDE_M);
                *v = if inside == 0.0 { v.abs() } else { -v.abs() };
            }
        }
        if setting.heading == Heading::RandomAtWalls {
            let inwards =
                |v: &[f64; 2]| wall.iter().zip(v).all(|(x, v)| (0.0..=SIDE_M).contains(x) || (*x < 0.0) == (*v > 0.0));
            loop {
                self.velocity = heading(setting.speed, rng);
                if inwards(&self.velocity) {
                    break;
                }
            }
        }
    }
}

fn heading(speed: f64, rng: &mut Pcg64) -> [f64; 2] {
    let angle = rng.random::<f64>() * TAU;
    [speed * angle.cos(), speed * angle.sin()]
}

/// The two filters.
pub struct Filters {
    leap: Transition<2>,
    noise: [Noise<f64>; 2],
    r: f64,
    dt: f64,
    /// Location and speed of each axis.
    pub kalman: [Belief<2>; 2],
    /// The same.
    pub fosb: FosbAxes<f64, 2>,
}

impl Filters {
    /// After the first measurement `z`; `speed` is a guess of variance `speed_var`.
    pub fn start(setting: &Setting, z: [f64; 2], speed: [f64; 2], speed_var: f64) -> Filters {
        let Design { q11, q13, q33, .. } = setting.design();
        let q = Matrix::<2, 2>::new(q11, q13, q13, q33);
        let f = Matrix::<2, 2>::new(1.0, setting.dt, 0.0, 1.0);
        let cov = Matrix::<2, 2>::new(setting.r, 0.0, 0.0, speed_var);
        let gauss = |mean, var| Gauss { mean, var };
        Filters {
            leap: Transition { next: Vector::zeros(), f, q },
            noise: [setting.noise; 2],
            r: setting.r,
            dt: setting.dt,
            kalman: [0, 1].map(|a| Belief { mean: Vector::from([z[a], speed[a]]), cov }),
            fosb: FosbAxes::start(&z.map(|z| gauss(z, setting.r)), &speed.map(|s| gauss(s, speed_var))),
        }
    }

    /// Goes on by an interval and takes a measurement.
    pub fn step(&mut self, z: [f64; 2]) {
        for (belief, z) in self.kalman.iter_mut().zip(z) {
            let prior = predict(belief, &Transition { next: self.leap.f * belief.mean, ..self.leap });
            let row = Row { h: Vector::from([1.0, 0.0]), residual: z - prior.mean[0], var: self.r };
            *belief = update(&prior, &[row], Robust::None).expect("R is positive").0;
        }
        let z = z.map(|mean| Gauss { mean, var: self.r });
        self.fosb.step(self.dt, &self.noise, &z).expect("D and R are positive, the track is finite");
    }

    /// Estimated locations: Kalman filter, FOSB.
    pub fn locations(&self) -> [[f64; 2]; 2] {
        [self.kalman.map(|b| b.mean[0]), self.fosb.axes.map(|a| a.location().mean)]
    }

    /// Estimated speeds: Kalman filter, FOSB.
    pub fn speeds(&self) -> [[f64; 2]; 2] {
        [self.kalman.map(|b| b.mean[1]), self.fosb.axes.map(|a| a.speed().mean)]
    }
}

/// One run of a setting, the filters started with the true speed: `each` is shown every sample.
pub fn run(
    effort: &Effort,
    setting: &Setting,
    number: usize,
    samples: usize,
    mut each: impl FnMut(&Target, [f64; 2], &Filters),
) {
    let mut rng = stream(effort, setting.part, number);
    let mut target = Target::start(setting, &mut rng);
    let measured = |target: &Target, rng: &mut Pcg64| target.location.map(|x| x + setting.r.sqrt() * normal(rng));
    let z = measured(&target, &mut rng);
    let mut filters = Filters::start(setting, z, target.velocity, setting.noise.over(setting.dt).1);
    each(&target, z, &filters);
    for _ in 1..samples {
        target.step(setting, &mut rng);
        let z = measured(&target, &mut rng);
        filters.step(z);
        each(&target, z, &filters);
    }
}

/// Distances from the truth of one run, for [`ESTIMATORS`], sorted.
pub fn distances(effort: &Effort, setting: &Setting, number: usize) -> [Vec<f64>; 3] {
    let mut out = [(); 3].map(|()| Vec::with_capacity(SAMPLES));
    run(effort, setting, number, SAMPLES, |target, z, filters| {
        let [kalman, fosb] = filters.locations();
        for (of, at) in out.iter_mut().zip([z, kalman, fosb]) {
            of.push((at[0] - target.location[0]).hypot(at[1] - target.location[1]));
        }
    });
    out.iter_mut().for_each(|of| of.sort_by(f64::total_cmp));
    out
}

/// The value below which the share `p` of sorted values lies.
pub fn quantile(sorted: &[f64], p: f64) -> f64 {
    let at = p * (sorted.len() - 1) as f64;
    let (low, part) = (at.floor() as usize, at.fract());
    sorted[low] + part * (sorted[(low + 1).min(sorted.len() - 1)] - sorted[low])
}

/// The printed numbers of a path, as one run gives them: for each of [`ESTIMATORS`] the distances of [`SHARES`].
pub fn numbers(effort: &Effort, setting: &Setting, number: usize) -> [f64; 6] {
    let of = distances(effort, setting, number);
    let mut out = [0.0; 6];
    for (j, sorted) in of.iter().enumerate() {
        for (i, p) in SHARES.into_iter().enumerate() {
            out[2 * j + i] = quantile(sorted, p);
        }
    }
    out
}
