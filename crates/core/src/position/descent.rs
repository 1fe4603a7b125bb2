//! Levenberg-damped Gauss–Newton on a handful of unknowns, finished by Newton's method.
//!
//! Where residuals are large beside the curvature of the rows, Gauss–Newton ends slowly or swings about the minimum. Close to it the steps are
//! those of the true curvature, from differences of the gradient, which the rows give exactly.

use super::Point;
use crate::linalg::{LeastSquares, definite_inverse, one_sided_jacobi, symmetrised};
use crate::types::{Belief, Matrix, Row, Vector};

/// Most accepted steps before the search is given up.
const MOST_STEPS: usize = 200;
/// A step shorter than this in standard deviations ends the search.
const SETTLED: f64 = 1e-10;
/// Below this many standard deviations the true curvature is tried first.
const CLOSE: f64 = 0.1;
/// Below this many the sum of squares no longer shows progress, the length of the step does.
const POLISHED: f64 = 1e-6;
/// Part of a standard deviation over which the gradient is differenced: the relative error of the curvature is the square of it, times the
/// bend of the rows over a standard deviation; rounding stays at 1e-13.
const DIFFERENCE: f64 = 1e-3;
/// Damping beyond which no step lowers the sum of squares.
const MOST_DAMPING: f64 = 1e12;
/// A step shorter than this that lowers nothing any more is the end: rounding of the residuals is all that is left.
const STALLED: f64 = 1e-4;
/// Smallest-to-largest singular value ratio of the Jacobian below which there is no covariance.
const SINGULAR: f64 = 1e-9;

/// Residuals about a point, as least squares.
struct Linearised<const N: usize> {
    fit: LeastSquares<N>,
    chi2: f64,
}

impl<const N: usize> Linearised<N> {
    fn at(x: &Vector<N>, rows: &impl Fn(&Vector<N>, &mut dyn FnMut(&Row<N>))) -> Self {
        let (mut fit, mut chi2) = (LeastSquares::new(), 0.0);
        rows(x, &mut |row| {
            let w = 1.0 / libm::sqrt(row.var);
            let residual = row.residual * w;
            fit.add(&(row.h * w), residual);
            chi2 += residual * residual;
        });
        Self { fit, chi2 }
    }

    /// The Gauss–Newton step, shortened by `damping` relative to the steepest direction.
    fn step(&self, damping: f64) -> Option<Vector<N>> {
        let mut fit = self.fit;
        if damping > 0.0 {
            let steepest = fit.r.column_iter().map(|c| c.norm_squared()).fold(0.0, f64::max);
            let weight = libm::sqrt(damping * steepest);
            for j in 0..N {
                let mut h = Vector::zeros();
                h[j] = weight;
                fit.add(&h, 0.0);
            }
        }
        let mut step = fit.y;
        for i in (0..N).rev() {
            for j in i + 1..N {
                step[i] -= fit.r[(i, j)] * step[j];
            }
            step[i] /= fit.r[(i, i)];
        }
        step.iter().all(|v| v.is_finite()).then_some(step)
    }

    /// Length of the undamped step in standard deviations.
    fn sds(&self) -> f64 {
        self.fit.y.norm()
    }

    /// `JᵀWe`: half the slope of the sum of squares, downwards.
    fn gradient(&self) -> Vector<N> {
        self.fit.r.transpose() * self.fit.y
    }

    /// Newton's step; `None` where the sum of squares is not curved upwards.
    fn newton(&self, x: &Vector<N>, rows: &impl Fn(&Vector<N>, &mut dyn FnMut(&Row<N>))) -> Option<Vector<N>> {
        let inverse = self.fit.right_solve(&Matrix::identity());
        let mut curvature = Matrix::<N, N>::zeros();
        for j in 0..N {
            let apart = DIFFERENCE * inverse.row(j).norm();
            let gradient = |by: f64| {
                let mut x = *x;
                x[j] += by;
                Self::at(&x, rows).gradient()
            };
            curvature.set_column(j, &((gradient(-apart) - gradient(apart)) / (2.0 * apart)));
        }
        let (inverse, _) = definite_inverse(&symmetrised(&curvature))?;
        Some(inverse * self.gradient()).filter(|step| step.iter().all(|v| v.is_finite()))
    }

    fn point(&self, x: &Vector<N>) -> Option<Point<N>> {
        let (sigma, _, _) = one_sided_jacobi(self.fit.r);
        if !(sigma.min() > SINGULAR * sigma.max()) {
            return None;
        }
        let inverse = self.fit.right_solve(&Matrix::identity());
        let cov = inverse * inverse.transpose();
        Some(Point { belief: Belief { mean: *x, cov }, chi2: self.chi2 })
    }
}

/// Returns the minimum of `Σ residual²/var` that a search from `start` ends in; `None` when it does not settle, or where the Jacobian has
/// not full rank. `rows` hands on the rows linearised at a point.
pub(super) fn descend<const N: usize>(
    start: &Vector<N>,
    rows: impl Fn(&Vector<N>, &mut dyn FnMut(&Row<N>)),
) -> Option<Point<N>> {
    let mut x = *start;
    let mut here = Linearised::at(&x, &rows);
    let mut damping = 1e-3;
    for _ in 0..MOST_STEPS {
        let sds = here.sds();
        if sds <= SETTLED {
            return here.point(&x);
        }
        if sds < CLOSE {
            let next = here.newton(&x, &rows).map(|step| (x + step, Linearised::at(&(x + step), &rows)));
            if let Some((there, next)) = next.filter(|(_, next)| next.sds() < sds) {
                (x, here) = (there, next);
                continue;
            }
            if sds < POLISHED {
                return here.point(&x);
            }
        }
        loop {
            let tried = here.step(damping).map(|step| x + step);
            let next = tried.map(|x| (x, Linearised::at(&x, &rows)));
            if let Some((there, next)) = next.filter(|(_, next)| next.chi2 < here.chi2) {
                (x, here) = (there, next);
                damping = (damping * 0.1).max(1e-15);
                break;
            }
            damping *= 10.0;
            if !(damping < MOST_DAMPING) {
                return if sds < STALLED { here.point(&x) } else { None };
            }
        }
    }
    None
}
