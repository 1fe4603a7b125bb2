//! No estimator allocates per step, whatever its storage is.

mod oracle;

use allocation_counter::measure;
use fixtrail_core::estimators::alpha_beta::{AlphaBeta, Design};
use fixtrail_core::estimators::augmented::{Hold, Sensed, Shown};
use fixtrail_core::estimators::diffuse::Diffuse;
use fixtrail_core::estimators::emvf::{Emvf, Options};
use fixtrail_core::estimators::fms::gain::Shape;
use fixtrail_core::estimators::fms::invariant::{InvariantWindow, Model};
use fixtrail_core::estimators::fms::newton::{ColdStart, MOST_ROWS, Newton, WindowModel};
use fixtrail_core::estimators::fms::varying::Varying;
use fixtrail_core::estimators::fms::{Align, posterior_nis};
use fixtrail_core::estimators::fosb::{FosbAxes, Gauss, Noise};
use fixtrail_core::estimators::gpb1::Gpb1;
use fixtrail_core::estimators::imm::Imm;
use fixtrail_core::estimators::kalman::{Robust, predict, update};
use fixtrail_core::estimators::lmmse::{Lmmse, Spread};
use fixtrail_core::estimators::lmvf::Lmvf;
use fixtrail_core::estimators::ufir::Ufir;
use fixtrail_core::graph::schedule::Chain;
use fixtrail_core::graph::{ARITY, Factor, Graph, Message};
use fixtrail_core::kernels::{self, Axes, Dense, FixedLag, Leap, Packed, Past, Sliding, Turn};
use fixtrail_core::models::{CoordinatedTurn, FmsPaper, Switching};
use fixtrail_core::sensors::range;
use fixtrail_core::{Belief, Matrix, Row, Transition, Vector};
use oracle::fixed::Heap;
use oracle::held::Filter;

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
fn imm_does_not_allocate() {
    let (paper, leap) = paper();
    let switching = Switching::new(&[20.0, 5.0, 1.0]).unwrap();
    let mut imm = Imm::start(&Belief { mean: Vector::zeros(), cov: Matrix::identity() }, &switching);
    assert_silent("imm", |k| {
        let prior = imm.mix(&switching.over(0.1 + k as f64 * 0.01)).predict(|j, x| Transition {
            next: leap.f * x,
            q: leap.q * (1.0 + j as f64),
            ..leap
        });
        let at = |x: &Vector<3>| Row { residual: row(&paper, k).residual - paper.c.dot(x), ..row(&paper, k) };
        let each = [0, 1, 2].map(|j| at(&prior.modes()[j].mean));
        let count = usize::from(k % 4 != 0);
        let combined = [at(&prior.belief().mean)];
        imm = prior.update(&combined[..count], &each[..3 * count], Robust::Huber(1.345), |_| {}).unwrap().0;
    });
}

#[test]
fn fosb_and_alpha_beta_do_not_allocate() {
    let vague = [Gauss { mean: 0.0, var: 4.0 }; 3];
    let mut fosb = FosbAxes::start(&vague, &vague);
    let mut walk = AlphaBeta::start(0.0, 0.0);
    assert_silent("fosb, alpha-beta", |k| {
        let dt = 0.1 + (k % 7) as f64 * 0.1;
        let z = Gauss { mean: (k as f64 * 0.3).sin(), var: 1.0 };
        fosb.predict(dt, &[Noise::Acceleration { q: 0.2 }; 3]).unwrap();
        fosb.step(dt, &[Noise::Speed { q11: 0.1, q33: 0.1 }; 3], &[z; 3]).unwrap();
        let design = Design::acceleration(1.0, dt, 0.2);
        for steady in [design.kalman(), design.fosb()] {
            walk.step(dt, z.mean, &steady.unwrap().gains()).unwrap();
        }
    });
}

