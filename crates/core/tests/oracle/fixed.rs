//! The oracle's matrices at a fixed size, and storage from the heap.

use super::{Instant, Posterior};
use fixtrail_core::storage::Store;
use fixtrail_core::{Belief, Matrix, Row, Transition, Vector, linalg};
use nalgebra::{DMatrix, DVector};

/// Boxes of any length.
pub struct Heap;

impl Store for Heap {
    type Of<T: Copy> = Box<[T]>;

    fn filled<T: Copy>(len: usize, value: T) -> Option<Box<[T]>> {
        Some(vec![value; len].into_boxed_slice())
    }
}

pub fn square<const N: usize>(m: &DMatrix<f64>) -> Matrix<N, N> {
    assert_eq!(m.shape(), (N, N));
    Matrix::from_fn(|i, j| m[(i, j)])
}

pub fn rows_of<const N: usize>(m: &DMatrix<f64>) -> Vec<Vector<N>> {
    (0..m.nrows()).map(|i| Vector::from_fn(|j, _| m[(i, j)])).collect()
}

pub fn columns_of<const N: usize>(m: &DMatrix<f64>) -> Vec<Vector<N>> {
    (0..m.ncols()).map(|j| Vector::from_fn(|i, _| m[(i, j)])).collect()
}

pub fn row_major(m: &DMatrix<f64>) -> Vec<f64> {
    m.transpose().as_slice().to_vec()
}

/// `G Q Gᵀ`, symmetric to the bit.
pub fn noise<const N: usize>(at: &Instant) -> Matrix<N, N> {
    linalg::symmetrised(&square(&(&at.g * &at.q * at.g.transpose())))
}

/// The leap that leads from `from`, linearised at 0; standing still before the first instant.
pub fn leap<const N: usize>(from: Option<&Instant>) -> Transition<N> {
    match from {
        Some(at) => {
            let next = &at.b * DVector::from_column_slice(&at.u);
            Transition { next: Vector::from_fn(|i, _| next[i]), f: square(&at.a), q: noise(at) }
        }
        None => Transition { next: Vector::zeros(), f: Matrix::identity(), q: Matrix::zeros() },
    }
}

/// The whitened rows of an instant, linearised at 0.
pub fn rows<const N: usize>(at: &Instant) -> Vec<Row<N>> {
    let got: Vec<usize> = (0..at.z.len()).filter(|i| at.z[*i].is_some()).collect();
    let mut rows: Vec<Row<N>> = got
        .iter()
        .map(|i| Row { h: Vector::from_fn(|j, _| at.c[(*i, j)]), residual: at.z[*i].unwrap_or(0.0), var: 1.0 })
        .collect();
    let mut r = row_major(&at.r.select_rows(&got).select_columns(&got));
    assert!(linalg::whiten(&mut rows, &mut r));
    rows
}

pub fn posterior<const N: usize>(belief: &Belief<N>) -> Posterior {
    Posterior {
        mean: DVector::from_fn(N, |i, _| belief.mean[i]),
        cov: DMatrix::from_fn(N, N, |i, j| belief.cov[(i, j)]),
    }
}

/// Worst deviation of a belief from the truth, as [`super::deviation`].
pub fn deviation<const N: usize>(belief: &Belief<N>, truth: &Posterior) -> f64 {
    super::deviation(belief.mean.as_slice(), |i, j| belief.cov[(i, j)], truth)
}
