//! A value of a spec or of a step with the place it stands at, whichever format it came from.

use super::names::{list, suggestion};
use crate::error::BuildError;
use std::path::Path;
use toml::Spanned;
use toml::de::{DeFloat, DeInteger, DeTable, DeValue};

/// Largest size of a number in a spec. Covariances multiply a few of them; beyond, a run would end in infinities.
const LARGEST: f64 = 1e15;

/// A value and its line.
pub(super) struct Node {
    /// `None` for a document as a whole.
    line: Option<u64>,
    value: Value,
}

enum Value {
    Text(String),
    /// As a number and as it was written.
    Number(f64, String),
    List(Vec<Node>),
    Table(Vec<Entry>),
    /// What no key takes or only [`Field::flag`] does: true, false, null, dates, as they were written.
    Word(String),
}

struct Entry {
    key: String,
    line: u64,
    node: Node,
}

/// Offsets at which the lines of a text begin.
struct Lines(Vec<usize>);

impl Lines {
    fn of(text: &str) -> Lines {
        Lines(core::iter::once(0).chain(text.match_indices('\n').map(|(i, _)| i + 1)).collect())
    }

    /// Line, from 1, of the byte at `offset`.
    fn line(&self, offset: usize) -> u64 {
        self.0.partition_point(|&start| start <= offset) as u64
    }
}

impl Node {
    /// The tables of a TOML document, the content of `file`, entries in order of their lines.
    pub(super) fn of_toml(text: &str, file: &Path) -> Result<Node, BuildError> {
        let lines = Lines::of(text);
        let document = DeTable::parse(text).map_err(|e| {
            let line = e.span().map(|span| lines.line(span.start));
            BuildError::new(file, line, None, format!("is no TOML: {}", e.message()))
        })?;
        Ok(Node { line: None, value: toml_table(document.get_ref(), &lines) })
    }

    /// An object of one line of NDJSON.
    pub(super) fn from_json(members: Vec<(String, serde_json::Value)>, line: u64) -> Node {
        let entries = members.into_iter().map(|(key, v)| Entry { key, line, node: json_value(v, line) });
        Node { line: Some(line), value: Value::Table(entries.collect()) }
    }

    /// A document with one table, of words that stand in no file: each a number, `true`, `false`, or else a text.
    pub(super) fn of_words(table: &str, words: &[(&str, &str)]) -> Node {
        let word = |text: &str| match text.parse::<f64>() {
            Ok(v) => Value::Number(v, text.to_owned()),
            Err(_) if text == "true" || text == "false" => Value::Word(text.to_owned()),
            Err(_) => Value::Text(text.to_owned()),
        };
        let entry = |key: &str, value: Value| Entry { key: key.to_owned(), line: 0, node: Node { line: None, value } };
        let entries = words.iter().map(|(key, text)| entry(key, word(text))).collect();
        Node { line: None, value: Value::Table(vec![entry(table, Value::Table(entries))]) }
    }

    /// This value as the root of `file`; keys inside are dotted from `key`, which may be empty.
    pub(super) fn field<'a>(&'a self, file: &'a Path, key: &str) -> Field<'a> {
        Field { file, key: key.to_owned(), node: self }
    }
}

fn toml_table(table: &DeTable<'_>, lines: &Lines) -> Value {
    let mut entries: Vec<(usize, Entry)> = table
        .iter()
        .map(|(key, value)| {
            let start = key.span().start;
            let entry =
                Entry { key: key.get_ref().to_string(), line: lines.line(start), node: toml_value(value, lines) };
            (start, entry)
        })
        .collect();
    entries.sort_by_key(|(start, _)| *start);
    Value::Table(entries.into_iter().map(|(_, entry)| entry).collect())
}

