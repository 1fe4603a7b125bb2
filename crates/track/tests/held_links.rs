//! Links without time stamps: what the receiver holds, how likely it is new, and what tells that it is not.

mod support;

use fixtrail_track::anchors::Anchors;
use fixtrail_track::fix::Status;
use fixtrail_track::link::LinkReport;
use fixtrail_track::mat::Mat;
use fixtrail_track::packet::{Content, Kind, Packet};
use fixtrail_track::pipeline::track;
use fixtrail_track::registry::MAX_HELD;
use fixtrail_track::spec::{
    ArrivalSpec, Duplicates, EmvfVariant, EstimatorSpec, Hold, KinematicSpec, LinearSpec, LinearStep, LinkSpec,
    ModelSpec, Prior, Receiver, Robust, SensorSpec, Spec, TurnSpec,
};
use fixtrail_track::target::{TargetPackets, TargetTrail};
use fixtrail_track::trackers::LaggedMode;
use fixtrail_track::trail::Trail;
use std::collections::BTreeMap;
use support::oracle::random::Random;
use support::{bits, packet, spec_of};

const LEN: usize = 60;

fn held_estimators() -> Vec<EstimatorSpec> {
    let emvf = |variant, range_mixture| EstimatorSpec::Emvf { variant, range_mixture };
    vec![
        EstimatorSpec::Lmvf { square_root: false },
        EstimatorSpec::Lmvf { square_root: true },
        EstimatorSpec::Lmmse,
        EstimatorSpec::Gpb1,
        emvf(EmvfVariant::Model2, false),
        emvf(EmvfVariant::Model2, true),
        emvf(EmvfVariant::Model1Zero, false),
        emvf(EmvfVariant::Model1Skip, false),
    ]
}

fn unstamped(hold: Hold, arrival: Option<ArrivalSpec>, duplicates: Duplicates) -> LinkSpec {
    LinkSpec { receiver: Receiver::Unstamped { hold }, arrival, duplicates }
}

fn paper(p: f64) -> LinkSpec {
    unstamped(Hold::Paper, Some(ArrivalSpec::Constant(p)), Duplicates::Keep)
}

fn prior(mean: &[f64], var: f64) -> Prior {
    let mut cov = Mat::identity(mean.len());
    cov.data.iter_mut().for_each(|v| *v *= var);
    Prior { mean: mean.to_vec(), cov, second_moment: None }
}

/// The second system of the paper with an input: two states, one of them measured.
fn linear(prior: Option<Prior>, estimator: EstimatorSpec, link: LinkSpec) -> Spec {
    let mat = |rows, cols, data: &[f64]| Mat { rows, cols, data: data.to_vec() };
    let base = LinearStep {
        a: mat(2, 2, &[0.6, 0.0, 0.8, 0.5]),
        b: mat(2, 1, &[0.2, 1.0]),
        g: Mat::identity(2),
        c: mat(1, 2, &[1.0, 1.0]),
        q: mat(2, 2, &[0.25, 0.1, 0.1, 0.3]),
        r: mat(1, 1, &[0.5]),
    };
    Spec { link, ..spec_of(ModelSpec::Linear(LinearSpec { base, sequence: Vec::new(), prior }), estimator) }
}

fn system(estimator: EstimatorSpec, link: LinkSpec) -> Spec {
    linear(Some(prior(&[1.5, -0.5], 0.4)), estimator, link)
}

fn row(k: usize, y: Option<f64>) -> Packet {
    packet(k, &[y], &[(0.3 * k as f64).sin()])
}

fn tracked(spec: &Spec, packets: &[Packet]) -> TargetTrail {
    tracked_among(spec, &Anchors::default(), packets).expect("every step can be taken")
}

fn tracked_among(spec: &Spec, anchors: &Anchors, packets: &[Packet]) -> Result<TargetTrail, String> {
    let packets = TargetPackets { target: None, packets: packets.to_vec() };
    track(spec, anchors, &packets, LaggedMode::Own).map_err(|e| e.to_string())
}

