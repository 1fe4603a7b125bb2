//! Small dense linear algebra without a heap: whitening, orthogonal least squares, singular values, LU.

use crate::types::{Matrix, Row, Vector};

/// Smallest-to-largest singular value ratio below which a window does not determine its state.
pub const RANK_TOLERANCE: f64 = 1e-12;

/// Returns `(m + mᵀ)/2`.
pub fn symmetrised<const N: usize>(m: &Matrix<N, N>) -> Matrix<N, N> {
    (m + m.transpose()) * 0.5
}

/// Turns rows with correlated noise of covariance `r` into independent rows of unit variance.
///
/// With `R = L Lᵀ`, each row and residual is replaced by its component of `L⁻¹`. `r` holds the `q × q` covariance row by row
/// (`q = rows.len()`) and is overwritten by `L`. Returns `false`, with the rows unchanged, when `r` is not positive definite.
///
/// # Panics
/// When `r` has fewer than `q²` entries.
#[must_use]
pub fn whiten<const N: usize>(rows: &mut [Row<N>], r: &mut [f64]) -> bool {
    let q = rows.len();
    if !cholesky(r, q) {
        return false;
    }
    for i in 0..q {
        for j in 0..i {
            let l = r[i * q + j];
            let (before, rest) = rows.split_at_mut(i);
            rest[0].h -= before[j].h * l;
            rest[0].residual -= before[j].residual * l;
        }
        let d = 1.0 / r[i * q + i];
        rows[i].h *= d;
        rows[i].residual *= d;
        rows[i].var = 1.0;
    }
    true
}

/// Makes rows independent whose noises have a part in common, one after the other: covariance `diag(own) + common 1 1ᵀ`.
///
/// Each row is replaced by what it says beyond the rows before it, which is [`whiten`] for this covariance in a number of operations
/// and in room that do not grow with the rows. The state is the mean of the common part given the rows so far, as a row, and its variance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Common<const N: usize> {
    h: Vector<N>,
    residual: f64,
    var: f64,
}

impl<const N: usize> Common<N> {
    /// Before the first row; `var` is the variance of the common part, not negative.
    pub fn new(var: f64) -> Self {
        Self { h: Vector::zeros(), residual: 0.0, var }
    }

    /// Returns the row that is independent of those before; `own.var` is the variance of the row's own part, positive.
    pub fn next(&mut self, own: &Row<N>) -> Row<N> {
        let var = self.var + own.var;
        let row = Row { h: own.h - self.h, residual: own.residual - self.residual, var };
        let gain = self.var / var;
        self.h += row.h * gain;
        self.residual += row.residual * gain;
        self.var = own.var * gain;
        row
    }
}

/// Replaces more than `N` rows by at most `N` rows of unit variance that say the same of the state. Returns how many are left at the
/// front of `rows`, and the residual sum of squares that no state explains.
pub fn compress<const N: usize>(rows: &mut [Row<N>]) -> (usize, f64) {
    if rows.len() <= N {
        return (rows.len(), 0.0);
    }
    let mut fit = LeastSquares::<N>::new();
    let mut left = 0.0;
    for row in rows.iter() {
        let w = 1.0 / libm::sqrt(row.var);
        let rest = fit.add(&(row.h * w), row.residual * w);
        left += rest * rest;
    }
    for (i, row) in rows.iter_mut().take(N).enumerate() {
        *row = Row { h: fit.r.row(i).transpose(), residual: fit.y[i], var: 1.0 };
    }
    (N, left)
}

/// Overwrites the lower triangle of the row-major `q × q` matrix `r` with its Cholesky factor; `false` when it has none.
#[must_use]
pub fn cholesky(r: &mut [f64], q: usize) -> bool {
    for i in 0..q {
        for j in 0..=i {
            let mut sum = r[i * q + j];
            for k in 0..j {
                sum -= r[i * q + k] * r[j * q + k];
            }
            if i == j {
                if !(sum > 0.0 && sum.is_finite()) {
                    return false;
                }
                r[i * q + i] = libm::sqrt(sum);
            } else {
                r[i * q + j] = sum / r[j * q + j];
            }
        }
    }
    true
}

/// Returns a lower triangular `L` with `L Lᵀ = m` for a positive semidefinite `m`; a direction that has no variance left to working
/// precision becomes a column of zeros. Entries are not numbers when those of `m` are not finite.
pub fn semidefinite_factor<const N: usize>(m: &Matrix<N, N>) -> Matrix<N, N> {
    if !m.iter().all(|v| v.is_finite()) {
        return Matrix::repeat(f64::NAN);
    }
    let mut l = Matrix::<N, N>::zeros();
    for j in 0..N {
        let mut d = m[(j, j)];
        for k in 0..j {
            d -= l[(j, k)] * l[(j, k)];
        }
        if !(d > 0.0) || d <= N as f64 * f64::EPSILON * m[(j, j)] {
            continue;
        }
        let root = libm::sqrt(d);
        l[(j, j)] = root;
        for i in j + 1..N {
            let mut v = m[(i, j)];
            for k in 0..j {
                v -= l[(i, k)] * l[(j, k)];
            }
            l[(i, j)] = v / root;
        }
    }
    l
}

