//! One row of a linear measurement.

use crate::types::{Row, Vector};

/// Returns the row of `z = cᵀx + v`, `var v = var`; `c` is a row of C.
pub fn linear<const N: usize>(c: &Vector<N>, x: &Vector<N>, z: f64, var: f64) -> Row<N> {
    Row { h: *c, residual: z - c.dot(x), var }
}
