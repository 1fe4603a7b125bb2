//! Targets that live somewhere, and sensors whose errors last.

mod support;

use fixtrail_track::anchors::Anchors;
use fixtrail_track::packet::{Content, Kind, Packet};
use fixtrail_track::pipeline::track;
use fixtrail_track::registry::{self, BuildOptions};
use fixtrail_track::spec::{
    DriftSpec, EstimatorSpec, GaussMarkovSpec, KinematicSpec, Lasting, ModelSpec, Robust, SensorSpec, Span, Spec,
    TurnSpec,
};
use fixtrail_track::target::TargetPackets;
use fixtrail_track::trackers::LaggedMode;
use fixtrail_track::trail::Trail;
use nalgebra::{DMatrix, DVector};
use std::collections::BTreeMap;
use support::oracle::random::Random;
use support::spec_of;

const SITES: [[f64; 2]; 4] = [[0.0, 0.0], [20.0, 0.0], [0.0, 20.0], [20.0, 20.0]];
const SD: f64 = 0.1;
const LASTING: Lasting = Lasting { sd: 0.4, time_s: 20.0 };
const DRIFT: DriftSpec = DriftSpec { each: Some(LASTING), shared: None };
const SHARED: DriftSpec = DriftSpec { each: None, shared: Some(LASTING) };
const BOTH: DriftSpec = DriftSpec { each: Some(LASTING), shared: Some(Lasting { sd: 0.3, time_s: 5.0 }) };

fn anchors() -> Anchors {
    let mut anchors = Anchors::default();
    for (i, site) in SITES.iter().enumerate() {
        anchors.add(&format!("a{i}"), [site[0], site[1], 0.0]).unwrap();
    }
    anchors
}

fn sensor(kind: Kind, sd: f64, drift: Option<DriftSpec>) -> SensorSpec {
    SensorSpec {
        kind,
        sd,
        path_loss: None,
        bias: BTreeMap::new(),
        drift,
        height_m: None,
        latency_s: 0.0,
        robust: Robust::None,
    }
}

fn hall() -> GaussMarkovSpec {
    GaussMarkovSpec {
        axes: 2,
        centre_m: vec![10.0, 9.0],
        spread_m: vec![4.0, 3.0],
        speed_mps: vec![0.8, 0.6],
        prior: None,
    }
}

fn packet(t_s: f64, content: Content) -> Packet {
    Packet::new(t_s, content, 1)
}

fn trail_of(spec: &Spec, packets: Vec<Packet>, mode: LaggedMode) -> Trail {
    track(spec, &anchors(), &TargetPackets { target: None, packets }, mode).unwrap().trail
}

#[test]
fn stationary_tracks_equal_gaussian_process_regression() {
    // The posterior of the newest position under the Matérn covariance, by a dense inverse that knows of no state.
    let mut rng = Random::new(31);
    let spec = Spec {
        sensors: vec![sensor(Kind::Position, 0.5, None)],
        ..spec_of(ModelSpec::GaussMarkov(hall()), EstimatorSpec::Kalman)
    };
    let mut times = vec![0.0];
    for _ in 0..11 {
        times.push(times[times.len() - 1] + 0.1 + 4.0 * rng.uniform());
    }
    let z: Vec<[f64; 2]> = times.iter().map(|_| [10.0 + 4.0 * rng.normal(), 9.0 + 3.0 * rng.normal()]).collect();
    let packets = times.iter().zip(&z).map(|(t, z)| packet(*t, Content::Position([Some(z[0]), Some(z[1]), None])));
    let trail = trail_of(&spec, packets.collect(), LaggedMode::Own);
    for axis in 0..2 {
        let (centre, spread, speed) = (hall().centre_m[axis], hall().spread_m[axis], hall().speed_mps[axis]);
        let matern = |tau: f64| {
            let a = speed / spread * tau.abs();
            spread * spread * (1.0 + a) * (-a).exp()
        };
        for newest in 0..times.len() {
            let k = DMatrix::from_fn(newest + 1, newest + 1, |i, j| {
                matern(times[i] - times[j]) + if i == j { 0.25 } else { 0.0 }
            });
            let cross = DVector::from_fn(newest + 1, |i, _| matern(times[newest] - times[i]));
            let off = DVector::from_fn(newest + 1, |i, _| z[i][axis] - centre);
            let gain = k.try_inverse().unwrap() * &cross;
            // Ill-conditioned by at most 16 / 0.25 · 12: 13 digits are left.
            assert!((trail.mean(newest).unwrap()[axis] - (centre + gain.dot(&off))).abs() < 1e-11);
            assert!((trail.cov_at(newest, axis, axis).unwrap() - (matern(0.0) - gain.dot(&cross))).abs() < 1e-11);
        }
    }
}

