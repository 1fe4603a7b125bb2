//! The predictive score against a computation of its own, and what it prefers.

mod support;

use allocation_counter::measure;
use fixtrail_track::anchors::Anchors;
use fixtrail_track::fix::Status;
use fixtrail_track::packet::{Content, Kind, Packet};
use fixtrail_track::pipeline::track;
use fixtrail_track::predictive::{Score, score};
use fixtrail_track::spec::{EstimatorSpec, Hold, KinematicSpec, ModelSpec, Receiver, Robust, SensorSpec, Spec};
use fixtrail_track::target::TargetPackets;
use fixtrail_track::trackers::LaggedMode;
use fixtrail_track::trail::Trail;
use nalgebra::{DMatrix, DVector};
use std::collections::BTreeMap;
use support::oracle::random::{Family, Random, run};
use support::{Declared, linear, packets, spec_of};

const SITES: [[f64; 2]; 4] = [[-20.0, -20.0], [20.0, -25.0], [-22.0, 20.0], [18.0, 21.0]];
const BIAS: f64 = 0.4;
const KINDS: [Kind; 4] = [Kind::Position, Kind::Range, Kind::Tdoa, Kind::Bearing];

fn anchors() -> Anchors {
    let mut anchors = Anchors::default();
    for (i, [x, y]) in SITES.iter().enumerate() {
        anchors.add(&format!("a{i}"), [*x, *y, 0.0]).unwrap();
    }
    anchors
}

fn sd(kind: Kind) -> f64 {
    match kind {
        Kind::Bearing => 0.02,
        Kind::Position => 0.5,
        _ => 0.2,
    }
}

/// A constant velocity seen by sensors of the given kinds; `scale` is by how much every standard deviation is wrong.
fn spec(kinds: &[Kind], noise: f64, scale: f64) -> Spec {
    let sensor = |kind: &Kind| SensorSpec {
        kind: *kind,
        sd: sd(*kind) * scale,
        path_loss: None,
        drift: None,
        bias: if *kind == Kind::Range { BTreeMap::from([("a1".to_owned(), BIAS)]) } else { BTreeMap::new() },
        height_m: None,
        latency_s: 0.0,
        robust: Robust::None,
    };
    let noise = noise * scale * scale;
    let model = KinematicSpec { order: 2, axes: 2, noise: vec![noise, noise], prior: None };
    Spec { sensors: kinds.iter().map(sensor).collect(), ..spec_of(ModelSpec::Kinematic(model), EstimatorSpec::Ekf) }
}

/// The components that a content measures at a place, exactly.
fn exact(content: &Content, x: &[f64]) -> Vec<f64> {
    let from = |anchor: u32| [x[0] - SITES[anchor as usize][0], x[1] - SITES[anchor as usize][1]];
    let distance = |anchor: u32| from(anchor)[0].hypot(from(anchor)[1]);
    match *content {
        Content::Position(_) => x[..2].to_vec(),
        Content::Range { anchor, .. } => vec![distance(anchor) + if anchor == 1 { BIAS } else { 0.0 }],
        Content::Tdoa { anchor, reference, .. } => vec![distance(anchor) - distance(reference)],
        Content::Bearing { anchor, .. } => vec![from(anchor)[1].atan2(from(anchor)[0])],
        _ => unreachable!("not a measurement of these tests"),
    }
}

/// Everything the kinds say along a walk with the spec's own noise, at irregular instants.
fn data(kinds: &[Kind], noise: f64, instants: usize, rng: &mut Random) -> Vec<Packet> {
    let mut x = [3.0, -2.0, 0.5, 0.3];
    let mut t_s = 100.0;
    let mut out = Vec::new();
    for _ in 0..instants {
        for kind in kinds {
            for anchor in 0..SITES.len() as u32 {
                let mut content = match kind {
                    Kind::Position if anchor == 0 => Content::Position([Some(0.0), Some(0.0), None]),
                    Kind::Range => Content::Range { anchor, value_m: 0.0 },
                    Kind::Tdoa if anchor > 0 => Content::Tdoa { anchor, reference: 0, value_m: 0.0 },
                    Kind::Bearing => Content::Bearing { anchor, value_rad: 0.0 },
                    _ => continue,
                };
                if rng.chance(0.3) {
                    continue;
                }
                let said = exact(&content, &x).into_iter().map(|v| v + sd(*kind) * rng.normal()).collect::<Vec<_>>();
                match &mut content {
                    Content::Position(p) => *p = [Some(said[0]).filter(|_| !rng.chance(0.2)), Some(said[1]), None],
                    Content::Range { value_m: v, .. }
                    | Content::Tdoa { value_m: v, .. }
                    | Content::Bearing { value_rad: v, .. } => *v = said[0],
                    _ => {}
                }
                let line = out.len() as u64 + 1;
                out.push(Packet::new(t_s, content, line));
            }
        }
        let dt = 0.1 + 0.4 * rng.uniform();
        t_s += dt;
        for axis in 0..2 {
            // Variances dt³/3 and dt, covariance dt²/2.
            let (a, b) = (noise.sqrt() * rng.normal(), noise.sqrt() * rng.normal());
            x[axis] += dt * x[axis + 2] + dt.powf(1.5) * (a / 2.0 + b / 12_f64.sqrt());
            x[axis + 2] += dt.sqrt() * a;
        }
    }
    out
}

