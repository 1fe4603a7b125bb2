//! Exact diffuse filtering: a Kalman filter whose first state is unknown altogether.
//!
//! The state is `x = a + X s + error`, where `s` is the unknown first state and the error has covariance `P` given `s`
//! (de Jong's augmented filter, exact where a "large" prior covariance is only approximate):
//!
//! ```text
//! start   a = 0, X = I, P = 0
//! row     f = hᵀPh + r,  e = z − hᵀa,  E = Xᵀh,  k = Ph/f
//!         (E/√f)ᵀ s = e/√f  joins the least squares for s
//!         a += k e,  X −= k Eᵀ,  P = (I − k hᵀ) P (I − k hᵀ)ᵀ + k r kᵀ
//! leap    a = F a + b,  X = F X,  P = F P Fᵀ + Q
//! result  x̂ = a + X ŝ,  cov = P + X S⁻¹ Xᵀ
//! ```
//!
//! A copy of (a, X) taken at an earlier instant and updated along (a fixed-point smoother) gives the lagged estimate and the joint
//! covariance. No transition matrix is inverted, so singular F and singular Q need nothing special.

use crate::estimators::kalman::{joseph, propagate};
use crate::linalg::{LeastSquares, RANK_TOLERANCE, ScaledSvd, symmetrised};
use crate::types::{Belief, Matrix, Row, StepError, Vector};

/// Filter from an unknown first state, with an optional lagged copy.
#[derive(Clone, Copy, Debug)]
pub struct Diffuse<const N: usize> {
    /// Mean for `s = 0`.
    pub a: Vector<N>,
    /// How the mean depends on `s`.
    pub x: Matrix<N, N>,
    /// Error covariance given `s`.
    pub p: Matrix<N, N>,
    /// What the innovations say of `s`.
    pub info: LeastSquares<N>,
    /// Rows `h Φ`: the observability matrix of `s`, without noise.
    seen: LeastSquares<N>,
    /// Product of the transitions so far.
    phi: Matrix<N, N>,
    /// Whether `seen` and `phi` are kept up.
    watching: bool,
    lag: Option<Lag<N>>,
}

/// The state at an earlier instant, carried along.
#[derive(Clone, Copy, Debug)]
struct Lag<const N: usize> {
    a: Vector<N>,
    x: Matrix<N, N>,
    p: Matrix<N, N>,
    /// cov(lagged, current) given s.
    cross: Matrix<N, N>,
    phi: Matrix<N, N>,
}

/// Estimates of the newest and of a lagged state from the same data; `None` where the data do not determine them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joint<const N: usize> {
    /// The newest state.
    pub filter: Option<Belief<N>>,
    /// The lagged state.
    pub lagged: Option<Belief<N>>,
    /// cov(newest, lagged); meaningful when both are there.
    pub cross: Matrix<N, N>,
}

/// One row as the filter took it.
#[derive(Clone, Copy, Debug)]
pub struct Taken<const N: usize> {
    /// Gradient of the row.
    pub h: Vector<N>,
    /// Gain of the newest state.
    pub gain: Vector<N>,
    /// Gain of the lagged state; zero before the copy is taken.
    pub gain_lag: Vector<N>,
    /// Innovation for `s = 0`.
    pub e: f64,
    /// How the innovation depends on `s`: `e(s) = e − eₓᵀ s`.
    pub e_x: Vector<N>,
    /// Innovation variance given `s`.
    pub f: f64,
}

impl<const N: usize> Joint<N> {
    /// Nothing is determined.
    pub fn none() -> Self {
        Self { filter: None, lagged: None, cross: Matrix::zeros() }
    }

    /// The newest state alone, as the lagged one too.
    pub(crate) fn newest(belief: Belief<N>) -> Self {
        Self { filter: Some(belief), lagged: Some(belief), cross: belief.cov }
    }

    /// Whether what is there is numbers.
    pub(crate) fn is_finite(&self) -> bool {
        let sound = |b: &Belief<N>| crate::estimators::kalman::finite(&b.mean, &b.cov).is_ok();
        self.filter.as_ref().is_none_or(sound) && self.lagged.as_ref().is_none_or(sound)
    }
}

impl<const N: usize> Taken<N> {
    /// A placeholder for storage.
    pub fn zero() -> Self {
        Self {
            h: Vector::zeros(),
            gain: Vector::zeros(),
            gain_lag: Vector::zeros(),
            e: 0.0,
            e_x: Vector::zeros(),
            f: 1.0,
        }
    }
}

