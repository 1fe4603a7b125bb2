//! A trail as CSV.

use super::columns::OutCell;
use super::{Encoder, Piece, WriteError};
use crate::time;

pub(super) fn append(encoder: &Encoder<'_>, piece: &Piece<'_>, out: &mut Vec<u8>) -> Result<(), WriteError> {
    let (mut float, offset_s) = (zmij::Buffer::new(), encoder.offset_s());
    encoder.rows(piece, |cells| write_cells(out, cells, &mut float, offset_s))
}

/// The line of column names.
pub(super) fn header(names: &[String]) -> Vec<u8> {
    let cells: Vec<OutCell<'_>> = names.iter().map(|name| OutCell::Text(name)).collect();
    let mut out = Vec::new();
    write_cells(&mut out, &cells, &mut zmij::Buffer::new(), 0);
    out
}

/// Appends one row.
pub(super) fn write_cells(out: &mut Vec<u8>, cells: &[OutCell<'_>], float: &mut zmij::Buffer, offset_s: i32) {
    for (i, cell) in cells.iter().enumerate() {
        if i > 0 {
            out.push(b',');
        }
        match cell {
            OutCell::Absent => {}
            OutCell::Float(x) => out.extend_from_slice(float.format_finite(*x).as_bytes()),
            OutCell::Text(text) => write_text(out, text, cells.len() == 1),
            OutCell::Index(k) => out.extend_from_slice(k.to_string().as_bytes()),
            OutCell::Date(ns) => out.extend_from_slice(time::utc_text(*ns, offset_s).as_bytes()),
        }
    }
    if let [OutCell::Absent] = cells {
        // A line of nothing would be no row.
        out.extend_from_slice(b"\"\"");
    }
    out.push(b'\n');
}

/// Appends text, in quotes where a reader needs them.
fn write_text(out: &mut Vec<u8>, text: &str, is_alone: bool) {
    let needs_quotes = text.bytes().any(|b| matches!(b, b',' | b'"' | b'\n' | b'\r')) || is_alone && text.is_empty();
    if !needs_quotes {
        out.extend_from_slice(text.as_bytes());
        return;
    }
    out.push(b'"');
    for byte in text.bytes() {
        if byte == b'"' {
            out.push(b'"');
        }
        out.push(byte);
    }
    out.push(b'"');
}
