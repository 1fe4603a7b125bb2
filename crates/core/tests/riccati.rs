//! Bounds and critical arrival rates against closed forms, dense recursions and simulated arrivals.

mod oracle;

use fixtrail_core::riccati::{Lossy, spectral_radius};
use fixtrail_core::{Matrix, Vector};
use nalgebra::{DMatrix, DVector};
use oracle::random::Random;
use oracle::{Instant, Run, Verdict};

/// A system as plain matrices, and its recursions as they are printed.
struct Dense {
    a: DMatrix<f64>,
    w: DMatrix<f64>,
    c: DMatrix<f64>,
    r: DMatrix<f64>,
}

impl Dense {
    fn random(rng: &mut Random, n: usize, q: usize, radius: f64) -> Dense {
        let a = rng.matrix(n, n);
        let found = eigenvalue_magnitudes(&a)[0];
        Dense { a: a * (radius / found), w: rng.definite(n, 1.0), c: rng.matrix(q, n), r: rng.definite(q, 0.7) }
    }

    fn lossy<const N: usize>(&self) -> Lossy<N> {
        let fixed = |m: &DMatrix<f64>| Matrix::<N, N>::from_fn(|i, j| m[(i, j)]);
        let c: Vec<Vector<N>> = (0..self.c.nrows()).map(|i| Vector::from_fn(|j, _| self.c[(i, j)])).collect();
        // Symmetric: column by column is row by row.
        Lossy::new(&fixed(&self.a), &fixed(&self.w), &c, self.r.as_slice()).expect("R is positive definite")
    }

    /// X − λ X Cᵀ (C X Cᵀ + R)⁻¹ C X.
    fn filtered(&self, x: &DMatrix<f64>, arrival: f64) -> DMatrix<f64> {
        let s = &self.c * x * self.c.transpose() + &self.r;
        let xc = x * self.c.transpose();
        x - &xc * s.try_inverse().expect("R is positive definite") * xc.transpose() * arrival
    }

    fn step(&self, x: &DMatrix<f64>, arrival: f64) -> DMatrix<f64> {
        let next = &self.a * self.filtered(x, arrival) * self.a.transpose() + &self.w;
        (&next + next.transpose()) * 0.5
    }
}

/// Largest first.
fn eigenvalue_magnitudes(a: &DMatrix<f64>) -> Vec<f64> {
    let mut found: Vec<f64> = a.complex_eigenvalues().iter().map(|e| e.re.hypot(e.im)).collect();
    found.sort_by(|x, y| y.total_cmp(x));
    found
}

fn deviation<const N: usize>(ours: &Matrix<N, N>, truth: &DMatrix<f64>) -> f64 {
    let largest = truth.amax();
    (0..N * N).map(|e| (ours[(e / N, e % N)] - truth[(e / N, e % N)]).abs() / largest).fold(0.0, f64::max)
}

fn square<const N: usize>(rows: [[f64; N]; N]) -> Matrix<N, N> {
    Matrix::from_fn(|i, j| rows[i][j])
}

fn scalar(a: f64, w: f64, r: f64) -> Lossy<1> {
    Lossy::new(&Matrix::<1, 1>::new(a), &Matrix::<1, 1>::new(w), &[Vector::<1>::new(1.0)], &[r]).expect("R is positive")
}

/// The example of the literature with two unstable modes and one sensor.
fn two_unstable() -> Lossy<2> {
    Lossy::new(&square([[1.25, 0.0], [1.0, 1.1]]), &(Matrix::identity() * 20.0), &[Vector::from([1.0, 1.0])], &[2.5])
        .expect("R is positive")
}