/// What the receiver of a link shows of continuous data, and what came: γ_0 = 1.
struct Shown {
    y: Vec<f64>,
    came: Vec<bool>,
}

fn shown(rng: &mut Random, len: usize, p: f64, hold: Hold) -> Shown {
    let z: Vec<f64> = (0..len).map(|k| (0.2 * k as f64).sin() + rng.normal()).collect();
    let came: Vec<bool> = (0..len).map(|k| k == 0 || rng.chance(p)).collect();
    let mut y: Vec<f64> = Vec::new();
    for k in 0..len {
        y.push(match (hold, came[k]) {
            (_, true) => z[k],
            (Hold::LastReceived, false) => y[k - 1],
            (Hold::Paper, false) => z[if came[k - 1] { k - 1 } else { k - 2 }],
        });
    }
    Shown { y, came }
}

fn rows(shown: &Shown) -> Vec<Packet> {
    shown.y.iter().enumerate().map(|(k, y)| row(k, Some(*y))).collect()
}

/// The largest difference of two trails of the same rows.
fn apart(a: &Trail, b: &Trail) -> f64 {
    assert_eq!((a.len(), &a.status), (b.len(), &b.status));
    let mut worst: f64 = 0.0;
    for row in 0..a.len() {
        let numbers = |t: &Trail| [t.mean(row).unwrap_or(&[]), t.cov(row).unwrap_or(&[])].concat();
        let (a, b) = (numbers(a), numbers(b));
        assert_eq!(a.len(), b.len());
        a.iter().zip(&b).for_each(|(a, b)| worst = worst.max((a - b).abs() / (1.0 + b.abs())));
    }
    worst
}

#[test]
fn row_zero_with_a_prior_is_the_start_and_its_value_is_not_consumed() {
    let shown = shown(&mut Random::new(1), LEN, 0.7, Hold::Paper);
    let mut estimators = held_estimators();
    estimators.extend([EstimatorSpec::Kalman, EstimatorSpec::Ekf]);
    for estimator in estimators {
        let spec = system(estimator, paper(0.7));
        let trail = tracked(&spec, &rows(&shown)).trail;
        assert_eq!((trail.len(), trail.status[0], trail.nis[0]), (LEN, Status::Predicted, None), "{estimator:?}");
        assert_eq!(trail.mean(0), Some(&[1.5, -0.5][..]), "{estimator:?}");
        // A square root of 0.4 squares to 0.4 up to rounding.
        let off =
            trail.cov(0).expect("P0").iter().zip([0.4, 0.0, 0.4]).map(|(p, p0)| (p - p0).abs()).fold(0.0, f64::max);
        let is_root = estimator == EstimatorSpec::Lmvf { square_root: true };
        assert!(off <= if is_root { 1e-16 } else { 0.0 }, "{estimator:?}: {off:e}");
        for other in [Some(1e6), None] {
            let mut packets = rows(&shown);
            packets[0] = row(0, other);
            assert!(bits(&tracked(&spec, &packets).trail) == bits(&trail), "{estimator:?}");
        }
        assert!(trail.status[1..].iter().all(|s| *s == Status::Updated), "{estimator:?}");
    }
}

#[test]
fn row_zero_without_a_prior_is_a_measurement() {
    let shown = shown(&mut Random::new(2), LEN, 0.7, Hold::Paper);
    let held = tracked(&linear(None, EstimatorSpec::Kalman, paper(0.7)), &rows(&shown)).trail;
    let stamped = tracked(&linear(None, EstimatorSpec::Kalman, LinkSpec::default()), &rows(&shown)).trail;
    assert!(bits(&held) == bits(&stamped));
}

