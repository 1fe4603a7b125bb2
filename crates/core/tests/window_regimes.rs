//! Finite-memory windows: every algorithm against the plain pass and against brute force.

mod oracle;

use fixtrail_core::estimators::diffuse::Joint;
use fixtrail_core::estimators::fms::gain::{Gain, Invariant, Shape};
use fixtrail_core::estimators::fms::invariant::{InvariantWindow, Model};
use fixtrail_core::estimators::fms::lost::LostRows;
use fixtrail_core::estimators::fms::varying::Varying;
use fixtrail_core::estimators::fms::{Align, STACKS_FROM};
use fixtrail_core::{Matrix, Row, Vector};
use nalgebra::DMatrix;
use oracle::fixed::{Heap, columns_of, deviation, leap, noise, posterior, row_major, rows, rows_of, square};
use oracle::random::{Family, Random, run};
use oracle::{Run, Start, Verdict};

/// Worst deviation of a joint estimate from another, in the units of [`oracle::deviation`].
fn apart<const N: usize>(ours: &Joint<N>, reference: &Joint<N>, what: &str) -> f64 {
    assert_eq!(ours.filter.is_some(), reference.filter.is_some(), "{what}: filter");
    assert_eq!(ours.lagged.is_some(), reference.lagged.is_some(), "{what}: lagged");
    let mut worst: f64 = 0.0;
    for (a, b) in [(&ours.filter, &reference.filter), (&ours.lagged, &reference.lagged)] {
        if let (Some(a), Some(b)) = (a, b) {
            worst = worst.max(deviation(a, &posterior(b)));
        }
    }
    if let (Some(a), Some(b)) = (&reference.filter, &reference.lagged) {
        let size = (a.cov.diagonal().max() * b.cov.diagonal().max()).sqrt();
        worst = worst.max((ours.cross - reference.cross).amax() / size);
    }
    worst
}

/// The run from `first` on, through a window of the given algorithms; `visit` gets the number of instants taken, and the estimate.
struct Windows<const N: usize> {
    invariant: InvariantWindow<N, Heap>,
    /// Aggregates in stacks from [`STACKS_FROM`] instants on, or has two filters that meet where there is no lag.
    stacked: Varying<N, Heap>,
    /// Room for one instant at first: too short for filters and stacks, so it always passes.
    passed: Varying<N, Heap>,
    shape: Shape,
}

impl<const N: usize> Windows<N> {
    fn new(run: &Run, shape: Shape) -> Self {
        let at = &run.instants[0];
        let (a, w) = (square(&at.a), noise(at));
        let (b, c, r) = (columns_of(&at.b), rows_of(&at.c), row_major(&at.r));
        let model = Model { a: &a, w: &w, b: &b, c: &c, r: &r };
        Self {
            invariant: InvariantWindow::new(&model, shape).expect("a sound model"),
            stacked: Varying::new(shape.window.max(STACKS_FROM) + 1).expect("there is room"),
            passed: Varying::new(1).expect("there is room"),
            shape,
        }
    }

    fn push(&mut self, run: &Run, k: usize) {
        let at = &run.instants[k];
        self.invariant.push(&at.z, &at.u).expect("there is room");
        let arrive = leap(k.checked_sub(1).map(|k| &run.instants[k]));
        for window in [&mut self.stacked, &mut self.passed] {
            window.push(&arrive, &mut rows(at)).expect("there is room");
            window.drop_front(window.len().saturating_sub(self.shape.window));
        }
    }

    /// (chosen by the invariant window, stacked, passed)
    fn estimates(&mut self, run: &Run, k: usize) -> [Joint<N>; 3] {
        let Shape { lag, align, .. } = self.shape;
        let next = leap(Some(&run.instants[k]));
        let of = |window: &mut Varying<N, Heap>| match align {
            Align::Filtered => window.filtered(lag),
            Align::Predicted => window.predicted(lag, &next),
        };
        [self.invariant.estimate(), of(&mut self.stacked), of(&mut self.passed)]
    }
}

/// Systems whose windows are of any length: random ones that neither grow nor fade fast, and the paper's.
fn system(rng: &mut Random, n: usize, len: usize, loss: f64) -> Run {
    let family =
        Family { len, n, q: rng.count(1, 3), p: 3, varying: false, prior: false, loss, singular: len < STACKS_FROM };
    let mut run = run(rng, &family);
    if len >= STACKS_FROM || rng.chance(0.3) {
        // A chain of integrators: conditions grow as powers of the window's length.
        let a = DMatrix::from_fn(n, n, |i, j| {
            if i == j {
                1.0
            } else if j == i + 1 {
                0.2
            } else {
                0.0
            }
        });
        run.instants.iter_mut().for_each(|at| at.a = a.clone());
    }
    run
}

