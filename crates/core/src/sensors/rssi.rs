//! Received signal strength under the log-distance law.

use super::range::distance;
use crate::types::{Row, Vector};
use core::f64::consts::LN_10;

/// Closer than this to an anchor, less than a wavelength of the usual radios, no log-distance law holds.
const NEAR_M: f64 = 0.1;

/// The log-distance law: `P(d) = at_1m_dbm − 10 exponent log10(d / 1 m)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathLoss {
    /// Exponent n: 2 in free space, 2 to 4 indoors.
    pub exponent: f64,
    /// Strength one metre from the anchor, dBm.
    pub at_1m_dbm: f64,
}

/// Returns the row of a signal strength at or from an anchor: `h = −(10 n / ln 10) (p − anchor)/d²` on the position, the first `axes`
/// components; the law is that of \[FOSB12\].
///
/// Anchor, axes and known height as in [`range`](super::range). `value_dbm` in dBm, `var` in dB²; `h` is in dB/m.
///
/// Closer to the anchor than 0.1 m the strength expected is that at 0.1 m and the gradient is zero: the law and its slope grow without bound
/// there, and a radio does not follow them.
///
/// # Panics
/// When `axes` exceeds 3 or the state.
pub fn rssi<const N: usize>(
    x: &Vector<N>,
    axes: usize,
    anchor_m: [f64; 3],
    height_m: Option<f64>,
    law: PathLoss,
    value_dbm: f64,
    var: f64,
) -> Row<N> {
    let (distance_m, direction) = distance(x, axes, anchor_m, height_m);
    let slope = -10.0 * law.exponent / LN_10;
    let h = if distance_m < NEAR_M { Vector::zeros() } else { direction * (slope / distance_m) };
    let expected_dbm = law.at_1m_dbm + slope * libm::log(distance_m.max(NEAR_M));
    Row { h, residual: value_dbm - expected_dbm, var }
}