#[test]
fn graphs_do_not_allocate() {
    let (paper, leap) = paper();
    let mut messages = [[Message::vacuous(); ARITY]; 12];
    assert_silent("graph", |k| {
        let factors: [Factor<3>; 12] = core::array::from_fn(|i| match (i, i % 2) {
            (0, _) => Factor::prior(0, Belief { mean: Vector::zeros(), cov: Matrix::identity() }),
            (i, 1) => Factor::observation(i / 2, &[row(&paper, k + i)]),
            (i, _) => Factor::transition(i / 2 - 1, i / 2, leap.f, leap.next, leap.q),
        });
        let mut graph = Graph::new(&factors, &mut messages).unwrap();
        graph.run(Chain::smoother(6)).unwrap();
        assert!(graph.belief(2).unwrap().is_some());
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
    for (window, lag) in [(10, 0), (10, 3), (40, 0), (40, 3)] {
        let mut held = Varying::<3, Heap>::new(window + 1).unwrap();
        assert_silent("varying", |k| {
            let mut rows = [row(&paper, k)];
            let count = usize::from(k % 4 != 0);
            held.push(&leap, &mut rows[..count]).unwrap();
            held.drop_front(held.len().saturating_sub(window));
            let joint = held.filtered(lag);
            assert!(k < 5 || posterior_nis(&joint.filter.unwrap(), &mut rows[..count]).is_some() == (count > 0));
        });
    }
}

#[test]
fn invariant_windows_do_not_allocate() {
    let (paper, leap) = paper();
    for (window, lag) in [(15, 5), (40, 5), (15, 0), (40, 0), (200, 0)] {
        for every in [usize::MAX, 9, 2] {
            let model = Model { a: &leap.f, w: &leap.q, b: &[paper.c], c: &[paper.c], r: &[paper.r] };
            let shape = Shape { window, lag, align: Align::Predicted };
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
fn kernels_do_not_allocate() {
    let (paper, leap) = paper();
    let start = Belief { mean: Vector::zeros(), cov: Matrix::identity() };
    let z = |k: usize| if k % 9 == 4 { f64::NAN } else { (k as f64 * 0.3).sin() };

    let (motion, mut chain) = (Leap::new(0.1, 0.5), kernels::Chain::of(&start));
    let mut axes = Axes { means: [chain.mean; 2], cov: chain.cov };
    let (given, mut dense) = (Dense::from(&leap), Packed::of(&start));
    let mut lagged = FixedLag::<3, 5>::new(&chain);
    let mut sliding = Sliding::new(&[[0.1; 3]; 15]);
    assert_silent("linear kernels", |k| {
        chain = chain.predict(&motion).checked_update(z(k), 1.0).unwrap().0;
        axes = axes.predict(&motion).update(&[z(k); 2], 1.0);
        let (next, s) = dense.predict(&given).measure(&paper.c.into(), z(k), paper.r);
        dense = next.checked(s).unwrap();
        lagged.push(&motion, 1.0, z(k));
        std::hint::black_box((lagged.mean(), lagged.cov(), sliding.push(z(k))));
    });

    let turning = Turn::new(&CoordinatedTurn::new([0.1; 2], 0.01).unwrap(), 0.1);
    let mut turn = Packed::of(&Belief { mean: Vector::<5>::zeros(), cov: Matrix::identity() });
    assert_silent("turn and range", |k| {
        let (next, s) = turn.predict(&turning).range(&[20.0, 30.0 * z(k % 4)], 36.0 + z(k), 0.1);
        turn = next.checked(s).unwrap();
    });

    let series: Vec<f64> = (0..100).map(z).collect();
    let (mut past, mut out) = (vec![Past::EMPTY; 100], vec![[0.0; 3]; 100]);
    assert_silent("series", |_| {
        kernels::series(&chain, &motion, 1.0, &series, &mut out);
        kernels::smooth(&chain, &motion, 1.0, &series, &mut past, &mut out);
    });
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

#[test]
fn filters_for_held_values_do_not_allocate() {
    // A turn that forgets, so that nothing leaves the range of numbers.
    let f = Matrix::<2, 2>::new(0.9, 0.3, -0.3, 0.9);
    let h = Matrix::<2, 2>::new(1.0, 0.0, 0.5, 1.0);
    let sensed = |x: &Vector<2>| Sensed { expected: h * x, h, r: Matrix::identity() };
    let belief = Belief { mean: Vector::repeat(1.0), cov: Matrix::<2, 2>::identity() };
    let first = sensed(&belief.mean);
    fn silent<F: Filter<2, 2>>(name: &str, mut held: F, f: Matrix<2, 2>, sensed: impl Fn(&Vector<2>) -> Sensed<2, 2>) {
        assert_silent(name, |k| {
            let leap = Transition { next: f * held.belief().mean, f, q: Matrix::identity() * 0.1 };
            let shown = Shown { y: Vector::repeat((k as f64 * 0.3).sin()), seen: [k % 5 != 0, k % 3 != 0] };
            held.take(&leap, &sensed(&leap.next), &shown, if k % 7 == 0 { 1.0 } else { 0.8 }).unwrap();
        });
    }
    for root in [false, true] {
        silent("lmvf", Lmvf::start(&belief, &belief.cov, &first, root), f, sensed);
    }
    let options = Options { range_mixture: true, ..Options::default() };
    silent("emvf", Emvf::start(&belief, &belief.cov, &first, options), f, sensed);
    for hold in [Hold::Paper, Hold::LastReceived] {
        for spread in [Spread::Unconditional, Spread::Conditional] {
            silent("lmmse", Lmmse::start(&belief, &first, hold, spread), f, sensed);
        }
        silent("gpb1", Gpb1::start(&belief, &first, hold), f, sensed);
    }
}
