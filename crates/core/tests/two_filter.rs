//! The two-filter form of a window against combined elements and against the plain pass.

mod oracle;

use fixtrail_core::estimators::fms::element::Element;
use fixtrail_core::estimators::fms::gain::Shape;
use fixtrail_core::estimators::fms::invariant::{InvariantWindow, Model};
use fixtrail_core::estimators::fms::two_filter::{TwoFilter, inverse_of, take_row};
use fixtrail_core::estimators::fms::varying::Varying;
use fixtrail_core::estimators::fms::{Align, STACKS_FROM, TWO_FILTER_FROM};
use fixtrail_core::{Belief, Matrix, Row, Transition, Vector};
use nalgebra::DMatrix;
use oracle::fixed::{Heap, deviation, posterior, square};
use oracle::random::Random;

/// A random motion: F of spectral norm about `size`, Q of the given rank.
fn motion<const N: usize>(rng: &mut Random, size: f64, rank: usize) -> Transition<N> {
    let f = rng.matrix(N, N) * (0.4 / (N as f64).sqrt()) + DMatrix::identity(N, N) * 0.6;
    let q = rng.covariance(N, rank, 0.5);
    Transition { next: Vector::from_fn(|_, _| rng.normal()), f: square(&(f * size)), q: square(&q) }
}

/// The rows of one instant, each lost with the given probability.
fn rows<const N: usize>(rng: &mut Random, most: usize, lost: f64) -> Vec<Row<N>> {
    let all: Vec<Row<N>> = (0..most)
        .map(|_| Row {
            h: Vector::from_fn(|_, _| rng.normal()),
            residual: 5.0 * rng.normal(),
            var: 0.1 + rng.uniform(),
        })
        .collect();
    all.into_iter().filter(|_| !rng.chance(lost)).collect()
}

fn apart<const N: usize>(ours: &Option<Belief<N>>, reference: &Option<Belief<N>>, what: &str) -> f64 {
    assert_eq!(ours.is_some(), reference.is_some(), "{what}");
    ours.as_ref().zip(reference.as_ref()).map_or(0.0, |(ours, reference)| deviation(ours, &posterior(reference)))
}

/// The rows and then the leap of one instant.
fn take<const N: usize>(element: &mut Element<N>, rows: &[Row<N>], leap: &Transition<N>) {
    for row in rows {
        element.row(row);
    }
    element.leap(&leap.f, &leap.next, &leap.q);
}

fn elements_agree<const N: usize>(rng: &mut Random) -> f64 {
    let mut worst: f64 = 0.0;
    for size in [0.6, 1.0, 1.2] {
        for rank in [0, 1, N] {
            let (mut whole, mut combined) = (Element::<N>::identity(), Element::identity());
            for k in 0..8 * N {
                let (leap, rows) = (motion(rng, size, rank), rows(rng, 2, 0.3));
                take(&mut whole, &rows, &leap);
                combined = combined.combine(&Element::instant(&rows, Some(&leap))).expect("definite");
                let (a, b) = (whole.told(), combined.told());
                let (eta, j) = (b.eta.amax().max(1.0), b.j.amax().max(1.0));
                worst = worst.max((a.eta - b.eta).amax() / eta).max((a.j - b.j).amax() / j);
                if k > 2 * N {
                    let past = combined.told();
                    worst = worst.max(apart(
                        &whole.filtered(past, 1e-6),
                        &combined.filtered(past, 1e-6),
                        "what the data told twice",
                    ));
                }
            }
        }
    }
    worst
}

#[test]
fn an_instant_taken_row_by_row_is_an_element_combined() {
    let mut rng = Random::new(1);
    let mut worst = elements_agree::<1>(&mut rng).max(elements_agree::<2>(&mut rng)).max(elements_agree::<3>(&mut rng));
    worst = worst.max(elements_agree::<4>(&mut rng)).max(elements_agree::<6>(&mut rng));
    println!("{worst:e}");
    assert!(worst < 1e-10, "{worst:e}");
}