impl<const N: usize> Default for Diffuse<N> {
    fn default() -> Self {
        Self::start()
    }
}

impl<const N: usize> Diffuse<N> {
    /// Nothing is known of the first state.
    pub fn start() -> Self {
        Self {
            a: Vector::zeros(),
            x: Matrix::identity(),
            p: Matrix::zeros(),
            info: LeastSquares::new(),
            seen: LeastSquares::new(),
            phi: Matrix::identity(),
            watching: true,
            lag: None,
        }
    }

    /// Keeps the present state as the lagged one.
    pub fn mark_lag(&mut self) {
        self.lag = Some(Lag { a: self.a, x: self.x, p: self.p, cross: self.p, phi: self.phi });
    }

    /// Takes one row; `row.residual` is the data less the expectation at the point that `a` is relative to.
    ///
    /// # Errors
    /// [`StepError::InnovationVariance`] when `hᵀPh + r` is not a positive number; nothing has changed then.
    pub fn update(&mut self, row: &Row<N>) -> Result<Taken<N>, StepError> {
        let ph = self.p * row.h;
        let f = row.h.dot(&ph) + row.var;
        if !(f > 0.0 && f.is_finite()) {
            return Err(StepError::InnovationVariance { var: f });
        }
        let e = row.residual - row.h.dot(&self.a);
        let e_x = self.x.tr_mul(&row.h);
        let gain = ph / f;
        let weight = 1.0 / libm::sqrt(f);
        self.info.add(&(e_x * weight), e * weight);
        if self.watching {
            self.seen.add(&(self.phi.tr_mul(&row.h) / libm::sqrt(row.var)), 0.0);
        }
        self.a += gain * e;
        self.x -= gain * e_x.transpose();
        self.p = joseph(&self.p, &row.h, row.var, &ph, f);
        let mut gain_lag = Vector::zeros();
        if let Some(lag) = &mut self.lag {
            gain_lag = lag.cross * row.h / f;
            lag.a += gain_lag * e;
            lag.x -= gain_lag * e_x.transpose();
            lag.p -= gain_lag * gain_lag.transpose() * f;
            lag.cross -= gain_lag * ph.transpose();
        }
        Ok(Taken { h: row.h, gain, gain_lag, e, e_x, f })
    }

    /// Moves to the next instant: `x⁺ = F x + offset + noise(q)`.
    pub fn leap(&mut self, f: &Matrix<N, N>, offset: &Vector<N>, q: &Matrix<N, N>) {
        self.a = f * self.a + offset;
        self.x = f * self.x;
        self.p = propagate(&self.p, f, q);
        if self.watching {
            self.phi = f * self.phi;
        }
        if let Some(lag) = &mut self.lag {
            lag.cross *= f.transpose();
        }
    }

    /// Whether the rows so far determine the first state (singular-value ratio of the column-scaled observability matrix).
    pub fn determines_start(&self) -> bool {
        !self.watching || self.seen.scaled_svd().ratio() >= RANK_TOLERANCE
    }

    /// Stops looking at what determines the first state, once the data do or a prior does. A pass that goes on for ever must: the
    /// product of the transitions of an unstable system leaves the range of numbers.
    pub fn stop_watching(&mut self) {
        self.watching = false;
    }

    /// Whether an ordinary covariance can take over without losing digits: what is not known of the first state adds at most 1e6 times
    /// the rest to any variance. First instants that lie close together leave velocities and accelerations so vague that a
    /// recursion in `P` alone would have to subtract numbers of 1e15 and more.
    pub fn may_collapse(&self) -> bool {
        const MOST: f64 = 1e6;
        let y = self.info.right_solve(&self.x);
        (0..N).all(|i| y.row(i).norm_squared() <= MOST * self.p[(i, i)])
    }

    /// Returns the estimates that the data determine.
    pub fn solve(&self) -> Joint<N> {
        let svd = self.seen.scaled_svd();
        if !self.watching || svd.ratio() >= RANK_TOLERANCE {
            let spread = |a: &Vector<N>, x: &Matrix<N, N>| {
                let y = self.info.right_solve(x);
                (a + y * self.info.y, y)
            };
            return self.joint(spread, true, true);
        }
        let partial = self.partial(&svd);
        let filter_ok = partial.determines(&self.phi, &column_sizes(&self.phi));
        let lag_ok = self.lag.as_ref().is_some_and(|l| partial.determines(&l.phi, &column_sizes(&l.phi)));
        let spread = |a: &Vector<N>, x: &Matrix<N, N>| (a + x * partial.mean, x * partial.root);
        self.joint(spread, filter_ok, lag_ok)
    }

