//! Sensors against differences of the value they linearise.

use fixtrail_core::sensors::{linear, position, range};
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
