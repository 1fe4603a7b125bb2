//! Trackers that hold a bounded memory do not allocate per step once they are warm.
//!
//! `rts` keeps the run, `fixed-lag-kalman` keeps rows per instant: they allocate by what they are.

mod support;

use allocation_counter::measure;
use fixtrail_track::anchors::Anchors;
use fixtrail_track::fix::{Fix, Sink, Status};
use fixtrail_track::link::Link;
use fixtrail_track::mat::Mat;
use fixtrail_track::packet::{Content, Kind, Packet};
use fixtrail_track::registry::{BuildOptions, build};
use fixtrail_track::spec::{
    Align, ArrivalSpec, Duplicates, EmvfVariant, EstimatorSpec, FosbNoise, Hold, KinematicSpec, LinkSpec, ModeSpec,
    ModelSpec, Prior, Receiver, Robust, SensorSpec, Span, Spec,
};
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
        drift: None,
        bias: BTreeMap::new(),
        height_m: None,
        latency_s: 0.0,
        robust: Robust::None,
    };
    Spec { sensors: vec![sensor], ..spec_of(ModelSpec::Kinematic(model), estimator) }
}

fn imm() -> EstimatorSpec {
    let mode = |psd, mean_s| Some(ModeSpec { noise: [psd, psd, 0.0], turn_noise: 0.0, mean_s });
    EstimatorSpec::Imm { modes: [mode(0.05, 20.0), mode(0.5, 9.0), mode(5.0, 2.0), None] }
}

fn at(t_s: f64, content: Content) -> Packet {
    Packet::new(t_s, content, 1)
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
        EstimatorSpec::Fosb { noise: FosbNoise::Model, speed_sd: None },
        EstimatorSpec::AlphaBeta { gains: None, interval_s: None },
        imm(),
        EstimatorSpec::Ufir { window: Span::Instants(12) },
        fms(12, 4, Align::Filtered),
        fms(40, 4, Align::Filtered),
        seconds,
    ] {
        assert_silent(&sensed(Kind::Position, estimator), &Anchors::default(), LaggedMode::Both, &packets);
    }
}

/// Ranges of a walk in a circle.
fn ranges(sites: &[[f64; 3]]) -> Vec<Vec<Packet>> {
    (0..900)
        .map(|k| {
            let t = 0.1 * k as f64;
            let (x, y) = (15.0 + 8.0 * (0.2 * t).sin(), 15.0 + 8.0 * (0.2 * t).cos());
            let range = |(i, s): (usize, &[f64; 3])| {
                at(t, Content::Range { anchor: i as u32, value_m: f64::hypot(x - s[0], y - s[1]) })
            };
            sites.iter().enumerate().map(range).collect()
        })
        .collect()
}

#[test]
fn extended_kalman_and_newton_windows_on_ranges_do_not_allocate() {
    let mut anchors = Anchors::default();
    let sites = [[0.0, 0.0, 0.0], [30.0, 0.0, 0.0], [0.0, 30.0, 0.0]];
    for (i, site) in sites.iter().enumerate() {
        anchors.add(&format!("a{i}"), *site).unwrap();
    }
    let packets = ranges(&sites);
    for estimator in [EstimatorSpec::Ekf, imm(), fms(8, 3, Align::Filtered), fms(8, 3, Align::Predicted)] {
        assert_silent(&sensed(Kind::Range, estimator), &anchors, LaggedMode::Both, &packets);
    }
}

fn held_estimators() -> Vec<EstimatorSpec> {
    vec![
        EstimatorSpec::Lmvf { square_root: false },
        EstimatorSpec::Lmvf { square_root: true },
        EstimatorSpec::Lmmse,
        EstimatorSpec::Gpb1,
        EstimatorSpec::Emvf { variant: EmvfVariant::Model2, range_mixture: true },
        EstimatorSpec::Emvf { variant: EmvfVariant::Model1Skip, range_mixture: false },
    ]
}

