//! Kalman filters of linear models.

use crate::input::{measured, path_m};
use crate::race::{Contender, Settings, Stepper, race};
use adskalman::{
    CovarianceUpdateMethod, KalmanFilterNoControl, ObservationModel, StateAndCovariance, TransitionModelLinearNoControl,
};
use fixtrail_core::estimators::kalman::{Robust, predict, update};
use fixtrail_core::kernels::{Axes, Chain, Dense, Leap, Packed, series};
use fixtrail_core::models::{Integrators, Linear};
use fixtrail_core::sensors::{self, position};
use fixtrail_core::{Belief, Matrix, Vector};
use kfilter::kalman::{Kalman, KalmanFilter, KalmanPredict, KalmanUpdate};
use kfilter::measurement::{LinearMeasurement, Measurement};
use kfilter::system::LinearNoInputSystem;
use nalgebra::{Const, DimMin};
use nalgebra34::{SMatrix as Matrix34, SVector as Vector34};

/// A model, complete.
pub struct Problem<const N: usize, const Q: usize> {
    integrators: Integrators<N>,
    dt_s: f64,
    a: Matrix<N, N>,
    q: Matrix<N, N>,
    c: Matrix<Q, N>,
    pub var_m2: f64,
    pub prior: Belief<N>,
}

impl<const N: usize, const Q: usize> Problem<N, Q> {
    /// The first `Q` components of a chain of integrators, measured every `dt_s` seconds.
    pub fn new(integrators: Integrators<N>, dt_s: f64, sd_m: f64) -> Self {
        let leap = integrators.leap(&Vector::zeros(), dt_s);
        let prior = Belief { mean: Vector::zeros(), cov: Matrix::identity() * 25.0 };
        Problem { integrators, dt_s, a: leap.f, q: leap.q, c: Matrix::identity(), var_m2: sd_m * sd_m, prior }
    }

    pub fn transposed(&self) -> Transposed<N, Q> {
        let r = Matrix::identity() * self.var_m2;
        Transposed { f: self.a, ft: self.a.transpose(), q: self.q, h: self.c, ht: self.c.transpose(), r }
    }
}

/// Fixtrail, matrices given once.
struct Given<'a, const N: usize, const Q: usize> {
    motion: Linear<N>,
    c: [Vector<N>; Q],
    problem: &'a Problem<N, Q>,
    belief: Belief<N>,
}

impl<const N: usize, const Q: usize> Stepper<N, Q> for Given<'_, N, Q> {
    fn step(&mut self, z: &[f64; Q]) -> [f64; N] {
        let prior = predict(&self.belief, &self.motion.leap(&self.belief.mean, &Vector::zeros()));
        let rows =
            std::array::from_fn::<_, Q, _>(|i| sensors::linear(&self.c[i], &prior.mean, z[i], self.problem.var_m2));
        (self.belief, _) = update(&prior, &rows, Robust::None).expect("a sound model and finite data");
        self.belief.mean.into()
    }
}

/// Fixtrail, discretised anew each step, as irregular sampling needs.
struct Leaping<'a, const N: usize, const Q: usize> {
    problem: &'a Problem<N, Q>,
    belief: Belief<N>,
}

impl<const N: usize, const Q: usize> Stepper<N, Q> for Leaping<'_, N, Q> {
    fn step(&mut self, z: &[f64; Q]) -> [f64; N] {
        let prior = predict(&self.belief, &self.problem.integrators.leap(&self.belief.mean, self.problem.dt_s));
        let rows = std::array::from_fn::<_, Q, _>(|i| position(&prior.mean, i, z[i], self.problem.var_m2));
        (self.belief, _) = update(&prior, &rows, Robust::None).expect("a sound model and finite data");
        self.belief.mean.into()
    }
}

struct Kfilter<const N: usize, const Q: usize> {
    filter: Kalman<f64, N, 0, LinearNoInputSystem<f64, N>>,
    measurement: LinearMeasurement<f64, N, Q>,
}