#[test]
fn rows_missing_from_k_are_rows_without_a_value() {
    let mut shown = shown(&mut Random::new(3), LEN, 0.7, Hold::Paper);
    shown.y[0] = 0.0;
    let mut estimators = held_estimators();
    estimators.extend([EstimatorSpec::Kalman, EstimatorSpec::Ekf]);
    let missing = [0, 1, 7, 8, 9, 30, 57];
    for estimator in estimators {
        for arrival in [ArrivalSpec::Constant(0.7), ArrivalSpec::Estimate] {
            let spec = system(estimator, unstamped(Hold::Paper, Some(arrival), Duplicates::Detect));
            // No input where there is no row.
            let silent = |k| packet(k, &[None], &[0.0]);
            let with: Vec<Packet> = rows(&shown)
                .into_iter()
                .enumerate()
                .map(|(k, row)| if missing.contains(&k) { silent(k) } else { row })
                .collect();
            let without: Vec<Packet> = rows(&shown)
                .into_iter()
                .enumerate()
                .filter(|(k, _)| !missing.contains(k))
                .map(|(_, row)| row)
                .collect();
            let (mut a, mut b) = (tracked(&spec, &with).trail, tracked(&spec, &without).trail);
            a.t_s.fill(None);
            b.t_s.fill(None);
            assert!(bits(&a) == bits(&b), "{estimator:?}");
            assert!(missing.iter().all(|k| a.status[*k] == Status::Predicted), "{estimator:?}");
        }
    }
}

#[test]
fn a_constant_a_list_and_a_column_of_one_probability_are_the_same() {
    let shown = shown(&mut Random::new(4), LEN, 0.8, Hold::Paper);
    let column = |p: &dyn Fn(usize) -> f64| -> Vec<Packet> {
        rows(&shown).into_iter().enumerate().map(|(k, row)| Packet { arrival: Some(p(k)), ..row }).collect()
    };
    for estimator in held_estimators() {
        let trail = |arrival, packets: &[Packet]| {
            bits(&tracked(&system(estimator, unstamped(Hold::Paper, Some(arrival), Duplicates::Keep)), packets).trail)
        };
        let by_column = || ArrivalSpec::Column("p".to_owned());
        let constant = trail(ArrivalSpec::Constant(0.8), &rows(&shown));
        assert!(trail(ArrivalSpec::List(vec![0.8; LEN]), &rows(&shown)) == constant, "{estimator:?}");
        assert!(trail(ArrivalSpec::List(vec![0.8]), &rows(&shown)) == constant, "{estimator:?}");
        assert!(trail(by_column(), &column(&|_| 0.8)) == constant, "{estimator:?}");
        // A shorter list: its last entry stays in force. p_0 is 1 whatever the list says of it.
        let list = trail(ArrivalSpec::List(vec![0.1, 0.9, 0.8, 0.6]), &rows(&shown));
        assert!(list != constant, "{estimator:?}");
        assert!(trail(by_column(), &column(&|k| [1.0, 0.9, 0.8, 0.6][k.min(3)])) == list, "{estimator:?}");
    }
}

#[test]
fn a_missing_row_keeps_the_probability_that_the_column_gave_last() {
    // A value that is new for certain used to leave its own probability, 1, to the rows missing after it, and so did row 0.
    let shown = shown(&mut Random::new(5), LEN, 0.8, Hold::Paper);
    let numbered = |k: usize| (k == 4).then_some(4);
    let packets: Vec<Packet> = rows(&shown)
        .into_iter()
        .enumerate()
        .filter(|(k, _)| ![1, 5].contains(k))
        .map(|(k, row)| Packet { arrival: Some(0.8), seq: numbered(k), ..row })
        .collect();
    let trail = |arrival| {
        bits(
            &tracked(&system(EstimatorSpec::Lmmse, unstamped(Hold::Paper, Some(arrival), Duplicates::Keep)), &packets)
                .trail,
        )
    };
    assert!(trail(ArrivalSpec::Column("p".to_owned())) == trail(ArrivalSpec::Constant(0.8)));
}

