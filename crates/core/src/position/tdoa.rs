//! Position from differences of distances to a common reference anchor.
//!
//! ```text
//! dd_i = |p − a_i| − |p − a_0|,  covariance diag(var_i) + var_0 1 1ᵀ
//! linear start   least squares of 2 (a_i − a_0)·(p − a_0) + 2 dd_i r_0 = |a_i − a_0|² − dd_i²  in p and r_0 = |p − a_0|
//! rank N         a line of solutions, cut with |p − a_0| = r_0 ≥ 0: two, one or none
//! then           Gauss–Newton with the full covariance, from the linear start and from the centre of the anchors
//! ```

use super::descent::descend;
use super::{Candidates, Location, Point};
use crate::linalg::{Common, LeastSquares, one_sided_jacobi};
use crate::sensors::{self, Pair};
use crate::types::Vector;

/// Relative singular value below which the linear start has lost a direction.
const LOST: f64 = 1e-9;

/// A measured difference of distances.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Difference {
    /// The anchor, metres.
    pub anchor_m: [f64; 3],
    /// Its distance less that of the reference anchor, metres.
    pub difference_m: f64,
    /// Variance of the anchor's own time of arrival, as a distance, m².
    pub var_m2: f64,
}

/// Differences of one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Differences<'a> {
    /// The reference anchor, metres.
    pub reference_m: [f64; 3],
    /// Variance of the reference's time of arrival, m²: the noise that all differences have in common.
    pub reference_var_m2: f64,
    /// The differences.
    pub differences: &'a [Difference],
    /// Known height of the target, with two axes.
    pub height_m: Option<f64>,
}

/// What the linear start says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Linear<const N: usize> {
    /// The differences determine position and distance to the reference.
    Unique {
        /// Position, metres.
        position_m: Vector<N>,
        /// Distance to the reference; negative when noise has led the linear problem astray. Metres.
        reference_range_m: f64,
    },
    /// Up to two positions fit.
    Roots([Option<Vector<N>>; 2]),
    /// Too few differences, or anchors that see the same.
    NotDetermined,
}

/// Returns the linear start, all differences weighing the same.
///
/// # Panics
/// When `N` is not 1, 2 or 3.
pub fn linear<const N: usize>(data: &Differences<'_>) -> Linear<N> {
    assert!((1..=3).contains(&N), "a position has 1 to 3 axes");
    let origin = data.reference_m;
    // Height of the target over the reference, where it is known.
    let rise = data.height_m.filter(|_| N < 3).map_or(0.0, |h| h - origin[2]);
    let uses_height = data.height_m.is_some() || N == 3;
    // Position in the first N unknowns, r_0 in the one after; what is left of four stays zero.
    let mut fit = LeastSquares::<4>::new();
    for d in data.differences {
        let mut h = Vector::<4>::zeros();
        let mut square = 0.0;
        for axis in 0..3 {
            let leg = d.anchor_m[axis] - origin[axis];
            if axis < N {
                h[axis] = 2.0 * leg;
                square += leg * leg;
            } else if axis == 2 && uses_height {
                square += leg * leg - 2.0 * leg * rise;
            }
        }
        h[N] = 2.0 * d.difference_m;
        fit.add(&h, square - d.difference_m * d.difference_m);
    }
    let (sigma, u_sigma, v) = one_sided_jacobi(fit.r);
    let mut s = Vector::<4>::zeros();
    let (mut kept, mut lost) = (0, 0);
    // Columns beyond the unknowns are zero, and Jacobi leaves them where they are.
    for j in 0..=N {
        if sigma[j] > LOST * sigma.max() {
            s += v.column(j) * (u_sigma.column(j).dot(&fit.y) / (sigma[j] * sigma[j]));
            kept += 1;
        } else {
            lost = j;
        }
    }
    let position = |s: &Vector<4>| Vector::<N>::from_fn(|i, _| s[i] + origin[i]);
    if kept == N + 1 {
        return Linear::Unique { position_m: position(&s), reference_range_m: s[N] };
    }
    if kept < N {
        return Linear::NotDetermined;
    }
    // |q|² + rise² = r_0² along s + τ n.
    let n: Vector<4> = v.column(lost).into();
    let product = |a: &Vector<4>, b: &Vector<4>| (0..N).map(|i| a[i] * b[i]).sum::<f64>() - a[N] * b[N];
    let roots = quadratic(product(&n, &n), product(&s, &n), product(&s, &s) + rise * rise);
    let at = |root: Option<f64>| root.map(|t| s + n * t).filter(|s| s[N] >= 0.0).map(|s| position(&s));
    Linear::Roots(roots.map(at))
}

/// The real roots of `a t² + 2 b t + c`.
fn quadratic(a: f64, b: f64, c: f64) -> [Option<f64>; 2] {
    let square = b * b - a * c;
    if !(square >= 0.0) {
        return [None, None];
    }
    // No subtraction of what is nearly equal: the other root from the product of both.
    let q = -(b + libm::copysign(libm::sqrt(square), b));
    let finite = |t: f64| Some(t).filter(|t| t.is_finite());
    [finite(q / a), finite(c / q)]
}

/// Returns the minimum of the weighted sum of squares, with the full covariance, that a search from `start` ends in; `None` when it does
/// not settle or has no covariance.
///
/// # Panics
/// When `N` is not 1, 2 or 3.
pub fn gauss_newton<const N: usize>(data: &Differences<'_>, start: &Vector<N>) -> Option<Point<N>> {
    assert!((1..=3).contains(&N), "a position has 1 to 3 axes");
    descend(start, |x, hand_on| {
        let mut common = Common::new(data.reference_var_m2);
        for d in data.differences {
            let pair = Pair { anchor_m: d.anchor_m, reference_m: data.reference_m };
            // The difference is less the reference's noise: the sign of what is common does not matter.
            hand_on(&common.next(&sensors::tdoa(x, N, pair, data.height_m, d.difference_m, d.var_m2)));
        }
    })
}

/// Returns where a target is by differences of its distances.
///
/// # Panics
/// When `N` is not 1, 2 or 3.
pub fn locate<const N: usize>(data: &Differences<'_>) -> Location<N> {
    let mut found = Candidates::new();
    match linear::<N>(data) {
        Linear::NotDetermined => return Location::NotDetermined,
        Linear::Roots(roots) => {
            for start in roots.iter().flatten() {
                found.add(gauss_newton(data, start));
            }
            return found.decide(Location::NoIntersection);
        }
        Linear::Unique { position_m, .. } => found.add(gauss_newton(data, &position_m)),
    }
    let count = data.differences.len() as f64 + 1.0;
    let anchors = data.differences.iter().map(|d| d.anchor_m).chain([data.reference_m]);
    let centre = anchors.fold(Vector::<N>::zeros(), |sum, a| sum + Vector::from_fn(|i, _| a[i] / count));
    found.add(gauss_newton(data, &centre));
    found.decide(Location::NotDetermined)
}