/// Errors of each anchor, or of all, that last, a target of the hall's law, and its ranges twice a second.
fn walk(rng: &mut Random, len: usize, shared: bool) -> (Vec<Packet>, Vec<[f64; 2]>) {
    let (hall, dt) = (hall(), 0.5);
    let motion = |axis: usize| {
        let lambda = hall.speed_mps[axis] / hall.spread_m[axis];
        let (a, e) = (lambda * dt, (-lambda * dt).exp());
        let f = [[e * (1.0 + a), e * dt], [-e * lambda * a, e * (1.0 - a)]];
        let p = [hall.spread_m[axis].powi(2), hall.speed_mps[axis].powi(2)];
        let entry = |i: usize, j: usize| {
            f64::from(u8::from(i == j)) * p[i] - f[i][0] * p[0] * f[j][0] - f[i][1] * p[1] * f[j][1]
        };
        let root = DMatrix::from_fn(2, 2, entry).cholesky().expect("definite").l();
        (f, root)
    };
    let motions = [motion(0), motion(1)];
    let mut state = [0, 1].map(|axis| [hall.spread_m[axis] * rng.normal(), hall.speed_mps[axis] * rng.normal()]);
    let mut errors = SITES.map(|_| LASTING.sd * rng.normal());
    let kept = (-dt / LASTING.time_s).exp();
    let (mut packets, mut truth) = (Vec::new(), Vec::new());
    for k in 0..len {
        let at = [hall.centre_m[0] + state[0][0], hall.centre_m[1] + state[1][0]];
        truth.push(at);
        for (anchor, site) in SITES.iter().enumerate() {
            let value_m =
                (at[0] - site[0]).hypot(at[1] - site[1]) + errors[if shared { 0 } else { anchor }] + SD * rng.normal();
            packets.push(packet(k as f64 * dt, Content::Range { anchor: anchor as u32, value_m }));
        }
        for (axis, (f, root)) in motions.iter().enumerate() {
            let w = root * DVector::from_fn(2, |_, _| rng.normal());
            let [p, v] = state[axis];
            state[axis] = [f[0][0] * p + f[0][1] * v + w[0], f[1][0] * p + f[1][1] * v + w[1]];
        }
        errors = errors.map(|e| kept * e + LASTING.sd * (1.0 - kept * kept).sqrt() * rng.normal());
    }
    (packets, truth)
}

fn spec(drift: Option<DriftSpec>, estimator: EstimatorSpec) -> Spec {
    let sd = if drift.is_some() { SD } else { SD.hypot(LASTING.sd) };
    Spec { sensors: vec![sensor(Kind::Range, sd, drift)], ..spec_of(ModelSpec::GaussMarkov(hall()), estimator) }
}

/// Mean squared error and mean NEES of the last position over many walks.
fn judged(drift: Option<DriftSpec>, estimator: EstimatorSpec, at: usize) -> (f64, f64) {
    judged_on(false, drift, estimator, at)
}

/// As [`judged`], on walks whose errors are shared or not.
fn judged_on(shared: bool, drift: Option<DriftSpec>, estimator: EstimatorSpec, at: usize) -> (f64, f64) {
    let mut rng = Random::new(32);
    let (mut squares, mut nees, runs) = (0.0, 0.0, 300);
    for _ in 0..runs {
        let (packets, truth) = walk(&mut rng, 60, shared);
        let trail = trail_of(&spec(drift, estimator), packets, LaggedMode::Own);
        let mean = trail.mean(at).expect("it has started");
        let e = DVector::from_fn(2, |i, _| mean[i] - truth[at][i]);
        let p = DMatrix::from_fn(2, 2, |i, j| trail.cov_at(at, i, j).unwrap());
        squares += e.norm_squared();
        nees += e.dot(&(p.try_inverse().unwrap() * &e));
    }
    (squares / f64::from(runs), nees / f64::from(runs))
}

#[test]
fn errors_that_last_are_told_from_noise() {
    let (with, nees) = judged(Some(DRIFT), EstimatorSpec::Ekf, 59);
    let (without, overconfident) = judged(None, EstimatorSpec::Ekf, 59);
    println!("{with} {nees} {without} {overconfident}");
    // Chi-square of 600 degrees of freedom over 300: standard deviation 0.115; bending of the ranges adds a little.
    assert!((nees - 2.0).abs() < 0.5, "{nees}");
    // Taken for noise, the same errors average out in the covariance and not in the world.
    // 3.5 on these walks, a dozen of the standard deviations above away from 2; the same walks, so that the ratio of the errors is 0.85 with
    // little chance in it.
    assert!(overconfident > 3.0 && with < 0.9 * without, "{overconfident} {with} {without}");
}

