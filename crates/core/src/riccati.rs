//! What can be known of a target when measurements are lost: the modified Riccati recursion and the arrival rate it needs \[SIN04\].
//!
//! ```text
//! g_λ(X) = A X Aᵀ + W − λ A X Cᵀ (C X Cᵀ + R)⁻¹ C X Aᵀ
//! S = (1 − λ) A S Aᵀ + W   ≤   lim E[P⁻]   ≤   X = g_λ(X)
//! ```
//!
//! The model is linear and time-invariant, each instant's measurements arrive together with probability λ or not at all, independently,
//! and the filter knows which have arrived. P⁻ is the covariance of its prediction, random because arrivals are. For λ = 1 both P⁻ and X
//! are the steady state of the Kalman filter.

use crate::estimators::kalman::{joseph, propagate};
use crate::linalg::{compress, whiten};
use crate::types::{Matrix, Row, Vector};

/// Most components of a measurement.
pub const MAX_COMPONENTS: usize = 12;

/// Squarings in [`spectral_radius`].
const SQUARINGS: u32 = 50;

/// A spectral radius at most this far from 1 counts as 1.
const RADIUS_TOLERANCE: f64 = 1e-9;

/// Most steps of the recursion before its fixed point is given up.
const MOST_STEPS: u32 = 100_000;

/// Most steps over which growth without noise is averaged.
const GROWTH_STEPS: u32 = 4_000;

/// Noise variance that stands for none, where covariances have a trace of 1 and rows a length of 1.
const NO_NOISE: f64 = 1e-14;

/// Returns the spectral radius of `a`: the largest magnitude of its eigenvalues.
///
/// Gelfand's formula `ρ = lim ‖A^m‖^(1/m)` at m = 2⁵⁰, by repeated squaring with the scale kept apart. What the limit lacks is a factor
/// `m^((N−1)/m)` at most times the condition of the eigenvectors to the power 1/m, below 1e-12; rounding acts as in any eigenvalue method,
/// like a change of `a` by some units in its last place.
pub fn spectral_radius<const N: usize>(a: &Matrix<N, N>) -> f64 {
    let mut power = *a;
    let mut log_scale = 0.0;
    let mut log_radius = f64::NEG_INFINITY;
    let mut weight = 1.0;
    for _ in 0..=SQUARINGS {
        let norm = power.norm();
        if norm == 0.0 {
            return 0.0;
        }
        if !norm.is_finite() {
            return f64::INFINITY;
        }
        log_scale += weight * libm::log(norm);
        log_radius = log_scale;
        power /= norm;
        power *= power;
        weight *= 0.5;
    }
    libm::exp(log_radius)
}

/// Bounds on the critical arrival rate λ_c: below it E\[P\] grows without bound from some start, above it E\[P\] stays bounded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CriticalRate {
    /// `1 − 1/ρ(A)²`, 0 for ρ(A) ≤ 1.
    pub lower: f64,
    /// The boundary above which the modified Riccati recursion has a fixed point; `None` when not even certain arrival makes one, because
    /// the measurements do not show everything that does not die out.
    pub upper: Option<f64>,
}

/// A linear time-invariant system whose measurements may be lost.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lossy<const N: usize> {
    a: Matrix<N, N>,
    w: Matrix<N, N>,
    /// Independent rows of unit variance that say what C and R say.
    rows: [Row<N>; MAX_COMPONENTS],
    count: usize,
}

impl<const N: usize> Lossy<N> {
    /// Returns the system x⁺ = A x + w, z = C x + v.
    ///
    /// Shapes: `a` and `w` (N, N), `w` the covariance of the process noise; `c` the q rows of C, `r` the (q, q) noise covariance row by
    /// row. `None` when q exceeds [`MAX_COMPONENTS`], `r` has another size or is not positive definite, or `a` is not finite.
    pub fn new(a: &Matrix<N, N>, w: &Matrix<N, N>, c: &[Vector<N>], r: &[f64]) -> Option<Self> {
        let q = c.len();
        if q > MAX_COMPONENTS || r.len() != q * q || !a.iter().chain(w.iter()).all(|v| v.is_finite()) {
            return None;
        }
        let mut rows = [Row { h: Vector::zeros(), residual: 0.0, var: 1.0 }; MAX_COMPONENTS];
        for (row, h) in rows.iter_mut().zip(c) {
            row.h = *h;
        }
        let mut factor = [0.0; MAX_COMPONENTS * MAX_COMPONENTS];
        factor[..q * q].copy_from_slice(r);
        if !whiten(&mut rows[..q], &mut factor[..q * q]) {
            return None;
        }
        let (count, _) = compress(&mut rows[..q]);
        Some(Self { a: *a, w: *w, rows, count })
    }

