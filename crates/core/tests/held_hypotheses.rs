//! `gpb1` against its two hypotheses written out with dense matrices over (x, z, d).

mod oracle;

use fixtrail_core::estimators::augmented::{Hold, Sensed, Shown};
use fixtrail_core::estimators::gpb1::Gpb1;
use fixtrail_core::{Belief, Matrix, Transition, Vector};
use nalgebra::{DMatrix, DVector};
use oracle::Posterior;
use oracle::fixed::deviation;
use oracle::held::{Filter, HeldRun, Kind, held_run};
use oracle::random::Random;

const HOLDS: [Hold; 2] = [Hold::Paper, Hold::LastReceived];

/// What is known of (x, z, d).
struct Dense {
    mean: DVector<f64>,
    cov: DMatrix<f64>,
}

/// Puts `part` at a block row and column of a matrix over (x, z, d).
fn put(m: &mut DMatrix<f64>, row: usize, col: usize, part: &DMatrix<f64>) {
    m.view_mut((row, col), part.shape()).copy_from(part);
}

impl Dense {
    fn start(run: &HeldRun) -> Self {
        let (c, n, m) = (&run.instants[0].c, run.mean.len(), run.instants[0].r.nrows());
        let mut map = DMatrix::zeros(n + 2 * m, n + m);
        put(&mut map, 0, 0, &DMatrix::identity(n, n));
        for block in [n, n + m] {
            put(&mut map, block, 0, c);
            put(&mut map, block, n, &DMatrix::identity(m, m));
        }
        let mut noise = DMatrix::zeros(n + m, n + m);
        put(&mut noise, 0, 0, &run.cov);
        put(&mut noise, n, n, &run.instants[0].r);
        let mut mean = DVector::zeros(n + m);
        mean.rows_mut(0, n).copy_from(&run.mean);
        Self { mean: &map * mean, cov: &map * noise * map.transpose() }
    }

    /// The hypothesis that the value of instant k came or not: the density of what is seen, and what is known then.
    fn given(&self, run: &HeldRun, hold: Hold, k: usize, came: bool) -> (f64, Self) {
        let (from, at) = (&run.instants[k - 1], &run.instants[k]);
        let (n, m) = (run.mean.len(), at.r.nrows());
        let size = n + 2 * m;
        let (ca, one) = (&at.c * &from.a, DMatrix::identity(m, m));
        // (x, z, d) of the next instant from those of this one, from (w, v) and from the input.
        let (mut of_old, mut of_noise) = (DMatrix::zeros(size, size), DMatrix::zeros(size, n + m));
        let mut known = DVector::zeros(size);
        put(&mut of_old, 0, 0, &from.a);
        put(&mut of_noise, 0, 0, &DMatrix::identity(n, n));
        known.rows_mut(0, n).copy_from(&from.b);
        let fresh = |of_old: &mut DMatrix<f64>, of_noise: &mut DMatrix<f64>, known: &mut DVector<f64>, row: usize| {
            put(of_old, row, 0, &ca);
            put(of_noise, row, 0, &at.c);
            put(of_noise, row, n, &one);
            known.rows_mut(row, m).copy_from(&(&at.c * &from.b));
        };
        fresh(&mut of_old, &mut of_noise, &mut known, n);
        match (came, hold) {
            (true, _) => fresh(&mut of_old, &mut of_noise, &mut known, n + m),
            (false, Hold::Paper) => put(&mut of_old, n + m, n, &one),
            (false, Hold::LastReceived) => put(&mut of_old, n + m, n + m, &one),
        }
        // What is shown.
        let (mut shown_old, mut shown_noise) = (DMatrix::zeros(m, size), DMatrix::zeros(m, n + m));
        let mut shown_known = DVector::zeros(m);
        if came {
            fresh(&mut shown_old, &mut shown_noise, &mut shown_known, 0);
        } else {
            put(&mut shown_old, 0, n + m, &one);
        }
        // What is shown is known: z and d stand as what is seen and a rest, and only the rest is estimated.
        let mut part = DMatrix::zeros(size, m);
        for i in (0..m).filter(|i| at.seen[*i]) {
            part[(n + i, i)] = f64::from(came);
            part[(n + m + i, i)] = 1.0;
        }
        of_old -= &part * &shown_old;
        of_noise -= &part * &shown_noise;
        known += &part * (&at.y - &shown_known);
        let mut noise = DMatrix::zeros(n + m, n + m);
        put(&mut noise, 0, 0, &from.w);
        put(&mut noise, n, n, &at.r);
        let mean = &of_old * &self.mean + known;
        let cov = &of_old * &self.cov * of_old.transpose() + &of_noise * &noise * of_noise.transpose();
        let seen: Vec<usize> = (0..m).filter(|i| at.seen[*i]).collect();
        if seen.is_empty() {
            return (1.0, Self { mean, cov });
        }
        let e = (&at.y - &shown_old * &self.mean - shown_known).select_rows(&seen);
        let mut s = &shown_old * &self.cov * shown_old.transpose() + &shown_noise * &noise * shown_noise.transpose();
        if !came {
            s += &at.r * 1e-9;
        }
        let s = s.select_rows(&seen).select_columns(&seen);
        let cross = (&of_old * &self.cov * shown_old.transpose() + &of_noise * noise * shown_noise.transpose())
            .select_columns(&seen);
        let inverse = s.clone().try_inverse().expect("regular");
        let density = (-0.5 * e.dot(&(&inverse * &e))).exp() / s.determinant().sqrt();
        let gain = cross.clone() * inverse;
        (density, Self { mean: mean + &gain * e, cov: cov - gain * cross.transpose() })
    }

