//! How far out an error is in the ellipsoid that is claimed for it.

use fixtrail_core::linalg::cholesky;

/// Returns `eᵀ P⁻¹ e` of the first `m` components, where `cov` is `n × n`; `None` when their block of P is not positive definite.
///
/// By `P = L Lᵀ` and forward substitution: `|L⁻¹ e|²`.
pub fn nees(error: &[f64], cov: &[f64], n: usize, m: usize) -> Option<f64> {
    let mut factor: Vec<f64> = (0..m * m).map(|e| cov[e / m * n + e % m]).collect();
    if !cholesky(&mut factor, m) {
        return None;
    }
    let mut solved = vec![0.0; m];
    for i in 0..m {
        let known: f64 = (0..i).map(|j| factor[i * m + j] * solved[j]).sum();
        solved[i] = (error[i] - known) / factor[i * m + i];
    }
    Some(solved.iter().map(|v| v * v).sum())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn block_of_a_covariance_is_judged_by_itself() {
        // P⁻¹ of the leading block [[2, 1], [1, 3]] is [[3, −1], [−1, 2]]/5.
        let cov = [2.0, 1.0, 0.7, 1.0, 3.0, 0.2, 0.7, 0.2, 1.0];
        let e = [1.0, -2.0, 9.0];
        assert!((nees(&e, &cov, 3, 2).unwrap() - (3.0 + 4.0 + 8.0) / 5.0).abs() < 1e-14);
        assert!((nees(&e, &cov, 3, 1).unwrap() - 0.5).abs() < 1e-15);
        assert_eq!(nees(&[1.0, 1.0], &[1.0, 1.0, 1.0, 1.0], 2, 2), None);
    }
}
