//! What the columns of a measurement table hold.

use crate::cell::Cell;
use crate::columns::{self, Extent, HeaderError, Known, aliased, known};
use crate::formats::Row;
use crate::options::{LinearShape, ReadOptions};
use crate::record::{Parts, Shape};
use fixtrail_track::error::BuildError;
use fixtrail_track::packet::Kind;
use std::path::Path;

/// The columns of the contract, `z1 …` and `u1 …` aside.
const KNOWN: [Known; 16] = [
    known("t"),
    aliased("target", "tag"),
    known("kind"),
    aliased("anchor", "anchor_id"),
    aliased("anchor2", "anchor_id2"),
    known("value"),
    known("x"),
    known("y"),
    known("z"),
    known("lat"),
    known("lon"),
    known("alt"),
    known("sd"),
    known("seq"),
    known("received"),
    known("k"),
];

/// Index into [`KNOWN`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Col {
    T,
    Target,
    Kind,
    Anchor,
    Anchor2,
    Value,
    X,
    Y,
    Z,
    Lat,
    Lon,
    Alt,
    Sd,
    Seq,
    Received,
    K,
}

/// The columns of one measurement table.
#[derive(Clone)]
pub(crate) struct Schema<'a> {
    /// The file, for messages.
    pub file: &'a Path,
    /// The file's names.
    names: Vec<String>,
    known: [Option<usize>; KNOWN.len()],
    /// Positions of `z1 …`.
    pub z: Vec<Option<usize>>,
    /// Positions of `u1 …`.
    pub u: Vec<Option<usize>>,
    /// Position of the column with the probability that a value is new.
    pub arrival: Option<usize>,
    /// Kind of rows that do not name one.
    pub kind: Option<Kind>,
    /// Whether packets do not say when they were sensed.
    unstamped: bool,
    /// Names that nobody asked for.
    pub ignored: Vec<String>,
}

