use super::*;
use crate::spec;
use std::path::Path;

/// SplitMix64: seeded, so that the bounds below hold for ever once they hold.
struct Chance(u64);

impl Chance {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (core::f64::consts::TAU * self.uniform()).cos()
    }
}

fn packet(t_s: f64, content: Content) -> Packet {
    Packet::new(t_s, content, 1)
}

fn position(t_s: f64, x: f64, y: f64) -> Packet {
    packet(t_s, Content::Position([Some(x), Some(y), None]))
}

fn one(packets: Vec<Packet>) -> Vec<TargetPackets> {
    vec![TargetPackets { target: Some("T1".into()), packets }]
}

/// A room of 8 × 6 m with anchors in its corners, two at the floor and two under the ceiling when `spread`.
fn room(spread: bool) -> Anchors {
    let mut anchors = Anchors::default();
    let low = if spread { 0.0 } else { 2.5 };
    for (name, position) in
        [("A0", [0.0, 0.0, 2.5]), ("A1", [8.0, 0.0, low]), ("A2", [8.0, 6.0, 2.5]), ("A3", [0.0, 6.0, low])]
    {
        anchors.add(name, position);
    }
    anchors
}

/// Ranges at 10 Hz of a target on a circle of 2 m radius walked at 1 m/s, 1 m above the floor.
fn ranges(anchors: &Anchors, sd: f64, bias: f64, count: usize, chance: &mut Chance) -> Vec<Packet> {
    let mut packets = Vec::new();
    for i in 0..count {
        let t = 0.1 * i as f64;
        let at = [4.0 + 2.0 * (0.5 * t).cos(), 3.0 + 2.0 * (0.5 * t).sin(), 1.0];
        for id in 0..anchors.len() as AnchorId {
            let p = anchors.position_m(id);
            let true_m = (0..3).map(|j| (p[j] - at[j]).powi(2)).sum::<f64>().sqrt();
            let biased = true_m + if id % 2 == 0 { bias } else { -bias };
            packets.push(packet(t, Content::Range { anchor: id, value_m: biased + sd * chance.normal() }));
        }
    }
    packets
}

fn parses(text: &str) -> spec::Spec {
    let mut no_file = |_: &Path| Err(std::io::Error::from(std::io::ErrorKind::NotFound));
    spec::parse(text, Path::new("proposed.toml"), &mut no_file).unwrap_or_else(|e| panic!("{e}\n{text}"))
}

fn circumstances() -> Circumstances<'static> {
    Circumstances { data: "walk.csv", ..Circumstances::default() }
}

#[test]
fn loss_of_independent_packets_is_estimated_within_three_errors_and_not_called_bursty() {
    let mut chance = Chance(1);
    let (n, p) = (20_000, 0.12);
    let kept: Vec<Packet> =
        (0..n).filter(|_| chance.uniform() >= p).map(|i| position(0.1 * i as f64, i as f64, 0.0)).collect();
    let survey = survey(&one(kept), &Anchors::default());
    let loss = survey.loss.expect("a steady rate");
    assert_eq!(loss.basis, Basis::Rate);
    // Three binomial standard errors.
    assert!((loss.rate() - p).abs() < 3.0 * (p * (1.0 - p) / n as f64).sqrt(), "{}", loss.rate());
    assert!(!loss.is_bursty());
    let mean = loss.mean_burst().expect("bursts");
    // 1/(1 − p), whose estimate from about 2100 bursts errs by √p/(1 − p)/√2100.
    assert!((mean - 1.0 / (1.0 - p)).abs() < 3.0 * p.sqrt() / (1.0 - p) / 2100f64.sqrt(), "{mean}");
    assert!((survey.targets[0].period_s.expect("period") - 0.1).abs() < 1e-9);
    assert!(survey.findings.iter().any(|f| f.text.contains("lost") && f.severity == Severity::Warning));
}

