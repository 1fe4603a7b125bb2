//! A step that cannot be taken leaves no trace, and equal steps give equal bytes.

mod support;

use fixtrail_track::anchors::Anchors;
use fixtrail_track::fix::{Fix, Sink};
use fixtrail_track::mat::Mat;
use fixtrail_track::packet::{Content, Kind, Packet};
use fixtrail_track::registry::{BuildOptions, build, layout};
use fixtrail_track::spec::{
    Align, EstimatorSpec, KinematicSpec, ModelSpec, Prior, Robust, SensorSpec, Span, Spec, TurnSpec,
};
use fixtrail_track::tracker::{Step, Tracker};
use fixtrail_track::trackers::LaggedMode;
use fixtrail_track::trail::Trail;
use nalgebra::DMatrix;
use std::collections::BTreeMap;
use support::oracle::random::Random;
use support::oracle::{Instant, Run};
use support::{Declared, fms, linear, packet, spec_of};

fn sensor(kind: Kind, sd: f64) -> SensorSpec {
    SensorSpec {
        kind,
        sd,
        path_loss: None,
        drift: None,
        bias: BTreeMap::new(),
        height_m: None,
        latency_s: 0.0,
        robust: Robust::None,
    }
}

fn anchors() -> Anchors {
    let mut anchors = Anchors::default();
    for (name, at) in
        [("a", [0.0, 0.0, 0.0]), ("b", [30.0, 0.0, 0.0]), ("c", [0.0, 30.0, 0.0]), ("d", [30.0, 30.0, 5.0])]
    {
        anchors.add(name, at).unwrap();
    }
    anchors
}

fn estimators() -> Vec<EstimatorSpec> {
    vec![
        EstimatorSpec::Kalman,
        EstimatorSpec::Ekf,
        EstimatorSpec::Rts,
        EstimatorSpec::FixedLagKalman { lag: Span::Instants(3) },
        fms(6, 2, Align::Filtered),
        fms(6, 2, Align::Predicted),
        fms(32, 2, Align::Filtered),
        fms(32, 2, Align::Predicted),
        EstimatorSpec::Fms { window: Span::Seconds(0.8), lag: Span::Seconds(0.2), align: Align::Filtered },
        EstimatorSpec::Ufir { window: Span::Instants(6) },
    ]
}

fn prior(n: usize) -> Option<Prior> {
    let mut cov = Mat::identity(n);
    cov.data.iter_mut().for_each(|v| *v *= 25.0);
    Some(Prior { mean: vec![12.0; n], cov, second_moment: None })
}

/// A way in which a step can be bad.
type Spoil = fn(&mut Owned);

/// A step that owns its packets.
#[derive(Clone, Debug)]
struct Owned {
    k: u64,
    t_s: Option<f64>,
    packets: Vec<Packet>,
}

impl Owned {
    fn step(&self) -> Step<'_> {
        Step::new(self.k, self.t_s, &self.packets)
    }
}

