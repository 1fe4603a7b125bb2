//! Neither an outlier of 46 m nor an outage of 90 s ends a track: robust updates, lost tracks and what smoothers make of new starts.

use fixtrail_track::anchors::Anchors;
use fixtrail_track::fix::Status;
use fixtrail_track::mat::Mat;
use fixtrail_track::packet::{Content, Kind, Packet};
use fixtrail_track::pipeline::track;
use fixtrail_track::spec::{
    EstimatorSpec, KinematicSpec, LinkSpec, ModeSpec, ModelSpec, Prior, Robust, SensorSpec, Span, Spec,
};
use fixtrail_track::target::TargetPackets;
use fixtrail_track::trackers::LaggedMode;
use fixtrail_track::trail::Trail;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use std::collections::BTreeMap;

const SITES: [[f64; 3]; 4] = [[-40.0, -40.0, 2.0], [40.0, -40.0, 3.0], [-40.0, 40.0, 2.5], [40.0, 40.0, 1.0]];
const SD_M: f64 = 0.3;
const HUBER: f64 = 1.345;
const ROBUST: [Robust; 3] = [Robust::Gate(9.0), Robust::Huber(HUBER), Robust::Redescending(4.685)];
const LAGGED: EstimatorSpec = EstimatorSpec::FixedLagKalman { lag: Span::Instants(7) };
/// A tenth of the noise and ten times as much, of 0.2 m²/s³.
const IMM: EstimatorSpec = EstimatorSpec::Imm { modes: [mode(0.02, 20.0), mode(2.0, 2.0), None, None] };
/// Modes that can follow no leap of 30 m in 12 instants.
const CALM_IMM: EstimatorSpec = EstimatorSpec::Imm { modes: [mode(0.005, 20.0), mode(0.02, 2.0), None, None] };
/// Quantile of chi-square with 2 degrees of freedom that one value in 1e8 exceeds, −2 ln 1e-8.
const RARE: f64 = 36.8;

/// Positions by time.
type Path = Vec<(f64, [f64; 2])>;

const fn mode(psd: f64, mean_s: f64) -> Option<ModeSpec> {
    Some(ModeSpec { noise: [psd, psd, 0.0], turn_noise: 0.0, mean_s })
}

fn anchors() -> Anchors {
    let mut anchors = Anchors::default();
    for (i, site) in SITES.iter().enumerate() {
        anchors.add(&format!("a{i}"), *site).unwrap();
    }
    anchors
}

fn normal(rng: &mut Pcg64) -> f64 {
    StandardNormal.sample(rng)
}

/// A round walk at 1 m/s, five instants a second; its acceleration of 0.07 m/s² is well inside the model's noise.
fn walk(from_s: f64, until_s: f64) -> Path {
    let instants = ((until_s - from_s) * 5.0) as u32;
    let at = |t: f64| (t, [15.0 * (t / 15.0).cos(), 15.0 * (t / 15.0).sin()]);
    (0..instants).map(|k| at(from_s + f64::from(k) / 5.0)).collect()
}

/// The ranges of a path to all anchors.
fn ranges(path: &Path, seed: u128) -> Vec<Packet> {
    let mut rng = Pcg64::new(seed, 1);
    let mut out = Vec::new();
    for (t_s, x) in path {
        for (i, site) in SITES.iter().enumerate() {
            let value_m = ((x[0] - site[0]).powi(2) + (x[1] - site[1]).powi(2) + (1.0 - site[2]).powi(2)).sqrt();
            let content = Content::Range { anchor: i as u32, value_m: value_m + SD_M * normal(&mut rng) };
            out.push(Packet::new(*t_s, content, 1));
        }
    }
    out
}

fn spec(estimator: EstimatorSpec, robust: Robust, noise: f64, prior: Option<Prior>) -> Spec {
    let sensor = SensorSpec {
        kind: Kind::Range,
        sd: SD_M,
        path_loss: None,
        drift: None,
        bias: BTreeMap::new(),
        height_m: Some(1.0),
        latency_s: 0.0,
        robust,
    };
    Spec {
        model: ModelSpec::Kinematic(KinematicSpec { order: 2, axes: 2, noise: vec![noise, noise], prior }),
        estimator,
        link: LinkSpec::default(),
        sensors: vec![sensor],
        columns: BTreeMap::new(),
        anchors: None,
        side_m: None,
    }
}

fn run(spec: &Spec, packets: &[Packet]) -> Trail {
    let packets = TargetPackets { target: None, packets: packets.to_vec() };
    track(spec, &anchors(), &packets, LaggedMode::Own).expect("every step can be taken").trail
}

