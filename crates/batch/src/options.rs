//! What a reader is told, and what it counts.

use crate::input::Format;
use fixtrail_track::packet::Kind;
use std::collections::BTreeMap;

/// Sizes of a linear model's measurement and input vectors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LinearShape {
    /// Number of measurements, the rows of C.
    pub q: usize,
    /// Number of inputs, the columns of B.
    pub p_u: usize,
}

/// What the spec says about the table.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ReadOptions {
    /// `[columns]`: our column name → the file's.
    pub columns: BTreeMap<String, String>,
    /// Kind of the rows that do not name one: the spec's only kind.
    pub default_kind: Option<Kind>,
    /// Kinds to keep; rows of others are counted and otherwise ignored. `None` keeps all.
    pub kinds: Option<Vec<Kind>>,
    /// Sizes when the model is linear; without a spec they follow from the columns.
    pub linear: Option<LinearShape>,
    /// Whether packets do not say when they were sensed: rows may then stand at the time of their reception.
    pub unstamped: bool,
    /// The file's column with the probability that a row's value is new.
    pub arrival: Option<String>,
    /// Skips and counts bad rows.
    pub skip_bad_rows: bool,
    /// Format of the file; `None` goes by extension, then by the first bytes.
    pub format: Option<Format>,
    /// How late the time stamps of each kind are, seconds; subtracted.
    pub latency_s: BTreeMap<Kind, f64>,
}

/// What was seen while reading.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Rows read, of any kind, bad ones and duplicates included.
    pub rows: u64,
    /// Rows dropped because they repeat another row.
    pub duplicates: u64,
    /// Bad rows skipped.
    pub skipped_bad: u64,
    /// What was wrong with the first of them.
    pub first_bad: Option<String>,
    /// Columns that nobody asked for.
    pub ignored_columns: Vec<String>,
    /// Rows of kinds that nobody asked for.
    pub ignored_kinds: BTreeMap<String, u64>,
    /// Rows older than an earlier row of the same target.
    pub out_of_order: u64,
}
