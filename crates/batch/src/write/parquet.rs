//! A trail as Parquet.

use super::columns::{ColumnKind, OutCell};
use super::{Job, To, WriteError};
use parquet::basic::Compression;
use parquet::column::writer::ColumnWriter;
use parquet::data_type::ByteArray;
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::parser::parse_message_type;
use std::io;
use std::sync::Arc;

/// Rows of a row group.
const GROUP_ROWS: usize = 1 << 16;

pub(super) fn write(job: &Job<'_>, to: To<'_>) -> Result<(), WriteError> {
    let columns = job.columns();
    let failed = |e: ParquetError| job.io(into_io(e));
    let origin = job.meta.origin.map(|o| {
        // Written out: the order of a JSON object's keys depends on how the whole program is built.
        let json = format!(r#"{{"lat":{:?},"lon":{:?},"alt":{:?}}}"#, o.lat_deg, o.lon_deg, o.alt_m);
        vec![KeyValue::new("fixtrail.origin".to_owned(), json)]
    });
    let mut rows = Rows::start("trail", &columns.names, &columns.kinds, origin, to).map_err(failed)?;
    let mut cells = Vec::new();
    job.rows(|target, row| {
        columns.fill(job, target, row, &mut cells)?;
        rows.push(&cells).map_err(failed)
    })?;
    rows.finish().map_err(failed)
}

/// A Parquet file that takes rows.
pub(super) struct Rows<'a> {
    file: SerializedFileWriter<To<'a>>,
    buffers: Vec<Buffer>,
    rows: usize,
}

impl<'a> Rows<'a> {
    pub fn start(
        name: &str,
        names: &[String],
        kinds: &[ColumnKind],
        metadata: Option<Vec<KeyValue>>,
        to: To<'a>,
    ) -> Result<Rows<'a>, ParquetError> {
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
        let schema = parse_message_type(&message)?;
        let mut properties = WriterProperties::builder()
            .set_compression(Compression::SNAPPY)
            .set_dictionary_enabled(false)
            .set_key_value_metadata(metadata);
        for (name, _) in names.iter().zip(kinds).filter(|(_, kind)| **kind == ColumnKind::Text) {
            properties = properties.set_column_dictionary_enabled(name.as_str().into(), true);
        }
        let file = SerializedFileWriter::new(to, Arc::new(schema), Arc::new(properties.build()))?;
        Ok(Rows { file, buffers: kinds.iter().map(|kind| Buffer::new(*kind)).collect(), rows: 0 })
    }

    pub fn push(&mut self, cells: &[OutCell<'_>]) -> Result<(), ParquetError> {
        self.buffers.iter_mut().zip(cells).for_each(|(buffer, cell)| buffer.push(cell));
        self.rows += 1;
        if self.rows.is_multiple_of(GROUP_ROWS) { write_group(&mut self.file, &mut self.buffers) } else { Ok(()) }
    }

    pub fn finish(mut self) -> Result<(), ParquetError> {
        if !self.rows.is_multiple_of(GROUP_ROWS) {
            write_group(&mut self.file, &mut self.buffers)?;
        }
        self.file.close().map(drop)
    }
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

/// The values of one column of a row group.
struct Buffer {
    /// 1 where there is a value.
    levels: Vec<i16>,
    values: Values,
}

enum Values {
    Floats(Vec<f64>),
    Ints(Vec<i64>),
    Texts(Vec<ByteArray>),
}

impl Buffer {
    fn new(kind: ColumnKind) -> Buffer {
        let values = match kind {
            ColumnKind::Float => Values::Floats(Vec::new()),
            ColumnKind::Index | ColumnKind::Date => Values::Ints(Vec::new()),
            ColumnKind::Text => Values::Texts(Vec::new()),
        };
        Buffer { levels: Vec::new(), values }
    }

    fn push(&mut self, cell: &OutCell<'_>) {
        let is_there = match (&mut self.values, cell) {
            (Values::Floats(v), OutCell::Float(x)) => {
                v.push(*x);
                true
            }
            (Values::Ints(v), OutCell::Date(ns)) => {
                v.push(*ns);
                true
            }
            (Values::Ints(v), OutCell::Index(k)) => i64::try_from(*k).map(|k| v.push(k)).is_ok(),
            (Values::Texts(v), OutCell::Text(text)) => {
                v.push(ByteArray::from(*text));
                true
            }
            _ => false,
        };
        self.levels.push(i16::from(is_there));
    }

    fn clear(&mut self) {
        self.levels.clear();
        match &mut self.values {
            Values::Floats(v) => v.clear(),
            Values::Ints(v) => v.clear(),
            Values::Texts(v) => v.clear(),
        }
    }
}

fn write_group(file: &mut SerializedFileWriter<To<'_>>, buffers: &mut [Buffer]) -> Result<(), ParquetError> {
    let mut group = file.next_row_group()?;
    for buffer in buffers.iter_mut() {
        let Some(mut column) = group.next_column()? else { break };
        let levels = Some(buffer.levels.as_slice());
        match (column.untyped(), &buffer.values) {
            (ColumnWriter::DoubleColumnWriter(w), Values::Floats(v)) => w.write_batch(v, levels, None)?,
            (ColumnWriter::Int64ColumnWriter(w), Values::Ints(v)) => w.write_batch(v, levels, None)?,
            (ColumnWriter::ByteArrayColumnWriter(w), Values::Texts(v)) => w.write_batch(v, levels, None)?,
            _ => return Err(ParquetError::General("a column has another type than its schema".to_owned())),
        };
        column.close()?;
        buffer.clear();
    }
    group.close()?;
    Ok(())
}
