//! Nonlinear tracking against dense least squares over whole trajectories, and the shapes at the edge of what is built.

mod support;

use fixtrail_core::models::Integrators;
use fixtrail_track::anchors::Anchors;
use fixtrail_track::fix::Status;
use fixtrail_track::packet::{Content, Kind, Packet};
use fixtrail_track::pipeline::track;
use fixtrail_track::spec::{Align, EstimatorSpec, KinematicSpec, ModelSpec, Robust, SensorSpec, Span, Spec, TurnSpec};
use fixtrail_track::target::TargetPackets;
use fixtrail_track::trackers::LaggedMode;
use fixtrail_track::trail::Trail;
use nalgebra::{DMatrix, DVector};
use std::collections::BTreeMap;
use support::oracle::nonlinear::minimised;
use support::oracle::random::{Family, Random, run};
use support::oracle::{Posterior, Start};
use support::{Declared, Tally, fms, packed_deviation, spec_of, tracked};

const SITES: [[f64; 3]; 4] = [[0.0, 0.0, 2.0], [20.0, 0.0, 3.0], [0.0, 20.0, 2.5], [20.0, 20.0, 1.0]];
const HEIGHT_M: f64 = 1.2;
const SD_M: f64 = 0.1;

fn anchors() -> Anchors {
    let mut anchors = Anchors::default();
    for (i, site) in SITES.iter().enumerate() {
        anchors.add(&format!("a{i}"), *site).unwrap();
    }
    anchors
}

fn distance(x: f64, y: f64, site: usize) -> f64 {
    let s = SITES[site];
    ((x - s[0]).powi(2) + (y - s[1]).powi(2) + (HEIGHT_M - s[2]).powi(2)).sqrt()
}

/// One instant of ranges: time, and distances by anchor.
type Ranges = (f64, Vec<(usize, f64)>);

fn packets(run: &[Ranges]) -> TargetPackets {
    let packet =
        |t_s: f64, anchor: usize, value_m: f64| Packet::new(t_s, Content::Range { anchor: anchor as u32, value_m }, 1);
    let packets = run.iter().flat_map(|(t, all)| all.iter().map(move |(a, v)| packet(*t, *a, *v))).collect();
    TargetPackets { target: None, packets }
}

fn ranging(model: ModelSpec, estimator: EstimatorSpec) -> Spec {
    let sensor = SensorSpec {
        kind: Kind::Range,
        sd: SD_M,
        path_loss: None,
        drift: None,
        bias: BTreeMap::new(),
        height_m: Some(HEIGHT_M),
        latency_s: 0.0,
        robust: Robust::None,
    };
    Spec { sensors: vec![sensor], ..spec_of(model, estimator) }
}

fn constant_velocity() -> ModelSpec {
    ModelSpec::Kinematic(KinematicSpec { order: 2, axes: 2, noise: vec![0.4, 0.4], prior: None })
}

/// A bent walk, irregularly sampled; some instants lack anchors.
fn walk(rng: &mut Random, len: usize) -> (Vec<Ranges>, Vec<[f64; 4]>) {
    let (mut t, mut run, mut truth) = (0.0, Vec::new(), Vec::new());
    for _ in 0..len {
        t += 0.2 + 0.3 * rng.uniform();
        let (s, c) = (0.4 * t).sin_cos();
        let x = [9.0 + 5.0 * c, 11.0 + 4.0 * s, -2.0 * s, 1.6 * c];
        let got: Vec<(usize, f64)> = (0..4)
            .filter(|_| !rng.chance(0.25))
            .collect::<Vec<_>>()
            .into_iter()
            .map(|a| (a, distance(x[0], x[1], a) + SD_M * rng.normal()))
            .collect();
        let got = if got.is_empty() { vec![(0, distance(x[0], x[1], 0))] } else { got };
        run.push((t, got));
        truth.push(x);
    }
    (run, truth)
}

