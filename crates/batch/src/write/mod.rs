//! Trails out.

mod columns;
mod csv;
mod geojson;
mod ndjson;
mod parquet;
pub(crate) mod place;
mod plain;

pub use plain::{Cell, Holds, Plain, write_plain};

use crate::ordered::ordered;
use crate::table::TableMeta;
use crate::time::TimeForm;
use columns::{Columns, OutCell};
use fixtrail_track::layout::Layout;
use fixtrail_track::target::TargetTrail;
use std::io::{self, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Where a trail goes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Output {
    /// A file: it appears whole or not at all. What is no regular file (`/dev/stdout`, a FIFO) is written directly.
    File(PathBuf),
    /// Standard output.
    Stdout,
}

impl Output {
    /// The name that messages use.
    pub fn name(&self) -> &Path {
        match self {
            Output::File(path) => path,
            Output::Stdout => Path::new("-"),
        }
    }
}

/// How a trail is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OutFormat {
    /// `.csv`
    Csv,
    /// `.parquet`
    Parquet,
    /// `.ndjson`
    Ndjson,
    /// `.geojson`
    GeoJson,
}

impl OutFormat {
    /// Every format with the extension that names it.
    pub const EXTENSIONS: [(&'static str, OutFormat); 4] = [
        (".csv", OutFormat::Csv),
        (".parquet", OutFormat::Parquet),
        (".ndjson", OutFormat::Ndjson),
        (".geojson", OutFormat::GeoJson),
    ];

    /// The format that the extension of `output` names; CSV for standard output and for what is no regular file.
    ///
    /// # Errors
    /// [`WriteError::Unsupported`] for any other extension.
    pub fn of(output: &Output) -> Result<OutFormat, WriteError> {
        let Output::File(path) = output else { return Ok(OutFormat::Csv) };
        let extension = path.extension().map_or(String::new(), |e| format!(".{}", e.to_string_lossy()));
        let named = Self::EXTENSIONS.iter().find(|(name, _)| name.eq_ignore_ascii_case(&extension));
        match named {
            Some((_, format)) => Ok(*format),
            None if place::is_direct(path) => Ok(OutFormat::Csv),
            None => Err(WriteError::Unsupported {
                file: path.clone(),
                what: format!("has the extension `{extension}`, expected `.csv`, `.parquet`, `.ndjson` or `.geojson`"),
            }),
        }
    }
}

/// Order of the rows of an output.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Order {
    /// By target, then time.
    #[default]
    Target,
    /// By time, then target.
    Time,
}

/// What to write.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WriteOptions {
    /// Adds the packed covariance.
    pub covariance: bool,
    /// Order of the rows.
    pub order: Order,
    /// Format.
    pub format: OutFormat,
}

/// A trail that cannot be written. What was at the output before is still there.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WriteError {
    /// The system refuses.
    #[error("{}: cannot be written: {source}", file.display())]
    Io {
        /// The output.
        file: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// Whoever read the output has had enough: the end of the work, not a failure.
    #[error("{}: the reader has closed it", file.display())]
    BrokenPipe {
        /// The output.
        file: PathBuf,
    },
    /// The format cannot hold this trail, or there is no such format.
    #[error("{}: {what}", file.display())]
    Unsupported {
        /// The output.
        file: PathBuf,
        /// What was asked, and what was expected.
        what: String,
    },
    /// An estimate is not finite; no file ever holds a NaN.
    #[error("{}: `{column}` at t = {t}{} is not finite", file.display(), target.as_ref().map_or(String::new(), |t| format!(" of target `{t}`")))]
    NotFinite {
        /// The output.
        file: PathBuf,
        /// The target.
        target: Option<String>,
        /// The time, as the file would have it.
        t: String,
        /// The column.
        column: String,
    },
}

