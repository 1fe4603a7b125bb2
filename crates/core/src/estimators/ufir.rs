//! Unbiased finite impulse response (UFIR) filter: least squares over a sliding window that ignores the process noise.
//!
//! The weights come from the observability of the window alone; the process noise enters only the covariance, which is that of this
//! (suboptimal) estimate under the stated Q and R, so it stays honest:
//!
//! ```text
//! E_k = Φ_kᵀ h_k,  S = Σ E_k E_kᵀ,  x̂ = Φ_M S⁻¹ Σ E_k z_k + known inputs      (rows whitened)
//! cov = Φ_M S⁻¹ Φ_Mᵀ + Σ_j D_j Q_j D_jᵀ,   D_j = Φ_M S⁻¹ Σ_{k>j} E_k h_kᵀ Φ_{k,j+1} − Φ_{M,j+1}
//! ```

use crate::estimators::fms::window::{Node, Window};
use crate::estimators::kalman::finite;
use crate::linalg::{LeastSquares, RANK_TOLERANCE, symmetrised};
use crate::storage::Store;
use crate::types::{Belief, Matrix, Row, StepError, Transition, Vector};

/// A sliding window over a linear model.
#[derive(Clone)]
pub struct Ufir<const N: usize, S: Store> {
    window: Window<N, S>,
    phi: S::Of<Matrix<N, N>>,
}

impl<const N: usize, S: Store> Ufir<N, S> {
    /// An empty window that expects about `capacity` instants, or `None` when the store has no room for them.
    pub fn new(capacity: usize) -> Option<Self> {
        Some(Self { window: Window::new(capacity)?, phi: S::filled(capacity, Matrix::identity())? })
    }

    /// Number of instants in the window.
    pub fn len(&self) -> usize {
        self.window.len()
    }

    /// Whether the window is empty.
    pub fn is_empty(&self) -> bool {
        self.window.is_empty()
    }

    /// Adds an instant: the transition that led to it and its rows, linearised at 0. `rows` is overwritten when there are more than N.
    ///
    /// # Errors
    /// [`StepError::WindowFull`] when the store has no more room; nothing has changed then.
    pub fn push(&mut self, arrive: &Transition<N>, rows: &mut [Row<N>]) -> Result<(), StepError> {
        let needed = self.window.len() + 1;
        let capacity = self.phi.as_ref().len();
        if needed > capacity {
            let full = StepError::WindowFull { capacity, needed };
            self.phi = S::filled(2 * capacity, Matrix::identity()).ok_or(full)?;
        }
        self.window.push(Node::new(arrive, rows))
    }

    /// Forgets the `count` oldest instants.
    pub fn drop_front(&mut self, count: usize) {
        self.window.drop_front(count);
    }

    /// Estimates the newest state, or returns `None` when the window does not determine it.
    pub fn estimate(&mut self) -> Option<Belief<N>> {
        let len = self.window.len();
        let phi = self.phi.as_mut();
        let mut fit = LeastSquares::<N>::new();
        let mut product = Matrix::<N, N>::identity();
        let mut known = Vector::<N>::zeros();
        for i in 0..len {
            let node = self.window.get(i);
            if i > 0 {
                product = node.arrive.f * product;
                known = node.arrive.f * known + node.arrive.next;
            }
            phi[i] = product;
            for row in node.rows() {
                let w = 1.0 / libm::sqrt(row.var);
                fit.add(&(product.tr_mul(&row.h) * w), (row.residual - row.h.dot(&known)) * w);
            }
        }
        if len == 0 || fit.scaled_svd().ratio() < RANK_TOLERANCE {
            return None;
        }
        let y = fit.right_solve(&product);
        let mean = y * fit.y + known;
        let to_end = y * fit.right_solve(&Matrix::identity()).transpose();
        let mut cov = y * y.transpose();
        let mut felt = Matrix::<N, N>::zeros();
        let mut carried = Matrix::<N, N>::identity();
        for i in (1..len).rev() {
            let node = self.window.get(i);
            for row in node.rows() {
                felt += phi[i].tr_mul(&row.h) * row.h.transpose() / row.var;
            }
            let d = to_end * felt - carried;
            cov += d * node.arrive.q * d.transpose();
            felt *= node.arrive.f;
            carried *= node.arrive.f;
        }
        let cov = symmetrised(&cov);
        finite(&mean, &cov).ok().map(|()| Belief { mean, cov })
    }
}