#[test]
fn scalar_bounds_equal_the_roots_of_the_quadratic() {
    for (a, w, r) in [(1.25_f64, 1.0_f64, 2.0_f64), (0.9, 0.3, 0.01), (1.0, 1e-4, 1.0), (-2.0, 5.0, 1.0)] {
        for arrival in [0.0, 0.2, 0.5, 0.8, 0.95, 1.0] {
            let system = scalar(a, w, r);
            let left = (1.0 - arrival) * a * a;
            assert_eq!(system.lower_bound(arrival).is_some(), left < 1.0, "a = {a}, λ = {arrival}");
            assert_eq!(system.upper_bound(arrival).is_some(), left < 1.0, "a = {a}, λ = {arrival}");
            if left >= 1.0 {
                continue;
            }
            let lower = system.lower_bound(arrival).expect("exists")[(0, 0)];
            // A geometric series; doubling loses some units in the last place.
            assert!((lower * (1.0 - left) / w - 1.0).abs() < 1e-12, "{lower}");
            // x = a²x + w − λa²x²/(x + r)  ⇔  (1 − (1 − λ)a²) x² + (r(1 − a²) − w) x − w r = 0.
            let (p, q) = (1.0 - left, r * (1.0 - a * a) - w);
            let root = ((q * q + 4.0 * p * w * r).sqrt() - q) / (2.0 * p);
            let upper = system.upper_bound(arrival).expect("exists")[(0, 0)];
            // The accuracy that is promised.
            assert!((upper / root - 1.0).abs() < 1e-9, "a = {a}, λ = {arrival}: {upper}, expected {root}");
            assert!(lower <= upper * (1.0 + 1e-9), "{lower} {upper}");
        }
    }
}

#[test]
fn critical_rate_of_one_state_is_the_closed_form() {
    for (a, printed) in [(1.05, 0.0930), (1.25, 0.36), (1.5, 0.5556), (2.0, 0.75)] {
        let critical = scalar(a, 1.0, 1.0).critical_rate();
        // Four digits are printed; both bounds are the same number to the width of the bisection, 2⁻⁴⁰.
        assert!((critical.lower - printed).abs() < 6e-5, "{critical:?}");
        assert!((critical.upper.expect("seen") - critical.lower).abs() < 1e-11, "{critical:?}");
    }
    for a in [0.0, 0.5, -0.99, 1.0] {
        let critical = scalar(a, 1.0, 1.0).critical_rate();
        assert_eq!((critical.lower, critical.upper), (0.0, Some(0.0)), "a = {a}");
    }
}

#[test]
fn critical_rate_of_two_unstable_modes_is_that_of_the_literature() {
    let critical = two_unstable().critical_rate();
    assert!((critical.lower - 0.36).abs() < 1e-12, "{critical:?}");
    let upper = critical.upper.expect("seen");
    // 0.472 was found with the recursion itself, to three digits.
    assert!((upper - 0.472).abs() < 0.0015, "{upper}");
    // For one scalar measurement the boundary is 1 − 1/Π|λ_i|² over the unstable eigenvalues.
    assert!((upper - (1.0 - (1.25_f64 * 1.1).powi(-2))).abs() < 1e-6, "{upper}");
}

#[test]
fn critical_rate_of_a_scalar_measurement_is_the_product_of_the_unstable_eigenvalues() {
    let mut rng = Random::new(1);
    let mut worst: f64 = 0.0;
    for _ in 0..30 {
        let system = Dense::random(&mut rng, 3, 1, 1.3);
        let product: f64 = eigenvalue_magnitudes(&system.a).iter().map(|m| m.max(1.0)).product();
        let upper = system.lossy::<3>().critical_rate().upper.expect("a random row sees all");
        worst = worst.max((upper - (1.0 - 1.0 / (product * product))).abs());
    }
    println!("{worst:e}");
    // The accuracy that is promised. With one eigenvalue of 1.3 only the boundary is at 0.41, with three at 0.79.
    assert!(worst < 1e-6, "{worst:e}");
}

#[test]
fn bounds_on_the_critical_rate_coincide_for_invertible_c_and_for_one_unstable_mode() {
    let mut rng = Random::new(2);
    for _ in 0..20 {
        let mut system = Dense::random(&mut rng, 3, 3, 1.4);
        let full = system.lossy::<3>().critical_rate();
        assert!((full.upper.expect("seen") - full.lower).abs() < 1e-6, "{full:?}");
        // One real mode outside, in a random basis.
        let basis = rng.matrix(3, 3);
        let inverse = basis.clone().try_inverse().expect("random");
        system.a = &basis * DMatrix::from_diagonal(&DVector::from_column_slice(&[1.4, 0.9, -0.5])) * inverse;
        system.c = rng.matrix(1, 3);
        system.r = DMatrix::identity(1, 1);
        let one = system.lossy::<3>().critical_rate();
        assert!((one.lower - (1.0 - 1.0 / 1.96)).abs() < 1e-9, "{one:?}");
        assert!((one.upper.expect("seen") - one.lower).abs() < 1e-6, "{one:?}");
    }
}

