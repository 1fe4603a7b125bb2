//! One JSON object per line.

use super::alike::{Cells, Pattern};
use super::lines::{self, Lines};
use super::{Part, Progress, Row, TableSink, unreadable};
use crate::cell::{Cell, clip};
use crate::columns::Extent;
use crate::input::Source;
use crate::ordered::ordered;
use fixtrail_track::error::BuildError;
use memchr::memchr;
use serde_core::de::{DeserializeSeed, Deserializer, MapAccess, SeqAccess, Visitor};
use std::borrow::Cow;
use std::cell::RefCell;
use std::collections::HashMap;
use std::fmt;
use std::path::Path;
use std::sync::Arc;

/// The keys seen so far and the cells of the current row, by position of the key.
#[derive(Default)]
pub(super) struct Keys {
    names: Vec<String>,
    positions: HashMap<String, usize>,
    cells: Vec<Option<Cell<'static>>>,
    /// What lines have looked like of late.
    pattern: Option<Pattern>,
    /// Lines since one looked like it.
    misses: u32,
}

/// Lines that look otherwise before another pattern is tried.
const MOST_MISSES: u32 = 16;

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
pub(super) fn read<S: TableSink>(source: Source<'_>, sink: &mut S, progress: Progress<'_>) -> Result<(), BuildError> {
    let (file, total, done) = (source.file, source.total, source.counter());
    let mut lines = Lines::new(source.reader);
    let (mut keys, mut first_line, mut rows) = (Keys::default(), 1, 0);
    while let Some(block) = lines.next().map_err(|e| unreadable(file, &e))? {
        let parsed = parse(&block, (file, first_line), &mut keys, NewKey::Told, sink);
        parsed.refused.map_or(Ok(()), Err)?;
        rows += parsed.rows;
        first_line += lines::count(&block);
        progress(done.get(), total);
    }
    end(file, rows, &keys, sink)
}

/// What all who read a part know of the table.
struct Known<P> {
    keys: Keys,
    part: P,
}

/// A block of lines on its way.
struct Piece<P> {
    block: Vec<u8>,
    first_line: u64,
    /// What was known when it set out.
    known: Arc<Known<P>>,
    /// Bytes read so far.
    bytes: u64,
}

/// Reads every line into parts.
///
/// What a row says may depend on the keys before it. So a block that has a new key is read again in its turn, and so are those that set out
/// before the key was known.
pub(super) fn read_parts<P: Part + Sync>(
    source: Source<'_>,
    mut part: P,
    threads: usize,
    join: &mut dyn FnMut(P::Block) -> Result<(), BuildError>,
    progress: Progress<'_>,
) -> Result<P, BuildError> {
    let (file, total, done) = (source.file, source.total, source.counter());
    let mut lines = Lines::new(source.reader);
    let (mut keys, mut first, mut rows) = (Keys::default(), 1, 0);
    let newest = RefCell::new(Arc::new(Known { keys: keys.fork(), part: part.fork() }));
    let next = || {
        let Some(block) = lines.next().map_err(|e| unreadable(file, &e))? else { return Ok(None) };
        let first_line = first;
        first += lines::count(&block);
        Ok(Some(Piece { block, first_line, known: newest.borrow().clone(), bytes: done.get() }))
    };
    let work = |kept: &mut Option<(Arc<Known<P>>, Keys, P)>, piece: Piece<P>| {
        if let Some((known, ..)) = kept
            && !Arc::ptr_eq(known, &piece.known)
        {
            *kept = None;
        }
        let fork = || (piece.known.clone(), piece.known.keys.fork(), piece.known.part.fork());
        let (_, keys, part) = kept.get_or_insert_with(fork);
        let parsed = parse(&piece.block, (file, piece.first_line), keys, NewKey::Stops, part);
        let block = part.cut();
        (piece, block, parsed)
    };
    let take = |(piece, mut block, mut parsed): (Piece<P>, P::Block, Parsed)| {
        let mut newest = newest.borrow_mut();
        if parsed.has_new_key || !Arc::ptr_eq(&newest, &piece.known) {
            let known = keys.names.len();
            parsed = parse(&piece.block, (file, piece.first_line), &mut keys, NewKey::Told, &mut part);
            block = part.cut();
            if keys.names.len() > known {
                *newest = Arc::new(Known { keys: keys.fork(), part: part.fork() });
            }
        }
        rows += parsed.rows;
        join(block)?;
        progress(piece.bytes, total);
        parsed.refused.map_or(Ok(()), Err)
    };
    ordered(threads, || None, next, work, take)?;
    end(file, rows, &keys, &mut part)?;
    Ok(part)
}

