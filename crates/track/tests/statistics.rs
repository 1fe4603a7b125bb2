//! Consistency: over many seeded runs the errors are as large as the covariances say, no larger and no smaller.
//!
//! The mean over R independent runs of a χ² of n degrees of freedom has mean n and standard deviation √(2n/R). Four of them on either
//! side are exceeded once in 16 000 times; a covariance wrong by 10 % would shift n by 0.1 n, which is 5.5 of them at n = 3, R = 2000.

mod support;

use fixtrail_track::anchors::Anchors;
use fixtrail_track::packet::{Content, Kind, Packet};
use fixtrail_track::pipeline::track;
use fixtrail_track::spec::{Align, EstimatorSpec, KinematicSpec, ModelSpec, Prior, Robust, SensorSpec, Span, Spec};
use fixtrail_track::target::TargetPackets;
use fixtrail_track::trackers::LaggedMode;
use fixtrail_track::trail::Trail;
use nalgebra::{DMatrix, DVector};
use std::collections::BTreeMap;
use support::oracle::random::Random;
use support::oracle::{Instant, Run};
use support::{Declared, fms, mat, packets, spec_of, tracked};

fn squared_error(mean: &[f64], cov: impl Fn(usize, usize) -> f64, truth: &DVector<f64>) -> f64 {
    let n = mean.len();
    let error = DVector::from_column_slice(mean) - truth;
    let cov = DMatrix::from_fn(n, n, cov);
    error.dot(&cov.cholesky().expect("definite").solve(&error))
}

/// A sum of χ² values with its expectation.
#[derive(Default, Debug)]
struct Chi {
    sum: f64,
    dof: f64,
    runs: usize,
}

impl Chi {
    fn add(&mut self, value: f64, dof: usize) {
        self.sum += value;
        self.dof += dof as f64;
        self.runs += 1;
    }

    /// How many standard deviations the sum is off; `excess` is a share of the expectation that is put up with.
    fn check(&self, name: &str, excess: f64) {
        let off = self.sum - self.dof;
        let sd = (2.0 * self.dof).sqrt();
        println!(
            "{name}: mean {:.4} of {:.4}, {:+.2} sd",
            self.sum / self.runs as f64,
            self.dof / self.runs as f64,
            off / sd
        );
        assert!(off.abs() < 4.0 * sd + excess * self.dof, "{name}: {:+.2} sd off, {self:?}", off / sd);
    }
}

/// A correlated pair of measurements, a singular process noise, a tenth of the components lost.
fn draw(rng: &mut Random, len: usize) -> (Run, Vec<DVector<f64>>) {
    let root = DMatrix::from_row_slice(3, 3, &[2.0, 0.0, 0.0, 0.3, 1.0, 0.0, 0.1, -0.2, 0.5]);
    let mean = DVector::from_column_slice(&[5.0, -1.0, 0.3]);
    let mut x = &mean + &root * rng.matrix(3, 1).column(0);
    let g = DMatrix::from_row_slice(3, 2, &[0.5, 0.0, 1.0, 0.0, 0.0, 1.0]);
    let q = DMatrix::from_row_slice(2, 2, &[0.09, 0.0, 0.0, 0.01]);
    let r = DMatrix::from_row_slice(2, 2, &[0.25, 0.1, 0.1, 0.49]);
    let (l, w) = (r.clone().cholesky().unwrap().l(), q.map(f64::sqrt));
    let mut states = Vec::new();
    let mut instants = Vec::new();
    for _ in 0..len {
        let mut at = Instant {
            a: DMatrix::from_row_slice(3, 3, &[1.0, 1.0, 0.5, 0.0, 1.0, 1.0, 0.0, 0.0, 0.95]),
            b: DMatrix::from_row_slice(3, 1, &[0.2, 0.4, 0.0]),
            g: g.clone(),
            q: q.clone(),
            c: DMatrix::from_row_slice(2, 3, &[1.0, 0.0, 0.0, 0.0, 1.0, 0.5]),
            r: r.clone(),
            z: Vec::new(),
            u: vec![rng.normal()],
        };
        let z = &at.c * &x + &l * rng.matrix(2, 1).column(0);
        at.z = (0..2).map(|i| (!rng.chance(0.1)).then_some(z[i])).collect();
        states.push(x.clone());
        x = &at.a * x + &at.b * at.u[0] + &g * (&w * rng.matrix(2, 1).column(0));
        instants.push(at);
    }
    (Run { instants, prior: Some((mean, &root * root.transpose())) }, states)
}

