//! The factor graph against the filters and smoothers that its schedules are.

mod oracle;

use fixtrail_core::estimators::fosb::{Fosb, Gauss, Noise};
use fixtrail_core::estimators::kalman::{Robust, predict, update};
use fixtrail_core::estimators::smoother::{Arrive, Forward, Instant, smooth};
use fixtrail_core::graph::schedule::{Chain, SplitChain};
use fixtrail_core::graph::{ARITY, Factor, Graph, GraphError, Message, Send};
use fixtrail_core::{Belief, Matrix, Row, Transition, Vector};
use nalgebra::DMatrix;
use oracle::random::Random;

const LEN: usize = 30;

/// A chain of two states, every other one with a singular Q; instants are lost now and then.
struct Run {
    prior: Belief<2>,
    leaps: Vec<(Matrix<2, 2>, Vector<2>, Matrix<2, 2>)>,
    rows: Vec<Vec<Row<2>>>,
}

fn fixed(m: &DMatrix<f64>) -> Matrix<2, 2> {
    Matrix::from_fn(|i, j| m[(i, j)])
}

fn run(rng: &mut Random, singular: bool) -> Run {
    let rank = if singular { 1 } else { 2 };
    let prior = Belief { mean: Vector::from([rng.normal(), rng.normal()]), cov: fixed(&rng.definite(2, 1.0)) };
    let leaps = (1..LEN).map(|_| {
        let phi = Matrix::<2, 2>::new(1.0, 0.2 + rng.uniform(), 0.0, 1.0 - 0.2 * rng.uniform());
        (phi, Vector::from([rng.normal(), rng.normal()]), fixed(&rng.covariance(2, rank, 0.5)))
    });
    let leaps = leaps.collect();
    let rows = (0..LEN).map(|_| {
        let count = if rng.chance(0.2) { 0 } else { rng.count(1, 2) };
        let row = |rng: &mut Random| Row {
            h: Vector::from([rng.normal(), rng.normal()]),
            residual: 3.0 * rng.normal(),
            var: 0.2 + rng.uniform(),
        };
        (0..count).map(|_| row(rng)).collect()
    });
    let rows = rows.collect();
    Run { prior, leaps, rows }
}

fn factors(run: &Run, prior: bool) -> Vec<Factor<2>> {
    let first = if prior { Factor::prior(0, run.prior) } else { Factor::observation(0, &[]) };
    let mut out = vec![first];
    for k in 0..LEN {
        assert_eq!(out.len(), Chain::seen(k));
        out.push(Factor::observation(k, &run.rows[k]));
        if let Some((phi, push, q)) = run.leaps.get(k) {
            assert_eq!(out.len(), Chain::leap(k));
            out.push(Factor::transition(k, k + 1, *phi, *push, *q));
        }
    }
    out
}

fn filtered(run: &Run) -> Vec<Belief<2>> {
    let mut belief = run.prior;
    (0..LEN)
        .map(|k| {
            if k > 0 {
                let (f, push, q) = run.leaps[k - 1];
                belief = predict(&belief, &Transition { next: f * belief.mean + push, f, q });
            }
            let mut rows = run.rows[k].clone();
            rows.iter_mut().for_each(|row| row.residual -= row.h.dot(&belief.mean));
            belief = update(&belief, &rows, Robust::None).unwrap().0;
            belief
        })
        .collect()
}

/// Smoothed beliefs given the first `len` instants.
fn smoothed(run: &Run, prior: bool, len: usize) -> Vec<Option<Belief<2>>> {
    let mut forward = Forward::start(prior.then_some(&run.prior));
    let (mut instants, mut all): (Vec<Instant<2>>, Vec<Row<2>>) = (Vec::new(), Vec::new());
    for k in 0..len {
        let step = k.checked_sub(1).map(|k| Arrive { f: run.leaps[k].0, offset: run.leaps[k].1, q: run.leaps[k].2 });
        let mut instant = forward.leap(step.as_ref());
        run.rows[k].iter().for_each(|row| forward.update(row));
        instant.rows = run.rows[k].len();
        instants.push(instant);
        all.extend(&run.rows[k]);
    }
    let mut out = vec![None; len];
    smooth(&forward.start_state(), &instants, &all, |k, belief| out[k] = belief);
    out
}

