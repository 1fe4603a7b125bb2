//! The columns of a trail table, and the cells of a row.

use super::{Job, WriteError};
use crate::table::TableMeta;
use crate::time::{self, TimeForm};
use fixtrail_track::fix::Status;
use fixtrail_track::geo;
use fixtrail_track::layout::Layout;
use fixtrail_track::target::TargetTrail;
use fixtrail_track::trail::Trail;

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

/// The columns of a trail table in order.
pub(super) struct Columns {
    pub names: Vec<String>,
    pub kinds: Vec<ColumnKind>,
    has_lagged: bool,
    has_covariance: bool,
}

impl Columns {
    pub fn new(layout: &Layout, meta: &TableMeta, has_lagged: bool, has_covariance: bool) -> Columns {
        let mut columns = Columns { names: Vec::new(), kinds: Vec::new(), has_lagged, has_covariance };
        match layout.is_linear() {
            true => columns.name_linear(layout, meta),
            false => columns.name_kinematic(layout, meta),
        }
        columns
    }

    fn add(&mut self, name: impl Into<String>, kind: ColumnKind) {
        self.names.push(name.into());
        self.kinds.push(kind);
    }

    fn add_packed(&mut self, prefix: &str, n: usize) {
        for i in 1..=n {
            for j in i..=n {
                self.add(format!("{prefix}_{i}_{j}"), ColumnKind::Float);
            }
        }
    }

    fn name_kinematic(&mut self, layout: &Layout, meta: &TableMeta) {
        let time = time_kind(meta);
        self.add("target", ColumnKind::Text);
        self.add("t", time);
        if meta.origin.is_some() && layout.axes >= 2 {
            let geodetic = ["lat", "lon", "alt"];
            geodetic.iter().take(layout.axes).for_each(|name| self.add(*name, ColumnKind::Float));
        }
        layout.names.iter().for_each(|name| self.add(name.as_str(), ColumnKind::Float));
        layout.names.iter().for_each(|name| self.add(format!("sd_{name}"), ColumnKind::Float));
        self.add("status", ColumnKind::Text);
        self.add("nis", ColumnKind::Float);
        if self.has_covariance {
            self.add_packed("p", layout.n());
        }
        if self.has_lagged {
            self.add("t_lag", time);
            layout.names.iter().for_each(|name| self.add(format!("{name}_lag"), ColumnKind::Float));
            layout.names.iter().for_each(|name| self.add(format!("sd_{name}_lag"), ColumnKind::Float));
            self.add("lag_status", ColumnKind::Text);
            if self.has_covariance {
                self.add_packed("ps", layout.n());
            }
        }
    }

    fn name_linear(&mut self, layout: &Layout, meta: &TableMeta) {
        if meta.has_target {
            self.add("target", ColumnKind::Text);
        }
        self.add("k", ColumnKind::Index);
        self.add("t", time_kind(meta));
        layout.names.iter().for_each(|name| self.add(name.as_str(), ColumnKind::Float));
        self.add("status", ColumnKind::Text);
        self.add("nis", ColumnKind::Float);
        if self.has_covariance {
            self.add_packed("p", layout.n());
        }
        if self.has_lagged {
            self.add("lag_k", ColumnKind::Index);
            (1..=layout.n()).for_each(|i| self.add(format!("s{i}"), ColumnKind::Float));
            if self.has_covariance {
                self.add_packed("ps", layout.n());
            }
            self.add("lag_status", ColumnKind::Text);
        }
    }

