//! Gains and moments of the α-β filter against closed forms, long runs of the filters they belong to, and drawn errors.

mod oracle;

use fixtrail_core::estimators::alpha_beta::{AlphaBeta, Design, Gains, Steady, Truth};
use fixtrail_core::estimators::fosb::{Fosb, Gauss, Noise};
use fixtrail_core::estimators::kalman::{Robust, predict, update};
use fixtrail_core::scalar::{Q16, Scalar};
use fixtrail_core::{Belief, Matrix, Row, StepError, Transition, Vector};
use oracle::random::Random;

fn close(found: f64, expected: f64, rel: f64, what: &str) {
    assert!((found - expected).abs() <= rel * expected.abs(), "{what}: {found}, expected {expected}");
}

/// A design over many decades; process noise of full rank, of rank 1 or of rank 0 across.
fn design(rng: &mut Random) -> Design {
    let spread = |rng: &mut Random, decades: f64| 10f64.powf(decades * (rng.uniform() - 0.5));
    let (r, dt) = (spread(rng, 6.0), spread(rng, 3.0));
    let q33 = r / (dt * dt) * spread(rng, 6.0);
    let q11 = r * spread(rng, 6.0);
    let across = [0.0, 1.0, -1.0, rng.uniform()][rng.count(0, 3)];
    Design { r, dt, q11, q13: across * (q11 * q33).sqrt(), q33 }
}

#[test]
fn kalman_gains_are_where_its_recursion_settles() {
    let mut rng = Random::new(21);
    for case in 0..200 {
        let design = design(&mut rng);
        let Design { r, dt, q11, q13, q33 } = design;
        let steady = design.kalman().unwrap();
        let what = format!("case {case}: {design:?}, {steady:?}");
        let f = Matrix::<2, 2>::new(1.0, dt, 0.0, 1.0);
        let leap = Transition { next: Vector::zeros(), f, q: Matrix::<2, 2>::new(q11, q13, q13, q33) };
        let mut belief = Belief { mean: Vector::zeros(), cov: Matrix::<2, 2>::new(r, 0.0, 0.0, q33 + r / (dt * dt)) };
        let row = Row { h: Vector::from([1.0, 0.0]), residual: 0.0, var: r };
        let mut prior = belief;
        for _ in 0..20_000 {
            prior = predict(&belief, &leap);
            belief = update(&prior, &[row], Robust::None).unwrap().0;
        }
        // Each of the recursion's rounding errors lives for about 1/α steps.
        let s = prior.cov[(0, 0)] + r;
        close(steady.innovation_var, s, 1e-10, &what);
        close(steady.alpha, prior.cov[(0, 0)] / s, 1e-10, &what);
        close(steady.beta, dt * prior.cov[(0, 1)] / s, 1e-10, &what);
        // Entries that are small differences are as good as their terms.
        let sd = [belief.cov[(0, 0)].sqrt(), belief.cov[(1, 1)].sqrt()];
        for (i, j) in [(0, 0), (0, 1), (1, 1)] {
            let off = steady.cov[(i, j)] - belief.cov[(i, j)];
            assert!(off.abs() < 1e-9 * sd[i] * sd[j] + 1e-12 * prior.cov[(i, j)].abs(), "{i} {j}: {off} {what}");
        }
        // The gains are those of the least errors, and the covariance is that of the errors.
        if let Some(moments) = steady.moments(Truth::Matched) {
            close(moments.mse_x, belief.cov[(0, 0)], 1e-8, &what);
        }
    }
}

#[test]
fn kalman_gains_for_accelerations_are_kalatas() {
    for lambda in [1e-4f64, 0.01, 0.1, 0.5, 1.0, 2.0, 5.0, 30.0] {
        for (r, dt) in [(16.0, 1.0), (0.3, 0.1), (2.0, 7.0)] {
            let q = lambda * lambda * r / f64::powi(dt, 4);
            let steady = Design::acceleration(r, dt, q).kalman().unwrap();
            let ratio = (4.0 + lambda - (8.0 * lambda + lambda * lambda).sqrt()) / 4.0;
            let alpha = 1.0 - ratio * ratio;
            close(steady.alpha, alpha, 1e-12, "alpha");
            close(steady.beta, 2.0 * (2.0 - alpha) - 4.0 * (1.0 - alpha).sqrt(), 1e-9, "beta");
        }
    }
    let steady = Design::acceleration(16.0, 1.0, 0.16).kalman().unwrap();
    close(steady.alpha, 0.36, 1e-15, "alpha");
    close(steady.beta, 0.08, 1e-15, "beta");
}

