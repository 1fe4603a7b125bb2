//! Nothing is ever lost: every filter for held values is then the filter without them.

mod oracle;

use fixtrail_core::estimators::augmented::{Hold, Sensed, Shown};
use fixtrail_core::estimators::emvf::{Emvf, Options, Variant};
use fixtrail_core::estimators::gpb1::Gpb1;
use fixtrail_core::estimators::kalman::{Robust, predict, update};
use fixtrail_core::estimators::lmmse::{Lmmse, Spread};
use fixtrail_core::estimators::lmvf::Lmvf;
use fixtrail_core::models::CoordinatedTurn;
use fixtrail_core::sensors::range;
use fixtrail_core::{Belief, Matrix, Row, Vector, linalg};
use oracle::fixed::{deviation, posterior};
use oracle::held::{Filter, HeldRun, Kind, held_run};
use oracle::random::Random;

/// One step of the filter that knows what came.
fn kalman<const N: usize>(run: &HeldRun, belief: &Belief<N>, k: usize) -> Belief<N> {
    let at = &run.instants[k];
    let prior = predict(belief, &run.leap(k, &belief.mean));
    let mut rows: Vec<Row<N>> = (0..at.y.len())
        .map(|i| {
            let h = Vector::<N>::from_fn(|j, _| at.c[(i, j)]);
            Row { h, residual: at.y[i] - h.dot(&prior.mean), var: 1.0 }
        })
        .collect();
    assert!(linalg::whiten(&mut rows, &mut oracle::fixed::row_major(&at.r)));
    update(&prior, &rows, Robust::None).expect("definite").0
}

/// Follows the run and returns the worst deviation from the Kalman filter.
fn off<const N: usize, const M: usize>(run: &HeldRun, mut filter: impl Filter<N, M>) -> f64 {
    let mut belief: Belief<N> = run.start();
    let mut worst: f64 = 0.0;
    for k in 1..=run.steps() {
        run.step(&mut filter, k);
        belief = kalman(run, &belief, k);
        worst = worst.max(deviation(&filter.belief(), &posterior(&belief)));
    }
    worst
}

/// `lmvf`, its square root, `lmmse` and `gpb1` with either hold.
fn all<const N: usize, const M: usize>(rng: &mut Random) -> [f64; 6] {
    let mut worst = [0.0_f64; 6];
    for _ in 0..20 {
        let run = held_run(rng, &Kind { n: N, m: M, steps: 50, hold: Hold::Paper, missing: 0.0, arrival: Some(1.0) });
        let belief = run.start::<N>();
        let sensed = run.sensed::<N, M>(0, &belief.mean);
        let (p, l) = (Hold::Paper, Hold::LastReceived);
        let found = [
            off(&run, Lmvf::start(&belief, &run.second(), &sensed, false)),
            off(&run, Lmvf::start(&belief, &run.second(), &sensed, true)),
            off(&run, Lmmse::start(&belief, &sensed, p, Spread::Unconditional)),
            off(&run, Lmmse::start(&belief, &sensed, l, Spread::Conditional)),
            off(&run, Gpb1::start(&belief, &sensed, p)),
            off(&run, Gpb1::start(&belief, &sensed, l)),
        ];
        (0..6).for_each(|i| worst[i] = worst[i].max(found[i]));
    }
    worst
}

// Two ways to round the same step: some 1e2 ε each, damped by the filter. In standard deviations, or relative where the mean is larger.
const ROUNDING: f64 = 1e-12;

#[test]
fn filters_for_held_values_where_all_comes_equal_the_kalman_filter() {
    let mut rng = Random::new(1);
    let worst = [all::<1, 1>(&mut rng), all::<2, 1>(&mut rng), all::<3, 2>(&mut rng), all::<4, 2>(&mut rng)];
    println!("{worst:?}");
    assert!(worst.iter().flatten().all(|w| *w < ROUNDING), "{worst:?}");
}

fn ranged(x: &Vector<5>, anchor: [f64; 3], var: f64) -> Sensed<5, 1> {
    // The residual of a distance of 0 is the distance expected, negative.
    let row = range(x, 2, anchor, None, 0.0, var);
    Sensed { expected: Vector::from([-row.residual]), h: row.h.transpose(), r: Matrix::from([[var]]) }
}

#[test]
fn emvf_where_all_comes_equals_the_extended_kalman_filter() {
    let mut rng = Random::new(2);
    let dt_s = 0.1;
    let (mut worst, mut travelled): (f64, f64) = (0.0, 0.0);
    for run in 0..20 {
        let model = CoordinatedTurn::new([0.1, 0.1], 0.02).expect("sound densities");
        let options = Options {
            variant: if run % 2 == 0 { Variant::Model2 } else { Variant::Model1 },
            range_mixture: run % 3 == 0,
        };
        let mut truth = Vector::from([30.0, 70.0, 20.0, 20.0, -1.0]);
        let cov = Matrix::from_diagonal(&Vector::from([1.0, 1.0, 4.0, 4.0, 0.01]));
        let mut belief = Belief { mean: truth + Vector::from_fn(|i, _| cov[(i, i)].sqrt() * rng.normal()), cov };
        let second = cov + belief.mean * belief.mean.transpose();
        let var = 0.01;
        let mut filter = Emvf::<5, 1>::start(&belief, &second, &ranged(&belief.mean, [0.0; 3], var), options);
        for k in 1..=50 {
            truth = model.leap(&truth, dt_s).next;
            let anchor = [[0.0, 0.0, 0.0], [100.0, 0.0, 0.0], [50.0, 90.0, 0.0]][k % 3];
            let z = -range(&truth, 2, anchor, None, 0.0, var).residual + var.sqrt() * rng.normal();
            let leap = model.leap(&filter.belief().mean, dt_s);
            let shown = Shown::all(Vector::from([z]));
            filter.step(&leap, &ranged(&leap.next, anchor, var), &shown, 1.0).expect("a sound step");
            let prior = predict(&belief, &model.leap(&belief.mean, dt_s));
            belief = update(&prior, &[range(&prior.mean, 2, anchor, None, z, var)], Robust::None).expect("definite").0;
            worst = worst.max(deviation(&filter.belief(), &posterior(&belief)));
            travelled = travelled.max((belief.mean - truth).fixed_rows::<2>(0).norm());
        }
    }
    println!("off by {worst:e}; {travelled} m from the truth at most");
    assert!(worst < ROUNDING, "{worst:e}");
    // They followed something: a lost run would be tens of metres off.
    assert!(travelled < 10.0, "{travelled}");
}
