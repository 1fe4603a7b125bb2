//! Truth tables: `t,target,x,y,z`, or `lat,lon,alt`.

use crate::cell::Cell;
use crate::columns::{self, Extent, HeaderError, Known, aliased, known};
use crate::formats::{self, Row, TableSink};
use crate::input::Input;
use crate::settle::to_local;
use crate::table::Table;
use crate::time::{self, Stamp, TimeForm};
use fixtrail_track::error::BuildError;
use fixtrail_track::truth::{TargetTruth, TruthPoint};
use std::collections::BTreeMap;
use std::path::Path;

const KNOWN: [Known; 8] = [
    known("t"),
    aliased("target", "tag"),
    known("x"),
    known("y"),
    known("z"),
    known("lat"),
    known("lon"),
    known("alt"),
];
const T: usize = 0;
const TARGET: usize = 1;
const X: usize = 2;
const LAT: usize = 5;
const LON: usize = 6;
const ALT: usize = 7;

/// Returns the known positions of each target, sorted by target id and time, in the frame and time of `table`.
///
/// A truth without target column belongs to the table's only target. Repeated rows are dropped.
///
/// # Errors
/// [`BuildError`] with file, line, column, value and expectation; also when times are in another form than the table's,
/// when latitudes come to a table in local metres, or when it cannot be told which target a row is about.
pub fn read_truth(path: &Path, table: &Table) -> Result<Vec<TargetTruth>, BuildError> {
    let mut sink = TruthRows { file: path, table, at: [None; KNOWN.len()], points: BTreeMap::new() };
    formats::read(&Input::File(path.to_owned()), None, &mut sink, &mut |_, _| {})?;
    sink.finish()
}

struct TruthRows<'a> {
    file: &'a Path,
    table: &'a Table,
    at: [Option<usize>; KNOWN.len()],
    /// Points with their lines, by target.
    points: BTreeMap<Option<String>, Vec<(u64, TruthPoint)>>,
}

