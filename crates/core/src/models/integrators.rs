//! Random walk, constant velocity and constant acceleration.

use super::{DesignError, check_densities};
use crate::types::{Matrix, Transition, Vector};

/// A chain of integrators per axis whose last derivative is driven by white noise.
///
/// Order 1 is the random walk, 2 constant velocity, 3 constant acceleration. State: all positions, then all velocities,
/// then all accelerations, then `N − order · axes` further components, which the motion leaves as they are.
///
/// ```
/// use fixtrail_core::{Vector, models::Integrators};
///
/// // Constant velocity in the plane, 0.5 m²/s³ on each axis.
/// let motion = Integrators::<4>::new(2, 2, [0.5, 0.5, 0.0])?;
/// let leap = motion.leap(&Vector::from([0.0, 0.0, 3.0, -1.0]), 2.0);
/// assert_eq!(leap.next, Vector::from([6.0, -2.0, 3.0, -1.0]));
/// assert_eq!(leap.q[(0, 2)], 1.0); // q dt²/2
/// # Ok::<(), fixtrail_core::models::DesignError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Integrators<const N: usize> {
    order: usize,
    axes: usize,
    psd: [f64; 3],
}

impl<const N: usize> Integrators<N> {
    /// Returns the model of `order` derivatives on `axes` axes.
    ///
    /// `psd` is the power spectral density per axis of the noise that drives the last derivative: m²/s, m²/s³ or m²/s⁵
    /// for order 1, 2, 3. Entries beyond `axes` are not used.
    ///
    /// # Errors
    /// [`DesignError`] when order or axes is not 1, 2 or 3, `N` is less than their product, or a density of a modelled axis
    /// is negative or not finite.
    pub fn new(order: usize, axes: usize, psd: [f64; 3]) -> Result<Self, DesignError> {
        if !(1..=3).contains(&order) {
            return Err(DesignError::Order { order });
        }
        if !(1..=3).contains(&axes) {
            return Err(DesignError::Axes { axes });
        }
        if N < order * axes {
            return Err(DesignError::StateSize { found: N, expected: order * axes });
        }
        check_densities(&psd[..axes])?;
        Ok(Integrators { order, axes, psd })
    }

    /// Number of modelled derivatives: 1, 2 or 3.
    pub fn order(&self) -> usize {
        self.order
    }

    /// Number of axes: 1, 2 or 3.
    pub fn axes(&self) -> usize {
        self.axes
    }

    /// Returns the motion over `dt_s` seconds: the exact discretisation of the continuous chain.
    ///
    /// With derivatives i, j counted from 0 and `a = order − 1 − i`, `b = order − 1 − j`:
    /// `f_ij = dt^(j−i)/(j−i)!` and `q_ij = psd · dt^(a+b+1) / (a! b! (a+b+1))`.
    /// `dt_s` must be finite and at least 0; 0 gives the identity without noise.
    pub fn leap(&self, x: &Vector<N>, dt_s: f64) -> Transition<N> {
        debug_assert!(dt_s >= 0.0 && dt_s.is_finite(), "an interval of {dt_s} s");
        let dt2 = dt_s * dt_s;
        let dt3 = dt2 * dt_s;
        let phi = [1.0, dt_s, dt2 / 2.0];
        let noise = unit_noise(self.order, dt_s, dt2, dt3);
        let (mut f, mut q) = (Matrix::<N, N>::identity(), Matrix::<N, N>::zeros());
        let mut next = *x;
        for axis in 0..self.axes {
            for i in 0..self.order {
                let row = i * self.axes + axis;
                for j in 0..self.order {
                    let col = j * self.axes + axis;
                    q[(row, col)] = self.psd[axis] * noise[i][j];
                    if j > i {
                        f[(row, col)] = phi[j - i];
                        next[row] += phi[j - i] * x[col];
                    }
                }
            }
        }
        Transition { next, f, q }
    }
}

/// Covariance of one axis for a density of 1.
fn unit_noise(order: usize, dt: f64, dt2: f64, dt3: f64) -> [[f64; 3]; 3] {
    match order {
        1 => [[dt, 0.0, 0.0], [0.0; 3], [0.0; 3]],
        2 => [[dt3 / 3.0, dt2 / 2.0, 0.0], [dt2 / 2.0, dt, 0.0], [0.0; 3]],
        _ => {
            let (pos_vel, pos_acc, vel_acc) = (dt2 * dt2 / 8.0, dt3 / 6.0, dt2 / 2.0);
            [[dt2 * dt3 / 20.0, pos_vel, pos_acc], [pos_vel, dt3 / 3.0, vel_acc], [pos_acc, vel_acc, dt]]
        }
    }
}
