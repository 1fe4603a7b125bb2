//! What holds for every system: covariances are symmetric to the bit and positive semidefinite, whatever the units.

mod oracle;

use fixtrail_core::estimators::diffuse::{Diffuse, Joint};
use fixtrail_core::estimators::fms::Align;
use fixtrail_core::estimators::fms::gain::Shape;
use fixtrail_core::estimators::fms::invariant::{InvariantWindow, Model};
use fixtrail_core::estimators::fms::varying::Varying;
use fixtrail_core::estimators::kalman::{Robust, predict, update};
use fixtrail_core::estimators::smoother::{Arrive, Forward, smooth};
use fixtrail_core::estimators::ufir::Ufir;
use fixtrail_core::{Belief, Matrix, Row, Vector};
use nalgebra::DMatrix;
use oracle::Run;
use oracle::fixed::{Heap, columns_of, leap, noise, row_major, rows, rows_of, square};
use oracle::random::{Family, Random, run};

/// A random run in units between 1e-9 and 1e8 for states and measurements.
fn scaled_run(rng: &mut Random, n: usize, len: usize) -> Run {
    let family =
        Family { len, n, q: rng.count(1, 3), p: 3, varying: false, prior: true, loss: 0.2, singular: rng.chance(0.5) };
    let mut out = run(rng, &family);
    let unit = |rng: &mut Random| 10f64.powf(-9.0 + 17.0 * rng.uniform());
    let d = DMatrix::from_diagonal(&nalgebra::DVector::from_fn(n, |_, _| unit(rng)));
    let inverse = d.map(|v| if v == 0.0 { 0.0 } else { 1.0 / v });
    let e = DMatrix::from_diagonal(&nalgebra::DVector::from_fn(family.q, |_, _| unit(rng)));
    for at in &mut out.instants {
        at.a = &d * &at.a * &inverse;
        at.b = &d * &at.b;
        at.g = &d * &at.g;
        at.c = &e * &at.c * &inverse;
        at.r = &e * &at.r * &e;
        at.r = (&at.r + at.r.transpose()) * 0.5;
        for (i, z) in at.z.iter_mut().enumerate() {
            *z = z.map(|z| z * e[(i, i)]);
        }
    }
    out.prior = out.prior.map(|(mean, cov)| {
        let cov = &d * cov * &d;
        (&d * mean, (&cov + cov.transpose()) * 0.5)
    });
    out
}

#[derive(Default, Debug)]
struct Seen {
    count: usize,
    /// Smallest eigenvalue over the trace.
    lowest: f64,
    /// The same of the correlations: units do not hide the small states behind the large ones.
    lowest_scaled: f64,
}

impl Seen {
    fn check<const N: usize>(&mut self, belief: &Belief<N>, what: &str) {
        self.count += 1;
        assert_eq!(belief.cov, belief.cov.transpose(), "{what}: not symmetric");
        // Units out of the way: the correlations must be those of a covariance.
        let sd = belief.cov.diagonal().map(f64::sqrt);
        assert!(sd.iter().all(|s| s.is_finite()), "{what}: variances {}", belief.cov.diagonal());
        let correlation = DMatrix::from_fn(N, N, |i, j| match sd[i] * sd[j] {
            0.0 => belief.cov[(i, j)],
            product => belief.cov[(i, j)] / product,
        });
        self.lowest_scaled = self.lowest_scaled.min(lowest(correlation));
        self.lowest = self.lowest.min(lowest(DMatrix::from_fn(N, N, |i, j| belief.cov[(i, j)])));
    }

    fn joint<const N: usize>(&mut self, joint: &Joint<N>, what: &str) {
        for belief in [&joint.filter, &joint.lagged].into_iter().flatten() {
            self.check(belief, what);
        }
    }
}

fn lowest(m: DMatrix<f64>) -> f64 {
    match m.trace() {
        0.0 => 0.0,
        trace => m.symmetric_eigenvalues().min() / trace,
    }
}

