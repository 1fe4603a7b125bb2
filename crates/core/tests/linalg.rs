//! The small linear algebra against dense algebra that shares nothing with it.

mod oracle;

use fixtrail_core::linalg::{LeastSquares, Lu, cholesky, compress, semidefinite_factor, symmetrised, whiten};
use fixtrail_core::{Matrix, Row, Vector};
use nalgebra::{DMatrix, DVector};
use oracle::fixed::{row_major, square};
use oracle::random::Random;

/// Random systems of up to 12 unknowns: condition up to about 1e4, so 1e-11 leaves an order of magnitude.
const CLOSE: f64 = 1e-11;

fn random_rows<const N: usize>(rng: &mut Random, count: usize) -> Vec<Row<N>> {
    (0..count)
        .map(|_| Row {
            h: Vector::from_fn(|_, _| rng.normal()),
            residual: 3.0 * rng.normal(),
            var: 0.1 + rng.uniform(),
        })
        .collect()
}

fn dense<const N: usize>(rows: &[Row<N>]) -> (DMatrix<f64>, DVector<f64>, DMatrix<f64>) {
    let h = DMatrix::from_fn(rows.len(), N, |i, j| rows[i].h[j]);
    let e = DVector::from_fn(rows.len(), |i, _| rows[i].residual);
    let r = DMatrix::from_fn(rows.len(), rows.len(), |i, j| if i == j { rows[i].var } else { 0.0 });
    (h, e, r)
}

/// `[H e]ᵀ R⁻¹ [H e]`: all that rows say.
fn information(h: &DMatrix<f64>, e: &DVector<f64>, r: &DMatrix<f64>) -> DMatrix<f64> {
    let mut both = DMatrix::zeros(h.nrows(), h.ncols() + 1);
    both.columns_mut(0, h.ncols()).copy_from(h);
    both.set_column(h.ncols(), e);
    both.transpose() * r.clone().try_inverse().expect("definite") * both
}

fn off(a: &DMatrix<f64>, b: &DMatrix<f64>) -> f64 {
    (a - b).amax() / b.amax().max(1e-300)
}

#[test]
fn whitened_rows_say_the_same() {
    let mut rng = Random::new(1);
    for q in 1..=6 {
        let mut rows = random_rows::<4>(&mut rng, q);
        let r = rng.definite(q, 0.7);
        let (h, e, _) = dense(&rows);
        let mut factor = row_major(&r);
        assert!(whiten(&mut rows, &mut factor));
        assert!(rows.iter().all(|row| row.var == 1.0));
        let (hw, ew, _) = dense(&rows);
        let plain = information(&hw, &ew, &DMatrix::identity(q, q));
        assert!(off(&plain, &information(&h, &e, &r)) < CLOSE);
    }
}

#[test]
fn whitening_by_an_indefinite_covariance_leaves_the_rows() {
    let mut rng = Random::new(2);
    let rows = random_rows::<3>(&mut rng, 2);
    for r in [[1.0, 2.0, 2.0, 1.0], [0.0, 0.0, 0.0, 1.0], [1.0, 1.0, 1.0, 1.0], [f64::NAN, 0.0, 0.0, 1.0]] {
        let mut copy = rows.clone();
        assert!(!whiten(&mut copy, &mut r.clone()));
        assert_eq!(copy, rows);
    }
}

fn check_compress<const N: usize>(rng: &mut Random) {
    for count in [1, N, N + 1, 3 * N + 2] {
        for blind in [false, true] {
            let mut rows = random_rows::<N>(rng, count);
            if blind {
                rows.iter_mut().for_each(|row| row.h[0] = 0.0);
            }
            let (h, e, r) = dense(&rows);
            let before = information(&h, &e, &r);
            let (left, unexplained) = compress(&mut rows);
            assert_eq!(left, count.min(N));
            let (h, e, r) = dense(&rows[..left]);
            let mut after = information(&h, &e, &r);
            after[(N, N)] += unexplained;
            assert!(off(&after, &before) < CLOSE, "{N} states, {count} rows: {:e}", off(&after, &before));
        }
    }
}

#[test]
fn compressed_rows_say_the_same() {
    let mut rng = Random::new(3);
    check_compress::<1>(&mut rng);
    check_compress::<3>(&mut rng);
    check_compress::<12>(&mut rng);
}

