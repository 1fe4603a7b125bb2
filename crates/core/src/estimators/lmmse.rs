//! Exact linear minimum mean square error estimate from what a receiver without time stamps shows, by augmentation: the state is
//! estimated together with the values that may be shown later.
//!
//! ```text
//! e = y − (p n̂ + q d̂)                      q = 1 − p, n = z_{k+1}, d what is held
//! cov e = p cov n + q cov d + p q E[(n−d)(n−d)ᵀ] − p q cov(n − d)
//! ```
//!
//! The mixture's spread E\[(n−d)(n−d)ᵀ\] is an unconditional second moment: a linear estimate does not learn from y which of the two it
//! was. It is propagated as the moments of x and of `ε = d − C x`, of which the differences are formed without cancellation:
//!
//! ```text
//! c = C⁺x⁺ − C x = Δx + C⁺(b + w),   Δ = C⁺F − C
//! n − d = c + v⁺ − ε,   n − z = c + v⁺ − v
//! ε⁺ = γ v⁺ − (1 − γ)(c − v)  (Hold::Paper),   γ v⁺ − (1 − γ)(c − ε)  (Hold::LastReceived)
//! ```
//!
//! For models that are not linear [`Spread::Conditional`] takes the moments given the past in place of the unconditional ones.

use crate::estimators::augmented::{Ahead, Cross, Hold, Joint, Sensed, Shown};
use crate::estimators::kalman::{Evidence, finite};
use crate::linalg::{pseudo_inverse, symmetrised};
use crate::types::{Belief, Matrix, StepError, Transition, Vector};

/// Where the spread of the mixture comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Spread {
    /// Unconditional moments: exact for a linear model.
    Unconditional,
    /// Moments given the past, about the linearisation: for models that are not linear.
    Conditional,
}

/// Eigenvalues of an innovation covariance up to this share of the largest noise variance seen are rounding errors of zero.
const NOTHING: f64 = 1e-12;

/// Second moments of differences of what may be shown, per pair.
struct Differences<const M: usize> {
    /// E\[(n−d)(n−d)ᵀ\]
    nd_nd: Matrix<M, M>,
    /// E\[(n−z)(n−z)ᵀ\]
    nz_nz: Matrix<M, M>,
    /// E\[(n−z)(n−d)ᵀ\]
    nz_nd: Matrix<M, M>,
}

/// Unconditional moments of x and ε.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Unconditional<const N: usize, const M: usize> {
    x: Vector<N>,
    eps: Vector<M>,
    xx: Matrix<N, N>,
    x_eps: Matrix<N, M>,
    eps_eps: Matrix<M, M>,
    /// E\[v εᵀ\] = p R.
    v_eps: Matrix<M, M>,
}

/// What [`Lmmse::step`] found, for tests against vectors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Predicted<const N: usize, const M: usize> {
    /// Expected value of y.
    pub y: Vector<M>,
    /// Covariance of the innovation.
    pub cov: Matrix<M, M>,
    /// Gains.
    pub gain: Cross<N, M>,
    /// The innovation normalised.
    pub evidence: Evidence,
}

/// The filter; [`Joint`] is its augmented estimate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lmmse<const N: usize, const M: usize> {
    hold: Hold,
    joint: Joint<N, M>,
    past: Option<Unconditional<N, M>>,
    last: Sensed<N, M>,
}

impl<const N: usize, const M: usize> Lmmse<N, M> {
    /// Returns the filter at the start: `belief` is x̂_{0|0}, z_0 came for certain (γ_0 = p_0 = 1) and is not used any more. `sensed` is
    /// linearised at `belief.mean`.
    pub fn start(belief: &Belief<N>, sensed: &Sensed<N, M>, hold: Hold, spread: Spread) -> Self {
        let past = Unconditional {
            x: belief.mean,
            eps: Vector::zeros(),
            xx: belief.cov + belief.mean * belief.mean.transpose(),
            x_eps: Matrix::zeros(),
            eps_eps: sensed.r,
            v_eps: sensed.r,
        };
        let past = (spread == Spread::Unconditional).then_some(past);
        Self { hold, joint: Joint::start(belief, sensed), past, last: *sensed }
    }

