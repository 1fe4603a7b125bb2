//! One JSON object per line.

use super::{PROGRESS_ROWS, Progress, Row, TableSink};
use crate::cell::{Cell, clip};
use crate::columns::Extent;
use crate::input::Source;
use fixtrail_track::error::BuildError;
use serde_core::de::{DeserializeSeed, Deserializer, MapAccess, SeqAccess, Visitor};
use std::borrow::Cow;
use std::collections::HashMap;
use std::fmt;

/// The keys seen so far and the cells of the current row, by position of the key.
#[derive(Default)]
struct Keys {
    names: Vec<String>,
    positions: HashMap<String, usize>,
    cells: Vec<Option<Cell<'static>>>,
}

impl Row for Keys {
    fn cell(&self, column: usize) -> Cell<'_> {
        match self.cells.get(column) {
            Some(Some(Cell::Text(t))) => Cell::Text(Cow::Borrowed(t)),
            Some(Some(cell)) => cell.clone(),
            _ => Cell::Absent,
        }
    }

    fn number(&self, column: usize) -> Option<f64> {
        match self.cells.get(column) {
            Some(Some(Cell::Float(x))) => Some(*x),
            Some(Some(Cell::Int(i))) => Some(*i as f64),
            _ => None,
        }
    }

    fn text(&self, column: usize) -> Option<&str> {
        match self.cells.get(column) {
            Some(Some(Cell::Text(text))) => Some(text),
            _ => None,
        }
    }

    fn whole(&self, column: usize) -> Option<i64> {
        match self.cells.get(column) {
            Some(Some(Cell::Int(i))) => Some(*i),
            _ => None,
        }
    }
}

/// Reads every line.
pub(super) fn read<S: TableSink>(
    mut source: Source<'_>,
    sink: &mut S,
    progress: Progress<'_>,
) -> Result<(), BuildError> {
    let file = source.file;
    let mut keys = Keys::default();
    let mut text = Vec::new();
    let (mut line, mut rows) = (0_u64, 0_u64);
    loop {
        text.clear();
        let n = source
            .reader
            .read_until(b'\n', &mut text)
            .map_err(|e| BuildError::new(file, Some(line + 1), None, format!("cannot be read: {e}")))?;
        if n == 0 {
            break;
        }
        line += 1;
        let bytes = if line == 1 { text.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(&text) } else { &text };
        if bytes.trim_ascii().is_empty() {
            continue;
        }
        rows += 1;
        let known = keys.names.len();
        match parse_line(bytes, &mut keys) {
            Ok(()) => {
                if keys.names.len() > known {
                    sink.columns(&keys.names, Extent::SoFar).map_err(|mut e| {
                        e.place.line = Some(line);
                        e
                    })?;
                }
                sink.row(line, &keys)?;
            }
            Err(what) => {
                keys.forget(known);
                sink.malformed(BuildError::new(file, Some(line), None, what))?;
            }
        }
        if rows.is_multiple_of(PROGRESS_ROWS) {
            progress(source.bytes_done(), source.total);
        }
    }
    if rows == 0 {
        return Err(BuildError::new(file, None, None, "has no rows, expected one JSON object per line"));
    }
    sink.columns(&keys.names, Extent::Whole)?;
    progress(source.bytes_done(), source.total);
    Ok(())
}

fn parse_line(bytes: &[u8], keys: &mut Keys) -> Result<(), String> {
    let text = std::str::from_utf8(bytes)
        .map_err(|e| format!("has bytes at {} that are not UTF-8, expected UTF-8 text", e.valid_up_to() + 1))?;
    keys.cells.iter_mut().for_each(|c| *c = None);
    let mut json = serde_json::Deserializer::from_str(text);
    keys.deserialize(&mut json).and_then(|()| json.end()).map_err(|e| {
        // Its own line number is always 1.
        let why = e.to_string();
        let why = why.split(" at line ").next().unwrap_or_default();
        format!("is `{}`, expected a JSON object: {why} (character {})", clip(text.trim()), e.column())
    })
}

impl Keys {
    fn position(&mut self, key: &str) -> usize {
        if let Some(i) = self.positions.get(key) {
            return *i;
        }
        self.names.push(key.to_owned());
        self.positions.insert(key.to_owned(), self.names.len() - 1);
        self.cells.push(None);
        self.names.len() - 1
    }

    /// Forgets the keys that only a malformed line had.
    fn forget(&mut self, known: usize) {
        for name in self.names.drain(known..) {
            self.positions.remove(&name);
        }
        self.cells.truncate(known);
    }
}

impl<'de> DeserializeSeed<'de> for &mut Keys {
    type Value = ();
    fn deserialize<D: Deserializer<'de>>(self, json: D) -> Result<(), D::Error> {
        json.deserialize_map(self)
    }
}

impl<'de> Visitor<'de> for &mut Keys {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an object")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<(), A::Error> {
        while let Some(i) = map.next_key_seed(Key(&mut *self))? {
            if self.cells[i].is_some() {
                return Err(serde_core::de::Error::custom(format_args!("the key `{}` stands twice", self.names[i])));
            }
            self.cells[i] = Some(map.next_value_seed(Value)?);
        }
        Ok(())
    }
}

/// Turns a key into its position without allocating when it is known.
struct Key<'a>(&'a mut Keys);

impl<'de> DeserializeSeed<'de> for Key<'_> {
    type Value = usize;
    fn deserialize<D: Deserializer<'de>>(self, json: D) -> Result<usize, D::Error> {
        json.deserialize_str(self)
    }
}

impl Visitor<'_> for Key<'_> {
    type Value = usize;
    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a key")
    }
    fn visit_str<E>(self, key: &str) -> Result<usize, E> {
        Ok(self.0.position(key.trim()))
    }
}

/// Turns a value into a cell.
struct Value;

impl<'de> DeserializeSeed<'de> for Value {
    type Value = Cell<'static>;
    fn deserialize<D: Deserializer<'de>>(self, json: D) -> Result<Cell<'static>, D::Error> {
        json.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for Value {
    type Value = Cell<'static>;
    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a number, a string or null")
    }
    fn visit_unit<E>(self) -> Result<Cell<'static>, E> {
        Ok(Cell::Absent)
    }
    fn visit_bool<E>(self, _: bool) -> Result<Cell<'static>, E> {
        Ok(Cell::Other("a Boolean"))
    }
    fn visit_i64<E>(self, i: i64) -> Result<Cell<'static>, E> {
        Ok(Cell::Int(i))
    }
    fn visit_u64<E>(self, i: u64) -> Result<Cell<'static>, E> {
        Ok(i64::try_from(i).map_or(Cell::Float(i as f64), Cell::Int))
    }
    fn visit_f64<E>(self, x: f64) -> Result<Cell<'static>, E> {
        Ok(Cell::Float(x))
    }
    fn visit_str<E>(self, text: &str) -> Result<Cell<'static>, E> {
        Ok(match text.trim() {
            "" => Cell::Absent,
            text => Cell::Text(Cow::Owned(text.to_owned())),
        })
    }
    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Cell<'static>, A::Error> {
        while seq.next_element_seed(Value)?.is_some() {}
        Ok(Cell::Other("a list"))
    }
    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Cell<'static>, A::Error> {
        // Keys are read as values: no allocation is worth saving here.
        while map.next_key_seed(Value)?.is_some() {
            map.next_value_seed(Value)?;
        }
        Ok(Cell::Other("an object"))
    }
}
