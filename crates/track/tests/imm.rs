//! `imm`: better than either of its modes alone where a target does both, and as sure of itself as it may be.

use fixtrail_track::anchors::Anchors;
use fixtrail_track::fix::Status;
use fixtrail_track::packet::{Content, Packet};
use fixtrail_track::pipeline::track;
use fixtrail_track::spec::{Spec, parse};
use fixtrail_track::target::TargetPackets;
use fixtrail_track::trackers::LaggedMode;
use fixtrail_track::trail::Trail;
use rand_distr::{Distribution, StandardNormal, StandardUniform};
use rand_pcg::Pcg64;
use std::path::Path;

const SITES: [[f64; 3]; 4] = [[-200.0, -200.0, 0.0], [200.0, -200.0, 0.0], [-200.0, 200.0, 0.0], [200.0, 200.0, 0.0]];
const SD_M: f64 = 0.6;
/// Density of the noise and mean duration of each mode.
const QUIET: (f64, f64) = (0.01, 15.0);
const AGILE: (f64, f64) = (2.0, 4.0);

fn normal(rng: &mut Pcg64) -> f64 {
    StandardNormal.sample(rng)
}

fn uniform(rng: &mut Pcg64) -> f64 {
    StandardUniform.sample(rng)
}

fn anchors() -> Anchors {
    let mut anchors = Anchors::default();
    for (i, site) in SITES.iter().enumerate() {
        anchors.add(&format!("a{i}"), *site).unwrap();
    }
    anchors
}

fn spec(model: &str, sensor: &str, estimator: &str) -> Spec {
    let text = format!("[model]\n{model}\n[sensor]\n{sensor}\n[estimator]\n{estimator}\n");
    parse(&text, Path::new("spec.toml"), &mut |_| panic!("a file")).unwrap_or_else(|e| panic!("{e}"))
}

fn imm() -> String {
    let mode = |(noise, mean_s)| format!("[[estimator.mode]]\nnoise = {noise:?}\nmean_s = {mean_s:?}\n");
    format!("kind = \"imm\"\n{}{}", mode(QUIET), mode(AGILE))
}

fn run(spec: &Spec, packets: &[Packet]) -> Trail {
    let packets = TargetPackets { target: None, packets: packets.to_vec() };
    track(spec, &anchors(), &packets, LaggedMode::Own).expect("every step can be taken").trail
}

/// A packet of range.
fn range(t_s: f64, x: [f64; 2], anchor: usize, noise_m: f64) -> Packet {
    let value_m = f64::hypot(x[0] - SITES[anchor][0], x[1] - SITES[anchor][1]) + noise_m;
    let content = Content::Range { anchor: anchor as u32, value_m };
    Packet::new(t_s, content, 1)
}

/// A target that draws its modes and its noise from the model, at irregular times: times, states `x y vx vy`, packets.
fn drawn(seed: u128, len: usize) -> (Vec<[f64; 4]>, Vec<Packet>) {
    let mut rng = Pcg64::new(seed, 3);
    let mut x = [[0.0, 1.0], [0.0, -1.0]];
    let (mut t_s, mut agile) = (0.0, uniform(&mut rng) < AGILE.1 / (QUIET.1 + AGILE.1));
    // A mode lasts for a time that is exponentially distributed, whatever has been before.
    let lasts = |rng: &mut Pcg64, agile: bool| -(1.0 - uniform(rng)).ln() * if agile { AGILE.1 } else { QUIET.1 };
    let mut left_s = lasts(&mut rng, agile);
    let (mut states, mut packets) = (Vec::new(), Vec::new());
    for _ in 0..len {
        states.push([x[0][0], x[1][0], x[0][1], x[1][1]]);
        for anchor in 0..SITES.len() {
            packets.push(range(t_s, [x[0][0], x[1][0]], anchor, SD_M * normal(&mut rng)));
        }
        let mut dt_s = 0.2 + 0.6 * uniform(&mut rng);
        t_s += dt_s;
        while dt_s > 0.0 {
            let part_s = dt_s.min(left_s);
            for axis in &mut x {
                let (a, b) = (normal(&mut rng), normal(&mut rng));
                // A factor of psd [dt³/3, dt²/2; dt²/2, dt].
                let root = (if agile { AGILE.0 } else { QUIET.0 } * part_s).sqrt();
                *axis = [axis[0] + part_s * axis[1] + root * part_s * (0.5 * a + b / 12f64.sqrt()), axis[1] + root * a];
            }
            dt_s -= part_s;
            left_s -= part_s;
            if left_s <= 0.0 {
                agile = !agile;
                left_s = lasts(&mut rng, agile);
            }
        }
    }
    (states, packets)
}

