//! Positions of one moment against closed forms, dense algebra and chance.

use fixtrail_core::position::lateration::{self, Linear, Range, Rank};
use fixtrail_core::position::rss::to_range;
use fixtrail_core::position::rss_ml::{self, Strength, Strengths};
use fixtrail_core::position::tdoa::{self, Difference, Differences};
use fixtrail_core::position::{Location, Point};
use fixtrail_core::sensors::PathLoss;
use fixtrail_core::{Matrix, Vector};

const BOX: [[f64; 3]; 5] = [[0.0, 0.0, 3.0], [20.0, 0.0, 2.0], [20.0, 15.0, 3.5], [0.0, 15.0, 2.5], [9.0, 16.0, 0.5]];
const LAW: PathLoss = PathLoss { exponent: 2.7, at_1m_dbm: -41.0 };

/// Noise that is the same on every machine.
struct Chance(u64);

impl Chance {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 11) as f64 + 0.5) / (1u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        (-2.0 * self.uniform().ln()).sqrt() * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

/// Distance in space; a position of two axes stands at `height_m`, or on the anchors' level without one.
fn distance<const N: usize>(p: &Vector<N>, anchor: [f64; 3], height_m: Option<f64>) -> f64 {
    let mut square = (0..N).map(|i| (p[i] - anchor[i]).powi(2)).sum::<f64>();
    if let (2, Some(height)) = (N, height_m) {
        square += (anchor[2] - height).powi(2);
    }
    square.sqrt()
}

fn ranges<const N: usize>(p: &Vector<N>, anchors: &[[f64; 3]], height_m: Option<f64>, sd: f64) -> Vec<Range> {
    let at = |a: &[f64; 3]| Range { anchor_m: *a, range_m: distance(p, *a, height_m), var_m2: sd * sd };
    anchors.iter().map(at).collect()
}

fn differences<const N: usize>(p: &Vector<N>, anchors: &[[f64; 3]], height_m: Option<f64>) -> Vec<Difference> {
    let reference = distance(p, anchors[0], height_m);
    let at = |(i, a): (usize, &[f64; 3])| Difference {
        anchor_m: *a,
        difference_m: distance(p, *a, height_m) - reference,
        var_m2: 0.01 * (1.0 + i as f64),
    };
    anchors[1..].iter().enumerate().map(at).collect()
}

fn strengths<const N: usize>(p: &Vector<N>, anchors: &[[f64; 3]], height_m: Option<f64>) -> Vec<Strength> {
    let at = |a: &[f64; 3]| Strength { anchor_m: *a, rss_dbm: -41.0 - 27.0 * distance(p, *a, height_m).log10() };
    anchors.iter().map(at).collect()
}

fn unique<const N: usize>(location: &Location<N>) -> Point<N> {
    match location {
        Location::Unique(point) => *point,
        other => panic!("{other:?}"),
    }
}

/// Worst error of a unique position. Rounding of distances of 20 m times the dilution of these layouts is below 1e-13; the search ends
/// within 1e-10 of standard deviations near 0.1.
fn assert_at<const N: usize>(location: &Location<N>, p: &Vector<N>) {
    let point = unique(location);
    assert!((point.belief.mean - p).amax() < 1e-9, "{:?} instead of {p:?}", point.belief.mean);
    assert!(point.chi2 < 1e-15, "{:e}", point.chi2);
}

#[test]
fn exact_data_give_the_exact_position() {
    for (x, y, z) in [(4.0, 6.0, 1.2), (17.0, 2.0, 0.3), (25.0, 20.0, 1.0), (-3.0, 8.0, 0.0)] {
        let (plane, space) = (Vector::from([x, y]), Vector::from([x, y, z]));
        for height_m in [None, Some(z)] {
            assert_at(&lateration::locate(&ranges(&plane, &BOX, height_m, 0.1), height_m), &plane);
            let strengths = strengths(&plane, &BOX, height_m);
            assert_at(&rss_ml::locate(&Strengths { law: LAW, sd_db: 2.0, strengths: &strengths, height_m }), &plane);
            let data = Differences {
                reference_m: BOX[0],
                reference_var_m2: 0.02,
                differences: &differences(&plane, &BOX, height_m),
                height_m,
            };
            assert_at(&tdoa::locate(&data), &plane);
        }
        assert_at(&lateration::locate(&ranges(&space, &BOX, None, 0.1), None), &space);
    }
}

#[test]
fn linear_stages_take_a_known_height_as_stated() {
    let p = Vector::from([4.0, 6.0]);
    let linear = lateration::linear::<2>(&ranges(&p, &BOX, Some(1.2), 0.1), Some(1.2), Rank::EXACT);
    // Rounding of squares of 400 m² over twice the layout's half-width of 8 m is below 1e-13.
    assert!(matches!(linear, Linear::Unique(q) if (q - p).amax() < 1e-11), "{linear:?}");
    let data = Differences {
        reference_m: BOX[0],
        reference_var_m2: 0.02,
        differences: &differences(&p, &BOX, Some(1.2)),
        height_m: Some(1.2),
    };
    let reference_m = distance(&p, BOX[0], Some(1.2));
    let tdoa::Linear::Unique { position_m, reference_range_m } = tdoa::linear::<2>(&data) else { panic!("{data:?}") };
    // The same, diluted tenfold by the unknown distance.
    assert!((position_m - p).amax() < 1e-10 && (reference_range_m - reference_m).abs() < 1e-10, "{position_m:?}");
}

#[test]
fn time_differences_in_space_give_the_exact_position() {
    let anchors =
        [[0.0, 0.0, 9.0], [20.0, 0.0, 0.0], [20.0, 15.0, 8.0], [0.0, 15.0, 1.0], [9.0, 16.0, 5.5], [8.0, -4.0, 4.0]];
    let p = Vector::from([7.0, 6.0, 3.0]);
    let data = Differences {
        reference_m: anchors[0],
        reference_var_m2: 0.02,
        differences: &differences(&p, &anchors, None),
        height_m: None,
    };
    assert_at(&tdoa::locate(&data), &p);
}

#[test]
fn rss_ranges_are_unbiased_as_stated() {
    // Simpson over ten standard deviations of the noise: what is left out has weight 1e-23, the step of a tenth leaves no error above 1e-12.
    let (d, sd_db) = (12.0_f64, 4.53);
    let mean = |of: &dyn Fn(f64) -> f64| {
        let n = 2000;
        let sum: f64 = (0..=n)
            .map(|i| {
                let u = -10.0 + 20.0 * f64::from(i) / f64::from(n);
                let w = if i == 0 || i == n { 1.0 } else { 2.0 + 2.0 * f64::from(i % 2) };
                w * (-0.5 * u * u).exp() * of(-41.0 - 27.0 * d.log10() + sd_db * u)
            })
            .sum();
        sum * (20.0 / f64::from(n)) / 3.0 / std::f64::consts::TAU.sqrt()
    };
    let at = |rss: f64| to_range(LAW, rss, sd_db);
    let unbiased = mean(&|rss| at(rss).unbiased_m);
    assert!((unbiased / d - 1.0).abs() < 1e-9, "{unbiased}");
    let bias = mean(&|rss| at(rss).median_m) / d;
    assert!((bias / at(-60.0).median_bias() - 1.0).abs() < 1e-9, "{bias}");
    // The variance stated at the true distance is the one that the unbiased distances have; stated at the estimate it scales with it.
    let var = mean(&|rss| at(rss).unbiased_m.powi(2)) - unbiased * unbiased;
    let stated = d * d * at(-60.0).kappa.powi(2).exp_m1();
    assert!((var / stated - 1.0).abs() < 1e-8, "{var} {stated}");
    let one = at(-60.0);
    assert!((one.var_m2 / (one.unbiased_m.powi(2) * one.kappa.powi(2).exp_m1()) - 1.0).abs() < 1e-14);
    // As often too long as too short: at the median of the noise.
    assert!((at(-41.0 - 27.0 * d.log10()).median_m / d - 1.0).abs() < 1e-13);
}

#[test]
fn rss_variance_keeps_its_digits_at_little_noise() {
    let r = to_range(LAW, -60.0, 1e-6);
    // exp(κ²) − 1 = κ² (1 + κ²/2 + …) with κ² = 7e-15: all digits are those of κ².
    assert!((r.var_m2 / (r.unbiased_m * r.kappa).powi(2) - 1.0).abs() < 1e-13, "{}", r.var_m2);
}

#[test]
fn anchors_in_line_give_a_mirrored_pair() {
    let anchors = [[0.0, -1.0, 0.0], [1.0, 1.0, 0.0], [2.0, 3.0, 0.0], [3.0, 5.0, 0.0]];
    let p = Vector::from([3.95, 4.61]);
    let location = lateration::locate(&ranges(&p, &anchors, None, 0.1), None);
    let Location::Pair(pair) = location else { panic!("{location:?}") };
    // Mirrored at the line through (0, −1) along (1, 2)/√5: 2 c (c·(p − o)) − (p − o).
    let (o, c) = (Vector::from([0.0, -1.0]), Vector::from([1.0, 2.0]) / 5f64.sqrt());
    let mirrored = o + c * (2.0 * c.dot(&(p - o))) - (p - o);
    for (hint, expected) in [(Vector::from([10.0, 0.0]), p), (Vector::from([-10.0, 10.0]), mirrored)] {
        let point = location.near(&hint).unwrap();
        // As for a unique position; the baseline of 7 m, 1 m away, dilutes tenfold.
        assert!((point.belief.mean - expected).amax() < 1e-8, "{:?} near {hint:?}", point.belief.mean);
    }
    assert!((pair[0].chi2 - pair[1].chi2).abs() < 1e-15);
}

#[test]
fn anchors_in_a_plane_give_a_mirrored_pair() {
    let anchors = [[0.0, 0.0, 3.0], [10.0, 0.0, 3.0], [10.0, 8.0, 3.0], [0.0, 8.0, 3.0]];
    let p = Vector::from([3.3, 4.6, 1.3]);
    let location = lateration::locate(&ranges(&p, &anchors, None, 0.1), None);
    assert!(matches!(location, Location::Pair(_)), "{location:?}");
    // As a unique position; heights 1.7 m below four anchors 5 m away are diluted tenfold.
    let below = location.near(&Vector::from([5.0, 5.0, 0.0])).unwrap();
    assert!((below.belief.mean - p).amax() < 1e-8, "{:?}", below.belief.mean);
    let above = location.near(&Vector::from([5.0, 5.0, 9.0])).unwrap();
    assert!((above.belief.mean - Vector::from([3.3, 4.6, 4.7])).amax() < 1e-8, "{:?}", above.belief.mean);
}

#[test]
fn what_is_not_determined_has_no_position() {
    let range = |x: f64, y: f64, range_m: f64| Range { anchor_m: [x, y, 0.0], range_m, var_m2: 0.01 };
    let one = [range(1.0, 2.0, 3.0)];
    assert_eq!(lateration::locate::<2>(&one, None), Location::NotDetermined);
    assert_eq!(lateration::locate::<2>(&[], None), Location::NotDetermined);
    assert_eq!(lateration::locate::<2>(&[one[0], one[0], one[0]], None), Location::NotDetermined);
    // Circles that do not reach each other; within each other.
    assert_eq!(lateration::locate::<2>(&[range(0.0, 1.0, 4.1), range(10.0, 0.0, 4.7)], None), Location::NoIntersection);
    assert_eq!(
        lateration::locate::<2>(&[range(0.0, 1.0, 20.0), range(10.0, 0.0, 4.7)], None),
        Location::NoIntersection
    );
    // A line of anchors in space.
    let line: Vec<Range> = (0..4).map(|i| range(4.0 * f64::from(i), 0.0, 5.0 + f64::from(i))).collect();
    assert_eq!(lateration::locate::<3>(&line, None), Location::NotDetermined);
    let p = Vector::from([4.0, 6.0]);
    let all = differences(&p, &BOX, None);
    let data = |count: usize| Differences {
        reference_m: BOX[0],
        reference_var_m2: 0.02,
        differences: &all[..count],
        height_m: None,
    };
    assert_eq!(tdoa::locate::<2>(&data(0)), Location::NotDetermined);
    assert_eq!(tdoa::locate::<2>(&data(1)), Location::NotDetermined);
    // A difference larger than the anchors' distance has no hyperbola.
    let far = [Difference { difference_m: 30.0, ..all[0] }, Difference { difference_m: -30.0, ..all[1] }];
    assert_eq!(tdoa::locate::<2>(&Differences { differences: &far, ..data(0) }), Location::NoIntersection);
    let strengths = strengths(&p, &BOX[..1], None);
    let data = Strengths { law: LAW, sd_db: 2.0, strengths: &strengths, height_m: None };
    assert_eq!(rss_ml::locate::<2>(&data), Location::NotDetermined);
}

#[test]
fn two_time_differences_leave_every_position_that_fits() {
    // Behind an anchor two hyperbolas cut twice, between the anchors once.
    let anchors = [[0.0, 0.0, 0.0], [20.0, 0.0, 0.0], [0.0, 20.0, 0.0]];
    let mut pairs = 0;
    for p in [[6.0, 7.0], [-4.0, -5.0], [-6.0, 2.0], [30.0, -4.0], [-3.0, -9.0]].map(Vector::from) {
        let all = differences(&p, &anchors, None);
        let data = Differences { reference_m: anchors[0], reference_var_m2: 0.02, differences: &all, height_m: None };
        let location = tdoa::locate::<2>(&data);
        let points = match location {
            Location::Unique(point) => vec![point],
            Location::Pair(pair) => pair.to_vec(),
            other => panic!("{other:?} at {p:?}"),
        };
        pairs += points.len() - 1;
        // Rounding of 30 m, diluted up to a hundredfold behind the anchors.
        assert!(points.iter().any(|q| (q.belief.mean - p).amax() < 1e-8), "{points:?} at {p:?}");
        assert!(points.iter().all(|q| q.chi2 < 1e-15), "{points:?} at {p:?}");
    }
    assert!(pairs >= 1, "no pair at all");
}

#[test]
fn time_difference_covariance_is_that_of_the_full_noise() {
    let p = Vector::from([4.0, 6.0]);
    let mut all = differences(&p, &BOX, Some(1.0));
    for (d, off) in all.iter_mut().zip([0.1, -0.05, 0.2, -0.15]) {
        d.difference_m += off;
    }
    let data = Differences { reference_m: BOX[0], reference_var_m2: 0.03, differences: &all, height_m: Some(1.0) };
    let point = unique(&tdoa::locate::<2>(&data));
    let x = point.belief.mean;
    let r = Matrix::<4, 4>::from_fn(|i, j| 0.03 + if i == j { all[i].var_m2 } else { 0.0 });
    let w = r.try_inverse().unwrap();
    let towards = |a: [f64; 3]| (x - Vector::from([a[0], a[1]])) / distance(&x, a, Some(1.0));
    let j = Matrix::<4, 2>::from_fn(|i, k| (towards(all[i].anchor_m) - towards(BOX[0]))[k]);
    let e = Vector::<4>::from_fn(|i, _| {
        all[i].difference_m - distance(&x, all[i].anchor_m, Some(1.0)) + distance(&x, BOX[0], Some(1.0))
    });
    let information = j.transpose() * w * j;
    // Dense inverses of well-conditioned 4 × 4 and 2 × 2 matrices keep 14 digits.
    assert!((information.try_inverse().unwrap() - point.belief.cov).amax() < 1e-12 * point.belief.cov.amax());
    assert!(((e.transpose() * w * e)[0] - point.chi2).abs() < 1e-12 * point.chi2);
    // At the minimum: within 1e-10 standard deviations, in units of the information's square root.
    let slope = j.transpose() * w * e;
    assert!((point.belief.cov * slope).amax() < 1e-9, "{slope:?}");
}

#[test]
fn lateration_is_as_good_as_it_says() {
    let p = Vector::from([4.0, 6.0]);
    let mut chance = Chance(7);
    let (runs, sd) = (4000, 0.15);
    let (mut nees, mut outside) = (0.0, 0);
    for _ in 0..runs {
        let mut data = ranges(&p, &BOX[..4], None, sd);
        for r in &mut data {
            r.range_m += sd * chance.normal();
        }
        let point = unique(&lateration::locate(&data, None));
        let e = point.belief.mean - p;
        let square = e.dot(&(point.belief.cov.try_inverse().unwrap() * e));
        nees += square / f64::from(runs);
        outside += i32::from(square > 5.991);
    }
    // χ² of 2 degrees of freedom has variance 4: the mean of 4000 stays within 4 √(4/4000) = 0.13 of 2, and 5 % ± 4 √(0.05·0.95/4000) = 1.4 %
    // lie outside of 5.991. Curvature adds (sd/distance)² < 0.002.
    assert!((nees - 2.0).abs() < 0.13, "NEES {nees}");
    assert!((f64::from(outside) / f64::from(runs) - 0.05).abs() < 0.014, "{outside}");
}

#[test]
fn nearly_collinear_anchors_are_as_good_as_collinear_ones() {
    // A baseline of 20 m with its middle off by 1 cm: the linear stage alone trusts the centimetre and is off by more than the room.
    let anchors = [[0.0, 0.0, 0.0], [10.0, 0.01, 0.0], [20.0, 0.0, 0.0]];
    let p = Vector::from([7.0, 6.0]);
    let hint = Vector::from([5.0, 3.0]);
    let mut chance = Chance(11);
    let (runs, sd) = (1000, 0.1);
    let (mut by_linear, mut by_pair) = (0.0, 0.0);
    for _ in 0..runs {
        let mut data = ranges(&p, &anchors, None, sd);
        for r in &mut data {
            r.range_m += sd * chance.normal();
        }
        let Linear::Unique(linear) = lateration::linear(&data, None, Rank::EXACT) else { panic!("in line") };
        by_linear += (linear - p).norm_squared() / f64::from(runs);
        let location = lateration::locate(&data, None);
        assert!(matches!(location, Location::Pair(_)), "{location:?}");
        by_pair += (location.near(&hint).unwrap().belief.mean - p).norm_squared() / f64::from(runs);
    }
    // The bound is sd² tr((JᵀJ)⁻¹) = 0.117² m² for these directions; 1000 runs scatter by 4 √(2/1000) = 18 % of the mean square at most.
    let mut information = Matrix::<2, 2>::zeros();
    for a in anchors {
        let u = (p - Vector::from([a[0], a[1]])) / distance(&p, a, None);
        information += u * u.transpose() / (sd * sd);
    }
    let bound = information.try_inverse().unwrap().trace();
    assert!((by_pair / bound - 1.0).abs() < 0.18, "RMS {} m, bound {} m", by_pair.sqrt(), bound.sqrt());
    assert!(by_linear.sqrt() > 10.0, "RMS {} m by the linear stage alone", by_linear.sqrt());
}

#[test]
fn a_side_that_fits_decisively_better_needs_no_hint() {
    // Off by a metre, ten standard deviations: still too narrow for the linear stage, and the other side does not fit.
    let anchors = [[0.0, 0.0, 0.0], [10.0, 1.0, 0.0], [20.0, 0.0, 0.0]];
    let p = Vector::from([7.0, 6.0]);
    let mut chance = Chance(13);
    for _ in 0..200 {
        let mut data = ranges(&p, &anchors, None, 0.1);
        for r in &mut data {
            r.range_m += 0.1 * chance.normal();
        }
        let error = (unique(&lateration::locate(&data, None)).belief.mean - p).norm();
        // Five times the bound of 0.12 m.
        assert!(error < 0.6, "{error} m");
    }
}

#[test]
fn strengths_of_an_unknown_level_give_the_level_too() {
    let p = Vector::from([4.0, 6.0]);
    let strengths = strengths(&p, &BOX, Some(1.0));
    let wrong = PathLoss { at_1m_dbm: -50.0, ..LAW };
    let data = Strengths { law: wrong, sd_db: 2.0, strengths: &strengths, height_m: Some(1.0) };
    let point = rss_ml::gauss_newton(&data, 2, &Vector::from([8.0, 8.0, -50.0])).unwrap();
    // As for a unique position; the level in dB has a standard deviation of some dB.
    assert!((point.belief.mean - Vector::from([4.0, 6.0, -41.0])).amax() < 1e-8, "{:?}", point.belief.mean);
    // Rows (−27/ln 10 (p − a)/d², 1) of 2 dB; a dense inverse of 3 × 3 keeps 12 digits.
    let j = Matrix::<5, 3>::from_fn(|i, k| {
        let d = distance(&p, BOX[i], Some(1.0));
        if k == 2 { 1.0 } else { -27.0 / std::f64::consts::LN_10 * (p[k] - BOX[i][k]) / (d * d) }
    });
    let cov = (j.transpose() * j).try_inverse().unwrap() * 4.0;
    // The position is off by 1e-10 standard deviations.
    assert!((cov - point.belief.cov).amax() < 1e-8 * cov.amax(), "{:?}", point.belief.cov);
    let level_known = Strengths { law: LAW, ..data };
    let known = rss_ml::gauss_newton(&level_known, 2, &Vector::from([8.0, 8.0])).unwrap();
    assert!(known.belief.cov.trace() < point.belief.cov.fixed_view::<2, 2>(0, 0).trace());
}

#[test]
fn large_residuals_still_end_at_the_minimum() {
    // Gauss–Newton alone swung about such minima, or crept towards them: it stopped off by 3e-7 of the position, or gave up.
    let mut chance = Chance(17);
    let (mut settled, mut worst): (_, f64) = (0, 0.0);
    for _ in 0..300 {
        let anchors: Vec<[f64; 3]> = (0..5).map(|_| [30.0 * chance.uniform(), 30.0 * chance.uniform(), 0.0]).collect();
        let p = Vector::from([3.0 + 24.0 * chance.uniform(), 3.0 + 24.0 * chance.uniform()]);
        let mut strengths = strengths(&p, &anchors, None);
        for s in &mut strengths {
            s.rss_dbm += 2.0 * chance.normal();
        }
        let data = Strengths { law: LAW, sd_db: 2.0, strengths: &strengths, height_m: None };
        let Some(point) = rss_ml::gauss_newton(&data, 2, &Vector::from([p[0], p[1], -41.0])) else { continue };
        settled += 1;
        let x = point.belief.mean;
        let mut slope = Vector::<3>::zeros();
        for s in &strengths {
            let d = distance(&Vector::from([x[0], x[1]]), s.anchor_m, None);
            let residual = s.rss_dbm - (x[2] - 27.0 * d.log10());
            let along = -27.0 / std::f64::consts::LN_10 / (d * d);
            slope +=
                Vector::from([along * (x[0] - s.anchor_m[0]), along * (x[1] - s.anchor_m[1]), 1.0]) * residual / 4.0;
        }
        worst = worst.max(slope.dot(&(point.belief.cov * slope)).sqrt());
    }
    // The search ends within 1e-10 standard deviations, or where rounding of 60 dB over 2 dB in the gradient is: 1e-13 diluted.
    assert!(worst < 1e-9, "{worst:e} standard deviations");
    // Some have no minimum: the level and the distance grow together.
    assert!(settled >= 270, "{settled} of 300 settled");
}