    /// What the rows say of the first state when they do not determine it.
    pub(crate) fn partial_start(&self) -> PartialStart<N> {
        self.partial(&self.seen.scaled_svd())
    }

    fn partial(&self, seen: &ScaledSvd<N>) -> PartialStart<N> {
        let limit = RANK_TOLERANCE * seen.sigma.max();
        let mut out =
            PartialStart { mean: Vector::zeros(), root: Matrix::zeros(), blind: Matrix::zeros(), scale: seen.scale };
        let mut rank = 0;
        for j in 0..N {
            if seen.sigma[j] > limit {
                rank += 1;
            } else {
                out.blind.set_column(j, &seen.v.column(j).component_div(&seen.scale));
            }
        }
        let info = self.info.scaled_svd();
        for j in largest_first(&info.sigma).into_iter().take(rank) {
            let column = info.v.column(j).component_div(&info.scale) / info.sigma[j];
            out.mean += column * (info.u_sigma.column(j).dot(&self.info.y) / info.sigma[j]);
            out.root.set_column(j, &column);
        }
        out
    }

    fn joint(
        &self,
        spread: impl Fn(&Vector<N>, &Matrix<N, N>) -> (Vector<N>, Matrix<N, N>),
        filter_ok: bool,
        lag_ok: bool,
    ) -> Joint<N> {
        let belief = |p: &Matrix<N, N>, mean: Vector<N>, y: &Matrix<N, N>| {
            let cov = symmetrised(&(p + y * y.transpose()));
            crate::estimators::kalman::finite(&mean, &cov).ok().map(|()| Belief { mean, cov })
        };
        let mut joint = Joint::none();
        if !filter_ok && !lag_ok {
            return joint;
        }
        let (mean, y) = spread(&self.a, &self.x);
        if filter_ok {
            joint.filter = belief(&self.p, mean, &y);
        }
        if let Some(lag) = self.lag.as_ref().filter(|_| lag_ok) {
            let (mean, y_lag) = spread(&lag.a, &lag.x);
            joint.lagged = belief(&lag.p, mean, &y_lag);
            joint.cross = lag.cross.transpose() + y * y_lag.transpose();
        }
        joint
    }

    /// Largest entry of each column of the product of the transitions so far.
    pub(crate) fn reach(&self) -> Vector<N> {
        column_sizes(&self.phi)
    }

    /// (X of the newest state, X of the lagged state), for gain design.
    pub(crate) fn responses(&self) -> (Matrix<N, N>, Matrix<N, N>) {
        (self.x, self.lag.as_ref().map_or_else(Matrix::zeros, |l| l.x))
    }
}

/// Estimate of a first state that the rows see only in some directions.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PartialStart<const N: usize> {
    /// Its mean, zero in the directions that no row sees.
    pub(crate) mean: Vector<N>,
    /// A square root of its covariance in the directions that are seen.
    pub(crate) root: Matrix<N, N>,
    /// The directions that no row sees, as columns among zeros.
    blind: Matrix<N, N>,
    /// Unit of each component.
    scale: Vector<N>,
}

impl<const N: usize> PartialStart<N> {
    /// Whether a state that depends on the first one by `x` is determined: it does not feel the directions that no row sees. `reach`
    /// holds the largest entry of each column of the product of the transitions.
    pub(crate) fn determines(&self, x: &Matrix<N, N>, reach: &Vector<N>) -> bool {
        (x * self.blind).amax() <= RANK_TOLERANCE * reach.component_div(&self.scale).amax()
    }
}

fn column_sizes<const N: usize>(m: &Matrix<N, N>) -> Vector<N> {
    Vector::from_fn(|j, _| m.column(j).amax())
}

fn largest_first<const N: usize>(values: &Vector<N>) -> [usize; N] {
    let mut order = core::array::from_fn(|i| i);
    order.sort_unstable_by(|i: &usize, j: &usize| values[*j].total_cmp(&values[*i]));
    order
}