#[test]
fn an_arrival_rate_learnt_ends_near_the_rate_of_the_channel() {
    const LONG: usize = 4000;
    for (seed, hold) in [(6, Hold::Paper), (7, Hold::LastReceived)] {
        for p in [0.95, 0.8, 0.5, 0.2] {
            let shown = shown(&mut Random::new(seed), LONG, p, hold);
            let estimator = EstimatorSpec::Lmmse;
            let report = |link| tracked(&system(estimator, link), &rows(&shown)).link;
            let asked = report(unstamped(hold, Some(ArrivalSpec::Estimate), Duplicates::Keep));
            let learnt = asked.arrival.expect("a rate");
            // Four standard deviations of a share of 4000. Repeats hide a run of losses in the paper's link, which at p = 0.2 leaves
            // a fifth of what the losses themselves would tell; the grid of rates is 0.01 wide.
            let sd = (p * (1.0 - p) / LONG as f64).sqrt() * if hold == Hold::Paper { 5.0_f64.sqrt() } else { 1.0 };
            assert!((learnt - p).abs() < 4.0 * sd + 0.005, "{hold:?}, p = {p}: {learnt}");
            // The same where the spec says nothing; and no report where it says all.
            assert_eq!(report(unstamped(hold, None, Duplicates::Keep)), asked);
            assert_eq!(report(unstamped(hold, Some(ArrivalSpec::Constant(p)), Duplicates::Keep)).arrival, None);
            // Sequence numbers tell every loss of the channel that holds what came last.
            let mut last = 0;
            let numbered: Vec<Packet> = rows(&shown)
                .into_iter()
                .enumerate()
                .map(|(k, row)| {
                    last = if shown.came[k] || hold == Hold::Paper { k } else { last };
                    Packet { seq: Some(last as u64), ..row }
                })
                .collect();
            if hold == Hold::LastReceived {
                let link = unstamped(hold, None, Duplicates::Keep);
                let by_number = tracked(&system(estimator, link), &numbered).link;
                let came = shown.came[1..].iter().filter(|c| **c).count() as f64;
                let lost = LONG as f64 - 1.0 - came;
                assert_eq!(
                    (by_number.stale, by_number.arrival),
                    (lost as u64, Some((1.0 + came) / (1.0 + LONG as f64)))
                );
            }
        }
    }
}

#[test]
fn repeats_are_lost_where_they_are_detected_and_new_where_they_are_kept() {
    let y = [0.3, 1.0, 1.0, 2.0, 2.0, 2.0, 0.5];
    let packets: Vec<Packet> = y.iter().enumerate().map(|(k, y)| row(k, Some(*y))).collect();
    let report = |duplicates| {
        let ran = tracked(&system(EstimatorSpec::Kalman, unstamped(Hold::Paper, None, duplicates)), &packets);
        let lost: Vec<usize> = (0..y.len()).filter(|k| ran.trail.status[*k] == Status::Predicted).collect();
        (lost, ran.link.repeats)
    };
    // Row 0 is the start.
    assert_eq!(report(Duplicates::Keep), (vec![0], 0));
    assert_eq!(report(Duplicates::Detect), (vec![0, 2, 4, 5], 3));
}

fn sensor(kind: Kind) -> SensorSpec {
    SensorSpec {
        kind,
        sd: 0.2,
        path_loss: None,
        drift: None,
        bias: BTreeMap::new(),
        height_m: None,
        latency_s: 0.0,
        robust: Robust::None,
    }
}

fn anchors(n: usize) -> Anchors {
    let mut anchors = Anchors::default();
    for i in 0..n {
        let angle = 1.1 * i as f64;
        assert!(anchors.add(&format!("a{i}"), [20.0 * angle.cos(), 20.0 * angle.sin(), 0.0]).is_some());
    }
    anchors
}

fn moving(kind: Kind, estimator: EstimatorSpec, link: LinkSpec) -> Spec {
    let model =
        KinematicSpec { order: 2, axes: 2, noise: vec![0.3, 0.3], prior: Some(prior(&[1.0, 2.0, 0.5, -0.2], 1.0)) };
    Spec { link, sensors: vec![sensor(kind)], ..spec_of(ModelSpec::Kinematic(model), estimator) }
}