/// Writes trails as one table, or as GeoJSON.
///
/// Numbers read back to the same bits; an unobservable row has empty cells. Each trail is in order of time already (a
/// [`Sink`](fixtrail_track::fix::Sink) guarantees it).
///
/// # Errors
/// [`WriteError`]; what was at the output before is still there then, and nothing else is left behind.
pub fn write_trails(
    output: &Output,
    trails: &[TargetTrail],
    layout: &Layout,
    table: impl Into<TableMeta>,
    options: &WriteOptions,
) -> Result<(), WriteError> {
    let has_lagged = trails.iter().any(|t| t.trail.lagged.is_some());
    let encoder = Encoder::new(output.name(), layout, table.into(), has_lagged, options)?;
    let mut by_target: Vec<&TargetTrail> = trails.iter().collect();
    by_target.sort_by(|a, b| a.target.cmp(&b.target));
    let pieces = match options.order {
        _ if options.format == OutFormat::GeoJson => by_target.into_iter().map(Piece::whole).collect(),
        Order::Target => by_target.into_iter().flat_map(Piece::cut).collect(),
        Order::Time => by_time(&by_target, layout),
    };
    place::write(output, |to| {
        let mut sheet = Sheet::start(&encoder, to)?;
        let mut groups = groups(&pieces);
        let next = || Ok(groups.next());
        let work = |(): &mut (), group: &[Piece<'_>]| encoder.encode(group);
        ordered(rayon::current_num_threads(), || (), next, work, |encoded| sheet.append(encoded?))?;
        sheet.finish()
    })
}

/// Rows of a trail.
#[derive(Clone)]
pub(crate) struct Piece<'a> {
    pub target: &'a TargetTrail,
    pub rows: Range<usize>,
}

impl<'a> Piece<'a> {
    /// All rows.
    pub fn whole(target: &'a TargetTrail) -> Piece<'a> {
        Piece { target, rows: 0..target.trail.len() }
    }

    /// All rows in pieces no longer than a group.
    pub fn cut(target: &'a TargetTrail) -> impl Iterator<Item = Piece<'a>> {
        let n = target.trail.len();
        (0..n).step_by(GROUP_ROWS).map(move |start| Piece { target, rows: start..n.min(start + GROUP_ROWS) })
    }
}

/// Rows that are encoded together, about: a row group of a Parquet file.
pub(crate) const GROUP_ROWS: usize = 1 << 16;

/// Bytes of a cell of text, at most and about.
const CELL_BYTES: usize = 20;

/// Pieces in groups, in their order.
fn groups<'p, 'a>(pieces: &'p [Piece<'a>]) -> impl Iterator<Item = &'p [Piece<'a>]> {
    let mut rest = pieces;
    std::iter::from_fn(move || {
        let mut rows = 0;
        let take = rest.iter().take_while(|piece| {
            let has_room = rows < GROUP_ROWS;
            rows += piece.rows.len();
            has_room
        });
        let (group, others) = rest.split_at(take.count());
        rest = others;
        (!group.is_empty()).then_some(group)
    })
}

/// Every row as a piece, in order of time, then target.
fn by_time<'a>(by_target: &[&'a TargetTrail], layout: &Layout) -> Vec<Piece<'a>> {
    let mut lines = Vec::new();
    for target in by_target {
        let trail = &target.trail;
        for row in 0..trail.len() {
            let time = trail.t_s[row].filter(|_| !layout.is_linear()).unwrap_or(trail.k[row] as f64);
            lines.push((time, Piece { target, rows: row..row + 1 }));
        }
    }
    // Stable, so that targets of one instant stay in their order.
    lines.sort_by(|a, b| a.0.total_cmp(&b.0));
    lines.into_iter().map(|(_, piece)| piece).collect()
}

/// Turns rows into bytes of the output; the same for all parts of it.
pub(crate) struct Encoder<'a> {
    file: &'a Path,
    columns: Columns,
    meta: TableMeta,
    axes: usize,
    format: OutFormat,
    /// Schema and properties of a Parquet file.
    parquet: Option<parquet::Form>,
}

