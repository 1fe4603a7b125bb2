//! What a receiver without time stamps holds, and the joint moments of the state and of the values that it may show.
//!
//! ```text
//! y_{k+1} = γ_{k+1} z_{k+1} + (1 − γ_{k+1}) d_k             what is shown; γ = 1 with probability p: something came
//! d_{k+1} = γ_{k+1} z_{k+1} + (1 − γ_{k+1}) z_k             Hold::Paper, (1c) of [MVF10]: a value is late by two steps at most
//! d_{k+1} = γ_{k+1} z_{k+1} + (1 − γ_{k+1}) d_k             Hold::LastReceived
//! ```
//!
//! Given the past, `y` and the next `d` are mixtures of `n = z_{k+1}`, `z = z_k` and `d = d_k`, which is why their first two moments
//! beside those of the state are all that a filter needs.

use crate::estimators::kalman::propagate;
use crate::linalg::{definite_inverse, symmetrised};
use crate::types::{Belief, Matrix, StepError, Transition, Vector};

/// What a receiver shows when nothing comes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Hold {
    /// The value before, or after two losses the one before that even if it was lost too: (1c) of \[MVF10\].
    #[default]
    Paper,
    /// The last value that came.
    LastReceived,
}

/// A measurement linearised about a state x: `z ≈ expected + h (x' − x) + v`, `cov v = r`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensed<const N: usize, const M: usize> {
    /// `h(x)`.
    pub expected: Vector<M>,
    /// Jacobian at x.
    pub h: Matrix<M, N>,
    /// Noise covariance, positive definite.
    pub r: Matrix<M, M>,
}

/// What the receiver shows; components that are not seen say nothing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shown<const M: usize> {
    /// Values; those of components not seen are not used.
    pub y: Vector<M>,
    /// Which components are seen.
    pub seen: [bool; M],
}

impl<const M: usize> Shown<M> {
    /// Every component of `y`.
    pub fn all(y: Vector<M>) -> Self {
        Self { y, seen: [true; M] }
    }

    /// Nothing.
    pub fn nothing() -> Self {
        Self { y: Vector::zeros(), seen: [false; M] }
    }

    /// Number of components seen.
    pub fn count(&self) -> u32 {
        self.seen.iter().map(|s| u32::from(*s)).sum()
    }

    /// Diagonal: 1 for what is seen, 0 for the rest.
    fn mask(&self) -> Matrix<M, M> {
        Matrix::from_fn(|i, j| if i == j && self.seen[i] { 1.0 } else { 0.0 })
    }

    /// Returns `y − expected`, 0 for what is not seen.
    pub(crate) fn innovation(&self, expected: &Vector<M>) -> Vector<M> {
        Vector::from_fn(|i, _| if self.seen[i] { self.y[i] - expected[i] } else { 0.0 })
    }

    /// Returns `eᵀ cov⁻¹ e` over what is seen.
    ///
    /// # Errors
    /// [`StepError::InnovationVariance`] when the covariance of what is seen is not positive definite.
    pub(crate) fn normalised(&self, cov: &Matrix<M, M>, e: &Vector<M>) -> Result<f64, StepError> {
        let (inverse, _) =
            definite_inverse(&self.decoupled(cov)).ok_or(StepError::InnovationVariance { var: cov[(0, 0)] })?;
        Ok(e.dot(&(inverse * e)))
    }

    /// Returns `cov` with what is not seen replaced by the identity, so that it decouples.
    pub(crate) fn decoupled(&self, cov: &Matrix<M, M>) -> Matrix<M, M> {
        Matrix::from_fn(|i, j| match (self.seen[i] && self.seen[j], i == j) {
            (true, _) => cov[(i, j)],
            (false, true) => 1.0,
            (false, false) => 0.0,
        })
    }

    /// Returns `inverse` without the rows and columns of what is not seen.
    pub(crate) fn restricted(&self, inverse: &Matrix<M, M>) -> Matrix<M, M> {
        Matrix::from_fn(|i, j| if self.seen[i] && self.seen[j] { inverse[(i, j)] } else { 0.0 })
    }
}

/// Mean and covariance of the state x, of its newest measurement z, and of the value d that is shown next if nothing comes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joint<const N: usize, const M: usize> {
    /// Mean of x.
    pub x: Vector<N>,
    /// Mean of z. Not used with [`Hold::LastReceived`].
    pub z: Vector<M>,
    /// Mean of d.
    pub d: Vector<M>,
    /// Covariance of x.
    pub xx: Matrix<N, N>,
    /// Covariance of x and z.
    pub xz: Matrix<N, M>,
    /// Covariance of x and d.
    pub xd: Matrix<N, M>,
    /// Covariance of z.
    pub zz: Matrix<M, M>,
    /// Covariance of z and d.
    pub zd: Matrix<M, M>,
    /// Covariance of d.
    pub dd: Matrix<M, M>,
}

impl<const N: usize, const M: usize> Joint<N, M> {
    /// Returns the moments at the start, where z_0 came for certain and was not used: `z = d = z_0`.
    pub fn start(belief: &Belief<N>, sensed: &Sensed<N, M>) -> Self {
        let xz = belief.cov * sensed.h.transpose();
        let zz = symmetrised(&(sensed.h * xz + sensed.r));
        Self { x: belief.mean, z: sensed.expected, d: sensed.expected, xx: belief.cov, xz, xd: xz, zz, zd: zz, dd: zz }
    }

