//! Smoothing by a backward square-root information filter: neither P nor Q is inverted, nothing is subtracted from a covariance.
//!
//! A forward pass keeps, per instant, the prediction (a, X, P); backwards, the data from that instant on are held as rows
//! `U x = y + noise of unit variance`:
//!
//! ```text
//! row     (h/√r)ᵀ x = z/√r joins U x = y                        (Givens rotations)
//! here    P = L Lᵀ,  T = L (I + LᵀUᵀU L)⁻¹ Lᵀ,  B = X − T Uᵀ U X
//!         x̂ = m + T Uᵀ(y − U m),  m = a + X ŝ,  cov = T + B S⁻¹ Bᵀ
//! leap    x⁺ = F x + b + w:  G Gᵀ = I + U Q Uᵀ,  rows G⁻¹ U F x = G⁻¹(y − U b), made triangular
//! ```
//!
//! `s` is the unknown first state of a [`Diffuse`] pass, solved for from all data; with a prior, X = 0 and its terms vanish.
//! `P − P N P` of the adjoint (Bryson–Frazier) form would lose all digits where the prediction is much vaguer than the smoothed state.

use crate::estimators::diffuse::{Diffuse, PartialStart};
use crate::estimators::kalman::finite;
use crate::linalg::{LeastSquares, semidefinite_factor, symmetrised};
use crate::types::{Belief, Matrix, Row, Vector};

/// How a deviation came to an instant: `δ⁺ = f δ + offset + noise(q)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Arrive<const N: usize> {
    /// Jacobian.
    pub f: Matrix<N, N>,
    /// What the deviation becomes when it was 0.
    pub offset: Vector<N>,
    /// Process noise.
    pub q: Matrix<N, N>,
}

impl<const N: usize> Arrive<N> {
    /// Standing still, without noise.
    pub fn still() -> Self {
        Self { f: Matrix::identity(), offset: Vector::zeros(), q: Matrix::zeros() }
    }
}

/// What a forward pass keeps of one instant.
#[derive(Clone, Copy, Debug)]
pub struct Instant<const N: usize> {
    /// How the state came here; not used on the first.
    pub arrive: Arrive<N>,
    /// Predicted mean for `s = 0`, relative to the point of linearisation.
    pub a: Vector<N>,
    /// Dependence of the prediction on `s`.
    pub x: Matrix<N, N>,
    /// Prediction covariance given `s`.
    pub p: Matrix<N, N>,
    /// Largest entry of each column of the product of the transitions up to here: the scale of what `x` forgets.
    pub reach: Vector<N>,
    /// How many rows it took.
    pub rows: usize,
}

impl<const N: usize> Instant<N> {
    /// What is to be kept of the instant that a pass has just come to.
    pub fn of(pass: &Diffuse<N>, arrive: Option<&Arrive<N>>) -> Self {
        let arrive = arrive.copied().unwrap_or_else(Arrive::still);
        Self { arrive, a: pass.a, x: pass.x, p: pass.p, reach: pass.reach(), rows: 0 }
    }

    /// A placeholder for storage.
    pub fn zero() -> Self {
        Self {
            arrive: Arrive::still(),
            a: Vector::zeros(),
            x: Matrix::zeros(),
            p: Matrix::zeros(),
            reach: Vector::zeros(),
            rows: 0,
        }
    }
}

/// Forward pass whose first state is known by a prior, or not at all.
#[derive(Clone, Copy, Debug)]
pub struct Forward<const N: usize> {
    pass: Diffuse<N>,
    diffuse: bool,
    failed: bool,
}

impl<const N: usize> Forward<N> {
    /// Starts from a prior (relative to the point of linearisation) or, without one, from an unknown state.
    pub fn start(prior: Option<&Belief<N>>) -> Self {
        let mut pass = Diffuse::start();
        if let Some(prior) = prior {
            pass.a = prior.mean;
            pass.p = prior.cov;
            pass.x = Matrix::zeros();
            pass.stop_watching();
        }
        Self { pass, diffuse: prior.is_none(), failed: false }
    }

    /// Moves to the next instant and returns what is to be kept of it; without `arrive` it is the first.
    pub fn leap(&mut self, arrive: Option<&Arrive<N>>) -> Instant<N> {
        if let Some(arrive) = arrive {
            if self.pass.determines_start() {
                self.pass.stop_watching();
            }
            self.pass.leap(&arrive.f, &arrive.offset, &arrive.q);
        }
        Instant::of(&self.pass, arrive)
    }

    /// Takes one row of the present instant. Once a covariance leaves the range of numbers, nothing is determined any more.
    pub fn update(&mut self, row: &Row<N>) {
        self.failed |= self.pass.update(row).is_err();
    }

    /// The unknown first state, solved for as far as the data see it.
    pub fn start_state(&self) -> StartState<N> {
        let mean = Vector::zeros();
        if self.failed {
            return StartState { mean, spread: Spread::Failed };
        }
        if !self.diffuse {
            return StartState { mean, spread: Spread::None };
        }
        StartState::after(&self.pass)
    }

    /// As [`Forward::start_state`], with a weak prior of mean 0 and the given standard deviations on the first state.
    pub fn damped_start(&self, spread: &Vector<N>) -> StartState<N> {
        let mut info = self.pass.info;
        for i in 0..N {
            let mut h = Vector::zeros();
            h[i] = 1.0 / spread[i];
            info.add(&h, 0.0);
        }
        StartState::of(info)
    }
}