fn at(t_s: f64, content: Content) -> Packet {
    Packet::new(t_s, content, 1)
}

fn position(t_s: f64, x: f64, y: f64) -> Packet {
    at(t_s, Content::Position([Some(x), Some(y), None]))
}

/// Ranges of a walk to `n` anchors at each instant.
fn ranges(rng: &mut Random, len: usize, n: usize) -> Vec<Vec<Packet>> {
    let anchors = anchors(n);
    let ranges = |k: usize, rng: &mut Random| {
        let t_s = 0.2 * k as f64;
        let (x, y) = (1.0 + 0.5 * t_s, 2.0 - 0.2 * t_s);
        let range = |id: u32, rng: &mut Random| {
            let [ax, ay, _] = anchors.position_m(id);
            at(t_s, Content::Range { anchor: id, value_m: f64::hypot(x - ax, y - ay) + 0.2 * rng.normal() })
        };
        (0..n as u32).map(|id| range(id, rng)).collect()
    };
    (0..len).map(|k| ranges(k, rng)).collect()
}

#[test]
fn repeated_positions_are_lost_where_they_are_detected() {
    let at = [(1.0, 2.0), (1.1, 2.0), (1.1, 2.0), (1.1, 1.9), (1.2, 1.9), (1.2, 1.9)];
    let packets: Vec<Packet> = at.iter().enumerate().map(|(k, (x, y))| position(0.2 * k as f64, *x, *y)).collect();
    let spec = moving(Kind::Position, EstimatorSpec::Kalman, unstamped(Hold::Paper, None, Duplicates::Detect));
    let ran = tracked(&spec, &packets);
    // Row 0 is the start; a coordinate alone may stay as it is.
    let lost: Vec<usize> = (0..6).filter(|k| ran.trail.status[*k] == Status::Predicted).collect();
    assert_eq!((lost, ran.link.repeats), (vec![0, 2, 5], 2));
}

#[test]
fn repeats_of_a_link_with_time_stamps_are_lost_source_by_source() {
    let link = |duplicates| LinkSpec { duplicates, ..LinkSpec::default() };
    let anchors = anchors(3);
    let mut steps = ranges(&mut Random::new(8), 12, 3);
    let whole = steps.clone();
    // Two sources repeat at instants 4 and 5, one of them once more; at 9 all three do.
    for (k, sources) in [(4, vec![0, 2]), (5, vec![2]), (9, vec![0, 1, 2])] {
        for source in sources {
            steps[k][source].content = steps[k - 1][source].content.clone();
        }
    }
    let detect = moving(Kind::Range, EstimatorSpec::Ekf, link(Duplicates::Detect));
    let ran = tracked_among(&detect, &anchors, &steps.concat()).expect("a good run");
    assert_eq!((ran.link.repeats, ran.trail.len()), (6, 12));
    // The same as without those packets, but for the instant of which nothing is left.
    let mut fewer = whole;
    fewer[4].retain(|p| p.source().1[0] == Some(1));
    fewer[5].retain(|p| p.source().1[0] != Some(2));
    fewer[9].clear();
    let keep = moving(Kind::Range, EstimatorSpec::Ekf, link(Duplicates::Keep));
    let without = tracked_among(&keep, &anchors, &fewer.concat()).expect("a good run").trail;
    let numbers = |trail: &Trail, row: usize| [trail.mean(row).unwrap_or(&[]), trail.cov(row).unwrap_or(&[])].concat();
    for k in 0..9 {
        assert_eq!(numbers(&ran.trail, k), numbers(&without, k), "instant {k}");
    }
    assert_eq!(ran.trail.status[9], Status::Predicted);
    assert_eq!(without.len(), 11);
    // One sensor's linear run.
    let y = [0.3, 1.0, 1.0, 2.0];
    let packets: Vec<Packet> = y.iter().enumerate().map(|(k, y)| row(k, Some(*y))).collect();
    let ran = tracked(&system(EstimatorSpec::Kalman, link(Duplicates::Detect)), &packets);
    assert_eq!((ran.trail.status[2], ran.link.repeats), (Status::Predicted, 1));
}