fn check_least_squares<const N: usize>(rng: &mut Random) {
    let count = 2 * N + 3;
    let rows = random_rows::<N>(rng, count);
    let (h, z, _) = dense(&rows);
    let mut fit = LeastSquares::<N>::new();
    let left: f64 = rows.iter().map(|row| fit.add(&row.h, row.residual).powi(2)).sum();
    let svd = h.clone().svd(true, true);
    let best = svd.solve(&z, 1e-12).expect("computed");
    let unexplained = (&h * &best - &z).norm_squared();
    assert!((left - unexplained).abs() < CLOSE * unexplained, "{left} {unexplained}");
    let r = DMatrix::from_fn(N, N, |i, j| fit.r[(i, j)]);
    assert!(off(&(r.transpose() * &r), &(h.transpose() * &h)) < CLOSE);
    let inverse = fit.right_solve(&Matrix::identity());
    let ours = inverse * fit.y;
    for i in 0..N {
        assert!((ours[i] - best[i]).abs() < CLOSE * best.amax(), "{ours} {best}");
    }
    let m = Matrix::<N, N>::from_fn(|_, _| rng.normal());
    assert!((fit.right_solve(&m) * fit.r - m).amax() < CLOSE);
}

#[test]
fn givens_least_squares_equals_the_pseudoinverse() {
    let mut rng = Random::new(4);
    for _ in 0..20 {
        check_least_squares::<1>(&mut rng);
        check_least_squares::<4>(&mut rng);
        check_least_squares::<12>(&mut rng);
    }
}

fn check_scaled_svd<const N: usize>(rng: &mut Random) {
    let mut fit = LeastSquares::<N>::new();
    // Units from millimetres to megametres must not matter.
    let units: Vec<f64> = (0..N).map(|i| 10f64.powi((5 * i as i32) % 13 - 6)).collect();
    for _ in 0..N + 1 {
        fit.add(&Vector::from_fn(|i, _| rng.normal() * units[i]), 0.0);
    }
    let svd = fit.scaled_svd();
    let mut scaled = fit.r;
    for j in 0..N {
        assert!((svd.scale[j] / fit.r.column(j).norm() - 1.0).abs() < 1e-14);
        scaled.column_mut(j).scale_mut(1.0 / svd.scale[j]);
    }
    let mut ours = svd.sigma.as_slice().to_vec();
    ours.sort_by(|a, b| b.total_cmp(a));
    let theirs = DMatrix::from_fn(N, N, |i, j| scaled[(i, j)]).singular_values();
    for (a, b) in ours.iter().zip(theirs.iter()) {
        // The peer's singular values are accurate to rounding of the largest.
        assert!((a - b).abs() < 1e-13 * theirs[0], "{ours:?} {theirs}");
    }
    assert!((scaled * svd.v - svd.u_sigma).amax() < 1e-13);
    assert!((svd.v.transpose() * svd.v - Matrix::identity()).amax() < 1e-13);
    let products = svd.u_sigma.transpose() * svd.u_sigma;
    for i in 0..N {
        for j in 0..i {
            assert!(products[(i, j)].abs() <= 1e-13 * svd.sigma[i] * svd.sigma[j], "columns {i} and {j} of {N}");
        }
    }
    assert!((svd.ratio() - theirs[N - 1] / theirs[0]).abs() < 1e-13);
}

#[test]
fn scaled_singular_values_equal_another_algorithm() {
    let mut rng = Random::new(5);
    for _ in 0..10 {
        check_scaled_svd::<1>(&mut rng);
        check_scaled_svd::<2>(&mut rng);
        check_scaled_svd::<5>(&mut rng);
        check_scaled_svd::<12>(&mut rng);
    }
}

#[test]
fn small_singular_values_keep_their_relative_accuracy() {
    for exponent in [2, 5, 8, 11] {
        let epsilon = 10f64.powi(-exponent);
        let mut fit = LeastSquares::<2>::new();
        fit.r = Matrix::<2, 2>::new(1.0, 1.0, 0.0, epsilon);
        // Unit columns at an angle of cosine c have singular values √(1 ± c); 1 − c without cancellation, c = 1/√(1 + ε²):
        let root = (1.0 + epsilon * epsilon).sqrt();
        let small = (epsilon * epsilon / (root * (root + 1.0))).sqrt();
        let large = (1.0 + 1.0 / root).sqrt();
        let ratio = fit.scaled_svd().ratio();
        // Four digits are plenty for a threshold; Jacobi keeps many more as long as ε is above rounding of 1.
        assert!((ratio / (small / large) - 1.0).abs() < 1e-4, "{ratio:e}, expected {:e}", small / large);
    }
}

