//! Finite memory: what a window says, when it says nothing, and how it forgets.

mod support;

use fixtrail_track::anchors::Anchors;
use fixtrail_track::fix::Status;
use fixtrail_track::mat::Mat;
use fixtrail_track::packet::{Content, Kind, Packet};
use fixtrail_track::pipeline::track;
use fixtrail_track::spec::{
    Align, EstimatorSpec, KinematicSpec, LinearSpec, LinearStep, ModelSpec, Robust, SensorSpec, Span, Spec,
};
use fixtrail_track::target::TargetPackets;
use fixtrail_track::trackers::LaggedMode;
use fixtrail_track::trail::Trail;
use nalgebra::{DMatrix, DVector};
use std::collections::BTreeMap;
use support::oracle::random::{Family, Random, run};
use support::oracle::{Instant, Posterior, Run, Start, Verdict};
use support::{Declared, fms, packed_deviation, spec_of, tracked};

/// Windows conditioned by up to 1e4, squared in the smoother.
const LIMIT: f64 = 1e-8;

fn posterior(trail: &Trail, row: usize) -> Option<Posterior> {
    let (mean, n) = (trail.mean(row)?, trail.n());
    let cov = DMatrix::from_fn(n, n, |i, j| trail.cov_at(row, i, j).expect("beside its mean"));
    Some(Posterior { mean: DVector::from_column_slice(mean), cov })
}

#[test]
fn fms_equals_a_diffuse_kalman_filter_and_smoother_started_on_the_window() {
    let mut rng = Random::new(1);
    let (mut worst, mut compared, mut absent, mut borderline): (f64, _, _, _) = (0.0, 0, 0, 0);
    for i in 0..25 {
        let varying = i % 2 == 0;
        let family = Family {
            len: 45,
            n: rng.count(1, 4),
            q: rng.count(1, 2),
            p: 2,
            varying,
            prior: false,
            loss: 0.3,
            singular: true,
        };
        let run = run(&mut rng, &family);
        let declared = if varying { Declared::Sequence } else { Declared::Invariant };
        let window = rng.count(2, 40);
        let lag = rng.count(0, window - 1);
        let trail = tracked(&run, declared, fms(window, lag, Align::Filtered), LaggedMode::Both);
        for k in (0..run.len()).filter(|k| k % 3 == i % 3) {
            let first = (k + 1).saturating_sub(window);
            let part = Run { instants: run.instants[first..=k].to_vec(), prior: None };
            let fresh = tracked(&part, declared, EstimatorSpec::Rts, LaggedMode::Both);
            let newest = k - first;
            let what = format!("run {i}, window {window}, lag {lag}, row {k}");
            let pairs = [
                (trail.mean(k).zip(trail.cov(k)), posterior(&fresh, newest)),
                (
                    trail.lagged(k),
                    newest.checked_sub(lag).and_then(|j| {
                        let (mean, cov) = fresh.lagged(j)?;
                        let n = mean.len();
                        let cov = DMatrix::from_fn(n, n, |a, b| cov[Trail::packed_index(n, a.min(b), a.max(b))]);
                        Some(Posterior { mean: DVector::from_column_slice(mean), cov })
                    }),
                ),
            ];
            for (ours, expected) in pairs {
                match (ours, expected) {
                    (Some((mean, cov)), Some(expected)) => {
                        let off = packed_deviation(mean, cov, &expected);
                        let whole = || run.posterior(Start::Unknown, first..k + 1, first);
                        if off > LIMIT && matches!(whole(), Verdict::Borderline) {
                            borderline += 1;
                            continue;
                        }
                        assert!(off < LIMIT, "{what}: {off:e}");
                        worst = worst.max(off);
                        compared += 1;
                    }
                    (None, None) => absent += 1,
                    (ours, expected) => panic!("{what}: {ours:?}, expected {expected:?}"),
                }
            }
        }
    }
    println!("{worst:e} of {compared}, {absent} absent, {borderline} borderline");
    assert!(compared > 400 && borderline < 10, "{compared} compared, {borderline} borderline");
}

