//! Flat columns of a Parquet file, read some thousand rows at a time.

use super::contained::contained;
use super::{PROGRESS_ROWS, Part, Progress, Row, TableSink, unreadable};
use crate::cell::Cell;
use crate::columns::Extent;
use crate::input::{Input, Source};
use crate::ordered::ordered;
use bytes::Bytes;
use fixtrail_track::error::BuildError;
use parquet::basic::{ConvertedType, LogicalType, TimeUnit, TimestampType};
use parquet::column::reader::{ColumnReader, ColumnReaderImpl};
use parquet::data_type::{ByteArray, DataType};
use parquet::errors::ParquetError;
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::schema::types::ColumnDescriptor;
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
        let result = match reader {
            Some(reader) => table.group(&**reader, &wanted, &group, part),
            None => table.reader().and_then(|opened| table.group(&**reader.insert(opened), &wanted, &group, part)),
        };
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
type Reader = Box<dyn FileReader>;

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
        // A nested column keeps its dotted path, a name that nobody asks for.
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

    /// Reads the rows of a group.
    fn group<S: TableSink>(
        &self,
        table: &dyn FileReader,
        wanted: &[bool],
        group: &Group,
        sink: &mut S,
    ) -> Result<(), BuildError> {
        let schema = table.metadata().file_metadata().schema_descr_ptr();
        let mut line = group.before;
        let damaged = |line: u64, e: &ParquetError| damaged(self.file, Some(line + 1), e);
        let columns = contained(|| table.get_row_group(group.number)).map_err(|e| damaged(line, &e))?;
        let mut batch = Batch { columns: Vec::new(), row: 0 };
        for (i, wanted) in wanted.iter().enumerate() {
            batch.columns.push(match wanted {
                false => None,
                true => {
                    let reader = contained(|| columns.get_column_reader(i)).map_err(|e| damaged(line, &e))?;
                    Some(Column::new(reader, &schema.column(i)))
                }
            });
        }
        let mut left = group.rows;
        while left > 0 {
            let size = left.min(BATCH);
            for column in batch.columns.iter_mut().flatten() {
                let read = contained(|| column.load(size)).map_err(|e| damaged(line, &e))?;
                if read != size {
                    let error = ParquetError::General(format!("a column holds {read} values where {size} belong"));
                    return Err(damaged(line, &error));
                }
            }
            for row in 0..size {
                batch.row = row;
                line += 1;
                sink.row(line, &batch)?;
            }
            left -= size;
        }
        Ok(())
    }
}

/// The current rows of all wanted columns.
struct Batch {
    columns: Vec<Option<Column>>,
    row: usize,
}

impl Row for Batch {
    fn cell(&self, column: usize) -> Cell<'_> {
        self.columns.get(column).and_then(Option::as_ref).map_or(Cell::Absent, |c| c.cell(self.row))
    }

    #[inline]
    fn number(&self, column: usize) -> Option<f64> {
        let column = self.columns.get(column)?.as_ref()?;
        match (&column.values, column.place(self.row)?) {
            (Values::Floats(v), i) => v.get(i).copied().filter(|x| x.is_finite()),
            (Values::Ints(v), i) if matches!(column.meaning, Meaning::Number) => v.get(i).map(|x| *x as f64),
            _ => None,
        }
    }

    #[inline]
    fn text(&self, column: usize) -> Option<&str> {
        let column = self.columns.get(column)?.as_ref()?;
        match &column.values {
            Values::Texts(v) => std::str::from_utf8(v.get(column.place(self.row)?)?.data()).ok().map(str::trim),
            _ => None,
        }
        .filter(|text| !text.is_empty())
    }

    #[inline]
    fn whole(&self, column: usize) -> Option<i64> {
        let column = self.columns.get(column)?.as_ref()?;
        match (&column.values, column.meaning) {
            (Values::Ints(v), Meaning::Number) => v.get(column.place(self.row)?).copied(),
            _ => None,
        }
    }
}

