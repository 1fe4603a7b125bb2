//! What the tests of trackers share: runs of the oracle as specs and packets, and trails beside the oracle's verdicts.

#![allow(dead_code)]

#[path = "../../../core/tests/oracle/mod.rs"]
pub mod oracle;

use fixtrail_track::anchors::Anchors;
use fixtrail_track::fix::Status;
use fixtrail_track::mat::Mat;
use fixtrail_track::packet::{Content, Packet};
use fixtrail_track::pipeline::track;
use fixtrail_track::spec::{EstimatorSpec, LinearSpec, LinearStep, LinkSpec, ModelSpec, Prior, Span, Spec};
use fixtrail_track::target::TargetPackets;
use fixtrail_track::trackers::LaggedMode;
use fixtrail_track::trail::Trail;
use nalgebra::DMatrix;
use oracle::{Posterior, Run, Verdict, deviation};
use std::collections::BTreeMap;

pub fn mat(m: &DMatrix<f64>) -> Mat {
    let data = (0..m.nrows()).flat_map(|i| (0..m.ncols()).map(move |j| m[(i, j)])).collect();
    Mat { rows: m.nrows(), cols: m.ncols(), data }
}

/// A spec with no sensor tables.
pub fn spec_of(model: ModelSpec, estimator: EstimatorSpec) -> Spec {
    Spec {
        model,
        estimator,
        link: LinkSpec::default(),
        sensors: Vec::new(),
        columns: BTreeMap::new(),
        anchors: None,
        side_m: None,
    }
}

/// Whether a time-invariant run is declared as one, or as a sequence of equal steps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Declared {
    Invariant,
    Sequence,
}

pub fn linear(run: &Run, declared: Declared) -> LinearSpec {
    let steps: Vec<LinearStep> = run
        .instants
        .iter()
        .map(|i| LinearStep { a: mat(&i.a), b: mat(&i.b), g: mat(&i.g), c: mat(&i.c), q: mat(&i.q), r: mat(&i.r) })
        .collect();
    let prior = run.prior.as_ref().map(|(mean, cov)| Prior {
        mean: mean.as_slice().to_vec(),
        cov: mat(cov),
        second_moment: None,
    });
    let sequence = if declared == Declared::Sequence { steps.clone() } else { Vec::new() };
    LinearSpec { base: steps[0].clone(), sequence, prior }
}

pub fn packet(k: usize, z: &[Option<f64>], u: &[f64]) -> Packet {
    Packet {
        k: Some(k as u64),
        ..Packet::new(k as f64, Content::Linear { z: z.to_vec(), u: u.to_vec() }, k as u64 + 1)
    }
}

/// The run's packets. Of the instants without data and input, every other has no packet at all; the last one always has.
pub fn packets(run: &Run) -> TargetPackets {
    let silent = |k: usize| {
        let at = &run.instants[k];
        k + 1 < run.len() && k.is_multiple_of(2) && at.z.iter().all(Option::is_none) && at.u.iter().all(|u| *u == 0.0)
    };
    let packets =
        (0..run.len()).filter(|k| !silent(*k)).map(|k| packet(k, &run.instants[k].z, &run.instants[k].u)).collect();
    TargetPackets { target: None, packets }
}

pub fn tracked(run: &Run, declared: Declared, estimator: EstimatorSpec, mode: LaggedMode) -> Trail {
    let spec = spec_of(ModelSpec::Linear(linear(run, declared)), estimator);
    track(&spec, &Anchors::default(), &packets(run), mode).expect("every step can be taken").trail
}

pub fn fms(window: usize, lag: usize, align: fixtrail_track::spec::Align) -> EstimatorSpec {
    EstimatorSpec::Fms { window: Span::Instants(window), lag: Span::Instants(lag), align }
}

/// Mean and packed covariance against the oracle's estimate.
pub fn packed_deviation(mean: &[f64], cov: &[f64], truth: &Posterior) -> f64 {
    let n = mean.len();
    deviation(mean, |i, j| cov[Trail::packed_index(n, i.min(j), i.max(j))], truth)
}

/// Collects how far trails are from the oracle.
#[derive(Debug, Default)]
pub struct Tally {
    pub worst: f64,
    pub estimates: usize,
    pub absent: usize,
    pub borderline: usize,
}

impl Tally {
    /// Compares one estimate, or its absence, with the oracle's verdict.
    pub fn add(&mut self, ours: Option<(&[f64], &[f64])>, verdict: &Verdict, what: &str, limit: f64) {
        match (ours, verdict) {
            (_, Verdict::Borderline) => self.borderline += 1,
            (None, Verdict::Undetermined) => self.absent += 1,
            (Some((mean, cov)), Verdict::Determined(truth)) => {
                let off = packed_deviation(mean, cov, truth);
                assert!(off <= limit, "{what}: off by {off:e}\nours {mean:?} {cov:?}\nexpected {truth:?}");
                self.worst = self.worst.max(off);
                self.estimates += 1;
            }
            (Some(_), Verdict::Undetermined) => panic!("{what}: an estimate where the data determine none"),
            (None, Verdict::Determined(truth)) => panic!("{what}: no estimate where the data determine {truth:?}"),
        }
    }

    /// Compares row `row` of a trail.
    pub fn row(&mut self, trail: &Trail, row: usize, verdict: &Verdict, what: &str, limit: f64) {
        self.add(trail.mean(row).zip(trail.cov(row)), verdict, what, limit);
        assert_eq!(trail.mean(row).is_none(), trail.status[row] == Status::Unobservable);
    }
}

/// Everything that a trail says, number by number.
pub fn bits(trail: &Trail) -> Vec<Vec<u64>> {
    let float = |v: Option<f64>| v.map_or(u64::MAX, f64::to_bits);
    let estimate = |pair: Option<(&[f64], &[f64])>| -> Vec<u64> {
        pair.map_or(Vec::new(), |(mean, cov)| mean.iter().chain(cov).map(|v| v.to_bits()).collect())
    };
    let row = |row: usize| {
        let mut out = vec![trail.k[row], float(trail.t_s[row]), trail.status[row] as u64];
        out.extend([float(trail.nis[row]), u64::from(trail.nis_dof[row])]);
        out.extend(estimate(trail.mean(row).zip(trail.cov(row))));
        if let Some(lagged) = &trail.lagged {
            out.extend([lagged.k[row].unwrap_or(u64::MAX), float(lagged.t_s[row])]);
            out.push(lagged.status[row].map_or(u64::MAX, |s| s as u64));
            out.extend(estimate(trail.lagged(row)));
        }
        out
    };
    (0..trail.len()).map(row).collect()
}