/// Which rows are predicted, and the report, where the receiver shows values with these numbers.
fn by_number(numbers: &[u64], hold: Hold) -> (Vec<usize>, LinkReport) {
    let packets: Vec<Packet> = numbers
        .iter()
        .enumerate()
        .map(|(k, number)| Packet { seq: Some(*number), ..row(k, Some((1.3 * k as f64).sin())) })
        .collect();
    let ran = tracked(&system(EstimatorSpec::Kalman, unstamped(hold, None, Duplicates::Keep)), &packets);
    let lost = (1..numbers.len()).filter(|k| ran.trail.status[*k] == Status::Predicted).collect();
    (lost, ran.link)
}

#[test]
fn sequence_numbers_tell_what_is_new() {
    // The counter starts anywhere; a number that is shown again, or comes a step late, is old.
    for offset in [0, 7, 1_000_000] {
        let numbers = [0, 1, 1, 2, 4, 5, 5, 5, 8].map(|n| n + offset);
        let (lost, report) = by_number(&numbers, Hold::Paper);
        assert_eq!((lost, report.stale), (vec![2, 3, 6, 7], 4), "{offset}");
        // Four of eight, under a uniform prior.
        assert_eq!(report.arrival, Some(0.5));
    }
}

#[test]
fn a_counter_that_begins_anew_is_followed() {
    // A counter that began anew after fewer than a thousand numbers used to make every later value old.
    let numbers: Vec<u64> = (0..300).chain(0..50).collect();
    assert!(by_number(&numbers, Hold::LastReceived).0.is_empty());
    let high: Vec<u64> = (5000..5010).chain([0, 1, 1, 3]).collect();
    assert_eq!(by_number(&high, Hold::Paper).0, [12]);
    // After a few numbers only it looks like packets that were overtaken, but not for ever.
    let early: Vec<u64> = (0..20).chain(0..300).collect();
    let lost = by_number(&early, Hold::LastReceived).0;
    assert!(lost.len() <= 101 && lost.iter().all(|k| (20..=121).contains(k)), "{lost:?}");
    // Packets that were overtaken are old.
    assert_eq!(by_number(&[0, 1, 2, 3, 4, 2, 3, 7, 8], Hold::LastReceived).0, [5, 6]);
}

#[test]
fn a_value_held_for_long_stays_old() {
    // After a thousand rows of the same number its value used to be taken for that of a new counter.
    let numbers: Vec<u64> = (0..10).chain(std::iter::repeat_n(9, 2500)).chain([2510, 2511]).collect();
    let (lost, report) = by_number(&numbers, Hold::LastReceived);
    assert_eq!((lost.len(), report.stale), (2500, 2500));
}

#[test]
fn losses_of_a_numbered_run_with_time_stamps_are_counted_once() {
    // A missing row used to count a second time by the number that it left out.
    let link = LinkSpec { arrival: Some(ArrivalSpec::Estimate), ..LinkSpec::default() };
    let numbered = |k: usize| Packet { seq: Some(k as u64), ..row(k, Some(1.0)) };
    let mut packets: Vec<Packet> = [0, 1, 3, 4, 8, 9].map(numbered).to_vec();
    packets.insert(4, Packet { seq: None, ..row(6, None) });
    let learnt = |packets: &[Packet]| tracked(&system(EstimatorSpec::Kalman, link.clone()), packets).link.arrival;
    // Rows 2, 5, 6 and 7 of ten are lost.
    assert_eq!(learnt(&packets), Some(7.0 / 12.0));
    // Without time index only the numbers tell.
    let positions: Vec<Packet> =
        [0, 1, 3, 4, 8, 9].map(|k| Packet { seq: Some(k), ..position(k as f64, 1.0, 2.0) }).to_vec();
    let spec = moving(Kind::Position, EstimatorSpec::Kalman, link.clone());
    assert_eq!(tracked(&spec, &positions).link.arrival, Some(7.0 / 12.0));
}