/// A time-invariant system without inputs; data are filled in by the test.
fn system(a: DMatrix<f64>, c: DMatrix<f64>, len: usize) -> Run {
    let (n, q) = (a.nrows(), c.nrows());
    let at = Instant {
        a,
        b: DMatrix::zeros(n, 0),
        g: DMatrix::identity(n, n),
        q: DMatrix::identity(n, n) * 0.04,
        c,
        r: DMatrix::identity(q, q) * 0.25,
        z: vec![Some(1.0); q],
        u: Vec::new(),
    };
    Run { instants: vec![at; len], prior: None }
}

fn integrators(n: usize, dt: f64) -> DMatrix<f64> {
    let powers = [1.0, dt, dt * dt / 2.0];
    DMatrix::from_fn(n, n, |i, j| if j >= i { powers[j - i] } else { 0.0 })
}

fn statuses(trail: &Trail) -> Vec<Status> {
    trail.status.clone()
}

#[test]
fn a_growing_first_window_is_unobservable_until_it_determines_the_state() {
    let run = system(integrators(3, 1.0), DMatrix::from_row_slice(1, 3, &[1.0, 0.0, 0.0]), 8);
    for declared in [Declared::Invariant, Declared::Sequence] {
        let filtered = tracked(&run, declared, fms(6, 2, Align::Filtered), LaggedMode::Both);
        // Three positions make a parabola: row 2 is the first.
        let seen = |from: usize, len: usize| -> Vec<Status> {
            (0..len).map(|k| if k < from { Status::Unobservable } else { Status::Updated }).collect()
        };
        assert_eq!(statuses(&filtered), seen(2, 8));
        let lagged = filtered.lagged.as_ref().unwrap();
        assert_eq!(lagged.status[..2], [None, None]);
        assert_eq!(lagged.status[2..], [Some(Status::Updated); 6]);
        // The paper's form knows z_{k−1} at the latest: one row later, and one row more at the end.
        let predicted = tracked(&run, declared, fms(6, 2, Align::Predicted), LaggedMode::Both);
        assert_eq!(statuses(&predicted), seen(3, 9));
        assert_eq!(predicted.lagged.as_ref().unwrap().status[2], Some(Status::Unobservable));
        for estimator in [EstimatorSpec::Kalman, EstimatorSpec::Ufir { window: Span::Instants(6) }] {
            assert_eq!(statuses(&tracked(&run, declared, estimator, LaggedMode::Own)), seen(2, 8));
        }
        // A smoother knows the first rows too.
        for estimator in [EstimatorSpec::Rts, EstimatorSpec::FixedLagKalman { lag: Span::Instants(2) }] {
            assert_eq!(statuses(&tracked(&run, declared, estimator, LaggedMode::Own)), seen(0, 8));
        }
        let short = EstimatorSpec::FixedLagKalman { lag: Span::Instants(1) };
        assert_eq!(statuses(&tracked(&run, declared, short, LaggedMode::Own)), seen(1, 8));
    }
}

#[test]
fn what_is_never_measured_is_never_estimated() {
    // Acceleration only: position and velocity are free.
    let run = system(integrators(3, 1.0), DMatrix::from_row_slice(1, 3, &[0.0, 0.0, 1.0]), 40);
    for declared in [Declared::Invariant, Declared::Sequence] {
        for estimator in [
            EstimatorSpec::Kalman,
            EstimatorSpec::Rts,
            EstimatorSpec::FixedLagKalman { lag: Span::Instants(3) },
            fms(15, 4, Align::Filtered),
            fms(15, 4, Align::Predicted),
            fms(35, 4, Align::Filtered),
            EstimatorSpec::Ufir { window: Span::Instants(15) },
        ] {
            let trail = tracked(&run, declared, estimator, LaggedMode::Own);
            assert!(trail.status.iter().all(|s| *s == Status::Unobservable), "{estimator:?}");
        }
    }
}

