//! Errors at the edges: a spec or a table that cannot be used, and a step that cannot be taken.

use std::path::PathBuf;

/// Where in a file something is wrong.
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub struct Place {
    /// The file, `-` for standard input.
    pub file: PathBuf,
    /// Line of a text file or row of a Parquet file, from 1.
    pub line: Option<u64>,
    /// Key of a spec (`model.Q[1][0]`) or column of a table.
    pub key: Option<String>,
}

impl core::fmt::Display for Place {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{}", self.file.display())?;
        if let Some(line) = self.line {
            write!(f, ":{line}")?;
        }
        match &self.key {
            Some(key) => write!(f, ": `{key}`"),
            None => Ok(()),
        }
    }
}

/// A spec or a table that cannot be used: one sentence with place, value and expectation. Exit code 2.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{place}: {what}")]
pub struct BuildError {
    /// Where.
    pub place: Place,
    /// The offending value and what was expected: "is -1, expected a positive number of seconds".
    pub what: String,
}

impl BuildError {
    /// An error at `file`, `line` and `key`.
    pub fn new(file: impl Into<PathBuf>, line: Option<u64>, key: Option<&str>, what: impl Into<String>) -> BuildError {
        BuildError { place: Place { file: file.into(), line, key: key.map(str::to_owned) }, what: what.into() }
    }
}

/// A step that cannot be taken; the tracker's state is as before it. The edge adds file and line.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum StepError {
    /// The mathematics refused the step.
    #[error("{0}")]
    Core(fixtrail_core::StepError),
    /// A packet does not fit the model.
    #[error("{0}")]
    Misfit(String),
}
