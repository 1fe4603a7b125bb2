//! Smoothers: over a whole series, and a fixed lag behind the newest measurement.

use crate::input::{measured, path_m};
use crate::kalman::Problem;
use crate::race::{Contender, Settings, race};
use adskalman::{CovarianceUpdateMethod, KalmanFilterNoControl, StateAndCovariance};
use fixtrail_core::Vector;
use fixtrail_core::kernels::{Chain, FixedLag, Leap, Past, smooth};
use fixtrail_core::models::Integrators;
use nalgebra::{Const, DimMin};
use std::cell::RefCell;

/// Steps behind the newest.
const LAG: usize = 5;

/// What adskalman makes of a series, from a state before its first interval.
fn smoothed<const N: usize, const Q: usize>(
    problem: &Problem<N, Q>,
    start: &StateAndCovariance<f64, Const<N>>,
    z: &[Vector<Q>],
) -> Vec<StateAndCovariance<f64, Const<N>>>
where
    Const<Q>: DimMin<Const<Q>, Output = Const<Q>>,
{
    let model = problem.transposed();
    KalmanFilterNoControl::<f64, Const<N>, Const<Q>>::new(&model, &model)
        .smooth(start, z)
        .expect("invertible covariances")
}

fn vectors<const Q: usize>(z: &[[f64; Q]]) -> Vec<Vector<Q>> {
    z.iter().map(|z| Vector::from(*z)).collect()
}

fn started<const N: usize, const Q: usize>(problem: &Problem<N, Q>) -> StateAndCovariance<f64, Const<N>> {
    StateAndCovariance::new(problem.prior.mean, problem.prior.cov)
}

/// adskalman over the whole series.
fn theirs<'a, const N: usize, const Q: usize>(problem: &'a Problem<N, Q>, z: &'a [[f64; Q]]) -> Contender<'a>
where
    Const<Q>: DimMin<Const<Q>, Output = Const<Q>>,
{
    let observations = vectors(z);
    Contender::new("adskalman 0.18", move |out| {
        let all = smoothed::<N, Q>(problem, &started::<N, Q>(problem), &observations);
        for (state, out) in all.iter().zip(out.as_chunks_mut::<N>().0) {
            *out = (*state.state()).into();
        }
    })
}

/// Constant acceleration on one axis, the whole series.
pub fn constant_acceleration(settings: &Settings) -> Result<(), String> {
    let integrators = Integrators::<3>::new(3, 1, [0.01, 0.0, 0.0]).map_err(|e| e.to_string())?;
    let problem = Problem::<3, 1>::new(integrators, 2.0, 0.05);
    let z = measured(settings.steps, settings.seed, 0.05, |k| [path_m(k as f64 * 2.0 / 300.0)[0]]);
    let (start, leap) = (Chain::of(&problem.prior), Leap::<f64, 3>::new(0.01, 2.0));
    let past = RefCell::new(vec![Past::EMPTY; settings.steps]);
    let ours = Contender::new("fixtrail, kernel", |out| {
        let (z, out) = (z.as_flattened(), out.as_chunks_mut::<3>().0);
        smooth(&start, &leap, problem.var_m2, z, &mut past.borrow_mut(), out);
    });
    race("smoother, constant acceleration, n=3 q=1", 3, settings, &[ours, theirs(&problem, &z)])
}

/// Constant velocity in the plane, the whole series.
pub fn constant_velocity(settings: &Settings) -> Result<(), String> {
    let integrators = Integrators::<4>::new(2, 2, [0.1, 0.1, 0.0]).map_err(|e| e.to_string())?;
    let problem = Problem::<4, 2>::new(integrators, 1.0, 0.5);
    let z = measured(settings.steps, settings.seed, 0.5, |k| path_m(k as f64 / 300.0));
    let chain = Integrators::<2>::new(2, 1, [0.1, 0.0, 0.0]).map_err(|e| e.to_string())?;
    let start = Chain::of(&Problem::<2, 1>::new(chain, 1.0, 0.5).prior);
    let leap = Leap::<f64, 2>::new(0.1, 1.0);
    let room = (vec![Past::EMPTY; settings.steps], vec![0.0; settings.steps], vec![[0.0; 2]; settings.steps]);
    let room = RefCell::new(room);
    let ours = Contender::new("fixtrail, kernel, one axis after the other", |out| {
        let (past, axis_z, means) = &mut *room.borrow_mut();
        for axis in 0..2 {
            for (axis_z, z) in axis_z.iter_mut().zip(&z) {
                *axis_z = z[axis];
            }
            smooth(&start, &leap, problem.var_m2, axis_z, past, means);
            for (mean, out) in means.iter().zip(out.as_chunks_mut::<4>().0) {
                (out[axis], out[axis + 2]) = (mean[0], mean[1]);
            }
        }
    });
    race("smoother, constant velocity, n=4 q=2", 4, settings, &[ours, theirs(&problem, &z)])
}

/// Constant acceleration, each state from the measurements up to five steps after it.
pub fn fixed_lag(settings: &Settings) -> Result<(), String> {
    let integrators = Integrators::<3>::new(3, 1, [0.01, 0.0, 0.0]).map_err(|e| e.to_string())?;
    let problem = Problem::<3, 1>::new(integrators, 2.0, 0.05);
    let z = measured(settings.steps, settings.seed, 0.05, |k| [path_m(k as f64 * 2.0 / 300.0)[0]]);
    let (start, leap) = (Chain::of(&problem.prior), Leap::<f64, 3>::new(0.01, 2.0));
    let observations = vectors(&z);
    let model = problem.transposed();
    let contenders = [
        Contender::new("fixtrail, kernel", |out| {
            let mut lagged = FixedLag::<3, LAG>::new(&start);
            for (z, out) in z.iter().zip(out.as_chunks_mut::<3>().0) {
                lagged.push(&leap, problem.var_m2, z[0]);
                *out = lagged.mean().unwrap_or_default();
            }
        }),
        Contender::new("adskalman 0.18, smoothing the last steps each time", |out| {
            let filter = KalmanFilterNoControl::<f64, Const<3>, Const<1>>::new(&model, &model);
            let mut filtered = vec![started(&problem)];
            for (k, (z, out)) in observations.iter().zip(out.as_chunks_mut::<3>().0).enumerate() {
                let method = CovarianceUpdateMethod::OptimalKalmanForcedSymmetric;
                let next = filter.step_with_options(&filtered[k], z, method).expect("a sound model");
                filtered.push(next);
                *out = if k + 1 < LAG { [0.0; 3] } else { prior_to(&filter, &filtered[k + 1 - LAG..]) };
            }
        }),
    ];
    race("smoother, lag 5, constant acceleration, n=3 q=1", 3, settings, &contenders)
}

/// The first of a few filtered states given all of them.
fn prior_to(
    filter: &KalmanFilterNoControl<'_, f64, Const<3>, Const<1>>,
    filtered: &[StateAndCovariance<f64, Const<3>>],
) -> [f64; 3] {
    let all = filter.smooth_from_filtered(filtered.to_vec()).expect("invertible covariances");
    (*all[0].state()).into()
}
