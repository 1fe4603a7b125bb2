//! Position from distances.
//!
//! ```text
//! linear stage   w_i ∝ 1/(4 r_i² var_i),  Σ w = 1,  c = Σ w_i a_i,  b_i = |a_i − c|² − r_i²
//!                weighted least squares of 2 (a_i − c)·q = b_i − Σ w b,  p = c + q
//! rank N         p is unique
//! rank N − 1     |p − c|² = −Σ w b gives the offset t from the anchors' line or plane: p = c + q ± t n; t² ≤ 0: no intersection
//! then           Gauss–Newton on Σ (r_i − |p − a_i|)²/var_i, covariance (JᵀWJ)⁻¹
//! ```
//!
//! With a known height the squared distances are first reduced to the plane. For the true distances the expression for t² is exact for
//! every layout, so anchors that are *nearly* in line may be taken for anchors in line: the linear stage then does not amplify the noise
//! by the little that they are off, and Gauss–Newton uses what they are off.

use super::descent::descend;
use super::{Candidates, Location, Point};
use crate::linalg::{LeastSquares, one_sided_jacobi};
use crate::sensors;
use crate::types::{Matrix, Vector};

/// Layouts that are thinner than this, relative to their length, are in line.
const IN_LINE: f64 = 1e-9;
/// Layouts narrower than this many standard deviations of the distances are too narrow for the linear stage.
const NARROW_SDS: f64 = 10.0;
/// Components of a unit vector below this are rounding.
const NO_COMPONENT: f64 = 1e-9;

/// A measured distance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Range {
    /// The anchor, metres.
    pub anchor_m: [f64; 3],
    /// Distance, metres.
    pub range_m: f64,
    /// Variance of its noise, m².
    pub var_m2: f64,
}

/// When anchors count as being in one line (plane).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rank {
    /// Smallest singular value of the weighted, centred anchors over the largest.
    pub relative: f64,
    /// The same in metres: the weighted RMS offset from the line (plane) that fits best.
    pub offset_m: f64,
}

impl Rank {
    /// In line up to rounding.
    pub const EXACT: Rank = Rank { relative: IN_LINE, offset_m: 0.0 };
}

/// What the linear stage says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Linear<const N: usize> {
    /// One position.
    Unique(Vector<N>),
    /// Two positions, mirrored at the anchors' line (plane). First the one along the normal whose first component is positive.
    Mirror([Vector<N>; 2]),
    /// The distances do not reach each other.
    NoIntersection {
        /// The point of the anchors' line (plane) that fits best.
        foot: Vector<N>,
        /// Unit normal of the line (plane).
        normal: Vector<N>,
    },
    /// Too few anchors, or all in one point (line).
    NotDetermined,
}

/// The weighted distances as a linear problem.
struct Normal<const N: usize> {
    centre: Vector<N>,
    /// `Σ w b`.
    mean: f64,
    /// Of the rows `√w (a − c)` and data `√w (b − mean)/2`.
    fit: LeastSquares<N>,
    /// Weighted mean of the variances.
    var_m2: f64,
}

fn normal<const N: usize>(ranges: impl Iterator<Item = Range> + Clone, height_m: Option<f64>) -> Option<Normal<N>> {
    assert!((1..=3).contains(&N), "a position has 1 to 3 axes");
    let flat = |a: &[f64; 3]| Vector::<N>::from_fn(|i, _| a[i]);
    // Squared distance in the axes that are sought.
    let square = |r: &Range| {
        let rise = height_m.filter(|_| N < 3).map_or(0.0, |h| r.anchor_m[2] - h);
        r.range_m * r.range_m - rise * rise
    };
    // A distance of zero knows its square to more than first order: the floor keeps the weight finite and changes no other.
    let weight = |r: &Range| 1.0 / (4.0 * (r.range_m * r.range_m).max(1e-12 * r.var_m2) * r.var_m2);
    let total: f64 = ranges.clone().map(|r| weight(&r)).sum();
    if !(total > 0.0 && total.is_finite()) {
        return None;
    }
    let (mut centre, mut var_m2) = (Vector::<N>::zeros(), 0.0);
    for r in ranges.clone() {
        centre += flat(&r.anchor_m) * (weight(&r) / total);
        var_m2 += r.var_m2 * (weight(&r) / total);
    }
    let b = |r: &Range| (flat(&r.anchor_m) - centre).norm_squared() - square(r);
    let mean: f64 = ranges.clone().map(|r| weight(&r) / total * b(&r)).sum();
    let mut fit = LeastSquares::new();
    for r in ranges {
        let root = libm::sqrt(weight(&r) / total);
        fit.add(&((flat(&r.anchor_m) - centre) * root), 0.5 * (b(&r) - mean) * root);
    }
    Some(Normal { centre, mean, fit, var_m2 })
}

