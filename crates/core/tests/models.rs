//! Motion models against oracles that share no formula with them.

use fixtrail_core::models::{CoordinatedTurn, DesignError, Drift, FmsPaper, GaussMarkov, Integrators, Linear};
use fixtrail_core::{Matrix, Transition, Vector};

/// Matrix exponential by halving, a Taylor series and squaring.
fn exponential<const N: usize>(a: &Matrix<N, N>) -> Matrix<N, N> {
    let halvings = 12;
    let small = a / 2f64.powi(halvings);
    let mut term = Matrix::<N, N>::identity();
    let mut sum = term;
    for k in 1..20 {
        term = term * small / k as f64;
        sum += term;
    }
    for _ in 0..halvings {
        sum = sum * sum;
    }
    sum
}

/// Van Loan's discretisation of `ẋ = F x + white noise of density W`: the exponential of `[[−F, W], [0, Fᵀ]] dt`.
fn van_loan<const N: usize, const N2: usize>(
    f: &Matrix<N, N>,
    w: &Matrix<N, N>,
    dt: f64,
) -> (Matrix<N, N>, Matrix<N, N>) {
    let mut block = Matrix::<N2, N2>::zeros();
    block.fixed_view_mut::<N, N>(0, 0).copy_from(&(-f * dt));
    block.fixed_view_mut::<N, N>(0, N).copy_from(&(w * dt));
    block.fixed_view_mut::<N, N>(N, N).copy_from(&(f.transpose() * dt));
    let e = exponential(&block);
    let phi = e.fixed_view::<N, N>(N, N).transpose();
    (phi, phi * e.fixed_view::<N, N>(0, N))
}

/// The continuous chain of integrators: F and the noise density matrix.
fn chain<const N: usize>(order: usize, axes: usize, psd: [f64; 3]) -> (Matrix<N, N>, Matrix<N, N>) {
    let f = Matrix::<N, N>::from_fn(|i, j| if j == i + axes { 1.0 } else { 0.0 });
    let last = (order - 1) * axes;
    let w = Matrix::<N, N>::from_fn(|i, j| if i == j && i >= last { psd[i - last] } else { 0.0 });
    (f, w)
}

/// Largest difference, each entry relative to its size or, below 1, absolute.
fn deviation<const R: usize, const C: usize>(a: &Matrix<R, C>, b: &Matrix<R, C>) -> f64 {
    a.zip_map(b, |a, b| (a - b).abs() / b.abs().max(1.0)).max()
}

/// Entries without pattern, so that no component is special.
fn scattered<const N: usize>() -> Vector<N> {
    Vector::from_fn(|i, _| 3.0 * (1.7 * i as f64 + 0.4).sin())
}

fn check_chain<const N: usize, const N2: usize>(order: usize, axes: usize) {
    let psd = [0.7, 2.5, 0.03];
    let model = Integrators::<N>::new(order, axes, psd).unwrap();
    let x = scattered::<N>();
    let (f, w) = chain::<N>(order, axes, psd);
    for dt in [1e-3, 0.1, 1.0, 3.7] {
        let leap = model.leap(&x, dt);
        let (phi, q) = van_loan::<N, N2>(&f, &w, dt);
        // The oracle squares 12 times and then multiplies by up to dt⁵: some hundred roundings of 1.1e-16.
        assert!(deviation(&leap.f, &phi) < 1e-12, "f of order {order} on {axes} axes over {dt} s");
        assert!(deviation(&leap.q, &q) < 1e-12, "q of order {order} on {axes} axes over {dt} s");
        assert!(deviation(&leap.next, &(phi * x)) < 1e-12, "next of order {order} on {axes} axes over {dt} s");
    }
}