#[derive(Default, Debug)]
struct Worst {
    chosen: f64,
    stacked: f64,
    brute: f64,
    estimates: usize,
    absent: usize,
}

fn check<const N: usize>(rng: &mut Random, window: usize, loss: f64, brute: bool, worst: &mut Worst) {
    for align in [Align::Filtered, Align::Predicted] {
        let most = if align == Align::Filtered { window - 1 } else { window };
        let len = window + window / 2 + 3;
        for lag in [0, 1, most / 3, most.saturating_sub(1), most] {
            if lag > most {
                continue;
            }
            let run = system(rng, N, len, loss);
            let mut windows = Windows::<N>::new(&run, Shape { window, lag, align });
            for k in 0..len {
                windows.push(&run, k);
                if window > 40 && k % 7 != 0 {
                    continue;
                }
                let what = format!("{align:?} n {N}, window {window}, lag {lag}, loss {loss}, row {k}");
                let [chosen, stacked, passed] = windows.estimates(&run, k);
                worst.chosen = worst.chosen.max(apart(&chosen, &passed, &what));
                worst.stacked = worst.stacked.max(apart(&stacked, &passed, &what));
                assert!(worst.chosen < 1e-8 && worst.stacked < 1e-8, "{what}: {worst:?}");
                if brute && k + 1 == len {
                    let end = k + usize::from(align == Align::Predicted);
                    let first = (k + 1).saturating_sub(window);
                    for (ours, at) in [(&passed.filter, end), (&passed.lagged, end - lag)] {
                        match (run.posterior(Start::Unknown, first..k + 1, at), ours) {
                            (Verdict::Determined(truth), Some(belief)) => {
                                worst.brute = worst.brute.max(deviation(belief, &truth));
                                worst.estimates += 1;
                            }
                            (Verdict::Undetermined, None) => worst.absent += 1,
                            (Verdict::Borderline, _) => {}
                            (verdict, ours) => panic!("{what}: {ours:?}, expected {verdict:?}"),
                        }
                    }
                }
            }
        }
    }
}

/// Three algorithms of condition 1e6 against each other leave nine digits; see [`oracle::deviation`] for the scale.
fn assert_close(worst: &Worst) {
    println!("{worst:?}");
    assert!(worst.chosen < 1e-9 && worst.stacked < 1e-9 && worst.brute < 1e-9, "{worst:?}");
}

#[test]
fn short_windows_agree_whatever_is_lost() {
    let mut rng = Random::new(1);
    let mut worst = Worst::default();
    for loss in [0.0, 0.1, 0.3, 0.6] {
        for window in [2, 3, 5, 9, 15, 29] {
            check::<1>(&mut rng, window, loss, window < 10, &mut worst);
            check::<2>(&mut rng, window, loss, window < 10, &mut worst);
            check::<3>(&mut rng, window, loss, window < 10, &mut worst);
            check::<4>(&mut rng, window, loss, window < 10, &mut worst);
        }
    }
    assert!(worst.estimates > 300, "{worst:?}");
    assert_close(&worst);
}

#[test]
fn long_windows_agree_whatever_is_lost() {
    let mut rng = Random::new(2);
    let mut worst = Worst::default();
    for loss in [0.0, 0.05, 0.3, 0.6] {
        for window in [30, 31, 45, 80] {
            check::<2>(&mut rng, window, loss, window == 31, &mut worst);
            check::<3>(&mut rng, window, loss, false, &mut worst);
        }
    }
    assert!(worst.estimates > 20, "{worst:?}");
    assert_close(&worst);
}

#[test]
fn alternating_loss_and_recovery_change_the_algorithm_not_the_answer() {
    // Lossless stretches use the gain, single losses the correction, bursts the stacks: the switches must leave no trace.
    let mut rng = Random::new(3);
    let mut worst: f64 = 0.0;
    for align in [Align::Filtered, Align::Predicted] {
        let mut run = system(&mut rng, 3, 400, 0.0);
        for (k, at) in run.instants.iter_mut().enumerate() {
            let lost = match k {
                90 | 97 | 210..=212 => true,
                130..=170 => k % 2 == 0,
                250..=290 => true,
                _ => false,
            };
            if lost {
                at.z.iter_mut().for_each(|z| *z = None);
            }
        }
        let mut windows = Windows::<3>::new(&run, Shape { window: 32, lag: 7, align });
        for k in 0..run.len() {
            windows.push(&run, k);
            let [chosen, _, passed] = windows.estimates(&run, k);
            worst = worst.max(apart(&chosen, &passed, &format!("{align:?}, row {k}")));
        }
    }
    println!("{worst:e}");
    assert!(worst < 1e-9, "{worst:e}");
}