/// The whole trajectory of a window by dense least squares, started at the truth.
fn dense(run: &[Ranges], truth: &[[f64; 4]]) -> Posterior {
    let motion = Integrators::<4>::new(2, 2, [0.4, 0.4, 0.0]).unwrap();
    let leaps: Vec<(DMatrix<f64>, DMatrix<f64>)> = run
        .windows(2)
        .map(|w| {
            let leap = motion.leap(&fixtrail_core::Vector::zeros(), w[1].0 - w[0].0);
            let q = DMatrix::from_fn(4, 4, |i, j| leap.q[(i, j)]);
            (DMatrix::from_fn(4, 4, |i, j| leap.f[(i, j)]), q.cholesky().expect("definite").l())
        })
        .collect();
    let residuals = |x: &DVector<f64>| {
        let mut out = Vec::new();
        for (k, (_, ranges)) in run.iter().enumerate() {
            out.extend(ranges.iter().map(|(a, v)| (v - distance(x[4 * k], x[4 * k + 1], *a)) / SD_M));
            if k > 0 {
                let (f, l) = &leaps[k - 1];
                let off = x.rows(4 * k, 4) - f * x.rows(4 * k - 4, 4);
                out.extend(l.solve_lower_triangular(&off).expect("its diagonal is positive").iter());
            }
        }
        DVector::from_vec(out)
    };
    minimised(&residuals, DVector::from_iterator(4 * truth.len(), truth.iter().flatten().copied()))
}

fn part(whole: &Posterior, k: usize) -> Posterior {
    Posterior { mean: whole.mean.rows(4 * k, 4).into_owned(), cov: whole.cov.view((4 * k, 4 * k), (4, 4)).into_owned() }
}

#[test]
fn newton_windows_equal_dense_nonlinear_least_squares() {
    let mut rng = Random::new(1);
    let (run, truth) = walk(&mut rng, 26);
    let (mut worst, mut compared): (f64, _) = (0.0, 0);
    for (window, lag, align) in [
        (5, 2, Align::Filtered),
        (8, 7, Align::Filtered),
        (8, 0, Align::Filtered),
        (6, 3, Align::Predicted),
        (6, 6, Align::Predicted),
    ] {
        let spec = ranging(constant_velocity(), fms(window, lag, align));
        let trail = track(&spec, &anchors(), &packets(&run), LaggedMode::Both).unwrap().trail;
        assert_eq!(trail.len(), run.len());
        for k in 3..run.len() {
            let end = if align == Align::Predicted { k } else { k + 1 };
            let first = end.saturating_sub(window);
            let whole = dense(&run[first..end], &truth[first..end]);
            let lagged = k - lag.min(k);
            if let Some((mean, cov)) = trail.lagged(k)
                && lagged < end
            {
                worst = worst.max(packed_deviation(mean, cov, &part(&whole, lagged - first)));
                compared += 1;
            }
            if align == Align::Filtered {
                let (mean, cov) = trail.mean(k).zip(trail.cov(k)).expect("four anchors or so determine it");
                worst = worst.max(packed_deviation(mean, cov, &part(&whole, k - first)));
                compared += 1;
            } else if let Some(mean) = trail.mean(k) {
                let motion = Integrators::<4>::new(2, 2, [0.4, 0.4, 0.0]).unwrap();
                let leap = motion.leap(&fixtrail_core::Vector::zeros(), run[k].0 - run[k - 1].0);
                let (f, q) =
                    (DMatrix::from_fn(4, 4, |i, j| leap.f[(i, j)]), DMatrix::from_fn(4, 4, |i, j| leap.q[(i, j)]));
                let last = part(&whole, k - 1 - first);
                let ahead = Posterior { mean: &f * last.mean, cov: &f * last.cov * f.transpose() + q };
                worst = worst.max(packed_deviation(mean, trail.cov(k).unwrap(), &ahead));
                compared += 1;
            }
        }
    }
    println!("{worst:e} of {compared}");
    // The oracle's Jacobian is by differences, good to 1e-9; Gauss–Newton stops at 1e-7 of a standard deviation and converges
    // faster than that.
    assert!(worst < 1e-6 && compared > 150, "{worst:e} of {compared}");
}