    /// Returns the covariance after an instant that was predicted with covariance `x`, averaged over the arrival of its measurements.
    ///
    /// `X − λ X Cᵀ (C X Cᵀ + R)⁻¹ C X`. For X = g_λ(X) it is an upper bound on E\[P\] as X is on E\[P⁻\].
    pub fn filtered(&self, x: &Matrix<N, N>, arrival: f64) -> Matrix<N, N> {
        mixed(x, &updated(x, &self.rows[..self.count]), arrival)
    }

    /// Returns `g_λ(x)`, one step of the modified Riccati recursion \[SIN04\]; x ≤ y gives g_λ(x) ≤ g_λ(y).
    pub fn step(&self, x: &Matrix<N, N>, arrival: f64) -> Matrix<N, N> {
        propagate(&self.filtered(x, arrival), &self.a, &self.w)
    }

    /// Returns the least fixed point X = g_λ(X), an upper bound on lim E\[P⁻\] from P⁻ = 0; the only one when the noise reaches every state
    /// ((A, W^½) controllable), and then from any start.
    ///
    /// By iteration from 0, which ascends. `None` when there is none, or when it has not settled within 100 000 steps, as happens within
    /// about 1e-4 of the critical rate. Accuracy: 1e-9 of each variance while an error shrinks by 1e-4 or more in a step.
    pub fn upper_bound(&self, arrival: f64) -> Option<Matrix<N, N>> {
        if self.is_unstable() && !(self.growth(arrival) < 1.0) {
            return None;
        }
        let mut x = Matrix::zeros();
        let mut last = 0.0;
        for _ in 0..MOST_STEPS {
            let next = self.step(&x, arrival);
            // Steps ascend in the order of covariances, so variances tell how far a step leads.
            let mut change: f64 = 0.0;
            for i in 0..N {
                let (old, new) = (x[(i, i)], next[(i, i)]);
                if !new.is_finite() {
                    return None;
                }
                if new > 0.0 {
                    change = change.max((new - old).abs() / new);
                }
            }
            x = next;
            // A geometric rest, change · (rate + rate² + …), with room for changes that fall in waves.
            if change * change <= 1e-12 * (last - change) || change <= N as f64 * f64::EPSILON {
                return Some(x);
            }
            last = change;
        }
        None
    }

    /// Returns the covariance of a smoother `lag` instants behind the newest measurements, in the steady state; nothing is lost. Without a
    /// `lag`, of one that has all later measurements. `x` is the steady prediction covariance, [`upper_bound`](Self::upper_bound) at rate 1.
    ///
    /// ```text
    /// P_{k−d|k} = X − X Λ_d X,   Λ_d = Σ_{i=0}^{d} (F̄ⁱ)ᵀ Cᵀ S⁻¹ C F̄ⁱ,   F̄ = A (I − K C),   S = C X Cᵀ + R
    /// ```
    ///
    /// \[AMO79, sec. 7.3\]; lag 0 is the filter. Λ is summed from the far end, `Λ ← Cᵀ S⁻¹ C + F̄ᵀ Λ F̄`, row by row as in the backward pass
    /// of \[BIE77\]. `None` when a sum without end has not settled within 100 000 instants.
    pub fn lagged(&self, x: &Matrix<N, N>, lag: Option<u32>) -> Option<Matrix<N, N>> {
        let rows = &self.rows[..self.count];
        let mut gains = [(Vector::<N>::zeros(), 1.0); MAX_COMPONENTS];
        let mut after = *x;
        for (row, (gain, s)) in rows.iter().zip(&mut gains) {
            let xh = after * row.h;
            *s = row.h.dot(&xh) + row.var;
            *gain = xh / *s;
            after = joseph(&after, &row.h, row.var, &xh, *s);
        }
        let none = Matrix::zeros();
        let mut information = none;
        let mut settled = false;
        for _ in 0..lag.map_or(MOST_STEPS, |lag| lag.saturating_add(1).min(MOST_STEPS)) {
            let mut next = propagate(&information, &self.a.transpose(), &none);
            for (row, (gain, s)) in rows.iter().zip(&gains).rev() {
                // (I − K hᵀ)ᵀ Λ (I − K hᵀ) + h hᵀ / s
                let through = Matrix::identity() - gain * row.h.transpose();
                next = propagate(&next, &through.transpose(), &(row.h * row.h.transpose() / *s));
            }
            // It ascends, so variances tell how far a step leads.
            settled = (0..N).all(|i| next[(i, i)] - information[(i, i)] <= f64::EPSILON * next[(i, i)]);
            information = next;
            if settled {
                break;
            }
        }
        (settled || lag.is_some_and(|lag| lag < MOST_STEPS)).then(|| x - propagate(&information, x, &none))
    }

