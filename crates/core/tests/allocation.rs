//! No estimator allocates per step, whatever its storage is.

mod oracle;

use allocation_counter::measure;
use fixtrail_core::estimators::diffuse::Diffuse;
use fixtrail_core::estimators::fms::gain::Shape;
use fixtrail_core::estimators::fms::invariant::{InvariantWindow, Model};
use fixtrail_core::estimators::fms::newton::{ColdStart, MOST_ROWS, Newton, WindowModel};
use fixtrail_core::estimators::fms::varying::Varying;
use fixtrail_core::estimators::fms::{Align, posterior_nis};
use fixtrail_core::estimators::kalman::{Robust, predict, update};
use fixtrail_core::estimators::ufir::Ufir;
use fixtrail_core::models::FmsPaper;
use fixtrail_core::sensors::range;
use fixtrail_core::{Belief, Matrix, Row, Transition, Vector};
use oracle::fixed::Heap;

/// Runs 200 steps to warm up and counts the allocations of 400 more.
fn assert_silent(name: &str, mut step: impl FnMut(usize)) {
    (0..200).for_each(&mut step);
    let counted = measure(|| (200..600).for_each(&mut step));
    assert_eq!(counted.count_total, 0, "{name}: {counted:?}");
}

fn paper() -> (FmsPaper, Transition<3>) {
    let paper = FmsPaper::new(2.0);
    let motion = paper.motion();
    (paper, Transition { next: Vector::zeros(), f: motion.a, q: motion.q })
}

fn row(paper: &FmsPaper, k: usize) -> Row<3> {
    Row { h: paper.c, residual: (k as f64 * 0.3).sin(), var: paper.r }
}

#[test]
fn the_counter_counts() {
    assert!(measure(|| drop(std::hint::black_box(vec![1, 2, 3]))).count_total > 0);
}

#[test]
fn kalman_does_not_allocate() {
    let (paper, leap) = paper();
    let mut belief = Belief { mean: Vector::zeros(), cov: Matrix::identity() };
    assert_silent("kalman", |k| {
        let prior = predict(&belief, &Transition { next: leap.f * belief.mean, ..leap });
        let mut row = row(&paper, k);
        row.residual -= row.h.dot(&prior.mean);
        belief = update(&prior, &[row], Robust::Gate(9.0)).unwrap().0;
    });
}

#[test]
fn diffuse_does_not_allocate() {
    let (paper, leap) = paper();
    let mut pass = Diffuse::<3>::start();
    assert_silent("diffuse", |k| {
        pass.leap(&leap.f, &leap.next, &leap.q);
        if k % 50 == 0 {
            pass.mark_lag();
        }
        pass.update(&row(&paper, k)).unwrap();
        assert!(k < 5 || pass.solve().filter.is_some());
    });
}

#[test]
fn varying_windows_do_not_allocate() {
    let (paper, leap) = paper();
    for window in [10, 40] {
        let mut held = Varying::<3, Heap>::new(window + 1).unwrap();
        assert_silent("varying", |k| {
            let mut rows = [row(&paper, k)];
            let count = usize::from(k % 4 != 0);
            held.push(&leap, &mut rows[..count]).unwrap();
            held.drop_front(held.len().saturating_sub(window));
            let joint = held.filtered(3);
            assert!(k < 5 || posterior_nis(&joint.filter.unwrap(), &mut rows[..count]).is_some() == (count > 0));
        });
    }
}

#[test]
fn invariant_windows_do_not_allocate() {
    let (paper, leap) = paper();
    for window in [15, 40] {
        for every in [usize::MAX, 9, 2] {
            let model = Model { a: &leap.f, w: &leap.q, b: &[paper.c], c: &[paper.c], r: &[paper.r] };
            let shape = Shape { window, lag: 5, align: Align::Predicted };
            let mut held = InvariantWindow::<3, Heap>::new(&model, shape).unwrap();
            assert_silent("invariant", |k| {
                let z = (k % every != 1).then_some((k as f64 * 0.3).sin());
                held.push(&[z], &[0.1]).unwrap();
                assert!(k < 8 || held.estimate().lagged.is_some());
            });
        }
    }
}

#[test]
fn ufir_does_not_allocate() {
    let (paper, leap) = paper();
    let mut held = Ufir::<3, Heap>::new(21).unwrap();
    assert_silent("ufir", |k| {
        held.push(&leap, &mut [row(&paper, k)]).unwrap();
        held.drop_front(held.len().saturating_sub(20));
        assert!(k < 3 || held.estimate().is_some());
    });
}

/// A walk past three anchors; instant `i` of the window is time `first + i`.
struct Walk {
    first: usize,
}

impl WindowModel<4> for Walk {
    fn leap(&mut self, _i: usize, x: &Vector<4>) -> Transition<4> {
        let f = Matrix::<4, 4>::from_fn(|i, j| if i == j || j == i + 2 { 1.0 } else { 0.0 });
        Transition { next: f * x, f, q: Matrix::identity() * 0.01 }
    }

    fn rows(&mut self, i: usize, x: &Vector<4>, out: &mut [Row<4>; MOST_ROWS]) -> usize {
        let t = (self.first + i) as f64 * 0.1;
        let truth = Vector::from([t.cos() * 5.0, t.sin() * 5.0, 0.0, 0.0]);
        for (out, anchor) in out.iter_mut().zip([[9.0, 9.0, 0.0], [-9.0, 9.0, 0.0], [0.0, -9.0, 0.0]]) {
            let measured = -range(&truth, 2, anchor, None, 0.0, 1.0).residual;
            *out = range(x, 2, anchor, None, measured, 0.01);
        }
        3
    }
}

#[test]
fn newton_does_not_allocate() {
    let mut newton = Newton::<4, Heap>::new(8).unwrap();
    let cold = ColdStart { guess: Vector::zeros(), spread: Vector::repeat(10.0) };
    assert_silent("newton", |k| {
        newton.drop_front(1);
        let joint = newton.solve(&mut Walk { first: k }, 8, Some(4), &cold).unwrap();
        assert!(joint.filter.is_some() && joint.lagged.is_some());
    });
}