fn nees(trail: &Trail, row: usize, truth: &DVector<f64>) -> f64 {
    let cov = |i, j| trail.cov_at(row, i, j).expect("there is an estimate");
    squared_error(trail.mean(row).expect("there is an estimate"), cov, truth)
}

#[test]
fn linear_estimators_are_consistent() {
    let mut rng = Random::new(1);
    let (len, at) = (24, 18);
    let window = fms(12, 4, Align::Filtered);
    let estimators: [(&str, EstimatorSpec); 6] = [
        ("kalman", EstimatorSpec::Kalman),
        ("rts", EstimatorSpec::Rts),
        ("fixed-lag-kalman", EstimatorSpec::FixedLagKalman { lag: Span::Instants(3) }),
        ("fms", window),
        ("fms predicted", fms(12, 4, Align::Predicted)),
        ("ufir", EstimatorSpec::Ufir { window: Span::Instants(8) }),
    ];
    let mut errors: [Chi; 6] = Default::default();
    let mut innovations: [Chi; 6] = Default::default();
    let mut lagged = Chi::default();
    for i in 0..2000 {
        let declared = if i % 2 == 0 { Declared::Invariant } else { Declared::Sequence };
        let (run, states) = draw(&mut rng, len);
        for (i, (_, estimator)) in estimators.iter().enumerate() {
            let trail = tracked(&run, declared, *estimator, LaggedMode::Own);
            errors[i].add(nees(&trail, at, &states[at]), 3);
            if let Some(nis) = trail.nis[at] {
                innovations[i].add(nis, trail.nis_dof[at] as usize);
            }
        }
        let both = tracked(&run, declared, window, LaggedMode::Both);
        let (mean, cov) = both.lagged(at).expect("there is an estimate");
        let entry = |i: usize, j: usize| cov[Trail::packed_index(3, i.min(j), i.max(j))];
        lagged.add(squared_error(mean, entry, &states[at - 4]), 3);
    }
    for (i, (name, _)) in estimators.iter().enumerate() {
        errors[i].check(&format!("{name} nees"), 0.0);
    }
    lagged.check("fms smoother nees", 0.0);
    for (i, (name, _)) in estimators.iter().enumerate() {
        // UFIR's covariance is its own error's, but its residual is not what the rest of the window predicts.
        if *name != "ufir" {
            innovations[i].check(&format!("{name} nis"), 0.0);
            assert!(innovations[i].runs > 1500, "{name}");
        }
    }
}

