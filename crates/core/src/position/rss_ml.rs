//! The most likely position for the signal strengths of one moment.
//!
//! ```text
//! minimum of  Σ (P_i − (P₁ − 10 n log10 |p − a_i|))²/σ²,  covariance (JᵀJ)⁻¹ σ²
//! ```
//!
//! The covariance at the estimate is optimistic: the slope of the law is that of the estimated distances, and shorter ones are steeper.

use super::descent::descend;
use super::lateration::{Range, located};
use super::rss::to_range;
use super::{Location, Point};
use crate::sensors::{self, PathLoss};
use crate::types::Vector;

/// A measured signal strength.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Strength {
    /// The anchor, metres.
    pub anchor_m: [f64; 3],
    /// Strength, dBm.
    pub rss_dbm: f64,
}

/// Signal strengths of one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Strengths<'a> {
    /// The law they follow.
    pub law: PathLoss,
    /// Standard deviation of their noise, dB.
    pub sd_db: f64,
    /// The strengths.
    pub strengths: &'a [Strength],
    /// Known height of the target, with two axes.
    pub height_m: Option<f64>,
}

/// Returns the minimum that a search from `start` ends in; `None` when it does not settle or has no covariance.
///
/// With one unknown more than `axes` the strength at one metre is sought too, in dBm after the position; that of `law` is not used then.
///
/// # Panics
/// When `axes` is not 1, 2 or 3, or `N` neither `axes` nor one more.
pub fn gauss_newton<const N: usize>(data: &Strengths<'_>, axes: usize, start: &Vector<N>) -> Option<Point<N>> {
    assert!((1..=3).contains(&axes) && (axes..=axes + 1).contains(&N), "a position has 1 to 3 axes");
    descend(start, |x, hand_on| {
        let at_1m_dbm = if N > axes { x[axes] } else { data.law.at_1m_dbm };
        let law = PathLoss { at_1m_dbm, ..data.law };
        for s in data.strengths {
            let mut row = sensors::rssi(x, axes, s.anchor_m, data.height_m, law, s.rss_dbm, data.sd_db * data.sd_db);
            if N > axes {
                row.h[axes] = 1.0;
            }
            hand_on(&row);
        }
    })
}

/// Returns where a target is by its signal strengths. The search starts from the distances they stand for, laterated, and from the
/// centre of the anchors.
///
/// # Panics
/// When `N` is not 1, 2 or 3.
pub fn locate<const N: usize>(data: &Strengths<'_>) -> Location<N> {
    let ranges = data.strengths.iter().map(|s| {
        let range = to_range(data.law, s.rss_dbm, data.sd_db);
        Range { anchor_m: s.anchor_m, range_m: range.unbiased_m, var_m2: range.var_m2 }
    });
    let count = data.strengths.len() as f64;
    let centre =
        data.strengths.iter().fold(Vector::<N>::zeros(), |sum, s| sum + Vector::from_fn(|i, _| s.anchor_m[i] / count));
    located(ranges, data.height_m, |start| gauss_newton(data, N, start), Some(centre))
}