#[test]
fn loss_in_bursts_is_called_bursty_and_counted_from_sequence_numbers_of_irregular_reports() {
    let mut chance = Chance(2);
    let (mut t, mut bad, mut lost) = (0.0, false, 0);
    let mut packets = Vec::new();
    for seq in 0..20_000u64 {
        t += 0.05 + 0.2 * chance.uniform();
        // Mean stay of 5 in the bad state, 45 in the good one.
        bad = if bad { chance.uniform() >= 0.2 } else { chance.uniform() < 1.0 / 45.0 };
        // The ends must arrive: losses outside of them cannot be counted.
        if bad && seq != 0 && seq != 19_999 {
            lost += 1;
        } else {
            packets.push(Packet { seq: Some(seq), ..position(t, 0.0, 0.0) });
        }
    }
    let loss = survey(&one(packets), &Anchors::default()).loss.expect("sequence numbers");
    assert_eq!((loss.basis, loss.lost, loss.expected), (Basis::Sequence, lost, 20_000));
    assert!(loss.is_bursty());
    // The mean of about 400 geometric bursts of mean 5 errs by √20/√400 = 0.22.
    assert!((loss.mean_burst().expect("bursts") - 5.0).abs() < 3.0 * 0.22, "{loss:?}");
}

#[test]
fn counters_of_each_anchor_and_of_the_radio_are_told_apart() {
    let anchors = room(true);
    let with_seq = |per_anchor: bool| -> Vec<Packet> {
        let mut all = ranges(&anchors, 0.1, 0.0, 100, &mut Chance(3));
        for (i, p) in all.iter_mut().enumerate() {
            p.seq = Some(if per_anchor { i as u64 / 4 } else { i as u64 });
        }
        all.remove(200);
        all
    };
    for per_anchor in [true, false] {
        let loss = survey(&one(with_seq(per_anchor)), &anchors).loss.expect("sequence numbers");
        assert_eq!((loss.lost, loss.expected), (1, 400), "one counter per anchor: {per_anchor}");
    }
}

#[test]
fn loss_of_a_source_with_two_rates_cannot_be_told() {
    // A ship reports every 2 s while it turns and every 10 s on its way.
    let (mut t, mut packets) = (0.0, Vec::new());
    for i in 0..400 {
        t += if i % 40 < 30 { 2.0 } else { 10.0 };
        packets.push(position(t, t, 0.0));
    }
    let survey = survey(&one(packets), &Anchors::default());
    assert_eq!((survey.loss, survey.targets[0].period_s), (None, None));
    assert!(survey.findings.iter().any(|f| f.text.contains("no fixed rate")));
}

#[test]
fn silence_is_found_with_its_place() {
    let packets: Vec<Packet> =
        (0..600).filter(|i| !(200..234).contains(i)).map(|i| position(0.1 * i as f64, 0.0, 0.0)).collect();
    let survey = survey(&one(packets), &Anchors::default());
    let silences = survey.targets[0].silences;
    assert_eq!((silences.count, silences.missing), (1, 34));
    assert!((silences.longest_s - 3.5).abs() < 1e-9 && (silences.longest_at_s - 19.9).abs() < 1e-9);
    assert!(survey.findings.iter().any(|f| f.text.contains("longest 3.5 s at t = 19.9 s, target `T1`")), "{survey:?}");
}

#[test]
fn repeats_and_delays_are_counted() {
    let mut packets: Vec<Packet> = (0..50)
        .map(|i| Packet {
            received_s: Some(0.1 * i as f64 + 0.02),
            arrival: None,
            ..position(0.1 * i as f64, i as f64, 0.0)
        })
        .collect();
    packets[10].received_s = Some(1.55);
    let again = packets[20].clone();
    packets.insert(21, again);
    packets.swap(30, 31);
    let survey = survey(&one(packets), &Anchors::default());
    let late = survey.targets[0].late;
    assert_eq!(survey.duplicates, 1);
    // Packet 10 comes after 11 … 15; the swap is one of rows, not of receptions.
    assert_eq!((late.disordered, late.overtaken), (1, 1));
    assert!((late.worst_s - 0.5).abs() < 1e-9, "{late:?}");
    assert_eq!(late.needed_late_s(), 0.5);
    assert!(survey.findings.iter().any(|f| f.text.contains("needs `late_s = 0.5`")), "{:?}", survey.findings);
    assert!((late.delay_s.expect("reception times").p50 - 0.02).abs() < 1e-9);
}