#[test]
fn integrators_of_every_shape_equal_van_loan() {
    check_chain::<1, 2>(1, 1);
    check_chain::<2, 4>(1, 2);
    check_chain::<3, 6>(1, 3);
    check_chain::<2, 4>(2, 1);
    check_chain::<4, 8>(2, 2);
    check_chain::<6, 12>(2, 3);
    check_chain::<3, 6>(3, 1);
    check_chain::<6, 12>(3, 2);
    check_chain::<9, 18>(3, 3);
}

fn check_semigroup<const N: usize>(order: usize, axes: usize) {
    let model = Integrators::<N>::new(order, axes, [0.7, 2.5, 0.03]).unwrap();
    let x = scattered::<N>();
    for (a, b) in [(0.3, 1.1), (2.0, 0.04), (0.0, 0.5), (0.5, 0.0)] {
        let first = model.leap(&x, a);
        let second = model.leap(&first.next, b);
        let both = model.leap(&x, a + b);
        // A handful of roundings.
        assert!(deviation(&(second.f * first.f), &both.f) < 1e-14);
        assert!(deviation(&second.next, &both.next) < 1e-14);
        assert!(deviation(&(second.f * first.q * second.f.transpose() + second.q), &both.q) < 1e-14);
    }
}

#[test]
fn integrators_over_two_intervals_equal_one_over_their_sum() {
    check_semigroup::<2>(1, 2);
    check_semigroup::<4>(2, 2);
    check_semigroup::<6>(2, 3);
    check_semigroup::<9>(3, 3);
}

#[test]
fn integrators_over_no_time_are_the_identity_without_noise() {
    let x = scattered::<9>();
    let leap = Integrators::<9>::new(3, 3, [1.0; 3]).unwrap().leap(&x, 0.0);
    assert_eq!(leap, Transition { next: x, f: Matrix::identity(), q: Matrix::zeros() });
}

#[test]
fn integrators_of_impossible_shape_are_rejected() {
    assert_eq!(Integrators::<4>::new(4, 1, [1.0; 3]), Err(DesignError::Order { order: 4 }));
    assert_eq!(Integrators::<4>::new(0, 2, [1.0; 3]), Err(DesignError::Order { order: 0 }));
    assert_eq!(Integrators::<8>::new(2, 4, [1.0; 3]), Err(DesignError::Axes { axes: 4 }));
    assert_eq!(Integrators::<4>::new(2, 3, [1.0; 3]), Err(DesignError::StateSize { found: 4, expected: 6 }));
    assert_eq!(Integrators::<2>::new(1, 2, [1.0, -2.0, 1.0]), Err(DesignError::NoiseDensity { index: 1, psd: -2.0 }));
    assert!(Integrators::<2>::new(1, 2, [1.0, f64::NAN, 1.0]).is_err());
    // The third axis is not modelled.
    assert!(Integrators::<2>::new(1, 2, [1.0, 0.0, f64::NAN]).is_ok());
    assert_eq!(
        DesignError::StateSize { found: 4, expected: 6 }.to_string(),
        "the state has 4 components, expected at least 6",
    );
}

fn turn() -> CoordinatedTurn {
    CoordinatedTurn::new([0.8, 1.9], 0.05).unwrap()
}

/// The turn's differential equation, integrated by the classical Runge–Kutta method in `steps` steps.
fn runge_kutta_turn(x: &Vector<5>, dt: f64, steps: usize) -> Vector<5> {
    let rate = |x: &Vector<5>| Vector::<5>::from([x[2], x[3], -x[4] * x[3], x[4] * x[2], 0.0]);
    let h = dt / steps as f64;
    let mut x = *x;
    for _ in 0..steps {
        let k1 = rate(&x);
        let k2 = rate(&(x + k1 * (h / 2.0)));
        let k3 = rate(&(x + k2 * (h / 2.0)));
        let k4 = rate(&(x + k3 * h));
        x += (k1 + 2.0 * k2 + 2.0 * k3 + k4) * (h / 6.0);
    }
    x
}

/// Turn rates on both sides of the switch of formulas (θ = 0.5 at 0.8 s) and far beyond.
const TURN_RATES: [f64; 9] = [0.0, 1e-300, 1e-9, -1e-4, 0.3, -0.62, 0.63, -2.0, 9.0];

