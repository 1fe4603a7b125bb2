//! Rows become records, a block of rows at a time.

use crate::cell::LARGEST;
use crate::columns::Extent;
use crate::content::{AnchorIds, Reading};
use crate::formats::decimal::leading;
use crate::formats::{Part, Row, Slab, TableSink};
use crate::names::{Lookup, MOST_TARGETS, Names, TargetId};
use crate::options::{Counts, ReadOptions};
use crate::record::{MOST_LINES, Shape};
use crate::schema::{Col, Schema};
use crate::time::Stamp;
use fixtrail_track::error::BuildError;
use fixtrail_track::packet::{Kind, Packet};
use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

/// How a table writes its times or positions, and the first row that shows it.
#[derive(Clone, Debug)]
pub(crate) struct Seen {
    /// Times: whether they are dates. Positions: whether they are latitude and longitude.
    pub form: bool,
    /// The row.
    pub line: u64,
    /// The file's name of the column that shows it.
    pub name: String,
    /// Its cell as messages show it.
    pub shown: String,
}

/// What a block of rows holds.
#[derive(Default)]
pub(crate) struct Block {
    /// Records, and their shape.
    pub words: Vec<u64>,
    pub shape: Shape,
    /// What was counted; rows out of order are not, for they show in the whole table alone.
    pub counts: Counts,
    /// Form of the times.
    pub times: Option<Seen>,
    /// Form of the positions.
    pub positions: Option<Seen>,
    /// Line of the first row that refers to an anchor.
    pub anchored: Option<u64>,
    /// Offset of the dates from UTC; `Some(None)` when they differ.
    pub offset_s: Option<Option<i32>>,
    /// How many rows of each target there were, where `k` is the number of a row: counted from 0 in each block.
    pub numbered: HashMap<TargetId, u64>,
}

/// Why a row is not taken.
enum RowError {
    /// The row is bad; it can be skipped.
    Bad(BuildError),
    /// The table contradicts itself.
    Fatal(BuildError),
}

impl From<BuildError> for RowError {
    fn from(error: BuildError) -> RowError {
        RowError::Bad(error)
    }
}

/// Where the cells of a row stand that is a target, a time in seconds and numbers, and nothing else.
#[derive(Clone)]
struct PlainRow {
    t: usize,
    target: Option<usize>,
    values: Vec<usize>,
    latency_s: f64,
    /// What each column of the file is.
    roles: Vec<Role>,
}

/// What a column is to a plain row.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Role {
    T,
    Target,
    Value(usize),
    Nothing,
}

/// Turns rows into a block of records.
pub(crate) struct Rows<'a> {
    pub schema: Schema<'a>,
    options: &'a ReadOptions,
    anchors: &'a AnchorIds<'a>,
    names: Arc<Names>,
    lookup: Lookup,
    plain: Option<PlainRow>,
    numbers: Vec<f64>,
    block: Block,
}