#[test]
fn noise_of_a_manoeuvring_target_at_uneven_times_is_found() {
    let mut chance = Chance(4);
    let sd = 0.2;
    let (mut t, mut packets) = (0.0, Vec::new());
    for _ in 0..4000 {
        t += 0.08 + 0.04 * chance.uniform();
        let (x, y) = (5.0 * (0.3 * t).cos(), 5.0 * (0.3 * t).sin());
        packets.push(position(t, x + sd * chance.normal(), y + sd * chance.normal()));
    }
    // Gross errors must not matter.
    for i in (50..4000).step_by(400) {
        if let Content::Position([Some(x), ..]) = &mut packets[i].content {
            *x += 30.0;
        }
    }
    let survey = survey(&one(packets), &Anchors::default());
    let kind = &survey.kinds[0];
    let found = kind.quick_sd.expect("enough rows");
    // The median of n magnitudes errs by 1.17/√n of itself if independent; neighbours share three of four samples, so n/4 = 1000 count.
    assert!((found / sd - 1.0).abs() < 3.0 * 1.17 / 1000f64.sqrt(), "{found}");
    assert_eq!(kind.outliers, 10);
    assert!((kind.worst_outlier.as_ref().expect("outliers").off - 30.0).abs() < 5.0 * sd);
    // The speed is 1.5 m/s on both axes; at the span that tells motion from noise the slope still errs by a quarter.
    let speed = kind.speed.expect("enough rows");
    assert!((1.2..2.2).contains(&speed), "{speed}");
}

#[test]
fn acceleration_density_of_its_own_model_is_found_within_a_factor_of_two() {
    let mut chance = Chance(5);
    let (dt, psd, sd) = (0.1_f64, 0.5_f64, 0.05);
    let mut state = [[0.0_f64; 2]; 2];
    let mut packets = Vec::new();
    for i in 0..20_000 {
        for [x, v] in &mut state {
            // Exact discretisation: cov = q [dt³/3 dt²/2; dt²/2 dt].
            let (a, b) = (chance.normal(), chance.normal());
            let dv = (psd * dt).sqrt() * a;
            *x += *v * dt + 0.5 * dt * dv + (psd * dt.powi(3) / 12.0).sqrt() * b;
            *v += dv;
        }
        packets.push(position(dt * i as f64, state[0][0] + sd * chance.normal(), state[1][0] + sd * chance.normal()));
    }
    let found = survey(&one(packets), &Anchors::default()).kinds[0].psd.expect("enough rows");
    // The 90 % quantile of thousands of bends errs by a few percent; the noise, a tenth of the bend's variance at the span, by more.
    assert!((0.25..1.0).contains(&found), "{found}");
}

#[test]
fn ranges_with_biases_miss_a_common_point_by_more_than_they_jitter() {
    let anchors = room(false);
    let survey = |bias| survey(&one(ranges(&anchors, 0.05, bias, 2000, &mut Chance(6))), &anchors);
    let unbiased = survey(0.0);
    let kind = &unbiased.kinds[0];
    // The anchors hang at 2.5 m, the target is at 1 m, a multiple of the quarter metres tried.
    assert!((kind.fit_height_m.expect("clearly better than 2.5 m") - 1.0).abs() <= 0.25);
    let fit = kind.fit_sd.expect("four anchors");
    // The median of 1000 magnitudes errs by 1.17/√1000; a height that is off by up to a quarter adds the rest.
    assert!((0.045..0.06).contains(&fit), "{fit}");
    assert!((kind.quick_sd.expect("enough rows") - 0.05).abs() < 0.005);
    let fit = survey(0.3).kinds[0].fit_sd.expect("four anchors");
    // ±0.3 m of opposite corners cannot be explained by a shift. At the true point the two degrees of freedom left see
    // √(4·0.3²/2) = 0.42 m, which counts as 0.42/0.83 as if it were the median of noise; the best point sees less.
    assert!((0.25..0.52).contains(&fit), "{fit}");
    assert!(survey(0.3).findings.iter().any(|f| f.text.contains("anchors have biases")));
}

