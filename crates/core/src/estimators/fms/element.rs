//! Associative elements of Kalman smoothing: what a stretch of instants says of its first and of its last state.
//!
//! An element stands for `p(x_end | x_start, z) = N(F x_start + b, C)` and for the likelihood of the stretch's data given `x_start`,
//! with information vector η and matrix J (Särkkä & García-Fernández 2021, lemma 8). One instant: its rows, then the leap, so
//! `F = F, b = B u, C = Q, η = Hᵀ R⁻¹ z, J = Hᵀ R⁻¹ H`: nothing is inverted.

use crate::estimators::diffuse::Joint;
use crate::estimators::kalman::propagate;
use crate::linalg::{Lu, symmetrised};
use crate::types::{Belief, Matrix, Row, Transition, Vector};

/// Scaled pivot of an information matrix below which a pass over the window decides: six digits would go.
pub const LEAST_PIVOT: f64 = 1e-6;

/// A stretch of instants.
#[derive(Clone, Copy, Debug)]
pub struct Element<const N: usize> {
    f: Matrix<N, N>,
    b: Vector<N>,
    c: Matrix<N, N>,
    told: Information<N>,
}

/// What data say of a state, as information: `exp(ηᵀx − ½ xᵀJx)`.
#[derive(Clone, Copy, Debug)]
pub struct Information<const N: usize> {
    /// `Hᵀ R⁻¹ z`.
    pub eta: Vector<N>,
    /// `Hᵀ R⁻¹ H`.
    pub j: Matrix<N, N>,
}

impl<const N: usize> Information<N> {
    /// Nothing.
    pub fn none() -> Self {
        Self { eta: Vector::zeros(), j: Matrix::zeros() }
    }
}

impl<const N: usize> Element<N> {
    /// The empty stretch.
    pub fn identity() -> Self {
        Self { f: Matrix::identity(), b: Vector::zeros(), c: Matrix::zeros(), told: Information::none() }
    }

    /// One instant: its rows, then the leap to the next, if there is one.
    pub fn instant(rows: &[Row<N>], leap: Option<&Transition<N>>) -> Self {
        let mut e = Self::identity();
        for row in rows {
            let w = row.h / row.var;
            e.told.eta += w * row.residual;
            e.told.j += w * row.h.transpose();
        }
        if let Some(leap) = leap {
            e.f = leap.f;
            e.b = leap.next;
            e.c = leap.q;
        }
        e
    }

    /// The stretch `self` followed by `then`; `None` when `I + C J` is singular to working precision.
    pub fn combine(&self, then: &Self) -> Option<Self> {
        let lu = Lu::new(Matrix::identity() + self.c * then.told.j)?;
        let t = lu.solve_transposed(then.f.transpose()).transpose();
        let u = lu.solve(self.f).transpose();
        Some(Self {
            f: t * self.f,
            b: t * (self.b + self.c * then.told.eta) + then.b,
            c: symmetrised(&(t * self.c * then.f.transpose() + then.c)),
            told: Information {
                eta: u * (then.told.eta - then.told.j * self.b) + self.told.eta,
                j: symmetrised(&(u * then.told.j * self.f + self.told.j)),
            },
        })
    }

    /// Takes a row of the last instant, as [`combine`](Element::combine) with [`instant`](Element::instant) has it: with `e = z − h b`
    /// and `s = h C hᵀ + r`
    ///
    /// ```text
    /// η += Fᵀ h e/s    J += Fᵀ h hᵀ F/s    b += C h e/s    F −= C h hᵀ F/s    C −= C h hᵀ C/s
    /// ```
    ///
    /// Returns `s`, the variance of the innovation given the first state.
    #[inline]
    pub fn row(&mut self, row: &Row<N>) -> f64 {
        let ch = self.c * row.h;
        let g = self.f.tr_mul(&row.h);
        let s = row.h.dot(&ch) + row.var;
        let inverse = 1.0 / s;
        let e = (row.residual - row.h.dot(&self.b)) * inverse;
        self.told.eta += g * e;
        self.b += ch * e;
        let (gain, weight) = (ch * inverse, g * inverse);
        for j in 0..N {
            for i in 0..N {
                self.f[(i, j)] -= gain[i] * g[j];
            }
            // Both halves are the same product.
            for i in 0..=j {
                let (c, w) = (self.c[(i, j)] - gain[i] * ch[j], self.told.j[(i, j)] + weight[i] * g[j]);
                (self.c[(i, j)], self.c[(j, i)]) = (c, c);
                (self.told.j[(i, j)], self.told.j[(j, i)]) = (w, w);
            }
        }
        s
    }

    /// Moves the end to the next instant: `x⁺ = f x + offset + noise(q)`.
    #[inline]
    pub fn leap(&mut self, f: &Matrix<N, N>, offset: &Vector<N>, q: &Matrix<N, N>) {
        self.f = f * self.f;
        self.b = f * self.b + offset;
        self.c = propagate(&self.c, f, q);
    }

