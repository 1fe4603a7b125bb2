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

use crate::estimators::diffuse::Diffuse;
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
    /// How many rows it took.
    pub rows: usize,
}

impl<const N: usize> Instant<N> {
    /// A placeholder for storage.
    pub fn zero() -> Self {
        Self { arrive: Arrive::still(), a: Vector::zeros(), x: Matrix::zeros(), p: Matrix::zeros(), rows: 0 }
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
        }
        Self { pass, diffuse: prior.is_none(), failed: false }
    }

    /// Moves to the next instant and returns what is to be kept of it; without `arrive` it is the first.
    pub fn leap(&mut self, arrive: Option<&Arrive<N>>) -> Instant<N> {
        if let Some(arrive) = arrive {
            self.pass.leap(&arrive.f, &arrive.offset, &arrive.q);
        }
        let arrive = arrive.copied().unwrap_or_else(Arrive::still);
        Instant { arrive, a: self.pass.a, x: self.pass.x, p: self.pass.p, rows: 0 }
    }

    /// Takes one row of the present instant. Once a covariance leaves the range of numbers, nothing is determined any more.
    pub fn update(&mut self, row: &Row<N>) {
        self.failed |= self.pass.update(row).is_err();
    }

    /// The unknown first state, solved for; `None` while the data do not determine it.
    pub fn start_state(&self) -> Option<StartState<N>> {
        if self.failed {
            return None;
        }
        if !self.diffuse {
            return Some(StartState { mean: Vector::zeros(), info: None });
        }
        self.pass.determines_start().then(|| StartState::of(self.pass.info))
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
    /// Its information; `None` when the start was known by a prior.
    info: Option<LeastSquares<N>>,
}

impl<const N: usize> StartState<N> {
    fn of(info: LeastSquares<N>) -> Self {
        Self { mean: info.right_solve(&Matrix::identity()) * info.y, info: Some(info) }
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

    /// Returns the smoothed belief at an instant once its rows are in, relative to the point of linearisation.
    pub fn smoothed(&self, at: &Instant<N>) -> Belief<N> {
        let (u, y) = (&self.later.r, &self.later.y);
        let l = semidefinite_factor(&at.p);
        let ul = u * l;
        let g = semidefinite_factor(&symmetrised(&(Matrix::identity() + ul.tr_mul(&ul))));
        let root = solve_right_transposed(&g, &l);
        let m = at.a + at.x * self.start.mean;
        let pull = |v: &Vector<N>| root * root.tr_mul(&u.tr_mul(v));
        let mean = m + pull(&(y - u * m));
        let mut cov = root * root.transpose();
        if let Some(info) = &self.start.info {
            let response = at.x - root * root.tr_mul(&u.tr_mul(&(u * at.x)));
            let spread = info.right_solve(&response);
            cov += spread * spread.transpose();
        }
        Belief { mean, cov: symmetrised(&cov) }
    }

    /// Goes back over the transition that led to the instant just left.
    pub fn leap(&mut self, arrive: &Arrive<N>) {
        let u = &self.later.r;
        let g = semidefinite_factor(&symmetrised(&(Matrix::identity() + u * arrive.q * u.transpose())));
        let mut rows = u * arrive.f;
        let mut y = self.later.y - u * arrive.offset;
        let mut before = LeastSquares::new();
        for i in 0..N {
            for k in 0..i {
                let l = g[(i, k)];
                for j in 0..N {
                    let t = rows[(k, j)];
                    rows[(i, j)] -= l * t;
                }
                let t = y[k];
                y[i] -= l * t;
            }
            let d = 1.0 / g[(i, i)];
            for j in 0..N {
                rows[(i, j)] *= d;
            }
            y[i] *= d;
            before.add(&rows.row(i).transpose(), y[i]);
        }
        self.later = before;
    }
}

/// Returns `M G⁻ᵀ` for a lower triangular G.
fn solve_right_transposed<const N: usize>(g: &Matrix<N, N>, m: &Matrix<N, N>) -> Matrix<N, N> {
    let mut x = *m;
    for j in 0..N {
        for k in 0..j {
            let l = g[(j, k)];
            for i in 0..N {
                let t = x[(i, k)];
                x[(i, j)] -= t * l;
            }
        }
        let d = 1.0 / g[(j, j)];
        for i in 0..N {
            x[(i, j)] *= d;
        }
    }
    x
}

/// Smooths a whole forward pass: hands each instant's index and belief to `visit`, newest first.
///
/// `rows` holds the rows of all instants one after the other.
pub fn smooth<const N: usize>(
    start: &StartState<N>,
    instants: &[Instant<N>],
    rows: &[Row<N>],
    mut visit: impl FnMut(usize, Belief<N>),
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
