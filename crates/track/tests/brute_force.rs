//! Every linear estimator against the joint Gaussian of the run, conditioned densely: through packets, link, tracker and trail.

mod support;

use fixtrail_track::spec::{Align, EstimatorSpec, Span};
use fixtrail_track::trackers::LaggedMode;
use std::collections::BTreeMap;
use support::oracle::random::{Family, Random, run};
use support::oracle::{Run, Start, Verdict};
use support::{Declared, Tally, fms, tracked};

/// Systems with a condition of up to about 1e6 lose that many of 16 digits on either side.
const LIMIT: f64 = 1e-9;

/// The smoothers' response to an unknown start squares that condition.
const SMOOTHED: f64 = 1e-8;

/// Random runs of every kind, each with the ways it can be declared.
fn cases(count: usize, seed: u128, prior: Option<bool>) -> Vec<(Run, Declared)> {
    let mut rng = Random::new(seed);
    (0..count)
        .map(|i| {
            let varying = rng.chance(0.4);
            let family = Family {
                len: rng.count(3, 7),
                n: rng.count(1, 4),
                q: rng.count(1, 3),
                p: 2 + i % 2,
                varying,
                prior: prior.unwrap_or(i % 2 == 0),
                loss: [0.0, 0.2, 0.4][i % 3],
                singular: true,
            };
            let declared = if varying || rng.chance(0.5) { Declared::Sequence } else { Declared::Invariant };
            (run(&mut rng, &family), declared)
        })
        .collect()
}

/// Prints what was seen and makes sure that it was something.
fn enough(name: &str, tally: &Tally, estimates: usize) {
    println!("{name}: {tally:?}");
    assert!(tally.estimates >= estimates, "{name}: {tally:?}");
    // Chance puts few systems near the threshold.
    assert!(tally.borderline * 20 < tally.estimates, "{name}: {tally:?}");
}

#[test]
fn kalman_equals_conditioning_on_the_past() {
    let mut tally = Tally::default();
    let mut nis_worst: f64 = 0.0;
    for (i, (run, declared)) in cases(300, 1, None).iter().enumerate() {
        let trail = tracked(run, *declared, EstimatorSpec::Kalman, LaggedMode::Own);
        assert_eq!(trail.len(), run.len());
        for k in 0..run.len() {
            let verdict = run.posterior(run.start(), 0..k + 1, k);
            tally.row(&trail, k, &verdict, &format!("run {i}, row {k}"), LIMIT);
            let Some(nis) = trail.nis[k] else { continue };
            if let Some((expected, dof)) = run.nis(run.start(), 0..k, k) {
                assert_eq!(trail.nis_dof[k] as usize, dof);
                nis_worst = nis_worst.max((nis - expected).abs() / expected.max(1.0));
            }
        }
    }
    enough("kalman", &tally, 1000);
    println!("nis {nis_worst:e}");
    assert!(nis_worst < LIMIT, "{nis_worst:e}");
}

#[test]
fn rts_equals_conditioning_on_all_data() {
    let mut tally = Tally::default();
    for (i, (run, declared)) in cases(300, 2, None).iter().enumerate() {
        for mode in [LaggedMode::Own, LaggedMode::Both] {
            let trail = tracked(run, *declared, EstimatorSpec::Rts, mode);
            assert_eq!(trail.len(), run.len());
            for k in 0..run.len() {
                let what = format!("run {i}, row {k}, {mode:?}");
                let smoothed = run.posterior(run.start(), 0..run.len(), k);
                if mode == LaggedMode::Own {
                    tally.row(&trail, k, &smoothed, &what, SMOOTHED);
                } else {
                    assert_eq!(trail.lagged.as_ref().unwrap().k[k], Some(k as u64));
                    tally.add(trail.lagged(k), &smoothed, &what, SMOOTHED);
                    tally.row(&trail, k, &run.posterior(run.start(), 0..k + 1, k), &what, LIMIT);
                }
            }
        }
    }
    enough("rts", &tally, 3000);
}

#[test]
fn fixed_lag_equals_conditioning_on_data_up_to_the_lag() {
    let mut tally = Tally::default();
    for (i, (run, declared)) in cases(150, 3, None).iter().enumerate() {
        for lag in 0..=run.len() {
            let estimator = EstimatorSpec::FixedLagKalman { lag: Span::Instants(lag) };
            let own = tracked(run, *declared, estimator, LaggedMode::Own);
            assert_eq!(own.len(), run.len());
            for k in 0..run.len() {
                let data = 0..(k + lag + 1).min(run.len());
                let what = format!("run {i}, lag {lag}, smoothed row {k}");
                assert_eq!(own.k[k], k as u64);
                tally.row(&own, k, &run.posterior(run.start(), data, k), &what, SMOOTHED);
            }
            let both = tracked(run, *declared, estimator, LaggedMode::Both);
            assert_eq!(both.len(), run.len());
            for k in 0..run.len() {
                let what = format!("run {i}, lag {lag}, row {k}");
                tally.row(&both, k, &run.posterior(run.start(), 0..k + 1, k), &what, LIMIT);
                assert_eq!(both.lagged.as_ref().unwrap().k[k], k.checked_sub(lag).map(|k| k as u64));
                if k >= lag {
                    let verdict = run.posterior(run.start(), 0..k + 1, k - lag);
                    tally.add(both.lagged(k), &verdict, &format!("{what}, lagged"), SMOOTHED);
                }
            }
        }
    }
    enough("fixed-lag-kalman", &tally, 5000);
}

