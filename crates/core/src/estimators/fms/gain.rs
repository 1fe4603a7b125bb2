//! The gain of a time-invariant window: computed once by the adjoint of the exact-diffuse pass, applied as dot products.
//!
//! `x̂ = K_z Z + K_u U` for the filter and for the smoother side by side, each row of the window a pair of columns. The adjoint Λ of
//! the estimate with respect to the pass's mean goes backwards through the window (`Y = X S⁻¹` at the end):
//!
//! ```text
//! row    g = Λ k + k_lag + Y E/f        (column of K_z),    Λ −= g hᵀ
//! leap   K_u = Λ B,                                          Λ = Λ F
//! ```

use crate::estimators::diffuse::{Diffuse, Joint, Taken};
use crate::estimators::fms::Align;
use crate::storage::Store;
use crate::types::{Matrix, Row, StepError, Transition, Vector};

/// The time-invariant model of a window: x⁺ = A x + B u + noise(q), z = rows x + noise; rows of unit variance.
#[derive(Clone, Copy, Debug)]
pub struct Invariant<'a, const N: usize> {
    /// A, and G Q Gᵀ.
    pub leap: &'a Transition<N>,
    /// Whitened rows of C.
    pub rows: &'a [Vector<N>],
    /// Columns of B.
    pub b: &'a [Vector<N>],
}

/// Shape of the window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    /// Instants with measurements.
    pub window: usize,
    /// How many instants before the estimated one the smoother stands.
    pub lag: usize,
    /// Where the window ends.
    pub align: Align,
}

impl Shape {
    /// Number of leaps between the oldest instant and the estimated one.
    pub fn leaps(&self) -> usize {
        match self.align {
            Align::Filtered => self.window - 1,
            Align::Predicted => self.window,
        }
    }

    /// Index of the lagged instant within the window, the oldest is 0.
    pub fn lagged(&self) -> Option<usize> {
        self.leaps().checked_sub(self.lag)
    }
}

/// One column of the gain: what a scalar of the window adds to the filter and to the smoother.
pub type Column<const N: usize> = (Vector<N>, Vector<N>);

/// A gain and the joint covariance that it reaches.
#[derive(Clone)]
pub struct Gain<const N: usize, S: Store> {
    /// Columns of K_z: oldest instant first, the rows of an instant in order.
    pub z: S::Of<Column<N>>,
    /// Columns of K_u: oldest leap first, the columns of B in order.
    pub u: S::Of<Column<N>>,
    /// Means for z = 0 and u = 0, and the joint covariance; both estimates are determined.
    pub joint: Joint<N>,
    /// How many instants before the estimated one the smoother stands: at 0 it is the filter.
    pub lag: usize,
}

impl<const N: usize, S: Store> Gain<N, S> {
    /// Designs the gain. `Ok(None)` when the full window does not determine both estimates, or the store has no room.
    ///
    /// # Errors
    /// As [`Diffuse::update`].
    pub fn design(model: &Invariant<'_, N>, shape: Shape) -> Result<Option<Self>, StepError> {
        let q = model.rows.len();
        let (m, leaps) = (shape.window, shape.leaps());
        let Some(lagged) = shape.lagged() else { return Ok(None) };
        let zero = (Vector::zeros(), Vector::zeros());
        let (Some(mut z), Some(mut u), Some(mut taken)) =
            (S::filled(m * q, zero), S::filled(leaps * model.b.len(), zero), S::filled(m * q, Taken::<N>::zero()))
        else {
            return Ok(None);
        };
        let mut pass = Diffuse::start();
        let offset = Vector::zeros();
        for i in 0..=leaps {
            if i > 0 {
                pass.leap(&model.leap.f, &offset, &model.leap.q);
            }
            if i == lagged {
                pass.mark_lag();
            }
            if i < m {
                for (r, h) in model.rows.iter().enumerate() {
                    taken.as_mut()[i * q + r] = pass.update(&Row { h: *h, residual: 0.0, var: 1.0 })?;
                }
            }
        }
        let joint = pass.solve();
        if joint.filter.is_none() || joint.lagged.is_none() || !pass.determines_start() {
            return Ok(None);
        }
        // Y = X S⁻¹ = (X R⁻¹) R⁻ᵀ, as the least squares hold Rᵀ R = S.
        let (x, x_lag) = pass.responses();
        let inverse = pass.info.right_solve(&Matrix::identity());
        let y = pass.info.right_solve(&x) * inverse.transpose();
        let y_lag = pass.info.right_solve(&x_lag) * inverse.transpose();
        let mut adjoint = Matrix::<N, N>::identity();
        let mut adjoint_lag = Matrix::<N, N>::zeros();
        for i in (0..=leaps).rev() {
            if i < m {
                for r in (0..q).rev() {
                    let t = &taken.as_ref()[i * q + r];
                    let weight = t.e_x / t.f;
                    let g = adjoint * t.gain + y * weight;
                    let g_lag = adjoint_lag * t.gain + t.gain_lag + y_lag * weight;
                    adjoint -= g * t.h.transpose();
                    adjoint_lag -= g_lag * t.h.transpose();
                    z.as_mut()[i * q + r] = (g, g_lag);
                }
            }
            if i == lagged {
                adjoint_lag += Matrix::identity();
            }
            if i > 0 {
                for (c, b) in model.b.iter().enumerate() {
                    u.as_mut()[(i - 1) * model.b.len() + c] = (adjoint * b, adjoint_lag * b);
                }
                adjoint *= model.leap.f;
                adjoint_lag *= model.leap.f;
            }
        }
        Ok(Some(Self { z, u, joint, lag: shape.lag }))
    }

    /// Returns the means of filter and smoother for the window's data, oldest first: `q` values per instant, then the inputs.
    #[inline]
    pub fn apply(&self, z: &[f64], u: &[f64]) -> Column<N> {
        let (columns, inputs) = (self.z.as_ref(), self.u.as_ref());
        if self.lag == 0 {
            let [filter] = add(weighed(columns, z), weighed(inputs, u));
            return (filter, filter);
        }
        let [filter, lagged] = add(weighed(columns, z), weighed(inputs, u));
        (filter, lagged)
    }
}

/// The sums of columns times their values: of the filter, and of `PARTS` = 2 of the smoother.
#[inline(always)]
fn weighed<const N: usize, const PARTS: usize>(columns: &[Column<N>], values: &[f64]) -> [Vector<N>; PARTS] {
    let count = columns.len().min(values.len());
    let (column_pairs, last_column) = columns[..count].as_chunks::<2>();
    let (value_pairs, last_value) = values[..count].as_chunks::<2>();
    // Two sums, for each addition waits for the last.
    let (mut even, mut odd) = ([Vector::zeros(); PARTS], [Vector::zeros(); PARTS]);
    let into = |sums: &mut [Vector<N>; PARTS], column: &Column<N>, value: f64| {
        sums[0] += column.0 * value;
        if PARTS > 1 {
            sums[PARTS - 1] += column.1 * value;
        }
    };
    for (columns, values) in column_pairs.iter().zip(value_pairs) {
        into(&mut even, &columns[0], values[0]);
        into(&mut odd, &columns[1], values[1]);
    }
    for (column, value) in last_column.iter().zip(last_value) {
        into(&mut even, column, *value);
    }
    add(even, odd)
}

#[inline(always)]
fn add<const N: usize, const PARTS: usize>(a: [Vector<N>; PARTS], b: [Vector<N>; PARTS]) -> [Vector<N>; PARTS] {
    core::array::from_fn(|part| a[part] + b[part])
}