/// dᵀ P⁻¹ d of the first two components.
fn distance(trail: &Trail, row: usize, d: [f64; 2]) -> f64 {
    let p = |i, j| trail.cov_at(row, i, j).expect("an estimate");
    let det = p(0, 0) * p(1, 1) - p(0, 1) * p(0, 1);
    (d[0] * d[0] * p(1, 1) - 2.0 * d[0] * d[1] * p(0, 1) + d[1] * d[1] * p(0, 0)) / det
}

/// Each estimate's error, and its squared distance from truth in standard deviations.
fn errors<'a>(trail: &'a Trail, path: &'a Path) -> impl Iterator<Item = (usize, f64, f64)> + 'a {
    (0..trail.len()).filter_map(|row| {
        let (mean, x) = (trail.mean(row)?, path[row].1);
        let d = [mean[0] - x[0], mean[1] - x[1]];
        Some((row, d[0].hypot(d[1]), distance(trail, row, d)))
    })
}

fn shorten(packet: &mut Packet, by_m: f64) {
    if let Content::Range { value_m, .. } = &mut packet.content {
        *value_m -= by_m;
    }
}

/// Filters with each way to treat outliers.
fn filters() -> impl Iterator<Item = (EstimatorSpec, Robust)> {
    [EstimatorSpec::Ekf, IMM].into_iter().flat_map(|estimator| ROBUST.map(|robust| (estimator, robust)))
}

#[test]
fn outlier_of_46_m_moves_a_huber_track_by_less_than_its_threshold() {
    // An update of weight w moves the state by δ = P⁻h/√s ψ with δᵀP⁻¹δ ≤ ψ² ≤ c², and what a Kalman filter makes of a deviation never
    // grows by the measure of its own covariance: compared with a run that lacks the row, no state is ever off by more than c standard
    // deviations. One outlier in 12 s, each forgotten before the next. A tenth is for the weights of other rows, which differ a little.
    let path = walk(0.0, 60.0);
    let clean = ranges(&path, 3);
    let (mut spoilt, mut without) = (clean.clone(), clean.clone());
    for k in (1..5).rev() {
        shorten(&mut spoilt[k * 240 + k], 46.0);
        without.remove(k * 240 + k);
    }
    let huber = spec(EstimatorSpec::Ekf, Robust::Huber(HUBER), 0.2, None);
    let (found, expected) = (run(&huber, &spoilt), run(&huber, &without));
    let mut most: f64 = 0.0;
    for row in 0..path.len() {
        let (Some(a), Some(b)) = (found.mean(row), expected.mean(row)) else { continue };
        most = most.max(distance(&expected, row, [a[0] - b[0], a[1] - b[1]]).sqrt());
    }
    assert!(most < 1.1 * HUBER && most > 0.1, "{most}");
    assert_eq!(found.restarts, 0);
    // The biweight does not see it at all, a plain filter is thrown off by 46 m times a gain of tenths.
    let biweight = spec(EstimatorSpec::Ekf, Robust::Redescending(4.685), 0.2, None);
    let (found, expected) = (run(&biweight, &spoilt), run(&biweight, &without));
    assert!((0..path.len()).all(|row| found.mean(row) == expected.mean(row)));
    let plain = spec(EstimatorSpec::Ekf, Robust::None, 0.2, None);
    assert!(errors(&run(&plain, &spoilt), &path).any(|(_, off, _)| off > 2.0));
    // Nor do modes: none expects it, and it says nothing of which it is.
    let modes = spec(IMM, Robust::Redescending(4.685), 0.2, None);
    let (found, expected) = (run(&modes, &spoilt), run(&modes, &without));
    for row in 0..path.len() {
        let (Some(a), Some(b)) = (found.mean(row), expected.mean(row)) else { continue };
        // Rounding of probabilities alone.
        assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-10), "row {row}: {a:?} {b:?}");
    }
}

#[test]
fn outlier_among_the_first_ranges_does_not_make_a_start() {
    let path = walk(0.0, 20.0);
    for k in 0..4 {
        for (estimator, robust) in filters() {
            let mut packets = ranges(&path, 4);
            shorten(&mut packets[5 * k], 46.0);
            let trail = run(&spec(estimator, robust, 0.2, None), &packets);
            let worst = errors(&trail, &path).map(|(_, _, nees)| nees).fold(0.0, f64::max);
            // Every estimate there is fits the truth; 100 instants at 1e-8 each.
            assert!(worst < RARE, "{robust:?}, outlier in instant {k}: {worst}");
            assert!(trail.status[5..].iter().all(|s| *s == Status::Updated), "{:?}", trail.status);
        }
    }
}

