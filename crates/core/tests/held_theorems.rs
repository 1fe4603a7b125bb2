//! `emvf` against Theorem 2 of [MVF10] written out as it is printed, with dense matrices; `lmvf` with known inputs against itself without.

mod oracle;

use fixtrail_core::estimators::augmented::{Hold, Sensed, Shown};
use fixtrail_core::estimators::emvf::{Emvf, Options, Variant};
use fixtrail_core::estimators::lmvf::Lmvf;
use fixtrail_core::models::CoordinatedTurn;
use fixtrail_core::{Belief, Matrix, Transition, Vector};
use nalgebra::{DMatrix, DVector};
use oracle::Posterior;
use oracle::fixed::deviation;
use oracle::held::{Filter, HeldRun, Kind, held_run};
use oracle::random::Random;

const DT_S: f64 = 0.1;
const VAR: f64 = 0.25;

fn dense<const R: usize, const C: usize>(m: &Matrix<R, C>) -> DMatrix<f64> {
    DMatrix::from_fn(R, C, |i, j| m[(i, j)])
}

/// Distance and bearing cosine to an anchor: two components, correlated.
fn sensed(x: &Vector<5>, anchor: [f64; 2]) -> Sensed<5, 2> {
    let (dx, dy) = (x[0] - anchor[0], x[1] - anchor[1]);
    let d = dx.hypot(dy);
    let mut h = Matrix::<2, 5>::zeros();
    (h[(0, 0)], h[(0, 1)]) = (dx / d, dy / d);
    (h[(1, 0)], h[(1, 1)]) = (10.0 * dy * dy / d.powi(3), -10.0 * dx * dy / d.powi(3));
    Sensed { expected: Vector::from([d, 10.0 * dx / d]), h, r: Matrix::<2, 2>::new(VAR, 0.1, 0.1, VAR) }
}

/// One instant as the theorem remembers it: h and H frozen at the state predicted, R, and the leap from there.
struct Frozen {
    h: DVector<f64>,
    jacobian: DMatrix<f64>,
    r: DMatrix<f64>,
    phi: DMatrix<f64>,
    w: DMatrix<f64>,
}

struct Theorem {
    x: DVector<f64>,
    p: DMatrix<f64>,
    s: DMatrix<f64>,
    past: Vec<Frozen>,
    arrival: f64,
    options: Options,
}

impl Theorem {
    fn step(&mut self, leap: &Transition<5>, sensed: &Sensed<5, 2>, y: &Vector<2>, arrival: f64) {
        let (phi, w) = (dense(&leap.f), dense(&leap.q));
        let last = self.past.last_mut().expect("there is a start");
        (last.phi, last.w) = (phi.clone(), w.clone());
        let now = Frozen {
            h: DVector::from_column_slice(sensed.expected.as_slice()),
            jacobian: dense(&sensed.h),
            r: dense(&sensed.r),
            phi: phi.clone(),
            w: w.clone(),
        };
        let q1 = arrival;
        let (q2, q3) = ((1.0 - arrival) * self.arrival, (1.0 - arrival) * (1.0 - self.arrival));
        let (n, c) = (&now.jacobian, &self.past[self.past.len() - 1]);
        // Probability, G, the value expected and the noise of its measurement.
        let mut parts = vec![
            (q1, n * &phi, now.h.clone(), &now.r + n * &w * n.transpose()),
            (q2, c.jacobian.clone(), c.h.clone(), c.r.clone()),
        ];
        if self.past.len() > 1 && self.options.variant == Variant::Model2 {
            let b = &self.past[self.past.len() - 2];
            let g = &b.jacobian * b.phi.clone().try_inverse().expect("regular");
            parts.push((q3, g.clone(), b.h.clone(), &b.r + &g * &b.w * g.transpose()));
        }
        let j = parts.iter().map(|(q, g, _, _)| g * *q).sum::<DMatrix<f64>>();
        let mut d = &j * &self.p * j.transpose() - &j * &self.s * j.transpose();
        for (q, g, _, noise) in &parts {
            d += (g * &self.s * g.transpose() + noise) * *q;
        }
        if self.options.range_mixture {
            for (i, a) in parts.iter().enumerate() {
                for b in &parts[..i] {
                    let apart = &a.2 - &b.2;
                    d += &apart * apart.transpose() * (a.0 * b.0);
                }
            }
        }
        let gain = (&phi * &self.p * j.transpose() + &w * n.transpose() * q1) * d.try_inverse().expect("regular");
        let expected = parts.iter().map(|(q, _, h, _)| h * *q).sum::<DVector<f64>>();
        let next = DVector::from_column_slice(leap.next.as_slice());
        self.x = next + &gain * (DVector::from_column_slice(y.as_slice()) - expected);
        self.p = (&phi - &gain * &j) * &self.p * phi.transpose() + (DMatrix::identity(5, 5) - &gain * n * q1) * &w;
        self.s = &phi * &self.s * phi.transpose() + &w;
        self.past.push(now);
        self.arrival = arrival;
    }
}