#[test]
fn turn_equals_the_integrated_differential_equation() {
    for omega in TURN_RATES {
        let x = Vector::from([30.0, 70.0, 20.0, -13.0, omega]);
        let error = deviation(&turn().leap(&x, 0.8).next, &runge_kutta_turn(&x, 0.8, 8000));
        // The phase is off by θ (θ/8000)⁴/120 < 4e-14 rad, at 24 m/s below 1e-12; 8000 roundings of 1e-16 are 8e-13.
        assert!(error < 2e-12, "{error:e} at {omega} rad/s");
    }
}

#[test]
fn turn_jacobian_equals_differences_of_the_value() {
    for omega in TURN_RATES {
        let x = Vector::from([30.0, 70.0, 20.0, -13.0, omega]);
        let f = turn().leap(&x, 0.8).f;
        for j in 0..5 {
            let value = |step: f64| {
                let mut x = x;
                x[j] += step;
                turn().leap(&x, 0.8).next
            };
            // Sixth-order central difference.
            let h = 0.01;
            let column = (45.0 * (value(h) - value(-h)) - 9.0 * (value(2.0 * h) - value(-2.0 * h)) + value(3.0 * h)
                - value(-3.0 * h))
                / (60.0 * h);
            // Truncation 36/7! h⁶ · dt⁷ · speed · dt ≈ 3e-14; rounding 70 · 1e-16/h ≈ 1e-12.
            let error = deviation(&f.column(j).into_owned(), &column);
            assert!(error < 1e-11, "{error:e} in column {j} at {omega} rad/s");
        }
    }
}

#[test]
fn turn_is_continuous_where_series_and_closed_form_meet() {
    for sign in [1.0, -1.0] {
        // θ = ω · 1 s, so the two states differ by one rounding of 0.5.
        let below = Vector::from([1.0, 2.0, 0.9, -0.7, sign * 0.5f64.next_down()]);
        let above = Vector::from([1.0, 2.0, 0.9, -0.7, sign * 0.5]);
        let (below, above) = (turn().leap(&below, 1.0), turn().leap(&above, 1.0));
        // The closed form of s′ loses one digit here; nothing else may show.
        assert!(deviation(&below.f, &above.f) < 1e-14);
        assert!(deviation(&below.next, &above.next) < 1e-15);
    }
}

#[test]
fn turn_without_turning_is_constant_velocity() {
    let x = Vector::from([30.0, 70.0, 20.0, -13.0, 0.0]);
    let leap = turn().leap(&x, 0.8);
    let straight =
        Integrators::<4>::new(2, 2, [0.8, 1.9, 0.0]).unwrap().leap(&Vector::from([30.0, 70.0, 20.0, -13.0]), 0.8);
    assert_eq!(leap.next.fixed_rows::<4>(0), straight.next);
    assert_eq!(leap.f.fixed_view::<4, 4>(0, 0), straight.f);
    assert_eq!(leap.q.fixed_view::<4, 4>(0, 0), straight.q);
    assert_eq!(leap.q.column(4).into_owned(), Vector::from([0.0, 0.0, 0.0, 0.0, 0.05 * 0.8]));
    // ∂(x, y)/∂ω = dt²/2 (−vy, vx) when ω = 0.
    assert!((leap.f[(0, 4)] - 0.32 * 13.0).abs() < 1e-14);
    assert!((leap.f[(1, 4)] - 0.32 * 20.0).abs() < 1e-14);
}

#[test]
fn turn_over_two_intervals_moves_as_one_over_their_sum() {
    let x = Vector::from([30.0, 70.0, 20.0, -13.0, 0.9]);
    let first = turn().leap(&x, 0.3);
    let second = turn().leap(&first.next, 1.4);
    let both = turn().leap(&x, 1.7);
    // A handful of roundings.
    assert!(deviation(&second.next, &both.next) < 1e-14);
    assert!(deviation(&(second.f * first.f), &both.f) < 1e-13);
}