/// What the integers of a column count.
#[derive(Clone, Copy)]
enum Meaning {
    Number,
    /// Instants: nanoseconds per unit.
    Instant(i64),
    /// A type no column takes.
    Other(&'static str),
}

/// One column and its current values.
struct Column {
    reader: ColumnReader,
    meaning: Meaning,
    optional: bool,
    /// 1 where a value is present (optional columns).
    levels: Vec<i16>,
    /// Position of each row's value.
    places: Vec<Option<usize>>,
    values: Values,
}

/// The values present, without the nulls.
enum Values {
    Ints(Vec<i64>),
    Floats(Vec<f64>),
    Texts(Vec<ByteArray>),
    None,
}

impl Column {
    fn new(reader: ColumnReader, descriptor: &ColumnDescriptor) -> Column {
        let meaning = match (descriptor.logical_type_ref(), descriptor.converted_type()) {
            (Some(LogicalType::Timestamp(TimestampType { unit, .. })), _) => Meaning::Instant(match unit {
                TimeUnit::MILLIS => 1_000_000,
                TimeUnit::MICROS => 1_000,
                TimeUnit::NANOS => 1,
            }),
            (_, ConvertedType::TIMESTAMP_MILLIS) => Meaning::Instant(1_000_000),
            (_, ConvertedType::TIMESTAMP_MICROS) => Meaning::Instant(1_000),
            (_, ConvertedType::DECIMAL) => Meaning::Other("a DECIMAL"),
            (_, ConvertedType::DATE) => Meaning::Other("a DATE"),
            (_, ConvertedType::TIME_MILLIS | ConvertedType::TIME_MICROS) => Meaning::Other("a TIME"),
            (_, ConvertedType::INTERVAL) => Meaning::Other("an INTERVAL"),
            _ => match reader {
                ColumnReader::BoolColumnReader(_) => Meaning::Other("a Boolean"),
                ColumnReader::FixedLenByteArrayColumnReader(_) => Meaning::Other("a fixed-length byte array"),
                ColumnReader::Int96ColumnReader(_) => Meaning::Instant(1),
                _ => Meaning::Number,
            },
        };
        let optional = descriptor.max_def_level() > 0;
        Column { reader, meaning, optional, levels: Vec::new(), places: Vec::new(), values: Values::None }
    }

    /// Decodes the next `rows` rows and returns how many there were.
    fn load(&mut self, rows: usize) -> Result<usize, ParquetError> {
        self.levels.clear();
        let levels = &mut self.levels;
        let optional = self.optional;
        let (read, values) = match &mut self.reader {
            ColumnReader::BoolColumnReader(r) => (next(r, rows, optional, levels)?.0, Values::None),
            ColumnReader::FixedLenByteArrayColumnReader(r) => (next(r, rows, optional, levels)?.0, Values::None),
            ColumnReader::Int32ColumnReader(r) => {
                let (read, v) = next(r, rows, optional, levels)?;
                (read, Values::Ints(v.into_iter().map(i64::from).collect()))
            }
            ColumnReader::Int64ColumnReader(r) => {
                let (read, v) = next(r, rows, optional, levels)?;
                (read, Values::Ints(v))
            }
            ColumnReader::Int96ColumnReader(r) => {
                let (read, v) = next(r, rows, optional, levels)?;
                (read, Values::Ints(v.into_iter().map(|i| i.to_nanos()).collect()))
            }
            ColumnReader::FloatColumnReader(r) => {
                let (read, v) = next(r, rows, optional, levels)?;
                (read, Values::Floats(v.into_iter().map(f64::from).collect()))
            }
            ColumnReader::DoubleColumnReader(r) => {
                let (read, v) = next(r, rows, optional, levels)?;
                (read, Values::Floats(v))
            }
            ColumnReader::ByteArrayColumnReader(r) => {
                let (read, v) = next(r, rows, optional, levels)?;
                (read, Values::Texts(v))
            }
        };
        self.values = values;
        self.places.clear();
        let mut present = 0;
        for row in 0..read {
            let is_there = !optional || self.levels.get(row).is_some_and(|l| *l > 0);
            self.places.push(is_there.then_some(present));
            present += usize::from(is_there);
        }
        Ok(read)
    }

    /// Where the value of a row stands among those present.
    #[inline]
    fn place(&self, row: usize) -> Option<usize> {
        self.places.get(row).copied().flatten()
    }

    fn cell(&self, row: usize) -> Cell<'_> {
        let Some(i) = self.place(row) else { return Cell::Absent };
        match (self.meaning, &self.values) {
            (Meaning::Other(what), _) => Cell::Other(what),
            (Meaning::Instant(unit_ns), Values::Ints(v)) => match v.get(i).and_then(|x| x.checked_mul(unit_ns)) {
                Some(ns) => Cell::Utc(ns),
                None => Cell::Other("a time outside the years 1678 to 2261"),
            },
            (_, Values::Ints(v)) => v.get(i).map_or(Cell::Absent, |x| Cell::Int(*x)),
            (_, Values::Floats(v)) => v.get(i).map_or(Cell::Absent, |x| Cell::Float(*x)),
            (_, Values::Texts(v)) => match v.get(i).map(|b| std::str::from_utf8(b.data())) {
                Some(Ok(text)) => Cell::text(text),
                Some(Err(_)) => Cell::Other("bytes that are not UTF-8"),
                None => Cell::Absent,
            },
            (_, Values::None) => Cell::Absent,
        }
    }
}

/// The next values of a flat column and the number of rows they belong to.
fn next<D: DataType>(
    reader: &mut ColumnReaderImpl<D>,
    rows: usize,
    optional: bool,
    levels: &mut Vec<i16>,
) -> Result<(usize, Vec<D::T>), ParquetError> {
    let mut values = Vec::with_capacity(rows);
    let (read, _, _) = reader.read_records(rows, optional.then_some(levels), None, &mut values)?;
    Ok((read, values))
}