#[test]
fn extended_filters_are_consistent_where_ranges_bend_little() {
    let sites = [[-30.0, -30.0, 0.0], [30.0, -30.0, 0.0], [-30.0, 30.0, 0.0], [30.0, 30.0, 0.0]];
    let mut anchors = Anchors::default();
    for (i, site) in sites.iter().enumerate() {
        anchors.add(&format!("a{i}"), *site).unwrap();
    }
    let sd = 0.2;
    let psd = 0.05;
    let dt = 0.5;
    let root = DMatrix::from_diagonal(&DVector::from_column_slice(&[1.0, 1.0, 0.5, 0.5]));
    let prior = Prior { mean: vec![0.0, 0.0, 1.0, 0.5], cov: mat(&(&root * &root)), second_moment: None };
    let motion = fixtrail_core::models::Integrators::<4>::new(2, 2, [psd, psd, 0.0]).unwrap();
    let leap = motion.leap(&fixtrail_core::Vector::zeros(), dt);
    let f = DMatrix::from_fn(4, 4, |i, j| leap.f[(i, j)]);
    let w = DMatrix::from_fn(4, 4, |i, j| leap.q[(i, j)]).cholesky().unwrap().l();
    let model = KinematicSpec { order: 2, axes: 2, noise: vec![psd, psd], prior: Some(prior.clone()) };
    let sensor = SensorSpec {
        kind: Kind::Range,
        sd,
        path_loss: None,
        drift: None,
        bias: BTreeMap::new(),
        height_m: None,
        latency_s: 0.0,
        robust: Robust::None,
    };
    let mut rng = Random::new(2);
    let estimators = [("ekf", EstimatorSpec::Ekf), ("rts", EstimatorSpec::Rts), ("fms", fms(8, 2, Align::Filtered))];
    let mut errors: [Chi; 3] = Default::default();
    let mut innovations: [Chi; 3] = Default::default();
    let (len, at) = (14, 10);
    for _ in 0..1000 {
        let mut x = DVector::from_column_slice(&prior.mean) + &root * rng.matrix(4, 1).column(0);
        let (mut states, mut table) = (Vec::new(), Vec::new());
        for k in 0..len {
            for (i, site) in sites.iter().enumerate() {
                if !rng.chance(0.3) {
                    let value_m = f64::hypot(x[0] - site[0], x[1] - site[1]) + sd * rng.normal();
                    let content = Content::Range { anchor: i as u32, value_m };
                    let t_s = dt * k as f64;
                    table.push(Packet::new(t_s, content, 1));
                }
            }
            states.push(x.clone());
            x = &f * x + &w * rng.matrix(4, 1).column(0);
        }
        let table = TargetPackets { target: None, packets: table };
        for (i, (_, estimator)) in estimators.iter().enumerate() {
            let spec =
                Spec { sensors: vec![sensor.clone()], ..spec_of(ModelSpec::Kinematic(model.clone()), *estimator) };
            let trail = track(&spec, &anchors, &table, LaggedMode::Own).unwrap().trail;
            // An instant without a packet has no row.
            let Some(row) = (0..trail.len()).find(|r| trail.t_s[*r] == Some(dt * at as f64)) else { continue };
            if trail.mean(row).is_none() {
                continue;
            }
            errors[i].add(nees(&trail, row, &states[at]), 4);
            if let Some(nis) = trail.nis[row] {
                innovations[i].add(nis, trail.nis_dof[row] as usize);
            }
        }
    }
    for (i, (name, _)) in estimators.iter().enumerate() {
        // Ranges of 40 m bend by less than a thousandth of their noise over the position's: two per cent is ample.
        errors[i].check(&format!("{name} nees"), 0.02);
        innovations[i].check(&format!("{name} nis"), 0.02);
        assert!(errors[i].runs > 950 && innovations[i].runs > 950);
    }
}

#[test]
fn a_wrong_covariance_is_found_out() {
    // The bound has teeth: the same runs under a process noise 30 % too small in standard deviation.
    let mut rng = Random::new(3);
    let mut chi = Chi::default();
    for _ in 0..2000 {
        let (mut run, states) = draw(&mut rng, 24);
        run.instants.iter_mut().for_each(|at| at.q *= 0.5);
        let spec = spec_of(ModelSpec::Linear(support::linear(&run, Declared::Invariant)), EstimatorSpec::Kalman);
        let trail = track(&spec, &Anchors::default(), &packets(&run), LaggedMode::Own).unwrap().trail;
        chi.add(nees(&trail, 18, &states[18]), 3);
    }
    assert!(chi.sum - chi.dof > 8.0 * (2.0 * chi.dof).sqrt(), "{chi:?}");
}