/// Worst deviation from the pass, and how many estimates there were.
fn against_the_pass<const N: usize>(rng: &mut Random, len: usize, lost: f64) -> (f64, usize) {
    let (mut worst, mut estimates): (f64, _) = (0.0, 0);
    for size in [0.8, 1.0, 1.15] {
        for rank in [0, 1, N] {
            let mut ours = Varying::<N, Heap>::new(len + 1).expect("there is room");
            let mut passed = Varying::<N, Heap>::new(1).expect("there is room");
            for k in 0..3 * len {
                let (leap, rows) = (motion(rng, size, rank), rows(rng, 2, lost));
                for window in [&mut ours, &mut passed] {
                    window.push(&leap, &mut rows.clone()).expect("there is room");
                    // Not always the same number of instants.
                    let most = len - usize::from(k % 7 == 3);
                    window.drop_front(window.len().saturating_sub(most));
                }
                let next = motion(rng, size, rank);
                let what = format!("{N} states, size {size}, rank {rank}, window {len}, loss {lost}, row {k}");
                for (a, b) in
                    [(ours.filtered(0), passed.filtered(0)), (ours.predicted(0, &next), passed.predicted(0, &next))]
                {
                    worst = worst.max(apart(&a.filter, &b.filter, &what));
                    assert!(worst < 1e-9, "{what}: {worst:e}");
                    assert_eq!(
                        (a.filter, a.filter.map_or_else(Matrix::zeros, |a| a.cov)),
                        (a.lagged, a.cross),
                        "{what}"
                    );
                    estimates += usize::from(a.filter.is_some());
                }
            }
        }
    }
    (worst, estimates)
}

#[test]
fn varying_windows_equal_the_pass() {
    let mut rng = Random::new(2);
    let (mut worst, mut estimates): (f64, _) = (0.0, 0);
    for lost in [0.0, 0.3, 0.6] {
        // Below the length of stacks what is not decided here is left to the pass itself.
        for len in [TWO_FILTER_FROM, 9, 15, STACKS_FROM - 1] {
            for (one, count) in [
                against_the_pass::<1>(&mut rng, len, lost),
                against_the_pass::<2>(&mut rng, len, lost),
                against_the_pass::<3>(&mut rng, len, lost),
                against_the_pass::<4>(&mut rng, len, lost),
                against_the_pass::<5>(&mut rng, len, lost),
                against_the_pass::<6>(&mut rng, len, lost),
            ] {
                worst = worst.max(one);
                estimates += count;
            }
        }
        let (one, count) = against_the_pass::<3>(&mut rng, STACKS_FROM + 10, lost);
        worst = worst.max(one);
        estimates += count;
    }
    println!("{worst:e} in {estimates} estimates");
    assert!(worst < 1e-9 && estimates > 10_000, "{worst:e} in {estimates} estimates");
}

/// A time-invariant window through losses that come and go, against the pass.
fn invariant_against_the_pass<const N: usize>(rng: &mut Random, leap: &Transition<N>, len: usize) -> f64 {
    let mut worst: f64 = 0.0;
    let b = [Vector::<N>::from_fn(|_, _| rng.normal())];
    let c: Vec<Vector<N>> = (0..2).map(|_| Vector::from_fn(|_, _| rng.normal())).collect();
    for align in [Align::Filtered, Align::Predicted] {
        let model = Model { a: &leap.f, w: &leap.q, b: &b, c: &c, r: &[0.3, 0.0, 0.0, 0.2] };
        let mut ours = InvariantWindow::<N, Heap>::new(&model, Shape { window: len, lag: 0, align }).expect("sound");
        let mut passed = Varying::<N, Heap>::new(1).expect("there is room");
        let mut arrive = *leap;
        for k in 0..5 * len {
            let lost = [0.0, 0.03, 0.4][k / len % 3];
            let z: Vec<Option<f64>> = (0..2).map(|_| (!rng.chance(lost)).then(|| 5.0 * rng.normal())).collect();
            let u = rng.normal();
            ours.push(&z, &[u]).expect("there is room");
            let mut rows: Vec<Row<N>> =
                (0..2).filter_map(|i| z[i].map(|z| Row { h: c[i], residual: z, var: [0.3, 0.2][i] })).collect();
            passed.push(&arrive, &mut rows).expect("there is room");
            passed.drop_front(passed.len().saturating_sub(len));
            arrive = Transition { next: b[0] * u, ..*leap };
            let expected = match align {
                Align::Filtered => passed.filtered(0),
                Align::Predicted => passed.predicted(0, &arrive),
            };
            let what = format!("{N} states, {align:?}, window {len}, row {k}");
            worst = worst.max(apart(&ours.estimate().filter, &expected.filter, &what));
            assert!(worst < 1e-9, "{what}: {worst:e}");
        }
    }
    worst
}