#[test]
fn filter_and_smoother_are_judged_separately() {
    // The second state is forgotten at every step, and never measured. The smoothers used to ask for the whole first state and
    // gave no estimate of any row.
    let a = DMatrix::from_row_slice(2, 2, &[0.5, 0.0, 0.0, 0.0]);
    let run = system(a, DMatrix::from_row_slice(1, 2, &[1.0, 0.0]), 8);
    for declared in [Declared::Invariant, Declared::Sequence] {
        let window = 5;
        for lag in 0..window {
            let trail = tracked(&run, declared, fms(window, lag, Align::Filtered), LaggedMode::Both);
            for k in 0..run.len() {
                // Only the window's first state is unknown.
                assert_eq!(trail.mean(k).is_some(), k > 0, "lag {lag}, row {k}");
                if k >= lag {
                    let lagged = k - lag > (k + 1).saturating_sub(window);
                    assert_eq!(trail.lagged(k).is_some(), lagged, "lag {lag}, row {k}");
                }
            }
        }
        // Of the whole run only the very first state.
        for estimator in
            [EstimatorSpec::Kalman, EstimatorSpec::Rts, EstimatorSpec::FixedLagKalman { lag: Span::Instants(2) }]
        {
            let trail = tracked(&run, declared, estimator, LaggedMode::Own);
            let known: Vec<bool> = (0..8).map(|k| trail.mean(k).is_some()).collect();
            assert_eq!(known, [false, true, true, true, true, true, true, true], "{estimator:?}");
        }
    }
}

#[test]
fn a_window_recovers_after_a_burst() {
    let mut run = system(integrators(2, 1.0), DMatrix::from_row_slice(1, 2, &[1.0, 0.0]), 40);
    for at in &mut run.instants[10..22] {
        at.z = vec![None];
    }
    for (declared, window) in [(Declared::Invariant, 5), (Declared::Sequence, 5)] {
        let trail = tracked(&run, declared, fms(window, 1, Align::Filtered), LaggedMode::Both);
        for k in 0..40 {
            // Two positions are needed; row k sees rows k − 4 … k.
            let inside = (k as usize + 1).saturating_sub(window)..=k as usize;
            let received = inside.filter(|i| !(10..22).contains(i)).count();
            let expected = match (received >= 2, (10..22).contains(&k)) {
                (false, _) => Status::Unobservable,
                (true, true) => Status::Predicted,
                (true, false) => Status::Updated,
            };
            assert_eq!(trail.status[k as usize], expected, "{declared:?}, row {k}");
        }
    }
    // The same with windows that are aggregated.
    for at in &mut run.instants[0..39] {
        at.z = vec![None];
    }
    run.instants.extend(run.instants.clone());
    run.instants[41].z = vec![Some(2.0)];
    for declared in [Declared::Invariant, Declared::Sequence] {
        let trail = tracked(&run, declared, fms(35, 1, Align::Filtered), LaggedMode::Own);
        let known: Vec<usize> = (0..trail.len()).filter(|k| trail.mean(*k).is_some()).collect();
        // Rows 39 and 41 from the second on, until the first leaves; then row 79 comes.
        let expected: Vec<usize> = (41..39 + 35).collect();
        assert_eq!(known, expected, "{declared:?}");
    }
}