    /// Moves the end to the instant before, for an element that runs against time: `x = f⁻¹ (x⁺ − offset − noise(q))`.
    #[inline]
    pub fn leap_back(&mut self, inverse: &Matrix<N, N>, offset: &Vector<N>, q: &Matrix<N, N>) {
        self.f = inverse * self.f;
        self.b = inverse * (self.b - offset);
        self.c = propagate(&(self.c + q), inverse, &Matrix::zeros());
    }

    /// What the data say of the first state.
    #[inline]
    pub fn told(&self) -> &Information<N> {
        &self.told
    }

    /// The estimate of the last state, the first one known by `past` alone. `None` when the information matrix of the first state has
    /// a scaled pivot up to `least`: the logarithm of it is the digits that go.
    ///
    /// With `J + J_past = L D Lᵀ` and `Y = F L⁻ᵀ`: mean `b + Y D⁻¹ L⁻¹ (η + η_past)`, covariance `C + Y D⁻¹ Yᵀ`.
    #[inline]
    pub fn filtered(&self, past: &Information<N>, least: f64) -> Option<Belief<N>> {
        let start = Root::new(&(self.told.j + past.j), least)?;
        let y = start.right(&self.f);
        let weighted = start.weighted(&y);
        let mean = weighted * start.left(self.told.eta + past.eta) + self.b;
        let mut cov = self.c;
        for j in 0..N {
            for i in 0..=j {
                for k in 0..N {
                    cov[(i, j)] += weighted[(i, k)] * y[(j, k)];
                }
                cov[(j, i)] = cov[(i, j)];
            }
        }
        Some(Belief { mean, cov })
    }

    /// Estimates of the last state and of the state between `self` and `then`, the first state unknown. `None` when the information
    /// matrix of the first state has a scaled pivot up to [`LEAST_PIVOT`].
    pub fn joint(&self, then: &Self) -> Option<Joint<N>> {
        let lu = Lu::new(Matrix::identity() + self.c * then.told.j)?;
        let whole = self.combine(then)?;
        let start = Root::new(&whole.told.j, LEAST_PIVOT)?;
        let s = start.left(whole.told.eta);
        let y = start.right(&whole.f);
        let weighted = start.weighted(&y);
        let filter = Belief { mean: weighted * s + whole.b, cov: symmetrised(&(whole.c + weighted * y.transpose())) };
        let between_c = lu.solve(self.c);
        let y_lag = start.right(&lu.solve(self.f));
        let weighted_lag = start.weighted(&y_lag);
        let lagged = Belief {
            mean: weighted_lag * s + lu.solve(self.b + self.c * then.told.eta),
            cov: symmetrised(&(between_c + weighted_lag * y_lag.transpose())),
        };
        let cross = then.f * between_c + weighted * y_lag.transpose();
        Some(Joint { filter: Some(filter), lagged: Some(lagged), cross })
    }
}

/// `J = L D Lᵀ`, L of unit diagonal.
struct Root<const N: usize> {
    l: Matrix<N, N>,
    /// Diagonal of D⁻¹.
    inverse: Vector<N>,
}

impl<const N: usize> Root<N> {
    #[inline]
    fn new(j: &Matrix<N, N>, least: f64) -> Option<Self> {
        let mut l = Matrix::<N, N>::identity();
        let mut inverse = Vector::<N>::zeros();
        for k in 0..N {
            let mut d = j[(k, k)];
            for m in 0..k {
                // Entry (k, m) is still that of L D here.
                let v = l[(k, m)] * inverse[m];
                d -= v * l[(k, m)];
                l[(k, m)] = v;
            }
            // The pivot of the matrix scaled to a diagonal of ones.
            if !(d > least * j[(k, k)] && d.is_finite()) {
                return None;
            }
            inverse[k] = 1.0 / d;
            for i in k + 1..N {
                let mut v = j[(i, k)];
                for m in 0..k {
                    v -= l[(i, m)] * l[(k, m)];
                }
                l[(i, k)] = v;
            }
        }
        Some(Self { l, inverse })
    }

    /// `M L⁻ᵀ`.
    #[inline]
    fn right(&self, m: &Matrix<N, N>) -> Matrix<N, N> {
        let mut y = *m;
        for j in 0..N {
            for k in 0..j {
                for i in 0..N {
                    y[(i, j)] -= y[(i, k)] * self.l[(j, k)];
                }
            }
        }
        y
    }

    /// `Y D⁻¹`.
    #[inline]
    fn weighted(&self, y: &Matrix<N, N>) -> Matrix<N, N> {
        Matrix::from_fn(|i, j| y[(i, j)] * self.inverse[j])
    }

    /// `L⁻¹ v`.
    #[inline]
    fn left(&self, mut v: Vector<N>) -> Vector<N> {
        for i in 0..N {
            for k in 0..i {
                v[i] -= self.l[(i, k)] * v[k];
            }
        }
        v
    }
}
