//! Difference of the distances to two anchors.

use super::range::distance;
use crate::types::{Row, Vector};

/// The anchors of a difference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pair {
    /// The anchor, metres.
    pub anchor_m: [f64; 3],
    /// The anchor whose distance is subtracted, metres.
    pub reference_m: [f64; 3],
}

/// Returns the row of a time difference of arrival, as a distance `|p − anchor| − |p − reference|`: `h` is the difference of the two
/// directions, on the position, the first `axes` components.
///
/// Axes and known height as in [`range`](super::range). `value_m` in metres, `var` in m². The noises of differences that share an anchor
/// are correlated: make their rows independent with [`Common`](crate::linalg::Common), or [`whiten`](crate::linalg::whiten).
///
/// Within 1e-9 m of one of the anchors its direction is zero.
///
/// # Panics
/// When `axes` exceeds 3 or the state.
pub fn tdoa<const N: usize>(
    x: &Vector<N>,
    axes: usize,
    pair: Pair,
    height_m: Option<f64>,
    value_m: f64,
    var: f64,
) -> Row<N> {
    let (far_m, away) = distance(x, axes, pair.anchor_m, height_m);
    let (reference_m, from_reference) = distance(x, axes, pair.reference_m, height_m);
    Row { h: away - from_reference, residual: value_m - (far_m - reference_m), var }
}
