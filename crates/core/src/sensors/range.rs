//! Distance to an anchor.

use crate::types::{Row, Vector};

/// Closer than this to an anchor the direction is rounding noise.
const TOUCHING_M: f64 = 1e-9;

/// Returns the row of a measured distance to an anchor: `h = (p − anchor)/d` on the position, the first `axes` components.
///
/// With one or two axes the anchor's further coordinates are ignored, unless the target's height is known: then
/// `d² = Σ (p_i − anchor_i)² + (anchor_z − height)²`, and the gradient shortens accordingly. With three axes the height is a
/// state and `height_m` is not used. `value_m`, `anchor_m` and `height_m` in metres, `var` in m².
///
/// Within 1e-9 m of the anchor there is no direction: the gradient is zero, and the measurement moves nothing.
///
/// # Panics
/// When `axes` exceeds 3 or the state.
pub fn range<const N: usize>(
    x: &Vector<N>,
    axes: usize,
    anchor_m: [f64; 3],
    height_m: Option<f64>,
    value_m: f64,
    var: f64,
) -> Row<N> {
    let (distance_m, h) = distance(x, axes, anchor_m, height_m);
    Row { h, residual: value_m - distance_m, var }
}

/// The distance to an anchor and its gradient, as [`range`] explains them.
pub(super) fn distance<const N: usize>(
    x: &Vector<N>,
    axes: usize,
    anchor_m: [f64; 3],
    height_m: Option<f64>,
) -> (f64, Vector<N>) {
    let mut h = Vector::zeros();
    let mut square = match height_m {
        Some(height) if axes < 3 => (anchor_m[2] - height) * (anchor_m[2] - height),
        _ => 0.0,
    };
    for axis in 0..axes {
        h[axis] = x[axis] - anchor_m[axis];
        square += h[axis] * h[axis];
    }
    let distance_m = libm::sqrt(square);
    let h = if distance_m < TOUCHING_M { Vector::zeros() } else { h / distance_m };
    (distance_m, h)
}