#[test]
fn an_outlier_is_forgotten_to_the_bit() {
    let mut rng = Random::new(2);
    let mut run = system(integrators(3, 1.0), DMatrix::from_row_slice(1, 3, &[1.0, 0.0, 0.0]), 60);
    for at in &mut run.instants {
        at.z = vec![Some(rng.normal())];
    }
    let mut spoiled = run.clone();
    spoiled.instants[20].z = vec![Some(1e6)];
    let ufir = EstimatorSpec::Ufir { window: Span::Instants(15) };
    for declared in [Declared::Invariant, Declared::Sequence] {
        for (estimator, touched) in
            [(fms(15, 5, Align::Predicted), 21..=35), (fms(15, 5, Align::Filtered), 20..=34), (ufir, 20..=34)]
        {
            let clean = tracked(&run, declared, estimator, LaggedMode::Both);
            let dirty = tracked(&spoiled, declared, estimator, LaggedMode::Both);
            for k in 0..clean.len() {
                let same = clean.mean(k) == dirty.mean(k) && clean.lagged(k) == dirty.lagged(k);
                assert_eq!(
                    same,
                    !touched.contains(&k) || clean.mean(k).is_none(),
                    "{declared:?}, {estimator:?}, row {k}"
                );
            }
        }
    }
}

#[test]
fn noise_free_data_give_the_exact_states() {
    let mut rng = Random::new(3);
    for (window, lag) in [(3, 0), (4, 2), (15, 5), (35, 10)] {
        let mut run = system(integrators(3, 0.5), DMatrix::from_row_slice(1, 3, &[1.0, 0.0, 0.0]), 60);
        run.instants.iter_mut().for_each(|at| at.b = DMatrix::from_row_slice(3, 1, &[0.1, 0.5, 1.0]));
        let mut x = DVector::from_column_slice(&[10.0, -1.0, 0.2]);
        let mut states = Vec::new();
        for at in &mut run.instants {
            at.u = vec![rng.normal()];
            at.z = vec![Some((&at.c * &x)[0])];
            states.push(x.clone());
            x = &at.a * x + &at.b * at.u[0];
        }
        for declared in [Declared::Invariant, Declared::Sequence] {
            let ufir = EstimatorSpec::Ufir { window: Span::Instants(window) };
            for estimator in [fms(window, lag, Align::Filtered), ufir] {
                let trail = tracked(&run, declared, estimator, LaggedMode::Both);
                for k in 3..60 {
                    // Positions reach hundreds; three rows half a second apart make an acceleration of 16 times their rounding.
                    let off = (DVector::from_column_slice(trail.mean(k).unwrap()) - &states[k]).amax();
                    assert!(off < 1e-9, "{estimator:?}, {declared:?}, row {k}: {off:e}");
                    if let Some((mean, _)) = trail.lagged(k) {
                        let off = (DVector::from_column_slice(mean) - &states[k - lag]).amax();
                        assert!(off < 1e-9, "{estimator:?}, {declared:?}, row {k}, lagged: {off:e}");
                    }
                }
            }
        }
    }
}

fn positions(kinematic: KinematicSpec, estimator: EstimatorSpec, sd: f64) -> Spec {
    let sensor = SensorSpec {
        kind: Kind::Position,
        sd,
        path_loss: None,
        drift: None,
        bias: BTreeMap::new(),
        height_m: None,
        latency_s: 0.0,
        robust: Robust::None,
    };
    Spec { sensors: vec![sensor], ..spec_of(ModelSpec::Kinematic(kinematic), estimator) }
}

fn position(t_s: f64, xyz: [Option<f64>; 3]) -> Packet {
    Packet::new(t_s, Content::Position(xyz), 1)
}