/// A part of an output.
pub(crate) enum Encoded {
    Text(Vec<u8>),
    Group(parquet::Group),
}

impl<'a> Encoder<'a> {
    /// An encoder of trails of one layout.
    ///
    /// # Errors
    /// [`WriteError::Unsupported`] when the format cannot hold them.
    pub fn new(
        file: &'a Path,
        layout: &Layout,
        meta: TableMeta,
        has_lagged: bool,
        options: &WriteOptions,
    ) -> Result<Encoder<'a>, WriteError> {
        let unsupported = |what: &str| Err(WriteError::Unsupported { file: file.to_owned(), what: what.to_owned() });
        if options.format == OutFormat::GeoJson {
            if layout.is_linear() {
                return unsupported(
                    "is `.geojson`, a linear model has no positions: expected `.csv`, `.parquet` or `.ndjson`",
                );
            }
            if layout.axes < 2 {
                return unsupported("is `.geojson`, which needs two axes: expected `.csv`, `.parquet` or `.ndjson`");
            }
            if meta.origin.is_none() {
                return unsupported("is `.geojson`, which needs positions in `lat`, `lon`: these are in local metres");
            }
        }
        let columns = Columns::new(layout, &meta, has_lagged, options.covariance);
        let mut encoder = Encoder { file, columns, meta, axes: layout.axes, format: options.format, parquet: None };
        if options.format == OutFormat::Parquet {
            let form = parquet::Form::of_trails(&encoder.columns, &meta);
            encoder.parquet = Some(form.map_err(|e| encoder.io(parquet::into_io(e)))?);
        }
        Ok(encoder)
    }

    /// The bytes of some rows.
    ///
    /// # Errors
    /// [`WriteError::NotFinite`].
    pub fn encode(&self, pieces: &[Piece<'_>]) -> Result<Encoded, WriteError> {
        let mut sheaf = Sheaf::of(self, pieces.iter().map(|piece| piece.rows.len()).sum());
        pieces.iter().try_for_each(|piece| sheaf.add(piece))?;
        sheaf.encoded()
    }

    /// An error of the system on this output.
    fn io(&self, source: io::Error) -> WriteError {
        io_error(self.file, source)
    }

    /// Calls `take` with the cells of each row.
    fn rows(&self, piece: &Piece<'_>, mut take: impl FnMut(&[OutCell<'_>])) -> Result<(), WriteError> {
        let mut cells = Vec::with_capacity(self.columns.list.len());
        for row in piece.rows.clone() {
            self.columns.fill(self.file, piece.target, row, &mut cells)?;
            take(&cells);
        }
        Ok(())
    }

    /// The offset from UTC in which dates are written as text.
    fn offset_s(&self) -> i32 {
        match self.meta.time {
            TimeForm::Rfc3339 { offset_s, .. } => offset_s,
            TimeForm::Seconds | TimeForm::Index => 0,
        }
    }
}

/// Rows that become a part of an output, piece by piece.
pub(crate) struct Sheaf<'e> {
    encoder: &'e Encoder<'e>,
    rows: Rows,
}

enum Rows {
    Text(Vec<u8>),
    Columns(Vec<parquet::Buffer>),
}