fn of(packets: Vec<Packet>) -> TargetPackets {
    TargetPackets { target: None, packets }
}

fn trail_of(spec: &Spec, packets: &TargetPackets) -> Trail {
    track(spec, &anchors(), packets, LaggedMode::Own).expect("every step can be taken").trail
}

fn scored(spec: &Spec, packets: &TargetPackets) -> Score {
    score(spec, &anchors(), packets, &trail_of(spec, packets), None).unwrap()
}

/// What the score should be, from a list of innovations.
#[derive(Default)]
struct Expected {
    log_density: f64,
    nis: f64,
    unforetold: usize,
    innovations: BTreeMap<Kind, Vec<f64>>,
}

impl Expected {
    fn add(&mut self, kind: Kind, innovation: f64, var: f64) {
        let square = innovation * innovation;
        let normal = (-0.5 * square / var).exp() / (std::f64::consts::TAU * var).sqrt();
        let cauchy = 1.0 / (std::f64::consts::PI * 10.0 * var.sqrt() * (1.0 + square / (100.0 * var)));
        self.log_density += (0.95 * normal + 0.05 * cauchy).ln();
        self.nis += innovation * innovation / var;
        self.innovations.entry(kind).or_default().push(innovation);
    }

    fn assert_is(&self, found: &Score, tolerance: f64) {
        let n: usize = self.innovations.values().map(Vec::len).sum();
        let close = |a: f64, b: f64| assert!((a - b).abs() <= tolerance * b.abs().max(1.0), "{a} {b}");
        assert_eq!((found.scalars, found.unforetold), (n, self.unforetold));
        close(found.mean_log_density().unwrap(), self.log_density / n as f64);
        close(found.mean_nis().unwrap(), self.nis / n as f64);
        assert_eq!(found.sizes().count(), self.innovations.len());
        for ((kind, size), (expected, innovations)) in found.sizes().zip(&self.innovations) {
            assert_eq!((kind, size.scalars), (*expected, innovations.len()));
            let mut sorted: Vec<f64> = innovations.iter().map(|v| v.abs()).collect();
            sorted.sort_by(f64::total_cmp);
            close(size.median, (sorted[(sorted.len() - 1) / 2] + sorted[sorted.len() / 2]) / 2.0);
            close(size.rms, (sorted.iter().map(|v| v * v).sum::<f64>() / sorted.len() as f64).sqrt());
        }
    }
}

fn dense(trail: &Trail, row: usize) -> Option<(DVector<f64>, DMatrix<f64>)> {
    let n = trail.n();
    let cov = DMatrix::from_fn(n, n, |i, j| trail.cov_at(row, i, j).unwrap_or(f64::NAN));
    Some((DVector::from_column_slice(trail.mean(row)?), cov))
}

/// The score of a walk's trail, from the packets in whatever order, by gradients that are differences.
fn by_differences(packets: &[Packet], trail: &Trail, noise: f64, from_s: f64) -> Expected {
    let mut expected = Expected::default();
    for packet in packets.iter().filter(|p| p.t_s >= from_s) {
        let values: Vec<Option<f64>> = match packet.content {
            Content::Position(p) => p[..2].to_vec(),
            _ => packet.content.values().collect(),
        };
        let before = (0..trail.len()).rev().find(|row| trail.t_s[*row].unwrap() < packet.t_s);
        let Some((row, (mean, cov))) = before.and_then(|row| Some((row, dense(trail, row)?))) else {
            expected.unforetold += values.iter().flatten().count();
            continue;
        };
        let dt = packet.t_s - trail.t_s[row].unwrap();
        let mut f = DMatrix::identity(4, 4);
        let mut q = DMatrix::zeros(4, 4);
        for axis in 0..2 {
            f[(axis, axis + 2)] = dt;
            q[(axis, axis)] = noise * dt.powi(3) / 3.0;
            (q[(axis, axis + 2)], q[(axis + 2, axis)]) = (noise * dt * dt / 2.0, noise * dt * dt / 2.0);
            q[(axis + 2, axis + 2)] = noise * dt;
        }
        let (mean, cov) = (&f * mean, &f * cov * f.transpose() + q);
        let kind = packet.content.kind();
        for (i, value) in values.iter().enumerate() {
            let Some(value) = value else { continue };
            let gradient = DVector::from_fn(4, |j, _| {
                let step = 1e-5;
                let at = |by: f64| {
                    let mut x = mean.clone();
                    x[j] += by;
                    exact(&packet.content, x.as_slice())[i]
                };
                (at(step) - at(-step)) / (2.0 * step)
            });
            let mut innovation = value - exact(&packet.content, mean.as_slice())[i];
            if kind == Kind::Bearing {
                innovation = innovation.sin().atan2(innovation.cos());
            }
            let sd = packet.sd.unwrap_or(sd(kind));
            expected.add(kind, innovation, (gradient.transpose() * &cov * &gradient)[0] + sd * sd);
        }
    }
    expected
}

