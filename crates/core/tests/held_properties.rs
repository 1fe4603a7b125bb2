//! What holds for every run of the filters for held values.

mod oracle;

use fixtrail_core::estimators::augmented::{Hold, Sensed, Shown};
use fixtrail_core::estimators::emvf::{Emvf, Options, Variant};
use fixtrail_core::estimators::gpb1::Gpb1;
use fixtrail_core::estimators::kalman::predict;
use fixtrail_core::estimators::lmmse::{Lmmse, Spread};
use fixtrail_core::estimators::lmvf::Lmvf;
use fixtrail_core::{Belief, Matrix, Transition, Vector};
use nalgebra::DMatrix;
use oracle::fixed::{deviation, posterior};
use oracle::held::{Filter, HeldRun, Kind, held_run};
use oracle::random::Random;

const HOLDS: [Hold; 2] = [Hold::Paper, Hold::LastReceived];

/// Smallest eigenvalue over the largest; the covariance is symmetric to the bit.
fn lowest<const N: usize>(belief: &Belief<N>) -> f64 {
    assert_eq!(belief.cov, belief.cov.transpose());
    assert!(belief.mean.iter().chain(&belief.cov).all(|v| v.is_finite()), "{belief:?}");
    let eigenvalues = DMatrix::from_fn(N, N, |i, j| belief.cov[(i, j)]).symmetric_eigenvalues();
    eigenvalues.min() / eigenvalues.max()
}

fn over_run<const N: usize, const M: usize>(run: &HeldRun, mut filter: impl Filter<N, M>) -> f64 {
    let mut least: f64 = 0.0;
    for k in 1..=run.steps() {
        run.step(&mut filter, k);
        least = least.min(lowest(&filter.belief()));
    }
    least
}

/// Every filter at its start.
struct All<const N: usize, const M: usize> {
    lmvf: [Lmvf<N, M>; 2],
    emvf: [Emvf<N, M>; 4],
    lmmse: [Lmmse<N, M>; 2],
    gpb1: Gpb1<N, M>,
}

fn all<const N: usize, const M: usize>(run: &HeldRun, hold: Hold) -> All<N, M> {
    let belief = run.start::<N>();
    let sensed = run.sensed(0, &belief.mean);
    let variants =
        [(Variant::Model2, false), (Variant::Model2, true), (Variant::Model1, false), (Variant::Model1, true)];
    All {
        lmvf: [false, true].map(|root| Lmvf::start(&belief, &run.second(), &sensed, root)),
        emvf: variants.map(|(variant, range_mixture)| {
            Emvf::start(&belief, &run.second(), &sensed, Options { variant, range_mixture })
        }),
        lmmse: [Spread::Unconditional, Spread::Conditional].map(|s| Lmmse::start(&belief, &sensed, hold, s)),
        gpb1: Gpb1::start(&belief, &sensed, hold),
    }
}

fn over_random_runs<const N: usize, const M: usize>(rng: &mut Random) -> [f64; 4] {
    let mut least = [0.0_f64; 4];
    for hold in HOLDS {
        for i in 0..20 {
            let arrival = [None, None, Some(1.0), Some(0.3)][i / 2 % 4];
            let mut run = held_run(rng, &Kind { n: N, m: M, steps: 60, hold, missing: 0.2, arrival });
            if i % 2 == 0 {
                // Most directions know no noise, and the start is known but for one.
                run.cov = rng.covariance(N, 1, 3.0);
                run.instants.iter_mut().for_each(|at| at.w = rng.covariance(N, 1, 0.2));
            }
            let All { lmvf, emvf, lmmse, gpb1 } = all::<N, M>(&run, hold);
            for filter in lmvf {
                least[0] = least[0].min(over_run(&run, filter));
            }
            for filter in emvf {
                least[1] = least[1].min(over_run(&run, filter));
            }
            for filter in lmmse {
                least[2] = least[2].min(over_run(&run, filter));
            }
            least[3] = least[3].min(over_run(&run, gpb1));
        }
    }
    least
}

