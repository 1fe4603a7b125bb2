//! A trail held in memory, one value per column and row: what writers, metrics and reports read.

use crate::fix::{Fix, Sink, Status};

/// The smoother's columns of a trail.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LaggedColumns {
    /// Index of the instant described; `None` before the first.
    pub k: Vec<Option<u64>>,
    /// The instant described.
    pub t_s: Vec<Option<f64>>,
    /// Means, `n` per row; NaN where there is no estimate.
    pub mean: Vec<f64>,
    /// Packed upper triangles, row-major, `n(n+1)/2` per row; NaN where there is no estimate.
    pub cov: Vec<f64>,
    /// Status; `None` where there is no lagged instant.
    pub status: Vec<Option<Status>>,
}

/// All fixes of one target, in order of time.
#[derive(Clone, Debug, PartialEq)]
pub struct Trail {
    n: usize,
    /// Index of each instant.
    pub k: Vec<u64>,
    /// Each instant in seconds.
    pub t_s: Vec<Option<f64>>,
    /// Means, `n` per row; NaN where the row is unobservable (a storage detail: read through [`Trail::mean`]).
    mean: Vec<f64>,
    /// Packed upper triangles, row-major, `n(n+1)/2` per row.
    cov: Vec<f64>,
    /// What happened at each instant.
    pub status: Vec<Status>,
    /// Normalised innovation squared.
    pub nis: Vec<Option<f64>>,
    /// Number of scalar measurements behind each `nis`.
    pub nis_dof: Vec<u32>,
    /// The smoother's columns, when both were asked for.
    pub lagged: Option<LaggedColumns>,
    /// How often the track was lost, given up and started anew.
    pub restarts: u64,
}

impl Trail {
    /// An empty trail of an `n`-state model; `with_lagged` keeps the smoother's half of each fix.
    pub fn new(n: usize, with_lagged: bool) -> Trail {
        Trail {
            n,
            k: Vec::new(),
            t_s: Vec::new(),
            mean: Vec::new(),
            cov: Vec::new(),
            status: Vec::new(),
            nis: Vec::new(),
            nis_dof: Vec::new(),
            lagged: with_lagged.then(LaggedColumns::default),
            restarts: 0,
        }
    }

    /// Number of state components.
    pub fn n(&self) -> usize {
        self.n
    }

    /// Makes room for that many rows more.
    pub fn reserve(&mut self, rows: usize) {
        self.k.reserve(rows);
        self.t_s.reserve(rows);
        self.mean.reserve(rows * self.n);
        self.cov.reserve(rows * Self::packed_len(self.n));
        self.status.reserve(rows);
        self.nis.reserve(rows);
        self.nis_dof.reserve(rows);
    }

    /// Appends rows with an estimate that was updated, and without a smoother's half, numbered on from those before: of row `k` of these `mean` of
    /// `n` values, the first of `cov` the packed upper triangle of the covariance, and the normalised innovation squared of `dof` measurements.
    ///
    /// # Panics
    /// When `N` is not `n`, or more than 9.
    // Column by column, each a loop without a branch.
    pub(crate) fn append_updated<const N: usize>(
        &mut self,
        t_s: &[f64],
        (mean, cov): (impl Fn(usize) -> [f64; N], impl Fn(usize) -> [f64; 45]),
        (nis, dof): (impl Fn(usize) -> f64, u32),
    ) {
        assert_eq!(self.n, N, "values of a mean");
        let (start, rows) = (self.len(), t_s.len());
        self.k.extend((start..start + rows).map(|k| k as u64));
        self.t_s.extend(t_s.iter().copied().map(Some));
        (0..rows).for_each(|k| self.mean.extend_from_slice(&mean(k)));
        (0..rows).for_each(|k| self.cov.extend_from_slice(&cov(k)[..Self::packed_len(N)]));
        self.status.resize(start + rows, Status::Updated);
        self.nis.extend((0..rows).map(|k| Some(nis(k))));
        self.nis_dof.resize(start + rows, dof);
    }

    /// The rows that stand at least `apart_s` seconds after the one before, the first of all included, without the smoother's half.
    pub fn thinned(&self, apart_s: f64) -> Trail {
        let mut out = Trail::new(self.n, false);
        let mut last_s = f64::NEG_INFINITY;
        for row in (0..self.len()).filter(|row| self.mean(*row).is_some()) {
            let Some(t_s) = self.t_s[row] else { continue };
            if t_s < last_s + apart_s {
                continue;
            }
            last_s = t_s;
            let (from, to) = (row * self.n, (row + 1) * self.n);
            let packed = Trail::packed_len(self.n);
            out.k.push(self.k[row]);
            out.t_s.push(Some(t_s));
            out.mean.extend_from_slice(&self.mean[from..to]);
            out.cov.extend_from_slice(&self.cov[row * packed..(row + 1) * packed]);
            out.status.push(self.status[row]);
            out.nis.push(self.nis[row]);
            out.nis_dof.push(self.nis_dof[row]);
        }
        out
    }