/// Least squares by Givens rotations, one row at a time: keeps the triangular factor `R` and the rotated data `y` of
/// `min ‖H s − z‖²`, so that `Rᵀ R = HᵀH` is never formed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LeastSquares<const N: usize> {
    /// Upper triangular factor.
    pub r: Matrix<N, N>,
    /// Rotated data.
    pub y: Vector<N>,
}

impl<const N: usize> LeastSquares<N> {
    /// No rows yet.
    pub fn new() -> Self {
        Self { r: Matrix::zeros(), y: Vector::zeros() }
    }

    /// Adds the row `hᵀ s = z` of unit weight and returns what is left of `z` once it is rotated out: its square is what the row adds
    /// to the residual sum of squares.
    pub fn add(&mut self, h: &Vector<N>, z: f64) -> f64 {
        let mut h = *h;
        let mut z = z;
        for i in 0..N {
            let b = h[i];
            if b == 0.0 {
                continue;
            }
            let a = self.r[(i, i)];
            let rho = libm::hypot(a, b);
            let (c, s) = (a / rho, b / rho);
            self.r[(i, i)] = rho;
            for j in i + 1..N {
                let (u, v) = (self.r[(i, j)], h[j]);
                self.r[(i, j)] = c * u + s * v;
                h[j] = c * v - s * u;
            }
            let (u, v) = (self.y[i], z);
            self.y[i] = c * u + s * v;
            z = c * v - s * u;
        }
        z
    }

    /// Returns `M R⁻¹`, by substitution. Entries are not finite when `R` is singular.
    pub fn right_solve(&self, m: &Matrix<N, N>) -> Matrix<N, N> {
        let mut y = *m;
        for j in 0..N {
            for k in 0..j {
                let r = self.r[(k, j)];
                for i in 0..N {
                    let t = y[(i, k)];
                    y[(i, j)] -= t * r;
                }
            }
            let d = 1.0 / self.r[(j, j)];
            for i in 0..N {
                y[(i, j)] *= d;
            }
        }
        y
    }

    /// Returns the singular values and right singular vectors of `R` with its columns scaled to unit length, and the scales
    /// (1 for a column of zeros).
    pub fn scaled_svd(&self) -> ScaledSvd<N> {
        let mut m = self.r;
        let mut scale = Vector::<N>::repeat(1.0);
        for j in 0..N {
            let norm = m.column(j).norm();
            if norm > 0.0 {
                scale[j] = norm;
                m.column_mut(j).scale_mut(1.0 / norm);
            }
        }
        let (sigma, u_sigma, v) = one_sided_jacobi(m);
        ScaledSvd { scale, sigma, u_sigma, v }
    }
}

impl<const N: usize> Default for LeastSquares<N> {
    fn default() -> Self {
        Self::new()
    }
}

/// `R D⁻¹ = U Σ Vᵀ` with `D = diag(scale)`.
#[derive(Clone, Copy, Debug)]
pub struct ScaledSvd<const N: usize> {
    /// Column lengths of R.
    pub scale: Vector<N>,
    /// Singular values, not sorted.
    pub sigma: Vector<N>,
    /// `U Σ`: column j has length `sigma[j]`.
    pub u_sigma: Matrix<N, N>,
    /// Right singular vectors, column j belongs to `sigma[j]`.
    pub v: Matrix<N, N>,
}

impl<const N: usize> ScaledSvd<N> {
    /// Smallest over largest singular value; 0 when all are 0.
    pub fn ratio(&self) -> f64 {
        let max = self.sigma.max();
        if max > 0.0 { self.sigma.min() / max } else { 0.0 }
    }
}

/// One-sided Jacobi: rotates the columns of `m` until they are orthogonal. Small singular values keep their relative accuracy.
pub(crate) fn one_sided_jacobi<const N: usize>(mut m: Matrix<N, N>) -> (Vector<N>, Matrix<N, N>, Matrix<N, N>) {
    let mut v = Matrix::<N, N>::identity();
    // 12 sweeps are twice what N = 12 needs; convergence is quadratic.
    for _ in 0..12 {
        let mut off: f64 = 0.0;
        for p in 0..N {
            for q in p + 1..N {
                let alpha = m.column(p).norm_squared();
                let beta = m.column(q).norm_squared();
                let gamma = m.column(p).dot(&m.column(q));
                let limit = libm::sqrt(alpha * beta);
                if limit == 0.0 || gamma.abs() <= 1e-17 * limit {
                    continue;
                }
                off = off.max(gamma.abs() / limit);
                let zeta = (beta - alpha) / (2.0 * gamma);
                let t = libm::copysign(1.0, zeta) / (zeta.abs() + libm::sqrt(1.0 + zeta * zeta));
                let c = 1.0 / libm::sqrt(1.0 + t * t);
                let s = c * t;
                for i in 0..N {
                    let (a, b) = (m[(i, p)], m[(i, q)]);
                    m[(i, p)] = c * a - s * b;
                    m[(i, q)] = s * a + c * b;
                    let (a, b) = (v[(i, p)], v[(i, q)]);
                    v[(i, p)] = c * a - s * b;
                    v[(i, q)] = s * a + c * b;
                }
            }
        }
        if off < 1e-15 {
            break;
        }
    }
    let sigma = Vector::<N>::from_fn(|j, _| m.column(j).norm());
    (sigma, m, v)
}