fn check<const N: usize>(rng: &mut Random, seen: &mut [Seen; 6]) {
    let len = 40;
    let run = scaled_run(rng, N, len);
    let [kalman, pass, windows, invariant, ufir, smoother] = seen;
    let (mean, cov) = run.prior.as_ref().expect("asked for");
    let mut belief = Belief { mean: Vector::from_fn(|i, _| mean[i]), cov: square(cov) };
    let at = &run.instants[0];
    let (a, w) = (square(&at.a), noise(at));
    let (b, c, r) = (columns_of(&at.b), rows_of(&at.c), row_major(&at.r));
    let model = Model { a: &a, w: &w, b: &b, c: &c, r: &r };
    let shape = Shape { window: 32, lag: 3, align: Align::Filtered };
    let mut held = InvariantWindow::<N, Heap>::new(&model, shape).expect("a sound model");
    let mut stacked = Varying::<N, Heap>::new(33).expect("there is room");
    let mut square_window = Ufir::<N, Heap>::new(33).expect("there is room");
    let mut diffuse = Diffuse::<N>::start();
    let mut forward = [Forward::<N>::start(None), Forward::start(Some(&belief))];
    let mut instants = [Vec::new(), Vec::new()];
    let mut all_rows: Vec<Row<N>> = Vec::new();
    for k in 0..len {
        let what = format!("{N} states, row {k}");
        let here = &run.instants[k];
        let arrive = leap(k.checked_sub(1).map(|k| &run.instants[k]));
        let rows = rows::<N>(here);
        if k > 0 {
            let mut leap = arrive;
            leap.next += leap.f * belief.mean;
            belief = predict(&belief, &leap);
            kalman.check(&belief, &what);
            diffuse.leap(&arrive.f, &arrive.next, &arrive.q);
        }
        let mut at_prior = rows.clone();
        at_prior.iter_mut().for_each(|row| row.residual -= row.h.dot(&belief.mean));
        belief = update(&belief, &at_prior, Robust::None).expect("definite").0;
        kalman.check(&belief, &what);
        if k == 2 {
            diffuse.mark_lag();
        }
        for row in &rows {
            diffuse.update(row).expect("definite");
        }
        pass.joint(&diffuse.solve(), &what);
        held.push(&here.z, &here.u).expect("there is room");
        invariant.joint(&held.estimate(), &what);
        stacked.push(&arrive, &mut rows.clone()).expect("there is room");
        stacked.drop_front(stacked.len().saturating_sub(32));
        windows.joint(&stacked.filtered(3), &what);
        square_window.push(&arrive, &mut rows.clone()).expect("there is room");
        square_window.drop_front(square_window.len().saturating_sub(32));
        if let Some(belief) = square_window.estimate() {
            ufir.check(&belief, &what);
        }
        let step = Arrive { f: arrive.f, offset: arrive.next, q: arrive.q };
        for (forward, instants) in forward.iter_mut().zip(&mut instants) {
            let mut instant = forward.leap((k > 0).then_some(&step));
            rows.iter().for_each(|row| forward.update(row));
            instant.rows = rows.len();
            instants.push(instant);
        }
        all_rows.extend(&rows);
    }
    for (forward, instants) in forward.iter().zip(&instants) {
        smooth(&forward.start_state(), instants, &all_rows, |k, belief| {
            if let Some(belief) = belief {
                smoother.check(&belief, &format!("{N} states, smoothed row {k}"));
            }
        });
    }
}

#[test]
fn covariances_are_symmetric_to_the_bit_and_semidefinite_in_any_units() {
    let mut rng = Random::new(1);
    let mut seen: [Seen; 6] = Default::default();
    for _ in 0..60 {
        check::<1>(&mut rng, &mut seen);
        check::<2>(&mut rng, &mut seen);
        check::<3>(&mut rng, &mut seen);
        check::<4>(&mut rng, &mut seen);
        check::<6>(&mut rng, &mut seen);
    }
    println!("kalman, pass, stacks, invariant, ufir, smoother: {seen:#?}");
    for seen in &seen {
        assert!(seen.count > 5000, "{seen:?}");
        // Rounding of the trace, times the states.
        assert!(seen.lowest > -10.0 * f64::EPSILON, "{seen:?}");
        // A recursive update subtracts: its rounding is that of the prior, whose variances may be 1e5 times the posterior's.
        assert!(seen.lowest_scaled > -1e-10, "{seen:?}");
    }
    // Windows and smoothers add squares only. A smoother that formed I + LᵀUᵀUL gave NaN where a prediction was 1e8 times vaguer
    // than the smoothed state: the identity had drowned.
    for seen in &seen[1..] {
        assert!(seen.lowest_scaled > -10.0 * f64::EPSILON, "{seen:?}");
    }
}

#[test]
fn a_refused_update_changes_nothing() {
    let row = |h: f64, residual: f64, var: f64| Row { h: Vector::from([h, 1.0]), residual, var };
    let bad = [row(1e200, 0.0, 1.0), row(1.0, 0.0, f64::INFINITY), row(1.0, 0.0, -20.0), row(f64::NAN, 0.0, 1.0)];
    let belief = Belief { mean: Vector::from([1.0, 2.0]), cov: Matrix::<2, 2>::identity() };
    for bad in bad {
        assert!(update(&belief, &[row(1.0, 0.1, 1.0), bad], Robust::None).is_err(), "{bad:?}");
        let mut pass = Diffuse::<2>::start();
        pass.update(&row(1.0, 0.1, 1.0)).unwrap();
        pass.leap(&Matrix::identity(), &Vector::zeros(), &Matrix::identity());
        let mut other = pass;
        if other.update(&bad).is_err() {
            assert_eq!(format!("{other:?}"), format!("{pass:?}"));
        } else {
            panic!("{bad:?} was taken");
        }
    }
}