impl<'a> Schema<'a> {
    /// The columns of a table of which nothing is known yet.
    pub fn new(file: &'a Path) -> Schema<'a> {
        Schema {
            file,
            names: Vec::new(),
            known: [None; KNOWN.len()],
            z: Vec::new(),
            u: Vec::new(),
            arrival: None,
            kind: None,
            unstamped: false,
            ignored: Vec::new(),
        }
    }

    /// Whether the table has a column.
    pub fn has(&self, col: Col) -> bool {
        self.known[col as usize].is_some()
    }

    /// Where a column of ours stands in the file.
    pub fn place(&self, col: Col) -> Option<usize> {
        self.known[col as usize]
    }

    /// Number of columns of the file.
    pub fn width(&self) -> usize {
        self.names.len()
    }

    /// Whether the time index of a linear row is its number among the rows of its target.
    pub fn numbers_rows(&self) -> bool {
        !self.has(Col::K) && !self.has(Col::T)
    }

    /// The words that a record of this table needs.
    pub fn shape(&self) -> Shape {
        let highest = |cols: &[Col]| cols.iter().rposition(|col| self.has(*col)).map_or(0, |i| i + 1);
        let positions = highest(&[Col::X, Col::Y, Col::Z]).max(highest(&[Col::Lat, Col::Lon, Col::Alt]));
        let only = self.kind.filter(|kind| !self.has(Col::Kind) && matches!(kind, Kind::Position | Kind::Linear));
        let (n_values, n_inputs) = match only {
            Some(Kind::Position) => (positions, 0),
            Some(_) => (self.z.len(), self.u.len()),
            None => (positions.max(self.z.len()).max(1), self.u.len()),
        };
        Shape::new(&Parts {
            t: self.has(Col::T),
            k: self.has(Col::K) || self.numbers_rows(),
            kind: only,
            n_values,
            n_inputs,
            sd: self.has(Col::Sd),
            seq: self.has(Col::Seq),
            received: self.has(Col::Received),
            arrival: self.arrival.is_some(),
        })
    }

    /// The cell of a row in a column of ours.
    pub fn cell<'r, R: Row>(&self, row: &'r R, col: Col) -> Cell<'r> {
        self.known[col as usize].map_or(Cell::Absent, |i| row.cell(i))
    }

    /// The file's name of the column at a position, or what we call it when it is not there.
    pub fn name(&self, place: Option<usize>, ours: &str) -> String {
        place.map_or_else(|| ours.to_owned(), |i| self.names[i].clone())
    }

    /// The file's name of a column of ours, or ours.
    pub fn shown(&self, col: Col) -> String {
        self.name(self.place(col), KNOWN[col as usize].name)
    }

    /// An error about a column of a row.
    pub fn at(&self, line: u64, col: Col, what: impl Into<String>) -> BuildError {
        BuildError::new(self.file, Some(line), Some(&self.shown(col)), what)
    }

    /// Returns the columns among the file's `names`. `before` is the schema so far when NDJSON brings a new key.
    pub fn resolve(
        before: &Schema<'a>,
        names: &[String],
        options: &ReadOptions,
        extent: Extent,
    ) -> Result<Schema<'a>, HeaderError> {
        columns::check_unique(names)?;
        let mapping = &options.columns;
        for ours in mapping.keys() {
            let is_numbered = numbered(ours, 'z').or(numbered(ours, 'u')).is_some();
            if !is_numbered && !KNOWN.iter().any(|k| k.name == ours || k.alias == Some(ours)) {
                let ours_all: Vec<String> = KNOWN.iter().map(|k| k.name.to_owned()).collect();
                let what = format!(
                    "is no column of ours in `[columns]`, expected one of {}, `z1` …, `u1` …",
                    columns::list(&ours_all)
                );
                return Err((Some(ours.clone()), what));
            }
        }
        let find = |name: &str, alias| columns::find(names, name, alias, mapping, extent);
        let mut schema = Schema { names: names.to_vec(), unstamped: options.unstamped, ..Schema::new(before.file) };
        for (place, k) in schema.known.iter_mut().zip(&KNOWN) {
            *place = find(k.name, k.alias)?;
        }
        if options.unstamped && !schema.has(Col::T) {
            schema.known[Col::T as usize] = schema.known[Col::Received as usize];
        }
        if let Some(name) = &options.arrival {
            schema.arrival = names.iter().position(|n| n == name);
            if schema.arrival.is_none() && extent == Extent::Whole {
                let what = format!(
                    "is missing, `link.arrival` of the spec says it holds the arrival rate; there are {}",
                    columns::list(names)
                );
                return Err((Some(name.clone()), what));
            }
        }
        // z1 … belong to a linear model; in any other table they are columns nobody asked for.
        let may_be_linear = options.linear.is_some() || matches!(options.default_kind, None | Some(Kind::Linear));
        // One more than there are columns is as wrong as any number, and no long list.
        let most =
            |prefix: char| names.iter().filter_map(|n| numbered(n, prefix)).max().unwrap_or(0).min(names.len() + 1);
        let shape = match options.linear {
            Some(shape) => shape,
            None if may_be_linear => LinearShape { q: most('z'), p_u: most('u') },
            None => LinearShape { q: 0, p_u: 0 },
        };
        for i in 1..=shape.q {
            schema.z.push(find(&format!("z{i}"), None)?);
        }
        for i in 1..=shape.p_u {
            schema.u.push(find(&format!("u{i}"), None)?);
        }

        let has_position = schema.has(Col::X) || schema.has(Col::Lat);
        schema.kind = match (options.default_kind, options.linear) {
            (Some(kind), _) => Some(kind),
            (None, Some(_)) => Some(Kind::Linear),
            (None, None) if schema.has(Col::Kind) => None,
            (None, None) => match (shape.q > 0, has_position, schema.has(Col::Value)) {
                (true, false, false) => Some(Kind::Linear),
                (false, true, false) => Some(Kind::Position),
                _ if extent == Extent::SoFar && !before.names.is_empty() => before.kind,
                (false, false, false) => {
                    let why = "and there is no measurement: expected `value`, `x` and `y`, `lat` and `lon`, or `z1` …";
                    return Err(columns::missing("kind", why, names));
                }
                _ => {
                    let why = "and the columns do not tell what was measured: expected a column `kind`, or one `[[sensor]]` in a spec";
                    return Err(columns::missing("kind", why, names));
                }
            },
        };
        schema.ignored = (0..names.len()).filter(|i| !schema.reads(*i)).map(|i| names[i].clone()).collect();
        if extent == Extent::Whole {
            schema.check_required(shape)?;
        }
        Ok(schema)
    }

    /// Whether the column at a position of the file is read.
    pub fn reads(&self, place: usize) -> bool {
        [&self.known[..], &self.z, &self.u, &[self.arrival]].iter().any(|places| places.contains(&Some(place)))
    }

    /// Refuses a table without the columns that every row will need.
    fn check_required(&self, shape: LinearShape) -> Result<(), HeaderError> {
        let names = &self.names;
        let need = |col: Col, why: &str| match self.has(col) {
            true => Ok(()),
            false => Err(columns::missing(KNOWN[col as usize].name, why, names)),
        };
        if self.has(Col::Lat) != self.has(Col::Lon) && !self.has(Col::X) {
            need(Col::Lat, "expected `lat` beside `lon`")?;
            need(Col::Lon, "expected `lon` beside `lat`")?;
        }
        if self.kind == Some(Kind::Linear) {
            let (q, p_u) = (shape.q, shape.p_u);
            if let Some(i) = self.z.iter().position(Option::is_none) {
                let why = format!("expected `z1` … `z{q}` for the {q} rows of C");
                return Err(columns::missing(&format!("z{}", i + 1), &why, names));
            }
            let is_extra = |i: usize| numbered(&names[i], 'z').is_some_and(|z| z > q) && !self.reads(i);
            if let Some(extra) = (0..names.len()).find(|i| is_extra(*i)).map(|i| &names[i]) {
                return Err((Some(extra.clone()), format!("is one too many, C has {q} rows: expected `z1` … `z{q}`")));
            }
            if let Some(i) = self.u.iter().position(Option::is_none) {
                let why = format!("expected `u1` … `u{p_u}` for the {p_u} columns of B");
                return Err(columns::missing(&format!("u{}", i + 1), &why, names));
            }
            return Ok(());
        }
        let or_received = if self.unstamped { " (or `received`, as the link has no time stamps)" } else { "" };
        need(Col::T, &format!("expected the time in seconds or RFC 3339{or_received}"))?;
        match self.kind.filter(|_| !self.has(Col::Kind)) {
            Some(Kind::Position) if !self.has(Col::Lat) => {
                need(Col::X, "expected `x` and `y` in metres, or `lat` and `lon`")
            }
            Some(Kind::Range | Kind::Rssi | Kind::Bearing | Kind::Tdoa) => {
                need(Col::Value, "expected the measured value")?;
                need(Col::Anchor, "expected the id of an anchor")?;
                match self.kind {
                    Some(Kind::Tdoa) => need(Col::Anchor2, "expected the id of the reference anchor"),
                    _ => Ok(()),
                }
            }
            _ => Ok(()),
        }
    }
}

/// The number in a name such as `z12`.
fn numbered(name: &str, prefix: char) -> Option<usize> {
    let digits = name.strip_prefix(prefix)?;
    let is_plain = !digits.starts_with('0') && digits.bytes().all(|b| b.is_ascii_digit());
    digits.parse().ok().filter(|_| is_plain)
}
