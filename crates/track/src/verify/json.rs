//! Reading vectors with errors that name the key.

use crate::error::BuildError;
use crate::mat::Mat;
use serde_json::Value;
use std::path::Path;

/// A value and the way to it.
#[derive(Clone)]
pub(super) struct Json<'a> {
    file: &'a Path,
    path: String,
    pub(super) value: &'a Value,
}

impl<'a> Json<'a> {
    pub(super) fn root(file: &'a Path, value: &'a Value) -> Self {
        Self { file, path: String::new(), value }
    }

    pub(super) fn fail(&self, what: impl Into<String>) -> BuildError {
        let key = (!self.path.is_empty()).then_some(self.path.as_str());
        BuildError::new(self.file, None, key, what)
    }

    /// The value under `key`, `None` when there is none or it is null.
    pub(super) fn optional(&self, key: &str) -> Option<Json<'a>> {
        let value = self.value.get(key).filter(|v| !v.is_null())?;
        let path = if self.path.is_empty() { key.to_owned() } else { format!("{}.{key}", self.path) };
        Some(Json { file: self.file, path, value })
    }

    pub(super) fn get(&self, key: &str) -> Result<Json<'a>, BuildError> {
        self.optional(key).ok_or_else(|| self.fail(format!("lacks `{key}`")))
    }

    pub(super) fn list(&self) -> Result<Vec<Json<'a>>, BuildError> {
        let items = self.value.as_array().ok_or_else(|| self.fail("is not a list"))?;
        let path = |i: usize| format!("{}[{i}]", self.path);
        Ok(items.iter().enumerate().map(|(i, value)| Json { file: self.file, path: path(i), value }).collect())
    }

    pub(super) fn number(&self) -> Result<f64, BuildError> {
        self.value.as_f64().ok_or_else(|| self.fail(format!("is {}, expected a number", self.value)))
    }

    pub(super) fn count(&self) -> Result<usize, BuildError> {
        let count = self.value.as_u64().and_then(|n| usize::try_from(n).ok()).filter(|n| *n <= 100_000);
        count.ok_or_else(|| self.fail(format!("is {}, expected a whole number up to 100000", self.value)))
    }

    pub(super) fn text(&self) -> Result<&'a str, BuildError> {
        self.value.as_str().ok_or_else(|| self.fail(format!("is {}, expected a text", self.value)))
    }

    pub(super) fn numbers(&self) -> Result<Vec<f64>, BuildError> {
        self.list()?.iter().map(Json::number).collect()
    }

    /// A list of numbers some of which may be null; null for the whole list means that all are.
    pub(super) fn holed(&self, len: usize) -> Result<Vec<Option<f64>>, BuildError> {
        if self.value.is_null() {
            return Ok(vec![None; len]);
        }
        self.list()?.iter().map(|v| if v.value.is_null() { Ok(None) } else { v.number().map(Some) }).collect()
    }

    pub(super) fn matrix(&self) -> Result<Mat, BuildError> {
        let rows: Vec<Vec<f64>> = self.list()?.iter().map(Json::numbers).collect::<Result<_, _>>()?;
        let cols = rows.first().map_or(0, Vec::len);
        if rows.iter().any(|r| r.len() != cols) {
            return Err(self.fail("has rows of different lengths"));
        }
        Ok(Mat { rows: rows.len(), cols, data: rows.concat() })
    }

    /// A matrix of the given shape.
    pub(super) fn shaped(&self, rows: usize, cols: usize) -> Result<Mat, BuildError> {
        let m = self.matrix()?;
        if (m.rows, m.cols) == (rows, cols) || (rows == 0 && m.data.is_empty()) {
            Ok(m)
        } else {
            Err(self.fail(format!("is {} × {}, expected {rows} × {cols}", m.rows, m.cols)))
        }
    }
}