/// dᵀ P⁻¹ d of the first two components.
fn distance(trail: &Trail, row: usize, d: [f64; 2]) -> f64 {
    let p = |i, j| trail.cov_at(row, i, j).expect("an estimate");
    let det = p(0, 0) * p(1, 1) - p(0, 1) * p(0, 1);
    (d[0] * d[0] * p(1, 1) - 2.0 * d[0] * d[1] * p(0, 1) + d[1] * d[1] * p(0, 0)) / det
}

#[test]
fn target_that_turns_now_and_then_is_tracked_better_than_by_either_mode() {
    let model = |noise: f64| format!("kind = \"constant-velocity\"\nnoise = {noise:?}");
    let sensor = format!("kind = \"range\"\nsd = {SD_M:?}");
    let mean = (QUIET.0 * QUIET.1 + AGILE.0 * AGILE.1) / (QUIET.1 + AGILE.1);
    let specs = [
        spec(&model(mean), &sensor, &imm()),
        spec(&model(QUIET.0), &sensor, "kind = \"ekf\""),
        spec(&model(AGILE.0), &sensor, "kind = \"ekf\""),
        spec(&model(mean), &sensor, "kind = \"ekf\""),
        spec(&model(mean), &sensor, "kind = \"imm\""),
    ];
    let (runs, len) = (300, 120);
    let (mut squares, mut speeds, mut nees, mut nis, mut count) = ([0.0; 5], [0.0; 5], [0.0; 5], [0.0; 5], 0.0);
    for seed in 0..runs {
        let (states, packets) = drawn(seed, len);
        for (i, spec) in specs.iter().enumerate() {
            let trail = run(spec, &packets);
            for row in 20..len {
                let (mean, x) = (trail.mean(row).expect("an estimate"), states[row]);
                let d = [mean[0] - x[0], mean[1] - x[1]];
                squares[i] += d[0] * d[0] + d[1] * d[1];
                speeds[i] += (mean[2] - x[2]).powi(2) + (mean[3] - x[3]).powi(2);
                nees[i] += distance(&trail, row, d) / 2.0;
                nis[i] += trail.nis[row].expect("a prediction") / f64::from(trail.nis_dof[row]);
            }
        }
        count += (len - 20) as f64;
    }
    let rms = |sum: [f64; 5]| sum.map(|s: f64| (s / count).sqrt());
    let mean = |sum: [f64; 5]| sum.map(|s: f64| s / count);
    let (places, speeds, nees, nis) = (rms(squares), rms(speeds), mean(nees), mean(nis));
    println!("{places:?}\n{speeds:?}\n{nees:?}\n{nis:?}");
    // 30 000 instants, of which six in a row are alike: 5000 squares, an RMSE to 1 %. All filters see the same data.
    for i in [1, 2, 3] {
        assert!(places[0] < 0.93 * places[i] && speeds[0] < 0.93 * speeds[i], "{i}: {places:?} {speeds:?}");
    }
    // Modes that are not the target's but a tenth and ten times the noise of the model.
    assert!(places[4] < 0.95 * places[3] && speeds[4] < 0.95 * speeds[3], "{places:?} {speeds:?}");
    // NEES over its mean of 2: sd √(2/2/5000) = 0.014, of which four are 0.06; a twentieth is for the modes being mixed, and changing
    // between instants. NIS over 4: innovations are independent, sd √(2/4/30000) = 0.004, four are 0.016; a hundredth for the mixing.
    assert!((nees[0] - 1.0).abs() < 0.11 && (nis[0] - 1.0).abs() < 0.026, "{nees:?} {nis:?}");
    // The bands have teeth: alone, either mode is outside of them.
    assert!(nees[1] > 5.0 && nis[1] > 2.0 && nis[2] < 0.9, "{nees:?} {nis:?}");
}

/// Largest relative difference of two trails, which must agree in everything but rounding.
fn difference(a: &Trail, b: &Trail) -> f64 {
    assert_eq!((a.len(), a.restarts, &a.status, &a.nis_dof), (b.len(), b.restarts, &b.status, &b.nis_dof));
    let mut worst: f64 = 0.0;
    for row in 0..a.len() {
        let numbers = |trail: &Trail| -> Vec<f64> {
            let mean = trail.mean(row).into_iter().flatten();
            mean.chain(trail.cov(row).into_iter().flatten()).chain(trail.nis[row].iter()).copied().collect()
        };
        let (a, b) = (numbers(a), numbers(b));
        assert_eq!(a.len(), b.len());
        worst = a.iter().zip(&b).map(|(a, b)| (a - b).abs() / (1.0 + a.abs())).fold(worst, f64::max);
    }
    worst
}