#[test]
fn turn_at_the_papers_point_has_the_derived_derivative() {
    // The printed ∂x/∂ω gives −44.09 here.
    let leap = turn().leap(&Vector::from([30.0, 70.0, 20.0, 20.0, -1.0]), 0.1);
    // Given to four digits.
    assert!((leap.f[(0, 4)] + 0.0931).abs() < 5e-5);
}

/// State, interval, value and column of ω, computed to sixty digits (from the conformance vectors of the turn).
struct TurnCase {
    x: [f64; 5],
    dt_s: f64,
    next: [f64; 4],
    omega: [f64; 4],
}

#[rustfmt::skip]
const TURN_CASES: [TurnCase; 6] = [
    TurnCase {
        x: [99.8764172597607, 47.85536673819816, -15.929387899810564, -3.903146866491479, 1e-12], dt_s: 0.1,
        next: [98.28347846977967, 47.46505205154893, -15.929387899810173, -3.903146866493072],
        omega: [0.019515734332462707, -0.07964693949905152, 0.39031468664930724, -1.5929387899810175],
    },
    TurnCase {
        x: [84.31723591211889, 80.82932020365024, -28.888966939787355, 12.449734040230638, 0.02], dt_s: 1.0,
        next: [55.3057016743963, 92.9893442383404, -29.13216742048116, 11.869503355476185],
        omega: [-6.031659137928756, -14.52603396069844, -11.869503355476185, -29.13216742048116],
    },
    TurnCase {
        x: [70.93229965405654, -2.532186889326475, -21.05768498798665, 11.910719419098648, 0.99999], dt_s: 0.5,
        next: [59.378633343738244, 0.6003178740963345, -24.190158426361826, 0.35716864544345844],
        omega: [-0.5414183170457917, -2.953949980200882, -0.17858432272172922, -12.095079213180913],
    },
    TurnCase {
        x: [69.8409236444701, -14.672531404074284, -10.812920740902822, 17.992771563297204, -1.0], dt_s: 0.5,
        next: [66.85956229364879, -4.722647150774359, -0.8630364876028959, 20.9741329141185],
        omega: [-2.549843107019848, -0.5371822037593239, -10.48706645705925, -0.43151824380144793],
    },
    TurnCase {
        x: [-37.126131336975504, 76.7390202210415, -7.9271556653089945, 27.061378871747962, -6.0], dt_s: 1.0,
        next: [-36.57732848483712, 75.53141483411281, -15.172787986881154, 23.76856175891765],
        omega: [2.6202651398365897, -4.162694524307724, -23.76856175891765, -15.172787986881154],
    },
    TurnCase {
        x: [9.91378923682096, 90.46630927630045, 3.3695865320338214, -15.591880301833449, 12.0], dt_s: 0.1,
        next: [11.004008230070651, 89.43433834777878, 15.753237674293866, -2.509252382837168],
        omega: [0.04042539784830806, 0.0650871408531628, 0.2509252382837168, 1.5753237674293867],
    },
];

#[test]
fn turn_equals_values_computed_to_sixty_digits() {
    for TurnCase { x, dt_s, next, omega } in TURN_CASES {
        let leap = turn().leap(&Vector::from(x), dt_s);
        for i in 0..4 {
            // The vectors' own tolerance.
            let close = |a: f64, b: f64| (a - b).abs() <= 1e-13 + 1e-13 * b.abs();
            assert!(close(leap.next[i], next[i]), "component {i} of {x:?} over {dt_s} s");
            assert!(close(leap.f[(i, 4)], omega[i]), "∂/∂ω of component {i} of {x:?} over {dt_s} s");
        }
    }
}

