//! Tables that are no trails: rows of numbers and names.

use super::columns::{ColumnKind, OutCell};
use super::{OutFormat, Output, To, WriteError, csv, io_error, ndjson, parquet, place};
use ::parquet::errors::ParquetError;
use std::io;

/// What a column holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Holds {
    /// Numbers.
    Numbers,
    /// Whole numbers from 0.
    Counts,
    /// Names.
    Names,
}

/// A cell.
#[derive(Clone, Debug, PartialEq)]
pub enum Cell {
    /// Nothing; also in place of a number that is not finite.
    Absent,
    /// In a column of numbers.
    Number(f64),
    /// In a column of counts.
    Count(u64),
    /// In a column of names.
    Name(String),
}

/// A table.
#[derive(Clone, Debug, PartialEq)]
pub struct Plain {
    /// Names of the columns, and what they hold.
    pub columns: Vec<(String, Holds)>,
    /// Rows, one cell for each column.
    pub rows: Vec<Vec<Cell>>,
}

impl Cell {
    fn out(&self) -> OutCell<'_> {
        match self {
            Cell::Number(x) if x.is_finite() => OutCell::Float(*x),
            Cell::Count(n) => OutCell::Index(*n),
            Cell::Name(name) => OutCell::Text(name),
            Cell::Absent | Cell::Number(_) => OutCell::Absent,
        }
    }
}

/// Writes a table as CSV, Parquet or NDJSON. Numbers read back to the same bits.
///
/// # Errors
/// [`WriteError`]; what was at the output before is still there then, and nothing else is left behind.
pub fn write_plain(output: &Output, table: &Plain, format: OutFormat) -> Result<(), WriteError> {
    let file = output.name();
    place::write(output, |to| match format {
        OutFormat::Csv => as_csv(table, to).map_err(|e| io_error(file, e)),
        OutFormat::Ndjson => as_ndjson(table, to).map_err(|e| io_error(file, e)),
        OutFormat::Parquet => as_parquet(table, to).map_err(|e| io_error(file, parquet::into_io(e))),
        OutFormat::GeoJson => Err(WriteError::Unsupported {
            file: file.to_owned(),
            what: "is `.geojson`, but there are no positions in it: expected `.csv`, `.parquet` or `.ndjson`"
                .to_owned(),
        }),
    })
}

fn names(table: &Plain) -> Vec<String> {
    table.columns.iter().map(|(name, _)| name.clone()).collect()
}

fn cells(row: &[Cell]) -> Vec<OutCell<'_>> {
    row.iter().map(Cell::out).collect()
}

fn as_csv(table: &Plain, to: To<'_>) -> io::Result<()> {
    to.write_all(&csv::header(&names(table)))?;
    let mut float = zmij::Buffer::new();
    for row in &table.rows {
        let mut line = Vec::new();
        csv::write_cells(&mut line, &cells(row), &mut float, 0);
        to.write_all(&line)?;
    }
    Ok(())
}

fn as_ndjson(table: &Plain, to: To<'_>) -> io::Result<()> {
    let keys = ndjson::keys(&names(table));
    for row in &table.rows {
        let mut line = Vec::new();
        for (key, cell) in keys.iter().zip(row) {
            line.extend_from_slice(key.as_bytes());
            ndjson::write_cell(&mut line, &cell.out(), 0);
        }
        line.extend_from_slice(b"}\n");
        to.write_all(&line)?;
    }
    Ok(())
}

fn as_parquet(table: &Plain, to: To<'_>) -> Result<(), ParquetError> {
    let kind = |holds: Holds| match holds {
        Holds::Numbers => ColumnKind::Float,
        Holds::Counts => ColumnKind::Index,
        Holds::Names => ColumnKind::Text,
    };
    let kinds: Vec<ColumnKind> = table.columns.iter().map(|(_, holds)| kind(*holds)).collect();
    let form = parquet::Form::new("rows", &names(table), &kinds, None)?;
    parquet::write_rows(&form, table.rows.iter().map(|row| cells(row)), to)
}
