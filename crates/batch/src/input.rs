//! Where a table comes from, and what it is.

use fixtrail_track::error::BuildError;
use std::cell::Cell;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::rc::Rc;

/// Where a table comes from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Input {
    /// A file.
    File(PathBuf),
    /// Standard input, `-` in messages.
    Stdin,
}

impl Input {
    /// The name that messages use.
    pub fn name(&self) -> &Path {
        match self {
            Input::File(path) => path,
            Input::Stdin => Path::new("-"),
        }
    }
}

/// How a table is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Comma-separated values with a header line.
    Csv,
    /// One JSON object per line.
    Ndjson,
    /// Apache Parquet.
    Parquet,
}

impl Format {
    /// The format that a file's extension names, if it names one.
    fn from_extension(path: &Path) -> Option<Format> {
        let extension = path.extension()?.to_str()?.to_ascii_lowercase();
        match extension.as_str() {
            "csv" => Some(Format::Csv),
            "ndjson" | "jsonl" => Some(Format::Ndjson),
            "parquet" => Some(Format::Parquet),
            _ => None,
        }
    }

    /// The format that the first bytes look like.
    fn sniff(head: &[u8]) -> Format {
        if head.starts_with(b"PAR1") {
            return Format::Parquet;
        }
        let text = head.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(head);
        match text.iter().find(|b| !b.is_ascii_whitespace()) {
            Some(b'{') => Format::Ndjson,
            _ => Format::Csv,
        }
    }
}

/// Counts the bytes that went through.
struct Counted<R> {
    inner: R,
    done: Rc<Cell<u64>>,
}

impl<R: Read> Read for Counted<R> {
    fn read(&mut self, buf: &mut [u8]) -> io::Result<usize> {
        let n = self.inner.read(buf)?;
        self.done.set(self.done.get() + n as u64);
        Ok(n)
    }
}

/// An opened table.
pub(crate) struct Source<'a> {
    /// The name that messages use.
    pub file: &'a Path,
    /// What is in it.
    pub format: Format,
    /// Its bytes.
    pub reader: Box<dyn BufRead>,
    /// Its size in bytes; 0 when unknown.
    pub total: u64,
    done: Rc<Cell<u64>>,
}

impl<'a> Source<'a> {
    /// Opens `input`; without `format` the extension decides, then the first bytes.
    pub fn open(input: &'a Input, format: Option<Format>) -> Result<Source<'a>, BuildError> {
        let file = input.name();
        let failed = |e: io::Error| BuildError::new(file, None, None, format!("cannot be read: {e}"));
        let (raw, total): (Box<dyn Read>, u64) = match input {
            Input::Stdin => (Box::new(io::stdin()), 0),
            Input::File(path) => {
                let open = File::open(path).map_err(failed)?;
                let meta = open.metadata().map_err(failed)?;
                if meta.is_dir() {
                    return Err(BuildError::new(file, None, None, "is a directory, expected a table"));
                }
                (Box::new(open), if meta.is_file() { meta.len() } else { 0 })
            }
        };
        let done = Rc::new(Cell::new(0));
        let mut reader = BufReader::with_capacity(1 << 16, Counted { inner: raw, done: done.clone() });
        let head = reader.fill_buf().map_err(failed)?;
        if head.is_empty() {
            return Err(BuildError::new(file, None, None, "is empty, expected a table with a header and rows"));
        }
        let format = format.or_else(|| Format::from_extension(file)).unwrap_or_else(|| Format::sniff(head));
        Ok(Source { file, format, reader: Box::new(reader), total, done })
    }

    /// A handle on the number of bytes read so far, for readers that take the source apart.
    pub fn counter(&self) -> Rc<Cell<u64>> {
        self.done.clone()
    }
}