#[test]
fn proposal_for_positions_is_a_kalman_filter_with_the_axes_of_the_data() {
    let mut chance = Chance(7);
    let flat: Vec<Packet> = (0..200)
        .map(|i| packet(0.1 * i as f64, Content::Position([Some(chance.normal()), Some(chance.normal()), Some(0.0)])))
        .collect();
    let climbing: Vec<Packet> = (0..200)
        .map(|i| packet(0.1 * i as f64, Content::Position([Some(chance.normal()), Some(1.0), Some(0.1 * i as f64)])))
        .collect();
    for (packets, axes) in [(flat, 2), (climbing, 3)] {
        let text = propose(&survey(&one(packets), &Anchors::default()), &circumstances()).expect("positions").text;
        let spec = parses(&text);
        let spec::ModelSpec::Kinematic(model) = &spec.model else { panic!("{text}") };
        assert_eq!((model.order, model.axes), (2, axes), "{text}");
        assert_eq!(spec.estimator, spec::EstimatorSpec::Kalman);
    }
}

#[test]
fn proposal_for_ranges_settles_the_height_only_where_the_anchors_do() {
    for (spread, axes) in [(true, 3), (false, 2)] {
        let anchors = room(spread);
        let packets = ranges(&anchors, 0.1, 0.0, 500, &mut Chance(8));
        let text = propose(&survey(&one(packets), &anchors), &circumstances()).expect("ranges").text;
        let spec = parses(&text);
        let spec::ModelSpec::Kinematic(model) = &spec.model else { panic!("{text}") };
        assert_eq!(model.axes, axes, "{text}");
        assert_eq!(spec.sensors[0].height_m, (axes == 2).then_some(1.0), "{text}");
        assert_eq!(spec.estimator, spec::EstimatorSpec::Ekf);
    }
}

/// Six anchors about a hall, all heights 0, and the distances to them along a walk, twice a second.
fn hall() -> (Anchors, Vec<(f64, Vec<f64>)>) {
    let mut anchors = Anchors::default();
    let places = [[0.0, 0.0], [12.0, 0.0], [12.0, 10.0], [0.0, 10.0], [6.0, 0.5], [6.0, 9.5]];
    for (i, [x, y]) in places.into_iter().enumerate() {
        anchors.add(&format!("A{i}"), [x, y, 0.0]);
    }
    let walk = (0..400).map(|i| {
        let t = 0.5 * i as f64;
        let (x, y) = (6.0 + 4.5 * (0.1 * t).cos(), 5.0 + 3.5 * (0.13 * t).sin());
        (t, places.iter().map(|p| (x - p[0]).hypot(y - p[1])).collect())
    });
    (anchors, walk.collect())
}

#[test]
fn ranges_that_are_all_too_long_lose_what_they_have_in_common() {
    let (anchors, walk) = hall();
    for bias in [0.0, 1.5] {
        let mut chance = Chance(11);
        let mut packets = Vec::new();
        for (t, distances) in &walk {
            for (id, d) in distances.iter().enumerate() {
                let value_m = d + bias + 0.2 * chance.normal();
                packets.push(packet(*t, Content::Range { anchor: id as AnchorId, value_m }));
            }
        }
        let survey = survey(&one(packets), &anchors);
        let found = survey.kinds[0].fit_bias_m;
        let text = propose(&survey, &circumstances()).expect("ranges").text;
        let spec = parses(&text);
        if bias == 0.0 {
            assert_eq!((found, spec.sensors[0].bias.len()), (None, 0), "{text}");
        } else {
            // The median of some 200 values with a deviation of at most three times a range's: 0.6 · 1.25/√200 = 0.05.
            assert!((found.expect("a bias") - bias).abs() < 0.15, "{found:?}");
            assert_eq!(spec.sensors[0].bias.len(), 6, "{text}");
        }
        assert!(matches!(spec.sensors[0].robust, spec::Robust::Huber(_)), "{text}");
        assert_eq!(spec.sensors[0].height_m, None, "a plan has no heights: {text}");
    }
}

