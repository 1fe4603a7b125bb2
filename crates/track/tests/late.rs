//! Packets that come late, in any order: within `late_s` they are used as if they had come in time, beyond it they are counted.

mod support;

use fixtrail_track::anchors::Anchors;
use fixtrail_track::link::LinkReport;
use fixtrail_track::packet::{Content, Kind, Packet};
use fixtrail_track::pipeline::{Pipeline, Until, track};
use fixtrail_track::registry::layout;
use fixtrail_track::spec::{
    Align, EstimatorSpec, KinematicSpec, LinkSpec, ModeSpec, ModelSpec, Receiver, Robust, SensorSpec, Span, Spec,
};
use fixtrail_track::target::TargetPackets;
use fixtrail_track::trackers::LaggedMode;
use fixtrail_track::trail::Trail;
use std::collections::BTreeMap;
use support::oracle::random::{Family, Random, run};
use support::{Declared, bits, fms, linear, packet, packets, spec_of};

/// A spec, its anchors, and the packets of a run in order.
struct Case {
    spec: Spec,
    anchors: Anchors,
    packets: Vec<Packet>,
}

impl Case {
    fn late(&self, late_s: Option<f64>) -> Spec {
        let link = LinkSpec { receiver: Receiver::Stamped { late_s }, ..LinkSpec::default() };
        Spec { link, ..self.spec.clone() }
    }

    fn pipeline(&self, late_s: Option<f64>) -> Pipeline {
        Pipeline::new(&self.late(late_s), &self.anchors, LaggedMode::Both).expect("a spec of which there is a tracker")
    }

    fn trail(&self) -> Trail {
        Trail::new(layout(&self.spec).n(), true)
    }

    /// The trail of packets in the order given; the most instants that waited.
    fn arriving(&self, late_s: f64, packets: &[Packet]) -> (Trail, LinkReport, usize) {
        let (mut pipeline, mut trail, mut most) = (self.pipeline(Some(late_s)), self.trail(), 0);
        for packet in packets {
            pipeline.push(packet.clone(), &mut trail).expect("a good step");
            most = most.max(pipeline.link().waiting().len());
        }
        pipeline.finish(&mut trail).expect("a good end");
        (trail, pipeline.link().report(), most)
    }

    /// The trail of packets in order, on a link that never waits.
    fn in_order(&self, packets: &[Packet]) -> Trail {
        let packets = TargetPackets { target: None, packets: packets.to_vec() };
        track(&self.late(None), &self.anchors, &packets, LaggedMode::Both).expect("a good run").trail
    }
}

fn smoothers_and_filters() -> Vec<EstimatorSpec> {
    vec![
        EstimatorSpec::Kalman,
        EstimatorSpec::Ekf,
        EstimatorSpec::Rts,
        EstimatorSpec::FixedLagKalman { lag: Span::Instants(3) },
        EstimatorSpec::Ufir { window: Span::Instants(6) },
        fms(7, 2, Align::Filtered),
        fms(7, 2, Align::Predicted),
    ]
}

fn linear_cases(rng: &mut Random, len: usize) -> Vec<Case> {
    let mut cases = Vec::new();
    for declared in [Declared::Invariant, Declared::Sequence] {
        for estimator in smoothers_and_filters() {
            let varying = declared == Declared::Sequence;
            let prior = rng.chance(0.5);
            let run = run(rng, &Family { len, n: 3, q: 2, p: 2, varying, prior, loss: 0.3, singular: false });
            let spec = spec_of(ModelSpec::Linear(linear(&run, declared)), estimator);
            cases.push(Case { spec, anchors: Anchors::default(), packets: packets(&run).packets });
        }
    }
    cases
}

fn at(t_s: f64, content: Content, line: usize) -> Packet {
    Packet::new(t_s, content, line as u64)
}

/// Positions or ranges of a walk, a fifth of them lost; the instants of the ranges have up to three packets.
fn kinematic_cases(rng: &mut Random, len: usize) -> Vec<Case> {
    let sites = [[0.0, 0.0, 0.0], [30.0, 0.0, 0.0], [0.0, 30.0, 0.0]];
    let mut anchors = Anchors::default();
    sites.iter().enumerate().for_each(|(i, site)| assert!(anchors.add(&format!("a{i}"), *site).is_some()));
    let mut cases = Vec::new();
    let mode = |psd, mean_s| Some(ModeSpec { noise: [psd, psd, 0.0], turn_noise: 0.0, mean_s });
    let imm = EstimatorSpec::Imm { modes: [mode(0.05, 1.0), mode(5.0, 0.5), None, None] };
    for kind in [Kind::Position, Kind::Range] {
        for estimator in smoothers_and_filters().into_iter().chain([imm]) {
            let is_linear = matches!(estimator, EstimatorSpec::Kalman | EstimatorSpec::Ufir { .. });
            if is_linear && kind == Kind::Range {
                continue;
            }
            let mut packets = Vec::new();
            for k in 0..len {
                let t_s = 0.1 * k as f64 + if k % 3 == 1 { 0.013 } else { 0.0 };
                let (x, y) = (12.0 + 2.0 * t_s, 15.0 - t_s);
                match kind {
                    Kind::Position if !rng.chance(0.2) => {
                        let coordinate = [Some(x + 0.1 * rng.normal()), Some(y + 0.1 * rng.normal()), None];
                        packets.push(at(t_s, Content::Position(coordinate), packets.len() + 1));
                    }
                    Kind::Range => {
                        for (anchor, site) in (0..).zip(&sites) {
                            if !rng.chance(0.2) {
                                let value_m = f64::hypot(x - site[0], y - site[1]) + 0.1 * rng.normal();
                                packets.push(at(t_s, Content::Range { anchor, value_m }, packets.len() + 1));
                            }
                        }
                    }
                    _ => {}
                }
            }
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
            let spec = Spec { sensors: vec![sensor], ..spec_of(ModelSpec::Kinematic(model), estimator) };
            cases.push(Case { spec, anchors: anchors.clone(), packets });
        }
    }
    cases
}

