//! Rows of cells out of each file format.

mod contained;
mod csv;
pub(crate) mod decimal;
mod lines;
mod ndjson;
mod parquet;

use crate::cell::Cell;
use crate::columns::Extent;
use crate::input::{Format, Input, Source};
use crate::ordered::ordered;
use fixtrail_track::error::BuildError;
use std::cell::RefCell;
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

/// What the blocks of a table are put together by, in order.
pub(crate) trait Joiner {
    /// A part's block.
    type Block: Send;
    /// Work of its own that what it has may come to.
    type Job: Send;
    /// What comes of a job.
    type Done: Send;
    /// Why it does not want to go on.
    type Error: From<BuildError>;

    /// Takes the next block.
    fn join(&mut self, block: Self::Block) -> Result<(), Self::Error>;

    /// The next job, if one is ready: jobs are done beside the reading.
    fn job(&mut self) -> Option<Self::Job>;

    /// Does a job.
    fn work(job: Self::Job) -> Self::Done;

    /// Takes what came of the next job.
    fn done(&mut self, done: Self::Done) -> Result<(), Self::Error>;
}

/// Reads the whole of `input` in parts, side by side where the format allows it, and hands their blocks to `joiner` in order. Returns the sink
/// that knows the columns of the whole table. Some jobs of the joiner may be left.
pub(crate) fn read_parts<P: Part, J: Joiner<Block = P::Block>>(
    input: &Input,
    format: Option<Format>,
    part: P,
    joiner: &mut J,
    progress: Progress<'_>,
) -> Result<P, J::Error> {
    let source = Source::open(input, format)?;
    match source.format {
        Format::Csv => csv::read_parts(source, part, joiner, progress),
        Format::Ndjson => in_turn(part, joiner, |sink| ndjson::read(source, sink, progress)),
        Format::Parquet => in_turn(part, joiner, |sink| parquet::read(source, input, sink, progress)),
    }
}

/// Parses the pieces that `next` hands out side by side, the jobs of `joiner` among them. `settle` sees what comes of each piece, in order: the
/// block that is joined, and whether to go on.
fn side_by_side<P: Part, I: Send, O: Send, J: Joiner<Block = P::Block>>(
    part: &P,
    mut next: impl FnMut() -> Result<Option<I>, BuildError>,
    parse: impl Fn(&mut P, I) -> O + Sync,
    mut settle: impl FnMut(O) -> (P::Block, Result<(), BuildError>),
    joiner: &mut J,
) -> Result<(), J::Error> {
    enum Task<P, J> {
        Piece(P),
        Job(J),
    }
    let joiner = RefCell::new(joiner);
    let next = || match joiner.borrow_mut().job() {
        Some(job) => Ok(Some(Task::Job(job))),
        None => Ok(next()?.map(Task::Piece)),
    };
    let work = |part: &mut P, task: Task<I, J::Job>| match task {
        Task::Piece(piece) => Task::Piece(parse(part, piece)),
        Task::Job(job) => Task::Job(J::work(job)),
    };
    let take = |task: Task<O, J::Done>| match task {
        Task::Job(done) => joiner.borrow_mut().done(done),
        Task::Piece(parsed) => {
            let (block, result) = settle(parsed);
            joiner.borrow_mut().join(block)?;
            Ok(result?)
        }
    };
    ordered(rayon::current_num_threads(), || part.fork(), next, work, take)
}

/// Fills one part after the other.
fn in_turn<P: Part, J: Joiner<Block = P::Block>>(
    part: P,
    joiner: &mut J,
    read: impl FnOnce(&mut InTurn<'_, P, J>) -> Result<(), BuildError>,
) -> Result<P, J::Error> {
    let mut sink = InTurn { part, rows: 0, joiner, refused: None };
    let result = read(&mut sink);
    let InTurn { mut part, joiner, refused, .. } = sink;
    if let Some(error) = refused {
        return Err(error);
    }
    joiner.join(part.cut())?;
    result?;
    Ok(part)
}

/// A sink that hands on what it has every so many rows.
struct InTurn<'a, P: Part, J: Joiner> {
    part: P,
    rows: u64,
    joiner: &'a mut J,
    /// Why the joiner does not want to go on.
    refused: Option<J::Error>,
}

impl<P: Part, J: Joiner<Block = P::Block>> InTurn<'_, P, J> {
    fn count(&mut self) -> Result<(), BuildError> {
        self.rows += 1;
        if !self.rows.is_multiple_of(PROGRESS_ROWS) {
            return Ok(());
        }
        self.hand_on().map_err(|error| {
            self.refused = Some(error);
            // Ends the reading; the error that counts is the joiner's.
            BuildError::new(Path::new(""), None, None, "is not read to its end")
        })
    }

    fn hand_on(&mut self) -> Result<(), J::Error> {
        self.joiner.join(self.part.cut())?;
        while let Some(job) = self.joiner.job() {
            self.joiner.done(J::work(job))?;
        }
        Ok(())
    }
}

impl<P: Part, J: Joiner<Block = P::Block>> TableSink for InTurn<'_, P, J> {
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
