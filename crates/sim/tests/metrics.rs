//! Scores against cases worked out by hand, and against errors drawn from the claimed distribution.

use fixtrail_sim::metrics::{Consistency, Kind, Score, kinematic, score};
use fixtrail_track::fix::{Estimate, Fix, Sink, Status};
use fixtrail_track::layout::Layout;
use fixtrail_track::target::TargetTrail;
use fixtrail_track::trail::Trail;
use fixtrail_track::truth::{TargetTruth, TruthPoint};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

/// One row of a test trail: instant, mean (`None`: unobservable), variances, NIS.
type TestRow<'a> = (f64, Option<&'a [f64]>, &'a [f64], Option<f64>);

fn trail(n: usize, rows: &[TestRow<'_>]) -> Trail {
    let mut trail = Trail::new(n, false);
    for (k, (t_s, mean, vars, nis)) in rows.iter().enumerate() {
        let mut cov = vec![0.0; n * n];
        for (i, v) in vars.iter().enumerate() {
            cov[i * n + i] = *v;
        }
        trail.fix(&Fix {
            k: k as u64,
            t_s: Some(*t_s),
            estimate: mean.map(|mean| Estimate { mean, cov: &cov }),
            status: if mean.is_some() { Status::Updated } else { Status::Unobservable },
            nis: *nis,
            nis_dof: if nis.is_some() { 2 } else { 0 },
            lagged: None,
        });
    }
    trail
}

fn named(target: Option<&str>, trail: Trail) -> TargetTrail {
    TargetTrail { target: target.map(str::to_owned), trail, link: Default::default() }
}

fn truth(target: Option<&str>, points: &[(f64, f64, f64)]) -> TargetTruth {
    let point = |&(t_s, x, y): &(f64, f64, f64)| TruthPoint { t_s, position_m: [Some(x), Some(y), None] };
    TargetTruth { target: target.map(str::to_owned), points: points.iter().map(point).collect() }
}

fn scored(trail: Trail, layout: &Layout, noise: &[f64], truth: &[TargetTruth], kind: Kind) -> Score {
    score(&[named(None, trail)], layout, &kinematic(layout, noise), truth, kind).unwrap()
}

fn close(got: f64, wanted: f64) {
    // All hand-computed values are of size 1; rounding is a few times 1e-16.
    assert!((got - wanted).abs() < 1e-12, "got {got}, wanted {wanted}");
}

#[test]
fn filter_is_predicted_from_its_last_fix_with_the_motions_noise() {
    let layout = Layout::kinematic(2, 2, &[]);
    let t = trail(
        4,
        &[(0.0, Some(&[0.0, 0.0, 1.0, 2.0]), &[1.0, 1.0, 0.25, 0.25], None), (10.0, Some(&[9.0; 4]), &[1.0; 4], None)],
    );
    // At 2 s: (2, 4); truth (5, 8) is 5 m away. Variance 1 + 4·0.25 + 3·2³/3 = 10 on each axis, so NEES = 25/10.
    let s = scored(t, &layout, &[3.0, 3.0], &[truth(Some("a"), &[(2.0, 5.0, 8.0)])], Kind::Filter);
    let row = &s.targets[0].row;
    close(row.errors.unwrap().rmse_m, 5.0);
    close(row.errors.unwrap().bias_m[0], -3.0);
    close(row.errors.unwrap().bias_m[1], -4.0);
    close(row.mean_nees.unwrap(), 2.5);
    assert_eq!((row.instants, row.missing, row.nees_dof, row.coverage95), (1, 0, 2, Some(1.0)));
    // The ellipse is a circle of radius sqrt(10 · 5.991…).
    close(s.targets[0].instants[0].radius95_m.unwrap(), (10.0_f64 * 5.991_464_547_107_979).sqrt());
}

#[test]
fn acceleration_carries_the_position_and_noise_has_its_fifth_power() {
    let layout = Layout::kinematic(3, 1, &[]);
    let t = trail(3, &[(0.0, Some(&[1.0, 2.0, 3.0]), &[0.0, 0.0, 0.0], None)]);
    // At 2 s: 1 + 2·2 + 3·2 = 11; variance 5·2⁵/20 = 8; truth 15: NEES 16/8 on one axis.
    let truth =
        TargetTruth { target: None, points: vec![TruthPoint { t_s: 2.0, position_m: [Some(15.0), None, None] }] };
    let row = scored(t, &layout, &[5.0], &[truth], Kind::Filter).overall;
    close(row.errors.unwrap().max_m, 4.0);
    close(row.mean_nees.unwrap(), 2.0);
    assert_eq!(row.nees_dof, 1);
}

#[test]
fn smoother_is_interpolated_by_hermite_with_velocity_and_linearly_without() {
    let with = Layout::kinematic(2, 2, &[]);
    let t = trail(
        4,
        &[(0.0, Some(&[0.0, 0.0, 1.0, 0.0]), &[1.0; 4], None), (2.0, Some(&[2.0, 0.0, -1.0, 0.0]), &[3.0; 4], None)],
    );
    // Hermite at the middle of [0, 2]: (0 + 2)/2 + 2·(1 − (−1))/8 = 1.5; variance (1 + 3)/2 = 2. Truth (1.5, 2): NEES 4/2.
    let row = scored(t, &with, &[], &[truth(None, &[(1.0, 1.5, 2.0)])], Kind::Smoother).overall;
    close(row.errors.unwrap().mean_m, 2.0);
    close(row.mean_nees.unwrap(), 2.0);

    let without = Layout::kinematic(1, 2, &[]);
    let rows: [TestRow; 2] = [(0.0, Some(&[0.0, 0.0]), &[1.0; 2], None), (2.0, Some(&[2.0, 4.0]), &[1.0; 2], None)];
    let at = [truth(None, &[(0.5, 0.5, 1.0), (3.0, 2.0, 4.0)])];
    let row = scored(trail(2, &rows), &without, &[], &at, Kind::Smoother).overall;
    close(row.errors.unwrap().max_m, 0.0); // The second instant is after the last fix: held.
    let row = scored(trail(2, &rows), &without, &[], &at, Kind::Filter).overall;
    close(row.errors.unwrap().max_m, 1.25_f64.sqrt()); // Held at (0, 0) while the truth is at (0.5, 1).
}

/// Position variance `a` after a state known exactly and `b` before another, by conditioning the joint Gaussian of the chain
/// `p' = v, v' = noise`.
fn pinned_variance(psd: f64, a: f64, b: f64) -> f64 {
    let noise = |dt: f64| [psd * dt.powi(3) / 3.0, psd * dt * dt / 2.0, psd * dt];
    let [p, c, v] = noise(a);
    // What the second fix sees: F Q(a) Fᵀ + Q(b), and its covariance with the position in between.
    let [qp, qc, qv] = noise(b);
    let (s11, s12, s22) = (p + 2.0 * b * c + b * b * v + qp, c + b * v + qc, v + qv);
    let (k1, k2) = (p + b * c, c);
    p - (s22 * k1 * k1 - 2.0 * s12 * k1 * k2 + s11 * k2 * k2) / (s11 * s22 - s12 * s12)
}

#[test]
fn smoother_between_two_fixes_is_as_uncertain_as_the_noise_between_them() {
    let layout = Layout::kinematic(2, 2, &[]);
    let t = trail(4, &[(0.0, Some(&[0.0; 4]), &[0.0; 4], None), (2.0, Some(&[0.0; 4]), &[0.0; 4], None)]);
    for at in [0.5, 1.0, 1.7] {
        let row = scored(t.clone(), &layout, &[3.0, 3.0], &[truth(None, &[(at, 0.1, 0.0)])], Kind::Smoother).overall;
        close(row.mean_nees.unwrap() * pinned_variance(3.0, at, 2.0 - at), 0.01);
    }
}

#[test]
fn instants_before_the_first_fix_or_unobservable_are_missing() {
    let layout = Layout::kinematic(1, 2, &[]);
    let rows: [TestRow; 3] =
        [(1.0, Some(&[0.0, 0.0]), &[1.0; 2], None), (2.0, None, &[], None), (3.0, Some(&[0.0, 0.0]), &[1.0; 2], None)];
    let mut t = truth(None, &[(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.5, 0.0, 0.0), (2.5, 0.0, 0.0), (3.0, 0.0, 0.0)]);
    t.points.push(TruthPoint { t_s: 4.0, position_m: [Some(1.0), None, None] });
    let counts = |kind| {
        let row = scored(trail(2, &rows), &layout, &[], &[t.clone()], kind).overall;
        (row.instants, row.missing, row.incomplete)
    };
    assert_eq!(counts(Kind::Filter), (3, 2, 1)); // 0.0 and 2.5 are missing.
    assert_eq!(counts(Kind::Smoother), (2, 3, 1)); // So is 1.5: its right neighbour is unobservable.
}

#[test]
fn percentiles_and_nees_with_correlation_match_hand_computation() {
    let layout = Layout::kinematic(1, 2, &[]);
    let mut t = Trail::new(2, false);
    let cov = [2.0, 1.0, 1.0, 2.0];
    t.fix(&Fix {
        k: 0,
        t_s: Some(0.0),
        estimate: Some(Estimate { mean: &[0.0, 0.0], cov: &cov }),
        status: Status::Updated,
        nis: None,
        nis_dof: 0,
        lagged: None,
    });
    // Errors 1, 2, 3, 4, 5 along (1, 1)/√2, an eigenvector of the covariance with eigenvalue 3: NEES = e²/3.
    let h = 0.5_f64.sqrt();
    let points: Vec<_> = (1..=5).map(|i| (f64::from(i), f64::from(i) * h, f64::from(i) * h)).collect();
    let row = scored(t, &layout, &[], &[truth(None, &points)], Kind::Filter).overall;
    let e = row.errors.unwrap();
    close(e.rmse_m, 11.0_f64.sqrt());
    close(e.mean_m, 3.0);
    close(e.p50_m, 3.0);
    close(e.p60_m, 3.4); // position 0.6 · 4 = 2.4
    close(e.p90_m, 4.6);
    close(e.p95_m, 4.8);
    close(row.mean_nees.unwrap(), 11.0 / 3.0);
    close(row.coverage95.unwrap(), 0.8); // 25/3 alone is above 5.99.
}

#[test]
fn height_enters_the_three_dimensional_error_only() {
    let layout = Layout::kinematic(1, 3, &[]);
    let t = trail(3, &[(0.0, Some(&[3.0, 4.0, 12.0]), &[1.0; 3], None)]);
    let point = TruthPoint { t_s: 0.0, position_m: [Some(0.0), Some(0.0), Some(0.0)] };
    let truth = TargetTruth { target: None, points: vec![point] };
    let e = scored(t, &layout, &[], &[truth], Kind::Filter).overall.errors.unwrap();
    close(e.rmse_m, 5.0);
    close(e.rmse_3d_m.unwrap(), 13.0);
}

/// A trail whose errors are drawn from `claimed_sd · scale`; NIS from chi-square of 2 degrees of freedom.
fn gaussian(scale: f64, n: usize) -> Score {
    let mut rng = Pcg64::new(42, 1);
    let mut draw = || -> f64 { StandardNormal.sample(&mut rng) };
    let layout = Layout::kinematic(1, 2, &[]);
    let mut t = Trail::new(2, false);
    let mut points = Vec::new();
    for k in 0..n {
        // P = L Lᵀ with L = [[1, 0], [0.5, 2]].
        let (a, b) = (draw(), draw());
        let mean = [scale * a, scale * (0.5 * a + 2.0 * b)];
        t.fix(&Fix {
            k: k as u64,
            t_s: Some(k as f64),
            estimate: Some(Estimate { mean: &mean, cov: &[1.0, 0.5, 0.5, 4.25] }),
            status: Status::Updated,
            nis: Some(draw().powi(2) + draw().powi(2)),
            nis_dof: 2,
            lagged: None,
        });
        points.push((k as f64, 0.0, 0.0));
    }
    scored(t, &layout, &[], &[truth(None, &points)], Kind::Filter)
}

#[test]
fn errors_as_claimed_are_judged_consistent() {
    let n = 20_000;
    let row = gaussian(1.0, n).overall;
    // Mean NEES has sd 2/sqrt(n) = 0.0141, coverage sqrt(0.05·0.95/n) = 1.54e-3, the NIS ratio 1/sqrt(n) = 7.1e-3.
    assert!((row.mean_nees.unwrap() - 2.0).abs() < 4.0 * 0.0141, "{:?}", row.mean_nees);
    assert!((row.coverage95.unwrap() - 0.95).abs() < 4.0 * 1.54e-3, "{:?}", row.coverage95);
    let nis = row.nis.unwrap();
    assert!((nis.ratio - 1.0).abs() < 4.0 * 7.1e-3, "{}", nis.ratio);
    assert_eq!((nis.instants, nis.dof), (n, 2 * n));
    assert!((nis.band95.1 - (1.0 + 1.96 * 7.07e-3)).abs() < 1e-4, "{:?}", nis.band95);
    assert_eq!(row.consistency, Consistency::Consistent);
    assert_eq!(row.verdict, "consistent: the true position is inside the claimed 95 % ellipse in 95 % of instants");
}

#[test]
fn errors_twice_as_large_as_claimed_are_over_confident() {
    let row = gaussian(2.0, 20_000).overall;
    // P(outside) = exp(−5.991/(2·4)) = 0.05^(1/4) = 0.473, sd 3.5e-3.
    assert!((1.0 - row.coverage95.unwrap() - 0.473).abs() < 4.0 * 3.5e-3, "{:?}", row.coverage95);
    assert_eq!(row.consistency, Consistency::OverConfident);
    assert_eq!(row.verdict, "over-confident: the true position leaves the claimed 95 % ellipse in 47 % of instants");
}

#[test]
fn errors_half_as_large_as_claimed_are_under_confident() {
    let row = gaussian(0.5, 20_000).overall;
    assert_eq!(row.consistency, Consistency::UnderConfident);
    assert_eq!(row.verdict, "under-confident: squared errors are 0.25 times what is claimed");
}

#[test]
fn instants_are_outside_exactly_when_the_error_exceeds_the_radius() {
    let s = gaussian(1.3, 2000);
    let instants = &s.targets[0].instants;
    assert!(instants.iter().all(|i| i.inside95() == (i.error_m().unwrap() <= i.radius95_m.unwrap())));
    assert!(instants.iter().any(|i| !i.inside95()));
}

#[test]
fn certainty_that_is_wrong_is_over_confident_without_a_mean_nees() {
    let layout = Layout::kinematic(1, 2, &[]);
    let t = trail(2, &[(0.0, Some(&[0.0, 0.0]), &[0.0, 0.0], None)]);
    let row = scored(t, &layout, &[], &[truth(None, &[(0.0, 1.0, 0.0)])], Kind::Filter).overall;
    assert_eq!((row.mean_nees, row.coverage95, row.consistency), (None, Some(0.0), Consistency::OverConfident));
}

#[test]
fn targets_are_matched_by_id_and_the_rest_reported() {
    let layout = Layout::kinematic(1, 2, &[]);
    let one = |at: f64| trail(2, &[(0.0, Some(&[at, 0.0]), &[1.0; 2], Some(1.0))]);
    let trails = [named(Some("a"), one(0.0)), named(Some("b"), one(3.0)), named(Some("c"), one(9.0))];
    let points = [(0.0, 0.0, 0.0)];
    let truths = [truth(Some("b"), &points), truth(Some("a"), &points), truth(Some("d"), &points)];
    let s = score(&trails, &layout, &kinematic(&layout, &[]), &truths, Kind::Filter).unwrap();
    let errors: Vec<_> = s.targets.iter().map(|t| (t.target.as_deref(), t.row.errors.unwrap().max_m)).collect();
    assert_eq!(errors, [(Some("a"), 0.0), (Some("b"), 3.0)]);
    assert_eq!(s.without_truth, [Some("c".to_owned())]);
    assert_eq!(s.without_trail, [Some("d".to_owned())]);
    close(s.overall.errors.unwrap().rmse_m, 4.5_f64.sqrt());
    assert_eq!(s.overall.nis.unwrap().instants, 2);
}

#[test]
fn nothing_in_common_is_an_error() {
    let layout = Layout::kinematic(1, 2, &[]);
    let t = [named(Some("a"), trail(2, &[(0.0, Some(&[0.0, 0.0]), &[1.0; 2], None)]))];
    let other = [truth(Some("b"), &[(0.0, 0.0, 0.0)])];
    assert_eq!(
        score(&t, &layout, &kinematic(&layout, &[]), &other, Kind::Filter).unwrap_err(),
        "the trail and the truth have no target in common: the trail has `a`, the truth `b`"
    );
    let linear = Layout::linear(2);
    assert!(score(&t, &linear, &kinematic(&linear, &[]), &other, Kind::Filter).unwrap_err().contains("linear"));
}

#[test]
fn truth_outside_the_trail_alone_is_not_judged() {
    let layout = Layout::kinematic(1, 2, &[]);
    let t = trail(2, &[(5.0, Some(&[0.0, 0.0]), &[1.0; 2], None)]);
    let row = scored(t, &layout, &[], &[truth(None, &[(0.0, 1.0, 0.0)])], Kind::Filter).overall;
    assert_eq!((row.instants, row.missing, row.errors, row.consistency), (0, 1, None, Consistency::NotJudged));
}