#[test]
fn kalman_on_detected_repeats_is_kalman_on_losses_that_are_seen_to_the_bit() {
    for seed in 0..20 {
        let shown = shown(&mut Random::new(40 + seed), 200, 0.6, Hold::LastReceived);
        let held = unstamped(Hold::LastReceived, Some(ArrivalSpec::Constant(0.6)), Duplicates::Detect);
        let lost: Vec<Packet> = (0..200).map(|k| row(k, (k > 0 && shown.came[k]).then_some(shown.y[k]))).collect();
        for estimator in [EstimatorSpec::Kalman, EstimatorSpec::Ekf] {
            let seen = tracked(&system(estimator, LinkSpec::default()), &lost).trail;
            let ran = tracked(&system(estimator, held.clone()), &rows(&shown));
            assert!(bits(&ran.trail) == bits(&seen), "seed {seed}, {estimator:?}");
            assert_eq!(ran.link.repeats, shown.came.iter().filter(|came| !**came).count() as u64);
        }
        // What changes came for certain: the estimators of held values are the Kalman filter then, up to rounding.
        let seen = tracked(&system(EstimatorSpec::Kalman, LinkSpec::default()), &lost).trail;
        for estimator in [EstimatorSpec::Lmmse, EstimatorSpec::Gpb1] {
            let off = apart(&tracked(&system(estimator, held.clone()), &rows(&shown)).trail, &seen);
            assert!(off < 1e-12, "seed {seed}, {estimator:?}: {off:e}");
        }
    }
}

#[test]
fn estimators_of_held_values_are_the_kalman_filter_where_everything_arrives() {
    let shown = shown(&mut Random::new(9), LEN, 1.0, Hold::Paper);
    let kalman = tracked(&system(EstimatorSpec::Kalman, paper(1.0)), &rows(&shown)).trail;
    for estimator in held_estimators() {
        let off = apart(&tracked(&system(estimator, paper(1.0)), &rows(&shown)).trail, &kalman);
        assert!(off < 1e-12, "{estimator:?}: {off:e}");
    }
    // Ranges, and a turning target.
    let packets = ranges(&mut Random::new(10), LEN, 3).concat();
    let anchors = anchors(3);
    let turning = |estimator| {
        let model = TurnSpec {
            noise: [0.3, 0.3],
            turn_noise: 0.01,
            per_step: None,
            prior: Some(prior(&[1.0, 2.0, 0.5, -0.2, 0.0], 0.5)),
        };
        Spec { link: paper(1.0), sensors: vec![sensor(Kind::Range)], ..spec_of(ModelSpec::Turn(model), estimator) }
    };
    for make in [&|e| moving(Kind::Range, e, paper(1.0)) as Spec, &turning as &dyn Fn(EstimatorSpec) -> Spec] {
        let ekf = tracked_among(&make(EstimatorSpec::Ekf), &anchors, &packets).expect("a good run").trail;
        for estimator in held_estimators().into_iter().filter(|e| !matches!(e, EstimatorSpec::Lmvf { .. })) {
            let off = apart(&tracked_among(&make(estimator), &anchors, &packets).expect("a good run").trail, &ekf);
            // Relative to numbers of about 20: the same sums in another order.
            assert!(off < 1e-12, "{estimator:?}: {off:e}");
        }
    }
}