    /// Takes both hypotheses together and returns the probability that the value came.
    fn step(&mut self, run: &HeldRun, hold: Hold, k: usize) -> f64 {
        let p = run.instants[k].arrival;
        let ((a, fresh), (b, held)) = (self.given(run, hold, k, true), self.given(run, hold, k, false));
        let weight = p * a / (p * a + (1.0 - p) * b);
        let mean = &fresh.mean * weight + &held.mean * (1.0 - weight);
        let part = |of: &Dense, w: f64| {
            let off = &of.mean - &mean;
            (&of.cov + &off * off.transpose()) * w
        };
        self.cov = part(&fresh, weight) + part(&held, 1.0 - weight);
        self.mean = mean;
        weight
    }

    fn state(&self, n: usize) -> Posterior {
        Posterior { mean: self.mean.rows(0, n).into(), cov: self.cov.view((0, 0), (n, n)).into() }
    }
}

fn gpb1<const N: usize, const M: usize>(run: &HeldRun, hold: Hold) -> Gpb1<N, M> {
    let belief = run.start();
    Gpb1::start(&belief, &run.sensed(0, &belief.mean), hold)
}

fn weigh<const N: usize, const M: usize>(run: &HeldRun, filter: &mut Gpb1<N, M>, k: usize) -> f64 {
    let leap = run.leap(k, &filter.joint().x);
    let sensed = run.sensed(k, &leap.next);
    filter.step(&leap, &sensed, &run.shown(k), run.instants[k].arrival).expect("a sound step").fresh
}

#[derive(Debug, Default)]
struct Off {
    weight: f64,
    state: f64,
    /// Steps that were undecided.
    open: usize,
}

fn over_random_runs<const N: usize, const M: usize>(rng: &mut Random, missing: f64) -> Off {
    let mut off = Off::default();
    for hold in HOLDS {
        for _ in 0..40 {
            let run = held_run(rng, &Kind { n: N, m: M, steps: 3, hold, missing, arrival: None });
            let (mut filter, mut dense) = (gpb1::<N, M>(&run, hold), Dense::start(&run));
            for k in 1..=3 {
                let (ours, truth) = (weigh(&run, &mut filter, k), dense.step(&run, hold, k));
                off.weight = off.weight.max((ours - truth).abs());
                off.state = off.state.max(deviation(&filter.belief(), &dense.state(N)));
                off.open += usize::from(truth > 0.01 && truth < 0.99);
            }
        }
    }
    off
}

#[test]
fn gpb1_over_random_runs_equals_its_two_hypotheses_written_out() {
    let mut rng = Random::new(1);
    let found = [
        over_random_runs::<1, 1>(&mut rng, 0.0),
        over_random_runs::<2, 1>(&mut rng, 0.3),
        over_random_runs::<2, 2>(&mut rng, 0.0),
        over_random_runs::<3, 2>(&mut rng, 0.4),
    ];
    println!("{found:?}");
    for off in found {
        // Both round covariances of condition up to 1e4. Without the 1e-9 R, or with it counted twice, weights move by 1e-5.
        assert!(off.weight < 1e-11 && off.state < 1e-11, "{off:?}");
        assert!(off.open > 20, "{off:?}");
    }
}

