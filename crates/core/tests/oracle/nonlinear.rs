//! Dense nonlinear least squares over a whole trajectory: all states at once, Jacobian by differences, Levenberg–Marquardt steps.

use super::Posterior;
use nalgebra::{DMatrix, DVector};

/// Residuals of unit variance as a function of the stacked states.
pub type Residuals<'a> = dyn Fn(&DVector<f64>) -> DVector<f64> + 'a;

/// The minimum of the sum of squared residuals, started at `guess`, and the inverse of JᵀJ there.
pub fn minimised(residuals: &Residuals<'_>, guess: DVector<f64>) -> Posterior {
    let mut x = guess;
    let mut damping = 1e-3;
    let mut cost = residuals(&x).norm_squared();
    for _ in 0..200 {
        let (j, r) = (jacobian(residuals, &x), residuals(&x));
        let normal = j.transpose() * &j;
        let damped = &normal + DMatrix::from_diagonal(&(normal.diagonal() * damping));
        let step = damped.cholesky().expect("damped").solve(&-(j.transpose() * r));
        let next = &x + &step;
        let next_cost = residuals(&next).norm_squared();
        if next_cost <= cost {
            x = next;
            cost = next_cost;
            damping = if damping < 1e-12 { 0.0 } else { damping * 0.1 };
            if step.amax() < 1e-11 * x.amax().max(1.0) {
                break;
            }
        } else if damping > 1e12 || step.amax() < 1e-11 * x.amax().max(1.0) {
            break;
        } else {
            damping = damping.max(1e-12) * 10.0;
        }
    }
    let j = jacobian(residuals, &x);
    let cov = (j.transpose() * &j).try_inverse().expect("the trajectory is determined");
    Posterior { mean: x, cov }
}

/// Central differences; with steps of 1e-5 of the size their error is about 1e-10.
fn jacobian(residuals: &Residuals<'_>, x: &DVector<f64>) -> DMatrix<f64> {
    let columns: Vec<DVector<f64>> = (0..x.len())
        .map(|i| {
            let h = 1e-5 * x[i].abs().max(1.0);
            let (mut up, mut down) = (x.clone(), x.clone());
            up[i] += h;
            down[i] -= h;
            (residuals(&up) - residuals(&down)) / (up[i] - down[i])
        })
        .collect();
    DMatrix::from_columns(&columns)
}