/// The whole table has been read.
fn end<S: TableSink>(file: &Path, rows: u64, keys: &Keys, sink: &mut S) -> Result<(), BuildError> {
    if rows == 0 {
        return Err(BuildError::new(file, None, None, "has no rows, expected one JSON object per line"));
    }
    sink.columns(&keys.names, Extent::Whole).map(drop)
}

/// What to do about a key that was not there before.
#[derive(Clone, Copy, PartialEq, Eq)]
enum NewKey {
    /// The sink is told.
    Told,
    /// Nothing more is read.
    Stops,
}

/// What came of a block.
#[derive(Default)]
struct Parsed {
    rows: u64,
    /// Why reading ended early.
    refused: Option<BuildError>,
    has_new_key: bool,
}

/// Reads the lines of a block.
fn parse<S: TableSink>(
    block: &[u8],
    (file, first_line): (&Path, u64),
    keys: &mut Keys,
    new_key: NewKey,
    sink: &mut S,
) -> Parsed {
    let text = std::str::from_utf8(block).ok();
    let (mut parsed, mut alike, mut start) = (Parsed::default(), Cells::default(), 0);
    for line in first_line.. {
        if start >= block.len() {
            break;
        }
        let end = memchr(b'\n', &block[start..]).map_or(block.len(), |end| start + end);
        let (bytes, shown) = (&block[start..end], text.map(|text| &text[start..end]));
        start = end + 1;
        if let (Some(text), Some(pattern)) = (shown, &keys.pattern)
            && pattern.cells(text, &mut alike)
        {
            keys.misses = 0;
            parsed.rows += 1;
            parsed.refused = sink.row(line, &alike).err();
        } else {
            let bytes = if line == 1 { bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes) } else { bytes };
            if bytes.trim_ascii().is_empty() {
                continue;
            }
            parsed.rows += 1;
            let known = keys.names.len();
            let read = parse_line(bytes, keys);
            let has_new_key = read.is_ok() && keys.names.len() > known;
            if has_new_key && new_key == NewKey::Stops {
                keys.forget(known);
                parsed.has_new_key = true;
                return parsed;
            }
            let result = match read {
                Ok(()) => {
                    keys.look(shown, has_new_key);
                    keys.tell(has_new_key, line, sink).and_then(|()| sink.row(line, keys))
                }
                Err(what) => {
                    keys.forget(known);
                    sink.malformed(BuildError::new(file, Some(line), None, what))
                }
            };
            parsed.refused = result.err();
        }
        if parsed.refused.is_some() {
            break;
        }
    }
    parsed
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

/// Reads lines whose keys are known.
///
/// # Errors
/// [`BuildError`] from `sink`, and where a line has another key.
pub(super) fn read_span<S: TableSink>(
    block: &[u8],
    (file, first_line): (&Path, u64),
    keys: &mut Keys,
    sink: &mut S,
) -> Result<(), BuildError> {
    match parse(block, (file, first_line), keys, NewKey::Stops, sink) {
        Parsed { has_new_key: true, .. } => {
            Err(BuildError::new(file, None, None, "has a key that its first row has not"))
        }
        parsed => parsed.refused.map_or(Ok(()), Err),
    }
}

impl Keys {
    /// The keys of the first line of a block, if it is an object.
    pub fn of_first(block: &[u8]) -> Option<Keys> {
        let mut keys = Keys::default();
        let line = block.split(|b| *b == b'\n').next()?;
        parse_line(line, &mut keys).ok()?;
        Some(keys)
    }

    /// The keys, by position.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// The same keys for another reader.
    pub fn fork(&self) -> Keys {
        Keys {
            names: self.names.clone(),
            positions: self.positions.clone(),
            cells: vec![None; self.names.len()],
            ..Keys::default()
        }
    }

    /// Tells a sink of new keys.
    fn tell<S: TableSink>(&self, has_new_key: bool, line: u64, sink: &mut S) -> Result<(), BuildError> {
        if !has_new_key {
            return Ok(());
        }
        sink.columns(&self.names, Extent::SoFar).map(drop).map_err(|mut e| {
            e.place.line = Some(line);
            e
        })
    }

    /// Looks at a line that was not alike for a pattern of those to come.
    fn look(&mut self, line: Option<&str>, has_new_key: bool) {
        self.misses += 1;
        if has_new_key || self.misses > MOST_MISSES {
            self.pattern = None;
        }
        if self.pattern.is_none() {
            self.misses = 0;
            let place = |key: &str| self.positions.get(key).copied();
            self.pattern = line.and_then(|line| Pattern::of(line, self.names.len(), place));
        }
    }

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
