//! Gauss–Newton windows: linear ones equal the exact pass.

mod oracle;

use fixtrail_core::estimators::fms::newton::{ColdStart, MOST_ROWS, Newton, WindowModel};
use fixtrail_core::estimators::fms::varying::Varying;
use fixtrail_core::{Row, Transition, Vector, sensors};
use oracle::Run;
use oracle::fixed::{Heap, deviation, leap, posterior, rows};
use oracle::random::{Family, Random, run};

/// A linear run as a nonlinear model would see it.
struct Linear<'a> {
    run: &'a Run,
    first: usize,
}

impl<const N: usize> WindowModel<N> for Linear<'_> {
    fn leap(&mut self, i: usize, x: &Vector<N>) -> Transition<N> {
        let mut leap = leap(Some(&self.run.instants[self.first + i - 1]));
        leap.next += leap.f * x;
        leap
    }

    fn rows(&mut self, i: usize, x: &Vector<N>, out: &mut [Row<N>; MOST_ROWS]) -> usize {
        let rows = rows::<N>(&self.run.instants[self.first + i]);
        for (out, row) in out.iter_mut().zip(&rows) {
            *out = sensors::linear(&row.h, x, row.residual, row.var);
        }
        rows.len()
    }
}

fn check<const N: usize>(rng: &mut Random, worst: &mut f64, compared: &mut usize) {
    let family =
        Family { len: 14, n: N, q: rng.count(1, 3), p: 2, varying: true, prior: false, loss: 0.2, singular: false };
    let run = run(rng, &family);
    let (window, lag) = (6, 2);
    let mut newton = Newton::<N, Heap>::new(window).unwrap();
    let mut exact = Varying::<N, Heap>::new(window + 1).unwrap();
    let cold = ColdStart { guess: Vector::zeros(), spread: Vector::repeat(100.0) };
    for k in 0..run.len() {
        let arrive = leap(k.checked_sub(1).map(|k| &run.instants[k]));
        exact.push(&arrive, &mut rows(&run.instants[k])).unwrap();
        if exact.len() > window {
            exact.drop_front(1);
            newton.drop_front(1);
        }
        let len = exact.len();
        let mut model = Linear { run: &run, first: k + 1 - len };
        let joint = newton.solve(&mut model, len, len.checked_sub(lag + 1), &cold).unwrap();
        let expected = exact.filtered(lag);
        for (ours, truth) in [(joint.filter, expected.filter), (joint.lagged, expected.lagged)] {
            if let (Some(ours), Some(truth)) = (&ours, &truth) {
                *worst = worst.max(deviation(ours, &posterior(truth)));
                *compared += 1;
            }
            // It asks for the whole trajectory, the pass only for the two states; it never knows more.
            assert!(ours.is_none() || truth.is_some(), "row {k}");
            assert!(ours.is_some() == truth.is_some() || k < N, "row {k}: {ours:?}, expected {truth:?}");
        }
    }
}

#[test]
fn linear_windows_through_newton_equal_the_exact_pass() {
    let mut rng = Random::new(1);
    let (mut worst, mut compared) = (0.0, 0);
    for _ in 0..40 {
        check::<1>(&mut rng, &mut worst, &mut compared);
        check::<2>(&mut rng, &mut worst, &mut compared);
        check::<3>(&mut rng, &mut worst, &mut compared);
    }
    println!("{worst:e} of {compared}");
    // One more iteration from a converged nominal moves by rounding; random systems condition it by up to 1e6.
    assert!(worst < 1e-9 && compared > 1000, "{worst:e} of {compared}");
}