#[test]
fn strengths_tell_their_law_and_targets_start_among_the_anchors() {
    let (anchors, walk) = hall();
    let mut chance = Chance(12);
    let mut packets = Vec::new();
    for (t, distances) in &walk {
        for (id, d) in distances.iter().enumerate() {
            let value_dbm = -45.0 - 25.0 * d.log10() + 3.0 * chance.normal();
            packets.push(packet(*t, Content::Rssi { anchor: id as AnchorId, value_dbm }));
        }
    }
    let survey = survey(&one(packets), &anchors);
    let law = survey.kinds[0].law.expect("a law");
    // The grid's exponents are half apart, and places are taken well below the anchors, which makes the law steeper.
    assert!(law.fitted && (2.0..=3.0).contains(&law.exponent), "{law:?}");
    // At the usual distance of 7 m the law says −66 dBm; noise of 3 dB averages out, the grid and the height remain.
    let at_7_m = law.at_1m_dbm - 10.0 * law.exponent * (7.0_f64.powi(2) + 3.0_f64.powi(2)).sqrt().log10();
    assert!((at_7_m + 66.1).abs() < 2.5, "{law:?} {at_7_m}");
    let spec = parses(&propose(&survey, &circumstances()).expect("strengths").text);
    let spec::ModelSpec::Kinematic(model) = &spec.model else { panic!("{spec:?}") };
    let prior = model.prior.as_ref().expect("a start");
    assert_eq!((model.axes, &prior.mean[..2]), (2, &[6.0, 5.0][..]));
    // Few moments: free space.
    let few = (0..3).map(|id| packet(0.0, Content::Rssi { anchor: id, value_dbm: -60.0 })).collect();
    let survey = super::survey(&one(few), &anchors);
    assert_eq!(survey.kinds[0].law.map(|l| (l.exponent, l.fitted)), Some((2.0, false)));
    parses(&propose(&survey, &circumstances()).expect("strengths").text);
}

#[test]
fn differences_and_bearings_tell_their_noise_from_the_places_they_fit() {
    let (anchors, walk) = hall();
    let mut chance = Chance(13);
    let (mut differences, mut bearings) = (Vec::new(), Vec::new());
    for (t, distances) in &walk {
        let times: Vec<f64> = distances.iter().map(|d| d + 0.5 * chance.normal()).collect();
        let (x, y) = (6.0 + 4.5 * (0.1 * t).cos(), 5.0 + 3.5 * (0.13 * t).sin());
        for id in 0..anchors.len() as AnchorId {
            let value_m = times[id as usize] - times[0];
            if id > 0 {
                differences.push(packet(*t, Content::Tdoa { anchor: id, reference: 0, value_m }));
            }
            let p = anchors.position_m(id);
            let value_rad = (y - p[1]).atan2(x - p[0]) + 0.1 * chance.normal();
            bearings.push(packet(*t, Content::Bearing { anchor: id, value_rad }));
        }
    }
    // The reference's part of a difference's variance is common to all and moves the place: at least the own half is seen.
    for (packets, low, high) in [(differences, 0.4, 0.75), (bearings, 0.09, 0.11)] {
        let survey = survey(&one(packets), &anchors);
        let found = survey.kinds[0].fit_sd.expect("enough moments");
        assert!((low..high).contains(&found), "{found}");
        let speed = survey.kinds[0].speed.expect("moving places");
        assert!((0.2..10.0).contains(&speed), "{speed}");
        let spec = parses(&propose(&survey, &circumstances()).expect("a sensor").text);
        assert!((low * 0.9..high * 1.1).contains(&spec.sensors[0].sd), "{spec:?}");
    }
}

