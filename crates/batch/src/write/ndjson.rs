//! A trail as one JSON object per line.

use super::columns::OutCell;
use super::{Encoder, Piece, WriteError};
use crate::time;

pub(super) fn append(encoder: &Encoder<'_>, piece: &Piece<'_>, out: &mut Vec<u8>) -> Result<(), WriteError> {
    let (keys, offset_s) = (keys(&encoder.columns.names()), encoder.offset_s());
    encoder.rows(piece, |cells| {
        for (key, cell) in keys.iter().zip(cells) {
            out.extend_from_slice(key.as_bytes());
            write_cell(out, cell, offset_s);
        }
        out.extend_from_slice(b"}\n");
    })
}

/// `{"target":`, `,"t":`, …
pub(super) fn keys(names: &[String]) -> Vec<String> {
    let key = |(i, name): (usize, &String)| format!("{}{}:", if i == 0 { '{' } else { ',' }, json_text(name));
    names.iter().enumerate().map(key).collect()
}

pub(super) fn write_cell(out: &mut Vec<u8>, cell: &OutCell<'_>, offset_s: i32) {
    match cell {
        OutCell::Absent => out.extend_from_slice(b"null"),
        OutCell::Float(x) => out.extend_from_slice(zmij::Buffer::new().format_finite(*x).as_bytes()),
        OutCell::Index(k) => out.extend_from_slice(k.to_string().as_bytes()),
        OutCell::Text(text) => out.extend_from_slice(json_text(text).as_bytes()),
        OutCell::Date(ns) => {
            out.push(b'"');
            out.extend_from_slice(time::utc_text(*ns, offset_s).as_bytes());
            out.push(b'"');
        }
    }
}

/// A JSON string.
fn json_text(text: &str) -> String {
    serde_json::Value::from(text).to_string()
}
