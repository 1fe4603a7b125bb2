//! Rows of cells out of each file format.

mod alike;
mod contained;
mod csv;
pub(crate) mod decimal;
mod lines;
mod ndjson;
pub(crate) mod parquet;
pub(crate) mod spans;

use crate::cell::Cell;
use crate::columns::Extent;
use crate::input::{Format, Input, Source};
use fixtrail_track::error::BuildError;
use std::path::Path;

/// One row, by position among the names last given to [`TableSink::columns`].
pub(crate) trait Row {
    /// The cell of a column.
    fn cell(&self, column: usize) -> Cell<'_>;

    /// The finite number in a column, where that is quick to say; `None` says nothing of the cell.
    fn number(&self, column: usize) -> Option<f64>;

    /// The text in a column, trimmed and not empty, where that is quick to say; `None` says nothing of the cell.
    fn text(&self, column: usize) -> Option<&str>;

    /// The whole number in a column, where that is quick to say; `None` says nothing of the cell.
    fn whole(&self, _column: usize) -> Option<i64> {
        None
    }
}

/// Rows by column, from a row on.
pub(crate) trait Slab: Row {
    /// The numbers in a column, where every row has one.
    fn numbers(&self, column: usize) -> Option<&[f64]>;

    /// How many rows, this one among them, have the same text or whole number in a column: at least so many.
    fn alike(&self, column: usize) -> usize;
}

/// Takes a table row by row.
pub(crate) trait TableSink {
    /// Takes the names of the columns and returns which of them it reads. NDJSON calls it again when a new key appears (the
    /// names so far keep their positions), and once more with [`Extent::Whole`] at the end.
    fn columns(&mut self, names: &[String], extent: Extent) -> Result<Vec<bool>, BuildError>;

    /// Takes a row; `line` is its line in a text file or its row in a Parquet file, from 1.
    fn row<R: Row>(&mut self, line: u64, row: &R) -> Result<(), BuildError>;

    /// Takes the line at the beginning of `text` if it is a row of nothing but what almost every row is, and returns its bytes, the line feed
    /// included; `None` says nothing of the line.
    fn line(&mut self, _line: u64, _text: &[u8]) -> Option<usize> {
        None
    }

    /// Takes rows if they are nothing but what almost every row is, and returns how many; `line` is that of the first.
    fn rows<S: Slab>(&mut self, _line: u64, _slab: &S) -> usize {
        0
    }

    /// Takes the news of a row that has no cells to speak of: the error to return, unless bad rows are skipped.
    fn malformed(&mut self, error: BuildError) -> Result<(), BuildError>;
}

/// A sink for a part of a table. Parts of one table are filled side by side and put together in order.
pub(crate) trait Part: TableSink + Send {
    /// What a part has collected.
    type Block: Send;

    /// Another part of the same table, with the same columns, that has collected nothing.
    fn fork(&self) -> Self;

    /// What was collected since the last cut.
    fn cut(&mut self) -> Self::Block;
}

/// The error of a file that the system does not read.
fn unreadable(file: &Path, error: &std::io::Error) -> BuildError {
    BuildError::new(file, None, None, format!("cannot be read: {error}"))
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

/// Reads the whole of `input` in parts, side by side where the format allows it, and hands their blocks to `join` in order. Returns the sink
/// that knows the columns of the whole table.
pub(crate) fn read_parts<P: Part + Sync>(
    input: &Input,
    format: Option<Format>,
    part: P,
    join: &mut dyn FnMut(P::Block) -> Result<(), BuildError>,
    progress: Progress<'_>,
) -> Result<P, BuildError> {
    let source = Source::open(input, format)?;
    let threads = rayon::current_num_threads();
    match source.format {
        Format::Csv => csv::read_parts(source, part, threads, join, progress),
        Format::Ndjson => ndjson::read_parts(source, part, threads, join, progress),
        Format::Parquet => parquet::read_parts(source, input, part, threads, join, progress),
    }
}

/// Fills one part after the other.
fn in_turn<P: Part>(
    part: P,
    join: &mut dyn FnMut(P::Block) -> Result<(), BuildError>,
    read: impl FnOnce(&mut InTurn<'_, P>) -> Result<(), BuildError>,
) -> Result<P, BuildError> {
    let mut sink = InTurn { part, rows: 0, join };
    let result = read(&mut sink);
    let InTurn { mut part, join, .. } = sink;
    join(part.cut())?;
    result.map(|()| part)
}

/// A sink that hands on what it has every so many rows.
struct InTurn<'a, P: Part> {
    part: P,
    rows: u64,
    join: &'a mut dyn FnMut(P::Block) -> Result<(), BuildError>,
}

impl<P: Part> InTurn<'_, P> {
    fn count(&mut self) -> Result<(), BuildError> {
        self.rows += 1;
        if self.rows.is_multiple_of(PROGRESS_ROWS) { (self.join)(self.part.cut()) } else { Ok(()) }
    }
}

impl<P: Part> TableSink for InTurn<'_, P> {
    fn columns(&mut self, names: &[String], extent: Extent) -> Result<Vec<bool>, BuildError> {
        self.part.columns(names, extent)
    }

    fn row<R: Row>(&mut self, line: u64, row: &R) -> Result<(), BuildError> {
        self.part.row(line, row)?;
        self.count()
    }

    fn malformed(&mut self, error: BuildError) -> Result<(), BuildError> {
        self.part.malformed(error)?;
        self.count()
    }
}
