//! Rows become the packets of their targets.

use crate::columns::Extent;
use crate::content::{AnchorIds, Reading};
use crate::formats::{Row, TableSink};
use crate::options::{Counts, ReadOptions};
use crate::schema::{Col, Schema};
use crate::time::Stamp;
use fixtrail_track::anchors::Anchors;
use fixtrail_track::error::BuildError;
use fixtrail_track::packet::{Kind, Packet};
use std::collections::HashMap;
use std::path::Path;

/// How a table writes its times or positions, and the first row that shows it.
#[derive(Clone, Copy)]
pub(crate) struct Seen {
    /// Times: whether they are dates. Positions: whether they are latitude and longitude.
    pub form: bool,
    /// The row.
    pub line: u64,
}

/// Dates of a packet, nanoseconds since 1970.
#[derive(Clone, Copy)]
pub(crate) struct Dates {
    /// Of `t`.
    pub sensed_ns: i64,
    /// Of `received`.
    pub received_ns: Option<i64>,
}

/// The packets of one target as they come.
#[derive(Default)]
pub(crate) struct Group {
    /// Its id; `None` when there is no target column.
    pub target: Option<String>,
    /// Its packets; where times are dates, `t_s` and `received_s` follow when the epoch is known.
    pub packets: Vec<Packet>,
    /// Dates of the packets, where times are dates.
    pub dates: Vec<Dates>,
    latest: Option<Stamp>,
    rows: u64,
}

/// The targets in order of their first rows.
#[derive(Default)]
struct Groups {
    positions: HashMap<String, usize>,
    list: Vec<Group>,
}

impl Groups {
    fn of(&mut self, target: Option<&str>) -> &mut Group {
        let key = target.unwrap_or_default();
        let i = match self.positions.get(key) {
            Some(i) => *i,
            None => {
                self.positions.insert(key.to_owned(), self.list.len());
                self.list.push(Group { target: target.map(str::to_owned), ..Group::default() });
                self.list.len() - 1
            }
        };
        &mut self.list[i]
    }
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

/// Collects the packets of a table.
pub(crate) struct Rows<'a> {
    pub schema: Schema<'a>,
    pub options: &'a ReadOptions,
    pub anchors: AnchorIds<'a>,
    groups: Groups,
    pub times: Option<Seen>,
    pub positions: Option<Seen>,
    /// Line of the first row that refers to an anchor.
    pub anchored: Option<u64>,
    /// Offset of the dates from UTC; `Some(None)` when they differ.
    pub offset_s: Option<Option<i32>>,
    pub counts: Counts,
}