#[test]
fn proposal_survives_odd_names_and_few_rows() {
    let odd = Circumstances { data: "a\nmodel = 1.csv", geodetic: true, anchors: Some("my \"anchors\"\\\n.csv") };
    let text =
        propose(&survey(&one(vec![position(0.0, 1.0, 2.0)]), &Anchors::default()), &odd).expect("positions").text;
    assert_eq!(parses(&text).anchors.as_deref(), Some("my \"anchors\"\\\n.csv"));
}

#[test]
fn proposal_without_a_sensor_says_why() {
    let anchors = room(true);
    let rssi = |t| packet(t, Content::Rssi { anchor: 0, value_dbm: -60.0 });
    let with_ranges = [ranges(&anchors, 0.1, 0.0, 50, &mut Chance(9)), vec![rssi(0.5)]].concat();
    let text = propose(&survey(&one(with_ranges), &anchors), &circumstances()).expect("ranges beside rssi").text;
    assert!(text.contains("1 rows of kind `rssi` are left out"), "{text}");
    let only = propose(&survey(&one(vec![rssi(0.0), rssi(1.0)]), &anchors), &circumstances());
    assert_eq!(only, Err(ProposeError::FewAnchors { kind: "rssi", anchors: 1, least: 3 }));
    let linear = packet(0.0, Content::Linear { z: vec![Some(1.0)], u: vec![] });
    let linear = Packet { k: Some(0), ..linear };
    assert_eq!(propose(&survey(&one(vec![linear]), &anchors), &circumstances()), Err(ProposeError::Linear));
    assert_eq!(propose(&survey(&[], &anchors), &circumstances()), Err(ProposeError::Empty));
}

#[test]
fn lost_rows_of_a_linear_run_are_counted_whether_absent_or_empty() {
    let row =
        |k: u64, z: Option<f64>| Packet { k: Some(k), ..packet(k as f64, Content::Linear { z: vec![z], u: vec![] }) };
    let rows = vec![row(0, None), row(1, Some(1.0)), row(3, Some(1.0)), row(4, None), row(5, None)];
    let loss = survey(&one(rows), &Anchors::default()).loss.expect("rows");
    assert_eq!((loss.expected, loss.lost, loss.bursts[0], loss.bursts[1]), (6, 4, 2, 1));
}

#[test]
fn anchors_on_a_line_are_a_problem() {
    let mut anchors = Anchors::default();
    for (i, x) in [0.0, 5.0, 9.0, 14.0].into_iter().enumerate() {
        anchors.add(&format!("A{i}"), [x, 0.01 * x, 2.0]);
    }
    let survey = survey(&one(ranges(&anchors, 0.1, 0.0, 50, &mut Chance(10))), &anchors);
    assert_eq!(survey.findings[0].severity, Severity::Problem, "{:?}", survey.findings);
    assert!(survey.findings[0].text.contains("stand on one line"));
}

#[test]
fn outcomes_are_counted_with_the_bursts_at_both_ends() {
    let loss = Loss::of("xx.x...xxx".chars().map(|c| c == 'x'));
    assert_eq!((loss.basis, loss.expected, loss.lost, loss.longest_burst), (Basis::Outcomes, 10, 6, 3));
    assert_eq!(loss.bursts, [1, 1, 1, 0, 0, 0, 0, 0, 0, 0]);
    assert_eq!((loss.rate(), loss.mean_burst()), (0.6, Some(2.0)));
    let none = Loss::of([false; 4]);
    assert_eq!((none.expected, none.rate(), none.mean_burst(), none.longest_burst), (4, 0.0, None, 0));
    assert_eq!((Loss::of([]).expected, Loss::of([]).rate(), Loss::of([true; 3]).mean_burst()), (0, 0.0, Some(3.0)));
}