    /// Puts the cells of a row into `cells`, in the order of the columns.
    pub fn fill<'a>(
        &self,
        job: &Job<'_>,
        target: &'a TargetTrail,
        row: usize,
        cells: &mut Vec<OutCell<'a>>,
    ) -> Result<(), WriteError> {
        cells.clear();
        match job.layout.is_linear() {
            true => self.fill_linear(job, target, row, cells),
            false => self.fill_kinematic(job, target, row, cells),
        }
        debug_assert_eq!(cells.len(), self.names.len());
        match cells.iter().position(|c| matches!(c, OutCell::Float(x) if !x.is_finite())) {
            None => Ok(()),
            Some(i) => Err(WriteError::NotFinite {
                file: job.file.to_owned(),
                target: target.target.clone(),
                t: target.trail.t_s[row].map_or("-".to_owned(), |t_s| job.meta.time.text(t_s)),
                column: self.names[i].clone(),
            }),
        }
    }

    fn fill_kinematic<'a>(&self, job: &Job<'_>, target: &'a TargetTrail, row: usize, cells: &mut Vec<OutCell<'a>>) {
        let (trail, n) = (&target.trail, job.layout.n());
        let (mean, cov) = (trail.mean(row), trail.cov(row));
        cells.push(target.target.as_deref().map_or(OutCell::Absent, OutCell::Text));
        cells.push(time_cell(&job.meta, trail.t_s[row]));
        if job.meta.origin.is_some() && job.layout.axes >= 2 {
            let geodetic = mean.and_then(|mean| geodetic(job, mean));
            cells.extend((0..job.layout.axes).map(|i| geodetic.map_or(OutCell::Absent, |g| OutCell::Float(g[i]))));
        }
        push_floats(cells, mean, n);
        push_sds(cells, cov, n);
        cells.push(OutCell::Text(trail.status[row].name()));
        cells.push(trail.nis[row].map_or(OutCell::Absent, OutCell::Float));
        if self.has_covariance {
            push_floats(cells, cov, Trail::packed_len(n));
        }
        if self.has_lagged {
            let lagged = trail.lagged(row);
            let columns = trail.lagged.as_ref();
            cells.push(time_cell(&job.meta, columns.and_then(|l| l.t_s[row])));
            push_floats(cells, lagged.map(|l| l.0), n);
            push_sds(cells, lagged.map(|l| l.1), n);
            cells.push(status_cell(columns.and_then(|l| l.status[row])));
            if self.has_covariance {
                push_floats(cells, lagged.map(|l| l.1), Trail::packed_len(n));
            }
        }
    }

    fn fill_linear<'a>(&self, job: &Job<'_>, target: &'a TargetTrail, row: usize, cells: &mut Vec<OutCell<'a>>) {
        let (trail, n) = (&target.trail, job.layout.n());
        if job.meta.has_target {
            cells.push(target.target.as_deref().map_or(OutCell::Absent, OutCell::Text));
        }
        cells.push(OutCell::Index(trail.k[row]));
        cells.push(match job.meta.time {
            TimeForm::Index => OutCell::Float(trail.k[row] as f64),
            _ => time_cell(&job.meta, trail.t_s[row]),
        });
        push_floats(cells, trail.mean(row), n);
        cells.push(OutCell::Text(trail.status[row].name()));
        cells.push(trail.nis[row].map_or(OutCell::Absent, OutCell::Float));
        if self.has_covariance {
            push_floats(cells, trail.cov(row), Trail::packed_len(n));
        }
        if self.has_lagged {
            let lagged = trail.lagged(row);
            let columns = trail.lagged.as_ref();
            cells.push(columns.and_then(|l| l.k[row]).map_or(OutCell::Absent, OutCell::Index));
            push_floats(cells, lagged.map(|l| l.0), n);
            if self.has_covariance {
                push_floats(cells, lagged.map(|l| l.1), Trail::packed_len(n));
            }
            cells.push(status_cell(columns.and_then(|l| l.status[row])));
        }
    }
}

/// Latitude, longitude and height of a state; in the plane at the height of the origin.
pub(super) fn geodetic(job: &Job<'_>, mean: &[f64]) -> Option<[f64; 3]> {
    let origin = job.meta.origin.as_ref()?;
    match job.layout.axes {
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

fn status_cell<'a>(status: Option<Status>) -> OutCell<'a> {
    status.map_or(OutCell::Absent, |s| OutCell::Text(s.name()))
}

fn push_floats(cells: &mut Vec<OutCell<'_>>, values: Option<&[f64]>, len: usize) {
    match values {
        Some(values) => cells.extend(values.iter().map(|x| OutCell::Float(*x))),
        None => cells.extend((0..len).map(|_| OutCell::Absent)),
    }
}

/// Standard deviations; a variance that rounding has made negative is 0.
fn push_sds(cells: &mut Vec<OutCell<'_>>, packed: Option<&[f64]>, n: usize) {
    for i in 0..n {
        cells.push(match packed {
            Some(p) => {
                let var = p[Trail::packed_index(n, i, i)];
                OutCell::Float(if var < 0.0 { 0.0 } else { var.sqrt() })
            }
            None => OutCell::Absent,
        });
    }
}