#[test]
fn score_of_a_walk_equals_a_dense_computation() {
    for seed in 0..4 {
        let mut rng = Random::new(300 + seed);
        let mut all = data(&KINDS, 0.3, 80, &mut rng);
        for packet in &mut all {
            if rng.chance(0.2) {
                packet.sd = Some(3.0 * sd(packet.content.kind()));
            }
        }
        // As they came: overtaken by up to five others, and by less than half a second.
        let mut spec = spec(&KINDS, 0.3, 1.0);
        spec.link.receiver = Receiver::Stamped { late_s: Some(10.0) };
        for i in (5..all.len()).step_by(3) {
            all.swap(i, i - rng.count(0, 5));
        }
        all.iter_mut().enumerate().for_each(|(i, p)| p.line = i as u64 + 1);
        let packets = of(all);
        let trail = trail_of(&spec, &packets);
        let found = score(&spec, &anchors(), &packets, &trail, None).unwrap();
        let expected = by_differences(&packets.packets, &trail, 0.3, f64::NEG_INFINITY);
        // Central differences over 1e-5 m keep ten digits.
        expected.assert_is(&found, 1e-8);
        assert!(found.unforetold >= 4 && found.scalars > 400, "{} {}", found.unforetold, found.scalars);
        // From the middle on.
        let middle_s = trail.t_s[trail.len() / 2].unwrap();
        let found = score(&spec, &anchors(), &packets, &trail, Some(middle_s)).unwrap();
        by_differences(&packets.packets, &trail, 0.3, middle_s).assert_is(&found, 1e-8);
        assert_eq!(found.unforetold, 0);
    }
}

#[test]
fn score_of_a_linear_run_equals_a_dense_computation() {
    for (seed, declared) in [(1, Declared::Invariant), (2, Declared::Sequence), (3, Declared::Sequence)] {
        let mut rng = Random::new(400 + seed);
        let varying = declared == Declared::Sequence;
        let family = Family { len: 40, n: 3, q: 2, p: 2, varying, prior: false, loss: 0.3, singular: false };
        let run = run(&mut rng, &family);
        let spec = spec_of(ModelSpec::Linear(linear(&run, declared)), EstimatorSpec::Kalman);
        let packets = packets(&run);
        let trail = trail_of(&spec, &packets);
        let mut expected = Expected::default();
        for (k, at) in run.instants.iter().enumerate() {
            let before = k.checked_sub(1).and_then(|row| Some((row, dense(&trail, row)?)));
            for (i, z) in at.z.iter().enumerate() {
                let Some(z) = z else { continue };
                let Some((row, (mean, cov))) = &before else {
                    expected.unforetold += 1;
                    continue;
                };
                let to = &run.instants[*row];
                let mean = &to.a * mean + &to.b * DVector::from_column_slice(&to.u);
                let cov = &to.a * cov * to.a.transpose() + &to.g * &to.q * to.g.transpose();
                let c = at.c.row(i);
                expected.add(Kind::Linear, z - (c * mean)[0], (c * cov * c.transpose())[0] + at.r[(i, i)]);
            }
        }
        // Two orders of the same few products.
        expected.assert_is(&score(&spec, &Anchors::default(), &packets, &trail, None).unwrap(), 1e-11);
    }
}

#[test]
fn noise_wrong_by_two_scores_lower_whatever_measures() {
    // All standard deviations twice what they are: the estimates stay the same, and with S for 4 S the mean logarithm of the normal density
    // changes by −½ ln 4 + ⅜ = −0.32 per scalar; half of what they are: ½ ln 4 − 1½ = −0.81, somewhat less under the mixture. The mean of
    // 600 or more scalars, each with a standard deviation of 0.7, is within 0.12 of that with four standard deviations.
    for kinds in [&KINDS[..], &KINDS[1..2], &KINDS[2..3], &KINDS[..1]] {
        let mut rng = Random::new(500);
        let packets = of(data(kinds, 0.3, 600, &mut rng));
        let score = |scale: f64| scored(&spec(kinds, 0.3, scale), &packets);
        let right = score(1.0);
        let mean = right.mean_log_density().unwrap();
        assert!(right.scalars > 600 && (right.mean_nis().unwrap() - 1.0).abs() < 0.2, "{right:?}");
        for (scale, at_least) in [(2.0, 0.2), (0.5, 0.3)] {
            let wrong = score(scale).mean_log_density().unwrap();
            assert!(
                wrong < mean - at_least,
                "{kinds:?}: {scale} times the noise scores {wrong}, the right noise {mean}"
            );
        }
    }
}