#[test]
fn covariances_over_random_runs_are_symmetric_to_the_bit_and_semidefinite() {
    let mut rng = Random::new(1);
    let least = [
        over_random_runs::<1, 1>(&mut rng),
        over_random_runs::<2, 1>(&mut rng),
        over_random_runs::<3, 2>(&mut rng),
        over_random_runs::<4, 2>(&mut rng),
        over_random_runs::<6, 3>(&mut rng),
    ];
    println!("lmvf, emvf, lmmse, gpb1: {least:?}");
    // A prior's variances are up to some 1e3 of the posterior's, and are subtracted: 1e3 ε.
    assert!(least.iter().flatten().all(|l| *l > -1e-12), "{least:?}");
}

fn refuses<const N: usize, const M: usize, F: Filter<N, M>>(run: &HeldRun, start: &F, p: f64) {
    let mut filter = start.clone();
    (1..=2).for_each(|k| {
        run.step(&mut filter, k);
    });
    let leap = run.leap(3, &filter.belief().mean);
    let sensed = run.sensed(3, &leap.next);
    let shown = Shown::all(Vector::repeat(1.0));
    let broken: [(Transition<N>, Sensed<N, M>, Shown<M>); 5] = [
        (Transition { next: Vector::repeat(f64::NAN), ..leap }, sensed, shown),
        (Transition { q: Matrix::identity() * f64::INFINITY, ..leap }, sensed, shown),
        (leap, Sensed { h: Matrix::repeat(f64::NAN), ..sensed }, shown),
        (leap, sensed, Shown::all(Vector::repeat(f64::NAN))),
        (leap, sensed, Shown::all(Vector::repeat(f64::INFINITY))),
    ];
    for (i, (leap, sensed, shown)) in broken.iter().enumerate() {
        let before = format!("{filter:?}");
        filter.take(leap, sensed, shown, p).expect_err(&format!("case {i}"));
        assert_eq!(before, format!("{filter:?}"), "case {i}");
    }
}

#[test]
fn a_refused_step_changes_nothing() {
    let mut rng = Random::new(2);
    for hold in HOLDS {
        for p in [1.0, 0.6] {
            let run = held_run(&mut rng, &Kind { n: 2, m: 2, steps: 3, hold, missing: 0.0, arrival: Some(p) });
            let All { lmvf, emvf, lmmse, gpb1 } = all::<2, 2>(&run, hold);
            for filter in lmvf {
                refuses(&run, &filter, p);
            }
            for filter in emvf {
                refuses(&run, &filter, p);
            }
            for filter in lmmse {
                refuses(&run, &filter, p);
            }
            refuses(&run, &gpb1, p);
        }
    }
}

#[test]
fn a_step_that_shows_nothing_is_pure_prediction() {
    let mut rng = Random::new(3);
    let mut worst = [0.0_f64; 4];
    for hold in HOLDS {
        for _ in 0..20 {
            let mut run = held_run(&mut rng, &Kind { n: 3, m: 2, steps: 8, hold, missing: 0.0, arrival: None });
            for k in [3, 6, 7] {
                run.instants[k].seen = vec![false; 2];
            }
            let All { lmvf, emvf, lmmse, gpb1 } = all::<3, 2>(&run, hold);
            for filter in lmvf {
                worst[0] = worst[0].max(predicts(&run, filter));
            }
            for filter in emvf {
                worst[1] = worst[1].max(predicts(&run, filter));
            }
            for filter in lmmse {
                worst[2] = worst[2].max(predicts(&run, filter));
            }
            worst[3] = worst[3].max(predicts(&run, gpb1));
        }
    }
    println!("{worst:?}");
    // The covariance is the sum of the same squares in another order.
    assert!(worst.iter().all(|w| *w < 1e-13), "{worst:?}");
}

fn predicts<const N: usize, const M: usize>(run: &HeldRun, mut filter: impl Filter<N, M>) -> f64 {
    let mut worst: f64 = 0.0;
    for k in 1..=run.steps() {
        let before = filter.belief();
        let evidence = run.step(&mut filter, k);
        if !run.instants[k].seen[0] {
            let predicted = predict(&before, &run.leap(k, &before.mean));
            worst = worst.max(deviation(&filter.belief(), &posterior(&predicted)));
            assert_eq!((evidence.nis, evidence.dof), (0.0, 0));
        }
    }
    worst
}