fn check_fms(align: Align, seed: u128) -> Tally {
    let mut tally = Tally::default();
    for (i, (run, declared)) in cases(120, seed, None).iter().enumerate() {
        let most = |window: usize| if align == Align::Predicted { window } else { window - 1 };
        // The prior is no measurement of the window: it is not used.
        let mut known = BTreeMap::new();
        let mut verdict = |first: usize, end: usize, at: usize| {
            known.entry((first, end, at)).or_insert_with(|| run.posterior(Start::Unknown, first..end, at)).clone()
        };
        for window in 1..=run.len() + 1 {
            for lag in 0..=most(window) {
                let trail = tracked(run, *declared, fms(window, lag, align), LaggedMode::Both);
                let beyond = usize::from(align == Align::Predicted);
                assert_eq!(trail.len(), run.len() + beyond);
                for k in 0..trail.len() {
                    let end = if align == Align::Predicted { k } else { k + 1 };
                    let first = end.saturating_sub(window);
                    let what = format!("run {i} {declared:?}, window {window}, lag {lag}, {align:?}, row {k}");
                    tally.row(&trail, k, &verdict(first, end, k), &what, LIMIT);
                    assert_eq!(trail.lagged.as_ref().unwrap().k[k], k.checked_sub(lag).map(|k| k as u64), "{what}");
                    if k >= lag {
                        let verdict = verdict(first, end, k - lag);
                        tally.add(trail.lagged(k), &verdict, &format!("{what}, lagged"), LIMIT);
                    }
                }
            }
        }
    }
    tally
}

#[test]
fn fms_filtered_equals_least_squares_on_its_window() {
    enough("fms filtered", &check_fms(Align::Filtered, 4), 10_000);
}

#[test]
fn fms_predicted_equals_least_squares_on_its_window() {
    enough("fms predicted", &check_fms(Align::Predicted, 5), 10_000);
}

#[test]
fn fms_nis_equals_the_innovation_form() {
    let mut worst: f64 = 0.0;
    let mut compared = 0;
    for (run, declared) in &cases(200, 7, None) {
        for align in [Align::Filtered, Align::Predicted] {
            let window = 1 + run.len() / 2;
            let trail = tracked(run, *declared, fms(window, 0, align), LaggedMode::Own);
            for k in 0..run.len() {
                // The window without the instant's own rows predicts them.
                let first = if align == Align::Filtered { k + 1 } else { k }.saturating_sub(window);
                let expected = run.nis(Start::Unknown, first..k, k);
                match (trail.nis[k], expected) {
                    (Some(nis), Some((expected, dof))) => {
                        assert_eq!(trail.nis_dof[k] as usize, dof);
                        compared += 1;
                        worst = worst.max((nis - expected).abs() / expected.max(1.0));
                    }
                    // Data that determine themselves in part only: a statistic of the rest, or none.
                    (_, None) => {}
                    // Where the window's other rows say next to nothing of these, I − HPHᵀ has no digits left.
                    (None, Some((expected, _))) => assert!(expected < 1e-3, "row {k}: no nis, expected {expected}"),
                }
            }
        }
    }
    println!("nis: {worst:e} of {compared}");
    // The posterior form divides by I − HPHᵀ, whose pivots may be as small as 1e-10.
    assert!(compared > 500 && worst < 1e-6, "{worst:e} of {compared}");
}

#[test]
fn ufir_equals_least_squares_with_its_true_error_covariance() {
    let mut tally = Tally::default();
    for (i, (run, declared)) in cases(120, 8, None).iter().enumerate() {
        for window in 1..=run.len() + 1 {
            let estimator = EstimatorSpec::Ufir { window: Span::Instants(window) };
            let trail = tracked(run, *declared, estimator, LaggedMode::Own);
            assert_eq!(trail.len(), run.len());
            for k in 0..run.len() {
                let data = (k + 1).saturating_sub(window)..k + 1;
                let verdict = run.without_process_noise(data.clone(), k);
                // UFIR asks for the whole start of its window.
                let whole = run.without_process_noise(data.clone(), data.start);
                let verdict = if matches!(whole, Verdict::Undetermined) { Verdict::Undetermined } else { verdict };
                tally.row(&trail, k, &verdict, &format!("run {i}, window {window}, row {k}"), LIMIT);
            }
        }
    }
    enough("ufir", &tally, 1000);
}
