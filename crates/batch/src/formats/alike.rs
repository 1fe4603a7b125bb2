//! Lines of JSON that are the line before but for their values.
//!
//! Most tables repeat one line: the same keys in the same order, numbers, and names in quotes. What stands between the values is compared as
//! bytes; only a line that differs is parsed.

use super::Row;
use super::decimal::leading;
use crate::cell::Cell;
use memchr::memchr;
use std::borrow::Cow;

/// What stands around the values of a line, and what they are.
pub(super) struct Pattern {
    /// The column of each value, and what stands before it, the quote of a text included.
    values: Vec<(usize, Vec<u8>, Kind)>,
    /// What stands after the last.
    end: Vec<u8>,
    /// Columns of a row.
    width: usize,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Number,
    Text,
}

/// The cells of a line, by column.
#[derive(Default)]
pub(super) struct Cells<'a> {
    cells: Vec<Cell<'a>>,
}

impl Row for Cells<'_> {
    fn cell(&self, column: usize) -> Cell<'_> {
        match self.cells.get(column) {
            Some(Cell::Text(text)) => Cell::Text(Cow::Borrowed(text)),
            Some(cell) => cell.clone(),
            None => Cell::Absent,
        }
    }

    #[inline]
    fn number(&self, column: usize) -> Option<f64> {
        match self.cells.get(column) {
            Some(Cell::Float(x)) => Some(*x),
            Some(Cell::Int(i)) => Some(*i as f64),
            _ => None,
        }
    }

    #[inline]
    fn text(&self, column: usize) -> Option<&str> {
        match self.cells.get(column) {
            Some(Cell::Text(text)) => Some(text),
            _ => None,
        }
    }

    #[inline]
    fn whole(&self, column: usize) -> Option<i64> {
        match self.cells.get(column) {
            Some(Cell::Int(i)) => Some(*i),
            _ => None,
        }
    }
}

impl Pattern {
    /// The pattern of a line that is known to be a JSON object; `column` is the place of a key. `None` where a value is neither a number nor
    /// a text, or anything is written with a backslash.
    pub fn of(line: &str, width: usize, column: impl Fn(&str) -> Option<usize>) -> Option<Pattern> {
        let bytes = line.as_bytes();
        let mut pattern = Pattern { values: Vec::new(), end: Vec::new(), width };
        let (mut at, mut from) = (0, 0);
        if memchr(b'\\', bytes).is_some() {
            return None;
        }
        while let Some(quote) = memchr(b'"', &bytes[at..]) {
            let key = at + quote + 1;
            let key_end = key + memchr(b'"', &bytes[key..])?;
            let colon = key_end + memchr(b':', &bytes[key_end..])?;
            let value = colon + 1 + bytes[colon + 1..].iter().position(|b| !b.is_ascii_whitespace())?;
            let column = column(line[key..key_end].trim())?;
            let (kind, start) = if bytes[value] == b'"' { (Kind::Text, value + 1) } else { (Kind::Number, value) };
            pattern.values.push((column, bytes[from..start].to_vec(), kind));
            from = start + length(&bytes[start..], kind)?;
            at = from + usize::from(kind == Kind::Text);
        }
        pattern.end = bytes[from..].to_vec();
        (!pattern.values.is_empty()).then_some(pattern)
    }

    /// Puts the cells of a line into `cells`; whether it has this pattern.
    #[inline]
    pub fn cells<'a>(&self, line: &'a str, cells: &mut Cells<'a>) -> bool {
        cells.cells.clear();
        cells.cells.resize(self.width, Cell::Absent);
        let mut at = 0;
        for (column, before, kind) in &self.values {
            let rest = &line.as_bytes()[at..];
            if !rest.starts_with(before) {
                return false;
            }
            at += before.len();
            let rest = &line.as_bytes()[at..];
            let (cell, length) = match kind {
                Kind::Text => {
                    // A text that is escaped, or blank at an end, needs a closer look.
                    let end = rest.iter().position(|b| matches!(b, b'"' | b'\\' | 0..=b' ' | 0x7F..));
                    match end {
                        Some(end) if end > 0 && rest[end] == b'"' => {
                            (Cell::Text(Cow::Borrowed(&line[at..at + end])), end)
                        }
                        _ => return false,
                    }
                }
                Kind::Number => match number(rest) {
                    Some(found) => found,
                    None => return false,
                },
            };
            cells.cells[*column] = cell;
            at += length;
        }
        line.as_bytes()[at..] == self.end
    }
}

