//! Flat columns of a Parquet file, read some thousand rows at a time.

use super::contained::contained;
use super::{PROGRESS_ROWS, Progress, Row, TableSink};
use crate::cell::Cell;
use crate::columns::Extent;
use crate::input::{Input, Source};
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
    mut source: Source<'_>,
    input: &Input,
    sink: &mut S,
    progress: Progress<'_>,
) -> Result<(), BuildError> {
    let file = source.file;
    let failed = |e: std::io::Error| BuildError::new(file, None, None, format!("cannot be read: {e}"));
    match input {
        Input::File(path) if source.total > 0 => {
            let file_bytes = File::open(path).map_err(failed)?;
            let open = contained(|| SerializedFileReader::new(file_bytes));
            read_rows(file, &open.map_err(|e| damaged(file, None, &e))?, source.total, sink, progress)
        }
        _ => {
            let mut all = Vec::new();
            source.reader.read_to_end(&mut all).map_err(failed)?;
            let total = all.len() as u64;
            let open = contained(|| SerializedFileReader::new(Bytes::from(all)));
            read_rows(file, &open.map_err(|e| damaged(file, None, &e))?, total, sink, progress)
        }
    }
}

fn damaged(file: &Path, line: Option<u64>, error: &ParquetError) -> BuildError {
    BuildError::new(file, line, None, format!("is no complete Parquet file, expected one: {error}"))
}

fn read_rows<S: TableSink>(
    file: &Path,
    table: &dyn FileReader,
    total: u64,
    sink: &mut S,
    progress: Progress<'_>,
) -> Result<(), BuildError> {
    let schema = table.metadata().file_metadata().schema_descr_ptr();
    // A nested column keeps its dotted path, a name that nobody asks for.
    let names: Vec<String> = schema.columns().iter().map(|c| c.path().string()).collect();
    let wanted = sink.columns(&names, Extent::Whole)?;
    if let Some(i) = (0..names.len()).find(|&i| wanted[i] && schema.column(i).max_rep_level() > 0) {
        return Err(BuildError::new(file, None, Some(&names[i]), "is a repeated column, expected one value per row"));
    }

    let mut line = 0_u64;
    for g in 0..table.num_row_groups() {
        let group = contained(|| table.get_row_group(g)).map_err(|e| damaged(file, Some(line + 1), &e))?;
        let rows = usize::try_from(group.metadata().num_rows()).unwrap_or(0);
        let mut batch = Batch { columns: Vec::new(), row: 0 };
        for (i, wanted) in wanted.iter().enumerate() {
            batch.columns.push(match wanted {
                false => None,
                true => {
                    let reader =
                        contained(|| group.get_column_reader(i)).map_err(|e| damaged(file, Some(line + 1), &e))?;
                    Some(Column::new(reader, &schema.column(i)))
                }
            });
        }
        let mut left = rows;
        while left > 0 {
            let size = left.min(BATCH);
            for column in batch.columns.iter_mut().flatten() {
                let read = contained(|| column.load(size)).map_err(|e| damaged(file, Some(line + 1), &e))?;
                if read != size {
                    let error = ParquetError::General(format!("a column holds {read} values where {size} belong"));
                    return Err(damaged(file, Some(line + 1), &error));
                }
            }
            for row in 0..size {
                batch.row = row;
                line += 1;
                sink.row(line, &batch)?;
            }
            left -= size;
            let share = (g as f64 + 1.0 - left as f64 / rows as f64) / table.num_row_groups() as f64;
            progress((total as f64 * share) as u64, total);
        }
    }
    if line == 0 {
        return Err(BuildError::new(file, None, None, "has columns but no rows, expected at least one"));
    }
    Ok(())
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