#[test]
fn a_shown_zero_moves_nothing_where_it_is_skipped() {
    let emvf = |variant| EstimatorSpec::Emvf { variant, range_mixture: false };
    let mut y = shown(&mut Random::new(11), 30, 0.7, Hold::Paper).y;
    y[12] = 0.0;
    let packets = |y: &[f64]| -> Vec<Packet> { y.iter().enumerate().map(|(k, y)| row(k, Some(*y))).collect() };
    let mut silent = packets(&y);
    silent[12] = row(12, None);
    let trail = |variant, packets: &[Packet]| tracked(&system(emvf(variant), paper(0.7)), packets).trail;
    let skipped = trail(EmvfVariant::Model1Skip, &packets(&y));
    assert_eq!(skipped.status[12], Status::Predicted);
    assert!(bits(&skipped) == bits(&trail(EmvfVariant::Model1Skip, &silent)));
    for variant in [EmvfVariant::Model1Zero, EmvfVariant::Model2] {
        let used = trail(variant, &packets(&y));
        assert_eq!(used.status[12], Status::Updated);
        assert_ne!(used.mean(12), trail(variant, &silent).mean(12));
    }
}

#[test]
fn a_shown_zero_is_one_before_a_bias_is_taken_from_it() {
    // A bias used to make a measurement of a zero that the receiver shows.
    let estimator = EstimatorSpec::Emvf { variant: EmvfVariant::Model1Skip, range_mixture: false };
    let mut spec = moving(Kind::Range, estimator, paper(0.7));
    spec.sensors[0].bias.insert("a0".to_owned(), 0.18);
    let mut packets = ranges(&mut Random::new(12), 20, 1).concat();
    packets[9].content = Content::Range { anchor: 0, value_m: 0.0 };
    let trail = tracked_among(&spec, &anchors(1), &packets).expect("a good run").trail;
    assert_eq!((trail.status[9], trail.status[10]), (Status::Predicted, Status::Updated));
}

#[test]
fn what_a_link_without_time_stamps_cannot_hold_is_refused_in_one_sentence() {
    for estimator in held_estimators().into_iter().filter(|e| !matches!(e, EstimatorSpec::Lmvf { .. })) {
        let spec = moving(Kind::Range, estimator, paper(0.9));
        let most = ranges(&mut Random::new(13), 20, MAX_HELD).concat();
        assert_eq!(tracked_among(&spec, &anchors(MAX_HELD), &most).expect("room for them").trail.len(), 20);
        let many = ranges(&mut Random::new(13), 20, MAX_HELD + 1).concat();
        let error = tracked_among(&spec, &anchors(MAX_HELD + 1), &many).expect_err("more than there is room for");
        assert!(error.contains("an instant has 9 values, expected at most 8"), "{error}");
        let mut fewer = ranges(&mut Random::new(14), 20, 3);
        fewer[7].pop();
        let error = tracked_among(&spec, &anchors(3), &fewer.concat()).expect_err("not what came at the first");
        assert!(error.contains("an instant has 2 values, expected 3 as at the first"), "{error}");
        fewer[7].pop();
        let error = tracked_among(&spec, &anchors(3), &fewer.concat()).expect_err("not what came at the first");
        assert!(error.contains("an instant has 1 value, expected 3"), "{error}");
    }
}

#[test]
fn losses_that_are_known_need_no_inverse_of_a_singular_motion() {
    // Two losses in a row used to ask for A⁻¹ although nothing was shown that it could be used for.
    let numbers = [0, 1, 1, 1, 1, 5, 6, 6, 6, 9];
    let packets: Vec<Packet> = numbers
        .iter()
        .enumerate()
        .map(|(k, number)| Packet { seq: Some(*number), ..row(k, Some((1.3 * *number as f64).sin())) })
        .collect();
    for estimator in held_estimators() {
        let spec = |estimator, link| {
            let mut spec = system(estimator, link);
            if let ModelSpec::Linear(linear) = &mut spec.model {
                linear.base.a.data = vec![0.6, 0.0, 0.8, 0.0];
            }
            spec
        };
        let held = tracked(&spec(estimator, paper(0.7)), &packets).trail;
        let kalman = tracked(&spec(EstimatorSpec::Kalman, paper(0.7)), &packets).trail;
        let off = apart(&held, &kalman);
        assert!(off < 1e-12, "{estimator:?}: {off:e}");
    }
}
