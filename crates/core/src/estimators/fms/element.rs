//! Associative elements of Kalman smoothing: what a stretch of instants says of its first and of its last state.
//!
//! An element stands for `p(x_end | x_start, z) = N(F x_start + b, C)` and for the likelihood of the stretch's data given `x_start`,
//! with information vector η and matrix J (Särkkä & García-Fernández 2021, lemma 8). One instant: its rows, then the leap, so
//! `F = F, b = B u, C = Q, η = Hᵀ R⁻¹ z, J = Hᵀ R⁻¹ H`: nothing is inverted.

use crate::estimators::diffuse::Joint;
use crate::linalg::{Lu, symmetrised};
use crate::types::{Belief, Matrix, Row, Transition, Vector};

/// A stretch of instants.
#[derive(Clone, Copy, Debug)]
pub struct Element<const N: usize> {
    f: Matrix<N, N>,
    b: Vector<N>,
    c: Matrix<N, N>,
    eta: Vector<N>,
    j: Matrix<N, N>,
}

impl<const N: usize> Element<N> {
    /// The empty stretch.
    pub fn identity() -> Self {
        Self { f: Matrix::identity(), b: Vector::zeros(), c: Matrix::zeros(), eta: Vector::zeros(), j: Matrix::zeros() }
    }

    /// One instant: its rows, then the leap to the next, if there is one.
    pub fn instant(rows: &[Row<N>], leap: Option<&Transition<N>>) -> Self {
        let mut e = Self::identity();
        for row in rows {
            let w = row.h / row.var;
            e.eta += w * row.residual;
            e.j += w * row.h.transpose();
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
        let lu = Lu::new(Matrix::identity() + self.c * then.j)?;
        let t = lu.solve_transposed(then.f.transpose()).transpose();
        let u = lu.solve(self.f).transpose();
        Some(Self {
            f: t * self.f,
            b: t * (self.b + self.c * then.eta) + then.b,
            c: symmetrised(&(t * self.c * then.f.transpose() + then.c)),
            eta: u * (then.eta - then.j * self.b) + self.eta,
            j: symmetrised(&(u * then.j * self.f + self.j)),
        })
    }

    /// The stretch `self` followed by one instant, as [`combine`](Element::combine) with [`instant`](Element::instant) has it, but row by row: with
    /// `e = z − h b` and `s = h C hᵀ + r`
    ///
    /// ```text
    /// η += Fᵀ h e/s    J += Fᵀ h hᵀ F/s    b += C h e/s    F −= C h hᵀ F/s    C −= C h hᵀ C/s
    /// ```
    pub fn then(&self, rows: &[Row<N>], leap: Option<&Transition<N>>) -> Self {
        let mut all = *self;
        for row in rows {
            let ch = all.c * row.h;
            let g = all.f.tr_mul(&row.h);
            let inverse = 1.0 / (row.h.dot(&ch) + row.var);
            let e = (row.residual - row.h.dot(&all.b)) * inverse;
            all.eta += g * e;
            all.b += ch * e;
            let (gain, weight) = (ch * inverse, g * inverse);
            for j in 0..N {
                for i in 0..N {
                    all.f[(i, j)] -= gain[i] * g[j];
                }
                // Both halves are the same product.
                for i in 0..=j {
                    let (c, w) = (all.c[(i, j)] - gain[i] * ch[j], all.j[(i, j)] + weight[i] * g[j]);
                    (all.c[(i, j)], all.c[(j, i)]) = (c, c);
                    (all.j[(i, j)], all.j[(j, i)]) = (w, w);
                }
            }
        }
        if let Some(leap) = leap {
            all.f = leap.f * all.f;
            all.b = leap.f * all.b + leap.next;
            all.c = symmetrised(&(leap.f * all.c * leap.f.transpose() + leap.q));
        }
        all
    }

    /// The estimate of the last state, the first one unknown. `None` as in [`joint`](Element::joint).
    pub fn filtered(&self) -> Option<Belief<N>> {
        let start = InverseRoot::new(&self.j)?;
        let y = start.apply(&self.f);
        let mean = self.f * start.solve(&self.eta) + self.b;
        Some(Belief { mean, cov: symmetrised(&(self.c + y * y.transpose())) })
    }

    /// Estimates of the last state and of the state between `self` and `then`, the first state unknown. `None` when the information
    /// matrix of the first state is too ill-conditioned (scaled pivot below 1e-6, where six digits would go) to be decided upon here.
    pub fn joint(&self, then: &Self) -> Option<Joint<N>> {
        let lu = Lu::new(Matrix::identity() + self.c * then.j)?;
        let whole = self.combine(then)?;
        let start = InverseRoot::new(&whole.j)?;
        let s = start.solve(&whole.eta);
        let y = start.apply(&whole.f);
        let filter = Belief { mean: whole.f * s + whole.b, cov: symmetrised(&(whole.c + y * y.transpose())) };
        let between_f = lu.solve(self.f);
        let between_c = lu.solve(self.c);
        let y_lag = start.apply(&between_f);
        let lagged = Belief {
            mean: between_f * s + lu.solve(self.b + self.c * then.eta),
            cov: symmetrised(&(between_c + y_lag * y_lag.transpose())),
        };
        let cross = then.f * between_c + y * y_lag.transpose();
        Some(Joint { filter: Some(filter), lagged: Some(lagged), cross })
    }
}

/// `J = D L Lᵀ D` with unit-diagonal scaling: gives `M J^{-½}` and `J⁻¹ v`.
struct InverseRoot<const N: usize> {
    scale: Vector<N>,
    l: Matrix<N, N>,
}

impl<const N: usize> InverseRoot<N> {
    fn new(j: &Matrix<N, N>) -> Option<Self> {
        let mut scale = Vector::<N>::zeros();
        for i in 0..N {
            let d = j[(i, i)];
            if !(d > 0.0 && d.is_finite()) {
                return None;
            }
            scale[i] = libm::sqrt(d);
        }
        let mut l = Matrix::<N, N>::zeros();
        for i in 0..N {
            for k in 0..=i {
                let mut sum = j[(i, k)] / (scale[i] * scale[k]);
                for m in 0..k {
                    sum -= l[(i, m)] * l[(k, m)];
                }
                if i == k {
                    if !(sum > 1e-6) {
                        return None;
                    }
                    l[(i, i)] = libm::sqrt(sum);
                } else {
                    l[(i, k)] = sum / l[(k, k)];
                }
            }
        }
        Some(Self { scale, l })
    }

    /// `M D⁻¹ L⁻ᵀ`.
    fn apply(&self, m: &Matrix<N, N>) -> Matrix<N, N> {
        let mut y = *m;
        for j in 0..N {
            for i in 0..N {
                let mut v = y[(i, j)] / self.scale[j];
                for k in 0..j {
                    v -= y[(i, k)] * self.l[(j, k)];
                }
                y[(i, j)] = v / self.l[(j, j)];
            }
        }
        y
    }

    fn solve(&self, v: &Vector<N>) -> Vector<N> {
        let mut x = v.component_div(&self.scale);
        for i in 0..N {
            for k in 0..i {
                let t = x[k];
                x[i] -= self.l[(i, k)] * t;
            }
            x[i] /= self.l[(i, i)];
        }
        for i in (0..N).rev() {
            for k in i + 1..N {
                let t = x[k];
                x[i] -= self.l[(k, i)] * t;
            }
            x[i] /= self.l[(i, i)];
        }
        x.component_div(&self.scale)
    }
}
