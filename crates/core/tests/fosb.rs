//! The FOSB filter against the Kalman filter it is a variant of, its limits, its number formats, and what a bad step leaves.

mod oracle;

use core::cell::Cell;
use fixtrail_core::estimators::alpha_beta::{AlphaBeta, Gains};
use fixtrail_core::estimators::fosb::{Fosb, FosbAxes, Gauss, LiteralStart, Noise};
use fixtrail_core::estimators::kalman::{Robust, predict, update};
use fixtrail_core::scalar::{Q16, Scalar};
use fixtrail_core::{Belief, Matrix, Row, StepError, Transition, Vector};
use oracle::random::Random;

fn close(found: f64, expected: f64, rel: f64, what: &str) {
    assert!((found - expected).abs() <= rel * expected.abs().max(1e-300), "{what}: {found}, expected {expected}");
}

fn gauss(mean: f64, var: f64) -> Gauss<f64> {
    Gauss { mean, var }
}

/// Either noise, with variances over some decades.
fn noise(rng: &mut Random) -> Noise<f64> {
    let spread = |rng: &mut Random| 10f64.powf(-3.0 + 4.0 * rng.uniform());
    match rng.chance(0.5) {
        true => Noise::Acceleration { q: spread(rng) },
        false => Noise::Speed { q11: spread(rng), q33: spread(rng) },
    }
}

fn leap(dt: f64, noise: &Noise<f64>, x: &Vector<2>) -> Transition<2> {
    let f = Matrix::<2, 2>::new(1.0, dt, 0.0, 1.0);
    let (q11, q33) = noise.over(dt);
    Transition { next: f * x, f, q: Matrix::<2, 2>::new(q11, 0.0, 0.0, q33) }
}

#[test]
fn fosb_is_the_kalman_filter_that_forgets_the_covariance_after_each_update() {
    let mut rng = Random::new(11);
    for case in 0..100 {
        let start = [gauss(rng.normal(), 0.1 + rng.uniform()), gauss(rng.normal(), 10f64.powf(4.0 * rng.uniform()))];
        let mut fosb = Fosb::start(start[0], start[1]);
        let mut belief = Belief {
            mean: Vector::from([start[0].mean, start[1].mean]),
            cov: Matrix::<2, 2>::new(start[0].var, 0.0, 0.0, start[1].var),
        };
        for k in 0..60 {
            let what = format!("case {case}, step {k}");
            // A gap now and then: several predictions before an update.
            let epochs = if rng.chance(0.3) { rng.count(2, 6) } else { 1 };
            let mut before = None;
            for _ in 0..epochs {
                let (dt, noise) = (10f64.powf(-1.5 + 2.0 * rng.uniform()), noise(&mut rng));
                let leap = leap(dt, &noise, &belief.mean);
                before = Some((belief, leap));
                belief = predict(&belief, &leap);
                fosb.predict(dt, &noise).unwrap();
                close(fosb.location().mean, belief.mean[0], 1e-11, &what);
                close(fosb.location().var, belief.cov[(0, 0)], 1e-12, &what);
                close(fosb.speed().var, belief.cov[(1, 1)], 1e-12, &what);
                close(fosb.covariance(), belief.cov[(0, 1)], 1e-12, &what);
            }
            let z = gauss(belief.mean[0] + 3.0 * rng.normal(), 10f64.powf(-1.0 + 3.0 * rng.uniform()));
            let row = Row { h: Vector::from([1.0, 0.0]), residual: z.mean - belief.mean[0], var: z.var };
            // The speed of the epoch before, by conditioning on z = x + D s + noise.
            let (old, leap) = before.unwrap();
            let h = Vector::from([1.0, leap.f[(0, 1)]]);
            let aside = Row { h, residual: row.residual, var: z.var + leap.q[(0, 0)] };
            let refined = update(&old, &[aside], Robust::None).unwrap().0;
            let predicted = belief;
            belief = update(&belief, &[row], Robust::None).unwrap().0;
            belief.cov[(0, 1)] = 0.0;
            belief.cov[(1, 0)] = 0.0;
            let step = fosb.update(z).unwrap();
            close(step.predicted.var, predicted.cov[(0, 0)], 1e-12, &what);
            close(step.innovation.var, predicted.cov[(0, 0)] + z.var, 1e-12, &what);
            assert!((step.innovation.mean - row.residual).abs() < 1e-10, "{what}");
            assert!((step.location.mean - belief.mean[0]).abs() < 1e-10, "{what}");
            assert!((step.speed.mean - belief.mean[1]).abs() < 1e-10 * belief.mean[1].abs().max(1.0), "{what}");
            close(step.location.var, belief.cov[(0, 0)], 1e-12, &what);
            // The Kalman filter subtracts here.
            close(step.speed.var, belief.cov[(1, 1)], 1e-9, &what);
            let found = step.refined.unwrap();
            assert!((found.mean - refined.mean[1]).abs() < 1e-9 * refined.mean[1].abs().max(1.0), "{what}");
            close(found.var, refined.cov[(1, 1)], 1e-9, &what);
            assert_eq!((fosb.location(), fosb.speed(), fosb.covariance()), (step.location, step.speed, 0.0));
        }
    }
}