#[test]
fn recursion_settles_above_the_critical_rate_and_grows_below_it() {
    let mut rng = Random::new(3);
    for _ in 0..12 {
        let system = Dense::random(&mut rng, 4, 2, 1.25);
        let lossy = system.lossy::<4>();
        let critical = lossy.critical_rate().upper.expect("seen");
        // 0.02 off the boundary a covariance changes by about 0.02·1.25² = 3 % per step or more: 3000 steps are 90 e-foldings. What
        // grows without bound is past 1e20 then; what settles has settled to rounding.
        for (arrival, settles) in [(critical + 0.02, true), (critical - 0.02, false)] {
            let mut x = DMatrix::zeros(4, 4);
            for _ in 0..3000 {
                x = system.step(&x, arrival);
                if x.trace() > 1e20 {
                    break;
                }
            }
            assert_eq!(x.trace() < 1e20, settles, "{arrival} of {critical}: {}", x.trace());
            let ours = lossy.upper_bound(arrival);
            assert_eq!(ours.is_some(), settles, "{arrival} of {critical}");
            if let Some(ours) = ours {
                // The printed form loses digits where X is large: 1e-16 of X against R, here up to 1e6.
                assert!(deviation(&ours, &x) < 1e-8, "{:e}", deviation(&ours, &x));
            }
        }
    }
}

#[test]
fn certain_arrival_gives_the_steady_state_of_the_kalman_filter() {
    let mut rng = Random::new(4);
    for _ in 0..20 {
        let system = Dense::random(&mut rng, 3, 2, 1.1);
        let mut x = DMatrix::identity(3, 3) * 100.0;
        for _ in 0..2000 {
            x = system.step(&x, 1.0);
        }
        let lossy = system.lossy::<3>();
        let ours = lossy.upper_bound(1.0).expect("seen");
        // The promised accuracy, from another start.
        assert!(deviation(&ours, &x) < 1e-9, "{:e}", deviation(&ours, &x));
        assert!(deviation(&lossy.filtered(&ours, 1.0), &system.filtered(&x, 1.0)) < 1e-9);
        assert_eq!(lossy.lower_bound(1.0).map(|s| deviation(&s, &system.w)), Some(0.0));
    }
}

#[test]
fn no_arrivals_give_the_open_loop_covariance_or_none() {
    let mut rng = Random::new(5);
    for _ in 0..10 {
        let system = Dense::random(&mut rng, 3, 2, 0.95);
        let mut x = DMatrix::zeros(3, 3);
        for _ in 0..2000 {
            x = &system.a * &x * system.a.transpose() + &system.w;
        }
        let lossy = system.lossy::<3>();
        for bound in [lossy.lower_bound(0.0), lossy.upper_bound(0.0)] {
            let bound = bound.expect("stable");
            assert!(deviation(&bound, &x) < 1e-9, "{:e}", deviation(&bound, &x));
            assert_eq!(lossy.filtered(&bound, 0.0), bound);
        }
        let unstable = Dense { a: &system.a * (1.05 / 0.95), ..system };
        assert_eq!(unstable.lossy::<3>().lower_bound(0.0), None);
        assert_eq!(unstable.lossy::<3>().upper_bound(0.0), None);
    }
    // A random walk without measurements grows by as much each step: no bound either, though its radius is 1.
    assert_eq!((scalar(1.0, 1.0, 1.0).lower_bound(0.0), scalar(1.0, 1.0, 1.0).upper_bound(0.0)), (None, None));
}

#[test]
fn step_with_correlated_and_surplus_rows_equals_the_printed_form() {
    let mut rng = Random::new(6);
    let mut worst: f64 = 0.0;
    for q in 1..=6 {
        for _ in 0..10 {
            let system = Dense::random(&mut rng, 3, q, 1.1);
            let x = rng.definite(3, 2.0);
            let ours = system.lossy::<3>().step(&Matrix::from_fn(|i, j| x[(i, j)]), 0.6);
            worst = worst.max(deviation(&ours, &system.step(&x, 0.6)));
        }
    }
    println!("{worst:e}");
    // Rounding of an inverse whose condition is below 1e3 in this family.
    assert!(worst < 1e-12, "{worst:e}");
}

