//! Targets that move otherwise than a model says: laws of each motion, and closed forms.

use fixtrail_sim::motions::{Kinematics, open};
use fixtrail_track::spec::{MotionSpec, Shape, Walls};
use rand_pcg::Pcg64;

fn rng(seed: u128) -> Pcg64 {
    Pcg64::new(seed, 0)
}

fn start() -> Kinematics {
    Kinematics { position_m: [3.0, 4.0, 0.0], velocity_mps: [2.0, -1.0, 0.0], acceleration_mps2: [0.0; 3] }
}

/// The target at `count` instants `dt_s` apart, the start first.
fn path(spec: &MotionSpec, dt_s: f64, count: usize, seed: u128) -> Vec<Kinematics> {
    let mut rng = rng(seed);
    let mut path = open(spec, 2, start(), &mut rng);
    (0..count)
        .map(|_| {
            let now = path.now();
            path.advance(dt_s, &mut rng);
            now
        })
        .collect()
}

/// Whether velocities are the slopes of positions and accelerations those of velocities, by central differences.
fn assert_slopes(states: &[Kinematics], dt_s: f64, tolerance: f64) {
    for w in states.windows(3) {
        for axis in 0..2 {
            let slope = |f: fn(&Kinematics) -> [f64; 3]| (f(&w[2])[axis] - f(&w[0])[axis]) / (2.0 * dt_s);
            let (v, a) = (slope(|s| s.position_m), slope(|s| s.velocity_mps));
            assert!((v - w[1].velocity_mps[axis]).abs() < tolerance, "{w:?}");
            assert!((a - w[1].acceleration_mps2[axis]).abs() < tolerance, "{w:?}");
        }
    }
}

#[test]
fn circle_keeps_its_radius_and_comes_round() {
    let spec = MotionSpec::Circle { centre_m: [10.0, 20.0], radius_m: 5.0, speed_mps: -2.0, start_rad: 0.3 };
    let turn_s = std::f64::consts::TAU * 5.0 / 2.0;
    let states = path(&spec, turn_s / 1000.0, 1001, 1);
    assert_slopes(&states, turn_s / 1000.0, 1e-4);
    for s in &states {
        let r = (s.position_m[0] - 10.0).hypot(s.position_m[1] - 20.0);
        assert!((r - 5.0).abs() < 1e-12 && (s.velocity_mps[0].hypot(s.velocity_mps[1]) - 2.0).abs() < 1e-12);
    }
    assert!((states[1000].position_m[0] - states[0].position_m[0]).abs() < 1e-9);
    // Clockwise: y falls at first.
    assert!(states[1].position_m[1] < states[0].position_m[1]);
}

#[test]
fn profiles_are_the_integrals_of_their_accelerations() {
    for shape in [Shape::Step, Shape::Ramp, Shape::Triangle] {
        let spec =
            MotionSpec::Profile { velocity_mps: None, shape, acceleration_mps2: [0.2, -0.4, 0.0], span_s: [2.0, 6.0] };
        let dt_s = 1e-3;
        let states = path(&spec, dt_s, 10_000, 1);
        let at = |t_s: f64| states[(t_s / dt_s).round() as usize];
        let [quarter, middle, late] = [3.0, 3.999, 5.0].map(|t| at(t).acceleration_mps2[0] / 0.2);
        match shape {
            Shape::Step => assert_eq!([quarter, middle, late], [1.0; 3]),
            Shape::Ramp => assert!((quarter - 0.25).abs() < 1e-9 && (late - 0.75).abs() < 1e-9),
            Shape::Triangle => assert!((quarter - 0.5).abs() < 1e-9 && (late - 0.5).abs() < 1e-9 && middle > 0.99),
        }
        assert_eq!((at(1.0).acceleration_mps2, at(7.0).acceleration_mps2), ([0.0, -0.0, 0.0], [0.0, -0.0, 0.0]));
        // By the trapezium rule, whose error is below h² for slopes and a jump's for steps.
        let mut now = start();
        for w in states.windows(2) {
            for axis in 0..2 {
                let a = 0.5 * (w[0].acceleration_mps2[axis] + w[1].acceleration_mps2[axis]);
                let v = now.velocity_mps[axis];
                now.velocity_mps[axis] += a * dt_s;
                now.position_m[axis] += 0.5 * (v + now.velocity_mps[axis]) * dt_s;
            }
        }
        let last = states.last().unwrap();
        for axis in 0..2 {
            assert!((now.velocity_mps[axis] - last.velocity_mps[axis]).abs() < 5e-4, "{shape:?} {now:?} {last:?}");
            assert!((now.position_m[axis] - last.position_m[axis]).abs() < 5e-3, "{shape:?} {now:?} {last:?}");
        }
    }
}

