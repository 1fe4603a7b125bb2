//! True and claimed steady errors by exact propagation of second moments, against figures of an independent implementation.

use fixtrail_core::estimators::augmented::{Hold, Sensed, Shown};
use fixtrail_core::estimators::emvf::{Emvf, Options};
use fixtrail_core::estimators::lmmse::{Lmmse, Spread};
use fixtrail_core::estimators::lmvf::Lmvf;
use fixtrail_core::{Belief, Matrix, Transition, Vector};
use nalgebra::DMatrix;

struct System<const N: usize> {
    a: Matrix<N, N>,
    c: Matrix<1, N>,
    w: Matrix<N, N>,
    r: f64,
    p0: Matrix<N, N>,
}

impl<const N: usize> System<N> {
    fn sensed(&self) -> Sensed<N, 1> {
        Sensed { expected: Vector::zeros(), h: self.c, r: Matrix::from([[self.r]]) }
    }
}

/// The system of [MVF10, sec. 3.2], read with W = B Bᵀ.
fn paper() -> System<2> {
    let b = Vector::from([0.6, 0.5]);
    let (a, c) = (Matrix::<2, 2>::new(0.6, 0.0, 0.8, 0.5), Matrix::<1, 2>::new(1.0, 1.0));
    System { a, c, w: b * b.transpose(), r: 1.0, p0: Matrix::identity() * 0.1 }
}

fn scalar(a: f64, q: f64, r: f64) -> System<1> {
    let one = |v| Matrix::<1, 1>::from([[v]]);
    System { a: one(a), c: one(1.0), w: one(q), r, p0: one(q) }
}

/// E[η ηᵀ] of η = (x, z, d, x̂, x̂⁻, x̂⁻⁻), where x̂⁺ is F_0 x̂ + F_1 x̂⁻ + F_2 x̂⁻⁻ + K y: x̂⁻ is the estimate before.
struct Moments<const N: usize>(DMatrix<f64>);

impl<const N: usize> Moments<N> {
    /// x̂_0 = 0, z = d = z_0.
    fn start(system: &System<N>) -> Self {
        let mut map = DMatrix::zeros(4 * N + 2, N + 1);
        for i in 0..N {
            map[(i, i)] = 1.0;
            map[(N, i)] = system.c[i];
            map[(N + 1, i)] = system.c[i];
        }
        map[(N, N)] = 1.0;
        map[(N + 1, N)] = 1.0;
        let noise = block(&system.p0, system.r);
        Self(&map * noise * map.transpose())
    }

    fn step(&mut self, system: &System<N>, f: &[Matrix<N, N>; 3], gain: &Matrix<N, 1>, p: f64) {
        let (size, noise) = (4 * N + 2, block(&system.w, system.r));
        let mut next = DMatrix::zeros(size, size);
        for (came, probability) in [(true, p), (false, 1.0 - p)] {
            // Rows of what the next η is made of: the old η, and (w, v).
            let (mut m, mut n) = (DMatrix::zeros(size, size), DMatrix::zeros(size, N + 1));
            let ca = system.c * system.a;
            for j in 0..N {
                m[(N, j)] = ca[j];
                n[(N, j)] = system.c[j];
                n[(j, j)] = 1.0;
                for i in 0..N {
                    m[(i, j)] = system.a[(i, j)];
                    (0..3).for_each(|age| m[(N + 2 + i, (age + 1) * N + 2 + j)] = f[age][(i, j)]);
                }
            }
            for i in N + 2..3 * N + 2 {
                m[(N + i, i)] = 1.0;
            }
            n[(N, N)] = 1.0;
            let (fresh_m, fresh_n) = (m.row(N).into_owned(), n.row(N).into_owned());
            if came {
                m.set_row(N + 1, &fresh_m);
                n.set_row(N + 1, &fresh_n);
            } else {
                m[(N + 1, N)] = 1.0;
            }
            for i in 0..N {
                for j in 0..size {
                    m[(N + 2 + i, j)] += if came { gain[i] * fresh_m[j] } else { gain[i] * f64::from(j == N + 1) };
                }
                for j in 0..=N {
                    n[(N + 2 + i, j)] = if came { gain[i] * fresh_n[j] } else { 0.0 };
                }
            }
            next += (&m * &self.0 * m.transpose() + &n * &noise * n.transpose()) * probability;
        }
        self.0 = next;
    }

    /// E[‖x − x̂‖²].
    fn error(&self) -> f64 {
        (0..N).map(|i| self.0[(i, i)] + self.0[(N + 2 + i, N + 2 + i)] - 2.0 * self.0[(i, N + 2 + i)]).sum()
    }
}

fn block<const N: usize>(w: &Matrix<N, N>, r: f64) -> DMatrix<f64> {
    DMatrix::from_fn(N + 1, N + 1, |i, j| match (i < N && j < N, i == j) {
        (true, _) => w[(i, j)],
        (false, true) => r,
        (false, false) => 0.0,
    })
}