fn spoils() -> [(&'static str, Spoil); 5] {
    [
        ("infinite noise", |s| s.packets.iter_mut().for_each(|p| p.sd = Some(1e200))),
        ("no noise at all", |s| s.packets.iter_mut().for_each(|p| p.sd = Some(0.0))),
        ("a value without bound", |s| {
            s.packets.iter_mut().for_each(|p| match &mut p.content {
                Content::Position(xyz) => xyz.iter_mut().flatten().for_each(|v| *v = 1.7e308),
                Content::Range { value_m, .. } => *value_m = 1.7e308,
                Content::Linear { z, u } => {
                    z.iter_mut().flatten().for_each(|v| *v = 1.7e308);
                    u.iter_mut().for_each(|v| *v = -1.7e308);
                }
                _ => {}
            })
        }),
        ("a far future", |s| s.t_s = Some(1e160)),
        ("not a number", |s| {
            s.packets.iter_mut().for_each(|p| match &mut p.content {
                Content::Position(xyz) => xyz.iter_mut().flatten().for_each(|v| *v = f64::NAN),
                Content::Range { value_m, .. } => *value_m = f64::NAN,
                Content::Linear { z, .. } => z.iter_mut().flatten().for_each(|v| *v = f64::NAN),
                _ => {}
            })
        }),
    ]
}

/// Counts fixes besides keeping them.
struct Kept(Trail, usize);

impl Sink for Kept {
    fn fix(&mut self, fix: &Fix<'_>) {
        self.0.fix(fix);
        self.1 += 1;
    }
}

fn bits(trail: &Trail) -> Vec<Option<Vec<u64>>> {
    let mut out = Vec::new();
    let pack = |pair: Option<(&[f64], &[f64])>| pair.map(|(m, c)| m.iter().chain(c).map(|v| v.to_bits()).collect());
    for row in 0..trail.len() {
        out.push(pack(trail.mean(row).zip(trail.cov(row))));
        out.push(pack(trail.lagged(row)));
        out.push(trail.nis[row].map(|n| vec![n.to_bits(), u64::from(trail.nis_dof[row])]));
    }
    out
}

/// Runs the steps; before step `at` it offers the bad one. Returns the trail and whether the bad one was refused.
fn offered(spec: &Spec, steps: &[Owned], at: usize, spoil: Option<Spoil>) -> (Trail, bool) {
    let anchors = anchors();
    let mut tracker: Box<dyn Tracker> = build(spec, &anchors, &BuildOptions { lagged: LaggedMode::Both }).unwrap();
    let mut sink = Kept(Trail::new(layout(spec).n(), true), 0);
    let mut refused = false;
    for (i, step) in steps.iter().enumerate() {
        if let (true, Some(spoil)) = (i == at, spoil) {
            let mut bad = step.clone();
            spoil(&mut bad);
            let before = sink.1;
            refused = tracker.step(&bad.step(), &mut sink).is_err();
            if refused {
                assert_eq!(sink.1, before, "a refused step handed on a fix");
            } else {
                return (sink.0, false);
            }
        }
        tracker.step(&step.step(), &mut sink).expect("a good step");
    }
    tracker.finish(&mut sink).expect("a good end");
    (sink.0, refused)
}

/// How often each estimator refused a step, each time without a trace.
fn check(specs: &[Spec], steps: &[Owned]) -> BTreeMap<String, usize> {
    let mut refusals = BTreeMap::new();
    for spec in specs {
        let (clean, _) = offered(spec, steps, 0, None);
        assert!(bits(&clean).iter().any(Option::is_some));
        let count = refusals.entry(format!("{:?}", spec.estimator)).or_insert(0);
        for (name, spoil) in spoils() {
            for at in [0, 1, 4, steps.len() / 2, steps.len() - 1] {
                let (trail, refused) = offered(spec, steps, at, Some(spoil));
                if refused {
                    assert!(bits(&trail) == bits(&clean), "{:?}: {name} at step {at} left a trace", spec.estimator);
                    *count += 1;
                }
            }
        }
    }
    refusals
}

/// Whatever an estimator says, it is a number, and it is never worse than silent about what it cannot know.
fn assert_finite(specs: &[Spec], steps: &[Owned]) {
    for spec in specs {
        for (name, spoil) in spoils() {
            let mut bad = steps.to_vec();
            spoil(&mut bad[steps.len() / 2]);
            // Time never goes back.
            let t_s = bad[steps.len() / 2].t_s;
            bad[steps.len() / 2..].iter_mut().for_each(|s| s.t_s = if s.t_s < t_s { t_s } else { s.t_s });
            let anchors = anchors();
            let mut tracker = build(spec, &anchors, &BuildOptions { lagged: LaggedMode::Both }).unwrap();
            let mut trail = Trail::new(layout(spec).n(), true);
            for step in &bad {
                if tracker.step(&step.step(), &mut trail).is_err() {
                    break;
                }
            }
            let _ = tracker.finish(&mut trail);
            for k in 0..trail.len() {
                let finite = |v: &[f64]| v.iter().all(|v| v.is_finite());
                let sound = trail.mean(k).is_none_or(finite) && trail.cov(k).is_none_or(finite);
                let lagged = trail.lagged(k).is_none_or(|(m, c)| finite(m) && finite(c));
                assert!(sound && lagged, "{:?}: {name} gave an estimate that is no number in row {k}", spec.estimator);
            }
        }
    }
}

fn timed(rng: &mut Random, len: u64, ranges: bool) -> Vec<Owned> {
    (0..len)
        .map(|k| {
            let t = 0.1 * k as f64;
            let (x, y) = (10.0 + 2.0 * t, 12.0 - t);
            let at = |content| Packet::new(t, content, k + 1);
            let mut packets = Vec::new();
            if ranges {
                for (anchor, (ax, ay)) in [(0.0, 0.0), (30.0, 0.0), (0.0, 30.0)].into_iter().enumerate() {
                    let value_m = f64::hypot(x - ax, y - ay) + 0.1 * rng.normal();
                    packets.push(at(Content::Range { anchor: anchor as u32, value_m }));
                }
            } else if k % 5 != 3 {
                packets.push(at(Content::Position([Some(x + 0.1 * rng.normal()), Some(y), None])));
            }
            Owned { k, t_s: Some(t), packets }
        })
        .collect()
}

#[test]
fn refused_steps_of_linear_kinematic_trackers_leave_no_trace() {
    let steps = timed(&mut Random::new(1), 40, false);
    for prior in [None, prior(4)] {
        let model = KinematicSpec { order: 2, axes: 2, noise: vec![0.5, 0.5], prior };
        let specs: Vec<Spec> = estimators()
            .into_iter()
            .map(|e| Spec {
                sensors: vec![sensor(Kind::Position, 0.1)],
                ..spec_of(ModelSpec::Kinematic(model.clone()), e)
            })
            .collect();
        let refusals = check(&specs, &steps);
        println!("{refusals:#?}");
        // Of 25 offers: what is no number, what has no noise, and what leads beyond the range of numbers.
        assert!(refusals.values().all(|count| *count >= 14), "{refusals:?}");
        assert_finite(&specs, &steps);
    }
}

#[test]
fn refused_steps_of_nonlinear_trackers_leave_no_trace() {
    let steps = timed(&mut Random::new(2), 18, true);
    for prior in [None, prior(5)] {
        let model = TurnSpec { noise: [0.3, 0.3], turn_noise: 0.01, per_step: None, prior };
        let specs: Vec<Spec> = estimators()
            .into_iter()
            .filter(|e| !matches!(e, EstimatorSpec::Kalman | EstimatorSpec::Ufir { .. }))
            // Newton has one algorithm for windows of any length.
            .filter(|e| !matches!(e, EstimatorSpec::Fms { window: Span::Instants(32), .. }))
            .map(|e| Spec { sensors: vec![sensor(Kind::Range, 0.1)], ..spec_of(ModelSpec::Turn(model.clone()), e) })
            .collect();
        let refusals = check(&specs, &steps);
        println!("{refusals:#?}");
        for name in ["Ekf", "Rts"] {
            assert!(refusals[name] >= 5, "{refusals:?}");
        }
        assert_finite(&specs, &steps);
    }
}

#[test]
fn refused_steps_of_linear_runs_leave_no_trace() {
    let mut rng = Random::new(3);
    let at = Instant {
        a: DMatrix::from_row_slice(2, 2, &[1.0, 1.0, 0.0, 1.0]),
        b: DMatrix::from_row_slice(2, 1, &[0.5, 1.0]),
        g: DMatrix::identity(2, 2),
        q: DMatrix::identity(2, 2) * 0.1,
        // Seen through a small factor: the gain is large.
        c: DMatrix::from_row_slice(1, 2, &[1e-3, 0.0]),
        r: DMatrix::identity(1, 1) * 1e-8,
        z: vec![None],
        u: vec![0.0],
    };
    let base = Run { instants: vec![at; 40], prior: None };
    let steps: Vec<Owned> = (0..40u64)
        .map(|k| {
            let z = (k % 7 != 5).then(|| 1e-3 * (k as f64 + rng.normal()));
            Owned { k, t_s: Some(k as f64), packets: vec![packet(k as usize, &[z], &[rng.normal()])] }
        })
        .collect();
    for declared in [Declared::Invariant, Declared::Sequence] {
        for prior in [None, prior(2)] {
            let mut model = linear(&base, declared);
            model.prior = prior;
            let specs: Vec<Spec> = estimators()
                .into_iter()
                .filter(|e| !matches!(e, EstimatorSpec::Fms { window: Span::Seconds(_), .. }))
                .map(|e| spec_of(ModelSpec::Linear(model.clone()), e))
                .collect();
            let refusals = check(&specs, &steps);
            println!("{declared:?} {refusals:#?}");
            assert_finite(&specs, &steps);
        }
    }
}

#[test]
fn equal_steps_give_equal_bytes() {
    let steps = timed(&mut Random::new(4), 40, true);
    for e in estimators() {
        if matches!(e, EstimatorSpec::Kalman | EstimatorSpec::Ufir { .. }) {
            continue;
        }
        let model = KinematicSpec { order: 2, axes: 2, noise: vec![0.5, 0.5], prior: None };
        let spec = Spec { sensors: vec![sensor(Kind::Range, 0.1)], ..spec_of(ModelSpec::Kinematic(model), e) };
        let (a, b) = (offered(&spec, &steps, 0, None).0, offered(&spec, &steps, 0, None).0);
        assert_eq!(bits(&a), bits(&b), "{e:?}");
        assert!(bits(&a).iter().flatten().count() > 60, "{e:?}");
    }
}
