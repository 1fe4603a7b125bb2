//! Tables as Parquet.

mod pages;

use super::columns::{self, Column, ColumnKind, Columns, OutCell, Source};
use super::{Encoder, Piece, To, WriteError};
use crate::table::TableMeta;
use bytes::Bytes;
use fixtrail_track::trail::Trail;
pub(super) use pages::Buffer;
use parquet::column::writer::ColumnCloseResult;
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::{WriterProperties, WriterPropertiesPtr};
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::parser::parse_message_type;
use parquet::schema::types::{SchemaDescPtr, SchemaDescriptor, TypePtr};
use std::io;
use std::sync::Arc;

/// Schema and properties of a file.
pub(super) struct Form {
    schema: TypePtr,
    descriptor: SchemaDescPtr,
    properties: WriterPropertiesPtr,
    kinds: Vec<ColumnKind>,
}

impl Form {
    /// Of a table of trails; the origin of their frame is in the file's metadata.
    pub fn of_trails(columns: &Columns, meta: &TableMeta) -> Result<Form, ParquetError> {
        let origin = meta.origin.map(|o| {
            // Written out: the order of a JSON object's keys depends on how the whole program is built.
            let json = format!(r#"{{"lat":{:?},"lon":{:?},"alt":{:?}}}"#, o.lat_deg, o.lon_deg, o.alt_m);
            vec![KeyValue::new("fixtrail.origin".to_owned(), json)]
        });
        Form::new("trail", &columns.names(), &columns.kinds(), origin)
    }

    /// Of columns that may be empty.
    pub fn new(
        name: &str,
        names: &[String],
        kinds: &[ColumnKind],
        metadata: Option<Vec<KeyValue>>,
    ) -> Result<Form, ParquetError> {
        let mut message = format!("message {name} {{");
        for (name, kind) in names.iter().zip(kinds) {
            message.push_str(&match kind {
                ColumnKind::Float => format!(" OPTIONAL DOUBLE {name};"),
                ColumnKind::Index => format!(" OPTIONAL INT64 {name};"),
                ColumnKind::Text => format!(" OPTIONAL BYTE_ARRAY {name} (STRING);"),
                ColumnKind::Date => format!(" OPTIONAL INT64 {name} (TIMESTAMP(NANOS,true));"),
            });
        }
        message.push_str(" }");
        let schema = Arc::new(parse_message_type(&message)?);
        let properties = WriterProperties::builder().set_key_value_metadata(metadata);
        let descriptor = Arc::new(SchemaDescriptor::new(schema.clone()));
        Ok(Form { schema, descriptor, properties: Arc::new(properties.build()), kinds: kinds.to_vec() })
    }

    /// An empty buffer for each column, with room for about so many rows.
    pub fn buffers(&self, rows: usize) -> Vec<Buffer> {
        let buffer = |kind: &ColumnKind| match kind {
            ColumnKind::Float => Buffer::floats(rows),
            ColumnKind::Index | ColumnKind::Date => Buffer::ints(),
            ColumnKind::Text => Buffer::texts(),
        };
        self.kinds.iter().map(buffer).collect()
    }

    /// Encodes what the buffers hold.
    pub fn group(&self, buffers: Vec<Buffer>) -> Result<Group, ParquetError> {
        let chunk = |(i, buffer): (usize, Buffer)| buffer.chunk(self.descriptor.column(i));
        Ok(Group { columns: buffers.into_iter().enumerate().map(chunk).collect::<Result<_, _>>()? })
    }
}

/// An encoded row group.
pub(crate) struct Group {
    columns: Vec<(Bytes, ColumnCloseResult)>,
}

/// A file that takes row groups.
pub(super) struct Table<'t> {
    file: SerializedFileWriter<To<'t>>,
}

