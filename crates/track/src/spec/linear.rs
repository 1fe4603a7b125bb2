//! The matrices of a linear model, fixed or step by step.

use super::matrix::{Definite, MAX_INPUT, MAX_MEASUREMENT, MAX_STATE, covariance, matrix, shape};
use super::model::prior;
use super::sequence;
use super::value::Table;
use super::{LinearSpec, LinearStep};
use crate::error::BuildError;
use crate::mat::Mat;
use std::path::Path;

/// The keys of a step.
pub(super) const STEP_KEYS: [&str; 6] = ["A", "B", "G", "C", "Q", "R"];

/// Fetches the files that a spec names.
pub(super) type Sources<'r> = dyn FnMut(&Path) -> std::io::Result<Vec<u8>> + 'r;

/// The model in `table`, its steps from the file it names.
pub(super) fn linear(table: &Table<'_>, whose: &str, sources: &mut Sources<'_>) -> Result<LinearSpec, BuildError> {
    table.only(whose, &["kind", "A", "B", "G", "C", "Q", "R", "x0", "P0", "S0", "sequence"], &[])?;
    let given = Matrices::read(table)?;
    let (base, sequence) = match table.get("sequence") {
        None => (given.complete(table, "")?, Vec::new()),
        Some(field) => sequence::read(&field, table.file(), &given, sources)?,
    };
    let prior = prior(table, base.a.rows)?;
    Ok(LinearSpec { base, sequence, prior })
}

/// What a table says of a step: each matrix by itself is well formed, together they may not be.
#[derive(Clone, Default)]
pub(super) struct Matrices {
    a: Option<Mat>,
    pub(super) b: Option<Mat>,
    g: Option<Mat>,
    c: Option<Mat>,
    q: Option<Mat>,
    r: Option<Mat>,
}

impl Matrices {
    /// The matrices that `table` has.
    pub(super) fn read(table: &Table<'_>) -> Result<Matrices, BuildError> {
        let general = |key: &str| table.get(key).map(|field| matrix(&field)).transpose();
        let cov = |key: &str, most: usize, definite: Definite| {
            table.get(key).map(|field| covariance(&field, most, definite)).transpose()
        };
        Ok(Matrices {
            a: general("A")?,
            b: general("B")?,
            g: general("G")?,
            c: general("C")?,
            q: cov("Q", MAX_INPUT, Definite::Semi)?,
            r: cov("R", MAX_MEASUREMENT, Definite::Strictly)?,
        })
    }

    /// These, and those of `base` where there are none.
    pub(super) fn over(self, base: &Matrices) -> Matrices {
        let or = |own: Option<Mat>, other: &Option<Mat>| own.or_else(|| other.clone());
        Matrices {
            a: or(self.a, &base.a),
            b: or(self.b, &base.b),
            g: or(self.g, &base.g),
            c: or(self.c, &base.c),
            q: or(self.q, &base.q),
            r: or(self.r, &base.r),
        }
    }

    /// Whether every matrix that has no default is there.
    pub(super) fn is_whole(&self) -> bool {
        self.a.is_some() && self.c.is_some() && self.q.is_some() && self.r.is_some()
    }

    /// The step these matrices make, which all come from `table` or its base; `why` follows what is said of a missing one.
    pub(super) fn complete(self, table: &Table<'_>, why: &str) -> Result<LinearStep, BuildError> {
        let missing = |key: &str, what: &str| table.missing(key, format!("{what}{why}"));
        let wrong =
            |key: &str, m: &Mat, expected: String| table.error(key, format!("is {}, expected {expected}", shape(m)));
        let a = self.a.ok_or_else(|| missing("A", "an n × n matrix"))?;
        let n = a.rows;
        if a.cols != n || n > MAX_STATE {
            return Err(wrong("A", &a, format!("n × n with at most {MAX_STATE} states")));
        }
        let c = self.c.ok_or_else(|| missing("C", "a q × n matrix"))?;
        if c.cols != n || c.rows > MAX_MEASUREMENT {
            let expected = format!("q × {n} with q at most {MAX_MEASUREMENT}, as `A` is {}", shape(&a));
            return Err(wrong("C", &c, expected));
        }
        let tall = |key: &str, letter: &str, m: &Mat| {
            if m.rows == n && m.cols <= MAX_INPUT {
                return Ok(());
            }
            Err(wrong(key, m, format!("{n} × {letter} with {letter} at most {MAX_INPUT}, as `A` is {}", shape(&a))))
        };
        let b = self.b.unwrap_or(Mat { rows: n, cols: 0, data: Vec::new() });
        tall("B", "p", &b)?;
        let default_g = self.g.is_none();
        let g = self.g.unwrap_or_else(|| Mat::identity(n));
        tall("G", "p", &g)?;
        let q = self.q.ok_or_else(|| missing("Q", "the p × p covariance of the process noise"))?;
        if q.rows != g.cols {
            let by_default = if default_g { " by default" } else { "" };
            return Err(wrong("Q", &q, format!("{p} × {p}, as `G` is {}{by_default}", shape(&g), p = g.cols)));
        }
        let r = self.r.ok_or_else(|| missing("R", "the q × q covariance of the measurement noise"))?;
        if r.rows != c.rows {
            return Err(wrong("R", &r, format!("{q} × {q}, as `C` is {}", shape(&c), q = c.rows)));
        }
        Ok(LinearStep { a, b, g, c, q, r })
    }
}