impl TruthRows<'_> {
    fn resolve(&mut self, names: &[String], extent: Extent) -> Result<(), HeaderError> {
        columns::check_unique(names)?;
        for (place, k) in self.at.iter_mut().zip(&KNOWN) {
            *place = columns::find(names, k.name, k.alias, &BTreeMap::new(), extent)?;
        }
        if extent == Extent::SoFar {
            return Ok(());
        }
        let is_missing = |i: usize| self.at[i].is_none();
        if is_missing(T) {
            return Err(columns::missing("t", "expected the time", names));
        }
        if is_missing(X) && (is_missing(LAT) || is_missing(LON)) {
            return Err(columns::missing("x", "expected `x` and `y` in metres, or `lat` and `lon`", names));
        }
        Ok(())
    }

    fn fail(&self, line: u64, i: usize, what: impl Into<String>) -> BuildError {
        BuildError::new(self.file, Some(line), Some(KNOWN[i].name), what)
    }

    fn t_s(&self, line: u64, cell: &Cell<'_>) -> Result<f64, BuildError> {
        let stamp = cell.stamp().map_err(|what| self.fail(line, T, what))?;
        match (stamp, self.table.time) {
            (None, _) => Err(self.fail(line, T, "is empty, expected a time")),
            (Some(Stamp::Seconds(t_s)), TimeForm::Seconds | TimeForm::Index) => Ok(t_s),
            (Some(Stamp::Utc { ns, .. }), TimeForm::Rfc3339 { epoch_unix_s, .. }) => {
                Ok(time::seconds_since(ns, epoch_unix_s))
            }
            (Some(Stamp::Seconds(_)), TimeForm::Rfc3339 { .. }) => {
                Err(self.fail(line, T, format!("is {}, expected RFC 3339 like the measurements", cell.show())))
            }
            (Some(Stamp::Utc { .. }), _) => {
                Err(self.fail(line, T, format!("is {}, expected seconds like the measurements", cell.show())))
            }
        }
    }

    fn position<'c>(&self, line: u64, cell: impl Fn(usize) -> Cell<'c>) -> Result<[Option<f64>; 3], BuildError> {
        let number = |i: usize, unit: &str| cell(i).number(unit).map_err(|what| self.fail(line, i, what));
        let local = [number(X, "metres")?, number(X + 1, "metres")?, number(X + 2, "metres")?];
        if local.iter().any(Option::is_some) {
            return Ok(local);
        }
        let (lat, lon) = (number(LAT, "degrees")?, number(LON, "degrees")?);
        for (i, degrees, most) in [(LAT, lat, 90.0), (LON, lon, 180.0)] {
            match degrees {
                None if self.at[X].is_some() => return Err(self.fail(line, X, "is empty, expected metres")),
                None => return Err(self.fail(line, i, "is empty, expected degrees")),
                Some(d) if d.abs() > most => {
                    return Err(self.fail(line, i, format!("is `{d:?}`, expected degrees from -{most} to {most}")));
                }
                Some(_) => {}
            }
        }
        match &self.table.origin {
            Some(origin) => Ok(to_local(origin, [lat, lon, number(ALT, "metres")?])),
            None => {
                let what = "gives degrees while the measurements are in local metres, expected `x` and `y` in metres";
                Err(self.fail(line, LAT, what))
            }
        }
    }

    fn finish(self) -> Result<Vec<TargetTruth>, BuildError> {
        let mut truths = Vec::with_capacity(self.points.len());
        let ids = self.points.len();
        for (id, mut rows) in self.points {
            let target = match (&id, self.table.has_target) {
                (Some(_), true) => id,
                (None, true) => match self.table.targets.as_slice() {
                    [only] => only.target.clone(),
                    several => {
                        let what = format!(
                            "is missing, the measurements have {} targets: expected a column `target`",
                            several.len()
                        );
                        return Err(BuildError::new(self.file, None, Some("target"), what));
                    }
                },
                (_, false) if ids == 1 => None,
                (_, false) => {
                    let what =
                        format!("has {ids} targets while the measurements have no target column, expected one target");
                    return Err(BuildError::new(self.file, None, Some("target"), what));
                }
            };
            rows.sort_by(|a, b| a.1.t_s.total_cmp(&b.1.t_s).then(a.0.cmp(&b.0)));
            for pair in rows.windows(2).filter(|p| p[0].1.t_s == p[1].1.t_s) {
                let ((first, a), (line, b)) = (pair[0], pair[1]);
                if a != b {
                    let what =
                        format!("puts the target elsewhere than line {first} at the same time, expected one position");
                    return Err(BuildError::new(self.file, Some(line), None, what));
                }
            }
            rows.dedup_by(|a, b| a.1 == b.1);
            truths.push(TargetTruth { target, points: rows.into_iter().map(|(_, p)| p).collect() });
        }
        Ok(truths)
    }
}

impl TableSink for TruthRows<'_> {
    fn columns(&mut self, names: &[String], extent: Extent) -> Result<Vec<bool>, BuildError> {
        self.resolve(names, extent).map_err(|(key, what)| BuildError::new(self.file, None, key.as_deref(), what))?;
        Ok((0..names.len()).map(|i| self.at.contains(&Some(i))).collect())
    }

    fn row<R: Row>(&mut self, line: u64, row: &R) -> Result<(), BuildError> {
        let cell = |i: usize| self.at[i].map_or(Cell::Absent, |c| row.cell(c));
        let id = cell(TARGET);
        let target = id.name("the id of a target").map_err(|what| self.fail(line, TARGET, what))?;
        if target.is_none() && self.at[TARGET].is_some() {
            return Err(self.fail(line, TARGET, "is empty, expected the id of a target"));
        }
        let point = TruthPoint { t_s: self.t_s(line, &cell(T))?, position_m: self.position(line, cell)? };
        let target = target.map(|t| t.into_owned());
        self.points.entry(target).or_default().push((line, point));
        Ok(())
    }

    fn malformed(&mut self, error: BuildError) -> Result<(), BuildError> {
        Err(error)
    }
}