    /// The augmented estimate.
    pub fn joint(&self) -> &Joint<N, M> {
        &self.joint
    }

    /// Takes one step: motion, and what is shown after it. `leap` is linearised at the mean, `sensed` at `leap.next`; `arrival` is p_{k+1}.
    ///
    /// # Errors
    /// [`StepError::SecondMoment`] when the unconditional moments are not finite while 0 < p < 1; [`StepError::NotFinite`]. Nothing has
    /// changed then.
    pub fn step(
        &mut self,
        leap: &Transition<N>,
        sensed: &Sensed<N, M>,
        shown: &Shown<M>,
        arrival: f64,
    ) -> Result<Predicted<N, M>, StepError> {
        let (p, q) = (arrival, 1.0 - arrival);
        let ahead = self.joint.ahead(leap, sensed, self.hold);
        let change = self.past.as_ref().map(|past| Change::of(past, leap, &self.joint.x, sensed, &self.last));
        let spread = match (&self.past, &change) {
            _ if p * q == 0.0 => None,
            (Some(past), Some(change)) => Some(change.differences(past, &sensed.r, &self.last.r, self.hold)?),
            _ => Some(Differences::conditional(&ahead)),
        };
        let (prior, cross, y, cov) = ahead.mixed(p, spread.as_ref());
        let noise = (0..M).filter(|i| shown.seen[*i]).fold(0.0_f64, |m, i| m.max(sensed.r[(i, i)]));
        let (inverse, rank) = pseudo_inverse(&shown.restricted(&cov), NOTHING * noise);
        let e = shown.innovation(&y);
        let gain = cross.gain(&inverse);
        let joint = prior.given(&cross, &gain, &e);
        finite(&joint.x, &joint.xx)?;
        if let (Some(past), Some(change)) = (&mut self.past, &change) {
            *past = change.next(past, leap, &sensed.r, &self.last.r, p, self.hold);
        }
        self.joint = joint;
        self.last = *sensed;
        let evidence = Evidence { nis: e.dot(&(inverse * e)), dof: rank as u32, rejected: 0, misfits: 0 };
        Ok(Predicted { y, cov, gain, evidence })
    }
}

impl<const N: usize, const M: usize> Ahead<N, M> {
    /// Returns the joint moments of the next step before y is used, the covariance of y with them, its mean and its covariance.
    fn mixed(&self, p: f64, spread: Option<&Differences<M>>) -> (Joint<N, M>, Cross<N, M>, Vector<M>, Matrix<M, M>) {
        let q = 1.0 - p;
        let Self { x, n, z, d, xx, xn, xz, xd, nn, nz, nd, zz, zd, dd } = self;
        let zero = Differences { nd_nd: Matrix::zeros(), nz_nz: Matrix::zeros(), nz_nd: Matrix::zeros() };
        let s = spread.unwrap_or(&zero);
        let pq = p * q;
        let y = n * p + d * q;
        let cov = nn * (p * p) + dd * (q * q) + (nd + nd.transpose() + s.nd_nd) * pq;
        let cross = Cross {
            x: xn * p + xd * q,
            z: nn * p + nd * q,
            d: nn * (p * p) + zd * (q * q) + (nd + nz.transpose() + s.nz_nd) * pq,
        };
        let prior = Joint {
            x: *x,
            z: *n,
            d: n * p + z * q,
            xx: *xx,
            xz: *xn,
            xd: xn * p + xz * q,
            zz: *nn,
            zd: nn * p + nz * q,
            dd: symmetrised(&(nn * (p * p) + zz * (q * q) + (nz + nz.transpose() + s.nz_nz) * pq)),
        };
        (prior, cross, y, symmetrised(&cov))
    }
}