#[test]
fn ekf_without_a_prior_starts_where_least_squares_does() {
    let mut rng = Random::new(2);
    for _ in 0..10 {
        let (run, truth) = walk(&mut rng, 40);
        let spec = ranging(constant_velocity(), EstimatorSpec::Ekf);
        let trail = track(&spec, &anchors(), &packets(&run), LaggedMode::Own).unwrap().trail;
        let first = (0..trail.len()).find(|k| trail.mean(*k).is_some()).expect("it starts");
        assert!(first <= 4, "started at row {first}");
        assert!((0..first).all(|k| trail.status[k] == Status::Unobservable));
        let whole = dense(&run[..=first], &truth[..=first]);
        let off = packed_deviation(trail.mean(first).unwrap(), trail.cov(first).unwrap(), &part(&whole, first));
        // As above; the first velocities are of large variance, the problem worse conditioned.
        assert!(off < 1e-5, "{off:e}");
        let far = (first..trail.len()).map(|k| {
            let mean = trail.mean(k).expect("once started it goes on");
            f64::hypot(mean[0] - truth[k][0], mean[1] - truth[k][1])
        });
        // 10 cm ranges: no position is as much as ten standard deviations off.
        assert!(far.fold(0.0, f64::max) < 1.0);
    }
}

#[test]
fn smoother_linearises_along_its_own_trail() {
    // Gauss–Newton from the trail that the filter's linearisation gives: one step takes most of what is left to the exact solution.
    let mut rng = Random::new(4);
    let mut worst: f64 = 0.0;
    for _ in 0..10 {
        let (run, truth) = walk(&mut rng, 30);
        let spec = ranging(constant_velocity(), EstimatorSpec::Rts);
        let trail = track(&spec, &anchors(), &packets(&run), LaggedMode::Own).unwrap().trail;
        let whole = dense(&run, &truth);
        for k in 0..run.len() {
            worst = worst.max(packed_deviation(trail.mean(k).unwrap(), trail.cov(k).unwrap(), &part(&whole, k)));
        }
    }
    // Standard deviations. What the filter's linearisation leaves is several times as much.
    assert!(worst < 0.01, "{worst:e}");
}

fn turn() -> ModelSpec {
    ModelSpec::Turn(TurnSpec { noise: [0.02, 0.02], turn_noise: 1e-4, per_step: None, prior: None })
}

#[test]
fn a_turn_rate_of_zero_is_nothing_special() {
    let mut rng = Random::new(3);
    // The filter used to take over as soon as the first ranges determined a state, with a turn rate known to 15 rad/s: it was sure of
    // 18 rad/s from then on, and a metre off.
    // Straight on, then a gentle curve, then straight on again.
    let (mut x, mut y, mut heading) = (4.0, 4.0, 0.6_f64);
    let mut run = Vec::new();
    let mut truth = Vec::new();
    for k in 0..240 {
        let omega = if (80..160).contains(&k) { 0.25 } else { 0.0 };
        heading += 0.1 * omega;
        x += 0.1 * 0.7 * heading.cos();
        y += 0.1 * 0.7 * heading.sin();
        truth.push((x, y, omega));
        run.push((0.1 * k as f64, (0..4).map(|a| (a, distance(x, y, a) + SD_M * rng.normal())).collect()));
    }
    for estimator in [
        EstimatorSpec::Ekf,
        EstimatorSpec::Rts,
        EstimatorSpec::FixedLagKalman { lag: Span::Instants(10) },
        fms(30, 8, Align::Filtered),
        fms(30, 8, Align::Predicted),
    ] {
        let trail = track(&ranging(turn(), estimator), &anchors(), &packets(&run), LaggedMode::Own).unwrap().trail;
        assert_eq!(trail.len(), 240);
        let mut sum = 0.0;
        for (k, (x, y, omega)) in truth.iter().enumerate().skip(40) {
            let mean = trail.mean(k).unwrap_or_else(|| panic!("{estimator:?}: nothing in row {k}"));
            let off = f64::hypot(mean[0] - x, mean[1] - y);
            assert!(off < 0.6, "{estimator:?}, row {k}: {off} m off");
            sum += off * off;
            let sd = trail.cov_at(k, 4, 4).unwrap().sqrt();
            assert!(
                (mean[4] - omega).abs() < 6.0 * sd + 0.3,
                "{estimator:?}, row {k}: {} ± {sd}, truly {omega}",
                mean[4]
            );
        }
        // Better than a single fix of four ranges of 10 cm.
        assert!((sum / 200.0_f64).sqrt() < 0.15, "{estimator:?}: {}", (sum / 200.0_f64).sqrt());
    }
}