#[test]
fn what_no_sensor_sees_has_no_critical_rate() {
    let row = [Vector::from([1.0, 0.0])];
    let unseen = |second: f64| {
        Lossy::new(&square([[0.5, 0.0], [0.0, second]]), &Matrix::identity(), &row, &[1.0]).expect("R is positive")
    };
    for (second, upper) in [(1.2, None), (1.0, None), (0.9, Some(0.0))] {
        assert_eq!(unseen(second).critical_rate().upper, upper, "{second}");
        assert_eq!(unseen(second).upper_bound(1.0).is_some(), upper.is_some(), "{second}");
    }
    // A velocity alone leaves the position open.
    let speed = Lossy::new(&square([[1.0, 0.1], [0.0, 1.0]]), &Matrix::identity(), &[Vector::from([0.0, 1.0])], &[1.0]);
    assert_eq!(speed.expect("R is positive").critical_rate().upper, None);
}

#[test]
fn covariance_that_is_not_positive_definite_or_of_another_size_makes_no_system() {
    let (a, c) = (Matrix::<2, 2>::identity(), [Vector::from([1.0, 0.0]), Vector::from([0.0, 1.0])]);
    assert_eq!(Lossy::new(&a, &a, &c, &[1.0, 1.0, 1.0, 1.0]), None);
    assert_eq!(Lossy::new(&a, &a, &c, &[1.0]), None);
    assert_eq!(Lossy::new(&(a * f64::NAN), &a, &c, &[1.0, 0.0, 0.0, 1.0]), None);
    assert_eq!(Lossy::new(&a, &a, &[Vector::from([1.0, 0.0]); 13], &[1.0; 169]), None);
}

fn radius_of_random<const N: usize>(rng: &mut Random) -> f64 {
    let a = rng.matrix(N, N);
    let truth = eigenvalue_magnitudes(&a)[0];
    (spectral_radius(&Matrix::<N, N>::from_fn(|i, j| a[(i, j)])) / truth - 1.0).abs()
}

#[test]
fn spectral_radius_equals_the_largest_eigenvalue() {
    let mut rng = Random::new(7);
    let mut worst: f64 = 0.0;
    for _ in 0..50 {
        worst = worst.max(radius_of_random::<1>(&mut rng));
        worst = worst.max(radius_of_random::<2>(&mut rng));
        worst = worst.max(radius_of_random::<5>(&mut rng));
        worst = worst.max(radius_of_random::<12>(&mut rng));
    }
    println!("{worst:e}");
    // Both methods are good to units in the last place of A, times the condition of an eigenvalue, below 1e3 in this family.
    assert!(worst < 1e-12, "{worst:e}");
    let turn = |angle: f64| square([[angle.cos(), -angle.sin()], [angle.sin(), angle.cos()]]);
    assert!((spectral_radius(&(turn(0.7) * 1.3)) - 1.3).abs() < 1e-12);
    assert_eq!(spectral_radius(&square([[0.0, 5.0, 1.0], [0.0, 0.0, 2.0], [0.0, 0.0, 0.0]])), 0.0);
    assert_eq!(spectral_radius(&Matrix::<4, 4>::zeros()), 0.0);
}

#[test]
fn spectral_radius_of_a_chain_of_integrators_is_1() {
    for dt in [1e-3, 0.1, 60.0] {
        // A Jordan block: its powers grow like m², and 2·log(2⁵⁰·dt)/2⁵⁰ is below 1e-13.
        let chain = square([[1.0, dt, dt * dt / 2.0], [0.0, 1.0, dt], [0.0, 0.0, 1.0]]);
        assert!((spectral_radius(&chain) - 1.0).abs() < 1e-12, "{:e}", spectral_radius(&chain) - 1.0);
    }
}