/// Bytes of the value at the beginning of `text`, its quote aside.
fn length(text: &[u8], kind: Kind) -> Option<usize> {
    match kind {
        Kind::Text => memchr(b'"', text),
        Kind::Number => number(text).map(|(_, length)| length),
    }
}

/// The JSON number at the beginning of `text` and its length; `None` for one that needs a closer look.
#[inline]
fn number(text: &[u8]) -> Option<(Cell<'static>, usize)> {
    let (value, length) = leading(text)?;
    let digits = usize::from(text[0] == b'-');
    let is_json = text[digits].is_ascii_digit()
        && !(text[digits] == b'0' && text.get(digits + 1).is_some_and(u8::is_ascii_digit))
        && text[length - 1] != b'.'
        && matches!(text.get(length), Some(b',' | b'}' | b' '));
    if !is_json {
        return None;
    }
    let is_whole = !text[..length].contains(&b'.');
    // -0 is a number of its own.
    let is_int = is_whole && !(value == 0.0 && digits == 1);
    Some((if is_int { Cell::Int(value as i64) } else { Cell::Float(value) }, length))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cells(pattern: &str, line: &str) -> Option<Vec<Cell<'static>>> {
        let names = ["t", "target", "x", "y"];
        let pattern = Pattern::of(pattern, 4, |key| names.iter().position(|name| *name == key))?;
        let mut cells = Cells::default();
        let owned = |cell: &Cell<'_>| match cell {
            Cell::Text(text) => Cell::Text(Cow::Owned(text.clone().into_owned())),
            Cell::Int(i) => Cell::Int(*i),
            Cell::Float(x) => Cell::Float(*x),
            _ => Cell::Absent,
        };
        pattern.cells(line, &mut cells).then(|| cells.cells.iter().map(owned).collect())
    }

    #[test]
    fn a_line_like_the_pattern_says_what_json_says() {
        let pattern = r#"{"t":0.1,"target":"a b", "x" : -3}"#;
        let text = |text: &str| Cell::Text(Cow::Owned(text.to_owned()));
        assert_eq!(
            cells(pattern, r#"{"t":12,"target":"7", "x" : 0.5}"#),
            Some(vec![Cell::Int(12), text("7"), Cell::Float(0.5), Cell::Absent])
        );
        for other in [
            r#"{"t":12,"target":"7","x" : 0.5}"#,
            r#"{"t":12,"target":"7", "x" : 0.5} "#,
            r#"{"t":12,"target":"7", "x" : 0.5,"y":1}"#,
            r#"{"t":12,"target":"7\n", "x" : 0.5}"#,
            r#"{"t":12,"target":"", "x" : 0.5}"#,
            r#"{"t":12,"target":" 7", "x" : 0.5}"#,
            r#"{"t":12,"target":"7", "x" : null}"#,
            r#"{"t":12,"target":"7", "x" : 1e3}"#,
            r#"{"t":012,"target":"7", "x" : 1}"#,
            r#"{"t":.5,"target":"7", "x" : 1}"#,
            r#"{"t":5.,"target":"7", "x" : 1}"#,
            r#"{"t":-,"target":"7", "x" : 1}"#,
            r#"{"t":12"#,
            "",
        ] {
            assert_eq!(cells(pattern, other), None, "{other}");
        }
        assert_eq!(cells(r#"{"t":0}"#, r#"{"t":-0}"#).unwrap()[0], Cell::Float(-0.0));
        assert_eq!(cells(r#"{"t":0}"#, r#"{"t":0}"#).unwrap()[0], Cell::Int(0));
    }

    #[test]
    fn what_is_not_plain_has_no_pattern() {
        for line in [
            r#"{"t":null}"#,
            r#"{"t":true}"#,
            r#"{"t":[1]}"#,
            r#"{"t":{"x":1}}"#,
            r#"{"\u0074":1}"#,
            "{}",
            r#"{"a":1}"#,
        ] {
            assert_eq!(cells(line, line), None, "{line}");
        }
    }
}
