//! Where the rows of each target stand in a Parquet file that keeps them together.

use super::column::Batch;
use super::{Group, Reader, Table};
use crate::formats::spans::{Listing, Span, Stop};
use crate::formats::{Part, Progress, Row, TableSink};
use crate::input::{Format, Input, Source};
use crate::names::Names;
use crate::ordered::ordered;
use fixtrail_track::error::BuildError;
use parquet::errors::ParquetError;
use std::ops::Range;

/// The spans of a file, in its order; each stands in one row group.
pub(crate) struct Groups<'a> {
    pub list: Vec<Span>,
    table: Table<'a>,
    wanted: Vec<bool>,
    groups: Vec<Group>,
}

/// Names, each with the number of rows that it stands in one after the other.
type Runs = Vec<(String, u64)>;

/// Rows from one look at a name to the next.
const STEP: usize = 64;

impl<'a> Groups<'a> {
    /// Looks through a Parquet file and gives `part` its columns; `target` says which of them names the target, `targets` takes the names. `None`
    /// for a file of another format, where a span has fewer than `fewest_rows` rows on average, and where a target has no name.
    ///
    /// # Errors
    /// [`BuildError`] when the file cannot be read, or from `part`.
    pub fn of<P: Part>(
        input: &'a Input,
        format: Option<Format>,
        part: &mut P,
        target: impl Fn(&P) -> Option<usize>,
        (targets, fewest_rows): (&Names, u64),
        progress: Progress<'_>,
    ) -> Result<Option<Groups<'a>>, BuildError> {
        let source = Source::open(input, format)?;
        if source.format != Format::Parquet {
            return Ok(None);
        }
        let table = Table::open(source, input)?;
        let wanted = table.columns(part)?;
        let Some(column) = target(part) else { return Ok(None) };
        let groups = table.groups()?;
        let mut each = groups.iter();
        let work = |reader: &mut Option<Reader>, group: &Group| {
            let found = table.opened(reader).and_then(|reader| {
                let names = || Batch::open(reader, group.number, |i| i == column);
                let fewest = |runs: usize| {
                    fewest_rows.saturating_mul((runs as u64).saturating_sub(1)) <= group.before + group.rows as u64
                };
                let look = || runs(names()?, names()?, (column, group.rows), fewest);
                super::contained(look).map_err(|e| table.damaged(group.before, &e))
            });
            found.map(|found| (found, table.done(group)))
        };
        let mut list = Listing::new(targets, fewest_rows, 1);
        let take = |worked: Result<(Option<Runs>, u64), BuildError>| {
            let (found, done) = worked.map_err(Stop::Failed)?;
            for (i, (name, rows)) in found.ok_or(Stop::Apart)?.into_iter().enumerate() {
                list.add(&name, rows, i > 0);
            }
            progress(done, table.total);
            list.check()
        };
        let found = ordered(rayon::current_num_threads(), || None, || Ok(each.next()), work, take);
        Ok(list.finish(found)?.map(|list| Groups { list, table, wanted, groups }))
    }

    /// How many row groups there are.
    pub fn len(&self) -> usize {
        self.groups.len()
    }

    /// Rows of a row group.
    pub fn rows(&self, group: usize) -> usize {
        self.groups[group].rows
    }

    /// The row group of a span, and which of its rows these are.
    pub fn place(&self, span: &Span) -> (usize, Range<usize>) {
        let row = span.line - 1;
        let group = self.groups.partition_point(|group| group.before <= row) - 1;
        let first = (row - self.groups[group].before) as usize;
        (group, first..first + span.lines as usize)
    }

    /// Reads the rows of a row group into `sink`. `reader` is what a thread keeps.
    ///
    /// # Errors
    /// [`BuildError`] when the file cannot be read, and from `sink`.
    pub fn read<S: TableSink>(
        &self,
        group: usize,
        reader: &mut Option<Reader>,
        sink: &mut S,
    ) -> Result<(), BuildError> {
        self.table.group(self.table.opened(reader)?, &self.wanted, &self.groups[group], sink)
    }
}

/// The runs of a row group; `None` where there is a row without a name, or more runs than are `allowed`.
///
/// Only every 64th row is looked at, and all rows between two that differ: what stands between two rows of one target is taken to be its
/// own. `coarse` and `fine` read the same column.
fn runs(
    mut coarse: Batch,
    mut fine: Batch,
    (column, rows): (usize, usize),
    allowed: impl Fn(usize) -> bool,
) -> Result<Option<Runs>, ParquetError> {
    let mut runs: Runs = Vec::new();
    let add = |runs: &mut Runs, name: &str, rows: u64| match runs.last_mut() {
        Some((last, n)) if last == name => *n += rows,
        _ => runs.push((name.to_owned(), rows)),
    };
    let (mut last, mut looked, mut refined) = (String::new(), 0, 0);
    while looked < rows {
        // The row that is looked at next is the last of these.
        let step = if looked == 0 { 1 } else { STEP.min(rows - looked) };
        coarse.skip(step - 1)?;
        coarse.load(1)?;
        let Some(name) = name(&coarse, column) else { return Ok(None) };
        if looked > 0 && name == last {
            add(&mut runs, &name, step as u64);
        } else {
            fine.skip(looked - refined)?;
            fine.load(step)?;
            refined = looked + step;
            for row in 0..step {
                fine.row = row;
                let Some(name) = self::name(&fine, column) else { return Ok(None) };
                add(&mut runs, &name, 1);
            }
            last = name;
        }
        looked += step;
        if !allowed(runs.len()) {
            return Ok(None);
        }
    }
    Ok(Some(runs))
}

/// The name of a target as its row will say it; `None` where that takes a closer look.
fn name(batch: &Batch, column: usize) -> Option<String> {
    match batch.text(column) {
        Some(name) => Some(name.to_owned()),
        None => batch.whole(column).map(|number| number.to_string()),
    }
}