fn all_cases(seed: u128, len: usize) -> Vec<Case> {
    let mut rng = Random::new(seed);
    let mut cases = linear_cases(&mut rng, len);
    cases.extend(kinematic_cases(&mut rng, len));
    cases
}

/// Seconds between instants on average.
fn spacing(case: &Case) -> f64 {
    if matches!(case.spec.model, ModelSpec::Linear(_)) { 1.0 } else { 0.1 }
}

/// The packets in the order in which they come when each takes up to `most_s`, some exactly that, and some come twice.
fn shuffled(rng: &mut Random, packets: &[Packet], most_s: f64, copies: f64) -> Vec<Packet> {
    let mut flights: Vec<(f64, usize, Packet)> = Vec::new();
    let delay = |rng: &mut Random| match rng.count(0, 4) {
        0 => 0.0,
        1 => most_s,
        _ => most_s * rng.uniform(),
    };
    for packet in packets {
        let times = if rng.chance(copies) { 2 } else { 1 };
        for _ in 0..times {
            let came_s = packet.t_s + delay(rng);
            // Of packets that come together the later sensed may be first.
            flights.push((came_s, rng.count(0, 1000), packet.clone()));
        }
    }
    flights.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    flights.into_iter().map(|(_, _, packet)| packet).collect()
}

/// What a link of `late_s` takes of arriving packets: those used, in order, and those that came too late.
fn sorted_out(arriving: &[Packet], late_s: f64) -> (Vec<Packet>, Vec<Packet>, usize) {
    let (mut newest, mut copies) = (f64::NEG_INFINITY, 0);
    let (mut used, mut late): (Vec<Packet>, Vec<Packet>) = (Vec::new(), Vec::new());
    for packet in arriving {
        if newest - packet.t_s > late_s + 1e-9 {
            late.push(packet.clone());
        } else if used.contains(packet) {
            copies += 1;
        } else {
            newest = newest.max(packet.t_s);
            used.push(packet.clone());
        }
    }
    used.sort_by_key(|packet| packet.line);
    (used, late, copies)
}

#[test]
fn packets_at_most_late_s_late_give_the_trail_of_packets_in_order_to_the_bit() {
    let (mut moved, mut doubled) = (0, 0);
    for (seed, case) in (0..4).flat_map(|seed| all_cases(seed, 40).into_iter().map(move |case| (seed, case))) {
        let mut rng = Random::new(100 + seed);
        let late_s = spacing(&case) * [0.7, 2.0, 5.0, 11.0][seed as usize];
        let arriving = shuffled(&mut rng, &case.packets, late_s, 0.2);
        let (trail, report, most) = case.arriving(late_s, &arriving);
        let what = format!("seed {seed}, {:?}", case.spec.estimator);
        assert!(bits(&trail) == bits(&case.in_order(&case.packets)), "{what}");
        let copies = (arriving.len() - case.packets.len()) as u64;
        assert_eq!((report.too_late, report.first_too_late, report.copies), (0, None, copies), "{what}");
        // Instants from t − late_s to t, and where two differ by less than the spacing one more.
        let mut times: Vec<f64> = case.packets.iter().map(|p| p.t_s).collect();
        times.dedup();
        let fit = |t: f64| times.iter().filter(|s| **s <= t && t - **s <= late_s + 1e-9).count();
        let room = times.iter().map(|t| fit(*t)).max().unwrap_or(0);
        assert!(most <= room, "{what}: {most} wait, room for {room}");
        moved += arriving.windows(2).filter(|pair| pair[0].line > pair[1].line).count();
        doubled += copies;
    }
    // Otherwise nothing was tested.
    assert!(moved > 1000 && doubled > 500, "{moved} {doubled}");
}