#[test]
fn mean_covariance_over_random_arrivals_lies_between_the_bounds() {
    let arrival = 0.8;
    let system = Dense {
        a: DMatrix::from_row_slice(2, 2, &[1.25, 0.0, 1.0, 1.1]),
        w: DMatrix::identity(2, 2) * 20.0,
        c: DMatrix::from_row_slice(1, 2, &[1.0, 1.0]),
        r: DMatrix::from_element(1, 1, 2.5),
    };
    let lossy = two_unstable();
    let (lower, upper) =
        (lossy.lower_bound(arrival).expect("stable"), lossy.upper_bound(arrival).expect("above 0.472"));
    let mut rng = Random::new(8);
    // Runs of losses at the end multiply the variance by 1.25⁴·0.2 = 0.49 < 1 per step in the mean square, so the mean has an error.
    let runs = 4000;
    let (mut sums, mut squares) = ([[0.0; 2]; 2], [[0.0; 2]; 2]);
    for _ in 0..runs {
        let mut predicted = DMatrix::zeros(2, 2);
        // The start is forgotten like 0.31^k.
        for _ in 0..60 {
            predicted = system.step(&predicted, f64::from(u8::from(rng.chance(arrival))));
        }
        let filtered = system.filtered(&predicted, f64::from(u8::from(rng.chance(arrival))));
        for (kind, p) in [predicted, filtered].iter().enumerate() {
            for i in 0..2 {
                sums[kind][i] += p[(i, i)];
                squares[kind][i] += p[(i, i)] * p[(i, i)];
            }
        }
    }
    let bounds = [(lower, upper), (lower * (1.0 - arrival), lossy.filtered(&upper, arrival))];
    for (kind, (lower, upper)) in bounds.iter().enumerate() {
        for i in 0..2 {
            let mean = sums[kind][i] / f64::from(runs);
            let error = ((squares[kind][i] / f64::from(runs) - mean * mean) / f64::from(runs)).sqrt();
            println!("{:.2} < {mean:.2} ± {error:.2} < {:.2}", lower[(i, i)], upper[(i, i)]);
            // Four standard errors to either side: one in 10⁴ runs of this test at the worst, were it not seeded.
            assert!(mean - 4.0 * error < upper[(i, i)], "{mean} ± {error} {upper}");
            assert!(mean + 4.0 * error > lower[(i, i)], "{mean} ± {error} {lower}");
        }
    }
}

/// The covariance of the state at instant 0, predicted with covariance `x`, given the measurements of instants 0 to `lag`: conditioning of one
/// joint Gaussian.
fn conditioned(system: &Dense, x: &DMatrix<f64>, lag: usize) -> DMatrix<f64> {
    let (n, q) = (system.a.nrows(), system.c.nrows());
    let instant = Instant {
        a: system.a.clone(),
        b: DMatrix::zeros(n, 0),
        g: DMatrix::identity(n, n),
        q: system.w.clone(),
        c: system.c.clone(),
        r: system.r.clone(),
        z: vec![Some(0.0); q],
        u: Vec::new(),
    };
    let run = Run { instants: vec![instant; lag + 1], prior: Some((DVector::zeros(n), x.clone())) };
    match run.posterior(run.start(), 0..lag + 1, 0) {
        Verdict::Determined(posterior) => posterior.cov,
        other => panic!("{other:?}"),
    }
}

#[test]
fn lagged_covariance_is_that_of_the_joint_gaussian() {
    let mut rng = Random::new(21);
    for trial in 0..12 {
        let system = Dense::random(&mut rng, 3, 1 + trial % 3, 0.7 + 0.05 * trial as f64);
        let lossy: Lossy<3> = system.lossy();
        let steady = lossy.upper_bound(1.0).expect("all of it is measured");
        let x = DMatrix::from_fn(3, 3, |i, j| steady[(i, j)]);
        for lag in [0, 1, 2, 5] {
            let ours = lossy.lagged(&steady, Some(lag as u32)).expect("a sum with an end");
            // The steady state is known to 1e-9 of itself.
            assert!(deviation(&ours, &conditioned(&system, &x, lag)) < 1e-8, "{trial}, lag {lag}");
        }
        let filtered = lossy.filtered(&steady, 1.0);
        assert!((lossy.lagged(&steady, Some(0)).unwrap() - filtered).amax() < 1e-12 * filtered.amax());
        let all = lossy.lagged(&steady, None).expect("settles");
        assert!(all.trace() < lossy.lagged(&steady, Some(1)).unwrap().trace());
        // What an instant adds shrinks like ρ(A)² at least: after 60 instants less than 1e-10 is left where ρ ≤ 0.8.
        if trial < 3 {
            assert!(deviation(&all, &conditioned(&system, &x, 60)) < 1e-8, "{trial}");
        }
    }
}
