//! Trails out.

mod columns;
mod csv;
mod geojson;
mod ndjson;
mod parquet;
mod place;
mod plain;

pub use plain::{Cell, Holds, Plain, write_plain};

use crate::table::TableMeta;
use columns::Columns;
use fixtrail_track::layout::Layout;
use fixtrail_track::target::TargetTrail;
use std::io::{self, Write};
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
    let meta = table.into();
    let job = Job { file: output.name(), trails, layout, meta, options };
    let unsupported = |what: &str| WriteError::Unsupported { file: job.file.to_owned(), what: what.to_owned() };
    if options.format == OutFormat::GeoJson {
        if layout.is_linear() {
            return Err(unsupported(
                "is `.geojson`, a linear model has no positions: expected `.csv`, `.parquet` or `.ndjson`",
            ));
        }
        if layout.axes < 2 {
            return Err(unsupported("is `.geojson`, which needs two axes: expected `.csv`, `.parquet` or `.ndjson`"));
        }
        if meta.origin.is_none() {
            return Err(unsupported("is `.geojson`, which needs positions in `lat`, `lon`: these are in local metres"));
        }
    }
    place::write(output, |to| match options.format {
        OutFormat::Csv => csv::write(&job, to),
        OutFormat::Ndjson => ndjson::write(&job, to),
        OutFormat::Parquet => parquet::write(&job, to),
        OutFormat::GeoJson => geojson::write(&job, to),
    })
}

/// What is to be written.
struct Job<'a> {
    file: &'a Path,
    trails: &'a [TargetTrail],
    layout: &'a Layout,
    meta: TableMeta,
    options: &'a WriteOptions,
}

impl<'a> Job<'a> {
    fn columns(&self) -> Columns {
        let has_lagged = self.trails.iter().any(|t| t.trail.lagged.is_some());
        Columns::new(self.layout, &self.meta, has_lagged, self.options.covariance)
    }

    /// An error of the system on this output.
    fn io(&self, source: io::Error) -> WriteError {
        io_error(self.file, source)
    }

    /// Positions of trails in order of their ids.
    fn by_target(&self) -> Vec<usize> {
        let mut order: Vec<usize> = (0..self.trails.len()).collect();
        order.sort_by(|a, b| self.trails[*a].target.cmp(&self.trails[*b].target));
        order
    }

    /// Calls `take` with the trail and row of each line of the output, in order.
    fn rows(&self, mut take: impl FnMut(&'a TargetTrail, usize) -> Result<(), WriteError>) -> Result<(), WriteError> {
        let targets = self.by_target();
        if self.options.order == Order::Target {
            for &i in &targets {
                let target = &self.trails[i];
                (0..target.trail.len()).try_for_each(|row| take(target, row))?;
            }
            return Ok(());
        }
        let mut lines = Vec::new();
        for &i in &targets {
            let trail = &self.trails[i].trail;
            for row in 0..trail.len() {
                let time = trail.t_s[row].filter(|_| !self.layout.is_linear()).unwrap_or(trail.k[row] as f64);
                lines.push((time, i, row));
            }
        }
        // Stable, so that targets of one instant stay in their order.
        lines.sort_by(|a, b| a.0.total_cmp(&b.0));
        lines.iter().try_for_each(|&(_, i, row)| take(&self.trails[i], row))
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
