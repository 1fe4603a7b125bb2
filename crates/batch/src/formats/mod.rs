//! Rows of cells out of each file format.

mod contained;
mod csv;
mod ndjson;
mod parquet;

use crate::cell::Cell;
use crate::columns::Extent;
use crate::input::{Format, Input, Source};
use fixtrail_track::error::BuildError;

/// One row, by position among the names last given to [`TableSink::columns`].
pub(crate) trait Row {
    /// The cell of a column.
    fn cell(&self, column: usize) -> Cell<'_>;
}

/// Takes a table row by row.
pub(crate) trait TableSink {
    /// Takes the names of the columns and returns which of them it reads. NDJSON calls it again when a new key appears (the
    /// names so far keep their positions), and once more with [`Extent::Whole`] at the end.
    fn columns(&mut self, names: &[String], extent: Extent) -> Result<Vec<bool>, BuildError>;

    /// Takes a row; `line` is its line in a text file or its row in a Parquet file, from 1.
    fn row<R: Row>(&mut self, line: u64, row: &R) -> Result<(), BuildError>;

    /// Takes the news of a row that has no cells to speak of: the error to return, unless bad rows are skipped.
    fn malformed(&mut self, error: BuildError) -> Result<(), BuildError>;
}

/// Bytes done, bytes in all (0 when unknown).
pub(crate) type Progress<'a> = &'a mut dyn FnMut(u64, u64);

/// Rows between two calls of the progress function.
const PROGRESS_ROWS: u64 = 4096;

/// Reads the whole of `input` into `sink`.
pub(crate) fn read<S: TableSink>(
    input: &Input,
    format: Option<Format>,
    sink: &mut S,
    progress: Progress<'_>,
) -> Result<(), BuildError> {
    let source = Source::open(input, format)?;
    match source.format {
        Format::Csv => csv::read(source, sink, progress),
        Format::Ndjson => ndjson::read(source, sink, progress),
        Format::Parquet => parquet::read(source, input, sink, progress),
    }
}
