//! Percentiles and chi-square quantiles.

use statrs::distribution::{ChiSquared, ContinuousCDF, Normal, StudentsT};

/// The `p`-quantile of the chi-square distribution with `dof` degrees of freedom; 0 for `dof` = 0.
pub fn chi_square_quantile(dof: usize, p: f64) -> f64 {
    ChiSquared::new(dof as f64).map_or(0.0, |d| d.inverse_cdf(p.clamp(0.0, 1.0)))
}

/// The central 95 % interval of the mean of `instants` independent chi-square values of `dof` degrees of freedom each.
///
/// Their sum is chi-square with `instants · dof` degrees of freedom. Values that follow each other in time are correlated and
/// spread wider than this.
pub fn mean_band95(instants: usize, dof: usize) -> Option<(f64, f64)> {
    let n = instants * dof;
    (n > 0).then(|| {
        let scale = 1.0 / instants as f64;
        (scale * chi_square_quantile(n, 0.025), scale * chi_square_quantile(n, 0.975))
    })
}

/// The `p`-quantile of `sorted` (ascending, not empty): linear between order statistics, at position `p·(n − 1)`.
pub(super) fn percentile(sorted: &[f64], p: f64) -> f64 {
    let at = p * (sorted.len() - 1) as f64;
    let low = at.floor() as usize;
    let high = (low + 1).min(sorted.len() - 1);
    sorted[low] + (at - low as f64) * (sorted[high] - sorted[low])
}

/// Quantile of Student's distribution of `dof ≥ 1` degrees of freedom, the normal one's of infinitely many; `p` between 0 and 1.
pub fn student_quantile(dof: f64, p: f64) -> f64 {
    let normal = || Normal::standard().inverse_cdf(p);
    if dof.is_infinite() {
        normal()
    } else {
        StudentsT::new(0.0, 1.0, dof).map_or_else(|_| normal(), |t| t.inverse_cdf(p))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentile_of_four_values_interpolates_linearly() {
        let v = [1.0, 2.0, 4.0, 8.0];
        assert_eq!(percentile(&v, 0.5), 3.0); // position 1.5
        // Position 2.7; 0.9·3 is rounded.
        assert!((percentile(&v, 0.9) - 6.8).abs() < 1e-14);
        assert_eq!((percentile(&v, 0.0), percentile(&v, 1.0)), (1.0, 8.0));
        assert_eq!(percentile(&[5.0], 0.95), 5.0);
    }

    #[test]
    fn chi_square_quantiles_match_printed_tables() {
        // Abramowitz and Stegun, table 26.8; printed to five digits.
        for (dof, p, printed) in [(1, 0.95, 3.84146), (2, 0.95, 5.99146), (10, 0.025, 3.24697), (100, 0.975, 129.561)] {
            let got = chi_square_quantile(dof, p);
            assert!((got - printed).abs() < 1e-5 * printed, "{dof} {p}: {got}");
        }
        assert_eq!(chi_square_quantile(0, 0.95), 0.0);
    }

    #[test]
    fn student_quantiles_match_printed_tables() {
        // Abramowitz and Stegun, table 26.10.
        for (dof, printed) in [(1.0, 12.706), (4.0, 2.776), (30.0, 2.042), (f64::INFINITY, 1.960)] {
            assert!((student_quantile(dof, 0.975) - printed).abs() < 1e-3, "{dof}: {}", student_quantile(dof, 0.975));
        }
    }

    #[test]
    fn chi_square_quantile_of_many_degrees_of_freedom_is_nearly_normal() {
        // Wilson and Hilferty: relative error O(1/dof^2) at these sizes, far below 1e-7.
        for dof in [20_000, 2_000_000] {
            let n = dof as f64;
            let wanted = n * (1.0 - 2.0 / (9.0 * n) + 1.959_963_984_540_054 * (2.0 / (9.0 * n)).sqrt()).powi(3);
            let got = chi_square_quantile(dof, 0.975);
            assert!((got / wanted - 1.0).abs() < 1e-7, "{dof}: {got} {wanted}");
        }
    }

    #[test]
    fn band_of_a_mean_narrows_with_the_root_of_its_size() {
        let (low, high) = mean_band95(1, 2).unwrap();
        // chi-square of 2 dof is exponential with mean 2.
        assert!((low + 2.0 * 0.975_f64.ln()).abs() < 1e-9 && (high + 2.0 * 0.025_f64.ln()).abs() < 1e-9);
        let (low, high) = mean_band95(10_000, 2).unwrap();
        // Standard deviation of the mean: 2/sqrt(10 000) = 0.02; skewness moves the ends by less than 1e-3.
        assert!((low - (2.0 - 0.0392)).abs() < 1e-3 && (high - 2.0392).abs() < 1e-3, "{low} {high}");
        assert_eq!(mean_band95(0, 2), None);
    }
}
