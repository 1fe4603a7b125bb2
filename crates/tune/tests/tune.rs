//! What is tuned on simulated recordings against the numbers they were made with.

use fixtrail_track::anchors::Anchors;
use fixtrail_track::packet::{Content, Packet};
use fixtrail_track::spec::{self, ModelSpec, Robust, Spec};
use fixtrail_track::target::TargetPackets;
use fixtrail_track::truth::{TargetTruth, TruthPoint};
use fixtrail_tune::{Change, Options, Recording, TuneError, Tuned, tune, write};
use rand_distr::{Distribution as _, StandardNormal};
use rand_pcg::Pcg64Mcg;
use std::path::Path;

const SITES: [[f64; 3]; 5] =
    [[0.0, 0.0, 2.0], [20.0, 0.0, 2.5], [0.0, 20.0, 2.2], [20.0, 20.0, 2.4], [10.0, -5.0, 3.0]];
const BIAS: [f64; 5] = [0.3, -0.1, 0.55, 0.2, 0.05];
const SD: f64 = 0.2;
const PSD: f64 = 0.3;
const HEIGHT: f64 = 1.0;
const LATENCY_S: f64 = 0.3;

struct Chance(Pcg64Mcg);

impl Chance {
    fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.0)
    }
}

fn packet(t_s: f64, content: Content) -> Packet {
    Packet { t_s, k: None, content, sd: None, seq: None, received_s: None, arrival: None, line: 1 }
}

fn anchors() -> Anchors {
    let mut anchors = Anchors::default();
    for (i, site) in SITES.iter().enumerate() {
        anchors.add(&format!("a{i}"), *site).unwrap();
    }
    anchors
}

/// A walk of constant velocity under noise of density [`PSD`], pulled back into the hall, and `measured` of it by each anchor ten times a second.
fn recording(
    seed: u128,
    seconds: usize,
    latency_s: f64,
    measured: impl Fn(&mut Chance, usize, f64) -> Content,
) -> Recording {
    let mut chance = Chance(Pcg64Mcg::new(seed));
    let dt = 0.1;
    let (mut p, mut v) = ([10.0, 10.0], [0.5, -0.3]);
    let (mut packets, mut points) = (Vec::new(), Vec::new());
    for k in 0..seconds * 10 {
        let t_s = k as f64 * dt;
        points.push(TruthPoint { t_s, position_m: [Some(p[0]), Some(p[1]), Some(HEIGHT)] });
        for (anchor, site) in SITES.iter().enumerate() {
            let distance = (p[0] - site[0]).hypot(p[1] - site[1]).hypot(HEIGHT - site[2]);
            packets.push(packet(t_s + latency_s, measured(&mut chance, anchor, distance)));
        }
        for axis in 0..2 {
            // A wall turns the target back.
            if (p[axis] < 2.0 && v[axis] < 0.0) || (p[axis] > 18.0 && v[axis] > 0.0) {
                v[axis] = -v[axis];
            }
            let (a, b) = (chance.normal(), chance.normal());
            // Cov (dt³/3, dt²/2, dt) by its Cholesky factor.
            let dv = (PSD * dt).sqrt() * a;
            p[axis] += v[axis] * dt + 0.5 * dt * dv + (PSD * dt * dt * dt / 12.0).sqrt() * b;
            v[axis] += dv;
        }
    }
    let targets = vec![TargetPackets { target: None, packets }];
    Recording {
        name: format!("walk {seed}"),
        anchors: anchors(),
        targets,
        truth: vec![TargetTruth { target: None, points }],
    }
}

fn ranges(chance: &mut Chance, anchor: usize, distance: f64) -> Content {
    Content::Range { anchor: anchor as u32, value_m: distance + BIAS[anchor] + SD * chance.normal() }
}

fn parsed(text: &str) -> Spec {
    spec::parse(text, Path::new("spec.toml"), &mut |_| Err(std::io::ErrorKind::NotFound.into())).unwrap()
}

const WRONG: &str = "\
# By hand.
version = 1
[model]
kind = \"constant-velocity\"
noise = 20.0  # a guess
[sensor]
kind = \"range\"
sd = 2.0
[estimator]
kind = \"ekf\"
";

const NUMBERS: Options = Options { keep_structure: true };

fn noise(spec: &Spec) -> f64 {
    let ModelSpec::Kinematic(model) = &spec.model else { panic!("{:?}", spec.model) };
    model.noise[0]
}

fn without_truth(recordings: &[Recording]) -> Vec<Recording> {
    recordings.iter().map(|r| Recording { truth: Vec::new(), ..r.clone() }).collect()
}