    /// The smoother's half as a trail of its own, at the instants it describes; empty without one.
    pub fn smoothed(&self) -> Trail {
        let mut out = Trail::new(self.n, false);
        let Some(lagged) = &self.lagged else { return out };
        for row in 0..self.len() {
            let (Some(k), Some((mean, cov)), Some(status)) = (lagged.k[row], self.lagged(row), lagged.status[row])
            else {
                continue;
            };
            out.k.push(k);
            out.t_s.push(lagged.t_s[row]);
            out.mean.extend_from_slice(mean);
            out.cov.extend_from_slice(cov);
            out.status.push(status);
            out.nis.push(None);
            out.nis_dof.push(0);
        }
        out
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.k.len()
    }

    /// Whether there are no rows.
    pub fn is_empty(&self) -> bool {
        self.k.is_empty()
    }

    /// Length of a packed covariance.
    pub fn packed_len(n: usize) -> usize {
        n * (n + 1) / 2
    }

    /// Index of entry (i, j), `i ≤ j`, in a packed upper triangle of an `n × n` matrix.
    pub fn packed_index(n: usize, i: usize, j: usize) -> usize {
        i * (2 * n - i + 1) / 2 + (j - i)
    }

    /// The mean at `row`, or `None` where the state is unobservable.
    pub fn mean(&self, row: usize) -> Option<&[f64]> {
        (self.status[row] != Status::Unobservable).then(|| &self.mean[row * self.n..(row + 1) * self.n])
    }

    /// The packed covariance (upper triangle, row-major) at `row`, or `None` where the state is unobservable.
    pub fn cov(&self, row: usize) -> Option<&[f64]> {
        let m = Self::packed_len(self.n);
        (self.status[row] != Status::Unobservable).then(|| &self.cov[row * m..(row + 1) * m])
    }

    /// The means of some rows, `n` values each, and their packed covariances; `None` when one of the rows is unobservable.
    ///
    /// # Panics
    /// When there are not as many rows.
    pub fn estimates(&self, rows: std::ops::Range<usize>) -> Option<(&[f64], &[f64])> {
        let m = Self::packed_len(self.n);
        let known = self.status[rows.clone()].iter().all(|status| *status != Status::Unobservable);
        known.then(|| (&self.mean[rows.start * self.n..rows.end * self.n], &self.cov[rows.start * m..rows.end * m]))
    }

    /// Entry (i, j) of the covariance at `row`.
    pub fn cov_at(&self, row: usize, i: usize, j: usize) -> Option<f64> {
        self.cov(row).map(|c| c[Self::packed_index(self.n, i.min(j), i.max(j))])
    }

    /// The lagged mean and packed covariance on `row`, where there is one.
    pub fn lagged(&self, row: usize) -> Option<(&[f64], &[f64])> {
        let l = self.lagged.as_ref()?;
        match l.status[row] {
            None | Some(Status::Unobservable) => None,
            Some(_) => {
                let m = Self::packed_len(self.n);
                Some((&l.mean[row * self.n..(row + 1) * self.n], &l.cov[row * m..(row + 1) * m]))
            }
        }
    }
}

fn push_estimate(n: usize, mean: &mut Vec<f64>, cov: &mut Vec<f64>, estimate: Option<&crate::fix::Estimate<'_>>) {
    match estimate {
        Some(e) => {
            mean.extend_from_slice(e.mean);
            for i in 0..n {
                cov.extend_from_slice(&e.cov[i * n + i..(i + 1) * n]);
            }
        }
        None => {
            mean.extend(core::iter::repeat_n(f64::NAN, n));
            cov.extend(core::iter::repeat_n(f64::NAN, Trail::packed_len(n)));
        }
    }
}

impl Sink for Trail {
    fn fix(&mut self, fix: &Fix<'_>) {
        self.k.push(fix.k);
        self.t_s.push(fix.t_s);
        push_estimate(self.n, &mut self.mean, &mut self.cov, fix.estimate.as_ref());
        self.status.push(fix.status);
        self.nis.push(fix.nis);
        self.nis_dof.push(fix.nis_dof);
        if let Some(l) = &mut self.lagged {
            l.k.push(fix.lagged.map(|g| g.k));
            l.t_s.push(fix.lagged.and_then(|g| g.t_s));
            l.status.push(fix.lagged.map(|g| g.status));
            push_estimate(self.n, &mut l.mean, &mut l.cov, fix.lagged.as_ref().and_then(|g| g.estimate.as_ref()));
        }
    }
}