#[test]
fn an_error_that_all_anchors_share_is_one_state() {
    let (with, nees) = judged_on(true, Some(SHARED), EstimatorSpec::Ekf, 59);
    let (each, _) = judged_on(true, Some(DRIFT), EstimatorSpec::Ekf, 59);
    println!("{with} {nees} {each}");
    // As above.
    assert!((nees - 2.0).abs() < 0.5, "{nees}");
    // Four ranges less one error that they share leave three to find two coordinates by, four errors leave the law of the hall: on these
    // walks a quarter of the squared error.
    assert!(with < 0.5 * each, "{with} {each}");
    // Where there is only that one, a filter that knows of errors of each anchor too expects more and errs little more.
    let (both, nees) = judged_on(true, Some(BOTH), EstimatorSpec::Ekf, 59);
    assert!(both < each && nees < 2.5, "{both} {nees}");
    let (smoother, nees) = judged_on(true, Some(SHARED), EstimatorSpec::Rts, 30);
    assert!((nees - 2.0).abs() < 0.6 && smoother < with, "{smoother} {nees}");
}

#[test]
fn smoothers_go_back_over_errors_that_last() {
    let (filter, _) = judged(Some(DRIFT), EstimatorSpec::Ekf, 30);
    for estimator in [EstimatorSpec::Rts, EstimatorSpec::FixedLagKalman { lag: Span::Instants(10) }] {
        let (smoother, nees) = judged(Some(DRIFT), estimator, 30);
        println!("{filter} {smoother} {nees}");
        // What lasts longer than the walk no smoother takes away: 0.91 of the filter's on the same walks.
        assert!(smoother < 0.95 * filter, "{estimator:?}: {smoother} {filter}");
        assert!((nees - 2.0).abs() < 0.6, "{estimator:?}: {nees}");
    }
}

#[test]
fn errors_of_sensors_are_not_shown() {
    let (packets, _) = walk(&mut Random::new(33), 20, false);
    let trail = trail_of(&spec(Some(DRIFT), EstimatorSpec::Rts), packets.clone(), LaggedMode::Both);
    assert_eq!(trail.n(), 4);
    let alone = trail_of(&spec(Some(DRIFT), EstimatorSpec::Ekf), packets, LaggedMode::Own);
    for row in 0..alone.len() {
        assert_eq!(alone.mean(row), trail.mean(row), "{row}");
        assert_eq!(alone.cov(row), trail.cov(row), "{row}");
        assert!(trail.lagged(row).is_none_or(|(mean, cov)| mean.len() == 4 && cov.len() == 10));
    }
}

#[test]
fn drifts_that_do_not_fit_are_refused() {
    let refused = |spec: &Spec, anchors: &Anchors| {
        registry::build(spec, anchors, &BuildOptions::default()).map(|_| ()).unwrap_err().to_string()
    };
    let mut many = Anchors::default();
    for i in 0..9 {
        many.add(&format!("a{i}"), [f64::from(i), 0.0, 0.0]).unwrap();
    }
    let found = refused(&spec(Some(DRIFT), EstimatorSpec::Ekf), &many);
    assert!(found.contains("sensor.drift") && found.contains("13 states with the errors of 9 anchors"), "{found}");
    // An error that they share is one.
    assert!(registry::build(&spec(Some(SHARED), EstimatorSpec::Ekf), &many, &BuildOptions::default()).is_ok());
    let mut eight = Anchors::default();
    for i in 0..8 {
        eight.add(&format!("a{i}"), [f64::from(i), 0.0, 0.0]).unwrap();
    }
    let found = refused(&spec(Some(BOTH), EstimatorSpec::Ekf), &eight);
    assert!(found.contains("sensor.drift") && found.contains("13 states with the errors of 8 anchors"), "{found}");
    let turn = ModelSpec::Turn(TurnSpec { noise: [1.0, 1.0], turn_noise: 0.1, per_step: None, prior: None });
    let found = refused(&Spec { model: turn, ..spec(Some(DRIFT), EstimatorSpec::Ekf) }, &anchors());
    assert!(found.contains("sensor.drift") && found.contains("coordinated turn"), "{found}");
    let walk = ModelSpec::Kinematic(KinematicSpec { order: 1, axes: 2, noise: vec![1.0, 1.0], prior: None });
    let drifting = Spec { model: walk, ..spec(Some(DRIFT), EstimatorSpec::Ekf) };
    assert!(registry::build(&drifting, &anchors(), &BuildOptions::default()).is_ok());
    assert!(registry::simulator(&drifting, &anchors()).map(|_| ()).unwrap_err().to_string().contains("do not drift"));
}
