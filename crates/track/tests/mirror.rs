//! Anchors in one line see a target and its mirror image alike: no side is made up, and the right one is taken once something tells.

use fixtrail_track::anchors::Anchors;
use fixtrail_track::fix::Status;
use fixtrail_track::mat::Mat;
use fixtrail_track::packet::{Content, Kind, Packet};
use fixtrail_track::pipeline::track;
use fixtrail_track::spec::{
    Align, EstimatorSpec, KinematicSpec, LinkSpec, ModeSpec, ModelSpec, Prior, Robust, SensorSpec, Span, Spec,
};
use fixtrail_track::target::TargetPackets;
use fixtrail_track::trackers::LaggedMode;
use fixtrail_track::trail::Trail;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use std::collections::BTreeMap;

/// Three anchors on the line y = x / 2, the fourth 8 m beside it.
const SITES: [[f64; 3]; 4] = [[-10.0, -5.0, 2.0], [0.0, 0.0, 3.0], [12.0, 6.0, 2.5], [2.0, -8.0, 2.0]];
const BESIDE: usize = 3;
const HEIGHT_M: f64 = 1.0;
const SD_M: f64 = 0.1;
const RATE_HZ: f64 = 5.0;
/// A position is off by more than this many standard deviations once in 1e8 (two axes).
const RARE: f64 = 36.8;

const fn mode(psd: f64, mean_s: f64) -> Option<ModeSpec> {
    Some(ModeSpec { noise: [psd, psd, 0.0], turn_noise: 0.0, mean_s })
}

const FILTERS: [EstimatorSpec; 2] =
    [EstimatorSpec::Ekf, EstimatorSpec::Imm { modes: [mode(0.02, 20.0), mode(0.5, 2.0), None, None] }];
const FMS: EstimatorSpec =
    EstimatorSpec::Fms { window: Span::Instants(10), lag: Span::Instants(3), align: Align::Filtered };

fn anchors(sites: &[[f64; 3]]) -> Anchors {
    let mut anchors = Anchors::default();
    for (i, site) in sites.iter().enumerate() {
        anchors.add(&format!("a{i}"), *site).unwrap();
    }
    anchors
}

fn packet(t_s: f64, content: Content) -> Packet {
    Packet::new(t_s, content, 1)
}

/// Where the target is: a bent walk on one side of the line, 4 m and more from it; mirrored with `side` = −1.
fn place(t_s: f64, side: f64) -> [f64; 2] {
    let (along, across) = (-5.0 + 0.5 * t_s, side * (6.0 + 2.0 * (0.25 * t_s).sin()));
    let root = 5f64.sqrt();
    [(2.0 * along - across) / root, (along + 2.0 * across) / root]
}

/// Ranges of the walk to the anchors that `heard` says at each instant.
fn walk(sites: &[[f64; 3]], side: f64, seconds: f64, seed: u128, heard: impl Fn(f64, usize) -> bool) -> Vec<Packet> {
    let mut rng = Pcg64::new(seed, 1);
    let mut out = Vec::new();
    for k in 0..(seconds * RATE_HZ) as u32 {
        let t_s = f64::from(k) / RATE_HZ;
        let x = place(t_s, side);
        for (i, site) in sites.iter().enumerate().filter(|(i, _)| heard(t_s, *i)) {
            let distance = (x[0] - site[0]).hypot(x[1] - site[1]).hypot(HEIGHT_M - site[2]);
            let noise: f64 = StandardNormal.sample(&mut rng);
            out.push(packet(t_s, Content::Range { anchor: i as u32, value_m: distance + SD_M * noise }));
        }
    }
    out
}

fn spec(estimator: EstimatorSpec, robust: Robust, prior: Option<Prior>) -> Spec {
    let sensor = SensorSpec {
        kind: Kind::Range,
        sd: SD_M,
        path_loss: None,
        drift: None,
        bias: BTreeMap::new(),
        height_m: Some(HEIGHT_M),
        latency_s: 0.0,
        robust,
    };
    Spec {
        model: ModelSpec::Kinematic(KinematicSpec { order: 2, axes: 2, noise: vec![0.1, 0.1], prior }),
        sensors: vec![sensor],
        estimator,
        link: LinkSpec::default(),
        columns: BTreeMap::new(),
        anchors: None,
        side_m: None,
    }
}