#[test]
fn invariant_windows_equal_the_pass() {
    let mut rng = Random::new(3);
    let mut worst: f64 = 0.0;
    for len in [4, 15, 70] {
        for size in [0.9, 1.05] {
            for rank in [1, 3] {
                let leap = motion::<1>(&mut rng, size, 1);
                worst = worst.max(invariant_against_the_pass(&mut rng, &leap, len));
                let leap = motion::<3>(&mut rng, size, rank);
                worst = worst.max(invariant_against_the_pass(&mut rng, &leap, len));
                let leap = motion::<6>(&mut rng, size, rank);
                worst = worst.max(invariant_against_the_pass(&mut rng, &leap, len));
            }
        }
    }
    println!("{worst:e}");
    assert!(worst < 1e-9, "{worst:e}");
}

#[test]
fn a_motion_that_forgets_leaves_the_estimate_to_others() {
    // Singular, and one whose inverse makes variances 100 times as large over each lost instant: the answers stay those of the pass.
    let mut rng = Random::new(4);
    let forgets = |left: f64| {
        let mut f = Matrix::<3, 3>::new(1.0, 0.4, 0.0, 0.0, 1.0, 0.4, 0.0, 0.0, left);
        f[(2, 1)] = 0.3 * left;
        Transition { next: Vector::from([0.1, -0.2, 0.3]), f, q: square(&rng.definite(3, 0.3)) }
    };
    let kinds = [0.0, 0.1].map(forgets);
    assert!(inverse_of(&kinds[0].f).is_none());
    for (kind, leap) in kinds.iter().enumerate() {
        for len in [10, STACKS_FROM + 5] {
            let mut worst = invariant_against_the_pass(&mut rng, leap, len);
            let mut ours = Varying::<3, Heap>::new(len + 1).expect("there is room");
            let mut passed = Varying::<3, Heap>::new(1).expect("there is room");
            for k in 0..6 * len {
                let rows = rows::<3>(&mut rng, 2, if k % 16 < 5 { 0.95 } else { 0.1 });
                for window in [&mut ours, &mut passed] {
                    window.push(leap, &mut rows.clone()).expect("there is room");
                    window.drop_front(window.len().saturating_sub(len));
                }
                let what = format!("kind {kind}, window {len}, row {k}");
                worst = worst.max(apart(&ours.filtered(0).filter, &passed.filtered(0).filter, &what));
            }
            println!("kind {kind}, window {len}: {worst:e}");
            assert!(worst < 1e-9, "kind {kind}, window {len}: {worst:e}");
        }
    }
}

#[test]
fn a_backward_filter_refuses_what_would_lose_digits() {
    // Its state doubles at each step back: after 10 leaps the covariance is over a million times the noise of the row.
    let leap = Transition { next: Vector::zeros(), f: Matrix::<1, 1>::new(0.5), q: Matrix::<1, 1>::new(1.0) };
    let inverse = inverse_of(&leap.f).expect("regular");
    let row = Row { h: Vector::from([1.0]), residual: 0.0, var: 1.0 };
    let taken = |leaps: usize| {
        let mut past = Element::identity();
        (0..leaps).for_each(|_| past.leap_back(&inverse, &leap.next, &leap.q));
        take_row(&mut past, &row).is_some()
    };
    assert_eq!([0, 9, 10, 20].map(taken), [true, true, false, false]);

    // Far from singular, but only eight digits of the inverse would be right.
    let near = Matrix::<2, 2>::new(1.0, 1.0, 1.0, 1.0 + 1e-8);
    assert!(inverse_of(&near).is_none());
    // Units are not condition.
    let units = Matrix::<2, 2>::new(1.0, 1e12, 0.0, 1.0);
    assert!(inverse_of(&units).is_some());
}

#[test]
fn a_window_refused_is_asked_for_again_when_it_has_passed() {
    let mut window = TwoFilter::<1, Heap>::new(4).expect("there is room");
    let mut asked = 0;
    for k in 0..12 {
        let mut refuse = |_, _: &mut Element<1>| {
            asked += 1;
            None
        };
        assert!(window.turn(4, &mut refuse).is_none() && window.is_empty(), "row {k}");
        window.push(|_| panic!("there is nothing to add to"));
        window.drop_front(1);
    }
    assert_eq!(asked, 3);
    assert!(window.turn(4, |_, _| Some(())).is_some());
    assert_eq!(window.len(), 4);
    window.push(|_| Some(()));
    window.drop_front(5);
    assert!(window.is_empty());

    // An instant that cannot be added empties the window too, until as many have come as it had.
    assert!(window.turn(4, |_, _| Some(())).is_some());
    window.push(|_| None);
    assert!(window.is_empty());
    for k in 0..4 {
        assert!(window.turn(4, |_, _| Some(())).is_none(), "row {k}");
        window.push(|_| Some(()));
    }
    assert!(window.turn(4, |_, _| Some(())).is_some());
}