impl<'a> Rows<'a> {
    pub fn new(file: &'a Path, options: &'a ReadOptions, anchors: &'a AnchorIds<'a>, names: Arc<Names>) -> Rows<'a> {
        Rows {
            schema: Schema::new(file),
            options,
            anchors,
            names,
            lookup: Lookup::default(),
            plain: None,
            numbers: Vec::new(),
            block: Block::default(),
        }
    }

    /// Gives an empty part room that another block has had.
    pub fn use_room(&mut self, mut words: Vec<u64>) {
        words.clear();
        self.block.words = words;
    }

    /// Takes a row of which every cell is what it is in almost every table; whether it was one.
    #[inline]
    fn take_plain<R: Row>(&mut self, line: u64, row: &R) -> bool {
        let Some(plain) = &self.plain else { return false };
        let ordinary = |column: usize| row.number(column).filter(|x| x.abs() <= LARGEST);
        let Some(t_s) = ordinary(plain.t) else { return false };
        for (number, column) in self.numbers.iter_mut().zip(&plain.values) {
            let Some(x) = ordinary(*column) else { return false };
            *number = x + 0.0;
        }
        let is_first = self.block.times.is_none();
        if is_first || line >= MOST_LINES || self.block.times.as_ref().is_some_and(|seen| seen.form) {
            return false;
        }
        let id = match plain.target.map(|column| (row.text(column), row.whole(column))) {
            None => self.lookup.id(&self.names, ""),
            Some((Some(name), _)) => self.lookup.id(&self.names, name),
            Some((None, Some(number))) => self.lookup.numbered(&self.names, number),
            Some((None, None)) => return false,
        };
        if id as usize >= MOST_TARGETS {
            return false;
        }
        self.block.shape.push_plain(id, line, t_s + 0.0 - plain.latency_s, &self.numbers, &mut self.block.words);
        true
    }

    fn take<R: Row>(&mut self, line: u64, row: &R) -> Result<(), RowError> {
        let at = Reading { schema: &self.schema, anchors: self.anchors, line, row };
        if line >= MOST_LINES {
            return Err(RowError::Fatal(
                at.fail(Col::T, format!("is in line {line}, expected less than {MOST_LINES} lines")),
            ));
        }
        let target = at.schema.cell(row, Col::Target);
        let target = target.name("the id of a target").map_err(|what| at.fail(Col::Target, what))?;
        if target.is_none() && at.schema.has(Col::Target) {
            return Err(at.fail(Col::Target, "is empty, expected the id of a target").into());
        }
        let kind = at.kind()?;
        if self.options.kinds.as_ref().is_some_and(|kinds| !kinds.contains(&kind)) {
            *self.block.counts.ignored_kinds.entry(kind.name().to_owned()).or_default() += 1;
            return Ok(());
        }
        let id = self.lookup.id(&self.names, target.as_deref().unwrap_or_default());
        if id as usize >= MOST_TARGETS {
            let what = format!("is one target more than the {MOST_TARGETS} there is room for");
            return Err(RowError::Fatal(at.fail(Col::Target, what)));
        }
        // A row of a linear run is an instant even when it turns out bad.
        let number = count_row(&self.schema, id, &mut self.block);

        let time = at.schema.cell(row, Col::T).stamp().map_err(|what| at.fail(Col::T, what))?;
        if time.is_none() && (at.schema.has(Col::T) || kind != Kind::Linear) {
            return Err(at.fail(Col::T, "is empty, expected a time in seconds or RFC 3339").into());
        }
        let received = at.schema.cell(row, Col::Received).stamp().map_err(|what| at.fail(Col::Received, what))?;
        let k = if kind == Kind::Linear { at.k(number)? } else { None };
        let sd = at.sd()?;
        let seq = at.schema.cell(row, Col::Seq).count("a sequence number, a whole number from 0");
        let seq = seq.map_err(|what| at.fail(Col::Seq, what))?;
        let arrival = at.arrival()?;
        let (content, is_geodetic) = at.content(kind)?;

        let times = same_time_form(&at, &self.block.times, time, received)?;
        let positions = same_position_form(&at, &self.block.positions, is_geodetic)?;

        let latency_s = self.options.latency_s.get(&kind).copied().unwrap_or(0.0);
        let t_s = match (time, k) {
            (Some(Stamp::Seconds(t_s)), _) => t_s - latency_s,
            (None, Some(k)) => k as f64,
            _ => 0.0,
        };
        if times.is_some() {
            self.block.times = times;
        }
        if positions.is_some() {
            self.block.positions = positions;
        }
        if !matches!(kind, Kind::Position | Kind::Linear) {
            self.block.anchored = self.block.anchored.or(Some(line));
        }
        if let Some(Stamp::Utc { offset_s, .. }) = time {
            let before = self.block.offset_s.unwrap_or(Some(offset_s));
            self.block.offset_s = Some(before.filter(|o| *o == offset_s));
        }
        let packet = Packet { k, sd, seq, arrival, ..Packet::new(t_s, content, line) };
        self.block.shape.push(id, time, received, &packet, &mut self.block.words);
        Ok(())
    }

    /// Counts a bad row, or returns its error when bad rows are not skipped.
    fn skip(&mut self, error: BuildError) -> Result<(), BuildError> {
        if !self.options.skip_bad_rows {
            return Err(error);
        }
        self.block.counts.skipped_bad += 1;
        self.block.counts.first_bad.get_or_insert_with(|| error.to_string());
        Ok(())
    }

    fn plain_row(&self) -> Option<PlainRow> {
        let (schema, shape) = (&self.schema, &self.block.shape);
        let kind = shape.kind().filter(|_| shape.is_plain() && shape.n_values() > 0 && !schema.has(Col::Kind))?;
        if self.options.kinds.as_ref().is_some_and(|kinds| !kinds.contains(&kind)) {
            return None;
        }
        let values = match kind {
            Kind::Position if !schema.has(Col::Lat) && !schema.has(Col::Lon) && !schema.has(Col::Alt) => {
                [Col::X, Col::Y, Col::Z].into_iter().take(shape.n_values()).map(|col| schema.place(col)).collect()
            }
            Kind::Linear if schema.u.is_empty() => schema.z.iter().copied().collect(),
            _ => None,
        };
        let (t, target, values): (usize, Option<usize>, Vec<usize>) =
            (schema.place(Col::T)?, schema.place(Col::Target), values?);
        let mut roles = vec![Role::Nothing; schema.width()];
        roles[t] = Role::T;
        target.into_iter().for_each(|column| roles[column] = Role::Target);
        values.iter().enumerate().for_each(|(i, column)| roles[*column] = Role::Value(i));
        let latency_s = self.options.latency_s.get(&kind).copied().unwrap_or(0.0);
        Some(PlainRow { t, target, values, latency_s, roles })
    }
}