#[test]
fn one_gap_of_several_predictions_beats_forgetting_at_each() {
    // 70 % of the epochs are missed: R = 16, q = 0.16, D = 1. What is reported of a long gap is larger when nothing is forgotten.
    let noise = Noise::Acceleration { q: 0.16 };
    let mut kept = Fosb::start(gauss(0.0, 16.0), gauss(0.0, 4.0));
    let mut forgotten = kept;
    for _ in 0..4 {
        kept.predict(1.0, &noise).unwrap();
        forgotten.predict(1.0, &noise).unwrap();
        forgotten = Fosb::start(forgotten.location(), forgotten.speed());
    }
    // 16 + 4²·4 + Σ (0.04 + 0.16 j²) against the same without the cross terms.
    close(kept.location().var, 16.0 + 64.0 + 4.0 * 0.04 + 0.16 * 14.0, 1e-14, "kept");
    close(forgotten.location().var, 16.0 + 16.0 + 4.0 * 0.04 + 0.16 * 6.0, 1e-14, "forgotten");
}

#[test]
fn a_second_fix_of_the_same_instant_leaves_the_speed() {
    let mut fosb = Fosb::start(gauss(1.0, 2.0), gauss(3.0, 4.0));
    let step = fosb.update(gauss(3.0, 2.0)).unwrap();
    assert_eq!(step.refined, None);
    assert_eq!(step.speed, gauss(3.0, 4.0));
    assert_eq!(step.location, gauss(2.0, 1.0));
}

#[test]
fn limits_are_those_of_the_messages() {
    let noise = Noise::Speed { q11: 0.0, q33: 0.0 };
    // A known speed: the mean of n measurements moved along.
    let mut known = Fosb::start(gauss(0.0, 2.0), gauss(1.5, 0.0));
    for k in 1..10 {
        let step = known.step(1.0, &noise, gauss(1.5 * f64::from(k) + 1.0, 2.0)).unwrap();
        close(step.location.var, 2.0 / f64::from(k + 1), 1e-14, "variance");
        assert_eq!(step.speed, gauss(1.5, 0.0));
    }
    // A speed of which nothing is known is (z1 − z0)/D after two measurements, its variance (R0 + R1 + Q11)/D².
    let mut unknown = Fosb::start(gauss(1.0, 2.0), gauss(0.0, 1e14));
    let step = unknown.step(0.5, &Noise::Speed { q11: 1.0, q33: 0.5 }, gauss(4.0, 3.0)).unwrap();
    close(step.refined.unwrap().mean, 6.0, 1e-12, "speed");
    close(step.refined.unwrap().var, 24.0, 1e-12, "its variance");
    close(step.speed.var, 24.5, 1e-12, "forward");
    close(step.location.mean, 4.0, 1e-12, "location");
    // A measurement that says nothing.
    let mut blind = Fosb::start(gauss(1.0, 2.0), gauss(0.5, 1.0));
    let step = blind.step(2.0, &noise, gauss(1e3, 1e30)).unwrap();
    close(step.location.mean, 2.0, 1e-14, "blind");
    close(step.location.var, 6.0, 1e-14, "blind");
    // One that says it all.
    let step = blind.step(1.0, &noise, gauss(-3.0, 1e-20)).unwrap();
    assert_eq!(step.location.mean, -3.0);
    assert!(step.location.var <= 1e-20);
}

