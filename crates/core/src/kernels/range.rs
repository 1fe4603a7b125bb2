//! A distance to an anchor, linearised at the mean.
//!
//! ```text
//! d = |p − anchor|      h = (p − anchor)/d on the position      e = z − d
//! ```
//!
//! The row is taken `d` times as large, `h d = p − anchor` with `e d` and `r d²`, which says the same: no direction is divided out, and the
//! root is drawn while the covariance is multiplied.

use super::Real;
use super::packed::Packed;

/// Closer than this to an anchor the direction is rounding noise, as in [`crate::sensors::range`].
const TOUCHING_M: f64 = 1e-9;

impl<T: Real, const N: usize> Packed<T, N> {
    /// Returns the belief after a measured distance `z` of the position, the first `A` components, to an anchor, with variance `var`, and the
    /// innovation variance. Where `z` is NaN nothing was measured.
    #[inline(always)]
    pub fn range<const A: usize>(&self, anchor_m: &[T; A], z: T, var: T) -> (Self, T) {
        let mut h = *anchor_m;
        for i in 0..A {
            h[i] = self.mean[i] - anchor_m[i];
        }
        let mut square = h[0] * h[0];
        for h in &h[1..] {
            square = square + *h * *h;
        }
        let d = square.sqrt();
        for i in 0..A {
            h[i] = h[i].where_above(d, TOUCHING_M, d.zero());
        }
        let square = square.where_above(d, TOUCHING_M, d.one());
        let (out, s) = self.update(&h, (z - d) * d, var * square);
        (out, s * square.inverse())
    }
}