/// The number of a target's row within this block, where rows are numbered.
fn count_row(schema: &Schema<'_>, id: TargetId, block: &mut Block) -> u64 {
    if !schema.numbers_rows() {
        return 0;
    }
    let count = block.numbered.entry(id).or_default();
    *count += 1;
    *count - 1
}

/// The form of times after a row, if the row shows it for the first time.
fn same_time_form<R: Row>(
    at: &Reading<'_, R>,
    seen: &Option<Seen>,
    time: Option<Stamp>,
    received: Option<Stamp>,
) -> Result<Option<Seen>, RowError> {
    let mut new: Option<Seen> = None;
    for (col, stamp) in [(Col::T, time), (Col::Received, received)] {
        let Some(stamp) = stamp else { continue };
        let shown = || at.schema.cell(at.row, col).show();
        if matches!(stamp, Stamp::Utc { ns: i64::MAX, .. }) {
            return Err(at.fail(col, format!("is {}, expected a time before the end of 2261", shown())).into());
        }
        let form = matches!(stamp, Stamp::Utc { .. });
        let now = || Seen { form, line: at.line, name: at.schema.shown(col), shown: shown() };
        match seen.as_ref().or(new.as_ref()) {
            None => new = Some(now()),
            Some(first) if first.form != form => {
                return Err(RowError::Fatal(other_time_form(at.schema.file, first, &now())));
            }
            Some(_) => {}
        }
    }
    Ok(new)
}

/// The error of a table whose times have two forms.
pub(crate) fn other_time_form(file: &Path, first: &Seen, now: &Seen) -> BuildError {
    let words = if first.form { "RFC 3339" } else { "seconds" };
    let what =
        format!("is {} where line {} has {words}, expected one form of time in the table", now.shown, first.line);
    BuildError::new(file, Some(now.line), Some(&now.name), what)
}

/// The form of positions after a row, if the row shows it for the first time.
fn same_position_form<R: Row>(
    at: &Reading<'_, R>,
    seen: &Option<Seen>,
    is_geodetic: Option<bool>,
) -> Result<Option<Seen>, RowError> {
    let Some(form) = is_geodetic else { return Ok(None) };
    let col = if form { Col::Lat } else { Col::X };
    let now = || Seen { form, line: at.line, name: at.schema.shown(col), shown: String::new() };
    match seen {
        Some(first) if first.form != form => Err(RowError::Fatal(other_position_form(at.schema.file, first, &now()))),
        Some(_) => Ok(None),
        None => Ok(Some(now())),
    }
}

/// The error of a table whose positions have two forms.
pub(crate) fn other_position_form(file: &Path, first: &Seen, now: &Seen) -> BuildError {
    let words = |is_geodetic| if is_geodetic { "`lat` and `lon`" } else { "`x` and `y`" };
    let what = format!(
        "gives a position in {} where line {} has {}, expected one form of position in the table",
        words(now.form),
        first.line,
        words(first.form)
    );
    BuildError::new(file, Some(now.line), Some(&now.name), what)
}

