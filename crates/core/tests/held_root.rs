//! The square-root form of `lmvf`: the same filter, and digits where the other has lost them.

mod oracle;

use fixtrail_core::estimators::augmented::{Hold, Sensed, Shown};
use fixtrail_core::estimators::lmvf::Lmvf;
use fixtrail_core::{Belief, Matrix, Transition, Vector, linalg};
use oracle::fixed::{deviation, posterior};
use oracle::held::{Filter, Kind, held_run};
use oracle::random::Random;
use oracle::twofold::Twofold;

fn forms<const N: usize, const M: usize>(rng: &mut Random, missing: f64) -> f64 {
    let mut worst: f64 = 0.0;
    for _ in 0..20 {
        let run = held_run(rng, &Kind { n: N, m: M, steps: 40, hold: Hold::Paper, missing, arrival: None });
        let belief = run.start::<N>();
        let sensed = run.sensed::<N, M>(0, &belief.mean);
        let mut both = [false, true].map(|root| Lmvf::start(&belief, &run.second(), &sensed, root));
        for k in 1..=run.steps() {
            let nis = both.each_mut().map(|filter| run.step(filter, k).nis);
            worst = worst.max(deviation(&both[1].belief(), &posterior(&Filter::belief(&both[0]))));
            worst = worst.max((nis[0] - nis[1]).abs() / (1.0 + nis[0]));
        }
    }
    worst
}

#[test]
fn square_root_form_over_random_runs_equals_the_full_form() {
    let mut rng = Random::new(1);
    let worst = [
        forms::<1, 1>(&mut rng, 0.0),
        forms::<2, 1>(&mut rng, 0.0),
        forms::<3, 2>(&mut rng, 0.2),
        forms::<4, 2>(&mut rng, 0.0),
        forms::<4, 3>(&mut rng, 0.4),
    ];
    println!("{worst:?}");
    // A⁻¹ amplifies: what is expected of a value two steps old is some 1e2 the state, and its rounding moves the mean by some 1e3 ε.
    // A row that is rotated in wrongly moves estimates by tenths.
    assert!(worst.iter().all(|w| *w < 1e-9), "{worst:?}");
}

/// One scalar measurement of two states; the leap that led to it.
#[derive(Clone, Copy)]
struct Instant {
    a: [[f64; 2]; 2],
    w: [[f64; 2]; 2],
    c: [f64; 2],
    r: f64,
}

type Square = [[Twofold; 2]; 2];
type Pair = [Twofold; 2];

fn lift(m: [[f64; 2]; 2]) -> Square {
    m.map(|row| row.map(Twofold::from))
}

fn product(a: &Square, b: &Square) -> Square {
    [0, 1].map(|i| [0, 1].map(|j| a[i][0] * b[0][j] + a[i][1] * b[1][j]))
}

fn transposed(a: &Square) -> Square {
    [[a[0][0], a[1][0]], [a[0][1], a[1][1]]]
}

fn times(a: &Square, x: &Pair) -> Pair {
    [0, 1].map(|i| a[i][0] * x[0] + a[i][1] * x[1])
}

fn dot(a: &Pair, b: &Pair) -> Twofold {
    a[0] * b[0] + a[1] * b[1]
}

/// `g m gᵀ`
fn quadratic(g: &Pair, m: &Square) -> Twofold {
    dot(g, &times(m, g))
}

/// `x A = (Aᵀ xᵀ)ᵀ`
fn row_times(x: &Pair, a: &Square) -> Pair {
    times(&transposed(a), x)
}