/// Returns the inverse of a positive definite `m` and the logarithm of its determinant, or `None` when `m` has no Cholesky factor.
pub fn definite_inverse<const M: usize>(m: &Matrix<M, M>) -> Option<(Matrix<M, M>, f64)> {
    let mut l = *m;
    // Symmetric: column-major and row-major storage are the same matrix, so L comes back transposed.
    if !cholesky(l.as_mut_slice(), M) {
        return None;
    }
    let mut inverse = Matrix::<M, M>::identity();
    let mut log_det = 0.0;
    for i in 0..M {
        let d = l[(i, i)];
        log_det += 2.0 * libm::log(d);
        for c in 0..=i {
            let mut v = inverse[(i, c)];
            for k in c..i {
                v -= l[(k, i)] * inverse[(k, c)];
            }
            inverse[(i, c)] = v / d;
        }
    }
    Some((inverse.transpose() * inverse, log_det))
}

/// Returns the pseudo-inverse of a positive semidefinite `m` without the eigenvalues up to `least`, and how many were left.
pub fn pseudo_inverse<const M: usize>(m: &Matrix<M, M>, least: f64) -> (Matrix<M, M>, usize) {
    let (sigma, u_sigma, v) = one_sided_jacobi(*m);
    let mut out = Matrix::<M, M>::zeros();
    let mut rank = 0;
    for j in 0..M {
        let s = sigma[j];
        if s > least {
            out += v.column(j) * u_sigma.column(j).transpose() * (1.0 / (s * s));
            rank += 1;
        }
    }
    (symmetrised(&out), rank)
}

/// LU factors with partial pivoting.
#[derive(Clone, Copy, Debug)]
pub struct Lu<const N: usize> {
    lu: Matrix<N, N>,
    pivot: [usize; N],
}

impl<const N: usize> Lu<N> {
    /// Factors `m`, or returns `None` when a pivot is zero or not finite.
    pub fn new(mut m: Matrix<N, N>) -> Option<Self> {
        let mut pivot = [0; N];
        for k in 0..N {
            let mut best = k;
            for i in k + 1..N {
                if m[(i, k)].abs() > m[(best, k)].abs() {
                    best = i;
                }
            }
            pivot[k] = best;
            let d = m[(best, k)];
            if d == 0.0 || !d.is_finite() {
                return None;
            }
            m.swap_rows(k, best);
            for i in k + 1..N {
                let l = m[(i, k)] / d;
                m[(i, k)] = l;
                for j in k + 1..N {
                    let u = m[(k, j)];
                    m[(i, j)] -= l * u;
                }
            }
        }
        Some(Self { lu: m, pivot })
    }

    /// Returns `M⁻¹ B`.
    pub fn solve<const K: usize>(&self, mut b: Matrix<N, K>) -> Matrix<N, K> {
        for k in 0..N {
            b.swap_rows(k, self.pivot[k]);
        }
        for c in 0..K {
            for i in 0..N {
                for j in 0..i {
                    let t = b[(j, c)];
                    b[(i, c)] -= self.lu[(i, j)] * t;
                }
            }
            for i in (0..N).rev() {
                for j in i + 1..N {
                    let t = b[(j, c)];
                    b[(i, c)] -= self.lu[(i, j)] * t;
                }
                b[(i, c)] /= self.lu[(i, i)];
            }
        }
        b
    }

    /// Returns `M⁻ᵀ B`.
    pub fn solve_transposed<const K: usize>(&self, mut b: Matrix<N, K>) -> Matrix<N, K> {
        for c in 0..K {
            for i in 0..N {
                for j in 0..i {
                    let t = b[(j, c)];
                    b[(i, c)] -= self.lu[(j, i)] * t;
                }
                b[(i, c)] /= self.lu[(i, i)];
            }
            for i in (0..N).rev() {
                for j in i + 1..N {
                    let t = b[(j, c)];
                    b[(i, c)] -= self.lu[(j, i)] * t;
                }
            }
        }
        for k in (0..N).rev() {
            b.swap_rows(k, self.pivot[k]);
        }
        b
    }
}