impl<const N: usize> Normal<N> {
    fn solve(&self, rank: Rank) -> Linear<N> {
        let (sigma, u_sigma, v): (Vector<N>, Matrix<N, N>, Matrix<N, N>) = one_sided_jacobi(self.fit.r);
        let least = (rank.relative * sigma.max()).max(rank.offset_m);
        let mut q = Vector::<N>::zeros();
        let (mut kept, mut flattest) = (0, 0);
        for j in 0..N {
            if sigma[j] > least {
                q += v.column(j) * (u_sigma.column(j).dot(&self.fit.y) / (sigma[j] * sigma[j]));
                kept += 1;
            } else {
                flattest = j;
            }
        }
        let foot = self.centre + q;
        if kept == N {
            return Linear::Unique(foot);
        }
        if kept + 1 < N {
            return Linear::NotDetermined;
        }
        let mut normal: Vector<N> = v.column(flattest).into();
        if normal.iter().find(|c| c.abs() > NO_COMPONENT).is_some_and(|c| *c < 0.0) {
            normal = -normal;
        }
        let square = -self.mean - q.norm_squared();
        if square > 0.0 {
            let away = normal * libm::sqrt(square);
            Linear::Mirror([foot + away, foot - away])
        } else {
            Linear::NoIntersection { foot, normal }
        }
    }

    /// The rank at which the linear stage can be trusted.
    fn physical(&self) -> Rank {
        // The RMS offset of a layout is half its width.
        Rank { relative: IN_LINE, offset_m: 0.5 * NARROW_SDS * libm::sqrt(self.var_m2) }
    }
}

/// Returns the result of the linear stage; weights, rank and mirrored pair as in the [module](self)'s lines.
///
/// # Panics
/// When `N` is not 1, 2 or 3.
pub fn linear<const N: usize>(ranges: &[Range], height_m: Option<f64>, rank: Rank) -> Linear<N> {
    normal::<N>(ranges.iter().copied(), height_m).map_or(Linear::NotDetermined, |n| n.solve(rank))
}

/// Returns the minimum of `Σ (r_i − |p − a_i|)²/var_i` that a search from `start` ends in; `None` when it does not settle or has no
/// covariance, as on the anchors' line.
///
/// # Panics
/// When `N` is not 1, 2 or 3.
pub fn gauss_newton<const N: usize>(ranges: &[Range], height_m: Option<f64>, start: &Vector<N>) -> Option<Point<N>> {
    assert!((1..=3).contains(&N), "a position has 1 to 3 axes");
    descend(start, |x, hand_on| {
        for r in ranges {
            hand_on(&sensors::range(x, N, r.anchor_m, height_m, r.range_m, r.var_m2));
        }
    })
}

/// Returns where a target is by its distances.
///
/// A layout narrower than ten standard deviations of the distances gives both mirrored starts beside the linear one; what Gauss–Newton
/// finds from them is a pair unless one fits decisively better (by 16 in the sum of squares).
///
/// # Panics
/// When `N` is not 1, 2 or 3.
pub fn locate<const N: usize>(ranges: &[Range], height_m: Option<f64>) -> Location<N> {
    located(ranges.iter().copied(), height_m, |start| gauss_newton(ranges, height_m, start), None)
}

/// [`locate`] with another likelihood for the minima, and one start more.
pub(super) fn located<const N: usize>(
    ranges: impl Iterator<Item = Range> + Clone,
    height_m: Option<f64>,
    refine: impl Fn(&Vector<N>) -> Option<Point<N>>,
    extra: Option<Vector<N>>,
) -> Location<N> {
    let Some(problem) = normal::<N>(ranges, height_m) else { return Location::NotDetermined };
    let mut found = Candidates::new();
    let off = libm::sqrt(problem.var_m2);
    let both = |linear: &Linear<N>| match linear {
        Linear::Mirror(pair) => Some(*pair),
        // Noise may have brought the offset to nothing: a standard deviation beside the line shows whether there is one.
        Linear::NoIntersection { foot, normal } => Some([foot + normal * off, foot - normal * off]),
        Linear::Unique(_) | Linear::NotDetermined => None,
    };
    let exact = problem.solve(Rank::EXACT);
    let mut none = Location::NoIntersection;
    let pair = match &exact {
        Linear::NotDetermined => return Location::NotDetermined,
        Linear::Unique(start) => {
            none = Location::NotDetermined;
            found.add(refine(start));
            both(&problem.solve(problem.physical()))
        }
        in_line => both(in_line),
    };
    for start in pair.iter().flatten().chain(&extra) {
        found.add(refine(start));
    }
    found.decide(none)
}