fn off(rng: &mut Random, options: Options) -> f64 {
    let model = CoordinatedTurn::new([0.1, 0.1], 0.02).expect("sound densities");
    let mut truth = Vector::from([3.0, 7.0, 2.0, 2.0, -1.0]);
    let cov = Matrix::from_diagonal(&Vector::from([0.3, 0.2, 0.1, 0.4, 0.1]));
    let belief = Belief { mean: truth + Vector::from_fn(|_, _| 0.3 * rng.normal()), cov };
    let second = cov + belief.mean * belief.mean.transpose();
    let anchors = [[0.0, 0.0], [10.0, 0.0], [5.0, 12.0]];
    let first = sensed(&belief.mean, anchors[0]);
    let mut filter = Emvf::<5, 2>::start(&belief, &second, &first, options);
    let mut theorem = Theorem {
        x: DVector::from_column_slice(belief.mean.as_slice()),
        p: dense(&cov),
        s: dense(&second),
        past: vec![Frozen {
            h: DVector::from_column_slice(first.expected.as_slice()),
            jacobian: dense(&first.h),
            r: dense(&first.r),
            phi: DMatrix::identity(5, 5),
            w: DMatrix::zeros(5, 5),
        }],
        arrival: 1.0,
        options,
    };
    let mut worst: f64 = 0.0;
    for k in 1..=20 {
        truth = model.leap(&truth, DT_S).next;
        let anchor = anchors[k % 3];
        let y = sensed(&truth, anchor).expected + Vector::from_fn(|_, _| 0.5 * rng.normal());
        let arrival = if rng.chance(0.2) { 1.0 } else { 0.3 + 0.6 * rng.uniform() };
        let leap = model.leap(&filter.belief().mean, DT_S);
        let sensed = sensed(&leap.next, anchor);
        filter.step(&leap, &sensed, &Shown::all(y), arrival).expect("a sound step");
        theorem.step(&leap, &sensed, &y, arrival);
        worst = worst.max(deviation(&filter.belief(), &Posterior { mean: theorem.x.clone(), cov: theorem.p.clone() }));
    }
    worst
}

#[test]
fn emvf_over_random_runs_equals_its_theorem_written_out() {
    let mut rng = Random::new(1);
    for variant in [Variant::Model2, Variant::Model1] {
        for range_mixture in [false, true] {
            let worst = (0..20).map(|_| off(&mut rng, Options { variant, range_mixture })).fold(0.0, f64::max);
            println!("{variant:?} {range_mixture}: {worst:e}");
            // The printed form subtracts J S Jᵀ of some 1e2, next to a D of some 0.1: 1e3 ε, and what 20 steps make of it. A term left
            // out is of D's own size.
            assert!(worst < 1e-10, "{worst:e}");
        }
    }
}

/// The same run with the known input as the effect of one more state, which is 1.
fn with_a_constant(run: &HeldRun) -> HeldRun {
    let n = run.mean.len();
    let grown = |m: &DMatrix<f64>, rows: usize| {
        let mut out = DMatrix::zeros(rows, n + 1);
        out.view_mut((0, 0), m.shape()).copy_from(m);
        out
    };
    let mut out = run.clone();
    out.mean = run.mean.push(1.0);
    out.cov = grown(&run.cov, n + 1);
    for at in &mut out.instants {
        let mut a = grown(&at.a, n + 1);
        a.view_mut((0, n), (n, 1)).copy_from(&at.b);
        a[(n, n)] = 1.0;
        (at.a, at.b) = (a, DVector::zeros(n + 1));
        (at.w, at.c) = (grown(&at.w, n + 1), grown(&at.c, at.c.nrows()));
    }
    out
}

#[test]
fn lmvf_with_known_inputs_equals_the_same_system_with_a_constant_state() {
    let mut rng = Random::new(2);
    let mut worst = [0.0_f64; 2];
    for _ in 0..20 {
        let kind = Kind { n: 2, m: 2, steps: 20, hold: Hold::Paper, missing: 0.1, arrival: None };
        let run = held_run(&mut rng, &kind);
        let constant = with_a_constant(&run);
        for (worst, root) in worst.iter_mut().zip([false, true]) {
            let (belief, grown) = (run.start::<2>(), constant.start::<3>());
            let first = run.sensed::<2, 2>(0, &belief.mean);
            let mut with = Lmvf::start(&belief, &run.second(), &first, root);
            let first = constant.sensed::<3, 2>(0, &grown.mean);
            let mut without = Lmvf::start(&grown, &constant.second(), &first, root);
            for k in 1..=run.steps() {
                run.step(&mut with, k);
                constant.step(&mut without, k);
                let truth = Filter::<3, 2>::belief(&without);
                let mean = DVector::from_column_slice(&truth.mean.as_slice()[..2]);
                let cov = dense(&truth.cov).view((0, 0), (2, 2)).into();
                *worst = worst.max(deviation(&Filter::<2, 2>::belief(&with), &Posterior { mean, cov }));
            }
        }
    }
    println!("{worst:?}");
    // A⁻¹ amplifies to some 1e2, the state has some 1e1 standard deviations: 1e4 ε. An input left out moves estimates by tenths.
    assert!(worst.iter().all(|w| *w < 1e-10), "{worst:?}");
}