#[test]
fn fosb_gains_are_where_its_recursion_settles_and_its_closed_forms() {
    let mut rng = Random::new(22);
    for case in 0..200 {
        let design = design(&mut rng);
        let Design { r, dt, q11, q33, .. } = design;
        let steady = design.fosb().unwrap();
        let what = format!("case {case}: {design:?}, {steady:?}");
        let mut fosb = Fosb::start(Gauss { mean: 0.0, var: r }, Gauss { mean: 0.0, var: q33 + r / (dt * dt) });
        let mut last = None;
        for _ in 0..20_000 {
            last = Some(fosb.step(dt, &Noise::Speed { q11, q33 }, Gauss { mean: 0.0, var: r }).unwrap());
        }
        let last = last.unwrap();
        close(steady.innovation_var, last.innovation.var, 1e-11, &what);
        close(steady.alpha, last.predicted.var / last.innovation.var, 1e-11, &what);
        close(steady.cov[(0, 0)], last.location.var, 1e-11, &what);
        close(steady.cov[(1, 1)], last.speed.var, 1e-11, &what);
        close(steady.alpha * steady.alpha, steady.beta + q11 / steady.innovation_var, 1e-12, &what);
        let s = steady.innovation_var;
        close(s, 2.0 * r - r * r / s + q11 + dt * (q33 * s).sqrt(), 1e-13, &what);
        // Without noise on the location β = α²; for accelerations β = 2 (√(1 + α²) − 1).
        let speed = Design { q11: 0.0, q13: 0.0, ..design }.fosb().unwrap();
        close(speed.beta, speed.alpha * speed.alpha, 1e-13, &what);
        let acceleration = Design::acceleration(r, dt, q33 / (dt * dt)).fosb().unwrap();
        let root = (1.0 + acceleration.alpha * acceleration.alpha).sqrt();
        close(acceleration.beta, 2.0 * acceleration.alpha * acceleration.alpha / (1.0 + root), 1e-13, &what);
    }
}

#[test]
fn fosb_and_kalman_have_the_same_gains_at_a_tracking_index_of_one() {
    let design = Design::acceleration(16.0, 1.0, 16.0);
    let (kalman, fosb) = (design.kalman().unwrap(), design.fosb().unwrap());
    close(fosb.alpha, kalman.alpha, 1e-14, "alpha");
    close(fosb.beta, kalman.beta, 1e-14, "beta");
}

#[test]
fn moments_are_those_of_drawn_errors() {
    let mut rng = Random::new(23);
    let design = Design::acceleration(16.0, 1.0, 0.16);
    let n = 400_000;
    for truth in [Truth::Matched, Truth::ConstantSpeed] {
        for steady in [design.kalman().unwrap(), design.fosb().unwrap()] {
            let gains = steady.gains::<f64>();
            let mut walk = AlphaBeta::start(0.0, 0.0);
            // The truth stands still: errors do not depend on it, and no digits are lost to a long way.
            let mut sums = [0.0; 3];
            for _ in 0..n {
                let a = 0.4 * rng.normal();
                // x moves by u, s by w; where the truth goes, the estimate is carried along.
                let (u, w) = match truth {
                    Truth::Matched => (a / 2.0, a),
                    Truth::ConstantSpeed => (0.2 * rng.normal(), 0.0),
                };
                walk.predict(1.0).unwrap();
                walk = AlphaBeta { location: walk.location - u, speed: walk.speed - w };
                walk.update(4.0 * rng.normal(), &gains).unwrap();
                let AlphaBeta { location, speed } = walk;
                sums = [sums[0] + location * location, sums[1] + location * speed, sums[2] + speed * speed];
            }
            let found = sums.map(|v| v / f64::from(n));
            let exact = steady.moments(truth).unwrap();
            // Errors are correlated over about 10 steps: 40 000 independent ones, 0.7 % of a variance; four of those.
            close(found[0], exact.mse_x, 0.028, "location");
            close(found[2], exact.mse_s, 0.028, "speed");
            let scale = (exact.mse_x * exact.mse_s).sqrt();
            assert!((found[1] - exact.cov_xs).abs() < 0.028 * scale, "{found:?} {exact:?}");
        }
    }
}

#[test]
fn fosb_reports_too_little_of_the_location_and_too_much_of_the_speed() {
    // Reported over actual variance, and RMS error over Kalman's, at tracking indices from 1e-4 to 5.
    let table = [
        (1e-4, 1.030, 0.67, 67.0),
        (0.01, 1.027, 0.70, 7.3),
        (0.1, 1.019, 0.78, 2.9),
        (0.5, 1.004, 0.93, 2.0),
        (1.0, 1.0000, 1.00, 2.0),
        (2.0, 1.005, 1.03, 2.3),
        (5.0, 1.009, 1.01, 3.0),
    ];
    for (index, rms, location, speed) in table {
        let design = Design::acceleration(16.0, 1.0, index * index * 16.0);
        let (kalman, fosb) = (design.kalman().unwrap(), design.fosb().unwrap());
        let (best, own) = (kalman.moments(Truth::Matched).unwrap(), fosb.moments(Truth::Matched).unwrap());
        assert!(((own.mse_x / best.mse_x).sqrt() - rms).abs() < 6e-4, "{index}: {}", (own.mse_x / best.mse_x).sqrt());
        assert!((fosb.cov[(0, 0)] / own.mse_x - location).abs() < 6e-3, "{index}");
        close(fosb.cov[(1, 1)] / own.mse_s, speed, 0.03, "speed");
    }
}