impl<const N: usize, const Q: usize> Kfilter<N, Q> {
    fn new(p: &Problem<N, Q>) -> Self {
        let noise = Matrix34::<f64, Q, Q>::identity() * p.var_m2;
        Kfilter {
            filter: Kalman::new(
                Matrix34::from_column_slice(p.a.as_slice()),
                Matrix34::from_column_slice(p.q.as_slice()),
                Vector34::from_column_slice(p.prior.mean.as_slice()),
                Matrix34::from_column_slice(p.prior.cov.as_slice()),
            ),
            measurement: LinearMeasurement::new(Matrix34::from_column_slice(p.c.as_slice()), noise, Vector34::zeros()),
        }
    }
}

impl<const N: usize, const Q: usize> Stepper<N, Q> for Kfilter<N, Q> {
    fn step(&mut self, z: &[f64; Q]) -> [f64; N] {
        self.filter.predict().expect("a sound model");
        self.measurement.set_measurement((*z).into());
        self.filter.update(&self.measurement).expect("an invertible innovation covariance");
        (*self.filter.state()).into()
    }
}

struct Adskalman<const N: usize, const Q: usize> {
    model: Transposed<N, Q>,
    method: CovarianceUpdateMethod,
    state: StateAndCovariance<f64, Const<N>>,
}

/// A model as adskalman wants it: each matrix with its transpose.
pub struct Transposed<const N: usize, const Q: usize> {
    f: Matrix<N, N>,
    ft: Matrix<N, N>,
    q: Matrix<N, N>,
    h: Matrix<Q, N>,
    ht: Matrix<N, Q>,
    r: Matrix<Q, Q>,
}

#[allow(non_snake_case)] // the trait's names
impl<const N: usize, const Q: usize> TransitionModelLinearNoControl<f64, Const<N>> for Transposed<N, Q> {
    fn F(&self) -> &Matrix<N, N> {
        &self.f
    }
    fn FT(&self) -> &Matrix<N, N> {
        &self.ft
    }
    fn Q(&self) -> &Matrix<N, N> {
        &self.q
    }
}

#[allow(non_snake_case)] // the trait's names
impl<const N: usize, const Q: usize> ObservationModel<f64, Const<N>, Const<Q>> for Transposed<N, Q>
where
    Const<Q>: DimMin<Const<Q>, Output = Const<Q>>,
{
    fn H(&self) -> &Matrix<Q, N> {
        &self.h
    }
    fn HT(&self) -> &Matrix<N, Q> {
        &self.ht
    }
    fn R(&self) -> &Matrix<Q, Q> {
        &self.r
    }
}

impl<const N: usize, const Q: usize> Adskalman<N, Q> {
    fn new(p: &Problem<N, Q>, method: CovarianceUpdateMethod) -> Self {
        Adskalman { model: p.transposed(), method, state: StateAndCovariance::new(p.prior.mean, p.prior.cov) }
    }
}

impl<const N: usize, const Q: usize> Stepper<N, Q> for Adskalman<N, Q>
where
    Const<Q>: DimMin<Const<Q>, Output = Const<Q>>,
{
    fn step(&mut self, z: &[f64; Q]) -> [f64; N] {
        let filter = KalmanFilterNoControl::<f64, Const<N>, Const<Q>>::new(&self.model, &self.model);
        self.state = filter
            .step_with_options(&self.state, &Vector::<Q>::from(*z), self.method)
            .expect("a positive definite innovation covariance");
        (*self.state.state()).into()
    }
}