impl<'t> Table<'t> {
    pub fn start(form: &Form, to: To<'t>) -> Result<Table<'t>, ParquetError> {
        let file = SerializedFileWriter::new(to, form.schema.clone(), form.properties.clone())?;
        Ok(Table { file })
    }

    pub fn append(&mut self, group: Group) -> Result<(), ParquetError> {
        let mut row_group = self.file.next_row_group()?;
        for (bytes, close) in group.columns {
            row_group.append_column(&bytes, close)?;
        }
        row_group.close().map(drop)
    }

    pub fn finish(self) -> Result<(), ParquetError> {
        self.file.close().map(drop)
    }
}

/// Appends rows of a trail, column by column.
pub(super) fn append(encoder: &Encoder<'_>, piece: &Piece<'_>, buffers: &mut [Buffer]) -> Result<(), WriteError> {
    let mut columns = encoder.columns.list.iter().zip(buffers);
    columns.try_for_each(|(column, buffer)| fill(encoder, column, piece, buffer))
}

/// Appends the cells of a column.
fn fill(encoder: &Encoder<'_>, column: &Column, piece: &Piece<'_>, buffer: &mut Buffer) -> Result<(), WriteError> {
    let (trail, rows) = (&piece.target.trail, piece.rows.clone());
    let n = trail.n();
    let refused = |row: usize| encoder.columns.not_finite(encoder.file, column, piece.target, row);
    // The columns that nearly all of a trail is in are copied as they are where no row lacks an estimate.
    if let Some((means, covs)) = trail.estimates(rows.clone()).filter(|(means, _)| !means.is_empty()) {
        let packed = Trail::packed_len(n);
        let odd = match column.source {
            Source::Mean(i) => Some(buffer.all_floats(means.chunks_exact(n).map(|mean| mean[i]))),
            Source::Cov(i) => Some(buffer.all_floats(covs.chunks_exact(packed).map(|cov| cov[i]))),
            Source::Sd(i) => Some(buffer.all_floats(covs.chunks_exact(packed).map(|cov| columns::sd(cov, n, i)))),
            _ => None,
        };
        match odd {
            Some(Some(odd)) => return Err(refused(rows.start + odd)),
            Some(None) => return Ok(()),
            None => {}
        }
    }
    match (column.source, &piece.target.target) {
        (Source::Target, Some(name)) => buffer.text(name, rows.len() as u32),
        (Source::Status, _) => {
            let runs = trail.status[rows].chunk_by(|a, b| a == b);
            runs.for_each(|run| buffer.text(run[0].name(), run.len() as u32));
        }
        (Source::Nis, _) => {
            if let Some(odd) = buffer.floats_or_none(&trail.nis[rows.clone()]) {
                return Err(refused(rows.start + odd));
            }
        }
        (Source::Time, _) if encoder.columns.is_in_seconds() => {
            if let Some(odd) = buffer.floats_or_none(&trail.t_s[rows.clone()]) {
                return Err(refused(rows.start + odd));
            }
        }
        (source, _) => {
            for row in rows {
                let cell = encoder.columns.cell(source, piece.target, row);
                if matches!(cell, OutCell::Float(x) if !x.is_finite()) {
                    return Err(refused(row));
                }
                push(buffer, &cell);
            }
        }
    }
    Ok(())
}

fn push(buffer: &mut Buffer, cell: &OutCell<'_>) {
    match cell {
        OutCell::Absent => buffer.absent(),
        OutCell::Float(x) => buffer.float(*x),
        OutCell::Text(text) => buffer.text(text, 1),
        OutCell::Date(ns) => buffer.int(*ns),
        // A count beyond what the column can hold is none of ours.
        OutCell::Index(k) => match i64::try_from(*k) {
            Ok(k) => buffer.int(k),
            Err(_) => buffer.absent(),
        },
    }
}

/// Writes rows of cells as one row group.
pub(super) fn write_rows<'c>(
    form: &Form,
    rows: impl Iterator<Item = Vec<OutCell<'c>>>,
    to: To<'_>,
) -> Result<(), ParquetError> {
    let rows: Vec<Vec<OutCell<'c>>> = rows.collect();
    let mut table = Table::start(form, to)?;
    for rows in rows.chunks(super::GROUP_ROWS) {
        let mut buffers = form.buffers(rows.len());
        rows.iter().for_each(|row| buffers.iter_mut().zip(row).for_each(|(buffer, cell)| push(buffer, cell)));
        table.append(form.group(buffers)?)?;
    }
    table.finish()
}

pub(super) fn into_io(error: ParquetError) -> io::Error {
    match error {
        ParquetError::External(inner) => match inner.downcast::<io::Error>() {
            Ok(io) => *io,
            Err(other) => io::Error::other(other),
        },
        other => io::Error::other(other),
    }
}
