//! Accounts of papers against the values of an independent implementation at equal settings (2026, numpy; the means and standard
//! deviations of its experiments are given with each), and their independence from threads.

use fixtrail_sim::papers::{Account, Effort, Entry, Measured, Paper, Printed, Verdict};
use std::sync::LazyLock;

const QUICK: Effort = Effort { runs: None, quick: true, seed: 1 };

/// A value of the independent implementation: mean, standard deviation of one experiment, number of experiments, digits printed.
struct Other {
    mean: f64,
    spread: f64,
    experiments: f64,
    digits: i32,
}

impl Other {
    /// Standard errors between theirs and ours.
    fn deviation(&self, ours: &Measured) -> f64 {
        let rounding = 10_f64.powi(-self.digits) / 12_f64.sqrt();
        let var = ours.se.powi(2) + self.spread.powi(2) / self.experiments + rounding.powi(2);
        (ours.mean - self.mean) / var.sqrt()
    }
}

static FMS: LazyLock<Account> = LazyLock::new(|| Paper::Fms.account(&QUICK, &|| {}));
// 60 runs, to see a variance of 0.1 m² too much in the truth of path 2.
static FOSB: LazyLock<Account> = LazyLock::new(|| Paper::Fosb.account(&Effort { runs: Some(60), ..QUICK }, &|| {}));

fn entry<'a>(account: &'a Account, what: &str) -> &'a Entry {
    let is = |e: &&Entry| match &e.printed {
        Printed::Claim(claim) => claim == what,
        _ => e.what == what,
    };
    account.entries.iter().find(is).unwrap_or_else(|| panic!("no entry `{what}`"))
}

fn literal(entry: &Entry) -> &Measured {
    entry.literal.as_ref().expect("a literal reading")
}

fn reading(entry: &Entry) -> &Measured {
    &entry.reading.as_ref().expect("another reading").measured
}

/// Checks that a number is within 4 standard errors of theirs, and returns how many there are between them.
fn agree(what: &str, ours: &Measured, other: Other) -> f64 {
    let z = other.deviation(ours).abs();
    assert!(z < 4.0, "{what}: ours {ours}, theirs {} ({z:.1} standard errors)", other.mean);
    z
}

/// Checks that 99 % of the deviations of a table are within 3 standard errors: all but one of its numbers at most.
fn mostly_near(deviations: &[f64]) {
    let far = deviations.iter().filter(|z| **z >= 3.0).count();
    assert!(far <= deviations.len().div_ceil(100), "{far} of {}: {deviations:?}", deviations.len());
}

#[test]
fn table_2_of_the_finite_memory_paper_agrees_with_an_independent_implementation() {
    let mut deviations = Vec::new();
    // 20 experiments of 30 runs of 800 steps.
    let of_mean = [
        ("FMS smoother", [0.0060, 0.0059, 0.0059], [0.0002, 0.0002, 0.0002]),
        ("FMS filter", [0.0475, 0.0440, 0.0407], [0.0010, 0.0009, 0.0010]),
        ("Kalman filter", [0.0500, 0.0457, 0.0419], [0.0011, 0.0009, 0.0010]),
    ];
    for (estimator, means, spreads) in of_mean {
        for (i, shape) in ["step", "ramp", "triangle"].into_iter().enumerate() {
            let what = format!("position error, {estimator}, {shape}, m");
            let other = Other { mean: means[i], spread: spreads[i], experiments: 20.0, digits: 4 };
            deviations.push(agree(&what, reading(entry(&FMS, &what)), other));
        }
    }
    // Theirs is analytic; the shape is one draw of many.
    for (estimator, mean) in [("FMS smoother", 0.0060), ("FMS filter", 0.0445), ("Kalman filter", 0.0482)] {
        let what = format!("position error, {estimator}, random, m");
        let spread = reading(entry(&FMS, &what)).spread;
        deviations.push(agree(&what, reading(entry(&FMS, &what)), Other { mean, spread, experiments: 1.0, digits: 4 }));
    }
    // The letter of the text; their spread is not on record, that of ours stands for it.
    let rms = [
        ("FMS smoother", [0.0409, 0.0409, 0.0409], 4),
        ("FMS filter", [0.272, 0.270, 0.267], 3),
        ("Kalman filter", [0.270, 0.267, 0.265], 3),
    ];
    for (estimator, means, digits) in rms {
        for (i, shape) in ["step", "ramp", "triangle"].into_iter().enumerate() {
            let what = format!("position error, {estimator}, {shape}, m");
            let ours = literal(entry(&FMS, &what));
            deviations.push(agree(
                &what,
                ours,
                Other { mean: means[i], spread: ours.spread, experiments: 20.0, digits },
            ));
        }
    }
    mostly_near(&deviations);
}