impl<const M: usize> Differences<M> {
    /// Moments given the past: covariance plus the square of the mean.
    fn conditional<const N: usize>(a: &Ahead<N, M>) -> Self {
        let (nd, nz) = (a.n - a.d, a.n - a.z);
        Self {
            nd_nd: a.nn + a.dd - a.nd - a.nd.transpose() + nd * nd.transpose(),
            nz_nz: a.nn + a.zz - a.nz - a.nz.transpose() + nz * nz.transpose(),
            nz_nd: a.nn - a.nd - a.nz.transpose() + a.zd + nz * nd.transpose(),
        }
    }
}

/// Unconditional moments of `c = C⁺x⁺ − C x`.
struct Change<const N: usize, const M: usize> {
    /// Known input, `b`.
    drive: Vector<N>,
    mean: Vector<M>,
    cc: Matrix<M, M>,
    /// E\[x⁺cᵀ\]
    xc: Matrix<N, M>,
    /// E\[c εᵀ\]
    c_eps: Matrix<M, M>,
}

impl<const N: usize, const M: usize> Change<N, M> {
    fn of(
        past: &Unconditional<N, M>,
        leap: &Transition<N>,
        at: &Vector<N>,
        sensed: &Sensed<N, M>,
        last: &Sensed<N, M>,
    ) -> Self {
        let h = &sensed.h;
        let drive = leap.next - leap.f * at;
        let delta = h * leap.f - last.h;
        let (hb, dx) = (h * drive, delta * past.x);
        let hq = h * leap.q;
        let cc = delta * past.xx * delta.transpose()
            + hq * h.transpose()
            + dx * hb.transpose()
            + hb * dx.transpose()
            + hb * hb.transpose();
        let fx = leap.f * past.x;
        let xc =
            leap.f * past.xx * delta.transpose() + fx * hb.transpose() + drive * (dx + hb).transpose() + hq.transpose();
        let c_eps = delta * past.x_eps + hb * past.eps.transpose();
        Self { drive, mean: dx + hb, cc, xc, c_eps }
    }

    fn differences(
        &self,
        past: &Unconditional<N, M>,
        r_next: &Matrix<M, M>,
        r: &Matrix<M, M>,
        hold: Hold,
    ) -> Result<Differences<M>, StepError> {
        let fresh = self.cc + r_next;
        let nd_nd = fresh + past.eps_eps - self.c_eps - self.c_eps.transpose();
        let (nz_nz, nz_nd) = match hold {
            Hold::Paper => (fresh + r, fresh - self.c_eps + past.v_eps),
            Hold::LastReceived => (nd_nd, nd_nd),
        };
        let finite = nd_nd.iter().chain(&nz_nz).all(|v| v.is_finite());
        if finite { Ok(Differences { nd_nd, nz_nz, nz_nd }) } else { Err(StepError::SecondMoment) }
    }

    fn next(
        &self,
        past: &Unconditional<N, M>,
        leap: &Transition<N>,
        r_next: &Matrix<M, M>,
        r: &Matrix<M, M>,
        p: f64,
        hold: Hold,
    ) -> Unconditional<N, M> {
        let q = 1.0 - p;
        let fx = leap.f * past.x;
        let b = &self.drive;
        let xx = propagate_moment(&past.xx, leap) + fx * b.transpose() + b * fx.transpose() + b * b.transpose();
        let (eps, x_eps, eps_eps) = match hold {
            Hold::Paper => (-self.mean * q, -self.xc * q, r_next * p + (self.cc + r) * q),
            Hold::LastReceived => (
                (past.eps - self.mean) * q,
                (leap.f * past.x_eps + b * past.eps.transpose() - self.xc) * q,
                r_next * p + (self.cc - self.c_eps - self.c_eps.transpose() + past.eps_eps) * q,
            ),
        };
        Unconditional { x: fx + b, eps, xx: symmetrised(&xx), x_eps, eps_eps: symmetrised(&eps_eps), v_eps: r_next * p }
    }
}

fn propagate_moment<const N: usize>(xx: &Matrix<N, N>, leap: &Transition<N>) -> Matrix<N, N> {
    crate::estimators::kalman::propagate(xx, &leap.f, &leap.q)
}