impl<'e> Sheaf<'e> {
    /// No rows yet; room for about so many.
    pub fn of(encoder: &'e Encoder<'e>, rows: usize) -> Sheaf<'e> {
        let rows = match &encoder.parquet {
            Some(form) => Rows::Columns(form.buffers(rows)),
            // What is not needed is never touched.
            None => Rows::Text(Vec::with_capacity(rows.min(GROUP_ROWS) * CELL_BYTES * encoder.columns.list.len())),
        };
        Sheaf { encoder, rows }
    }

    /// Appends rows.
    ///
    /// # Errors
    /// [`WriteError::NotFinite`]; the sheaf is of no use any more.
    pub fn add(&mut self, piece: &Piece<'_>) -> Result<(), WriteError> {
        match &mut self.rows {
            Rows::Columns(buffers) => parquet::append(self.encoder, piece, buffers),
            Rows::Text(out) => match self.encoder.format {
                OutFormat::GeoJson => geojson::append(self.encoder, piece, out),
                OutFormat::Ndjson => ndjson::append(self.encoder, piece, out),
                OutFormat::Csv | OutFormat::Parquet => csv::append(self.encoder, piece, out),
            },
        }
    }

    /// The rows as they stand in the output.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn encoded(self) -> Result<Encoded, WriteError> {
        match (self.rows, &self.encoder.parquet) {
            (Rows::Columns(buffers), Some(form)) => {
                Ok(Encoded::Group(form.group(buffers).map_err(|e| self.encoder.io(parquet::into_io(e)))?))
            }
            (Rows::Columns(_), None) => Err(self.encoder.io(io::Error::other("a Parquet file without a schema"))),
            (Rows::Text(bytes), _) => Ok(Encoded::Text(bytes)),
        }
    }
}

/// An output that is being written.
pub(crate) struct Sheet<'e, 't> {
    encoder: &'e Encoder<'e>,
    to: Out<'t>,
    parts: u64,
}

enum Out<'t> {
    Text(To<'t>),
    Table(parquet::Table<'t>),
}

impl<'e, 't> Sheet<'e, 't> {
    /// Writes what stands before the first row.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn start(encoder: &'e Encoder<'e>, to: To<'t>) -> Result<Sheet<'e, 't>, WriteError> {
        let to = match (&encoder.parquet, encoder.format) {
            (Some(form), _) => {
                Out::Table(parquet::Table::start(form, to).map_err(|e| encoder.io(parquet::into_io(e)))?)
            }
            (None, format) => {
                let head = match format {
                    OutFormat::Csv => csv::header(&encoder.columns.names()),
                    OutFormat::GeoJson => geojson::HEAD.to_vec(),
                    OutFormat::Ndjson | OutFormat::Parquet => Vec::new(),
                };
                to.write_all(&head).map_err(|e| encoder.io(e))?;
                Out::Text(to)
            }
        };
        Ok(Sheet { encoder, to, parts: 0 })
    }

    /// Writes the next rows.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn append(&mut self, part: Encoded) -> Result<(), WriteError> {
        let encoder = self.encoder;
        match (&mut self.to, part) {
            (Out::Text(to), Encoded::Text(bytes)) => {
                // Features of GeoJSON stand in a list.
                let bytes = match encoder.format {
                    OutFormat::GeoJson if self.parts == 0 => bytes.strip_prefix(b",").unwrap_or(&bytes),
                    _ => &bytes,
                };
                to.write_all(bytes).map_err(|e| encoder.io(e))?;
            }
            (Out::Table(table), Encoded::Group(group)) => {
                table.append(group).map_err(|e| encoder.io(parquet::into_io(e)))?;
            }
            _ => return Err(encoder.io(io::Error::other("a part of another format"))),
        }
        self.parts += 1;
        Ok(())
    }

    /// Writes what stands after the last row.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn finish(self) -> Result<(), WriteError> {
        let encoder = self.encoder;
        match self.to {
            Out::Text(to) if encoder.format == OutFormat::GeoJson => {
                to.write_all(geojson::FOOT).map_err(|e| encoder.io(e))
            }
            Out::Text(_) => Ok(()),
            Out::Table(table) => table.finish().map_err(|e| encoder.io(parquet::into_io(e))),
        }
    }
}

fn io_error(file: &Path, source: io::Error) -> WriteError {
    let file = file.to_owned();
    match source.kind() {
        io::ErrorKind::BrokenPipe => WriteError::BrokenPipe { file },
        _ => WriteError::Io { file, source },
    }
}

/// Where bytes go.
type To<'a> = &'a mut (dyn Write + Send);