#[test]
fn claims_of_the_finite_memory_paper_come_out_as_the_independent_implementation_has_them() {
    // Root mean square error after a jump of 0.2 m/s²: 0.346 m against 0.360 m, from some hundred runs.
    let after = entry(&FMS, "FMS filter outperforms Kalman filter when the acceleration suddenly changes, step");
    agree("after a jump", literal(after), Other { mean: 0.346 / 0.360, spread: 0.0, experiments: 1.0, digits: 2 });
    assert_eq!(after.verdict, Verdict::Reproduced);
    let converges = entry(&FMS, "at constant acceleration the error of the FMS filter converges much faster");
    assert_eq!(literal(converges).mean, 15.0);
    assert!(converges.reason.contains("the Kalman filter's after 57"), "{}", converges.reason);
    let deviations = [("FMS smoother", 0.04128), ("FMS filter", 0.27582), ("Kalman filter", 0.2745)];
    for (estimator, sd) in deviations {
        let bound = entry(&FMS, &format!("position error, {estimator}, step, m")).bound.clone().expect("a bound");
        assert!((bound.value - sd).abs() < 6e-5, "{estimator}: {}", bound.value);
    }
    for (claim, verdict) in [
        ("Π is positive definite", Verdict::Contradicted),
        ("the lagged state is A^−d x_i − Ξ̃ U − Λ̃ W", Verdict::Contradicted),
        ("M ≥ n is enough for that", Verdict::Contradicted),
        ("filter and smoother are unbiased", Verdict::Reproduced),
        ("one gain serves all windows (time-invariance)", Verdict::Reproduced),
        ("flops of the fixed-lag Kalman smoother, 4n³ + 8n² + 6n + 1", Verdict::NotReproducible),
    ] {
        assert_eq!(entry(&FMS, claim).verdict, verdict, "{claim}");
    }
}

#[test]
fn error_distances_of_the_fosb_paper_agree_with_an_independent_implementation() {
    let mut deviations = Vec::new();
    let estimators = ["no tracking", "Kalman filter", "FOSB"];
    // 400 runs of 10 000 samples (path 3: 200); the spread of theirs is that of ours.
    let letter = |e: &Entry| *literal(e);
    let other = |e: &Entry| *reading(e);
    type Reading = fn(&Entry) -> Measured;
    let rows: [(&str, Reading, [f64; 6], f64); 5] = [
        ("path 1", letter, [8.58, 5.41, 4.69, 2.96, 4.57, 2.88], 400.0),
        ("path 1", other, [8.58, 5.41, 4.77, 3.01, 4.68, 2.96], 400.0),
        ("path 2", letter, [8.58, 5.41, 4.63, 2.92, 4.50, 2.84], 400.0),
        ("path 3", letter, [4.55, 2.87, 2.97, 1.86, 2.97, 1.84], 200.0),
        ("path 3", other, [4.55, 2.87, 3.00, 1.87, 3.02, 1.87], 200.0),
    ];
    for (path, of, means, experiments) in rows {
        for (i, mean) in means.into_iter().enumerate() {
            let what = format!("{path}, {}, {} % of errors below, m", estimators[i / 2], [90, 60][i % 2]);
            let ours = of(entry(&FOSB, &what));
            deviations.push(agree(&what, &ours, Other { mean, spread: ours.spread, experiments, digits: 2 }));
        }
    }
    mostly_near(&deviations);
}

#[test]
fn claims_of_the_fosb_paper_come_out_as_the_independent_implementation_has_them() {
    let near = |claim: &str, value: f64, tolerance: f64| {
        let ours = literal(entry(&FOSB, claim)).mean;
        assert!((ours - value).abs() < tolerance, "{claim}: {ours}, expected {value}");
    };
    near("FOSB is slightly better than the Kalman filter, path 1", 0.9735, 0.004);
    near("the two filters become alike as Δ decreases, path 1", 0.9995, 0.0005);
    near("the two filters become alike as Δ decreases, path 2", 0.971, 0.004);
    // The first variance of theirs is not on record: 0.3 %.
    near("the speed estimate of step 11", 382.0, 1.5);
    near("its oscillation comes from its being non-causal", 0.14, 0.01);
    let start = entry(&FOSB, "too short a Δ slows the initial convergence of FOSB");
    assert!((literal(start).mean - 19.0 / 5.3).abs() < 0.2, "{}", start.reason);
    assert!(start.reason.contains("takes 32 s"), "{}", start.reason);
    // The peak after a wall is 9 % higher, 2.82 m against 2.58 m, over 1000 runs of 500 samples.
    let peak = entry(&FOSB, "its corner effect (the peaks) is slightly larger");
    assert!((reading(peak).mean - 2.82 / 2.58).abs() < 0.02, "{}", reading(peak));
    for (claim, verdict) in [
        ("the two filters become alike as Δ decreases, path 1", Verdict::Reproduced),
        ("the two filters become alike as Δ decreases, path 2", Verdict::Contradicted),
        ("the location is smoothed: it uses one future observation", Verdict::Contradicted),
        ("the Kalman filter's errors are a reference bound", Verdict::UnderReading),
        ("a smaller Δ gives smaller errors, path 1", Verdict::Reproduced),
        ("a smaller Δ gives smaller errors, path 2", Verdict::Reproduced),
        ("the smaller σ gives larger errors", Verdict::NotReproducible),
    ] {
        assert_eq!(entry(&FOSB, claim).verdict, verdict, "{claim}");
    }
}

#[test]
fn accounts_do_not_depend_on_the_number_of_threads_and_report_every_piece() {
    use std::sync::atomic::{AtomicUsize, Ordering};
    let few = Effort { runs: Some(3), quick: true, seed: 5 };
    for paper in Paper::ALL {
        let with = |threads: usize| {
            let done = AtomicUsize::new(0);
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            let account = pool.install(|| {
                paper.account(&few, &|| {
                    done.fetch_add(1, Ordering::Relaxed);
                })
            });
            assert_eq!(done.into_inner(), paper.pieces(&few), "{}", paper.name());
            account
        };
        assert_eq!(with(1), with(2), "{}", paper.name());
    }
}