#[test]
fn weight_of_arrival_where_it_is_certain_or_impossible_is_one_or_zero() {
    let mut rng = Random::new(2);
    for hold in HOLDS {
        for p in [0.0, 1.0] {
            let run = held_run(&mut rng, &Kind { n: 2, m: 1, steps: 6, hold, missing: 0.2, arrival: Some(p) });
            let mut filter = gpb1::<2, 1>(&run, hold);
            for k in 1..=6 {
                assert_eq!(weigh(&run, &mut filter, k), p, "{hold:?} {k}");
            }
        }
    }
}

#[test]
fn weight_of_arrival_where_nothing_is_shown_is_the_rate() {
    let mut rng = Random::new(3);
    let run = held_run(&mut rng, &Kind { n: 2, m: 2, steps: 6, hold: Hold::Paper, missing: 1.0, arrival: None });
    let mut filter = gpb1::<2, 2>(&run, Hold::Paper);
    for k in 1..=6 {
        // exp(log p) and the sum of both weights round.
        let p = run.instants[k].arrival;
        assert!((weigh(&run, &mut filter, k) - p).abs() < 4.0 * f64::EPSILON);
    }
}

#[test]
fn weight_of_arrival_of_a_value_that_repeats_to_the_bit_is_nearly_zero() {
    let mut rng = Random::new(4);
    let mut largest: f64 = 0.0;
    for _ in 0..20 {
        let kind = Kind { n: 2, m: 1, steps: 20, hold: Hold::LastReceived, missing: 0.0, arrival: Some(0.8) };
        let run = held_run(&mut rng, &kind);
        let mut filter = gpb1::<2, 1>(&run, Hold::LastReceived);
        weigh(&run, &mut filter, 1);
        for k in 2..=20 {
            let fresh = weigh(&run, &mut filter, k);
            if run.instants[k].y == run.instants[k - 1].y {
                largest = largest.max(fresh);
            } else {
                assert!(fresh > 1.0 - 1e-12, "{k}: {fresh}");
            }
        }
    }
    println!("{largest:e}");
    // Odds of 4 for a new value, times a density lower by the square root of 1e-9 R over its variance, which is at least R.
    assert!(largest < 4.0 * 1e-9_f64.sqrt() / 0.2 * 1.5, "{largest:e}");
    assert!(largest > 0.0);
}

#[test]
fn gpb1_after_a_vague_start_takes_every_step() {
    // What came is known: its variance is 0. Rounding left 1e-16 of the prior variance of it, which where negative outweighed the
    // 1e-9 R that is added, and the step was refused.
    let mut refused = 0;
    for hold in HOLDS {
        for p in [1.0, 0.9] {
            for seed in 0..50 {
                let mut rng = Random::new(seed);
                let p0 = 10f64.powf(2.0 + 8.0 * rng.uniform());
                let belief = Belief { mean: Vector::zeros(), cov: Matrix::<2, 2>::identity() * p0 };
                let f = Matrix::<2, 2>::new(1.0, 1.0, 0.0, 1.0);
                let q = Matrix::<2, 2>::new(1.0, 1.5, 1.5, 3.0) * 1e-3;
                let h = Matrix::<2, 2>::new(1.0, 0.1 * rng.normal(), 0.5 * rng.normal(), 1.0);
                let r = Matrix::<2, 2>::new(1.0, 0.3, 0.3, 1.0);
                let sensed = |x: &Vector<2>| Sensed { expected: h * x, h, r };
                let mut filter = Gpb1::<2, 2>::start(&belief, &sensed(&belief.mean), hold);
                for k in 1..=30 {
                    let x = filter.joint().x;
                    let leap = Transition { next: f * x, f, q };
                    let value = h * Vector::from([f64::from(k), 1.0]) + Vector::from([rng.normal(), rng.normal()]);
                    if let Err(e) = filter.step(&leap, &sensed(&leap.next), &Shown::all(value), p) {
                        println!("{hold:?} {p} {p0:e} {k}: {e}");
                        refused += 1;
                        break;
                    }
                }
            }
        }
    }
    assert_eq!(refused, 0);
}