#[test]
fn modes_that_are_all_the_same_give_the_trail_of_one_filter() {
    // With an unknown start, outliers, lost instants and an outage: start, restarts, statuses and NIS are the filter's own. The mixture
    // of equal modes rounds once or twice, some 1e-13 on the straight; 1e-11 where an outlier throws a turn about.
    let (_, mut packets) = drawn(1, 100);
    for i in [3, 130, 131, 222] {
        if let Content::Range { value_m, .. } = &mut packets[i].content {
            *value_m += 46.0;
        }
    }
    packets.retain(|p| !(20.0..23.0).contains(&p.t_s));
    let (_, again) = drawn(2, 40);
    packets.extend(again.into_iter().map(|p| Packet { t_s: p.t_s + 900.0, ..p }));
    let straight = ["kind = \"constant-velocity\"\nnoise = [0.4, 0.6]", ""];
    let turn = [
        "kind = \"coordinated-turn\"\nnoise = 0.4\nturn_noise = 0.01",
        "x0 = [0, 0, 1, -1, 0]\nP0 = [[1, 0, 0, 0, 0], [0, 1, 0, 0, 0], [0, 0, 1, 0, 0], [0, 0, 0, 1, 0], [0, 0, 0, 0, 0.1]]",
    ];
    for [model, start] in [straight, turn] {
        for robust in ["none", "gate", "huber", "redescending"] {
            let sensor = format!("kind = \"range\"\nsd = {SD_M:?}\nrobust = {robust:?}");
            // A filter that is not robust would go on from a prediction of 900 s, and forget nothing; a turn is found again late.
            let restarts = u64::from(robust != "none" && start.is_empty());
            let until = if restarts == 0 { packets.len() - 160 } else { packets.len() };
            for modes in 2..=4 {
                let tables = "[[estimator.mode]]\nmean_s = 3\n".repeat(modes);
                let trail =
                    |estimator: &str| run(&spec(&format!("{model}\n{start}"), &sensor, estimator), &packets[..until]);
                let (one, all) = (trail("kind = \"ekf\""), trail(&format!("kind = \"imm\"\n{tables}")));
                let off = difference(&one, &all);
                println!("{model:?} {robust} {modes}: {off:e}");
                assert!(off < 1e-9, "{model} {robust} {modes}: {off:e}");
                assert_eq!(one.restarts, restarts, "{model} {robust}");
                let updated = one.status.iter().filter(|s| **s == Status::Updated).count();
                assert!(updated > 80, "{model} {robust}: {updated}");
            }
        }
    }
}

#[test]
fn every_kinematic_model_has_modes() {
    let position = |k: u32| {
        let t_s = 0.3 * f64::from(k);
        let x = |phase: f64| Some(5.0 * (0.2 * t_s + phase).sin());
        let content = Content::Position([x(0.0), x(1.0), x(2.0)]);
        Packet::new(t_s, content, 1)
    };
    let packets: Vec<Packet> = (0..60).map(position).collect();
    for kind in ["random-walk", "constant-velocity", "constant-acceleration", "coordinated-turn"] {
        for axes in 1..=3 {
            let model = match (kind, axes) {
                ("coordinated-turn", 2) => "kind = \"coordinated-turn\"\nnoise = 0.1\nturn_noise = 0.01".to_owned(),
                ("coordinated-turn", _) => continue,
                _ => format!("kind = {kind:?}\naxes = {axes}\nnoise = 0.1"),
            };
            let trail = run(&spec(&model, "kind = \"position\"\nsd = 0.1", "kind = \"imm\""), &packets);
            assert!(trail.status[10..].iter().all(|s| *s == Status::Updated), "{kind} {axes}: {:?}", trail.status);
            let (mean, Content::Position(xyz)) = (trail.mean(59).expect("an estimate"), &packets[59].content) else {
                unreachable!("positions")
            };
            assert!((0..axes).all(|i| (mean[i] - xyz[i].unwrap()).abs() < 0.2), "{kind} {axes}: {mean:?}");
        }
    }
}