    /// Returns the solution of S = (1 − λ) A S Aᵀ + W, a lower bound on lim E\[P⁻\] for every λ; (1 − λ) S is one on lim E\[P\].
    ///
    /// By doubling. `None` when there is none: (1 − λ) ρ(A)² ≥ 1, where E\[P⁻\] grows without bound.
    pub fn lower_bound(&self, arrival: f64) -> Option<Matrix<N, N>> {
        let radius = spectral_radius(&self.a);
        if !((1.0 - arrival) * radius * radius < 1.0) {
            return None;
        }
        let mut sum = self.w;
        let mut power = self.a * libm::sqrt(1.0 - arrival);
        for _ in 0..64 {
            let next = propagate(&sum, &power, &sum);
            let settled = (0..N).all(|i| next[(i, i)] - sum[(i, i)] <= f64::EPSILON * next[(i, i)]);
            if !next.iter().all(|v| v.is_finite()) {
                return None;
            }
            sum = next;
            if settled {
                return Some(sum);
            }
            power *= power;
        }
        None
    }

    /// Returns the spectral radius of A.
    pub fn spectral_radius(&self) -> f64 {
        spectral_radius(&self.a)
    }

    /// Whether A has an eigenvalue outside the unit circle, by more than 1e-9.
    pub fn is_unstable(&self) -> bool {
        self.spectral_radius() > 1.0 + RADIUS_TOLERANCE
    }

    /// Returns bounds on the critical arrival rate \[SIN04\]. They coincide when C is invertible, and when one mode is unstable.
    ///
    /// The upper one by bisection over λ. It does not depend on W and R: large X leave the recursion `h_λ(X) = A (X − λ X Cᵀ (C X Cᵀ)⁺ C X)
    /// Aᵀ`, positively homogeneous and monotone, and g_λ has a fixed point when repeated h_λ shrinks every X. Accuracy about 1e-6.
    pub fn critical_rate(&self) -> CriticalRate {
        let radius = self.spectral_radius();
        if radius < 1.0 - RADIUS_TOLERANCE {
            return CriticalRate { lower: 0.0, upper: Some(0.0) };
        }
        let is_seen = self.growth(1.0) < 1.0 - 1e-6;
        if radius <= 1.0 + RADIUS_TOLERANCE {
            return CriticalRate { lower: 0.0, upper: is_seen.then_some(0.0) };
        }
        let lower = 1.0 - 1.0 / (radius * radius);
        if !is_seen {
            return CriticalRate { lower, upper: None };
        }
        let (mut below, mut above) = (lower, 1.0);
        for _ in 0..40 {
            let middle = 0.5 * (below + above);
            if self.growth(middle) < 1.0 {
                above = middle;
            } else {
                below = middle;
            }
        }
        CriticalRate { lower, upper: Some(above) }
    }

    /// Returns the factor by which h_λ makes covariances grow in the long run.
    fn growth(&self, arrival: f64) -> f64 {
        let mut rows = self.rows;
        for row in &mut rows[..self.count] {
            let length = row.h.norm();
            if length > 0.0 {
                row.h /= length;
            }
            row.var = NO_NOISE;
        }
        let none = Matrix::zeros();
        let mut x = Matrix::<N, N>::identity() / N as f64;
        let (mut log_growth, mut weights) = (0.0, 0.0);
        for step in 0..GROWTH_STEPS {
            let next = propagate(&mixed(&x, &updated(&x, &rows[..self.count]), arrival), &self.a, &none);
            let trace = next.trace();
            if !(trace > 0.0) {
                return 0.0;
            }
            if !trace.is_finite() {
                return f64::INFINITY;
            }
            let next = next / trace;
            // The shape has settled, and so has the growth.
            if (next - x).amax() < 1e-14 {
                return trace;
            }
            x = next;
            // Complex eigenvalues make the shape go round for ever. Weights that start and end flat average that out like 1/steps³.
            let at = 2.0 * f64::from(step) / f64::from(GROWTH_STEPS) - 1.0;
            if at > 0.0 {
                let weight = at * at * (1.0 - at) * (1.0 - at);
                log_growth += weight * libm::log(trace);
                weights += weight;
            }
        }
        libm::exp(log_growth / weights)
    }
}

/// Returns `X − X Hᵀ (H X Hᵀ + V)⁻¹ H X` for independent rows.
fn updated<const N: usize>(x: &Matrix<N, N>, rows: &[Row<N>]) -> Matrix<N, N> {
    let mut out = *x;
    for row in rows {
        let xh = out * row.h;
        let s = row.h.dot(&xh) + row.var;
        out = joseph(&out, &row.h, row.var, &xh, s);
    }
    out
}

/// Returns `(1 − λ) without + λ with`.
fn mixed<const N: usize>(without: &Matrix<N, N>, with: &Matrix<N, N>, arrival: f64) -> Matrix<N, N> {
    without * (1.0 - arrival) + with * arrival
}
