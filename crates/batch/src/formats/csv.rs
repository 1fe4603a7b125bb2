//! CSV with a header line.
//!
//! Lines without quotes are cut at commas, a block of lines at a time and several blocks side by side; from the first quote on the `csv`
//! crate reads, row by row.

use super::decimal::decimal;
use super::lines::{self, Lines};
use super::{PROGRESS_ROWS, Part, Progress, Row, TableSink, in_turn, unreadable};
use crate::cell::{Cell, clip};
use crate::columns::Extent;
use crate::input::Source;
use crate::ordered::ordered;
use csv::{ErrorKind, ReaderBuilder, StringRecord, Terminator};
use fixtrail_track::error::BuildError;
use memchr::memchr2_iter;
use std::io::Read;
use std::path::Path;

impl Row for StringRecord {
    fn cell(&self, column: usize) -> Cell<'_> {
        self.get(column).map_or(Cell::Absent, Cell::text)
    }

    fn number(&self, column: usize) -> Option<f64> {
        self.get(column).and_then(|text| decimal(text.as_bytes()))
    }

    fn text(&self, column: usize) -> Option<&str> {
        self.get(column).map(str::trim).filter(|text| !text.is_empty())
    }
}

/// Where a reader stands in a file.
#[derive(Default)]
struct Place {
    /// Lines before it.
    lines: u64,
    /// Rows before it.
    rows: u64,
    /// The header, once it has been read.
    names: Option<Vec<String>>,
}

/// Reads the header and every row.
pub(super) fn read<S: TableSink>(source: Source<'_>, sink: &mut S, progress: Progress<'_>) -> Result<(), BuildError> {
    let (file, total, done) = (source.file, source.total, source.counter());
    read_rows(source.reader, file, Place::default(), sink, &mut || progress(done.get(), total))
}

/// Reads the header and every row into parts.
pub(super) fn read_parts<P: Part>(
    source: Source<'_>,
    mut part: P,
    threads: usize,
    join: &mut dyn FnMut(P::Block) -> Result<(), BuildError>,
    progress: Progress<'_>,
) -> Result<P, BuildError> {
    let (file, total, done) = (source.file, source.total, source.counter());
    let failed = |e: std::io::Error| unreadable(file, &e);
    let mut lines = Lines::new(source.reader);
    let mut place = Place::default();
    let mut block = lines.next().map_err(failed)?.unwrap_or_default();
    if let Some(Header { names, line, end }) = header(&block) {
        part.columns(&names, Extent::Whole).map_err(|e| at_line(e, line))?;
        block.drain(..end);
        place = Place { lines: line, rows: 0, names: Some(names) };
    }

    let mut odd = None;
    if let Some(names) = &place.names {
        let (mut pending, mut first_line) = (Some(block), place.lines + 1);
        let next = || {
            let block = match pending.take() {
                Some(block) => Some(block),
                None => lines.next().map_err(failed)?,
            };
            let Some(block) = block else { return Ok(None) };
            let from = first_line;
            first_line += lines::count(&block);
            match plain_text(block) {
                Ok(text) => Ok(Some((text, from, done.get()))),
                Err(block) => {
                    odd = Some((block, from));
                    Ok(None)
                }
            }
        };
        let work = |part: &mut P, (text, first_line, bytes): (String, u64, u64)| {
            let (rows, result) = cut_rows(&text, first_line, names.len(), file, part);
            (part.cut(), rows, result, bytes)
        };
        let mut rows = 0;
        let take = |(block, count, result, bytes): (P::Block, u64, Result<(), BuildError>, u64)| {
            rows += count;
            join(block)?;
            progress(bytes, total);
            result
        };
        ordered(threads, || part.fork(), next, work, take)?;
        place.rows = rows;
        match odd {
            Some((block, from)) => {
                place.lines = from - 1;
                odd_rows(lines.after(block), file, place, part, join, &mut || progress(done.get(), total))
            }
            None if rows == 0 => Err(no_rows(file)),
            None => Ok(part),
        }
    } else {
        odd_rows(lines.after(block), file, place, part, join, &mut || progress(done.get(), total))
    }
}

