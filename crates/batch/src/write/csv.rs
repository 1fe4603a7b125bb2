//! A trail as CSV.

use super::columns::{OutCell, Source, sd};
use super::{Encoder, Piece, WriteError};
use crate::time;
use fixtrail_track::trail::Trail;

pub(super) fn append(encoder: &Encoder<'_>, piece: &Piece<'_>, out: &mut Vec<u8>) -> Result<(), WriteError> {
    let (mut float, offset_s) = (zmij::Buffer::new(), encoder.offset_s());
    match piece.target.trail.estimates(piece.rows.clone()) {
        Some(estimates) if !encoder.columns.has_geodetic() => append_known(encoder, piece, estimates, out),
        _ => encoder.rows(piece, |cells| write_cells(out, cells, &mut float, offset_s)),
    }
}

/// Appends rows that all have an estimate, cell by cell out of the trail: `means` and packed `covs` are those of the rows.
fn append_known(
    encoder: &Encoder<'_>,
    piece: &Piece<'_>,
    (means, covs): (&[f64], &[f64]),
    out: &mut Vec<u8>,
) -> Result<(), WriteError> {
    let Encoder { columns, .. } = encoder;
    let (mut float, offset_s) = (zmij::Buffer::new(), encoder.offset_s());
    let (trail, list) = (&piece.target.trail, &columns.list);
    let (n, packed) = (trail.n(), Trail::packed_len(trail.n()));
    let mut name = Vec::new();
    write_text(&mut name, piece.target.target.as_deref().unwrap_or_default(), false);
    for (i, row) in piece.rows.clone().enumerate() {
        let (mean, cov) = (&means[i * n..(i + 1) * n], &covs[i * packed..(i + 1) * packed]);
        for column in list {
            let number = match column.source {
                Source::Mean(i) => Some(mean[i]),
                Source::Sd(i) => Some(sd(cov, n, i)),
                Source::Cov(i) => Some(cov[i]),
                Source::Nis => trail.nis[row],
                Source::Time if columns.is_in_seconds() => trail.t_s[row],
                Source::Target => {
                    out.extend_from_slice(&name);
                    None
                }
                Source::Status => {
                    write_short(out, trail.status[row].name().as_bytes());
                    None
                }
                source => match columns.cell(source, piece.target, row) {
                    OutCell::Float(x) => Some(x),
                    cell => {
                        write_cell(out, &cell, &mut float, offset_s);
                        None
                    }
                },
            };
            if let Some(x) = number {
                if !x.is_finite() {
                    return Err(columns.not_finite(encoder.file, column, piece.target, row));
                }
                write_short(out, float.format_finite(x).as_bytes());
            }
            out.push(b',');
        }
        if let Some(end) = out.last_mut() {
            *end = b'\n';
        }
    }
    Ok(())
}

/// Appends a text that is short as a rule: its beginning and its end by moves of fixed length, for which no function is called.
#[inline]
fn write_short(out: &mut Vec<u8>, text: &[u8]) {
    match text.len() {
        n @ 16..=32 => {
            out.extend_from_slice(&text[..16]);
            // The rest overlaps what is there.
            out.truncate(out.len() - (32 - n));
            out.extend_from_slice(&text[n - 16..]);
        }
        n @ 8..16 => {
            out.extend_from_slice(&text[..8]);
            out.truncate(out.len() - (16 - n));
            out.extend_from_slice(&text[n - 8..]);
        }
        _ => out.extend_from_slice(text),
    }
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
            OutCell::Text(text) => write_text(out, text, cells.len() == 1),
            cell => write_cell(out, cell, float, offset_s),
        }
    }
    if let [OutCell::Absent] = cells {
        // A line of nothing would be no row.
        out.extend_from_slice(b"\"\"");
    }
    out.push(b'\n');
}

/// Appends one cell of several.
fn write_cell(out: &mut Vec<u8>, cell: &OutCell<'_>, float: &mut zmij::Buffer, offset_s: i32) {
    match cell {
        OutCell::Absent => {}
        OutCell::Float(x) => out.extend_from_slice(float.format_finite(*x).as_bytes()),
        OutCell::Text(text) => write_text(out, text, false),
        OutCell::Index(k) => out.extend_from_slice(k.to_string().as_bytes()),
        OutCell::Date(ns) => out.extend_from_slice(time::utc_text(*ns, offset_s).as_bytes()),
    }
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