#[test]
fn without_process_noise_location_variance_falls_as_the_root_of_time() {
    // A closed form of the recursion's limit: α √k → 1, where the Kalman filter's variance falls as 4/k.
    let noise = Noise::Speed { q11: 0.0, q33: 0.0 };
    let mut fosb = Fosb::start(gauss(0.0, 1.0), gauss(0.0, 1e8));
    for k in 1..=100_000 {
        let var = fosb.step(1.0, &noise, gauss(0.0, 1.0)).unwrap().location.var;
        if k == 1000 || k == 100_000 {
            let root = f64::from(k).sqrt();
            assert!((var * root - 1.0).abs() < 1.0 / root.sqrt(), "{k}: {}", var * root);
        }
    }
}

#[test]
fn the_literal_start_is_that_of_the_golden_vector() {
    // golden/fosb/fosb_literal_init_1d.json: z_1 changes the location alone.
    let noise = Noise::Speed { q11: 0.16, q33: 0.16 };
    let start = LiteralStart { location: gauss(-2.5623, 18.334), forward: gauss(1.1, 2.0), refined: gauss(0.9, 1.5) };
    let (mut fosb, first) = Fosb::start_literal(&start, 1.4634, &noise, gauss(2.0498, 20.4655)).unwrap();
    close(first.predicted.mean, -0.9525599999999999, 1e-14, "prediction");
    close(first.predicted.var, 22.77707912, 1e-14, "prediction");
    close(first.location.mean, 0.6288672103648567, 1e-14, "x_1");
    close(first.location.var, 10.779752785715894, 1e-14, "var x_1");
    assert_eq!(first.speed, gauss(0.9, 1.66));
    assert_eq!(first.refined, None);
    let step = fosb.step(1.4658, &noise, gauss(0.2379, 11.0967)).unwrap();
    close(step.location.mean, 0.9791169009358033, 1e-14, "x_2");
    close(step.speed.mean, 0.7374697236628707, 1e-14, "s_2");
    close(step.speed.var, 1.5887544282670265, 1e-14, "var s_2");
    close(step.refined.unwrap().var, 1.4287544282670264, 1e-14, "refined");
}

#[test]
fn axes_are_filters_side_by_side() {
    let mut rng = Random::new(12);
    let start: [Gauss<f64>; 3] = core::array::from_fn(|_| gauss(rng.normal(), 1.0 + rng.uniform()));
    let speed: [Gauss<f64>; 3] = core::array::from_fn(|_| gauss(rng.normal(), 1.0 + rng.uniform()));
    let mut together = FosbAxes::start(&start, &speed);
    let mut alone: [Fosb<f64>; 3] = core::array::from_fn(|i| Fosb::start(start[i], speed[i]));
    for _ in 0..50 {
        let (dt, noise) = (0.1 + rng.uniform(), core::array::from_fn(|_| noise(&mut rng)));
        let z = core::array::from_fn(|_| gauss(rng.normal(), 0.5 + rng.uniform()));
        let steps = together.step(dt, &noise, &z).unwrap();
        for i in 0..3 {
            assert_eq!(steps[i], alone[i].step(dt, &noise[i], z[i]).unwrap());
        }
    }
    assert_eq!(together.axes, alone);
    // The last axis fails: none has moved.
    let noise = [Noise::Acceleration { q: 1.0 }; 3];
    let bad = [gauss(0.0, 1.0), gauss(0.0, 1.0), gauss(0.0, 0.0)];
    assert!(together.step(1.0, &noise, &bad).is_err());
    assert!(together.update(&bad).is_err());
    let odd = [noise[0], noise[1], Noise::Acceleration { q: -1.0 }];
    assert!(together.predict(1.0, &odd).is_err());
    assert_eq!(together.axes, alone);
}

