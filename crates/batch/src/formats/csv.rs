//! CSV with a header line.

use super::{PROGRESS_ROWS, Progress, Row, TableSink};
use crate::cell::{Cell, clip};
use crate::columns::Extent;
use crate::input::Source;
use csv::{ErrorKind, ReaderBuilder, StringRecord, Terminator};
use fixtrail_track::error::BuildError;
use std::io::Read;
use std::path::Path;

impl Row for StringRecord {
    fn cell(&self, column: usize) -> Cell<'_> {
        self.get(column).map_or(Cell::Absent, Cell::text)
    }
}

/// Reads the header and every row. The carriage return of a CRLF line is white space at the end of its last cell.
pub(super) fn read<S: TableSink>(source: Source<'_>, sink: &mut S, progress: Progress<'_>) -> Result<(), BuildError> {
    let (file, total, done) = (source.file, source.total, source.counter());
    // With a line feed after the last line too, the reader stands on the line after the record it has just read.
    let mut reader = ReaderBuilder::new()
        .has_headers(false)
        .flexible(true)
        .terminator(Terminator::Any(b'\n'))
        .buffer_capacity(1 << 16)
        .from_reader(source.reader.chain(&b"\n"[..]));
    let mut record = StringRecord::new();

    let mut names: Option<Vec<String>> = None;
    let (mut rows, mut last_line) = (0_u64, 0_u64);
    loop {
        let more = reader.read_record(&mut record);
        let end = reader.position().line().saturating_sub(1);
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
            let cells = format!("{} cell{}", record.len(), if record.len() == 1 { "" } else { "s" });
            let text = record.iter().collect::<Vec<_>>().join(",");
            let what = format!("has {cells} (`{}`), expected {} as in the header", clip(text.trim()), names.len());
            sink.malformed(BuildError::new(file, Some(line), None, what))?;
        }
        if rows.is_multiple_of(PROGRESS_ROWS) {
            progress(done.get(), total);
        }
    }
    if names.is_none() {
        return Err(BuildError::new(file, None, None, "has no header, expected a line of column names and rows"));
    }
    if rows == 0 {
        return Err(BuildError::new(file, None, None, "has a header but no rows, expected at least one"));
    }
    progress(done.get(), total);
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
