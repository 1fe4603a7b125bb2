//! Instants microseconds apart, and gaps of a day: time scales that a covariance recursion has to bridge without losing digits.

use fixtrail_track::anchors::Anchors;
use fixtrail_track::packet::{Content, Kind, Packet};
use fixtrail_track::pipeline::track;
use fixtrail_track::spec::{Align, EstimatorSpec, KinematicSpec, LinkSpec, ModelSpec, Robust, SensorSpec, Span, Spec};
use fixtrail_track::target::TargetPackets;
use fixtrail_track::trackers::LaggedMode;
use fixtrail_track::trail::Trail;

/// One axis, positions measured to 0.1 m at the given times.
fn tracked(order: usize, times_s: &[f64], estimator: EstimatorSpec, lagged: LaggedMode) -> Trail {
    let sensor = SensorSpec {
        kind: Kind::Position,
        sd: 0.1,
        path_loss: None,
        drift: None,
        bias: Default::default(),
        height_m: None,
        latency_s: 0.0,
        robust: Robust::None,
    };
    let spec = Spec {
        model: ModelSpec::Kinematic(KinematicSpec { order, axes: 1, noise: vec![1.0], prior: None }),
        estimator,
        link: LinkSpec::default(),
        sensors: vec![sensor],
        columns: Default::default(),
        anchors: None,
        side_m: None,
    };
    let packet = |(i, t_s): (usize, &f64)| {
        // Anything that is no straight line.
        Packet::new(*t_s, Content::Position([Some((i as f64).sin()), None, None]), i as u64 + 2)
    };
    let packets = times_s.iter().enumerate().map(packet).collect();
    let target = TargetPackets { target: None, packets };
    track(&spec, &Anchors::default(), &target, lagged).expect("a sound model and sound data").trail
}

fn fms(window: usize, lag: usize) -> EstimatorSpec {
    EstimatorSpec::Fms { window: Span::Instants(window), lag: Span::Instants(lag), align: Align::Filtered }
}

#[test]
fn filter_without_a_prior_bears_first_instants_that_lie_close_together() {
    // The second and third instants leave an acceleration of 1e11 m/s² possible; handed to an ordinary covariance, that ended in a
    // negative innovation variance. A window over everything never has such a covariance.
    for (order, gap_s) in [(2, 1e-6), (3, 1e-6), (3, 1e-3)] {
        let times: Vec<f64> = [0.0, gap_s, 2.0 * gap_s].into_iter().chain((1..20).map(f64::from)).collect();
        let wanted = tracked(order, &times, fms(100, 0), LaggedMode::Own);
        for estimator in [EstimatorSpec::Kalman, EstimatorSpec::FixedLagKalman { lag: Span::Instants(0) }] {
            let got = tracked(order, &times, estimator, LaggedMode::Own);
            for row in 0..times.len() {
                let (Some(a), Some(b)) = (got.mean(row), wanted.mean(row)) else {
                    assert_eq!(got.mean(row).is_some(), wanted.mean(row).is_some(), "row {row}");
                    continue;
                };
                for i in 0..order {
                    let sd = wanted.cov_at(row, i, i).unwrap().sqrt();
                    // What the window itself loses: it knows the state of the first instants to 1e-16 of 1e11.
                    assert!((a[i] - b[i]).abs() < 1e-6 * sd, "order {order}, {gap_s} s, row {row}: {a:?} {b:?}");
                    let ratio = got.cov_at(row, i, i).unwrap().sqrt() / sd;
                    assert!((ratio - 1.0).abs() < 1e-6, "order {order}, {gap_s} s, row {row}: sd {ratio} times");
                }
            }
        }
    }
}

#[test]
fn smoother_of_a_window_bears_a_gap_of_a_day() {
    // After a day of silence the instants before it say nothing of those after it: the window is as good as one that starts there.
    let after: Vec<f64> = (0..8).map(|i| 86_400.0 + 0.05 * f64::from(i)).collect();
    let before: Vec<f64> = (0..8).map(|i| 0.05 * f64::from(i)).collect();
    let times: Vec<f64> = before.iter().chain(&after).copied().collect();
    for (order, lag) in [(2, 0), (2, 2)] {
        let got = tracked(order, &times, fms(60, lag), LaggedMode::Both);
        let lagged = got.lagged.as_ref().unwrap();
        for row in before.len() + order + lag..times.len() {
            let (mean, cov) = got.lagged(row).unwrap();
            let first = row - lag;
            assert_eq!(lagged.k[row], Some(first as u64));
            // Before the gap the velocity was known, so it is known to 86 400 m²/s² after it, against at most 8 from the few instants
            // since: that moves the estimate by 1e-4 of a mean of at most some twenty deviations.
            let alone = tracked(order, &times[..=row], fms(row + 1 - before.len(), lag), LaggedMode::Both);
            let (wanted, wanted_cov) = alone.lagged(row).unwrap();
            for i in 0..order {
                let entry = Trail::packed_index(order, i, i);
                let sd = wanted_cov[entry].sqrt();
                assert!(
                    sd > 0.0 && (mean[i] - wanted[i]).abs() < 1e-2 * sd,
                    "order {order}, row {row}: {mean:?} {wanted:?}"
                );
                assert!(
                    (cov[entry].sqrt() / sd - 1.0).abs() < 1e-3,
                    "order {order}, row {row}: {cov:?} {wanted_cov:?}"
                );
            }
        }
    }
}