#[test]
fn a_turn_seen_exactly_straight_stays_straight() {
    // No noise, no turn: the turn rate's column is that of ω = 0 all the way.
    let run: Vec<Ranges> = (0..60)
        .map(|k| {
            let t = 0.2 * k as f64;
            (t, (0..4).map(|a| (a, distance(3.0 + t, 5.0 + 0.8 * t, a))).collect())
        })
        .collect();
    for estimator in [EstimatorSpec::Ekf, fms(12, 4, Align::Filtered)] {
        let trail = track(&ranging(turn(), estimator), &anchors(), &packets(&run), LaggedMode::Own).unwrap().trail;
        for k in 10..60 {
            let t = 0.2 * k as f64;
            let expected = [3.0 + t, 5.0 + 0.8 * t, 1.0, 0.8, 0.0];
            for (mean, expected) in trail.mean(k).unwrap().iter().zip(expected) {
                // Exact data: the recursion forgets its linearisation errors, the window has none but its stopping at 1e-7 sd.
                assert!((mean - expected).abs() < 1e-4, "{estimator:?}, row {k}: {mean}, expected {expected}");
            }
        }
    }
}

#[test]
fn twelve_states_and_six_outputs_suit_every_linear_estimator() {
    let mut rng = Random::new(4);
    let family = Family { len: 7, n: 12, q: 6, p: 3, varying: false, prior: false, loss: 0.1, singular: false };
    let limit = 1e-8;
    let mut tally = Tally::default();
    for i in 0..4 {
        let run = run(&mut rng, &family);
        for declared in [Declared::Invariant, Declared::Sequence] {
            let check =
                |tally: &mut Tally, trail: &Trail, range: &dyn Fn(usize) -> std::ops::Range<usize>, what: &str| {
                    for k in 0..run.len() {
                        let verdict = run.posterior(Start::Unknown, range(k), k);
                        tally.row(trail, k, &verdict, &format!("{what}, run {i}, row {k}"), limit);
                    }
                };
            let own = |e| tracked(&run, declared, e, LaggedMode::Own);
            check(&mut tally, &own(EstimatorSpec::Kalman), &|k| 0..k + 1, "kalman");
            check(&mut tally, &own(EstimatorSpec::Rts), &|_| 0..7, "rts");
            let lagging = own(EstimatorSpec::FixedLagKalman { lag: Span::Instants(2) });
            check(&mut tally, &lagging, &|k| 0..(k + 3).min(7), "fixed-lag-kalman");
            check(&mut tally, &own(fms(5, 1, Align::Filtered)), &|k| (k + 1).saturating_sub(5)..k + 1, "fms");
            check(&mut tally, &own(fms(5, 1, Align::Predicted)), &|k| k.saturating_sub(5)..k, "fms predicted");
            let trail = own(EstimatorSpec::Ufir { window: Span::Instants(5) });
            for k in 0..run.len() {
                let data = (k + 1).saturating_sub(5)..k + 1;
                tally.row(&trail, k, &run.without_process_noise(data, k), &format!("ufir, run {i}, row {k}"), limit);
            }
        }
    }
    println!("{tally:?}");
    assert!(tally.estimates > 150 && tally.borderline * 4 < tally.estimates, "{tally:?}");
}