#[test]
fn hand_made_gains_report_their_own_errors() {
    let design = Design::acceleration(16.0, 1.0, 0.16);
    let kalman = design.kalman().unwrap();
    let same = design.fixed(kalman.alpha, kalman.beta).unwrap();
    for (i, j) in [(0, 0), (0, 1), (1, 1)] {
        close(same.cov[(i, j)], kalman.cov[(i, j)], 1e-12, "covariance");
    }
    close(same.innovation_var, kalman.innovation_var, 1e-12, "innovation");
    let other = design.fixed(0.5, 0.3).unwrap();
    assert!(other.cov[(0, 0)] > kalman.cov[(0, 0)] && other.cov[(1, 1)] > kalman.cov[(1, 1)]);
    for (alpha, beta) in [(0.0, 0.1), (0.5, 0.0), (1.0, 2.0), (-0.1, 0.1), (f64::NAN, 0.1), (1.9, 0.3)] {
        assert_eq!(design.fixed(alpha, beta), None, "{alpha} {beta}");
    }
}

#[test]
fn designs_that_are_none_have_no_gains() {
    let good = Design::acceleration(16.0, 1.0, 0.16);
    for bad in [
        Design { r: 0.0, ..good },
        Design { dt: -1.0, ..good },
        Design { q11: -0.1, ..good },
        Design { q33: f64::NAN, ..good },
        Design { q13: 1.0, ..good },
        Design { r: f64::INFINITY, ..good },
    ] {
        assert_eq!((bad.kalman(), bad.fosb(), bad.fixed(0.5, 0.1)), (None, None, None), "{bad:?}");
    }
    let still = Design { q11: 0.0, q13: 0.0, q33: 0.0, ..good };
    for steady in [still.kalman().unwrap(), still.fosb().unwrap()] {
        assert_eq!((steady.alpha, steady.beta, steady.moments(Truth::Matched)), (0.0, 0.0, None));
    }
}

fn long_run<T: Scalar>(steady: &Steady, limit: f64) {
    let mut rng = Random::new(24);
    let (dt, gains, wide) = (steady.design.dt, steady.gains::<T>(), steady.gains::<f64>());
    let mut small = AlphaBeta::start(T::ZERO, T::ZERO);
    let mut large = AlphaBeta::start(0.0, 0.0);
    let mut worst: f64 = 0.0;
    for _ in 0..2000 {
        let z = T::from_f64(10.0 * rng.normal());
        small.step(T::from_f64(dt), z, &gains).unwrap();
        large.step(T::from_f64(dt).to_f64(), z.to_f64(), &wide).unwrap();
        worst = worst.max((small.location.to_f64() - large.location).abs());
    }
    println!("{}: {worst:.2e} m", core::any::type_name::<T>());
    assert!(worst < limit, "{worst}");
}

#[test]
fn number_formats_deviate_by_little() {
    let steady = Design::acceleration(16.0, 0.125, 0.16).kalman().unwrap();
    long_run::<f32>(&steady, 1e-4);
    long_run::<Q16>(&steady, 2e-2);
}

#[test]
fn a_settled_fosb_is_an_alpha_beta_filter() {
    let design = Design { r: 16.0, dt: 0.5, q11: 0.16, q13: 0.0, q33: 0.16 };
    let steady = design.fosb().unwrap();
    let settled = [(0, 0), (1, 1)].map(|at| Gauss { mean: 1.0, var: steady.cov[at] });
    let mut fosb = Fosb::start(settled[0], settled[1]);
    let mut walk = AlphaBeta::start(1.0, 1.0);
    let mut rng = Random::new(25);
    for _ in 0..500 {
        let z = 5.0 * rng.normal();
        let step = fosb.step(0.5, &Noise::Speed { q11: 0.16, q33: 0.16 }, Gauss { mean: z, var: 16.0 }).unwrap();
        let nu = walk.step(0.5, z, &steady.gains()).unwrap();
        assert!((nu - step.innovation.mean).abs() < 1e-12);
        assert!((walk.location - step.location.mean).abs() < 1e-12);
        assert!((walk.speed - step.speed.mean).abs() < 1e-12);
    }
}

#[test]
fn bad_steps_change_nothing() {
    let gains = Gains { alpha: 0.5, beta_per_s: 0.1 };
    let mut walk = AlphaBeta::start(1.0, 2.0);
    let before = walk;
    assert!(matches!(walk.step(0.0, 1.0, &gains), Err(StepError::Interval { .. })));
    assert!(matches!(walk.step(1.0, f64::NAN, &gains), Err(StepError::Measurement { .. })));
    assert!(matches!(walk.step(1e308, 1e308, &gains), Err(StepError::NotFinite { component: 0 })));
    let steep = Gains { alpha: 0.0, beta_per_s: 1e300 };
    assert!(matches!(walk.step(1.0, 1e300, &steep), Err(StepError::NotFinite { component: 1 })));
    assert_eq!(walk, before);
}