#[test]
fn turn_of_impossible_noise_is_rejected() {
    assert_eq!(CoordinatedTurn::new([1.0, 1.0], -0.5), Err(DesignError::NoiseDensity { index: 2, psd: -0.5 }));
    assert!(CoordinatedTurn::new([f64::INFINITY, 1.0], 0.5).is_err());
}

#[test]
fn linear_step_is_a_x_plus_the_drive() {
    let model =
        Linear::<2> { a: Matrix::<2, 2>::new(1.0, 2.0, -0.5, 0.25), q: Matrix::<2, 2>::new(3.0, 1.0, 1.0, 2.0) };
    let leap = model.leap(&Vector::from([4.0, -8.0]), &Vector::from([100.0, 200.0]));
    assert_eq!(leap, Transition { next: Vector::from([88.0, 196.0]), f: model.a, q: model.q });
}

#[test]
fn fms_paper_at_two_seconds_is_the_stated_model() {
    let paper = FmsPaper::new(2.0);
    // GQGᵀ by hand at T = 2: G's first two rows are equal.
    let (w, a) = (0.029929, 0.0001);
    assert_eq!(paper.a, Matrix::<3, 3>::new(1.0, 2.0, 2.0, 0.0, 1.0, 2.0, 0.0, 0.0, 1.0));
    assert_eq!(paper.g, Matrix::<3, 2>::new(1.0, 0.0, 1.0, 0.0, 0.0, 1.0));
    assert_eq!(FmsPaper::new(0.5).g[(0, 0)], 0.25);
    assert_eq!(FmsPaper::new(0.5).a[(0, 2)], 0.125);
    assert_eq!(paper.c, Vector::from([1.0, 0.0, 0.0]));
    // One rounding of the squares.
    assert!((paper.r - 0.0025).abs() < 1e-18);
    assert!(deviation(&paper.motion().q, &Matrix::<3, 3>::new(w, w, 0.0, w, w, 0.0, 0.0, 0.0, a)) < 1e-17);
}

/// The generator and noise density of `p̈ = −2λ ṗ − λ² p + w` on two axes with the stationary variances σ² and λ²σ².
fn resident(spread: [f64; 2], speed: [f64; 2]) -> (Matrix<4, 4>, Matrix<4, 4>) {
    let (mut f, mut w) = (Matrix::<4, 4>::zeros(), Matrix::<4, 4>::zeros());
    for i in 0..2 {
        let lambda = speed[i] / spread[i];
        f[(i, 2 + i)] = 1.0;
        f[(2 + i, i)] = -lambda * lambda;
        f[(2 + i, 2 + i)] = -2.0 * lambda;
        // The Lyapunov equation F P + P Fᵀ + W = 0 of P = diag(σ², λ²σ²).
        w[(2 + i, 2 + i)] = 4.0 * lambda * speed[i] * speed[i];
    }
    (f, w)
}

#[test]
fn gauss_markov_motion_is_the_exact_discretisation() {
    let (centre, spread, speed) = ([3.0, -7.0, 0.0], [5.0, 2.0, 0.0], [0.4, 1.5, 0.0]);
    let model = GaussMarkov::<4>::new(2, centre, spread, speed).unwrap();
    let (f, w) = resident([5.0, 2.0], [0.4, 1.5]);
    let x = scattered::<4>();
    let at = Vector::from([3.0, -7.0, 0.0, 0.0]);
    for dt in [1e-3, 0.1, 0.4, 1.0, 3.7, 20.0] {
        let leap = model.leap(&x, dt);
        let (phi, q) = van_loan::<4, 8>(&f, &w, dt);
        // The oracle squares a 24-digit exponential twelve times; its block holds exp(+λdt) of up to 6e6, which costs its q some digits.
        let tolerance = if dt > 10.0 { 1e-6 } else { 1e-10 };
        assert!(deviation(&leap.f, &phi) < tolerance, "{dt}: {}", deviation(&leap.f, &phi));
        assert!(deviation(&leap.q, &q) < tolerance, "{dt}: {}", deviation(&leap.q, &q));
        assert!((leap.next - (at + phi * (x - at))).amax() < tolerance, "{dt}");
        // What is stationary stays so.
        let p = Matrix::<4, 4>::from_diagonal(&Vector::from([25.0, 4.0, 0.16, 2.25]));
        assert!((leap.f * p * leap.f.transpose() + leap.q - p).amax() < 1e-13, "{dt}");
    }
    assert_eq!(model.stationary(1), Some((-7.0, 2.0)));
    assert_eq!(model.stationary(3), Some((0.0, 1.5)));
    assert_eq!(model.stationary(4), None);
}

