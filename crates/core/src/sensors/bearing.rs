//! Direction from an anchor to the target, in the plane.

use crate::types::{Row, Vector};
use core::f64::consts::{PI, TAU};

/// Closer than this to an anchor, seen from above, the direction is rounding noise.
const TOUCHING_M: f64 = 1e-9;

/// Returns the row of a bearing from an anchor, `atan2(p_y − anchor_y, p_x − anchor_x)`, counter-clockwise from the x axis:
/// `h = (−Δy, Δx)/(Δx² + Δy²)` on the first two components.
///
/// The residual is the turn from the expected to the measured direction, in (−π, π]: whole turns of `value_rad` do not matter. Heights do
/// not either, with two axes or three. `value_rad` in radians, `anchor_m` in metres, `var` in rad²; `h` is in rad/m.
///
/// Within 1e-9 m of the anchor there is no direction: the gradient is zero, and the measurement moves nothing.
///
/// # Panics
/// When the state has fewer than two components.
pub fn bearing<const N: usize>(x: &Vector<N>, anchor_m: [f64; 3], value_rad: f64, var: f64) -> Row<N> {
    let (dx, dy) = (x[0] - anchor_m[0], x[1] - anchor_m[1]);
    let square = dx * dx + dy * dy;
    let mut h = Vector::zeros();
    if square >= TOUCHING_M * TOUCHING_M {
        h[0] = -dy / square;
        h[1] = dx / square;
    }
    let turn = libm::remainder(value_rad - libm::atan2(dy, dx), TAU);
    Row { h, residual: if turn <= -PI { PI } else { turn }, var }
}