fn compare<'a, const N: usize, const Q: usize>(
    title: &str,
    p: &'a Problem<N, Q>,
    z: &'a [[f64; Q]],
    settings: &Settings,
    more: impl FnOnce(&mut Vec<Contender<'a>>),
) -> Result<(), String>
where
    Const<Q>: DimMin<Const<Q>, Output = Const<Q>>,
{
    let given = || Given {
        motion: Linear { a: p.a, q: p.q },
        c: std::array::from_fn(|i| p.c.row(i).transpose()),
        problem: p,
        belief: p.prior,
    };
    let motion = Dense::new(&p.a, &p.q);
    let rows: [[f64; N]; Q] = std::array::from_fn(|i| p.c.row(i).transpose().into());
    let contenders = [
        Contender::stepping("fixtrail, general kernel, step by step", z, move || General {
            motion,
            rows,
            var: p.var_m2,
            belief: Packed::of(&p.prior),
        }),
        Contender::new("fixtrail, general kernel, series", move |out| {
            let problem = fixtrail_lanes::Linear { motion, rows, vars: [p.var_m2; Q], start: Packed::of(&p.prior) };
            fixtrail_lanes::linear(&problem, z.as_flattened(), z.len(), out);
        }),
        Contender::stepping("fixtrail", z, given),
        Contender::stepping("fixtrail, discretising each step", z, || Leaping { problem: p, belief: p.prior }),
        Contender::stepping("kfilter 0.5", z, || Kfilter::new(p)),
        Contender::stepping("adskalman 0.18, Joseph form", z, || Adskalman::new(p, CovarianceUpdateMethod::JosephForm)),
        Contender::stepping("adskalman 0.18, short form", z, || {
            Adskalman::new(p, CovarianceUpdateMethod::OptimalKalmanForcedSymmetric)
        }),
    ];
    let mut all = contenders.into();
    more(&mut all);
    race(title, N, settings, &all)
}

/// The kernel of any linear model, called for each step.
struct General<const N: usize, const Q: usize> {
    motion: Dense<f64, N>,
    rows: [[f64; N]; Q],
    var: f64,
    belief: Packed<f64, N>,
}

impl<const N: usize, const Q: usize> Stepper<N, Q> for General<N, Q> {
    fn step(&mut self, z: &[f64; Q]) -> [f64; N] {
        let mut next = self.belief.predict(&self.motion);
        let mut least = f64::INFINITY;
        for (row, z) in self.rows.iter().zip(z) {
            let s;
            (next, s) = next.measure(row, *z, self.var);
            least = least.min(s);
        }
        self.belief = next.checked(least).expect("finite data");
        self.belief.mean
    }
}

/// The kernel of a chain of integrators, called for each step.
struct Kernel<const N: usize> {
    belief: Chain<f64, N>,
    leap: Leap<f64, N>,
    var: f64,
}

impl<const N: usize> Stepper<N, 1> for Kernel<N> {
    fn step(&mut self, z: &[f64; 1]) -> [f64; N] {
        self.belief = self.belief.predict(&self.leap).checked_update(z[0], self.var).expect("finite data").0;
        self.belief.mean
    }
}

/// Constant acceleration on one axis every 2 s, position measured.
pub fn constant_acceleration(settings: &Settings) -> Result<(), String> {
    let integrators = Integrators::<3>::new(3, 1, [0.01, 0.0, 0.0]).map_err(|e| e.to_string())?;
    let problem = Problem::new(integrators, 2.0, 0.05);
    let z = measured(settings.steps, settings.seed, 0.05, |k| [path_m(k as f64 * 2.0 / 300.0)[0]]);
    let start = Chain::of(&problem.prior);
    let leap = Leap::<f64, 3>::new(0.01, 2.0);
    let var = problem.var_m2;
    let alone = z.as_flattened();
    compare("kalman, constant acceleration, n=3 q=1", &problem, &z, settings, |all| {
        all.push(Contender::stepping("fixtrail, kernel, step by step", &z, move || Kernel {
            belief: start,
            leap,
            var,
        }));
        all.push(Contender::new("fixtrail, kernel, gain never kept", move |out| {
            let mut belief = start;
            for (z, out) in alone.iter().zip(out.as_chunks_mut::<3>().0) {
                belief = belief.predict(&leap).update(*z, var).0;
                *out = belief.mean;
            }
        }));
        all.push(Contender::new("fixtrail, kernel, series", move |out| {
            series(&start, &leap, var, alone, out.as_chunks_mut::<3>().0);
        }));
    })
}