fn deviation(found: &Belief<2>, expected: &Belief<2>) -> f64 {
    let scale = 1.0 + expected.mean.amax();
    let mean = (found.mean - expected.mean).amax() / scale;
    mean.max((found.cov - expected.cov).amax() / (1.0 + expected.cov.amax()))
}

#[test]
fn chains_give_filter_smoother_and_fixed_lag() {
    let mut rng = Random::new(31);
    let (mut worst_filter, mut worst_lag, mut worst_smoother): (f64, f64, f64) = (0.0, 0.0, 0.0);
    for case in 0..20 {
        let run = run(&mut rng, case % 2 == 0);
        let factors = factors(&run, true);
        let expected = filtered(&run);
        let empty = vec![[Message::vacuous(); ARITY]; factors.len()];
        let mut messages = empty.clone();
        let mut graph = Graph::new(&factors, &mut messages).unwrap();
        graph.run(Chain::filter(LEN)).unwrap();
        for (k, expected) in expected.iter().enumerate() {
            worst_filter = worst_filter.max(deviation(&graph.belief(k).unwrap().unwrap(), expected));
        }
        let mut messages = empty.clone();
        let mut graph = Graph::new(&factors, &mut messages).unwrap();
        graph.run(Chain::smoother(LEN)).unwrap();
        for (k, expected) in smoothed(&run, true, LEN).iter().enumerate() {
            worst_smoother = worst_smoother.max(deviation(&graph.belief(k).unwrap().unwrap(), &expected.unwrap()));
        }
        // What a lag sends back stays out of what goes onward: the filter is as before, at every lag.
        for lag in [1, 4] {
            let mut messages = empty.clone();
            let mut graph = Graph::new(&factors, &mut messages).unwrap();
            for k in 0..LEN {
                graph.run(Chain::fixed_lag(k, lag)).unwrap();
                worst_filter = worst_filter.max(deviation(&graph.belief(k).unwrap().unwrap(), &expected[k]));
                let old = k.saturating_sub(lag);
                let lagged = smoothed(&run, true, k + 1)[old].unwrap();
                worst_lag = worst_lag.max(deviation(&graph.belief(old).unwrap().unwrap(), &lagged));
            }
        }
    }
    println!("filter {worst_filter:.1e}, fixed lag {worst_lag:.1e}, smoother {worst_smoother:.1e}");
    assert!(worst_filter < 1e-12 && worst_lag < 1e-12 && worst_smoother < 1e-12);
}

#[test]
fn without_a_prior_nothing_is_known_until_the_data_say_it() {
    let mut rng = Random::new(32);
    for case in 0..20 {
        let run = run(&mut rng, case % 2 == 0);
        let factors = factors(&run, false);
        let mut messages = vec![[Message::vacuous(); ARITY]; factors.len()];
        let mut graph = Graph::new(&factors, &mut messages).unwrap();
        let mut seen = 0;
        for k in 0..LEN {
            graph.run(Chain::onward(k)).unwrap();
            seen += run.rows[k].len();
            assert_eq!(graph.belief(k).unwrap().is_some(), seen >= 2, "case {case}, instant {k}");
        }
        graph.run(Chain::back(LEN - 1, 0)).unwrap();
        for (k, expected) in smoothed(&run, false, LEN).iter().enumerate() {
            let off = deviation(&graph.belief(k).unwrap().unwrap(), &expected.unwrap());
            // Two rows that are nearly alike determine a state badly.
            assert!(off < 1e-9, "case {case}, instant {k}: {off:e}");
        }
    }
}

