//! The columns of a trail table, and the cells of a row.

use super::WriteError;
use crate::table::TableMeta;
use crate::time::{self, TimeForm};
use fixtrail_track::geo::{self, Origin};
use fixtrail_track::layout::Layout;
use fixtrail_track::target::TargetTrail;
use fixtrail_track::trail::Trail;
use std::path::Path;

/// What the cells of a column are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ColumnKind {
    Float,
    Index,
    Text,
    Date,
}

/// A cell to write.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum OutCell<'a> {
    Absent,
    Float(f64),
    Index(u64),
    Text(&'a str),
    /// Nanoseconds since 1970.
    Date(i64),
}

/// Where the cells of a column come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Source {
    Target,
    Index,
    Time,
    /// Latitude, longitude or height.
    Geodetic(usize),
    Mean(usize),
    Sd(usize),
    Cov(usize),
    Status,
    Nis,
    LagIndex,
    LagTime,
    LagMean(usize),
    LagSd(usize),
    LagCov(usize),
    LagStatus,
}

/// A column.
pub(super) struct Column {
    pub name: String,
    pub kind: ColumnKind,
    pub source: Source,
}

/// The columns of a trail table in order, and what their cells depend on besides the trail.
pub(super) struct Columns {
    pub list: Vec<Column>,
    n: usize,
    axes: usize,
    is_linear: bool,
    meta: TableMeta,
    has_geodetic: bool,
}

impl Columns {
    pub fn new(layout: &Layout, meta: &TableMeta, has_lagged: bool, has_covariance: bool) -> Columns {
        let is_linear = layout.is_linear();
        let has_geodetic = !is_linear && meta.origin.is_some() && layout.axes >= 2;
        let (n, axes) = (layout.n(), layout.axes);
        let mut columns = Columns { list: Vec::new(), n, axes, is_linear, meta: *meta, has_geodetic };
        let lagged = if has_lagged { Some(has_covariance) } else { None };
        match is_linear {
            true => columns.add_linear(layout, has_covariance, lagged),
            false => columns.add_kinematic(layout, has_covariance, lagged),
        }
        columns
    }

    pub fn names(&self) -> Vec<String> {
        self.list.iter().map(|c| c.name.clone()).collect()
    }

    pub fn kinds(&self) -> Vec<ColumnKind> {
        self.list.iter().map(|c| c.kind).collect()
    }

    fn add(&mut self, name: impl Into<String>, kind: ColumnKind, source: Source) {
        self.list.push(Column { name: name.into(), kind, source });
    }

    fn add_packed(&mut self, prefix: &str, source: fn(usize) -> Source) {
        let mut place = 0;
        for i in 1..=self.n {
            for j in i..=self.n {
                self.add(format!("{prefix}_{i}_{j}"), ColumnKind::Float, source(place));
                place += 1;
            }
        }
    }

    fn add_states(&mut self, names: impl Iterator<Item = String>, source: fn(usize) -> Source) {
        for (i, name) in names.enumerate() {
            self.add(name, ColumnKind::Float, source(i));
        }
    }

    fn add_kinematic(&mut self, layout: &Layout, has_covariance: bool, lagged: Option<bool>) {
        let time = time_kind(&self.meta);
        let names = || layout.names.iter();
        self.add("target", ColumnKind::Text, Source::Target);
        self.add("t", time, Source::Time);
        if self.has_geodetic {
            let geodetic = ["lat", "lon", "alt"].into_iter().take(layout.axes).map(str::to_owned);
            self.add_states(geodetic, Source::Geodetic);
        }
        self.add_states(names().cloned(), Source::Mean);
        self.add_states(names().map(|name| format!("sd_{name}")), Source::Sd);
        self.add("status", ColumnKind::Text, Source::Status);
        self.add("nis", ColumnKind::Float, Source::Nis);
        if has_covariance {
            self.add_packed("p", Source::Cov);
        }
        if let Some(has_covariance) = lagged {
            self.add("t_lag", time, Source::LagTime);
            self.add_states(names().map(|name| format!("{name}_lag")), Source::LagMean);
            self.add_states(names().map(|name| format!("sd_{name}_lag")), Source::LagSd);
            self.add("lag_status", ColumnKind::Text, Source::LagStatus);
            if has_covariance {
                self.add_packed("ps", Source::LagCov);
            }
        }
    }

    fn add_linear(&mut self, layout: &Layout, has_covariance: bool, lagged: Option<bool>) {
        if self.meta.has_target {
            self.add("target", ColumnKind::Text, Source::Target);
        }
        self.add("k", ColumnKind::Index, Source::Index);
        self.add("t", time_kind(&self.meta), Source::Time);
        self.add_states(layout.names.iter().cloned(), Source::Mean);
        self.add("status", ColumnKind::Text, Source::Status);
        self.add("nis", ColumnKind::Float, Source::Nis);
        if has_covariance {
            self.add_packed("p", Source::Cov);
        }
        if let Some(has_covariance) = lagged {
            self.add("lag_k", ColumnKind::Index, Source::LagIndex);
            self.add_states((1..=self.n).map(|i| format!("s{i}")), Source::LagMean);
            if has_covariance {
                self.add_packed("ps", Source::LagCov);
            }
            self.add("lag_status", ColumnKind::Text, Source::LagStatus);
        }
    }