fn toml_value(value: &Spanned<DeValue<'_>>, lines: &Lines) -> Node {
    let node = match value.get_ref() {
        DeValue::String(s) => Value::Text(s.to_string()),
        DeValue::Integer(i) => Value::Number(integer(i), i.to_string()),
        DeValue::Float(f) => Value::Number(float(f), f.to_string()),
        DeValue::Array(items) => Value::List(items.iter().map(|item| toml_value(item, lines)).collect()),
        DeValue::Table(table) => toml_table(table, lines),
        DeValue::Boolean(b) => Value::Word(b.to_string()),
        DeValue::Datetime(d) => Value::Word(d.to_string()),
    };
    Node { line: Some(lines.line(value.span().start)), value: node }
}

/// The nearest `f64`; NaN, which no key takes, for what is no number.
fn integer(i: &DeInteger<'_>) -> f64 {
    match i.radix() {
        10 => i.as_str().parse().unwrap_or(f64::NAN),
        radix => i128::from_str_radix(i.as_str(), radix).map_or(f64::NAN, |v| v as f64),
    }
}

fn float(f: &DeFloat<'_>) -> f64 {
    f.as_str().parse().unwrap_or(f64::NAN)
}

fn json_value(value: serde_json::Value, line: u64) -> Node {
    let value = match value {
        serde_json::Value::Null => Value::Word("null".to_owned()),
        serde_json::Value::Bool(b) => Value::Word(b.to_string()),
        serde_json::Value::Number(n) => Value::Number(n.as_f64().unwrap_or(f64::NAN), n.to_string()),
        serde_json::Value::String(s) => Value::Text(s),
        serde_json::Value::Array(items) => Value::List(items.into_iter().map(|v| json_value(v, line)).collect()),
        serde_json::Value::Object(members) => return Node::from_json(members.into_iter().collect(), line),
    };
    Node { line: Some(line), value }
}

/// A value that knows its file, line and dotted key.
#[derive(Clone)]
pub(super) struct Field<'a> {
    file: &'a Path,
    key: String,
    node: &'a Node,
}

impl<'a> Field<'a> {
    /// An error here.
    pub(super) fn error(&self, what: impl Into<String>) -> BuildError {
        BuildError::new(self.file, self.node.line, Some(&self.key), what)
    }

    /// The error "is VALUE, expected EXPECTED".
    pub(super) fn misfit(&self, expected: impl core::fmt::Display) -> BuildError {
        self.error(format!("is {}, expected {expected}", self.shown()))
    }

    /// The value in a few characters, for messages.
    pub(super) fn shown(&self) -> String {
        /// Longest text repeated in a message, in characters.
        const LONGEST: usize = 60;
        let text = match &self.node.value {
            Value::Text(s) => format!("{s:?}"),
            Value::Number(_, text) | Value::Word(text) => text.clone(),
            Value::List(items) => match items.len() {
                0 => "an empty list".to_owned(),
                1 => "a list of 1 value".to_owned(),
                n => format!("a list of {n} values"),
            },
            Value::Table(_) => "a table".to_owned(),
        };
        match text.char_indices().nth(LONGEST) {
            Some((end, _)) => format!("{}…", &text[..end]),
            None => text,
        }
    }