#[test]
fn gauss_markov_noise_of_short_intervals_keeps_its_digits() {
    // Over a millisecond of a law that lasts 1000 s the noise is 1e-18 of the variance: that of constant velocity, 4λ³σ² (dt³/3 …), to
    // first order in λ dt = 1e-6.
    let model = GaussMarkov::<2>::new(1, [0.0; 3], [10.0; 3], [0.01; 3]).unwrap();
    let psd = 4.0 * 1e-9 * 100.0;
    let (dt, q) = (1e-3, model.leap(&Vector::zeros(), 1e-3).q);
    for (found, expected) in
        [(q[(0, 0)], psd * dt * dt * dt / 3.0), (q[(0, 1)], psd * dt * dt / 2.0), (q[(1, 1)], psd * dt)]
    {
        assert!((found / expected - 1.0).abs() < 1e-5, "{found:e} {expected:e}");
    }
}

#[test]
fn gauss_markov_motion_refuses_what_is_not_stationary() {
    let new = |centre: f64, spread: f64, speed: f64| GaussMarkov::<4>::new(2, [centre; 3], [spread; 3], [speed; 3]);
    assert!(new(0.0, 1.0, 1.0).is_ok());
    assert_eq!(new(f64::NAN, 1.0, 1.0), Err(DesignError::Stationary { axis: 0 }));
    assert_eq!(new(0.0, 0.0, 1.0), Err(DesignError::Stationary { axis: 0 }));
    assert_eq!(new(0.0, 1.0, 0.0), Err(DesignError::Stationary { axis: 0 }));
    assert!(matches!(new(0.0, f64::INFINITY, 1.0), Err(DesignError::NoiseDensity { .. })));
    let small = GaussMarkov::<3>::new(2, [0.0; 3], [1.0; 3], [1.0; 3]);
    assert_eq!(small, Err(DesignError::StateSize { found: 3, expected: 4 }));
}

#[test]
fn further_components_stay_and_drift_when_told_to() {
    let walk = Integrators::<5>::new(2, 1, [2.0, 0.0, 0.0]).unwrap();
    let x = scattered::<5>();
    let mut leap = walk.leap(&x, 0.3);
    let alone = Integrators::<2>::new(2, 1, [2.0, 0.0, 0.0]).unwrap().leap(&Vector::from([x[0], x[1]]), 0.3);
    assert_eq!(leap.f.fixed_view::<2, 2>(0, 0), alone.f);
    assert_eq!(leap.q.fixed_view::<2, 2>(0, 0), alone.q);
    assert_eq!(leap.next.rows(2, 3), x.rows(2, 3));
    assert_eq!(leap.q.view((2, 2), (3, 3)).amax(), 0.0);
    Drift { first: 3, count: 2, sd: 0.5, time_s: 7.0 }.apply(&x, 0.3, &mut leap);
    let kept = (-0.3f64 / 7.0).exp();
    for i in [3, 4] {
        assert!((leap.next[i] - kept * x[i]).abs() < 1e-15 && (leap.f[(i, i)] - kept).abs() < 1e-15);
        // The stationary variance stays.
        assert!((kept * kept * 0.25 + leap.q[(i, i)] - 0.25).abs() < 1e-15);
    }
    assert_eq!((leap.next[2], leap.f[(2, 2)], leap.q[(2, 2)]), (x[2], 1.0, 0.0));
}
