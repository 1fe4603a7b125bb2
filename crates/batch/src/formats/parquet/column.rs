//! Columns of a row group, some thousand rows at a time.

use super::super::{Row, Slab};
use crate::cell::Cell;
use parquet::basic::{ConvertedType, LogicalType, TimeUnit, TimestampType};
use parquet::column::reader::{ColumnReader, ColumnReaderImpl};
use parquet::data_type::{ByteArray, DataType};
use parquet::errors::ParquetError;
use parquet::file::reader::FileReader;
use parquet::schema::types::ColumnDescriptor;

/// The current rows of all wanted columns.
pub(super) struct Batch {
    columns: Vec<Option<Column>>,
    pub row: usize,
}

impl Batch {
    /// Opens the wanted columns of a row group.
    ///
    /// # Errors
    /// [`ParquetError`] when they are damaged.
    pub fn open(table: &dyn FileReader, group: usize, wanted: impl Fn(usize) -> bool) -> Result<Batch, ParquetError> {
        let schema = table.metadata().file_metadata().schema_descr_ptr();
        let group = table.get_row_group(group)?;
        let column = |i| -> Result<Option<Column>, ParquetError> {
            let open = || Ok(Column::new(group.get_column_reader(i)?, &schema.column(i)));
            wanted(i).then(open).transpose()
        };
        Ok(Batch { columns: (0..schema.num_columns()).map(column).collect::<Result<_, _>>()?, row: 0 })
    }

    /// Decodes the next `rows` rows, and begins with the first.
    ///
    /// # Errors
    /// [`ParquetError`] when a column is damaged or has no more rows.
    pub fn load(&mut self, rows: usize) -> Result<(), ParquetError> {
        self.row = 0;
        self.columns.iter_mut().flatten().try_for_each(|column| all(column.load(rows)?, rows))
    }

    /// Passes over the next `rows` rows.
    ///
    /// # Errors
    /// As [`load`](Batch::load).
    pub fn skip(&mut self, rows: usize) -> Result<(), ParquetError> {
        self.columns.iter_mut().flatten().try_for_each(|column| all(column.skip(rows)?, rows))
    }
}

/// An error unless there were as many rows as wanted.
fn all(there: usize, wanted: usize) -> Result<(), ParquetError> {
    match there == wanted {
        true => Ok(()),
        false => Err(ParquetError::General(format!("a column holds {there} values where {wanted} belong"))),
    }
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

impl Slab for Batch {
    fn numbers(&self, column: usize) -> Option<&[f64]> {
        match self.columns.get(column)?.as_ref()? {
            Column { values: Values::Floats(v), is_full: true, .. } => v.get(self.row..),
            _ => None,
        }
    }

    fn alike(&self, column: usize) -> usize {
        let Some(Some(Column { values, is_full: true, .. })) = self.columns.get(column) else { return 1 };
        // Values of a dictionary are the same bytes in memory.
        let is_same = |a: &ByteArray, b: &ByteArray| {
            let (a, b) = (a.data(), b.data());
            a.len() == b.len() && (std::ptr::eq(a, b) || a == b)
        };
        let same = |same: usize| same.max(1);
        match values {
            Values::Ints(v) => same(v[self.row..].iter().take_while(|x| **x == v[self.row]).count()),
            Values::Texts(v) => same(v[self.row..].iter().take_while(|x| is_same(x, &v[self.row])).count()),
            Values::Floats(_) | Values::None => 1,
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
    /// How deep each row goes (optional columns).
    levels: Vec<i16>,
    /// The level of a row whose value is present: those of nullable groups around the column count too.
    present: i16,
    /// Whether every row has a value.
    is_full: bool,
    /// Position of each row's value, where some have none.
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
        let present = descriptor.max_def_level();
        Column {
            reader,
            meaning,
            optional: present > 0,
            present,
            levels: Vec::new(),
            is_full: true,
            places: Vec::new(),
            values: Values::None,
        }
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
        self.is_full = !optional || self.levels.len() >= read && self.levels[..read].iter().all(|l| *l == self.present);
        if self.is_full {
            return Ok(read);
        }
        let mut present = 0;
        for row in 0..read {
            let is_there = self.levels.get(row).is_some_and(|l| *l == self.present);
            self.places.push(is_there.then_some(present));
            present += usize::from(is_there);
        }
        Ok(read)
    }

    /// Passes over the next `rows` rows and returns how many there were.
    fn skip(&mut self, rows: usize) -> Result<usize, ParquetError> {
        match &mut self.reader {
            ColumnReader::BoolColumnReader(r) => r.skip_records(rows),
            ColumnReader::FixedLenByteArrayColumnReader(r) => r.skip_records(rows),
            ColumnReader::Int32ColumnReader(r) => r.skip_records(rows),
            ColumnReader::Int64ColumnReader(r) => r.skip_records(rows),
            ColumnReader::Int96ColumnReader(r) => r.skip_records(rows),
            ColumnReader::FloatColumnReader(r) => r.skip_records(rows),
            ColumnReader::DoubleColumnReader(r) => r.skip_records(rows),
            ColumnReader::ByteArrayColumnReader(r) => r.skip_records(rows),
        }
    }

    /// Where the value of a row stands among those present.
    #[inline]
    fn place(&self, row: usize) -> Option<usize> {
        if self.is_full { Some(row) } else { self.places.get(row).copied().flatten() }
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
