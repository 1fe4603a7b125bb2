//! A matrix of any size, as a spec carries it.

/// A matrix in row-major order.
#[derive(Clone, Debug, PartialEq)]
pub struct Mat {
    /// Number of rows.
    pub rows: usize,
    /// Number of columns.
    pub cols: usize,
    /// Entries, row by row.
    pub data: Vec<f64>,
}

impl Mat {
    /// Entry (i, j).
    ///
    /// # Panics
    /// When the entry is outside the matrix.
    pub fn at(&self, i: usize, j: usize) -> f64 {
        assert!(j < self.cols, "column {j} of a matrix with {} columns", self.cols);
        self.data[i * self.cols + j]
    }

    /// The identity.
    pub fn identity(n: usize) -> Mat {
        Mat { rows: n, cols: n, data: (0..n * n).map(|i| if i / n == i % n { 1.0 } else { 0.0 }).collect() }
    }
}