/// Estimate of the unknown first state.
#[derive(Clone, Copy, Debug)]
pub struct StartState<const N: usize> {
    mean: Vector<N>,
    spread: Spread<N>,
}

/// Its uncertainty.
#[derive(Clone, Copy, Debug)]
enum Spread<const N: usize> {
    /// The start was known by a prior.
    None,
    /// The data determine it.
    Full(LeastSquares<N>),
    /// The data determine it in some directions.
    Partial(PartialStart<N>),
    /// The forward pass left the range of numbers.
    Failed,
}

impl<const N: usize> StartState<N> {
    /// The unknown first state of a pass, solved for as far as the data see it.
    pub fn after(pass: &Diffuse<N>) -> Self {
        if pass.determines_start() {
            return Self::of(pass.info);
        }
        let partial = pass.partial_start();
        Self { mean: partial.mean, spread: Spread::Partial(partial) }
    }

    fn of(info: LeastSquares<N>) -> Self {
        Self { mean: info.right_solve(&Matrix::identity()) * info.y, spread: Spread::Full(info) }
    }

    /// Whether the data determine the whole of it.
    pub fn is_determined(&self) -> bool {
        !matches!(self.spread, Spread::Partial(_) | Spread::Failed)
    }
}

/// The data from an instant on, on their way back.
#[derive(Clone, Copy, Debug)]
pub struct Backward<'a, const N: usize> {
    start: &'a StartState<N>,
    later: LeastSquares<N>,
}

impl<'a, const N: usize> Backward<'a, N> {
    /// Starts after the newest instant.
    pub fn new(start: &'a StartState<N>) -> Self {
        Self { start, later: LeastSquares::new() }
    }

    /// Takes in one row of the present instant.
    pub fn row(&mut self, row: &Row<N>) {
        let weight = 1.0 / libm::sqrt(row.var);
        self.later.add(&(row.h * weight), row.residual * weight);
    }

    /// Returns the smoothed belief at an instant once its rows are in, relative to the point of linearisation; `None` when the data do
    /// not determine it.
    pub fn smoothed(&self, at: &Instant<N>) -> Option<Belief<N>> {
        match &self.start.spread {
            Spread::Failed => return None,
            Spread::Partial(partial) if !partial.determines(&at.x, &at.reach) => return None,
            _ => {}
        }
        let (u, y) = (&self.later.r, &self.later.y);
        let l = semidefinite_factor(&at.p);
        let ul = u * l;
        let root = identity_plus(&ul).right_solve(&l);
        let m = at.a + at.x * self.start.mean;
        let pull = |v: &Vector<N>| root * root.tr_mul(&u.tr_mul(v));
        let mean = m + pull(&(y - u * m));
        let mut cov = root * root.transpose();
        let response = at.x - root * root.tr_mul(&u.tr_mul(&(u * at.x)));
        let spread = match &self.start.spread {
            Spread::None | Spread::Failed => Matrix::zeros(),
            Spread::Full(info) => info.right_solve(&response),
            Spread::Partial(partial) => response * partial.root,
        };
        cov += spread * spread.transpose();
        let cov = symmetrised(&cov);
        finite(&mean, &cov).ok().map(|()| Belief { mean, cov })
    }

    /// Goes back over the transition that led to the instant just left.
    pub fn leap(&mut self, arrive: &Arrive<N>) {
        let u = &self.later.r;
        let g = identity_plus(&(u * semidefinite_factor(&arrive.q)).transpose());
        let mut rows = u * arrive.f;
        let mut y = self.later.y - u * arrive.offset;
        let mut before = LeastSquares::new();
        for i in 0..N {
            for k in 0..i {
                let l = g.r[(k, i)];
                for j in 0..N {
                    let t = rows[(k, j)];
                    rows[(i, j)] -= l * t;
                }
                let t = y[k];
                y[i] -= l * t;
            }
            let d = 1.0 / g.r[(i, i)];
            for j in 0..N {
                rows[(i, j)] *= d;
            }
            y[i] *= d;
            before.add(&rows.row(i).transpose(), y[i]);
        }
        self.later = before;
    }
}

/// Returns the triangular factor of `I + MᵀM` without forming it: beside a large M the identity would drown in rounding.
fn identity_plus<const N: usize>(m: &Matrix<N, N>) -> LeastSquares<N> {
    let mut factor = LeastSquares { r: Matrix::identity(), y: Vector::zeros() };
    for i in 0..N {
        factor.add(&m.row(i).transpose(), 0.0);
    }
    factor
}

/// Smooths a whole forward pass: hands each instant's index and belief to `visit`, newest first; `None` where the data do not
/// determine it.
///
/// `rows` holds the rows of all instants one after the other.
pub fn smooth<const N: usize>(
    start: &StartState<N>,
    instants: &[Instant<N>],
    rows: &[Row<N>],
    mut visit: impl FnMut(usize, Option<Belief<N>>),
) {
    let mut backward = Backward::new(start);
    let mut end = rows.len();
    for (i, at) in instants.iter().enumerate().rev() {
        for row in &rows[end - at.rows..end] {
            backward.row(row);
        }
        end -= at.rows;
        visit(i, backward.smoothed(at));
        backward.leap(&at.arrive);
    }
}
