//! Trackers that hold a bounded memory do not allocate per step once they are warm.
//!
//! `rts` keeps the run, `fixed-lag-kalman` keeps rows per instant: they allocate by what they are.

mod support;

use allocation_counter::measure;
use fixtrail_track::anchors::Anchors;
use fixtrail_track::fix::{Fix, Sink, Status};
use fixtrail_track::packet::{Content, Kind, Packet};
use fixtrail_track::registry::{BuildOptions, build};
use fixtrail_track::spec::{Align, EstimatorSpec, KinematicSpec, ModelSpec, Robust, SensorSpec, Span, Spec};
use fixtrail_track::tracker::Step;
use fixtrail_track::trackers::LaggedMode;
use nalgebra::DMatrix;
use std::collections::BTreeMap;
use support::oracle::{Instant, Run};
use support::{Declared, fms, linear, packet, spec_of};

/// Takes fixes and keeps nothing but their number.
#[derive(Default)]
struct Counted {
    fixes: usize,
    unobservable: usize,
}

impl Sink for Counted {
    fn fix(&mut self, fix: &Fix<'_>) {
        self.fixes += 1;
        self.unobservable += usize::from(fix.status == Status::Unobservable);
    }
}

/// Runs 300 steps to warm up and counts the allocations of the rest.
fn assert_silent(spec: &Spec, anchors: &Anchors, mode: LaggedMode, packets: &[Vec<Packet>]) {
    let mut tracker = build(spec, anchors, &BuildOptions { lagged: mode }).unwrap();
    let mut sink = Counted::default();
    let mut run = |from: usize, to: usize| {
        for (k, packets) in packets.iter().enumerate().take(to).skip(from) {
            let t_s = packets.first().map(|p| p.t_s);
            tracker.step(&Step::new(k as u64, t_s, packets), &mut sink).expect("a good step");
        }
    };
    run(0, 300);
    let counted = measure(|| run(300, packets.len()));
    assert_eq!(counted.count_total, 0, "{:?} {mode:?}: {counted:?}", spec.estimator);
    assert!(sink.fixes == packets.len() && sink.unobservable < 20, "{:?} {}", spec.estimator, sink.unobservable);
}

fn linear_packets() -> Vec<Vec<Packet>> {
    (0..900)
        .map(|k| {
            let z = [(k % 6 != 2).then_some((0.1 * k as f64).sin()), (k % 25 != 3).then_some(0.5)];
            vec![packet(k, &z, &[0.1])]
        })
        .collect()
}

fn run() -> Run {
    let at = Instant {
        a: DMatrix::from_row_slice(2, 2, &[1.0, 1.0, 0.0, 1.0]),
        b: DMatrix::from_row_slice(2, 1, &[0.5, 1.0]),
        g: DMatrix::identity(2, 2),
        q: DMatrix::identity(2, 2) * 0.1,
        c: DMatrix::from_row_slice(2, 2, &[1.0, 0.0, 1.0, 1.0]),
        r: DMatrix::from_row_slice(2, 2, &[1.0, 0.4, 0.4, 1.0]),
        z: vec![None; 2],
        u: vec![0.0],
    };
    Run { instants: vec![at; 5], prior: None }
}

#[test]
fn trackers_of_linear_runs_do_not_allocate() {
    let packets = linear_packets();
    for declared in [Declared::Invariant, Declared::Sequence] {
        let model = linear(&run(), declared);
        for estimator in [
            EstimatorSpec::Kalman,
            EstimatorSpec::Ekf,
            EstimatorSpec::Ufir { window: Span::Instants(12) },
            fms(12, 4, Align::Filtered),
            fms(12, 4, Align::Predicted),
            fms(40, 4, Align::Filtered),
            fms(40, 4, Align::Predicted),
        ] {
            for mode in [LaggedMode::Own, LaggedMode::Both] {
                assert_silent(
                    &spec_of(ModelSpec::Linear(model.clone()), estimator),
                    &Anchors::default(),
                    mode,
                    &packets,
                );
            }
        }
    }
}

fn sensed(kind: Kind, estimator: EstimatorSpec) -> Spec {
    let model = KinematicSpec { order: 2, axes: 2, noise: vec![0.5, 0.5], prior: None };
    let sensor = SensorSpec {
        kind,
        sd: 0.1,
        path_loss: None,
        bias: BTreeMap::new(),
        height_m: None,
        latency_s: 0.0,
        robust: Robust::None,
    };
    Spec { sensors: vec![sensor], ..spec_of(ModelSpec::Kinematic(model), estimator) }
}

fn at(t_s: f64, content: Content) -> Packet {
    Packet { t_s, k: None, content, sd: None, seq: None, received_s: None, arrival: None, line: 1 }
}

#[test]
fn trackers_of_positions_do_not_allocate() {
    let packets: Vec<Vec<Packet>> = (0..900)
        .map(|k| {
            let t = 0.1 * k as f64 + if k % 3 == 0 { 0.02 } else { 0.0 };
            vec![at(t, Content::Position([Some(t.sin()), (k % 7 != 0).then_some(t.cos()), None]))]
        })
        .collect();
    let seconds = EstimatorSpec::Fms { window: Span::Seconds(1.5), lag: Span::Seconds(0.5), align: Align::Filtered };
    for estimator in [
        EstimatorSpec::Kalman,
        EstimatorSpec::Ufir { window: Span::Instants(12) },
        fms(12, 4, Align::Filtered),
        fms(40, 4, Align::Filtered),
        seconds,
    ] {
        assert_silent(&sensed(Kind::Position, estimator), &Anchors::default(), LaggedMode::Both, &packets);
    }
}

#[test]
fn extended_kalman_and_newton_windows_on_ranges_do_not_allocate() {
    let mut anchors = Anchors::default();
    let sites = [[0.0, 0.0, 0.0], [30.0, 0.0, 0.0], [0.0, 30.0, 0.0]];
    for (i, site) in sites.iter().enumerate() {
        anchors.add(&format!("a{i}"), *site).unwrap();
    }
    let packets: Vec<Vec<Packet>> = (0..900)
        .map(|k| {
            let t = 0.1 * k as f64;
            let (x, y) = (15.0 + 8.0 * (0.2 * t).sin(), 15.0 + 8.0 * (0.2 * t).cos());
            let range = |(i, s): (usize, &[f64; 3])| {
                at(t, Content::Range { anchor: i as u32, value_m: f64::hypot(x - s[0], y - s[1]) })
            };
            sites.iter().enumerate().map(range).collect()
        })
        .collect();
    for estimator in [EstimatorSpec::Ekf, fms(8, 3, Align::Filtered), fms(8, 3, Align::Predicted)] {
        assert_silent(&sensed(Kind::Range, estimator), &anchors, LaggedMode::Both, &packets);
    }
}