/// Covariances of the filter with numbers of twice the digits, by (15), (16) and (19) of [MVF10] as they are printed.
fn reference(p0: f64, instants: &[Instant], arrival: f64) -> Vec<Square> {
    let (one, zero) = (Twofold::from(1.0), Twofold::from(0.0));
    let mut p = lift([[p0, 0.0], [0.0, p0]]);
    let mut s = lift([[0.0; 2]; 2]);
    let mut out = Vec::new();
    let mut arrival_before = one;
    for k in 1..instants.len() {
        let (at, last) = (&instants[k], &instants[k - 1]);
        let (a, w, c) = (lift(at.a), lift(at.w), at.c.map(Twofold::from));
        let q1 = Twofold::from(arrival);
        let (q2, q3) = ((one - q1) * arrival_before, (one - q1) * (one - arrival_before));
        let mut parts = vec![(q1, row_times(&c, &a)), (q2, last.c.map(Twofold::from))];
        let mut d = q1 * (Twofold::from(at.r) + quadratic(&c, &w)) + q2 * Twofold::from(last.r);
        if k > 1 {
            let (b, before) = (lift(last.a), &instants[k - 2]);
            let det = b[0][0] * b[1][1] - b[0][1] * b[1][0];
            let inverse = [[b[1][1] / det, -b[0][1] / det], [-b[1][0] / det, b[0][0] / det]];
            let g = row_times(&before.c.map(Twofold::from), &inverse);
            d = d + q3 * (Twofold::from(before.r) + quadratic(&g, &lift(last.w)));
            parts.push((q3, g));
        }
        let j = parts.iter().fold([zero; 2], |sum, (q, g)| [sum[0] + *q * g[0], sum[1] + *q * g[1]]);
        d = d + quadratic(&j, &p) - quadratic(&j, &s);
        d = parts.iter().fold(d, |d, (q, g)| d + *q * quadratic(g, &s));
        let (apj, wc) = (times(&a, &times(&p, &j)), times(&w, &c));
        let gain = [0, 1].map(|i| (apj[i] + q1 * wc[i]) / d);
        let (pa, sa) = (product(&p, &transposed(&a)), product(&s, &transposed(&a)));
        let f = [0, 1].map(|i| [0, 1].map(|l| a[i][l] - gain[i] * j[l]));
        let cw = row_times(&c, &w);
        let moved = product(&f, &pa);
        p = [0, 1].map(|i| [0, 1].map(|l| moved[i][l] + w[i][l] - q1 * gain[i] * cw[l]));
        let second = product(&a, &sa);
        s = [0, 1].map(|i| [0, 1].map(|l| second[i][l] + w[i][l]));
        arrival_before = q1;
        out.push(p);
    }
    out
}

/// Worst deviation of P of the full and of the square-root form from the reference, in parts of the standard deviations.
fn lost(p0: f64, instants: &[Instant], arrival: f64) -> [f64; 2] {
    let sensed = |at: &Instant| Sensed {
        expected: Vector::<1>::zeros(),
        h: Matrix::<1, 2>::new(at.c[0], at.c[1]),
        r: Matrix::from([[at.r]]),
    };
    let square = |m: [[f64; 2]; 2]| Matrix::<2, 2>::from_fn(|i, j| m[i][j]);
    let belief = Belief { mean: Vector::zeros(), cov: Matrix::identity() * p0 };
    let truth = reference(p0, instants, arrival);
    [false, true].map(|root| {
        // S_0 = 0: the spread would be a large noise, under which nothing is conditioned badly.
        let mut filter = Lmvf::<2, 1>::start(&belief, &Matrix::zeros(), &sensed(&instants[0]), root);
        let mut worst: f64 = 0.0;
        for (at, truth) in instants[1..].iter().zip(&truth) {
            let leap = Transition { next: Vector::zeros(), f: square(at.a), q: square(at.w) };
            if filter.step(&leap, &sensed(at), &Shown::all(Vector::zeros()), arrival).is_err() {
                return f64::INFINITY;
            }
            let cov = filter.belief().cov;
            for i in 0..2 {
                for j in 0..2 {
                    let off = Twofold::from(cov[(i, j)]) - truth[i][j];
                    worst = worst.max(off.near().abs() / (truth[i][i].near() * truth[j][j].near()).sqrt());
                }
            }
        }
        worst
    })
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

#[test]
fn square_root_form_after_a_vague_start_and_exact_values_keeps_digits_that_the_full_form_loses() {
    for arrival in [1.0, 0.9] {
        let mut rng = Random::new(2);
        let mut found = Vec::new();
        for _ in 0..50 {
            let instants: Vec<Instant> = (0..11)
                .map(|_| {
                    let w = linalg::symmetrised(&oracle::fixed::square::<2>(&rng.definite(2, 1e-5)));
                    Instant {
                        a: [[1.0 + 0.1 * rng.normal(), rng.normal()], [0.1 * rng.normal(), 1.0 + 0.1 * rng.normal()]],
                        w: [[w[(0, 0)], w[(0, 1)]], [w[(1, 0)], w[(1, 1)]]],
                        c: [rng.normal(), rng.normal()],
                        r: 1e-10,
                    }
                })
                .collect();
            found.push(lost(1e8, &instants, arrival));
        }
        let [full, root] = [0, 1].map(|i| median(found.iter().map(|f| f[i]).collect()));
        let worst = found.iter().map(|f| f[1]).fold(0.0, f64::max);
        println!("p = {arrival}: full {full:e}, square root {root:e}, at worst {worst:e}");
        assert!(full >= 100.0 * root, "{full:e} {root:e}");
        // A factor that lost the digits between the standard deviations 1e4 and 1e-5 would be off by 1e-7.
        assert!(worst < 1e-10, "{worst:e}");
    }
}
