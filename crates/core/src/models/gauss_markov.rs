//! A target that lives somewhere: position and velocity keep to a stationary law.

use super::{DesignError, check_densities};
use crate::types::{Matrix, Transition, Vector};

/// Second-order Gauss–Markov motion per axis, critically damped: `p̈ = −2λ ṗ − λ² (p − c) + w`.
///
/// Its position is a Gaussian process with the Matérn covariance of ν = 3/2, `σ² (1 + λ|τ|) exp(−λ|τ|)` (Rasmussen & Williams 2006,
/// sec. 4.2.1): centre c and standard deviation σ of the position, standard deviation `λσ` of the velocity, for ever. Over times that are
/// short beside `1/λ` it is constant velocity driven by white noise of density `4 λ³ σ²`; over long ones it forgets where the target was
/// and knows where it lives, so that its covariance stays bounded without measurements.
///
/// State: all positions, then all velocities, then `N − 2 · axes` further components, which the motion leaves as they are.
///
/// ```
/// use fixtrail_core::{Vector, models::GaussMarkov};
///
/// // Within some 5 m of (10, 20), at some 0.5 m/s.
/// let motion = GaussMarkov::<4>::new(2, [10.0, 20.0, 0.0], [5.0, 5.0, 0.0], [0.5, 0.5, 0.0])?;
/// let leap = motion.leap(&Vector::from([13.0, 20.0, 0.0, 0.0]), 1000.0);
/// assert!((leap.next - Vector::from([10.0, 20.0, 0.0, 0.0])).amax() < 1e-9);
/// assert!((leap.q[(0, 0)] - 25.0).abs() < 1e-9);
/// # Ok::<(), fixtrail_core::models::DesignError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GaussMarkov<const N: usize> {
    axes: usize,
    centre_m: [f64; 3],
    spread_m: [f64; 3],
    speed_mps: [f64; 3],
}

impl<const N: usize> GaussMarkov<N> {
    /// Returns the model on `axes` axes with centre and standard deviation of the position, and that of the velocity per axis. Entries
    /// beyond `axes` are not used.
    ///
    /// # Errors
    /// [`DesignError`] when axes is not 1, 2 or 3, `N` is less than twice their number, a centre is not finite, or a standard deviation is
    /// not positive and finite.
    pub fn new(axes: usize, centre_m: [f64; 3], spread_m: [f64; 3], speed_mps: [f64; 3]) -> Result<Self, DesignError> {
        if !(1..=3).contains(&axes) {
            return Err(DesignError::Axes { axes });
        }
        if N < 2 * axes {
            return Err(DesignError::StateSize { found: N, expected: 2 * axes });
        }
        check_densities(&spread_m[..axes])?;
        check_densities(&speed_mps[..axes])?;
        let wrong = |i: &usize| !(centre_m[*i].is_finite() && spread_m[*i] > 0.0 && speed_mps[*i] > 0.0);
        match (0..axes).find(wrong) {
            Some(axis) => Err(DesignError::Stationary { axis }),
            None => Ok(Self { axes, centre_m, spread_m, speed_mps }),
        }
    }

    /// Mean and standard deviation of component `i` in the stationary law, which has no correlations; `None` beyond the motion's own.
    pub fn stationary(&self, i: usize) -> Option<(f64, f64)> {
        match (i / self.axes, i % self.axes) {
            (0, axis) => Some((self.centre_m[axis], self.spread_m[axis])),
            (1, axis) => Some((0.0, self.speed_mps[axis])),
            _ => None,
        }
    }

    /// Returns the motion over `dt_s` seconds, exactly.
    ///
    /// With `a = λ dt`, `e = exp(−a)`: `f = e [[1 + a, dt], [−λ a, 1 − a]]` on the deviation from the centre, and with
    /// `E = e²`, `r = E (exp(2a) − 1 − 2a − 2a²)`: `q = σ² [[r, 2λa² E], [2λa² E, λ² (r + 4a E)]]`, which is `P − f P fᵀ` of the stationary
    /// `P = σ² diag(1, λ²)` without its cancellation.
    /// `dt_s` must be finite and at least 0; 0 gives the identity without noise.
    pub fn leap(&self, x: &Vector<N>, dt_s: f64) -> Transition<N> {
        debug_assert!(dt_s >= 0.0 && dt_s.is_finite(), "an interval of {dt_s} s");
        let (mut f, mut q) = (Matrix::<N, N>::identity(), Matrix::<N, N>::zeros());
        let mut next = *x;
        for axis in 0..self.axes {
            let velocity = self.axes + axis;
            let lambda = self.speed_mps[axis] / self.spread_m[axis];
            let var = self.spread_m[axis] * self.spread_m[axis];
            let a = lambda * dt_s;
            let e = libm::exp(-a);
            let (pp, pv, vp, vv) = (e * (1.0 + a), e * dt_s, -e * lambda * a, e * (1.0 - a));
            f[(axis, axis)] = pp;
            f[(axis, velocity)] = pv;
            f[(velocity, axis)] = vp;
            f[(velocity, velocity)] = vv;
            let off = x[axis] - self.centre_m[axis];
            next[axis] = self.centre_m[axis] + pp * off + pv * x[velocity];
            next[velocity] = vp * off + vv * x[velocity];
            let (decayed, rest) = (e * e, remainder(2.0 * a));
            q[(axis, axis)] = var * rest;
            q[(axis, velocity)] = var * 2.0 * lambda * a * a * decayed;
            q[(velocity, axis)] = q[(axis, velocity)];
            q[(velocity, velocity)] = var * lambda * lambda * (rest + 4.0 * a * decayed);
        }
        Transition { next, f, q }
    }
}

/// `exp(−u) (exp(u) − 1 − u − u²/2)` for u ≥ 0.
fn remainder(u: f64) -> f64 {
    if u > 1.0 {
        return 1.0 - libm::exp(-u) * (1.0 + u + u * u / 2.0);
    }
    // u³/3! + u⁴/4! + …: below 1, 18 terms leave 1/21! of the first.
    let mut sum = 0.0;
    for k in (4..=20).rev() {
        sum = (1.0 + sum) * u / f64::from(k);
    }
    libm::exp(-u) * (1.0 + sum) * u * u * u / 6.0
}