#[test]
fn fosb_is_a_schedule_on_the_graph_of_scalars() {
    let mut rng = Random::new(33);
    let mut worst: f64 = 0.0;
    for _ in 0..20 {
        let gauss = |mean: f64, var: f64| Belief { mean: Vector::from([mean]), cov: Matrix::<1, 1>::new(var) };
        let scalar = |v: f64| Matrix::<1, 1>::new(v);
        let start = [Gauss { mean: rng.normal(), var: 0.5 + rng.uniform() }, Gauss { mean: rng.normal(), var: 1.0 }];
        let mut factors = vec![
            Factor::prior(SplitChain::place_at(0), gauss(start[0].mean, start[0].var)),
            Factor::prior(SplitChain::speed_at(0), gauss(start[1].mean, start[1].var)),
        ];
        let mut fosb = Fosb::start(start[0], start[1]);
        let mut steps = Vec::new();
        for k in 0..LEN {
            let (dt, z) = (0.2 + rng.uniform(), Gauss { mean: 3.0 * rng.normal(), var: 0.2 + rng.uniform() });
            let noise = match k % 2 {
                0 => Noise::Acceleration { q: 0.3 },
                _ => Noise::Speed { q11: 0.1 * rng.uniform(), q33: 0.2 * rng.uniform() },
            };
            let (q11, q33) = noise.over(dt);
            let place = [
                (SplitChain::place_at(k), scalar(-1.0)),
                (SplitChain::speed_at(k), scalar(-dt)),
                (SplitChain::place_at(k + 1), scalar(1.0)),
            ];
            let speed = [(SplitChain::speed_at(k), scalar(-1.0)), (SplitChain::speed_at(k + 1), scalar(1.0))];
            assert_eq!(factors.len(), SplitChain::place(k));
            factors.push(Factor::linear(&place, Vector::zeros(), scalar(q11)).unwrap());
            factors.push(Factor::linear(&speed, Vector::zeros(), scalar(q33)).unwrap());
            let row = Row { h: Vector::from([1.0]), residual: z.mean, var: z.var };
            factors.push(Factor::observation(SplitChain::place_at(k + 1), &[row]));
            steps.push(fosb.step(dt, &noise, z).unwrap());
        }
        let mut messages = vec![[Message::vacuous(); ARITY]; factors.len()];
        let mut graph = Graph::new(&factors, &mut messages).unwrap();
        graph.run(SplitChain::start()).unwrap();
        for (k, step) in steps.iter().enumerate() {
            graph.run(SplitChain::fosb(k)).unwrap();
            let mut check = |variable: usize, expected: Gauss<f64>| {
                let found = graph.belief(variable).unwrap().unwrap();
                worst = worst.max((found.mean[0] - expected.mean).abs() / (1.0 + expected.mean.abs()));
                worst = worst.max((found.cov[0] - expected.var).abs() / expected.var);
            };
            check(SplitChain::place_at(k + 1), step.location);
            check(SplitChain::speed_at(k + 1), step.speed);
            check(SplitChain::speed_at(k), step.refined.unwrap());
        }
    }
    println!("fosb {worst:.1e}");
    assert!(worst < 1e-12, "{worst:e}");
}

/// A joint normal of three variables by conditioning, with a wide prior in place of none.
fn brute(a: [f64; 3], b: f64, q: f64, from: [Option<(f64, f64)>; 3], slot: usize) -> (f64, f64) {
    let precision = DMatrix::from_fn(3, 3, |i, j| {
        a[i] * a[j] / q + if i == j { from[i].filter(|_| i != slot).map_or(0.0, |(_, var)| 1.0 / var) } else { 0.0 }
    });
    let eta =
        nalgebra::DVector::from_fn(3, |i, _| -a[i] * b / q + from[i].filter(|_| i != slot).map_or(0.0, |(m, v)| m / v));
    let cov = precision.try_inverse().unwrap();
    ((&cov * eta)[slot], cov[(slot, slot)])
}

