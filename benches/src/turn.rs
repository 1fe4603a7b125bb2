//! Extended Kalman filter: coordinated turn, one range per step to four anchors in turn.

use crate::input::{measured, path_m};
use crate::race::{Contender, Settings, Stepper, race};
use adskalman::{CovarianceUpdateMethod, ObservationModel, StateAndCovariance, TransitionModelLinearNoControl};
use fixtrail_core::estimators::kalman::{Robust, predict, update};
use fixtrail_core::kernels::{Packed, Turn};
use fixtrail_core::models::CoordinatedTurn;
use fixtrail_core::sensors::range;
use fixtrail_core::{Belief, Matrix, Vector};
use kfilter::kalman::{Kalman, KalmanFilter, KalmanPredict, KalmanUpdate};
use kfilter::measurement::{LinearisableMeasurement, Measurement};
use kfilter::system::{LinearisableSystem, NoInputSystem, System};
use nalgebra::Const;
use nalgebra34::{SMatrix as Matrix34, SVector as Vector34};

const DT_S: f64 = 0.1;
const VAR_M2: f64 = 0.01;
const ANCHORS_M: [[f64; 3]; 4] = [[-60.0, -60.0, 0.0], [60.0, -60.0, 0.0], [60.0, 60.0, 0.0], [-60.0, 60.0, 0.0]];

struct Fixtrail {
    motion: CoordinatedTurn,
    belief: Belief<5>,
    k: usize,
}

impl Stepper<5, 1> for Fixtrail {
    fn step(&mut self, z: &[f64; 1]) -> [f64; 5] {
        let prior = predict(&self.belief, &self.motion.leap(&self.belief.mean, DT_S));
        let row = range(&prior.mean, 2, ANCHORS_M[self.k % 4], None, z[0], VAR_M2);
        (self.belief, _) = update(&prior, &[row], Robust::None).expect("a sound model and finite data");
        self.k += 1;
        self.belief.mean.into()
    }
}

/// The kernel, called for each step.
struct Kernel {
    motion: Turn<f64>,
    belief: Packed<f64, 5>,
    k: usize,
}

impl Stepper<5, 1> for Kernel {
    fn step(&mut self, z: &[f64; 1]) -> [f64; 5] {
        let [x, y, _] = ANCHORS_M[self.k % 4];
        let (next, s) = self.belief.predict(&self.motion).range(&[x, y], z[0], VAR_M2);
        self.belief = next.checked(s).expect("a sound model and finite data");
        self.k += 1;
        self.belief.mean
    }
}

/// The turn as a user of the peers writes it: value and rows of the Jacobian.
fn turn_by_hand(x: &[f64; 5]) -> ([f64; 5], [[f64; 5]; 5]) {
    let [px, py, vx, vy, w] = *x;
    let (sin, cos) = (w * DT_S).sin_cos();
    let (s, c, ds, dc) = if w.abs() < 1e-4 {
        let t2 = DT_S * DT_S;
        (DT_S - w * w * t2 * DT_S / 6.0, w * t2 / 2.0, -w * t2 * DT_S / 3.0, t2 / 2.0)
    } else {
        // 1 − cos without cancellation: the derivative divides by w once more.
        let (s, c) = (sin / w, sin * sin / ((1.0 + cos) * w));
        (s, c, (DT_S * cos - s) / w, (DT_S * sin - c) / w)
    };
    let (vx_next, vy_next) = (cos * vx - sin * vy, sin * vx + cos * vy);
    let value = [px + s * vx - c * vy, py + c * vx + s * vy, vx_next, vy_next, w];
    let jacobian = [
        [1.0, 0.0, s, -c, ds * vx - dc * vy],
        [0.0, 1.0, c, s, dc * vx + ds * vy],
        [0.0, 0.0, cos, -sin, -DT_S * vy_next],
        [0.0, 0.0, sin, cos, DT_S * vx_next],
        [0.0, 0.0, 0.0, 0.0, 1.0],
    ];
    (value, jacobian)
}

fn range_by_hand(x: &[f64; 5], k: usize) -> (f64, [f64; 5]) {
    let [ax, ay, _] = ANCHORS_M[k % 4];
    let (dx, dy) = (x[0] - ax, x[1] - ay);
    let d = (dx * dx + dy * dy).sqrt();
    (d, [dx / d, dy / d, 0.0, 0.0, 0.0])
}

/// The turn as a kfilter system.
struct TurnSystem {
    x: Vector34<f64, 5>,
    f: Matrix34<f64, 5, 5>,
    ft: Matrix34<f64, 5, 5>,
    q: Matrix34<f64, 5, 5>,
}

impl System<f64, 5, 0> for TurnSystem {
    fn covariance(&self) -> &Matrix34<f64, 5, 5> {
        &self.q
    }
    fn state(&self) -> &Vector34<f64, 5> {
        &self.x
    }
    fn state_mut(&mut self) -> &mut Vector34<f64, 5> {
        &mut self.x
    }
}