#[test]
fn truth_gives_biases_height_latency_and_noise_back() {
    let recordings = [recording(1, 120, LATENCY_S, ranges), recording(2, 120, LATENCY_S, ranges)];
    let tuned = tune(&parsed(WRONG), &recordings, &NUMBERS, &|_| {}).unwrap();
    let sensor = &tuned.spec.sensors[0];
    assert_eq!(sensor.height_m, Some(HEIGHT));
    // Found to 25 ms.
    assert!((sensor.latency_s - LATENCY_S).abs() < 0.04, "{}", sensor.latency_s);
    let calibration = tuned.calibrations[0].as_ref().unwrap();
    for (i, bias) in BIAS.iter().enumerate() {
        // The target moves while its packets are late, which adds about speed × latency × cos to each residual and averages out over walls.
        let found = calibration.bias[&format!("a{i}")];
        assert!((found.value - bias).abs() < 0.08, "a{i}: {found:?}, made with {bias}");
        assert!(found.error.is_some_and(|e| (0.001..0.15).contains(&e)), "{found:?}");
    }
    let before = tuned.before.rmse_m.unwrap();
    let after = tuned.after.rmse_m.unwrap();
    assert!(after < 0.5 * before && after < 0.2, "{before} {after}");
    // The score is flat around the best: half and double cost a few hundredths.
    assert!((0.5 * SD..2.0 * SD).contains(&sensor.sd), "{}", sensor.sd);
    assert!((PSD..30.0 * PSD).contains(&noise(&tuned.spec)), "{}", noise(&tuned.spec));
    let (scale, honesty) = tuned.honesty.unwrap();
    assert!((0.7..1.6).contains(&scale) && honesty.independent > 20.0, "{scale} {honesty:?}");
}

#[test]
fn foretold_measurements_give_the_noise_back() {
    let recordings = without_truth(&[recording(3, 120, 0.0, |chance, anchor, distance| Content::Range {
        anchor: anchor as u32,
        value_m: distance + SD * chance.normal(),
    })]);
    let start = WRONG.replace("sd = 2.0", "sd = 2.0\nheight_m = 1.0");
    let tuned = tune(&parsed(&start), &recordings, &NUMBERS, &|_| {}).unwrap();
    assert!(!tuned.with_truth && tuned.after.score > tuned.before.score + 0.5);
    // 6000 ranges fix their noise to 1 %, the steps of the search to 10 %.
    assert!((tuned.spec.sensors[0].sd / SD - 1.0).abs() < 0.1, "{}", tuned.spec.sensors[0].sd);
    // Walls turn a velocity of metres per second round at once: more noise than between them.
    assert!((PSD..30.0 * PSD).contains(&noise(&tuned.spec)), "{}", noise(&tuned.spec));
    let innovation = tuned.after.innovation.unwrap();
    assert!((innovation - 1.0).abs() < 0.1, "{innovation}");
}

#[test]
fn outliers_and_lasting_errors_change_the_structure() {
    let drifting = |chance: &mut Chance, anchor: usize, distance: f64| {
        // A tenth of the ranges is off by metres; each anchor's error changes with the distance, as multipath does.
        let outlier = if chance.normal() > 1.3 { 5.0 * chance.normal().abs() } else { 0.0 };
        let lasting = 0.4 * (distance / 3.0 + anchor as f64).sin();
        Content::Range { anchor: anchor as u32, value_m: distance + lasting + outlier + 0.05 * chance.normal() }
    };
    let recordings = [recording(4, 40, 0.0, drifting)];
    let tuned = tune(&parsed(WRONG), &recordings, &Options::default(), &|_| {}).unwrap();
    let taken = |change: Change| tuned.structures.iter().any(|t| t.change == change && t.taken);
    assert!(taken(Change::Redescending) && taken(Change::Drift(0)), "{:?}", tuned.structures);
    assert!(matches!(tuned.spec.sensors[0].robust, Robust::Redescending(_) | Robust::Huber(_)));
    let drift = tuned.spec.sensors[0].drift.unwrap();
    // A sine of amplitude 0.4 m has an RMS of 0.28.
    assert!((0.1..0.8).contains(&drift.sd), "{drift:?}");
}

#[test]
fn strengths_give_their_law_back() {
    let strengths = |chance: &mut Chance, anchor: usize, distance: f64| {
        let value_dbm = -45.0 + 4.0 * BIAS[anchor] - 24.0 * distance.log10() + 2.0 * chance.normal();
        Content::Rssi { anchor: anchor as u32, value_dbm }
    };
    let start = WRONG.replace("\"range\"", "\"rssi\"\npath_loss = { exponent = 3.5, at_1m_dbm = -30 }");
    let recordings = [recording(5, 200, 0.0, strengths)];
    let tuned = tune(&parsed(&start), &recordings, &NUMBERS, &|_| {}).unwrap();
    let [exponent, level] = tuned.calibrations[0].as_ref().unwrap().path_loss.unwrap();
    // 10 000 strengths of 2 dB: the slope to about 0.01, the mean level (that of the mean bias, 0.8 dB) to about 0.1 dB.
    assert!((exponent.value - 2.4).abs() < 0.05 && exponent.error.unwrap() < 0.05, "{exponent:?}");
    assert!((level.value - -44.2).abs() < 0.6, "{level:?}");
}

