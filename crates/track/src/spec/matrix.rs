//! Matrices and vectors of a spec, and the checks that make one a covariance.

use super::value::Field;
use crate::error::BuildError;
use crate::mat::Mat;
use nalgebra::SMatrix;

/// Largest number of states of a linear model.
pub const MAX_STATE: usize = 12;
/// Largest number of measurement components of a linear model.
pub const MAX_MEASUREMENT: usize = 6;
/// Largest number of inputs and of noise components of a linear model.
pub const MAX_INPUT: usize = 12;

/// Largest difference of two entries that count as equal, relative to √(m_ii m_jj), which bounds every entry of a
/// covariance: covariances printed with ten digits pass.
const ENTRY_TOLERANCE: f64 = 1e-9;

/// Smallest eigenvalue of a measurement covariance once scaled to unit diagonal. Whitening divides rounding errors
/// (1e-16) by it, so four digits are left at worst; less means that two components are one.
const SMALLEST_POSITIVE: f64 = 1e-12;

/// What a covariance has to be.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Definite {
    /// Positive semidefinite: Q, P0.
    Semi,
    /// Positive definite: R.
    Strictly,
}

impl Definite {
    fn name(self) -> &'static str {
        match self {
            Definite::Semi => "positive semidefinite",
            Definite::Strictly => "positive definite",
        }
    }
}

/// "2 × 3".
pub(super) fn shape(m: &Mat) -> String {
    format!("{} × {}", m.rows, m.cols)
}

/// The vector of `n` finite numbers in `field`; `of` says what has `n` of them.
pub(super) fn vector(field: &Field<'_>, n: usize, of: &str) -> Result<Vec<f64>, BuildError> {
    let expected = format!("a list of {n}, {of}");
    let entries = field.list(&expected)?;
    if entries.len() != n {
        return Err(field.misfit(expected));
    }
    entries.iter().map(number).collect()
}

/// The rectangular matrix of finite numbers in `field`.
pub(super) fn matrix(field: &Field<'_>) -> Result<Mat, BuildError> {
    let expected = "a matrix, a list of rows such as [[1.0, 0.0], [0.0, 1.0]]";
    let mut cols = None;
    let mut data = Vec::new();
    let rows = field.list(expected)?;
    for row in &rows {
        let entries = row.list("a row of numbers")?;
        let first = *cols.get_or_insert(entries.len());
        if entries.len() != first {
            return Err(row.error(format!("has {}, expected {first} as in the first row", number_of(entries.len()))));
        }
        for entry in &entries {
            data.push(number(entry)?);
        }
    }
    Ok(Mat { rows: rows.len(), cols: cols.unwrap_or(0), data })
}

fn number_of(entries: usize) -> String {
    if entries == 1 { "1 entry".to_owned() } else { format!("{entries} entries") }
}

fn number(entry: &Field<'_>) -> Result<f64, BuildError> {
    entry.number("a finite number", |_| true)
}

/// The covariance in `field`: square with at most `most` rows, symmetric, and positive definite or semidefinite.
///
/// Tests are made on the matrix scaled to unit diagonal, so units do not matter. Differences within
/// [`ENTRY_TOLERANCE`] are averaged away; an error of that size in each of n × n entries moves an eigenvalue by at most
/// n times it, which is what a semidefinite matrix is allowed.
pub(super) fn covariance(field: &Field<'_>, most: usize, definite: Definite) -> Result<Mat, BuildError> {
    let mut m = matrix(field)?;
    let n = m.rows;
    if m.cols != n || n > most.min(MAX_STATE) {
        return Err(field.error(format!("is {}, expected a square matrix of at most {most} rows", shape(&m))));
    }
    let entry = |i: usize, j: usize| field.elements()?.get(i)?.elements()?.get(j).cloned();
    let at = |i: usize, j: usize, what: String| entry(i, j).as_ref().unwrap_or(field).error(what);
    for i in 0..n {
        let v = m.at(i, i);
        if v < 0.0 || (v == 0.0 && definite == Definite::Strictly) {
            let bound = if definite == Definite::Semi { "at least 0" } else { "a positive number" };
            let what = format!("is {v:?}, expected {bound} on the diagonal of a {} matrix", definite.name());
            return Err(at(i, i, what));
        }
    }
    // Padding with the identity changes nothing: the smallest eigenvalue of a unit diagonal is at most 1.
    let mut scaled = SMatrix::<f64, MAX_STATE, MAX_STATE>::identity();
    for i in 0..n {
        for j in 0..i {
            let (upper, lower) = (m.at(j, i), m.at(i, j));
            let bound = m.at(i, i).sqrt() * m.at(j, j).sqrt();
            if (upper - lower).abs() > ENTRY_TOLERANCE * bound {
                return Err(at(i, j, format!("is {lower:?}, expected {upper:?} as [{j}][{i}] of a symmetric matrix")));
            }
            let mean = if upper == lower { upper } else { 0.5 * upper + 0.5 * lower };
            if mean.abs() > bound * (1.0 + ENTRY_TOLERANCE) {
                let (a, b) = (m.at(j, j), m.at(i, i));
                return Err(at(
                    j,
                    i,
                    format!(
                        "is {mean:?}, expected at most {bound:?} in size: with {a:?} and {b:?} on the diagonal the matrix \
                         is not {}",
                        definite.name()
                    ),
                ));
            }
            (m.data[i * n + j], m.data[j * n + i]) = (mean, mean);
            let r = if bound > 0.0 { mean / bound } else { 0.0 };
            (scaled[(i, j)], scaled[(j, i)]) = (r, r);
        }
    }
    let smallest = scaled.symmetric_eigenvalues().min();
    let least = match definite {
        Definite::Semi => -(n as f64) * ENTRY_TOLERANCE,
        Definite::Strictly => SMALLEST_POSITIVE,
    };
    if smallest.is_nan() || smallest < least {
        return Err(field.error(format!(
            "has the eigenvalue {smallest:.3e} once scaled to unit diagonal, expected a {} matrix",
            definite.name()
        )));
    }
    Ok(m)
}