#[test]
fn the_lost_row_correction_itself_is_exact() {
    let mut rng = Random::new(4);
    let (mut worst, mut corrected, mut handed_on): (f64, _, _) = (0.0, 0, 0);
    for i in 0..60 {
        let (window, lag) = (rng.count(6, 20), rng.count(0, 5));
        let mut run = system(&mut rng, 3, window, 0.0);
        run.instants.iter_mut().for_each(|at| at.u.iter_mut().for_each(|u| *u = 0.0));
        let q = run.instants[0].z.len();
        let mut lost = Vec::new();
        let probability = [0.03, 0.1, 0.25][i % 3];
        for (k, at) in run.instants.iter_mut().enumerate() {
            for (j, z) in at.z.iter_mut().enumerate() {
                if lost.len() < 16 && rng.chance(probability) {
                    *z = None;
                    lost.push(k * q + j);
                }
            }
        }
        let shape = Shape { window, lag, align: Align::Filtered };
        let at = &run.instants[0];
        // Whitened by hand: the correction works in raw coordinates, its design in white ones.
        let full = oracle::Instant { z: vec![Some(0.0); q], ..at.clone() };
        let h: Vec<Vector<3>> = rows::<3>(&full).iter().map(|row| row.h).collect();
        let step = fixtrail_core::Transition { next: Vector::zeros(), f: square(&at.a), q: noise(at) };
        let model = Invariant { leap: &step, rows: &h, b: &[] };
        let Some(mut gain) = Gain::<3, Heap>::design(&model, shape).expect("a sound model") else { continue };
        let l = at.r.clone().cholesky().expect("definite").l();
        let factor = row_major(&l);
        let lost_rows = LostRows::<Heap>::design(&model, window, &factor).expect("a sound model").expect("room");
        // Columns of the gain for raw data: K L⁻¹.
        let inverse = l.try_inverse().expect("regular");
        for block in gain.z.chunks_mut(q) {
            let white = block.to_vec();
            for (j, column) in block.iter_mut().enumerate() {
                *column = (0..q).fold((Vector::zeros(), Vector::zeros()), |sum, i| {
                    (sum.0 + white[i].0 * inverse[(i, j)], sum.1 + white[i].1 * inverse[(i, j)])
                });
            }
        }
        let z: Vec<f64> = run.instants.iter().flat_map(|at| at.z.iter().map(|z| z.unwrap_or(0.0))).collect();
        let precision = at.r.clone().try_inverse().expect("definite");
        let Some((moved, joint)) = lost_rows.correct(&gain, &z, &lost, |row| precision[(row % q, row % q)]) else {
            handed_on += 1;
            continue;
        };
        corrected += 1;
        let base = gain.apply(&z, &[]);
        let mut ours = joint;
        ours.filter.as_mut().expect("designed for both").mean = base.0 + moved.0;
        ours.lagged.as_mut().expect("designed for both").mean = base.1 + moved.1;
        let mut windows = Windows::<3>::new(&run, shape);
        (0..window).for_each(|k| windows.push(&run, k));
        let [_, _, passed] = windows.estimates(&run, window - 1);
        worst = worst.max(apart(&ours, &passed, &format!("case {i}, lost {lost:?}")));
    }
    println!("{worst:e}, {corrected} corrected, {handed_on} handed on");
    assert!(worst < 1e-9 && corrected >= 40, "{worst:e}, {corrected} corrected, {handed_on} handed on");
}