    /// The text.
    pub(super) fn text(&self, expected: &str) -> Result<&'a str, BuildError> {
        match &self.node.value {
            Value::Text(s) => Ok(s),
            _ => Err(self.misfit(expected)),
        }
    }

    /// Whether it is `true`.
    pub(super) fn flag(&self) -> Result<bool, BuildError> {
        match &self.node.value {
            Value::Word(w) if w == "true" => Ok(true),
            Value::Word(w) if w == "false" => Ok(false),
            _ => Err(self.misfit("true or false")),
        }
    }

    /// The number, which is finite and satisfies `fits`.
    pub(super) fn number(&self, expected: &str, fits: impl Fn(f64) -> bool) -> Result<f64, BuildError> {
        match self.node.value {
            Value::Number(v, _) if v.is_finite() && v.abs() > LARGEST => {
                Err(self.misfit(format!("{expected}, at most {LARGEST:e} in size")))
            }
            Value::Number(v, _) if v.is_finite() && fits(v) => Ok(v),
            _ => Err(self.misfit(expected)),
        }
    }

    /// The whole number in `from..=to`.
    pub(super) fn count(&self, from: usize, to: usize) -> Result<usize, BuildError> {
        let fits = |v: f64| v.fract() == 0.0 && v >= from as f64 && v <= to as f64;
        self.number(&format!("a whole number from {from} to {to}"), fits).map(|v| v as usize)
    }

    /// The elements, or `None` when this is no list.
    pub(super) fn elements(&self) -> Option<Vec<Field<'a>>> {
        let Value::List(items) = &self.node.value else { return None };
        let field = |(i, node)| Field { file: self.file, key: format!("{}[{i}]", self.key), node };
        Some(items.iter().enumerate().map(field).collect())
    }

    /// The elements of a list that is not empty.
    pub(super) fn list(&self, expected: &str) -> Result<Vec<Field<'a>>, BuildError> {
        self.elements().filter(|e| !e.is_empty()).ok_or_else(|| self.misfit(expected))
    }

    /// Whether it is a table.
    pub(super) fn is_table(&self) -> bool {
        matches!(self.node.value, Value::Table(_))
    }

    /// The table.
    pub(super) fn table(&self, expected: &str) -> Result<Table<'a>, BuildError> {
        match &self.node.value {
            Value::Table(entries) => {
                Ok(Table { file: self.file, key: self.key.clone(), line: self.node.line, entries })
            }
            _ => Err(self.misfit(expected)),
        }
    }
}

/// A table that knows its file, line and dotted key.
pub(super) struct Table<'a> {
    file: &'a Path,
    key: String,
    line: Option<u64>,
    entries: &'a [Entry],
}

impl<'a> Table<'a> {
    /// The dotted name of `key` in this table.
    pub(super) fn dotted(&self, key: &str) -> String {
        if self.key.is_empty() { key.to_owned() } else { format!("{}.{key}", self.key) }
    }

    /// The file it stands in.
    pub(super) fn file(&self) -> &'a Path {
        self.file
    }

    /// The value of `key`.
    pub(super) fn get(&self, key: &str) -> Option<Field<'a>> {
        let entry = self.entries.iter().find(|e| e.key == key)?;
        Some(Field { file: self.file, key: self.dotted(key), node: &entry.node })
    }

    /// The value of `key`, which must be there.
    pub(super) fn require(&self, key: &str, expected: &str) -> Result<Field<'a>, BuildError> {
        self.get(key).ok_or_else(|| self.missing(key, expected))
    }

    /// The error "is missing, expected EXPECTED".
    pub(super) fn missing(&self, key: &str, expected: impl core::fmt::Display) -> BuildError {
        self.error(key, format!("is missing, expected {expected}"))
    }

    /// An error at `key`, on its line if it is there and on the table's, if that has one, when it is not.
    pub(super) fn error(&self, key: &str, what: impl Into<String>) -> BuildError {
        match self.get(key) {
            Some(field) => field.error(what),
            None => BuildError::new(self.file, self.line, Some(&self.dotted(key)), what),
        }
    }

    /// Keys and values in order of their lines.
    pub(super) fn fields(&self) -> impl Iterator<Item = (&'a str, Field<'a>)> + '_ {
        let field = |e: &'a Entry| Field { file: self.file, key: self.dotted(&e.key), node: &e.node };
        self.entries.iter().map(move |e| (e.key.as_str(), field(e)))
    }

    /// Nothing, if every key is among `expected`. `later` are keys that will be available one day; `whose` says what the
    /// table is.
    pub(super) fn only(&self, whose: &str, expected: &[&str], later: &[&str]) -> Result<(), BuildError> {
        let Some(stray) = self.entries.iter().find(|e| !expected.contains(&e.key.as_str())) else { return Ok(()) };
        let expected_list = list(expected.iter().copied());
        let what = if later.contains(&stray.key.as_str()) {
            format!("is not available yet, expected {expected_list}")
        } else {
            let hint = suggestion(&stray.key, expected.iter().copied());
            format!("is not a key of {whose}, expected {expected_list}{hint}")
        };
        let key = self.dotted(&stray.key.escape_debug().to_string());
        Err(BuildError::new(self.file, Some(stray.line), Some(&key), what))
    }
}