#[test]
fn packets_beyond_late_s_are_counted_and_leave_the_trail_of_the_data_without_them() {
    let mut lost = 0;
    for (seed, case) in (10..13).flat_map(|seed| all_cases(seed, 40).into_iter().map(move |case| (seed, case))) {
        let mut rng = Random::new(100 + seed);
        let late_s = spacing(&case) * [0.0, 1.3, 3.0][seed as usize - 10];
        let arriving = shuffled(&mut rng, &case.packets, late_s + 3.0 * spacing(&case), 0.2);
        let (used, late, copies) = sorted_out(&arriving, late_s);
        let (trail, report, _) = case.arriving(late_s, &arriving);
        let what = format!("seed {seed}, {:?}", case.spec.estimator);
        assert!(bits(&trail) == bits(&case.in_order(&used)), "{what}");
        assert_eq!((report.too_late, report.copies), (late.len() as u64, copies as u64), "{what}");
        assert_eq!(report.first_too_late, late.first().map(|p| p.line), "{what}");
        lost += late.len();
    }
    assert!(lost > 500, "{lost}");
}

#[test]
fn a_packet_exactly_late_s_late_is_used_and_one_a_microsecond_later_is_not() {
    let case = &mut kinematic_cases(&mut Random::new(3), 40)[0];
    // Tenths of a second are no binary fractions: 1.1 − 0.8 is more than 0.3, 0.4 − 0.1 is more than 0.3 too.
    for packet in &mut case.packets {
        packet.t_s = (packet.t_s * 10.0).round() / 10.0;
    }
    for i in 0..case.packets.len() {
        let late_s = 0.3;
        let mut arriving = case.packets.clone();
        let packet = arriving.remove(i);
        let by = |late_s: f64| arriving.iter().filter(|p| p.t_s < packet.t_s + late_s + 1e-7).count();
        let (last, place) = (case.packets.last().expect("packets").t_s, by(late_s));
        arriving.insert(place, packet.clone());
        let (trail, report, _) = case.arriving(late_s, &arriving);
        assert_eq!(report.too_late, 0, "packet {i}");
        assert!(bits(&trail) == bits(&case.in_order(&case.packets)), "packet {i}");
        // The packet before is exactly 0.3 s younger and was in time; a microsecond more, and it is not.
        if arriving[place.saturating_sub(1)].t_s > packet.t_s + 0.25 && last > packet.t_s + 0.31 {
            let (_, report, _) = case.arriving(late_s - 1e-6, &arriving);
            assert_eq!((report.too_late, report.first_too_late), (1, Some(packet.line)), "packet {i}");
        }
    }
}

#[test]
fn what_is_told_now_is_what_a_fresh_run_on_the_data_so_far_says() {
    for case in all_cases(20, 22) {
        let mut rng = Random::new(120);
        let late_s = 4.0 * spacing(&case);
        let arriving = shuffled(&mut rng, &case.packets, 5.0 * spacing(&case), 0.2);
        let what = format!("{:?}", case.spec.estimator);
        let has_tail = case.spec.estimator.has_smoother();
        let (mut pipeline, mut settled) = (case.pipeline(Some(late_s)), case.trail());
        for (i, packet) in arriving.iter().enumerate() {
            pipeline.push(packet.clone(), &mut settled).expect("a good step");
            let mut told = settled.clone();
            pipeline.now(Until::Newest, &mut told).expect("a good step");
            let (used, ..) = sorted_out(&arriving[..=i], late_s);
            let (mut fresh, mut expected) = (case.pipeline(None), case.trail());
            for packet in used {
                fresh.push(packet, &mut expected).expect("a good step");
            }
            match has_tail {
                // A smoother owes fixes that only the end of the run makes due.
                true => fresh.now(Until::Newest, &mut expected).expect("a good step"),
                false => fresh.finish(&mut expected).expect("a good end"),
            }
            assert!(bits(&told) == bits(&expected), "{what}, packet {i}");
            assert!(!told.is_empty() || has_tail, "{what}, packet {i}");
        }
        pipeline.finish(&mut settled).expect("a good end");
        let (undisturbed, ..) = case.arriving(late_s, &arriving);
        assert!(bits(&settled) == bits(&undisturbed), "{what}");
    }
}

#[test]
fn what_is_told_until_an_instant_without_data_is_what_lost_rows_give() {
    let mut rng = Random::new(30);
    for mut case in linear_cases(&mut rng, 20) {
        let (mut pipeline, mut told) = (case.pipeline(Some(3.0)), case.trail());
        for packet in shuffled(&mut rng, &case.packets, 3.0, 0.0) {
            pipeline.push(packet, &mut told).expect("a good step");
        }
        pipeline.now(Until::Row(23), &mut told).expect("a good step");
        case.packets.push(packet(23, &[None, None], &[0.0, 0.0]));
        let (mut fresh, mut expected) = (case.pipeline(None), case.trail());
        for packet in &case.packets {
            fresh.push(packet.clone(), &mut expected).expect("a good step");
        }
        fresh.now(Until::Newest, &mut expected).expect("a good step");
        // The last row has a time, the gap before it has none: a linear run by its index has no use for either.
        told.t_s.fill(None);
        expected.t_s.fill(None);
        for lagged in [&mut told, &mut expected].into_iter().filter_map(|t| t.lagged.as_mut()) {
            lagged.t_s.fill(None);
        }
        assert!(bits(&told) == bits(&expected), "{:?}", case.spec.estimator);
    }
}