impl<'a> Rows<'a> {
    pub fn new(file: &'a Path, options: &'a ReadOptions, anchors: &'a Anchors) -> Rows<'a> {
        Rows {
            schema: Schema::new(file),
            options,
            anchors: AnchorIds::new(anchors),
            groups: Groups::default(),
            times: None,
            positions: None,
            anchored: None,
            offset_s: None,
            counts: Counts::default(),
        }
    }

    /// The targets that have packets.
    pub fn take_groups(&mut self) -> Vec<Group> {
        let mut list = std::mem::take(&mut self.groups).list;
        list.retain(|g| !g.packets.is_empty());
        list
    }

    fn take<R: Row>(&mut self, line: u64, row: &R) -> Result<(), RowError> {
        let at = Reading { schema: &self.schema, anchors: &self.anchors, line, row };
        let target = at.schema.cell(row, Col::Target);
        let target = target.name("the id of a target").map_err(|what| at.fail(Col::Target, what))?;
        if target.is_none() && at.schema.has(Col::Target) {
            return Err(at.fail(Col::Target, "is empty, expected the id of a target").into());
        }
        let kind = at.kind()?;
        if self.options.kinds.as_ref().is_some_and(|kinds| !kinds.contains(&kind)) {
            *self.counts.ignored_kinds.entry(kind.name().to_owned()).or_default() += 1;
            return Ok(());
        }
        // A row of a linear run is an instant even when it turns out bad.
        let group = self.groups.of(target.as_deref());
        group.rows += 1;

        let time = at.schema.cell(row, Col::T).stamp().map_err(|what| at.fail(Col::T, what))?;
        if time.is_none() && (at.schema.has(Col::T) || kind != Kind::Linear) {
            return Err(at.fail(Col::T, "is empty, expected a time in seconds or RFC 3339").into());
        }
        let received = at.schema.cell(row, Col::Received).stamp().map_err(|what| at.fail(Col::Received, what))?;
        let k = if kind == Kind::Linear { at.k(group.rows - 1)? } else { None };
        let sd = at.sd()?;
        let seq = at.schema.cell(row, Col::Seq).count("a sequence number, a whole number from 0");
        let seq = seq.map_err(|what| at.fail(Col::Seq, what))?;
        let arrival = at.arrival()?;
        let (content, is_geodetic) = at.content(kind)?;

        let times = same_time_form(&at, self.times, time, received)?;
        let positions = same_position_form(&at, self.positions, is_geodetic)?;

        let latency_s = self.options.latency_s.get(&kind).copied().unwrap_or(0.0);
        let t_s = match (time, k) {
            (Some(Stamp::Seconds(t_s)), _) => t_s - latency_s,
            (None, Some(k)) => k as f64,
            _ => 0.0,
        };
        let received_s = match received {
            Some(Stamp::Seconds(t_s)) => Some(t_s),
            _ => None,
        };
        self.times = times;
        self.positions = positions;
        if !matches!(kind, Kind::Position | Kind::Linear) {
            self.anchored = self.anchored.or(Some(line));
        }
        if let Some(Stamp::Utc { ns, offset_s }) = time {
            let before = self.offset_s.unwrap_or(Some(offset_s));
            self.offset_s = Some(before.filter(|o| *o == offset_s));
            let received_ns = match received {
                Some(Stamp::Utc { ns, .. }) => Some(ns),
                _ => None,
            };
            group.dates.push(Dates { sensed_ns: ns, received_ns });
        }
        group.packets.push(Packet { t_s, k, content, sd, seq, received_s, arrival, line });
        if let Some(now) = time {
            match group.latest {
                Some(latest) if now.is_before(latest) => self.counts.out_of_order += 1,
                _ => group.latest = Some(now),
            }
        }
        Ok(())
    }

    /// Counts a bad row, or returns its error when bad rows are not skipped.
    fn skip(&mut self, error: BuildError) -> Result<(), BuildError> {
        if !self.options.skip_bad_rows {
            return Err(error);
        }
        self.counts.skipped_bad += 1;
        self.counts.first_bad.get_or_insert_with(|| error.to_string());
        Ok(())
    }
}

fn same_time_form<R: Row>(
    at: &Reading<'_, R>,
    mut seen: Option<Seen>,
    time: Option<Stamp>,
    received: Option<Stamp>,
) -> Result<Option<Seen>, RowError> {
    for (col, stamp) in [(Col::T, time), (Col::Received, received)] {
        let Some(stamp) = stamp else { continue };
        let form = matches!(stamp, Stamp::Utc { .. });
        match seen {
            None => seen = Some(Seen { form, line: at.line }),
            Some(first) if first.form != form => {
                let words = |is_date| if is_date { "RFC 3339" } else { "seconds" };
                let cell = at.schema.cell(at.row, col);
                let what = format!(
                    "is {} where line {} has {}, expected one form of time in the table",
                    cell.show(),
                    first.line,
                    words(first.form)
                );
                return Err(RowError::Fatal(at.fail(col, what)));
            }
            Some(_) => {}
        }
    }
    Ok(seen)
}

fn same_position_form<R: Row>(
    at: &Reading<'_, R>,
    seen: Option<Seen>,
    is_geodetic: Option<bool>,
) -> Result<Option<Seen>, RowError> {
    let Some(form) = is_geodetic else { return Ok(seen) };
    match seen {
        Some(first) if first.form != form => {
            let words = |is_geodetic| if is_geodetic { "`lat` and `lon`" } else { "`x` and `y`" };
            let col = if form { Col::Lat } else { Col::X };
            let what = format!(
                "gives a position in {} where line {} has {}, expected one form of position in the table",
                words(form),
                first.line,
                words(first.form)
            );
            Err(RowError::Fatal(at.fail(col, what)))
        }
        seen => Ok(seen.or(Some(Seen { form, line: at.line }))),
    }
}

impl TableSink for Rows<'_> {
    fn columns(&mut self, names: &[String], extent: Extent) -> Result<Vec<bool>, BuildError> {
        let file = self.schema.file;
        self.schema = Schema::resolve(&self.schema, names, self.options, extent)
            .map_err(|(key, what)| BuildError::new(file, None, key.as_deref(), what))?;
        self.counts.ignored_columns = self.schema.ignored.clone();
        Ok((0..names.len()).map(|i| self.schema.reads(i)).collect())
    }

    fn row<R: Row>(&mut self, line: u64, row: &R) -> Result<(), BuildError> {
        self.counts.rows += 1;
        match self.take(line, row) {
            Ok(()) => Ok(()),
            Err(RowError::Bad(error)) => self.skip(error),
            Err(RowError::Fatal(error)) => Err(error),
        }
    }

    fn malformed(&mut self, error: BuildError) -> Result<(), BuildError> {
        self.counts.rows += 1;
        if !self.schema.has(Col::Target) {
            self.groups.of(None).rows += 1;
        }
        self.skip(error)
    }
}