impl LinearisableSystem<f64, 5, 0> for TurnSystem {
    fn transition(&self) -> &Matrix34<f64, 5, 5> {
        &self.f
    }
    fn transition_transpose(&self) -> &Matrix34<f64, 5, 5> {
        &self.ft
    }
}

impl NoInputSystem<f64, 5> for TurnSystem {
    fn step(&mut self) -> &Vector34<f64, 5> {
        let (value, jacobian) = turn_by_hand(&self.x.into());
        self.x = value.into();
        // An array of rows is the transpose by columns.
        self.ft = jacobian.into();
        self.f = self.ft.transpose();
        &self.x
    }
    fn predict(&self, x: &Vector34<f64, 5>) -> Vector34<f64, 5> {
        turn_by_hand(&(*x).into()).0.into()
    }
}

/// A range as a kfilter measurement, linearised where it is made.
struct RangeMeasurement {
    z: Vector34<f64, 1>,
    expected: Vector34<f64, 1>,
    h: Matrix34<f64, 1, 5>,
    ht: Matrix34<f64, 5, 1>,
    r: Matrix34<f64, 1, 1>,
}

impl Measurement<f64, 5, 1> for RangeMeasurement {
    fn covariance(&self) -> &Matrix34<f64, 1, 1> {
        &self.r
    }
    fn measurement(&self) -> &Vector34<f64, 1> {
        &self.z
    }
    fn set_measurement(&mut self, z: Vector34<f64, 1>) {
        self.z = z;
    }
    fn predict(&self, _x: &Vector34<f64, 5>) -> Vector34<f64, 1> {
        self.expected
    }
}

impl LinearisableMeasurement<f64, 5, 1> for RangeMeasurement {
    fn observation(&self) -> &Matrix34<f64, 1, 5> {
        &self.h
    }
    fn observation_transpose(&self) -> &Matrix34<f64, 5, 1> {
        &self.ht
    }
}

struct Kfilter {
    filter: Kalman<f64, 5, 0, TurnSystem>,
    k: usize,
}

impl Stepper<5, 1> for Kfilter {
    fn step(&mut self, z: &[f64; 1]) -> [f64; 5] {
        KalmanPredict::predict(&mut self.filter).expect("a sound model");
        let (expected, h) = range_by_hand(&(*self.filter.state()).into(), self.k);
        let ht = Vector34::from(h);
        let measurement =
            RangeMeasurement { z: (*z).into(), expected: [expected].into(), h: ht.transpose(), ht, r: [VAR_M2].into() };
        self.filter.update(&measurement).expect("an invertible innovation covariance");
        self.k += 1;
        (*self.filter.state()).into()
    }
}

/// The turn linearised, as adskalman wants it.
struct LinearisedTurn {
    next: Vector<5>,
    f: Matrix<5, 5>,
    ft: Matrix<5, 5>,
    q: Matrix<5, 5>,
}

#[allow(non_snake_case)] // the trait's names
impl TransitionModelLinearNoControl<f64, Const<5>> for LinearisedTurn {
    fn F(&self) -> &Matrix<5, 5> {
        &self.f
    }
    fn FT(&self) -> &Matrix<5, 5> {
        &self.ft
    }
    fn Q(&self) -> &Matrix<5, 5> {
        &self.q
    }
    fn predict(&self, previous: &StateAndCovariance<f64, Const<5>>) -> StateAndCovariance<f64, Const<5>> {
        StateAndCovariance::new(self.next, self.f * previous.covariance() * self.ft + self.q)
    }
}

/// A range linearised, as adskalman wants it.
struct LinearisedRange {
    expected: f64,
    h: Matrix<1, 5>,
    ht: Matrix<5, 1>,
    r: Matrix<1, 1>,
}

#[allow(non_snake_case)] // the trait's names
impl ObservationModel<f64, Const<5>, Const<1>> for LinearisedRange {
    fn H(&self) -> &Matrix<1, 5> {
        &self.h
    }
    fn HT(&self) -> &Matrix<5, 1> {
        &self.ht
    }
    fn R(&self) -> &Matrix<1, 1> {
        &self.r
    }
    fn predict_observation(&self, _state: &Vector<5>) -> Vector<1> {
        [self.expected].into()
    }
}

struct Adskalman {
    state: StateAndCovariance<f64, Const<5>>,
    method: CovarianceUpdateMethod,
    q: Matrix<5, 5>,
    k: usize,
}

impl Stepper<5, 1> for Adskalman {
    fn step(&mut self, z: &[f64; 1]) -> [f64; 5] {
        let (next, jacobian) = turn_by_hand(&(*self.state.state()).into());
        let ft = Matrix::<5, 5>::from(jacobian);
        let turn = LinearisedTurn { next: next.into(), f: ft.transpose(), ft, q: self.q };
        let prior = turn.predict(&self.state);
        let (expected, h) = range_by_hand(&next, self.k);
        let ht = Vector::from(h);
        let range = LinearisedRange { expected, h: ht.transpose(), ht, r: [VAR_M2].into() };
        self.state = range
            .update(&prior, &Vector::<1>::from(*z), self.method)
            .expect("a positive definite innovation covariance");
        self.k += 1;
        (*self.state.state()).into()
    }
}