#[test]
fn irregular_times_equal_a_sequence_of_their_matrices() {
    use fixtrail_core::models::Integrators;
    let (sd, psd) = (0.3, [0.7, 0.2, 0.0]);
    let mut rng = Random::new(4);
    let times: Vec<f64> = (0..80)
        .scan(0.0, |t, _| {
            *t += [0.01, 0.5, 0.5, 3.0][rng.count(0, 3)];
            Some(*t)
        })
        .collect();
    let values: Vec<[Option<f64>; 3]> = times
        .iter()
        .map(|t| [Some(2.0 * t + rng.normal()), (!rng.chance(0.2)).then_some(5.0 - t + rng.normal()), None])
        .collect();
    let motion = Integrators::<4>::new(2, 2, psd).unwrap();
    let dense = |m: &fixtrail_core::Matrix<4, 4>| Mat { rows: 4, cols: 4, data: m.transpose().as_slice().to_vec() };
    let steps: Vec<LinearStep> = (0..80)
        .map(|k| {
            let dt = if k + 1 < 80 { times[k + 1] - times[k] } else { 0.0 };
            let leap = motion.leap(&fixtrail_core::Vector::zeros(), dt);
            LinearStep {
                a: dense(&leap.f),
                b: Mat { rows: 4, cols: 0, data: Vec::new() },
                g: Mat::identity(4),
                c: Mat { rows: 2, cols: 4, data: vec![1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0] },
                q: dense(&leap.q),
                r: Mat { rows: 2, cols: 2, data: vec![sd * sd, 0.0, 0.0, sd * sd] },
            }
        })
        .collect();
    let linear = LinearSpec { base: steps[0].clone(), sequence: steps, prior: None };
    let kinematic = KinematicSpec { order: 2, axes: 2, noise: psd[..2].to_vec(), prior: None };
    let timed =
        TargetPackets { target: None, packets: times.iter().zip(&values).map(|(t, v)| position(*t, *v)).collect() };
    let counted = TargetPackets {
        target: None,
        packets: values.iter().enumerate().map(|(k, v)| support::packet(k, &v[..2], &[])).collect(),
    };
    for estimator in [
        EstimatorSpec::Kalman,
        EstimatorSpec::Rts,
        EstimatorSpec::FixedLagKalman { lag: Span::Instants(4) },
        fms(12, 4, Align::Filtered),
        fms(40, 9, Align::Filtered),
        EstimatorSpec::Ufir { window: Span::Instants(12) },
    ] {
        let anchors = Anchors::default();
        let a = track(&positions(kinematic.clone(), estimator, sd), &anchors, &timed, LaggedMode::Both).unwrap().trail;
        let spec = spec_of(ModelSpec::Linear(linear.clone()), estimator);
        let b = track(&spec, &anchors, &counted, LaggedMode::Both).unwrap().trail;
        assert_eq!((a.len(), &a.status), (b.len(), &b.status));
        let mut worst: f64 = 0.0;
        for k in 0..a.len() {
            if let Some(expected) = posterior(&b, k) {
                worst = worst.max(packed_deviation(a.mean(k).unwrap(), a.cov(k).unwrap(), &expected));
            }
            assert_eq!(a.nis_dof[k], b.nis_dof[k]);
        }
        // The same numbers up to the order of a few sums.
        assert!(worst < 1e-10, "{estimator:?}: {worst:e}");
    }
}

#[test]
fn a_window_in_seconds_equals_one_in_instants_on_regular_times() {
    let mut rng = Random::new(5);
    let packets: Vec<Packet> =
        (0..60).map(|k| position(0.1 * k as f64, [Some(rng.normal()), Some(rng.normal()), None])).collect();
    let packets = TargetPackets { target: None, packets };
    let kinematic = KinematicSpec { order: 2, axes: 2, noise: vec![0.5, 0.5], prior: None };
    for align in [Align::Filtered, Align::Predicted] {
        // Instants at ages 0 … 0.9 s are ten; the lag of 0.3 s stands three back.
        let seconds = EstimatorSpec::Fms { window: Span::Seconds(0.9), lag: Span::Seconds(0.3), align };
        let anchors = Anchors::default();
        let a = track(&positions(kinematic.clone(), seconds, 0.3), &anchors, &packets, LaggedMode::Both).unwrap().trail;
        let instants = positions(kinematic.clone(), fms(10, 3, align), 0.3);
        let b = track(&instants, &anchors, &packets, LaggedMode::Both).unwrap().trail;
        assert_eq!(a.len(), b.len());
        for k in 0..a.len() {
            assert_eq!((a.mean(k), a.cov(k), a.lagged(k)), (b.mean(k), b.cov(k), b.lagged(k)), "{align:?}, row {k}");
        }
    }
}