#[test]
fn a_mirrored_path_is_a_folded_line() {
    let spec = MotionSpec::Bouncing { area_m: [7.0, 5.0], speed_mps: 3.0, walls: Walls::Mirror };
    let states = path(&spec, 0.9, 400, 5);
    let (first, fold) = (states[0], |v: f64, side: f64| {
        let w = v.rem_euclid(2.0 * side);
        w.min(2.0 * side - w)
    });
    for (k, s) in states.iter().enumerate() {
        for (axis, side) in [7.0, 5.0].into_iter().enumerate() {
            let straight = first.position_m[axis] + first.velocity_mps[axis] * 0.9 * k as f64;
            assert!((s.position_m[axis] - fold(straight, side)).abs() < 1e-9, "{k} {axis}");
        }
    }
}

#[test]
fn a_random_bounce_stays_inside_turns_at_walls_alone_and_fills_the_room() {
    let (spec, dt_s) = (MotionSpec::Bouncing { area_m: [50.0, 50.0], speed_mps: 1.36, walls: Walls::Random }, 1.0);
    let states = path(&spec, dt_s, 40_000, 2);
    let mut turns = 0;
    let mut quarters = [0; 4];
    for w in states.windows(2) {
        let [p, q] = [w[0].position_m, w[1].position_m];
        assert!(q[..2].iter().all(|v| (0.0..=50.0).contains(v)));
        assert!((w[1].velocity_mps[0].hypot(w[1].velocity_mps[1]) - 1.36).abs() < 1e-12);
        let step = (q[0] - p[0]).hypot(q[1] - p[1]);
        assert!(step <= 1.36 + 1e-12);
        if w[0].velocity_mps == w[1].velocity_mps {
            assert!((step - 1.36).abs() < 1e-9);
        } else {
            turns += 1;
            // A wall was within reach.
            assert!(p[..2].iter().any(|v| v.min(50.0 - v) <= 1.36), "{p:?}");
        }
        quarters[usize::from(q[0] > 25.0) + 2 * usize::from(q[1] > 25.0)] += 1;
    }
    // Chords of a square in random directions are some 30 m long.
    assert!((800..4000).contains(&turns), "{turns}");
    assert!(quarters.iter().all(|n| (8_000..12_000).contains(n)), "{quarters:?}");
}

#[test]
fn noises_have_the_spread_that_they_are_given() {
    let (dt_s, count) = (0.5, 20_001);
    let speed = MotionSpec::ConstantSpeed { velocity_mps: Some([1.0, 2.0, 0.0]), position_sd_m: 0.4 };
    let pushed = MotionSpec::Acceleration { velocity_mps: None, acceleration_sd_mps2: 0.4 };
    // A variance over 40 000 values has a relative standard error of √(2/40 000) = 0.7 %; four of them.
    for (spec, velocity, sd) in [(speed, [1.0, 2.0], 0.4), (pushed, [2.0, -1.0], 0.4 * dt_s * dt_s / 2.0)] {
        let states = path(&spec, dt_s, count, 3);
        let rest = |w: &[Kinematics], i: usize| w[1].position_m[i] - w[0].position_m[i] - dt_s * velocity[i];
        let sum: f64 = states.windows(2).map(|w| rest(w, 0).powi(2) + rest(w, 1).powi(2)).sum();
        let var = sum / (2 * (count - 1)) as f64;
        assert!((var / (sd * sd) - 1.0).abs() < 0.028, "{var}");
        assert!(states.iter().all(|s| s.velocity_mps[..2] == velocity && s.position_m[2] == 0.0));
    }
}