#[test]
fn outage_of_90_s_is_followed_by_a_clean_start() {
    let (before, after) = (walk(0.0, 30.0), walk(120.0, 150.0));
    let path: Path = before.iter().chain(&after).copied().collect();
    for (estimator, robust) in filters() {
        for spoilt in [false, true] {
            let mut packets = ranges(&path, 5);
            if spoilt {
                // The first range after the outage is the worst there is.
                shorten(&mut packets[4 * before.len()], 46.0);
            }
            let trail = run(&spec(estimator, robust, 0.2, None), &packets);
            assert_eq!(trail.restarts, 1, "{estimator:?} {robust:?}");
            assert_eq!(trail.status[before.len()], Status::Unobservable);
            assert!(trail.status[before.len() + 5..].iter().all(|s| *s == Status::Updated));
            let worst = errors(&trail, &path).map(|(_, _, nees)| nees).fold(0.0, f64::max);
            assert!(worst < RARE, "{robust:?}: {worst}");
        }
    }
}

/// A prior 30 m off and sure of itself.
fn wrong() -> Prior {
    let sd: [f64; 4] = [0.1, 0.1, 0.1, 0.1];
    let data = (0..16).map(|e| if e / 4 == e % 4 { sd[e / 4].powi(2) } else { 0.0 }).collect();
    Prior { mean: vec![-15.0, 5.0, 0.0, 1.0], cov: Mat { rows: 4, cols: 4, data }, second_moment: None }
}

#[test]
fn lost_track_is_given_up_at_the_twelfth_instant_that_misses() {
    let path = walk(0.0, 20.0);
    let packets = ranges(&path, 6);
    for (estimator, robust) in filters() {
        let estimator = if estimator == IMM { CALM_IMM } else { estimator };
        let trail = run(&spec(estimator, robust, 0.01, Some(wrong())), &packets);
        assert_eq!(trail.restarts, 1, "{estimator:?} {robust:?}");
        assert!(trail.status[..11].iter().all(|s| matches!(s, Status::Rejected | Status::Updated)));
        assert_eq!(trail.status[11], Status::Unobservable);
        assert!(trail.status[16..].iter().all(|s| *s == Status::Updated), "{robust:?} {:?}", trail.status);
        // Not by NEES: the noise is too small for the curve of the walk. 0.01 m²/s³ follows it within 0.5 m.
        assert!(errors(&trail, &path).filter(|(row, ..)| *row > 20).all(|(_, off, _)| off < 1.0), "{robust:?}");
    }
    let plain = run(&spec(EstimatorSpec::Ekf, Robust::None, 0.01, Some(wrong())), &packets);
    assert_eq!(plain.restarts, 0);
    assert!(plain.status.iter().all(|s| *s == Status::Updated));
}

/// Checks that a trail is that of its parts, each run by itself.
fn is_of_parts(whole: &Trail, parts: &[Trail], what: &str) {
    let mut row = 0;
    for part in parts {
        for at in 0..part.len() {
            assert_eq!(whole.t_s[row], part.t_s[at], "{what}");
            assert_eq!((whole.mean(row), whole.cov(row)), (part.mean(at), part.cov(at)), "{what}, row {row}");
            row += 1;
        }
    }
    assert_eq!(row, whole.len(), "{what}");
}

#[test]
fn nothing_leaks_across_a_new_start() {
    // Bit for bit: each start must be what it is when there is nothing before and nothing after it.
    let (before, after) = (walk(0.0, 12.0), walk(102.0, 114.0));
    let (first, second) = (ranges(&before, 7), ranges(&after, 8));
    let both: Vec<Packet> = first.iter().chain(&second).cloned().collect();
    for estimator in [EstimatorSpec::Ekf, EstimatorSpec::Rts, LAGGED, IMM] {
        for robust in ROBUST {
            let spec = spec(estimator, robust, 0.2, None);
            let whole = run(&spec, &both);
            assert_eq!(whole.restarts, 1);
            is_of_parts(&whole, &[run(&spec, &first), run(&spec, &second)], &format!("{estimator:?} {robust:?}"));
        }
    }
    // A lost track, whose first part has a prior and the second none.
    for estimator in [EstimatorSpec::Ekf, EstimatorSpec::Rts, LAGGED, CALM_IMM] {
        for robust in ROBUST {
            let with = |prior| spec(estimator, robust, 0.01, prior);
            let whole = run(&with(Some(wrong())), &first);
            let parts = [run(&with(Some(wrong())), &first[..44]), run(&with(None), &first[44..])];
            assert_eq!((whole.restarts, parts[0].restarts, parts[1].restarts), (1, 0, 0));
            is_of_parts(&whole, &parts, &format!("lost, {estimator:?} {robust:?}"));
        }
    }
}