/// Many tracks of constant acceleration, with `lost` of their measurements lost.
pub fn many(settings: &Settings, lost: f64) -> Result<(), String> {
    const STEPS: usize = 800;
    let tracks = (settings.steps / STEPS).max(8);
    let integrators = Integrators::<3>::new(3, 1, [0.01, 0.0, 0.0]).map_err(|e| e.to_string())?;
    let problem = Problem::<3, 1>::new(integrators, 2.0, 0.05);
    let mut z: Vec<f64> = Vec::new();
    for track in 0..tracks {
        let one = measured(STEPS, settings.seed + track as u64, 0.05, |k| [path_m(k as f64 * 2.0 / 300.0)[0]]);
        // Every so manyth in place of chance: the same for all contenders.
        let every = if lost > 0.0 { (1.0 / lost) as usize } else { usize::MAX };
        z.extend(one.iter().enumerate().map(|(k, z)| if (k + track) % every == every - 1 { f64::NAN } else { z[0] }));
    }
    let many = fixtrail_lanes::Problem { leap: Leap::new(0.01, 2.0), var: problem.var_m2, start: problem.prior };
    let (z, problem) = (&z, &problem);
    let contenders = [
        Contender::new("fixtrail, tracks side by side", move |out| fixtrail_lanes::filter(&many, z, STEPS, out)),
        Contender::new("fixtrail, tracks one by one", move |out| {
            let (start, leap) = (Chain::of(&problem.prior), Leap::<f64, 3>::new(0.01, 2.0));
            for (z, out) in z.chunks(STEPS).zip(out.chunks_mut(STEPS * 3)) {
                series(&start, &leap, problem.var_m2, z, out.as_chunks_mut::<3>().0);
            }
        }),
        Contender::new("kfilter 0.5", move |out| {
            for (z, out) in z.chunks(STEPS).zip(out.chunks_mut(STEPS * 3)) {
                let mut filter = Kfilter::<3, 1>::new(problem);
                for (z, out) in z.iter().zip(out.as_chunks_mut::<3>().0) {
                    *out = if z.is_nan() {
                        filter.filter.predict().expect("a sound model");
                        (*filter.filter.state()).into()
                    } else {
                        filter.step(&[*z])
                    };
                }
            }
        }),
        Contender::new("copying z and the estimates", move |out| {
            for (z, out) in z.iter().zip(out.as_chunks_mut::<3>().0) {
                *out = [*z; 3];
            }
        }),
    ];
    let title = format!("{tracks} tracks x {STEPS}, n=3 q=1, {:.0} % lost", 100.0 * lost);
    race(&title, 3, &Settings { steps: tracks * STEPS, ..*settings }, &contenders)
}

/// Constant velocity in the plane every second, both coordinates measured.
pub fn constant_velocity(settings: &Settings) -> Result<(), String> {
    let integrators = Integrators::<4>::new(2, 2, [0.1, 0.1, 0.0]).map_err(|e| e.to_string())?;
    let problem = Problem::new(integrators, 1.0, 0.5);
    let z = measured(settings.steps, settings.seed, 0.5, |k| path_m(k as f64 / 300.0));
    let chain = Integrators::<2>::new(2, 1, [0.1, 0.0, 0.0]).map_err(|e| e.to_string())?;
    let one = Chain::of(&Problem::<2, 1>::new(chain, 1.0, 0.5).prior);
    let start = Axes { means: [one.mean; 2], cov: one.cov };
    let (leap, var) = (Leap::<f64, 2>::new(0.1, 1.0), problem.var_m2);
    compare("kalman, constant velocity, n=4 q=2", &problem, &z, settings, |all| {
        all.push(Contender::new("fixtrail, kernel, one covariance for both axes", |out| {
            let mut belief = start;
            for (z, out) in z.iter().zip(out.as_chunks_mut::<4>().0) {
                belief = belief.predict(&leap).update(z, var);
                let [[x, vx], [y, vy]] = belief.means;
                *out = [x, y, vx, vy];
            }
        }));
    })
}
