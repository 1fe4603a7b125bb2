//! A trail as one JSON object per line.

use super::columns::OutCell;
use super::{Job, To, WriteError};
use crate::time::{self, TimeForm};
use std::io::{self, Write};

pub(super) fn write(job: &Job<'_>, to: To<'_>) -> Result<(), WriteError> {
    let columns = job.columns();
    let offset_s = match job.meta.time {
        TimeForm::Rfc3339 { offset_s, .. } => offset_s,
        TimeForm::Seconds | TimeForm::Index => 0,
    };
    let keys = keys(&columns.names);
    let mut cells = Vec::new();
    job.rows(|target, row| {
        columns.fill(job, target, row, &mut cells)?;
        for (key, cell) in keys.iter().zip(&cells) {
            to.write_all(key.as_bytes()).and_then(|()| write_cell(to, cell, offset_s)).map_err(|e| job.io(e))?;
        }
        to.write_all(b"}\n").map_err(|e| job.io(e))
    })
}

/// `{"target":`, `,"t":`, …
pub(super) fn keys(names: &[String]) -> Vec<String> {
    let key = |(i, name): (usize, &String)| format!("{}{}:", if i == 0 { '{' } else { ',' }, json_text(name));
    names.iter().enumerate().map(key).collect()
}

pub(super) fn write_cell(to: &mut dyn Write, cell: &OutCell<'_>, offset_s: i32) -> io::Result<()> {
    match cell {
        OutCell::Absent => to.write_all(b"null"),
        OutCell::Float(x) => to.write_all(ryu::Buffer::new().format_finite(*x).as_bytes()),
        OutCell::Index(k) => write!(to, "{k}"),
        OutCell::Text(text) => to.write_all(json_text(text).as_bytes()),
        OutCell::Date(ns) => write!(to, "\"{}\"", time::utc_text(*ns, offset_s)),
    }
}

/// A JSON string.
fn json_text(text: &str) -> String {
    serde_json::Value::from(text).to_string()
}