    /// Whether positions are written as latitudes and longitudes too.
    pub fn has_geodetic(&self) -> bool {
        self.has_geodetic
    }

    /// Whether the instants of a row are numbers as the trail has them.
    pub fn is_in_seconds(&self) -> bool {
        self.meta.time == TimeForm::Seconds
    }

    /// Puts the cells of a row into `cells`, in the order of the columns.
    pub fn fill<'a>(
        &self,
        file: &Path,
        target: &'a TargetTrail,
        row: usize,
        cells: &mut Vec<OutCell<'a>>,
    ) -> Result<(), WriteError> {
        cells.clear();
        let geodetic = self.geodetic(target, row);
        for column in &self.list {
            cells.push(match column.source {
                Source::Geodetic(i) => float(geodetic.map(|g| g[i])),
                source => self.cell(source, target, row),
            });
        }
        match cells.iter().position(|c| matches!(c, OutCell::Float(x) if !x.is_finite())) {
            None => Ok(()),
            Some(i) => Err(self.not_finite(file, &self.list[i], target, row)),
        }
    }

    pub fn not_finite(&self, file: &Path, column: &Column, target: &TargetTrail, row: usize) -> WriteError {
        WriteError::NotFinite {
            file: file.to_owned(),
            target: target.target.clone(),
            t: target.trail.t_s[row].map_or("-".to_owned(), |t_s| self.meta.time.text(t_s)),
            column: column.name.clone(),
        }
    }

    /// Latitude, longitude and height of a row, where they are asked for.
    fn geodetic(&self, target: &TargetTrail, row: usize) -> Option<[f64; 3]> {
        if !self.has_geodetic {
            return None;
        }
        geodetic(self.meta.origin.as_ref(), self.axes, target.trail.mean(row)?)
    }

    /// One cell.
    pub fn cell<'a>(&self, source: Source, target: &'a TargetTrail, row: usize) -> OutCell<'a> {
        let trail = &target.trail;
        let lagged = || trail.lagged.as_ref();
        match source {
            Source::Target => target.target.as_deref().map_or(OutCell::Absent, OutCell::Text),
            Source::Index => OutCell::Index(trail.k[row]),
            Source::Time if self.is_linear && self.meta.time == TimeForm::Index => OutCell::Float(trail.k[row] as f64),
            Source::Time => time_cell(&self.meta, trail.t_s[row]),
            Source::Geodetic(i) => float(self.geodetic(target, row).map(|g| g[i])),
            Source::Mean(i) => float(trail.mean(row).map(|mean| mean[i])),
            Source::Sd(i) => float(trail.cov(row).map(|cov| sd(cov, self.n, i))),
            Source::Cov(i) => float(trail.cov(row).map(|cov| cov[i])),
            Source::Status => OutCell::Text(trail.status[row].name()),
            Source::Nis => float(trail.nis[row]),
            Source::LagIndex => lagged().and_then(|l| l.k[row]).map_or(OutCell::Absent, OutCell::Index),
            Source::LagTime => time_cell(&self.meta, lagged().and_then(|l| l.t_s[row])),
            Source::LagMean(i) => float(trail.lagged(row).map(|(mean, _)| mean[i])),
            Source::LagSd(i) => float(trail.lagged(row).map(|(_, cov)| sd(cov, self.n, i))),
            Source::LagCov(i) => float(trail.lagged(row).map(|(_, cov)| cov[i])),
            Source::LagStatus => {
                lagged().and_then(|l| l.status[row]).map_or(OutCell::Absent, |s| OutCell::Text(s.name()))
            }
        }
    }
}

fn float<'a>(value: Option<f64>) -> OutCell<'a> {
    value.map_or(OutCell::Absent, OutCell::Float)
}

/// A standard deviation out of a packed covariance; that of a variance that rounding has made negative is 0.
pub(super) fn sd(packed: &[f64], n: usize, i: usize) -> f64 {
    let var = packed[Trail::packed_index(n, i, i)];
    if var < 0.0 { 0.0 } else { var.sqrt() }
}

/// Latitude, longitude and height of a state; in the plane at the height of the origin.
pub(super) fn geodetic(origin: Option<&Origin>, axes: usize, mean: &[f64]) -> Option<[f64; 3]> {
    let origin = origin?;
    match axes {
        2 => {
            let (lat, lon) = geo::wgs84_on_level(origin, mean[0], mean[1]);
            Some([lat, lon, origin.alt_m])
        }
        3 => {
            let (lat, lon, alt) = geo::wgs84_from_enu(origin, [mean[0], mean[1], mean[2]]);
            Some([lat, lon, alt])
        }
        _ => None,
    }
}

fn time_kind(meta: &TableMeta) -> ColumnKind {
    match meta.time {
        TimeForm::Rfc3339 { .. } => ColumnKind::Date,
        TimeForm::Seconds | TimeForm::Index => ColumnKind::Float,
    }
}

fn time_cell<'a>(meta: &TableMeta, t_s: Option<f64>) -> OutCell<'a> {
    match (t_s, meta.time) {
        (None, _) => OutCell::Absent,
        (Some(t_s), TimeForm::Rfc3339 { epoch_unix_s, .. }) => OutCell::Date(time::unix_ns(t_s, epoch_unix_s)),
        (Some(t_s), _) => OutCell::Float(t_s),
    }
}