    /// Mean and covariance of the state.
    pub fn belief(&self) -> Belief<N> {
        Belief { mean: self.x, cov: self.xx }
    }

    /// Returns the moments of everything that the next step may show. `leap` is linearised at x, `sensed` at `leap.next`.
    pub fn ahead(&self, leap: &Transition<N>, sensed: &Sensed<N, M>, hold: Hold) -> Ahead<N, M> {
        let Sensed { expected, h, r } = sensed;
        let xx = propagate(&self.xx, &leap.f, &leap.q);
        let xn = xx * h.transpose();
        let nn = symmetrised(&(h * xn + r));
        let xd = leap.f * self.xd;
        let (xz, z, zz, zd) = match hold {
            Hold::Paper => (leap.f * self.xz, self.z, self.zz, self.zd),
            Hold::LastReceived => (xd, self.d, self.dd, self.dd),
        };
        Ahead {
            x: leap.next,
            n: *expected,
            z,
            d: self.d,
            xx,
            xn,
            xz,
            xd,
            nn,
            nz: h * xz,
            nd: h * xd,
            zz,
            zd,
            dd: self.dd,
        }
    }

    /// Returns the moments given a value with innovation `e` of which `cross` is the covariance with x, z and d, and `gain` their gains.
    pub(crate) fn given(&self, cross: &Cross<N, M>, gain: &Cross<N, M>, e: &Vector<M>) -> Self {
        let Cross { x: kx, z: kz, d: kd } = gain;
        Self {
            x: self.x + kx * e,
            z: self.z + kz * e,
            d: self.d + kd * e,
            xx: symmetrised(&(self.xx - kx * cross.x.transpose())),
            xz: self.xz - kx * cross.z.transpose(),
            xd: self.xd - kx * cross.d.transpose(),
            zz: symmetrised(&(self.zz - kz * cross.z.transpose())),
            zd: self.zd - kz * cross.d.transpose(),
            dd: symmetrised(&(self.dd - kd * cross.d.transpose())),
        }
    }
}

/// What belongs to x, to z and to d: the covariance of a value with them, or their gains.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cross<const N: usize, const M: usize> {
    /// Rows of x.
    pub x: Matrix<N, M>,
    /// Rows of z.
    pub z: Matrix<M, M>,
    /// Rows of d.
    pub d: Matrix<M, M>,
}

impl<const N: usize, const M: usize> Cross<N, M> {
    /// Returns the gains that belong to a covariance.
    pub(crate) fn gain(&self, inverse: &Matrix<M, M>) -> Self {
        Self { x: self.x * inverse, z: self.z * inverse, d: self.d * inverse }
    }
}

/// Moments one step ahead, before anything is shown: of the state x, its measurement n, the measurement before z and the held value d.
/// With [`Hold::LastReceived`] z is d.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ahead<const N: usize, const M: usize> {
    pub(crate) x: Vector<N>,
    pub(crate) n: Vector<M>,
    pub(crate) z: Vector<M>,
    pub(crate) d: Vector<M>,
    pub(crate) xx: Matrix<N, N>,
    pub(crate) xn: Matrix<N, M>,
    pub(crate) xz: Matrix<N, M>,
    pub(crate) xd: Matrix<N, M>,
    pub(crate) nn: Matrix<M, M>,
    pub(crate) nz: Matrix<M, M>,
    pub(crate) nd: Matrix<M, M>,
    pub(crate) zz: Matrix<M, M>,
    pub(crate) zd: Matrix<M, M>,
    pub(crate) dd: Matrix<M, M>,
}

impl<const N: usize, const M: usize> Ahead<N, M> {
    /// Returns the joint moments if something came, with z and d in terms of what is shown, and the covariance of n with them.
    ///
    /// A component that is seen is known then: its moments are not left to a subtraction.
    pub(crate) fn fresh(&self, shown: &Shown<M>) -> (Joint<N, M>, Cross<N, M>) {
        let Self { x, n, xx, xn, nn, .. } = *self;
        let rest = Matrix::identity() - shown.mask();
        let (z, xz, zn) = (n + shown.innovation(&n), xn * rest, rest * nn);
        let zz = zn * rest;
        let joint = Joint { x, z, d: z, xx, xz, xd: xz, zz, zd: zz, dd: zz };
        (joint, Cross { x: xn, z: zn, d: zn })
    }

    /// Returns the joint moments if nothing came, with d⁺ = z as what is shown and z − d, and the covariance of d with them.
    pub(crate) fn held(&self, shown: &Shown<M>) -> (Joint<N, M>, Cross<N, M>) {
        let Self { x, n, z, d, xx, xn, xz, xd, nn, nz, nd, zz, zd, dd } = *self;
        let mask = shown.mask();
        let off = zd - mask * dd;
        let joint = Joint {
            x,
            z: n,
            d: z + shown.innovation(&d),
            xx,
            xz: xn,
            xd: xz - xd * mask,
            zz: nn,
            zd: nz - nd * mask,
            dd: symmetrised(&(zz - mask * zd.transpose() - off * mask)),
        };
        (joint, Cross { x: xd, z: nd, d: off })
    }
}
