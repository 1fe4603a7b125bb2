//! Sensors against differences of the value they linearise.

use core::f64::consts::{FRAC_PI_2, PI, TAU};
use fixtrail_core::linalg::{Common, whiten};
use fixtrail_core::sensors::{Pair, PathLoss, bearing, linear, position, range, rssi, tdoa};
use fixtrail_core::{Row, Vector};

const ANCHOR_M: [f64; 3] = [-4.0, 7.0, 2.5];

/// Worst difference between `h` and a sixth-order central difference of `−residual`, whose slope it is.
fn gradient_error<const N: usize>(x: &Vector<N>, sense: impl Fn(&Vector<N>) -> Row<N>) -> f64 {
    let row = sense(x);
    let mut worst = 0.0f64;
    for j in 0..N {
        let value = |step: f64| {
            let mut x = *x;
            x[j] += step;
            -sense(&x).residual
        };
        let h = 0.01;
        let slope = (45.0 * (value(h) - value(-h)) - 9.0 * (value(2.0 * h) - value(-2.0 * h)) + value(3.0 * h)
            - value(-3.0 * h))
            / (60.0 * h);
        worst = worst.max((slope - row.h[j]).abs());
    }
    worst
}

#[test]
fn range_gradient_equals_differences() {
    let x = Vector::from([1.0, 2.0, 3.0, 0.4, 0.5, 0.6]);
    for (axes, height_m) in [(1, None), (1, Some(1.2)), (2, None), (2, Some(1.2)), (3, None)] {
        let error = gradient_error(&x, |x| range(x, axes, ANCHOR_M, height_m, 6.0, 0.04));
        // Truncation of order h⁶/d⁶ ≈ 1e-15, rounding 10 · 1e-16/h ≈ 1e-13.
        assert!(error < 1e-12, "{error:e} with {axes} axes and height {height_m:?}");
    }
}

#[test]
fn range_takes_the_third_coordinate_as_stated() {
    let x = Vector::from([-1.0, 3.0, 100.0, 100.0]);
    // 3-4-5 in the plane.
    assert_eq!(range(&x, 2, ANCHOR_M, None, 5.5, 0.04).residual, 0.5);
    // Height 14.5: 12 below the target, 5-12-13.
    let row = range(&x, 2, ANCHOR_M, Some(14.5), 13.25, 0.04);
    assert_eq!((row.residual, row.var), (0.25, 0.04));
    assert_eq!(row.h, Vector::from([3.0 / 13.0, -4.0 / 13.0, 0.0, 0.0]));
    // In space the height is a state: 1 below is one more leg, and a stated height changes nothing.
    let x = Vector::from([-1.0, 3.0, 14.5]);
    assert_eq!(range(&x, 3, ANCHOR_M, None, 13.0, 0.04).residual, 0.0);
    assert_eq!(range(&x, 3, ANCHOR_M, Some(-50.0), 13.0, 0.04), range(&x, 3, ANCHOR_M, None, 13.0, 0.04));
}

#[test]
fn range_at_the_anchor_has_no_direction() {
    let row = range(&Vector::from([-4.0, 7.0, 1.0, 1.0]), 2, ANCHOR_M, None, 0.3, 0.04);
    assert_eq!(row, Row { h: Vector::zeros(), residual: 0.3, var: 0.04 });
    // A nanometre away it is still none, two away there is one.
    assert_eq!(range(&Vector::from([0.5e-9, 0.0]), 2, [0.0; 3], None, 0.3, 0.04).h, Vector::<2>::zeros());
    assert_eq!(range(&Vector::from([2e-9, 0.0]), 2, [0.0; 3], None, 0.3, 0.04).h, Vector::from([1.0, 0.0]));
    // Right under an anchor at a known height the distance is real and its plane gradient zero.
    let under = range(&Vector::from([-4.0, 7.0]), 2, ANCHOR_M, Some(1.0), 1.5, 0.04);
    assert_eq!((under.h, under.residual), (Vector::<2>::zeros(), 0.0));
}

#[test]
fn position_is_the_named_component() {
    let row = position(&Vector::from([10.0, 20.0, 30.0]), 1, 20.5, 0.04);
    assert_eq!(row, Row { h: Vector::from([0.0, 1.0, 0.0]), residual: 0.5, var: 0.04 });
}

#[test]
fn linear_is_the_inner_product() {
    let c = Vector::from([2.0, -1.0, 0.5]);
    let row = linear(&c, &Vector::from([10.0, 20.0, 30.0]), 18.0, 0.25);
    assert_eq!(row, Row { h: c, residual: 3.0, var: 0.25 });
}

/// The layouts of axes and known height that a sensor of distances has.
const LAYOUTS: [(usize, Option<f64>); 5] = [(1, None), (1, Some(1.2)), (2, None), (2, Some(1.2)), (3, None)];
const LAW: PathLoss = PathLoss { exponent: 2.7, at_1m_dbm: -41.0 };

#[test]
fn rssi_gradient_equals_differences() {
    let x = Vector::from([1.0, 2.0, 3.0, 0.4, 0.5, 0.6]);
    for (axes, height_m) in LAYOUTS {
        let error = gradient_error(&x, |x| rssi(x, axes, ANCHOR_M, height_m, LAW, -60.0, 4.0));
        // Truncation 13 (h/d)⁶ ≈ 1e-14, rounding of values near 60: 10 · 1e-14/h ≈ 1e-11; the gradient is 1 to 3 dB/m.
        assert!(error < 1e-10, "{error:e} with {axes} axes and height {height_m:?}");
    }
}