fn odd_rows<P: Part>(
    reader: impl Read,
    file: &Path,
    place: Place,
    part: P,
    join: &mut dyn FnMut(P::Block) -> Result<(), BuildError>,
    progress: &mut dyn FnMut(),
) -> Result<P, BuildError> {
    in_turn(part, join, |sink| read_rows(reader, file, place, sink, progress))
}

/// A header on a line of its own.
pub(super) struct Header {
    pub names: Vec<String>,
    pub line: u64,
    /// Bytes of the block up to the end of the line.
    pub end: usize,
}

/// The header at the beginning of a file, if it is one line of several names and complete.
pub(super) fn header(block: &[u8]) -> Option<Header> {
    let mut end = 0;
    for (i, line) in block.split_inclusive(|b| *b == b'\n').enumerate() {
        end += line.len();
        let text = if i == 0 { line.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(line) } else { line };
        if text.trim_ascii().is_empty() {
            continue;
        }
        if !line.ends_with(b"\n") || !memchr::memchr_iter(b'"', text).count().is_multiple_of(2) {
            return None;
        }
        let mut record = StringRecord::new();
        let read = ReaderBuilder::new().has_headers(false).from_reader(text).read_record(&mut record);
        let names: Vec<String> = record.iter().map(|c| c.trim().to_owned()).collect();
        // A blank line in a table of one column may mean something.
        return (read.is_ok() && names.len() > 1).then_some(Header { names, line: i as u64 + 1, end });
    }
    None
}

/// The text of a block that holds no quote, else the block.
fn plain_text(block: Vec<u8>) -> Result<String, Vec<u8>> {
    match memchr::memchr(b'"', &block) {
        None => String::from_utf8(block).map_err(std::string::FromUtf8Error::into_bytes),
        Some(_) => Err(block),
    }
}

/// A line and where its cells end.
struct Cells<'a> {
    line: &'a str,
    ends: &'a [usize],
}

impl Cells<'_> {
    #[inline]
    fn get(&self, column: usize) -> &str {
        let from = if column == 0 { 0 } else { self.ends[column - 1] + 1 };
        &self.line[from..self.ends[column]]
    }
}

impl Row for Cells<'_> {
    fn cell(&self, column: usize) -> Cell<'_> {
        Cell::text(self.get(column))
    }

    #[inline]
    fn number(&self, column: usize) -> Option<f64> {
        decimal(self.get(column).as_bytes())
    }

    #[inline]
    fn text(&self, column: usize) -> Option<&str> {
        Some(self.get(column).trim()).filter(|text| !text.is_empty())
    }
}

/// Reads lines without quotes; returns how many rows there were.
pub(super) fn cut_rows<S: TableSink>(
    text: &str,
    first_line: u64,
    columns: usize,
    file: &Path,
    sink: &mut S,
) -> (u64, Result<(), BuildError>) {
    let (mut line, mut start, mut rows) = (first_line, 0, 0);
    let mut ends = Vec::with_capacity(columns);
    let bytes = text.as_bytes();
    while start < bytes.len() {
        if let Some(length) = sink.line(line, &bytes[start..]) {
            (line, start, rows) = (line + 1, start + length, rows + 1);
            continue;
        }
        let mut end = bytes.len();
        for at in memchr2_iter(b',', b'\n', &bytes[start..]) {
            if bytes[start + at] == b'\n' {
                end = start + at;
                break;
            }
            ends.push(at);
        }
        ends.push(end - start);
        let cells = Cells { line: &text[start..end], ends: &ends };
        let result = if ends.len() == columns {
            rows += 1;
            sink.row(line, &cells)
        } else if ends.len() == 1 && cells.line.trim().is_empty() {
            Ok(())
        } else {
            rows += 1;
            sink.malformed(wrong_count(file, line, cells.line, ends.len(), columns))
        };
        if result.is_err() {
            return (rows, result);
        }
        ends.clear();
        (line, start) = (line + 1, end + 1);
    }
    (rows, Ok(()))
}