impl TableSink for Rows<'_> {
    fn columns(&mut self, names: &[String], extent: Extent) -> Result<Vec<bool>, BuildError> {
        let file = self.schema.file;
        self.schema = Schema::resolve(&self.schema, names, self.options, extent)
            .map_err(|(key, what)| BuildError::new(file, None, key.as_deref(), what))?;
        self.block.counts.ignored_columns = self.schema.ignored.clone();
        let shape = self.schema.shape();
        if shape != self.block.shape {
            let (before, words) = (self.block.shape, std::mem::take(&mut self.block.words));
            let wide = if words.is_empty() { shape } else { before.union(&shape) };
            words.chunks_exact(before.width.max(1)).for_each(|r| before.widen(r, &wide, &mut self.block.words));
            self.block.shape = wide;
        }
        self.plain = self.plain_row();
        self.numbers = vec![0.0; self.plain.as_ref().map_or(0, |plain| plain.values.len())];
        Ok((0..names.len()).map(|i| self.schema.reads(i)).collect())
    }

    fn row<R: Row>(&mut self, line: u64, row: &R) -> Result<(), BuildError> {
        self.block.counts.rows += 1;
        if self.take_plain(line, row) {
            return Ok(());
        }
        match self.take(line, row) {
            Ok(()) => Ok(()),
            Err(RowError::Bad(error)) => self.skip(error),
            Err(RowError::Fatal(error)) => Err(error),
        }
    }

    #[inline]
    fn line(&mut self, line: u64, text: &[u8]) -> Option<usize> {
        let plain = self.plain.as_ref()?;
        let is_ready = self.block.times.as_ref().is_some_and(|seen| !seen.form) && line < MOST_LINES;
        if !is_ready || plain.roles.is_empty() {
            return None;
        }
        let (mut at, mut t_s, mut name, mut id) = (0, 0.0, "", None);
        let last = plain.roles.len() - 1;
        for (i, role) in plain.roles.iter().enumerate() {
            let rest = &text[at..];
            let length = match role {
                Role::Target => match self.lookup.leads(rest) {
                    Some((same, length)) => {
                        id = Some(same);
                        length
                    }
                    None => {
                        let length = rest.iter().position(|b| matches!(b, b',' | b'\n'))?;
                        name = std::str::from_utf8(&rest[..length]).ok()?;
                        // White space around a name is none of it.
                        if name.is_empty() || name.bytes().any(|b| b <= b' ' || b >= 0x7F) {
                            return None;
                        }
                        length
                    }
                },
                Role::T | Role::Value(_) => {
                    let (x, length) = leading(rest)?;
                    if x.abs() > LARGEST {
                        return None;
                    }
                    match role {
                        Role::Value(i) => self.numbers[*i] = x + 0.0,
                        _ => t_s = x + 0.0,
                    }
                    length
                }
                Role::Nothing => rest.iter().position(|b| matches!(b, b',' | b'\n'))?,
            };
            at += length;
            if text.get(at) != Some(if i == last { &b'\n' } else { &b',' }) {
                return None;
            }
            at += 1;
        }
        let id = match id {
            Some(id) => id,
            None => self.lookup.id(&self.names, name),
        };
        if id as usize >= MOST_TARGETS {
            return None;
        }
        self.block.shape.push_plain(id, line, t_s - plain.latency_s, &self.numbers, &mut self.block.words);
        self.block.counts.rows += 1;
        Some(at)
    }

    fn rows<S: Slab>(&mut self, line: u64, slab: &S) -> usize {
        let Some(plain) = &self.plain else { return 0 };
        let Some(t_s) = slab.numbers(plain.t) else { return 0 };
        let Some(values) = plain.values.iter().map(|column| slab.numbers(*column)).collect::<Option<Vec<_>>>() else {
            return 0;
        };
        let ordinary = |x: f64| x.abs() <= LARGEST;
        let is_ready = self.block.times.as_ref().is_some_and(|seen| !seen.form);
        if !is_ready || line + (t_s.len() as u64) >= MOST_LINES || !t_s.first().is_some_and(|t_s| ordinary(*t_s)) {
            return 0;
        }
        let id = match plain.target.map(|column| (slab.text(column), slab.whole(column))) {
            None => self.lookup.id(&self.names, ""),
            Some((Some(name), _)) => self.lookup.id(&self.names, name),
            Some((None, Some(number))) => self.lookup.numbered(&self.names, number),
            Some((None, None)) => return 0,
        };
        if id as usize >= MOST_TARGETS {
            return 0;
        }
        // What goes over many rows comes last: a row that is not taken asks anew.
        let count = plain.target.map_or(t_s.len(), |column| slab.alike(column)).min(t_s.len());
        let mut taken = 0;
        for (i, t_s) in t_s[..count].iter().enumerate() {
            self.numbers.iter_mut().zip(&values).for_each(|(number, column)| *number = column[i] + 0.0);
            if !ordinary(*t_s) || !self.numbers.iter().all(|x| ordinary(*x)) {
                break;
            }
            let t_s = t_s + 0.0 - plain.latency_s;
            self.block.shape.push_plain(id, line + i as u64, t_s, &self.numbers, &mut self.block.words);
            taken += 1;
        }
        self.block.counts.rows += taken as u64;
        taken
    }

    fn malformed(&mut self, error: BuildError) -> Result<(), BuildError> {
        self.block.counts.rows += 1;
        if !self.schema.has(Col::Target) {
            count_row(&self.schema, self.lookup.id(&self.names, ""), &mut self.block);
        }
        self.skip(error)
    }
}

impl Part for Rows<'_> {
    type Block = Block;

    fn fork(&self) -> Self {
        let block = Block { shape: self.block.shape, ..Block::default() };
        Rows {
            schema: self.schema.clone(),
            names: self.names.clone(),
            lookup: Lookup::default(),
            plain: self.plain.clone(),
            numbers: self.numbers.clone(),
            block,
            ..*self
        }
    }

    fn cut(&mut self) -> Block {
        let shape = self.block.shape;
        let mut block = std::mem::replace(&mut self.block, Block { shape, ..Block::default() });
        block.counts.ignored_columns.clone_from(&self.schema.ignored);
        block
    }
}