#[test]
fn scores_of_targets_add_up_and_outliers_do_not_decide() {
    let kinds = &KINDS[1..2];
    let mut rng = Random::new(600);
    let (one, other) = (of(data(kinds, 0.3, 200, &mut rng)), of(data(kinds, 0.3, 100, &mut rng)));
    let spec = spec(kinds, 0.3, 1.0);
    let (a, b) = (scored(&spec, &one), scored(&spec, &other));
    let mut sum = a.clone();
    sum.add(&b);
    let n = (a.scalars + b.scalars) as f64;
    let mean =
        (a.mean_log_density().unwrap() * a.scalars as f64 + b.mean_log_density().unwrap() * b.scalars as f64) / n;
    assert_eq!((sum.scalars, sum.unforetold), (a.scalars + b.scalars, a.unforetold + b.unforetold));
    assert!((sum.mean_log_density().unwrap() - mean).abs() < 1e-12);
    // One range 46 m short in the last instant, which the trail has not followed before it is judged: 230 standard deviations.
    let mut spoilt = one.clone();
    let Some(Packet { content: Content::Range { value_m, .. }, .. }) = spoilt.packets.last_mut() else { panic!() };
    *value_m -= 46.0;
    let trail = trail_of(&spec, &one);
    let after = score(&spec, &anchors(), &spoilt, &trail, None).unwrap();
    let lost = (a.mean_log_density().unwrap() - after.mean_log_density().unwrap()) * a.scalars as f64;
    // S is from 1 to 2 times the sensor's variance, so ln(10π/0.05) + ln(1 + ν²/100 S) is 12.0 to 12.7; less what it cost before, 1.0 and
    // half of its squared innovation, which is below 9.
    assert!(lost > 6.5 && lost < 12.0, "{lost}");
    assert!(after.mean_nis().unwrap() > 20.0, "{:?}", after.mean_nis());
}

#[test]
fn unobservable_rows_foretell_nothing_and_misfits_are_refused() {
    let kinds = &KINDS[1..2];
    let mut rng = Random::new(700);
    let packets = of(data(kinds, 0.3, 60, &mut rng));
    let plain = spec(kinds, 0.3, 1.0);
    let trail = trail_of(&plain, &packets);
    let before = score(&plain, &anchors(), &packets, &trail, None).unwrap();
    // What a track that was given up and started anew leaves behind.
    let mut gone = trail.clone();
    (30..35).for_each(|row| gone.status[row] = Status::Unobservable);
    let after = score(&plain, &anchors(), &packets, &gone, None).unwrap();
    let count = |row: usize| packets.packets.iter().filter(|p| Some(p.t_s) == trail.t_s[row]).count();
    let lost: usize = (31..36).map(count).sum();
    assert_eq!((after.scalars, after.unforetold), (before.scalars - lost, before.unforetold + lost));

    let mut held = plain.clone();
    held.link.receiver = Receiver::Unstamped { hold: Hold::Paper };
    let error = score(&held, &anchors(), &packets, &trail, None).unwrap_err().to_string();
    assert!(error.contains("`link.stamped` is false") || error.contains("link.stamped"), "{error}");
    let error = score(&plain, &anchors(), &packets, &Trail::new(6, false), None).unwrap_err().to_string();
    assert!(error.contains("has 4 states, the trail has 6"), "{error}");
}

#[test]
fn scoring_does_not_allocate_per_scalar() {
    let kinds = &KINDS[..];
    let mut rng = Random::new(800);
    let long = of(data(kinds, 0.3, 1200, &mut rng));
    let short = of(long.packets[..long.packets.len() / 4].to_vec());
    let spec = spec(kinds, 0.3, 1.0);
    let count = |packets: &TargetPackets| {
        let trail = trail_of(&spec, packets);
        measure(|| drop(score(&spec, &anchors(), packets, &trail, None))).count_total
    };
    // Four times the scalars: each of the four lists of innovations doubles its room twice more, and the list of packets is one piece.
    let (few, many) = (count(&short), count(&long));
    assert!(long.packets.len() > 8000 && many <= few + 12, "{few} {many} {}", long.packets.len());
}