#[test]
fn rssi_falls_by_ten_exponents_per_decade() {
    let at = |d: f64| -rssi(&Vector::from([d, 0.0]), 2, [0.0; 3], None, LAW, 0.0, 4.0).residual;
    // Ten digits of numbers below 100 are far above rounding.
    for (d, expected) in [(1.0, -41.0), (10.0, -68.0), (100.0, -95.0), (0.1, -14.0)] {
        assert!((at(d) - expected).abs() < 1e-10, "{} at {d} m", at(d));
    }
    // 3-4-5 with a known height: slope −27/ln 10 · 1/5 along the distance, 3/5 of it in the plane.
    let row = rssi(&Vector::from([3.0, 0.0]), 2, [0.0, 0.0, 6.0], Some(2.0), LAW, -60.0, 4.0);
    assert!((row.h[0] + 27.0 / std::f64::consts::LN_10 * 3.0 / 25.0).abs() < 1e-14, "{}", row.h[0]);
    assert_eq!((row.h[1], row.var), (0.0, 4.0));
}

#[test]
fn rssi_within_a_tenth_of_a_metre_is_flat() {
    let at = |d: f64| rssi(&Vector::from([d, 0.0]), 2, [0.0; 3], None, LAW, -20.0, 4.0);
    let edge = at(0.1);
    assert!(edge.h[0] < -100.0);
    for d in [0.0, 1e-12, 0.05, 0.0999] {
        assert_eq!(at(d), Row { h: Vector::zeros(), residual: edge.residual, var: 4.0 }, "{d} m");
    }
}

#[test]
fn tdoa_is_the_difference_of_two_ranges() {
    let pair = Pair { anchor_m: ANCHOR_M, reference_m: [3.0, -1.0, 0.5] };
    let x = Vector::from([1.0, 2.0, 3.0, 0.4]);
    for (axes, height_m) in LAYOUTS {
        let row = tdoa(&x, axes, pair, height_m, 1.5, 0.08);
        let (a, b) =
            (range(&x, axes, pair.anchor_m, height_m, 0.0, 1.0), range(&x, axes, pair.reference_m, height_m, 0.0, 1.0));
        assert_eq!((row.h, row.var), (a.h - b.h, 0.08));
        // Distances below 10: a few units in the last place.
        assert!((row.residual - (1.5 + a.residual - b.residual)).abs() < 1e-14);
        // As for ranges.
        let error = gradient_error(&x, |x| tdoa(x, axes, pair, height_m, 1.5, 0.08));
        assert!(error < 1e-12, "{error:e} with {axes} axes and height {height_m:?}");
    }
}

#[test]
fn bearing_gradient_equals_differences() {
    let x = Vector::from([1.0, 2.0, 3.0, 0.4]);
    let error = gradient_error(&x, |x| bearing(x, ANCHOR_M, 0.3, 0.01));
    // Truncation (h/d)⁶/d ≈ 1e-17, rounding 10 · 1e-16/h ≈ 1e-13.
    assert!(error < 1e-12, "{error:e}");
}

#[test]
fn bearing_is_counter_clockwise_from_x() {
    let expected = |x: f64, y: f64| -bearing(&Vector::from([x, y, 55.0]), [1.0, 1.0, -9.0], 0.0, 0.01).residual;
    assert_eq!(expected(3.0, 1.0), 0.0);
    assert_eq!(expected(1.0, 4.0), FRAC_PI_2);
    assert_eq!(expected(1.0, 0.5), -FRAC_PI_2);
}

#[test]
fn bearing_residual_is_the_shorter_turn() {
    // Expected just below π, measured just above −π: 0.2 rad on, not 2π − 0.2 back.
    let x = Vector::from([-(0.1f64.cos()), 0.1f64.sin()]);
    let row = bearing(&x, [0.0; 3], -PI + 0.1, 0.01);
    // Angles of a few radians: a few units in the last place.
    assert!((row.residual - 0.2).abs() < 1e-14, "{}", row.residual);
    // Whole turns say nothing.
    for turns in [-3.0, -1.0, 1.0, 2.0] {
        let turned = bearing(&x, [0.0; 3], -PI + 0.1 + turns * TAU, 0.01);
        assert!((turned.residual - 0.2).abs() < 1e-14, "{turns} turns: {}", turned.residual);
    }
    // Straight behind is π, never −π.
    let east = Vector::from([1.0, 0.0]);
    assert_eq!(bearing(&east, [0.0; 3], PI, 0.01).residual, PI);
    assert_eq!(bearing(&east, [0.0; 3], -PI, 0.01).residual, PI);
}

#[test]
fn bearing_at_the_anchor_has_no_direction() {
    let row = bearing(&Vector::from([ANCHOR_M[0], ANCHOR_M[1], 0.0]), ANCHOR_M, 0.3, 0.01);
    assert_eq!(row.h, Vector::<3>::zeros());
}

#[test]
fn rows_with_a_common_noise_come_apart_as_by_whitening() {
    let own: Vec<Row<3>> = (0..5)
        .map(|i| {
            let i = f64::from(i);
            Row {
                h: Vector::from([1.0 + i, (3.0 * i).sin(), 0.5 - i * i]),
                residual: (7.0 * i).cos(),
                var: 0.2 + 0.1 * i,
            }
        })
        .collect();
    let common = 0.3;
    let mut by_matrix = own.clone();
    let mut r: Vec<f64> = (0..25).map(|e| common + if e / 5 == e % 5 { own[e / 5].var } else { 0.0 }).collect();
    assert!(whiten(&mut by_matrix, &mut r));
    let mut shared = Common::new(common);
    for (own, expected) in own.iter().zip(&by_matrix) {
        let row = shared.next(own);
        let w = 1.0 / row.var.sqrt();
        // Five rows of numbers below 20 over sds above 0.4: rounding near 1e-14.
        assert!((row.h * w - expected.h).amax() < 1e-12 && (row.residual * w - expected.residual).abs() < 1e-12);
    }
}