fn run(spec: &Spec, sites: &[[f64; 3]], packets: Vec<Packet>) -> Trail {
    track(spec, &anchors(sites), &TargetPackets { target: None, packets }, LaggedMode::Own).unwrap().trail
}

/// Squared error of a row's position over its covariance; `None` of an unobservable row.
fn misses(trail: &Trail, row: usize, side: f64) -> Option<f64> {
    let mean = trail.mean(row)?;
    let cov = trail.cov(row)?;
    let x = place(trail.t_s[row].unwrap(), side);
    let e = [mean[0] - x[0], mean[1] - x[1]];
    let (a, b, c) = (cov[0], cov[1], cov[4]);
    Some((c * e[0] * e[0] - 2.0 * b * e[0] * e[1] + a * e[1] * e[1]) / (a * c - b * b))
}

#[test]
fn anchors_in_line_alone_never_tell_the_side() {
    // Anchors beside the line by millimetres, where noise is 10 cm: 600 ranges tell the sides apart by less than 1 in the sum of squares.
    let nearly = [[-10.0, -5.002, 2.0], [0.0, 0.002, 3.0], [12.0, 5.999, 2.5]];
    let smoothers = [EstimatorSpec::Rts, EstimatorSpec::FixedLagKalman { lag: Span::Instants(7) }, FMS];
    for estimator in FILTERS.into_iter().chain(smoothers) {
        for robust in [Robust::None, Robust::Redescending(4.685)] {
            if estimator == FMS && robust != Robust::None {
                continue;
            }
            for sites in [&SITES[..3], &nearly, &SITES[..2]] {
                let trail = run(&spec(estimator, robust, None), sites, walk(sites, 1.0, 40.0, 1, |_, _| true));
                let what = format!("{estimator:?}, {robust:?}, {} anchors", sites.len());
                assert_eq!(trail.len(), 200, "{what}");
                assert!(trail.status.iter().all(|s| *s == Status::Unobservable), "{what}: {:?}", trail.status);
            }
        }
    }
}

#[test]
fn a_point_beside_the_line_tells_the_side() {
    let sites = &SITES[..3];
    for side in [1.0, -1.0] {
        for estimator in FILTERS.into_iter().chain([EstimatorSpec::Rts, FMS]) {
            let mut spec = spec(estimator, Robust::None, None);
            // Any point of the right side will do, however far away.
            let [x, y] = place(3.0, 50.0 * side);
            spec.side_m = Some([x, y, 0.0]);
            let trail = run(&spec, sites, walk(sites, side, 40.0, 8, |_, _| true));
            let known = (0..trail.len()).filter_map(|row| misses(&trail, row, side));
            let (count, worst) = known.fold((0, 0.0_f64), |(n, worst), missed| (n + 1, worst.max(missed)));
            assert!(count > 180 && worst < RARE, "{estimator:?}, side {side}: {count} rows, {worst}");
        }
    }
}

#[test]
fn an_anchor_beside_the_line_tells_the_side() {
    const FROM_S: f64 = 30.0;
    // Once anchors 0 to 2 all the time, once two of them: 150 instants are more than a search looks back over.
    for least in [0, 1] {
        for side in [1.0, -1.0] {
            let heard = |t: f64, i: usize| i >= least && (i != BESIDE || t >= FROM_S);
            for estimator in FILTERS.into_iter().chain([FMS]) {
                if estimator == FMS && least > 0 {
                    continue;
                }
                let trail = run(&spec(estimator, Robust::None, None), &SITES, walk(&SITES, side, 40.0, 2, heard));
                let told = trail.t_s.iter().position(|t| t.unwrap() >= FROM_S).unwrap();
                for row in 0..trail.len() {
                    let missed = misses(&trail, row, side);
                    let what = format!("{estimator:?}, side {side}, from anchor {least}, row {row}: {missed:?}");
                    // The mirror image is 10 m off, a hundred standard deviations: the first range tells. A window still holds nine rows of both.
                    match row {
                        row if row < told => assert!(missed.is_none(), "{what}"),
                        row if estimator == FMS && row < told + 10 => {}
                        _ => assert!(missed.is_some_and(|m| m < RARE), "{what}"),
                    }
                }
            }
            // Looking back, a smoother knows the side from the first instant on, or as far back as its search.
            for estimator in [EstimatorSpec::Rts, EstimatorSpec::FixedLagKalman { lag: Span::Instants(7) }] {
                let trail = run(&spec(estimator, Robust::None, None), &SITES, walk(&SITES, side, 40.0, 3, heard));
                assert_eq!(trail.len(), 200);
                for row in 0..200 {
                    let missed = misses(&trail, row, side);
                    assert!(missed.is_some_and(|m| m < RARE), "{estimator:?}, side {side}, row {row}: {missed:?}");
                }
            }
        }
    }
}