#[test]
fn lagged_smoother_of_weighted_rows_ends_where_the_filter_does() {
    // At the last instant both have used the same rows at the same variances. Without the weights they differ by standard deviations.
    let path = walk(0.0, 12.0);
    let mut packets = ranges(&path, 9);
    for i in [60, 101, 237] {
        shorten(&mut packets[i], 46.0);
    }
    for robust in ROBUST {
        let filter = run(&spec(EstimatorSpec::Ekf, robust, 0.2, None), &packets);
        let last = filter.len() - 1;
        let smoother = run(&spec(LAGGED, robust, 0.2, None), &packets);
        let (a, b) = (filter.mean(last).unwrap(), smoother.mean(last).unwrap());
        // Two recursions over 60 instants of numbers up to 15, rounding amplified by the spread of variances, about 1e4.
        assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-9), "{robust:?}: {a:?} {b:?}");
    }
}

#[test]
fn smoother_leaves_out_what_misses_the_smoothed_trail() {
    // Of weight 0 in both passes: the trail is that of a run without the outliers, bit for bit.
    let path = walk(0.0, 12.0);
    let clean = ranges(&path, 9);
    let (mut spoilt, mut without) = (clean.clone(), clean);
    for i in [237, 101, 60] {
        shorten(&mut spoilt[i], 46.0);
        without.remove(i);
    }
    for robust in [Robust::Gate(9.0), Robust::Redescending(4.685)] {
        let trail = |packets: &[Packet]| run(&spec(EstimatorSpec::Rts, robust, 0.2, None), packets);
        let (found, expected) = (trail(&spoilt), trail(&without));
        assert!((0..path.len()).all(|row| found.mean(row).is_some() && found.mean(row) == expected.mean(row)));
    }
}

#[test]
fn consistent_data_are_tracked_almost_as_well_and_never_given_up() {
    // Truth drawn from the model. Of normal data ν a row of weight w < 1 leaves unused P⁻h/√s (ν − ψ): the error covariance grows by
    // ε P⁻h hᵀP⁻/s = ε k s kᵀ, with ε = E[(ν − ψ)²]. An update shrinks what came before so that the excess stays below a P if
    // a k r kᵀ ≥ ε k s kᵀ, that is a = ε/(1 − κ), κ = hᵀP⁻h/s. Here κ is 0.3 at most: 0.035 m² in 0.125. ε is 2 (3 φ(3) + Q(3)) = 0.029
    // for the gate, 1 − 2 · 0.821 + 0.710 = 0.067 for Huber, and by moments up to the eighth 1 − 2 · 0.758 + 0.604 = 0.089 for the
    // biweight. A tenth of that is for the 200 runs: 2000 independent pairs. NEES of the last instants: mean 2, standard deviation 2,
    // of the mean of 200 runs 0.14, four of which are 0.57; and the same excess.
    let runs = 200;
    let mut squares = [0.0; 4];
    let mut nees = [0.0; 4];
    for seed in 0..runs {
        let mut rng = Pcg64::new(1000 + seed, 2);
        let (dt, q) = (0.2f64, 0.2f64);
        let mut path = Path::new();
        let mut x = [[0.0, 0.5], [0.0, -0.5]];
        for k in 0..100 {
            path.push((f64::from(k) * dt, [x[0][0], x[1][0]]));
            for axis in &mut x {
                let (a, b) = (normal(&mut rng), normal(&mut rng));
                // A factor of q [dt³/3, dt²/2; dt²/2, dt].
                let root = (q * dt).sqrt();
                let push = root * dt * (0.5 * a + b / 12f64.sqrt());
                *axis = [axis[0] + dt * axis[1] + push, axis[1] + root * a];
            }
        }
        let packets = ranges(&path, 2000 + seed);
        for (i, robust) in [Robust::None, ROBUST[0], ROBUST[1], ROBUST[2]].into_iter().enumerate() {
            let trail = run(&spec(EstimatorSpec::Ekf, robust, q, None), &packets);
            assert_eq!(trail.restarts, 0, "{robust:?}, seed {seed}");
            squares[i] +=
                errors(&trail, &path).filter(|(row, ..)| *row >= 10).map(|(_, off, _)| off * off).sum::<f64>();
            nees[i] += errors(&trail, &path).last().expect("an estimate").2 / runs as f64;
        }
    }
    for (i, epsilon) in [0.0, 0.0293, 0.0674, 0.0887].into_iter().enumerate() {
        let most = 1.1 * epsilon / (1.0 - 0.3);
        let loss = squares[i] / squares[0] - 1.0;
        assert!(loss <= most && loss > -0.01, "{i}: {loss} of {squares:?}");
        assert!((nees[i] - 2.0).abs() < 0.57 + 2.0 * most, "{i}: {nees:?}");
    }
}