#[test]
fn windows_are_chosen_by_what_they_foretell() {
    let start = "[model]\nkind = \"linear\"\nA = [[1.0]]\nC = [[1.0]]\nQ = [[0.01]]\nR = [[1.0]]\n[estimator]\nkind = \"ufir\"\nwindow = 3\n";
    let mut chance = Chance(Pcg64Mcg::new(6));
    let mut x = 0.0;
    let walk = (0..3000).map(|k| {
        x += 0.1 * chance.normal();
        let content = Content::Linear { z: vec![Some(x + chance.normal())], u: Vec::new() };
        Packet { k: Some(k), ..packet(k as f64, content) }
    });
    let targets = vec![TargetPackets { target: None, packets: walk.collect() }];
    let recordings = [Recording { name: "walk".to_owned(), anchors: Anchors::default(), targets, truth: Vec::new() }];
    let tuned = tune(&parsed(start), &recordings, &NUMBERS, &|_| {}).unwrap();
    let best = tuned.windows.iter().max_by(|a, b| a.1.total_cmp(&b.1)).unwrap().0;
    // A mean over M of a random walk of step variance q under noise r errs by r/M + qM/3, least at M = √(3r/q) = 17.
    assert!((10..=30).contains(&best), "{:?}", tuned.windows);
    let text = write(start, &tuned, "a walk").unwrap();
    assert!(text.contains(&format!("window = {best}  # loss at ")), "{text}");
}

#[test]
fn tuned_text_reads_back_and_keeps_what_was_there() {
    let recordings = [recording(7, 40, 0.0, ranges)];
    let tuned = tune(&parsed(WRONG), &recordings, &Options::default(), &|_| {}).unwrap();
    for start in [
        WRONG.to_owned(),
        WRONG.replace("[sensor]", "[[sensor]]"),
        "sensor = { kind = \"range\", sd = 2.0 }\nmodel = { kind = \"constant-velocity\", noise = 20.0 }\nestimator.kind = \"ekf\"\n".to_owned(),
        "sensor = [{ kind = \"range\", sd = 2.0 }]\n[model]\nkind = \"constant-velocity\"\nnoise = 20.0\n".to_owned(),
    ] {
        let text = write(&start, &tuned, "walk 7").unwrap();
        let read = parsed(&text);
        let near = |a: f64, b: f64| (a - b).abs() <= 1e-3 * b.abs();
        assert!(near(read.sensors[0].sd, tuned.spec.sensors[0].sd), "{text}");
        assert_eq!(read.sensors[0].bias.len(), 5);
        assert_eq!(read.sensors[0].drift.is_some(), tuned.spec.sensors[0].drift.is_some());
        assert_eq!(std::mem::discriminant(&read.model), std::mem::discriminant(&tuned.spec.model));
        assert!(text.starts_with("# Tuned on walk 7 ("), "{text}");
    }
    assert!(write(WRONG, &tuned, "walk 7").unwrap().contains("# By hand."));
}

#[test]
fn the_result_does_not_depend_on_the_threads() {
    let recordings = [recording(8, 20, 0.0, ranges), recording(9, 20, 0.0, ranges)];
    let on = |threads: usize| -> Tuned {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| tune(&parsed(WRONG), &recordings, &Options::default(), &|_| {}).unwrap())
    };
    let (one, two) = (on(1), on(2));
    assert_eq!(one.spec, two.spec);
    assert_eq!(one.after, two.after);
}

#[test]
fn what_cannot_be_tuned_is_refused() {
    let spec = parsed(WRONG);
    let empty = Recording { targets: Vec::new(), ..recording(10, 1, 0.0, ranges) };
    assert_eq!(tune(&spec, &[empty], &NUMBERS, &|_| {}).unwrap_err(), TuneError::Empty);
    let linear = parsed("[model]\nkind = \"linear\"\nA = [[1.0]]\nC = [[1.0]]\nQ = [[0.01]]\nR = [[1.0]]\n");
    assert_eq!(tune(&linear, &[recording(10, 1, 0.0, ranges)], &NUMBERS, &|_| {}).unwrap_err(), TuneError::Nothing);
    // Truth of another time says nothing.
    let mut late = recording(11, 5, 0.0, ranges);
    late.truth[0].points.iter_mut().for_each(|p| p.t_s -= 1e4);
    assert!(matches!(tune(&spec, &[late], &NUMBERS, &|_| {}), Err(TuneError::Start(_))));
}