#[test]
fn after_the_decision_the_filter_is_that_of_a_known_side() {
    let heard = |t: f64, i: usize| i != BESIDE || t >= 20.0;
    let packets = walk(&SITES, 1.0, 60.0, 4, heard);
    let x = place(0.0, 1.0);
    let prior = Prior { mean: vec![x[0], x[1], 0.0, 0.0], cov: Mat::identity(4), second_moment: None };
    let known = run(&spec(EstimatorSpec::Ekf, Robust::None, Some(prior)), &SITES, packets.clone());
    // A prior tells the side from the first instant on.
    assert!((0..known.len()).all(|row| misses(&known, row, 1.0).is_some_and(|m| m < RARE)));
    let found = run(&spec(EstimatorSpec::Ekf, Robust::None, None), &SITES, packets);
    for row in 200..300 {
        let (a, b) = (known.mean(row).unwrap(), found.mean(row).unwrap());
        // Both have forgotten how they began; what is left is where each was linearised before.
        assert!((a[0] - b[0]).hypot(a[1] - b[1]) < 0.02 * SD_M, "{row}: {a:?} {b:?}");
    }
}

#[test]
fn one_outlier_does_not_decide() {
    // The first range of the anchor beside the line is that of the mirror image.
    for robust in [Robust::Gate(9.0), Robust::Redescending(4.685)] {
        for side in [1.0, -1.0] {
            let mut packets = walk(&SITES, side, 40.0, 5, |t, i| i != BESIDE || t >= 30.0);
            let wrong = walk(&SITES, -side, 40.0, 6, |t, i| i == BESIDE && t >= 30.0).remove(0);
            let first = packets.iter().position(|p| p.content.anchors()[0] == Some(BESIDE as u32)).unwrap();
            packets[first] = wrong;
            let trail = run(&spec(EstimatorSpec::Ekf, robust, None), &SITES, packets);
            for row in 0..trail.len() {
                match misses(&trail, row, side) {
                    Some(missed) => assert!(missed < RARE, "{robust:?}, side {side}, row {row}: {missed}"),
                    None => assert!(row < 160, "{robust:?}, side {side}, row {row} has no estimate"),
                }
            }
        }
    }
}

#[test]
fn a_ceiling_of_anchors_leaves_two_heights_until_one_is_measured() {
    let sites = [[-8.0, -8.0, 3.0], [8.0, -8.0, 3.0], [-8.0, 8.0, 3.0], [8.0, 8.0, 3.0]];
    let altimeter = SensorSpec {
        kind: Kind::Position,
        sd: 0.3,
        path_loss: None,
        drift: None,
        bias: BTreeMap::new(),
        height_m: None,
        latency_s: 0.0,
        robust: Robust::None,
    };
    let mut spec = spec(EstimatorSpec::Ekf, Robust::None, None);
    spec.model = ModelSpec::Kinematic(KinematicSpec { order: 2, axes: 3, noise: vec![0.1; 3], prior: None });
    spec.sensors[0].height_m = None;
    spec.sensors.push(altimeter);
    let mut packets = walk(&sites, 1.0, 40.0, 7, |_, _| true);
    let whole = run(&spec, &sites, packets.clone());
    assert!(whole.status.iter().all(|s| *s == Status::Unobservable), "{:?}", whole.status);
    packets.push(packet(35.0, Content::Position([None, None, Some(1.2)])));
    packets.sort_by(|a, b| a.t_s.total_cmp(&b.t_s));
    let told = run(&spec, &sites, packets);
    for row in 0..told.len() {
        match told.mean(row) {
            None => assert!(told.t_s[row].unwrap() < 35.0),
            Some(mean) => {
                let (at_s, x) = (told.t_s[row].unwrap(), place(told.t_s[row].unwrap(), 1.0));
                assert!(at_s >= 35.0, "{at_s}");
                assert!(
                    (mean[0] - x[0]).hypot(mean[1] - x[1]).hypot(mean[2] - HEIGHT_M) < 1.0,
                    "{row}: {mean:?} {x:?}"
                );
            }
        }
    }
}
