//! Flat columns of a Parquet file, row group by row group.

mod column;
pub(crate) mod groups;

use super::contained::contained;
use super::{PROGRESS_ROWS, Part, Progress, TableSink, unreadable};
use crate::columns::Extent;
use crate::input::{Input, Source};
use crate::ordered::ordered;
use bytes::Bytes;
use column::Batch;
use fixtrail_track::error::BuildError;
use parquet::errors::ParquetError;
use parquet::file::reader::{FileReader, SerializedFileReader};
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Rows decoded at a time.
const BATCH: usize = PROGRESS_ROWS as usize;

/// Reads every row group. A regular file is read in place, anything else is held in memory.
pub(super) fn read<S: TableSink>(
    source: Source<'_>,
    input: &Input,
    sink: &mut S,
    progress: Progress<'_>,
) -> Result<(), BuildError> {
    let table = Table::open(source, input)?;
    let wanted = table.columns(sink)?;
    let reader = table.reader()?;
    for group in table.groups()? {
        table.group(&*reader, &wanted, &group, sink)?;
        progress(table.done(&group), table.total);
    }
    Ok(())
}

/// Reads every row group into parts.
pub(super) fn read_parts<P: Part>(
    source: Source<'_>,
    input: &Input,
    mut part: P,
    threads: usize,
    join: &mut dyn FnMut(P::Block) -> Result<(), BuildError>,
    progress: Progress<'_>,
) -> Result<P, BuildError> {
    let table = Table::open(source, input)?;
    let wanted = table.columns(&mut part)?;
    let mut groups = table.groups()?.into_iter();
    // Where a reader stands in its file is its own.
    let worker = || (part.fork(), None);
    let work = |(part, reader): &mut (P, Option<Reader>), group: Group| {
        let result = table.opened(reader).and_then(|reader| table.group(reader, &wanted, &group, part));
        (part.cut(), result, table.done(&group))
    };
    let take = |(block, result, done): (P::Block, Result<(), BuildError>, u64)| {
        join(block)?;
        progress(done, table.total);
        result
    };
    ordered(threads, worker, || Ok(groups.next()), work, take)?;
    Ok(part)
}

fn damaged(file: &Path, line: Option<u64>, error: &ParquetError) -> BuildError {
    BuildError::new(file, line, None, format!("is no complete Parquet file, expected one: {error}"))
}

/// Reads one file.
pub(crate) type Reader = Box<dyn FileReader>;

/// A Parquet file.
struct Table<'a> {
    file: &'a Path,
    place: Place<'a>,
    /// Its size in bytes.
    total: u64,
}

/// Where its bytes are.
enum Place<'a> {
    File(&'a Path),
    Memory(Bytes),
}

/// A row group: its number among how many, the rows before it and in it.
struct Group {
    number: usize,
    of: usize,
    before: u64,
    rows: usize,
}

impl<'a> Table<'a> {
    fn open(mut source: Source<'a>, input: &'a Input) -> Result<Table<'a>, BuildError> {
        let file = source.file;
        match input {
            Input::File(path) if source.total > 0 => Ok(Table { file, place: Place::File(path), total: source.total }),
            _ => {
                let mut all = Vec::new();
                let read = source.reader.read_to_end(&mut all);
                read.map_err(|e| unreadable(file, &e))?;
                Ok(Table { file, total: all.len() as u64, place: Place::Memory(Bytes::from(all)) })
            }
        }
    }

    fn reader(&self) -> Result<Reader, BuildError> {
        let failed = |e: std::io::Error| unreadable(self.file, &e);
        let open = match &self.place {
            Place::File(path) => {
                let file = File::open(path).map_err(failed)?;
                contained(|| SerializedFileReader::new(file)).map(|reader| Box::new(reader) as Reader)
            }
            Place::Memory(bytes) => {
                contained(|| SerializedFileReader::new(bytes.clone())).map(|reader| Box::new(reader) as Reader)
            }
        };
        open.map_err(|e| damaged(self.file, None, &e))
    }

    /// Tells a sink of the columns; returns which of them it wants.
    fn columns<S: TableSink>(&self, sink: &mut S) -> Result<Vec<bool>, BuildError> {
        let schema = self.reader()?.metadata().file_metadata().schema_descr_ptr();
        // A nested column keeps its dotted path.
        let names: Vec<String> = schema.columns().iter().map(|c| c.path().string()).collect();
        let wanted = sink.columns(&names, Extent::Whole)?;
        match (0..names.len()).find(|&i| wanted[i] && schema.column(i).max_rep_level() > 0) {
            Some(i) => {
                let what = "is a repeated column, expected one value per row";
                Err(BuildError::new(self.file, None, Some(&names[i]), what))
            }
            None => Ok(wanted),
        }
    }

    /// The row groups; one has a row at least.
    fn groups(&self) -> Result<Vec<Group>, BuildError> {
        let reader = self.reader()?;
        let (mut before, mut groups) = (0, Vec::new());
        let of = reader.num_row_groups();
        for (number, group) in reader.metadata().row_groups().iter().enumerate() {
            let rows = usize::try_from(group.num_rows()).unwrap_or(0);
            groups.push(Group { number, of, before, rows });
            before += rows as u64;
        }
        match before {
            0 => Err(BuildError::new(self.file, None, None, "has columns but no rows, expected at least one")),
            _ => Ok(groups),
        }
    }

    /// Bytes that have been read after a group, about.
    fn done(&self, group: &Group) -> u64 {
        (self.total as f64 * (group.number as f64 + 1.0) / group.of as f64) as u64
    }

    /// The reader that a thread keeps.
    fn opened<'r>(&self, reader: &'r mut Option<Reader>) -> Result<&'r dyn FileReader, BuildError> {
        match reader {
            Some(reader) => Ok(&**reader),
            None => Ok(&**reader.insert(self.reader()?)),
        }
    }

    fn damaged(&self, line: u64, error: &ParquetError) -> BuildError {
        damaged(self.file, Some(line + 1), error)
    }

    /// Reads the rows of a group.
    fn group<S: TableSink>(
        &self,
        table: &dyn FileReader,
        wanted: &[bool],
        group: &Group,
        sink: &mut S,
    ) -> Result<(), BuildError> {
        let mut line = group.before;
        let open = || Batch::open(table, group.number, |i| wanted[i]);
        let mut batch = contained(open).map_err(|e| self.damaged(line, &e))?;
        let mut left = group.rows;
        while left > 0 {
            let size = left.min(BATCH);
            contained(|| batch.load(size)).map_err(|e| self.damaged(line, &e))?;
            while batch.row < size {
                let mut taken = sink.rows(line + 1, &batch);
                if taken == 0 {
                    sink.row(line + 1, &batch)?;
                    taken = 1;
                }
                batch.row += taken;
                line += taken as u64;
            }
            left -= size;
        }
        Ok(())
    }
}