#[test]
fn the_full_window_gain_is_used_and_is_unbiased() {
    // K O = [Φ_M; Φ_L]: noise-free data give the exact states, whatever the start.
    let mut rng = Random::new(5);
    for _ in 0..20 {
        let run = system(&mut rng, 3, 12, 0.0);
        let mut windows = Windows::<3>::new(&run, Shape { window: 12, lag: 4, align: Align::Predicted });
        let Some(gain) = windows.invariant.gain() else { continue };
        let at = &run.instants[0];
        let (a, c, b) = (square::<3>(&at.a), rows_of::<3>(&at.c), columns_of::<3>(&at.b));
        let start = Vector::<3>::from_fn(|_, _| rng.normal());
        let (mut x, mut states) = (start, vec![start]);
        let (mut z, mut u) = (Vec::new(), Vec::new());
        for _ in 0..12 {
            z.extend(c.iter().map(|c| c.dot(&x)));
            x = a * x;
            for b in &b {
                let input = rng.normal();
                u.push(input);
                x += b * input;
            }
            states.push(x);
        }
        let (filter, lagged) = gain.apply(&z, &u);
        let size = states.iter().map(|x| x.amax()).fold(1.0, f64::max);
        // The gain's entries may be a thousand times the data's: rounding times that.
        assert!((filter - states[12]).amax() < 1e-10 * size, "{filter} {}", states[12]);
        assert!((lagged - states[8]).amax() < 1e-10 * size, "{lagged} {}", states[8]);
        // The same data through the window, and an estimate that is bit for bit the gain's.
        for i in 0..12 {
            let q = c.len();
            let z: Vec<Option<f64>> = z[i * q..(i + 1) * q].iter().map(|z| Some(*z)).collect();
            windows.invariant.push(&z, &u[i * b.len()..(i + 1) * b.len()]).expect("there is room");
        }
        let joint = windows.invariant.estimate();
        assert_eq!((joint.filter.unwrap().mean, joint.lagged.unwrap().mean), (filter, lagged));
    }
}

#[test]
fn posterior_nis_equals_the_innovation_form() {
    use fixtrail_core::estimators::fms::posterior_nis;
    use fixtrail_core::estimators::kalman::{Robust, update};
    let mut rng = Random::new(6);
    let mut worst: f64 = 0.0;
    for count in [1, 2, 3, 7] {
        for _ in 0..50 {
            let prior = fixtrail_core::Belief {
                mean: Vector::<3>::from_fn(|_, _| rng.normal()),
                cov: square(&rng.definite(3, 1.0)),
            };
            let mut at_prior: Vec<Row<3>> = (0..count)
                .map(|_| Row {
                    h: Vector::from_fn(|_, _| rng.normal()),
                    residual: 3.0 * rng.normal(),
                    var: 0.2 + rng.uniform(),
                })
                .collect();
            let (belief, _) = update(&prior, &at_prior, Robust::None).expect("definite");
            let h = DMatrix::from_fn(count, 3, |i, j| at_prior[i].h[j]);
            let cov = DMatrix::from_fn(3, 3, |i, j| prior.cov[(i, j)]);
            let r = DMatrix::from_fn(count, count, |i, j| if i == j { at_prior[i].var } else { 0.0 });
            let nu = nalgebra::DVector::from_fn(count, |i, _| at_prior[i].residual);
            let s = &h * cov * h.transpose() + r;
            let expected = nu.dot(
                &s.try_inverse()
                    .expect("definite")
                    .column_iter()
                    .zip(nu.iter())
                    .fold(nalgebra::DVector::zeros(count), |sum, (column, nu)| sum + column * *nu),
            );
            // The rows relative to 0, as a window holds them.
            at_prior.iter_mut().for_each(|row| row.residual += row.h.dot(&prior.mean));
            let nis = posterior_nis(&belief, &mut at_prior).expect("the prior says what to expect");
            worst = worst.max((nis - expected).abs() / expected.max(1.0));
        }
    }
    println!("{worst:e}");
    // I − HPHᵀ of these has eigenvalues down to 1e-3, and its inverse is used once.
    assert!(worst < 1e-10, "{worst:e}");
}

#[test]
fn rows_alone_in_their_window_have_no_nis() {
    use fixtrail_core::estimators::fms::posterior_nis;
    // The estimate is the measurement itself: there was nothing to compare it with.
    let mut window = Varying::<1, Heap>::new(3).expect("there is room");
    let row = Row { h: Vector::from([2.0]), residual: 5.0, var: 0.25 };
    let still = fixtrail_core::Transition { next: Vector::zeros(), f: Matrix::identity(), q: Matrix::zeros() };
    window.push(&still, &mut [row]).expect("there is room");
    let belief = window.filtered(0).filter.expect("one row determines one state");
    assert_eq!(posterior_nis(&belief, &mut [row]), None);
    assert_eq!(posterior_nis(&belief, &mut []), None);
}