#[test]
fn a_column_of_zeros_has_no_singular_value() {
    let mut fit = LeastSquares::<3>::new();
    assert_eq!(fit.scaled_svd().ratio(), 0.0);
    fit.add(&Vector::from([1.0, 0.0, 2.0]), 0.0);
    fit.add(&Vector::from([3.0, 0.0, 5.0]), 0.0);
    let svd = fit.scaled_svd();
    assert_eq!(svd.sigma.min(), 0.0);
    assert_eq!(svd.scale[1], 1.0);
}

fn check_lu<const N: usize>(rng: &mut Random) {
    let m = Matrix::<N, N>::from_fn(|_, _| rng.normal());
    let b = Matrix::<N, 2>::from_fn(|_, _| rng.normal());
    let lu = Lu::new(m).expect("random matrices are regular");
    let size = DMatrix::from_fn(N, N, |i, j| m[(i, j)]).try_inverse().expect("regular").amax();
    // Backward stable: residual of rounding times the solution.
    assert!((m * lu.solve(b) - b).amax() < 1e-14 * size * (N * N) as f64, "{:e}", (m * lu.solve(b) - b).amax());
    assert!((m.transpose() * lu.solve_transposed(b) - b).amax() < 1e-14 * size * (N * N) as f64);
}

#[test]
fn lu_solves_both_ways() {
    let mut rng = Random::new(6);
    for _ in 0..30 {
        check_lu::<1>(&mut rng);
        check_lu::<3>(&mut rng);
        check_lu::<12>(&mut rng);
    }
    // Needs its pivots.
    let lu = Lu::new(Matrix::<3, 3>::new(0.0, 2.0, 0.0, 0.0, 0.0, 3.0, 4.0, 0.0, 0.0)).expect("a permutation");
    assert_eq!(lu.solve(Vector::from([2.0, 6.0, 12.0])), Vector::from([3.0, 1.0, 2.0]));
    assert_eq!(lu.solve_transposed(Vector::from([4.0, 2.0, 3.0])), Vector::from([1.0, 1.0, 1.0]));
}

#[test]
fn lu_of_a_singular_matrix_is_none() {
    assert!(Lu::new(Matrix::<2, 2>::new(1.0, 2.0, 2.0, 4.0)).is_none());
    assert!(Lu::new(Matrix::<2, 2>::zeros()).is_none());
    assert!(Lu::new(Matrix::<1, 1>::new(f64::NAN)).is_none());
    assert!(Lu::new(Matrix::<1, 1>::new(f64::INFINITY)).is_none());
}

#[test]
fn semidefinite_factor_of_every_rank() {
    let mut rng = Random::new(7);
    for rank in 0..=5 {
        let m = square::<5>(&rng.covariance(5, rank, 2.0));
        let l = semidefinite_factor(&m);
        // A direction left out carries at most rounding of its variance, n ε m_jj.
        assert!((l * l.transpose() - m).amax() < 1e-14 * m.amax().max(1.0), "rank {rank}");
        assert_eq!(l, l.lower_triangle());
        assert_eq!(l.diagonal().iter().filter(|d| **d > 0.0).count(), rank);
    }
}

#[test]
fn cholesky_equals_another_and_refuses_what_has_none() {
    let mut rng = Random::new(8);
    for q in 1..=12 {
        let m = rng.definite(q, 1.5);
        let mut ours = row_major(&m);
        assert!(cholesky(&mut ours, q));
        let theirs = m.clone().cholesky().expect("definite").l();
        for i in 0..q {
            for j in 0..=i {
                assert!((ours[i * q + j] - theirs[(i, j)]).abs() < 1e-13 * m.amax());
            }
        }
    }
    assert!(!cholesky(&mut [-1.0], 1));
    assert!(!cholesky(&mut [f64::INFINITY], 1));
    assert!(cholesky(&mut [], 0));
}

#[test]
fn symmetrised_is_symmetric_to_the_bit() {
    let mut rng = Random::new(9);
    let m = Matrix::<7, 7>::from_fn(|_, _| rng.normal());
    let s = symmetrised(&m);
    assert_eq!(s, s.transpose());
    assert!((s * 2.0 - m - m.transpose()).amax() < 1e-15);
}