fn refuses<T: Scalar>(largest: f64) {
    let n = T::from_f64;
    let noise = Noise::Acceleration { q: n(0.16) };
    let good = Gauss { mean: n(1.0), var: n(2.0) };
    let mut fosb = Fosb::start(good, good);
    let before = fosb;
    for dt in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(matches!(fosb.step(n(dt), &noise, good), Err(StepError::Interval { .. })), "{dt}");
        assert_eq!(fosb, before);
    }
    for var in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let z = Gauss { var: n(var), ..good };
        assert!(matches!(fosb.step(n(1.0), &noise, z), Err(StepError::MeasurementVariance { .. })), "{var}");
        assert_eq!(fosb, before);
    }
    for mean in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let z = Gauss { mean: n(mean), ..good };
        assert!(matches!(fosb.step(n(1.0), &noise, z), Err(StepError::Measurement { .. })), "{mean}");
        assert_eq!(fosb, before);
    }
    let negative = Noise::Speed { q11: n(0.0), q33: n(-1.0) };
    assert!(matches!(fosb.predict(n(1.0), &negative), Err(StepError::ProcessNoise { .. })));
    // The location's variance leaves the range.
    assert!(matches!(
        fosb.predict(n(largest), &noise),
        Err(StepError::NotFinite { .. } | StepError::ProcessNoise { .. })
    ));
    let calm = Noise::Speed { q11: n(0.0), q33: n(0.0) };
    assert!(matches!(fosb.predict(n(largest), &calm), Err(StepError::NotFinite { component: 0 })));
    assert_eq!(fosb, before);
}

#[test]
fn bad_steps_change_nothing() {
    refuses::<f64>(1e200);
    refuses::<f32>(1e30);
    refuses::<Q16>(300.0);
}

thread_local! {
    /// Multiplications, additions and divisions.
    static COUNTS: Cell<[u32; 3]> = const { Cell::new([0; 3]) };
}

/// A number that counts what is done with it.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
struct Counted(f64);

fn counted(kind: usize, out: f64) -> Counted {
    let mut counts = COUNTS.get();
    counts[kind] += 1;
    COUNTS.set(counts);
    Counted(out)
}

macro_rules! counts {
    ($($op:ident $name:ident $kind:literal $sign:tt),*) => {$(
        impl core::ops::$op for Counted {
            type Output = Counted;

            fn $name(self, other: Counted) -> Counted {
                counted($kind, self.0 $sign other.0)
            }
        }
    )*};
}
counts!(Mul mul 0 *, Add add 1 +, Sub sub 1 -, Div div 2 /);

impl Scalar for Counted {
    type Inverse = Counted;

    const ZERO: Counted = Counted(0.0);
    const HALF: Counted = Counted(0.5);

    fn is_finite(self) -> bool {
        self.0.is_finite()
    }

    fn from_f64(value: f64) -> Counted {
        Counted(value)
    }

    fn to_f64(self) -> f64 {
        self.0
    }

    fn inverse(self) -> Counted {
        counted(2, 1.0 / self.0)
    }

    fn times(self, inverse: Counted) -> Counted {
        self * inverse
    }
}

#[test]
fn a_step_takes_the_operations_it_is_said_to() {
    let n = Counted;
    let mut fosb = Fosb::start(Gauss { mean: n(0.0), var: n(16.0) }, Gauss { mean: n(0.0), var: n(4.0) });
    let noise = Noise::Speed { q11: n(0.1), q33: n(0.2) };
    let mut walk = AlphaBeta::start(n(0.0), n(0.0));
    let gains = Gains { alpha: n(0.3), beta_per_s: n(0.1) };
    for _ in 0..3 {
        COUNTS.set([0; 3]);
        fosb.step(n(1.0), &noise, Gauss { mean: n(3.0), var: n(16.0) }).unwrap();
        assert_eq!(COUNTS.get(), [12, 13, 1]);
        COUNTS.set([0; 3]);
        walk.step(n(1.0), n(3.0), &gains).unwrap();
        assert_eq!(COUNTS.get(), [3, 4, 0]);
    }
}

