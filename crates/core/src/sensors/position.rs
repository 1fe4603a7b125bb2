//! One coordinate of a position.

use crate::types::{Row, Vector};

/// Returns the row of a measured component of the state: `h = e_axis`.
///
/// `value_m` in metres and `var` in m² for a position, which is the first components of a kinematic state.
///
/// # Panics
/// When the state has no component `axis`.
pub fn position<const N: usize>(x: &Vector<N>, axis: usize, value_m: f64, var: f64) -> Row<N> {
    let mut h = Vector::zeros();
    h[axis] = 1.0;
    Row { h, residual: value_m - x[axis], var }
}