fn wrong_count(file: &Path, line: u64, text: &str, count: usize, columns: usize) -> BuildError {
    let cells = format!("{count} cell{}", if count == 1 { "" } else { "s" });
    let what = format!("has {cells} (`{}`), expected {columns} as in the header", clip(text.trim()));
    BuildError::new(file, Some(line), None, what)
}

fn no_rows(file: &Path) -> BuildError {
    BuildError::new(file, None, None, "has a header but no rows, expected at least one")
}

/// Reads what may hold quotes. The carriage return of a CRLF line is white space at the end of its last cell.
fn read_rows<S: TableSink>(
    reader: impl Read,
    file: &Path,
    place: Place,
    sink: &mut S,
    progress: &mut dyn FnMut(),
) -> Result<(), BuildError> {
    // With a line feed after the last line too, the reader stands on the line after the record it has just read.
    let mut reader = ReaderBuilder::new()
        .has_headers(false)
        .flexible(true)
        .terminator(Terminator::Any(b'\n'))
        .buffer_capacity(1 << 16)
        .from_reader(reader.chain(&b"\n"[..]));
    let mut record = StringRecord::new();

    let Place { lines: before, mut rows, mut names } = place;
    let mut last_line = before;
    loop {
        let more = reader.read_record(&mut record);
        let end = before + reader.position().line().saturating_sub(1);
        match more {
            Ok(true) => {}
            Ok(false) => break,
            Err(e) => {
                let error = reading_error(file, end, &e);
                if names.is_none() || !matches!(e.kind(), ErrorKind::Utf8 { .. }) {
                    return Err(error);
                }
                sink.malformed(error)?;
                continue;
            }
        }
        let line = end - record.iter().map(|c| c.matches('\n').count() as u64).sum::<u64>();
        let is_blank = record.len() == 1 && record[0].trim().is_empty();
        let Some(names) = &names else {
            if is_blank {
                continue;
            }
            let header: Vec<String> = record.iter().map(|c| c.trim().to_owned()).collect();
            sink.columns(&header, Extent::Whole).map_err(|e| at_line(e, line))?;
            names = Some(header);
            last_line = line;
            continue;
        };
        if names.len() == 1 {
            // A blank line in a table of one column may be a lost value, and leaving it out would shift all that follow.
            if line > last_line + 1 {
                let what =
                    "is blank, which in a table of one column may be a lost value: write `\"\"`, or add a column";
                return Err(BuildError::new(file, Some(last_line + 1), None, what));
            }
            if is_blank && record[0].contains('\r') {
                continue;
            }
        } else if is_blank {
            continue;
        }
        last_line = line;
        rows += 1;
        if record.len() == names.len() {
            sink.row(line, &record)?;
        } else {
            let text = record.iter().collect::<Vec<_>>().join(",");
            sink.malformed(wrong_count(file, line, &text, record.len(), names.len()))?;
        }
        if rows.is_multiple_of(PROGRESS_ROWS) {
            progress();
        }
    }
    if names.is_none() {
        return Err(BuildError::new(file, None, None, "has no header, expected a line of column names and rows"));
    }
    if rows == 0 {
        return Err(no_rows(file));
    }
    progress();
    Ok(())
}

fn at_line(mut error: BuildError, line: u64) -> BuildError {
    error.place.line = Some(line);
    error
}

fn reading_error(file: &Path, line: u64, error: &csv::Error) -> BuildError {
    match error.kind() {
        ErrorKind::Utf8 { err, .. } => {
            let what = format!("has bytes in cell {} that are not UTF-8, expected UTF-8 text", err.field() + 1);
            BuildError::new(file, Some(line), None, what)
        }
        ErrorKind::Io(e) => BuildError::new(file, Some(line), None, format!("cannot be read: {e}")),
        _ => BuildError::new(file, Some(line), None, format!("is not CSV: {error}")),
    }
}