#[test]
fn linear_factors_send_what_conditioning_says() {
    let mut rng = Random::new(34);
    for _ in 0..50 {
        let a = [rng.normal(), rng.normal(), rng.normal()];
        let (b, q) = (rng.normal(), 0.1 + rng.uniform());
        let known = [0, 1, 2].map(|_| Some((rng.normal(), 0.1 + rng.uniform())));
        for slot in 0..3 {
            let mut factors = vec![];
            for (i, at) in known.iter().enumerate().filter(|(i, _)| *i != slot) {
                let (mean, var) = at.unwrap();
                factors.push(Factor::prior(i, Belief { mean: Vector::from([mean]), cov: Matrix::<1, 1>::new(var) }));
            }
            let terms = [0, 1, 2].map(|i| (i, Matrix::<1, 1>::new(a[i])));
            factors.push(Factor::linear(&terms, Vector::from([b]), Matrix::<1, 1>::new(q)).unwrap());
            let mut messages = vec![[Message::vacuous(); ARITY]; 3];
            let mut graph = Graph::new(&factors, &mut messages).unwrap();
            graph.run([(0, 0), (2, slot)].map(|(factor, slot)| Send { factor, slot })).unwrap();
            // One neighbour has said nothing: neither does the factor.
            assert_eq!(graph.belief(slot).unwrap(), None);
            graph.run([(1, 0), (2, slot)].map(|(factor, slot)| Send { factor, slot })).unwrap();
            let found = graph.belief(slot).unwrap().unwrap();
            let (mean, var) = brute(a, b, q, known, slot);
            assert!((found.mean[0] - mean).abs() < 1e-9 * (1.0 + mean.abs()), "{} {mean}", found.mean[0]);
            assert!((found.cov[0] - var).abs() < 1e-9 * var, "{} {var}", found.cov[0]);
        }
    }
}

#[test]
fn partly_known_neighbours_leave_what_they_leave_open() {
    // y − x = noise, x seen in one direction: so is y, with the noise beside it.
    let q = Matrix::<2, 2>::new(0.5, 0.1, 0.1, 0.7);
    let h = Vector::from([1.0, 2.0]);
    let row = Row { h, residual: 3.0, var: 0.4 };
    let terms = [(0, -Matrix::<2, 2>::identity()), (1, Matrix::<2, 2>::identity())];
    let factors = [Factor::observation(0, &[row]), Factor::linear(&terms, Vector::zeros(), q).unwrap()];
    let mut messages = [[Message::vacuous(); ARITY]; 2];
    let mut graph = Graph::new(&factors, &mut messages).unwrap();
    graph.run([Send { factor: 0, slot: 0 }, Send { factor: 1, slot: 1 }]).unwrap();
    let Some(Message::Information { info, eta }) = graph.message(Send { factor: 1, slot: 1 }) else { panic!() };
    let var = 0.4 + h.dot(&(q * h));
    assert!((info - h * h.transpose() / var).amax() < 1e-13, "{info}");
    assert!((eta - h * (3.0 / var)).amax() < 1e-13, "{eta}");
    assert_eq!(graph.belief(1).unwrap(), None);
}

#[test]
fn what_cannot_be_sent_changes_nothing() {
    let certain = Factor::prior(0, Belief { mean: Vector::from([1.0]), cov: Matrix::<1, 1>::zeros() });
    let factors = [certain, certain, Factor::transition(0, 1, Matrix::identity(), Vector::zeros(), Matrix::zeros())];
    let mut messages = [[Message::vacuous(); ARITY]; 3];
    assert!(Graph::new(&factors, &mut messages[..2]).is_none());
    let mut graph = Graph::new(&factors, &mut messages).unwrap();
    for (factor, slot) in [(3, 0), (0, 1), (2, 2)] {
        assert_eq!(graph.send(Send { factor, slot }), Err(GraphError::NoSlot { factor, slot }));
    }
    graph.run([Send { factor: 0, slot: 0 }, Send { factor: 1, slot: 0 }]).unwrap();
    assert_eq!(graph.belief(0), Err(GraphError::Contradiction { variable: 0 }));
    assert_eq!(graph.send(Send { factor: 2, slot: 1 }), Err(GraphError::Contradiction { variable: 0 }));
    assert_eq!(graph.belief(1), Ok(None));
    assert!(Factor::<1>::linear(&[(0, Matrix::identity())], Vector::zeros(), Matrix::identity()).is_none());
}
