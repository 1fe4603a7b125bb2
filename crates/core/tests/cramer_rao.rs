//! The posterior Cramér–Rao bound against conditioning, information matrices and simulated losses.

mod oracle;

use fixtrail_core::cramer_rao::{measured, moved};
use fixtrail_core::{Matrix, Row, Vector};
use nalgebra::DMatrix;
use oracle::fixed;
use oracle::random::{self, Family, Random};
use oracle::{Run, Verdict};

/// The bound after the last instant of a linear run.
fn bound(run: &Run, arrival: impl Fn(usize) -> f64) -> Matrix<3, 3> {
    let mut p = fixed::square(&run.prior.as_ref().expect("a prior").1);
    for (k, at) in run.instants.iter().enumerate() {
        if k > 0 {
            let leap = fixed::leap(Some(&run.instants[k - 1]));
            p = moved(&p, &leap.f, &leap.q);
        }
        p = measured(&p, &fixed::rows::<3>(at), arrival(k));
    }
    p
}

fn family() -> Family {
    Family { len: 8, n: 3, q: 2, p: 2, varying: true, prior: true, loss: 0.0, singular: false }
}

#[test]
fn bound_of_a_linear_model_is_the_covariance_given_all_measurements() {
    let mut rng = Random::new(3);
    for trial in 0..50 {
        let run = random::run(&mut rng, &family());
        let Verdict::Determined(truth) = run.posterior(run.start(), 0..run.len(), run.len() - 1) else { panic!() };
        let ours = bound(&run, |_| 1.0);
        let worst = (0..9).map(|e| (ours[(e / 3, e % 3)] - truth.cov[(e / 3, e % 3)]).abs()).fold(0.0, f64::max);
        // Two ways through a dozen products each.
        assert!(worst < 1e-9 * truth.cov.amax(), "{trial}: {worst}");
    }
}

#[test]
fn part_of_the_information_counts_as_often_as_it_arrives() {
    // (P⁻¹ + λ Σ h hᵀ / r)⁻¹ by inversion.
    let mut rng = Random::new(4);
    let prior = rng.definite(3, 2.0);
    let rows: Vec<Row<3>> =
        (0..4).map(|i| Row { h: Vector::from_fn(|_, _| rng.normal()), residual: 0.0, var: 0.5 + i as f64 }).collect();
    for arrival in [0.0, 0.1, 0.7, 1.0] {
        let ours = measured(&fixed::square::<3>(&prior), &rows, arrival);
        let mut information = prior.clone().try_inverse().expect("definite");
        for row in &rows {
            let h = DMatrix::from_column_slice(3, 1, row.h.as_slice());
            information += &h * h.transpose() * (arrival / row.var);
        }
        let truth = information.try_inverse().expect("definite");
        for (i, j) in (0..3).flat_map(|i| (0..3).map(move |j| (i, j))) {
            assert!((ours[(i, j)] - truth[(i, j)]).abs() < 1e-12 * truth.amax(), "{arrival}: {ours} {truth}");
        }
    }
}

#[test]
fn bound_lies_below_the_mean_covariance_of_a_filter_that_knows_its_losses() {
    let mut rng = Random::new(5);
    for trial in 0..20 {
        let run = random::run(&mut rng, &family());
        let (arrival, draws) = (0.6, 2000);
        let ours = bound(&run, |_| arrival);
        let traces: Vec<f64> = (0..draws)
            .map(|_| {
                let came: Vec<f64> = (0..run.len()).map(|_| f64::from(u8::from(rng.chance(arrival)))).collect();
                bound(&run, |k| came[k]).trace()
            })
            .collect();
        let mean = traces.iter().sum::<f64>() / f64::from(draws);
        let sd = (traces.iter().map(|t| (t - mean).powi(2)).sum::<f64>() / f64::from(draws)).sqrt();
        assert!(ours.trace() < mean + 4.0 * sd / f64::from(draws).sqrt(), "{trial}: {} {mean}", ours.trace());
    }
}