/// Distances along the path from step `first` on, one round a minute, and where a filter of them starts.
fn ranged(steps: usize, seed: u64, first: usize) -> (Vec<[f64; 1]>, Belief<5>) {
    let truth = |k: usize| path_m((first + k) as f64 * DT_S / 60.0);
    let z = measured(steps, seed, VAR_M2.sqrt(), |k| {
        let ([x, y], [ax, ay, _]) = (truth(k + 1), ANCHORS_M[k % 4]);
        [(x - ax).hypot(y - ay)]
    });
    let ([x, y], [x1, y1]) = (truth(0), truth(1));
    let mean = Vector::from([x + 0.5, y - 0.5, (x1 - x) / DT_S, (y1 - y) / DT_S, 0.01]);
    (z, Belief { mean, cov: Matrix::from_diagonal(&Vector::from([1.0, 1.0, 1.0, 1.0, 0.05])) })
}

fn turning() -> Result<CoordinatedTurn, String> {
    CoordinatedTurn::new([0.1, 0.1], 0.01).map_err(|e| e.to_string())
}

fn kfilter(start: &Belief<5>, q: &Matrix<5, 5>) -> Kfilter {
    let system = TurnSystem {
        x: Vector34::from_column_slice(start.mean.as_slice()),
        f: Matrix34::zeros(),
        ft: Matrix34::zeros(),
        q: Matrix34::from_column_slice(q.as_slice()),
    };
    Kfilter { filter: Kalman::new_custom(system, Matrix34::from_column_slice(start.cov.as_slice())), k: 0 }
}

/// Coordinated turn every 0.1 s.
pub fn range_only(settings: &Settings) -> Result<(), String> {
    let motion = turning()?;
    let (z, prior) = ranged(settings.steps, settings.seed, 0);
    let mean = prior.mean;
    let q = motion.leap(&mean, DT_S).q;
    let adskalman = |method| Adskalman { state: StateAndCovariance::new(mean, prior.cov), method, q, k: 0 };
    let contenders = [
        Contender::stepping("fixtrail, kernel, step by step", &z, || Kernel {
            motion: Turn::new(&motion, DT_S),
            belief: Packed::of(&prior),
            k: 0,
        }),
        Contender::stepping("fixtrail", &z, || Fixtrail { motion, belief: prior, k: 0 }),
        Contender::stepping("kfilter 0.5", &z, || kfilter(&prior, &q)),
        Contender::stepping("adskalman 0.18, Joseph form", &z, || adskalman(CovarianceUpdateMethod::JosephForm)),
        Contender::stepping("adskalman 0.18, short form", &z, || {
            adskalman(CovarianceUpdateMethod::OptimalKalmanForcedSymmetric)
        }),
    ];
    race("ekf, coordinated turn and range, n=5 q=1", 5, settings, &contenders)
}

/// Many tracks of the same.
pub fn many(settings: &Settings) -> Result<(), String> {
    const STEPS: usize = 800;
    let tracks = (settings.steps / STEPS).max(8);
    let motion = turning()?;
    let (mut z, mut starts) = (Vec::new(), Vec::new());
    for track in 0..tracks {
        let (one, start) = ranged(STEPS, settings.seed + track as u64, 37 * track);
        z.extend(one);
        starts.push(start);
    }
    let packed: Vec<_> = starts.iter().map(Packed::of).collect();
    let anchors_m = ANCHORS_M.map(|[x, y, _]| [x, y]);
    let ranging = fixtrail_lanes::Ranging { motion: Turn::new(&motion, DT_S), anchors_m: &anchors_m, var: VAR_M2 };
    let q = motion.leap(&starts[0].mean, DT_S).q;
    let (z, starts) = (&z, &starts);
    let contenders = [
        Contender::new("fixtrail, tracks side by side", |out| {
            fixtrail_lanes::range(&ranging, &packed, z.as_flattened(), STEPS, out);
        }),
        Contender::new("kfilter 0.5", |out| {
            let tracks = z.chunks(STEPS).zip(out.chunks_mut(STEPS * 5));
            for (start, (z, out)) in starts.iter().zip(tracks) {
                let mut filter = kfilter(start, &q);
                for (z, out) in z.iter().zip(out.as_chunks_mut::<5>().0) {
                    *out = filter.step(z);
                }
            }
        }),
        Contender::new("adskalman 0.18, short form", |out| {
            let tracks = z.chunks(STEPS).zip(out.chunks_mut(STEPS * 5));
            for (start, (z, out)) in starts.iter().zip(tracks) {
                let state = StateAndCovariance::new(start.mean, start.cov);
                let mut filter =
                    Adskalman { state, method: CovarianceUpdateMethod::OptimalKalmanForcedSymmetric, q, k: 0 };
                for (z, out) in z.iter().zip(out.as_chunks_mut::<5>().0) {
                    *out = filter.step(z);
                }
            }
        }),
    ];
    let title = format!("ekf, {tracks} tracks x {STEPS}, coordinated turn and range");
    race(&title, 5, &Settings { steps: tracks * STEPS, ..*settings }, &contenders)
}