/// Claimed and true trace of P of `lmvf` and the claimed one of `lmmse` after 500 steps, when nothing changes any more.
fn steady<const N: usize>(system: &System<N>, p: f64) -> [f64; 3] {
    let belief = Belief { mean: Vector::zeros(), cov: system.p0 };
    let leap = Transition { next: Vector::zeros(), f: system.a, q: system.w };
    let sensed = system.sensed();
    let mut lmvf = Lmvf::<N, 1>::start(&belief, &system.p0, &sensed, false);
    let mut lmmse = Lmmse::<N, 1>::start(&belief, &sensed, Hold::Paper, Spread::Unconditional);
    let mut moments = Moments::start(system);
    let mut before = [0.0; 3];
    for k in 0..500 {
        // Covariances do not depend on data: all is 0.
        let used = lmvf.step(&leap, &sensed, &Shown::all(Vector::zeros()), p).unwrap();
        lmmse.step(&leap, &sensed, &Shown::all(Vector::zeros()), p).unwrap();
        moments.step(system, &[system.a - used.gain * used.j, Matrix::zeros(), Matrix::zeros()], &used.gain, p);
        let now = [lmvf.belief().cov.trace(), moments.error(), lmmse.joint().belief().cov.trace()];
        if k == 499 {
            // a = 0.98 forgets 1e-9 of its second moment in 500 steps; the rest forgets faster.
            assert!((0..3).all(|i| (now[i] - before[i]).abs() < 1e-8 * now[i]), "{now:?} {before:?}");
        }
        before = now;
    }
    before
}

/// Half a unit of the last printed digit, and what steady leaves.
fn assert_prints(value: f64, printed: f64, unit: f64) {
    assert!((value - printed).abs() <= 0.5 * unit + 1e-6, "{value} is not {printed}");
}

#[test]
fn steady_errors_of_the_papers_system_are_those_of_the_independent_implementation() {
    // p, claimed, true, true over exact LMMSE.
    let table = [
        (0.1, (1.184, 1e-3), (1.388, 1e-3), 1.007),
        (0.5, (0.7786, 1e-4), (0.9160, 1e-4), 1.018),
        (0.9, (0.4372, 1e-4), (0.4587, 1e-4), 1.002),
        (0.99, (0.3722, 1e-4), (0.3740, 1e-4), 1.000),
    ];
    for (p, (claimed, claimed_unit), (real, real_unit), ratio) in table {
        let found = steady(&paper(), p);
        println!("{p}: {found:?} {}", found[1] / found[2]);
        assert_prints(found[0], claimed, claimed_unit);
        assert_prints(found[1], real, real_unit);
        assert_prints(found[1] / found[2], ratio, 1e-3);
    }
}

#[test]
fn steady_errors_of_scalar_systems_are_those_of_the_independent_implementation() {
    let table = [
        (0.2, 1.0, 0.01, 0.5, 0.9899, 0.9735, 1.41, 1e-2),
        (0.2, 1.0, 0.01, 0.9, 0.4394, 0.2579, 1.54, 1e-2),
        (-0.9, 1.0, 0.1, 0.5, 2.644, 2.384, 1.094, 1e-3),
        (0.98, 0.1, 1.0, 0.3, 0.3257, 0.4542, 1.030, 1e-3),
        (0.98, 0.1, 1.0, 0.5, 0.3058, 0.4179, 1.035, 1e-3),
        (0.98, 0.1, 1.0, 0.9, 0.2673, 0.2897, 1.003, 1e-3),
        (0.98, 0.1, 10.0, 0.5, 0.8266, 1.1367, 1.062, 1e-3),
    ];
    for (a, q, r, p, claimed, real, ratio, ratio_unit) in table {
        let found = steady(&scalar(a, q, r), p);
        println!("{a} {q} {r} {p}: {found:?} {}", found[1] / found[2]);
        let unit = if claimed > 1.5 { 1e-3 } else { 1e-4 };
        assert_prints(found[0], claimed, unit);
        assert_prints(found[1], real, unit);
        assert_prints(found[1] / found[2], ratio, ratio_unit);
    }
}

#[test]
fn emvf_of_a_linear_model_is_worse_than_lmvf_by_the_simulated_factors() {
    let system = paper();
    // From a simulation by other code, 40 000 runs of 160 steps.
    for (p, simulated) in [(0.5, 1.2161), (0.8, 1.0442)] {
        let belief = Belief { mean: Vector::zeros(), cov: system.p0 };
        let leap = Transition { next: Vector::zeros(), f: system.a, q: system.w };
        let mut emvf = Emvf::<2, 1>::start(&belief, &system.p0, &system.sensed(), Options::default());
        let mut moments = Moments::start(&system);
        let ca = system.c * system.a;
        let mut before = 1.0;
        for _ in 0..500 {
            let used = emvf.step(&leap, &system.sensed(), &Shown::all(Vector::zeros()), p).unwrap();
            // It expects of z_{k−1} what was predicted for it.
            let weights = [p, (1.0 - p) * before, (1.0 - p) * (1.0 - before)];
            let mut f = weights.map(|q| used.gain * ca * -q);
            f[0] += system.a;
            moments.step(&system, &f, &used.gain, p);
            before = p;
        }
        let ratio = moments.error() / steady(&system, p)[1];
        println!("{p}: {ratio}");
        // Errors are alike over some 5 steps: the standard error of a mean square is √(2·5/(40 000·160)) = 1.2e-3 of it.
        assert!((ratio - simulated).abs() < 3e-3_f64, "{ratio} is not {simulated}");
    }
}
