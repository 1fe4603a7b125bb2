//! Levenberg-damped Gauss–Newton on a handful of unknowns.

use super::Point;
use crate::linalg::{LeastSquares, one_sided_jacobi};
use crate::types::{Belief, Matrix, Row, Vector};

/// Most accepted steps before the search is given up.
const MOST_STEPS: usize = 200;
/// A step shorter than this in standard deviations ends the search.
const SETTLED: f64 = 1e-10;
/// Below this many standard deviations the sum of squares no longer shows progress, the length of the step does.
const POLISHED: f64 = 1e-6;
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
        if sds < POLISHED {
            let Some(step) = here.step(0.0) else { return here.point(&x) };
            let next = Linearised::at(&(x + step), &rows);
            if !(next.sds() < sds) {
                return here.point(&x);
            }
            x += step;
            here = next;
            continue;
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
