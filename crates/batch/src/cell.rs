//! One cell of a table and what it may mean.

use crate::time::{self, Stamp};
use std::borrow::Cow;

/// The largest magnitude of a number in a table: beyond it metres and seconds are surely something else.
pub(crate) const LARGEST: f64 = 1e12;

/// A cell as its format delivers it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Cell<'a> {
    /// Empty or null.
    Absent,
    /// Text, trimmed and not empty.
    Text(Cow<'a, str>),
    /// A whole number.
    Int(i64),
    /// A number.
    Float(f64),
    /// An instant, nanoseconds since 1970-01-01T00:00:00Z.
    Utc(i64),
    /// Something no column takes ("a Boolean").
    Other(&'static str),
}

impl<'a> Cell<'a> {
    /// The cell of a piece of text.
    pub fn text(text: &'a str) -> Cell<'a> {
        match text.trim() {
            "" => Cell::Absent,
            text => Cell::Text(Cow::Borrowed(text)),
        }
    }

    /// The cell as messages show it.
    pub fn show(&self) -> String {
        match self {
            Cell::Absent => "empty".to_owned(),
            Cell::Text(t) => format!("`{}`", clip(t)),
            Cell::Int(i) => format!("`{i}`"),
            Cell::Float(x) => format!("`{x:?}`"),
            Cell::Utc(ns) => format!("`{}`", time::utc_text(*ns, 0)),
            Cell::Other(what) => (*what).to_owned(),
        }
    }

    /// A finite number of ordinary size; `expected` ("a range in metres") completes the message.
    pub fn number(&self, expected: &str) -> Result<Option<f64>, String> {
        let x = match self {
            Cell::Absent => return Ok(None),
            Cell::Float(x) => Some(*x),
            Cell::Int(i) => Some(*i as f64),
            Cell::Text(t) => t.parse().ok(),
            Cell::Utc(_) | Cell::Other(_) => None,
        };
        match x {
            None => Err(format!("is {}, expected {expected}", self.show())),
            Some(x) if !x.is_finite() => {
                Err(format!("is {}, expected {expected}, finite (a lost value is an empty cell)", self.show()))
            }
            Some(x) if x.abs() > LARGEST => {
                Err(format!("is {}, too large: expected {expected} between -1e12 and 1e12", self.show()))
            }
            // -0.0 becomes 0.0, so that equal numbers are equal bytes.
            Some(x) => Ok(Some(x + 0.0)),
        }
    }

    /// A whole number that is not negative.
    pub fn count(&self, expected: &str) -> Result<Option<u64>, String> {
        /// Whole numbers up to here are exact in an f64.
        const EXACT: f64 = 9_007_199_254_740_992.0;
        let from_float = |x: f64| ((0.0..=EXACT).contains(&x) && x.fract() == 0.0).then_some(x as u64);
        let n = match self {
            Cell::Absent => return Ok(None),
            Cell::Int(i) => u64::try_from(*i).ok(),
            Cell::Float(x) => from_float(*x),
            Cell::Text(t) => t.parse().ok().or_else(|| t.parse().ok().and_then(from_float)),
            Cell::Utc(_) | Cell::Other(_) => None,
        };
        n.map(Some).ok_or_else(|| format!("is {}, expected {expected}", self.show()))
    }

    /// A name: text, or a whole number written as one.
    pub fn name(&self, expected: &str) -> Result<Option<Cow<'_, str>>, String> {
        match self {
            Cell::Absent => Ok(None),
            Cell::Text(t) => Ok(Some(Cow::Borrowed(t))),
            Cell::Int(i) => Ok(Some(Cow::Owned(i.to_string()))),
            Cell::Float(x) if x.fract() == 0.0 && x.abs() < LARGEST => Ok(Some(Cow::Owned(format!("{x:.0}")))),
            _ => Err(format!("is {}, expected {expected}", self.show())),
        }
    }

    /// A time: seconds, or RFC 3339.
    pub fn stamp(&self) -> Result<Option<Stamp>, String> {
        const EXPECTED: &str = "a time in seconds or RFC 3339 (2025-03-01T12:00:00Z)";
        match self {
            Cell::Utc(ns) => Ok(Some(Stamp::Utc { ns: *ns, offset_s: 0 })),
            Cell::Text(t) if time::looks_like_a_date(t) => match time::parse_rfc3339(t) {
                Ok(stamp) => Ok(Some(stamp)),
                Err(why) => Err(format!("is {}, expected {EXPECTED}: {why}", self.show())),
            },
            _ => Ok(self.number(EXPECTED)?.map(Stamp::Seconds)),
        }
    }
}

/// The first 40 characters of a value for a message.
pub(crate) fn clip(text: &str) -> Cow<'_, str> {
    match text.char_indices().nth(40) {
        None => Cow::Borrowed(text),
        Some((end, _)) => Cow::Owned(format!("{}…", &text[..end])),
    }
}