/// Largest deviation of location, in metres, from the same filter in `f64` over walks of 1000 steps, R = 16 m², q = 0.16 m²/s⁴.
fn deviation<T: Scalar>(dt: f64, offset: f64, speed_var: f64) -> f64 {
    let mut rng = Random::new(13);
    let mut worst: f64 = 0.0;
    for _ in 0..20 {
        let (q, r) = (0.16, 16.0);
        let n = T::from_f64;
        // What both are told is representable in both: the deviation is that of the arithmetic.
        let exact = |v: f64| n(v).to_f64();
        let (narrow, wide) = (Noise::Acceleration { q: n(q) }, Noise::Acceleration { q: exact(q) });
        let phase = rng.uniform();
        let truth = |k: usize| offset + 100.0 * (phase + 0.05 * dt * k as f64).sin();
        let first = exact(truth(0) + 4.0 * rng.normal());
        let mut small = Fosb::start(Gauss { mean: n(first), var: n(r) }, Gauss { mean: n(0.0), var: n(speed_var) });
        let mut large = Fosb::start(gauss(first, r), gauss(0.0, speed_var));
        for k in 1..1000 {
            let z = exact(truth(k) + 4.0 * rng.normal());
            let found = small.step(n(dt), &narrow, Gauss { mean: n(z), var: n(r) }).unwrap();
            let expected = large.step(exact(dt), &wide, gauss(z, r)).unwrap();
            worst = worst.max((found.location.mean.to_f64() - expected.location.mean).abs());
        }
    }
    worst
}

#[test]
fn single_precision_deviates_by_little() {
    for (dt, limit) in [(1.0, 1.4e-3), (0.1, 1.4e-3), (0.01, 3.5e-3)] {
        let worst = deviation::<f32>(dt, 3000.0, 4.0);
        println!("f32, D = {dt} s, 3 km off: {worst:.2e} m");
        assert!(worst < limit, "{dt}: {worst}");
    }
}

#[test]
fn fixed_point_deviates_by_little() {
    // At 100 Hz the speed noise of a step, 1.6e-5 m²/s², is one unit of the last place: what deviates is the noise, not the sums.
    for (dt, limit) in [(1.0, 1e-3), (0.1, 6e-3), (0.01, 0.5)] {
        let worst = deviation::<Q16>(dt, 0.0, 4.0);
        println!("Q16.16, D = {dt} s: {worst:.2e} m");
        assert!(worst < limit, "{dt}: {worst}");
    }
}

#[test]
fn single_precision_keeps_the_speed_variance_of_a_vague_start() {
    // V − K t in place of the products loses all digits here: 1e10 − 1e10.
    let noise = (Noise::Acceleration { q: 0.16f32 }, Noise::Acceleration { q: f64::from(0.16f32) });
    let mut small = Fosb::start(Gauss { mean: 0.0f32, var: 4.5 }, Gauss { mean: 0.0, var: 1e10 });
    let mut large = Fosb::start(gauss(0.0, 4.5), gauss(0.0, 1e10));
    let found = small.step(0.125, &noise.0, Gauss { mean: 1.0, var: 4.5 }).unwrap();
    let expected = large.step(0.125, &noise.1, gauss(1.0, 4.5)).unwrap();
    close(f64::from(found.speed.var), expected.speed.var, 4e-7, "speed variance");
}

#[test]
fn fixed_point_rounds_to_nearest_and_shows_overflow() {
    let n = Q16::from_f64;
    let mut rng = Random::new(14);
    for _ in 0..2000 {
        let (a, b) = (n(100.0 * rng.normal()), n(100.0 * rng.normal()));
        let half = 0.5 / 65536.0 + 1e-12;
        assert!(((a * b).to_f64() - a.to_f64() * b.to_f64()).abs() <= half || !(a * b).is_finite());
        assert!(b == n(0.0) || ((a / b).to_f64() - a.to_f64() / b.to_f64()).abs() <= half || !(a / b).is_finite());
        assert_eq!((a + b).to_f64(), a.to_f64() + b.to_f64());
        assert_eq!((a - b).to_f64(), a.to_f64() - b.to_f64());
    }
    let large = n(30000.0);
    for out in [large + large, large * large, n(0.0) - large - large, large / n(0.0), large / n(0.001), n(f64::NAN)] {
        assert!(!out.is_finite(), "{out:?}");
        assert!(!(out + n(-1.0)).is_finite() && !(n(1.0) - out).is_finite() && !(out * n(0.5)).is_finite());
    }
    assert_eq!(Q16::from_bits(3).to_bits(), 3);
}