fn prior(n: usize) -> Option<Prior> {
    Some(Prior { mean: vec![1.0; n], cov: Mat::identity(n), second_moment: None })
}

fn unstamped(arrival: ArrivalSpec) -> LinkSpec {
    LinkSpec {
        receiver: Receiver::Unstamped { hold: Hold::Paper },
        arrival: Some(arrival),
        duplicates: Duplicates::Detect,
    }
}

#[test]
fn trackers_of_held_values_do_not_allocate() {
    // The noise of several values at an instant used to be a new list at every step.
    let mut model = linear(&run(), Declared::Invariant);
    model.prior = prior(2);
    let mut anchors = Anchors::default();
    let sites = [[0.0, 0.0, 0.0], [30.0, 0.0, 0.0], [0.0, 30.0, 0.0]];
    sites.iter().enumerate().for_each(|(i, site)| assert!(anchors.add(&format!("a{i}"), *site).is_some()));
    let ranges = ranges(&sites);
    for estimator in held_estimators() {
        let spec = Spec {
            link: unstamped(ArrivalSpec::Constant(0.9)),
            ..spec_of(ModelSpec::Linear(model.clone()), estimator)
        };
        assert_silent(&spec, &Anchors::default(), LaggedMode::Own, &linear_packets());
        if !matches!(estimator, EstimatorSpec::Lmvf { .. }) {
            let mut spec = Spec { link: unstamped(ArrivalSpec::Constant(0.9)), ..sensed(Kind::Range, estimator) };
            if let ModelSpec::Kinematic(model) = &mut spec.model {
                model.prior = prior(4);
            }
            assert_silent(&spec, &anchors, LaggedMode::Own, &ranges);
        }
    }
}

/// Sends packets through a link, the last of them with a count of the allocations.
fn assert_silent_link(spec: &LinkSpec, packets: &[Vec<Packet>]) {
    let mut link = Link::new(spec, true);
    let mut steps = 0;
    let mut run = |packets: Vec<Packet>| {
        for packet in packets {
            link.push(packet, |_| {
                steps += 1;
                Ok::<(), ()>(())
            })
            .expect("a good step");
        }
    };
    // Copies, which the link takes, are made before.
    let (warm, rest) = packets.split_at(300);
    let (warm, rest): (Vec<Packet>, Vec<Packet>) = (warm.concat(), rest.concat());
    run(warm);
    let counted = measure(|| run(rest));
    assert_eq!(counted.count_total, 0, "{spec:?}: {counted:?}");
    assert!(steps >= packets.len() - 20, "{steps}");
}

#[test]
fn links_do_not_allocate() {
    // Where repeats were detected every packet used to be copied.
    let stamped = |late_s| LinkSpec {
        receiver: Receiver::Stamped { late_s },
        arrival: Some(ArrivalSpec::Estimate),
        duplicates: Duplicates::Detect,
    };
    let sites = [[0.0, 0.0, 0.0], [30.0, 0.0, 0.0], [0.0, 30.0, 0.0]];
    let mut late = ranges(&sites);
    // Three instants at a time come in reverse.
    late.chunks_mut(3).for_each(<[Vec<Packet>]>::reverse);
    let mut repeated = ranges(&sites);
    for k in (2..900).step_by(3) {
        repeated[k][1].content = repeated[k - 1][1].content.clone();
    }
    let linear: Vec<Vec<Packet>> = linear_packets();
    for packets in [&late, &repeated, &linear] {
        assert_silent_link(&stamped(Some(if packets == &linear { 3.0 } else { 0.3 })), packets);
    }
    for packets in [&repeated, &linear] {
        assert_silent_link(&stamped(None), packets);
        assert_silent_link(&unstamped(ArrivalSpec::Estimate), packets);
        let numbered: Vec<Vec<Packet>> = (0..)
            .zip(packets)
            .map(|(k, packets)| packets.iter().map(|p| Packet { seq: Some(k), ..p.clone() }).collect())
            .collect();
        assert_silent_link(&unstamped(ArrivalSpec::Estimate), &numbered);
    }
}
