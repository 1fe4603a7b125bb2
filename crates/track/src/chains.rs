//! Positions of a target whose axes move apart from each other, by the kernels of the core: the same equations as the general filter, with
//! the known zeros left out.
//!
//! `Chains` is what trackers step by; [`Series`] takes all positions of some targets at once, and gives the same bits.

use crate::error::StepError;
use crate::model::Model;
use crate::packet::{Content, Kind};
use crate::recursion::{Interval, Recursion};
use crate::spec::{Duplicates, EstimatorSpec, KinematicSpec, ModelSpec, Prior, Receiver, Robust, Spec};
use crate::tracker::Step;
use crate::trail::Trail;
use fixtrail_core::estimators::kalman::{Evidence, MISFIT};
use fixtrail_core::kernels::{Chain, Leap};
use fixtrail_core::{Belief, Row};
use fixtrail_lanes::{Integrators, integrators};

pub use fixtrail_lanes::side_by_side;

/// The model of a spec whose axes are chains of integrators, each measured by its position alone.
pub(crate) fn kinematic(spec: &Spec) -> Option<(&KinematicSpec, f64)> {
    let ModelSpec::Kinematic(model) = &spec.model else { return None };
    let [sensor] = spec.sensors.as_slice() else { return None };
    let is_plain = sensor.kind == Kind::Position
        && sensor.drift.is_none()
        && sensor.robust == Robust::None
        && sensor.bias.is_empty();
    let is_kalman = matches!(spec.estimator, EstimatorSpec::Kalman | EstimatorSpec::Ekf);
    let apart = model.prior.as_ref().is_none_or(|prior| are_apart(prior, model.axes));
    (is_plain && is_kalman && apart).then_some((model, sensor.sd))
}

/// Whether no two axes are correlated. Component `d·axes + a` is derivative `d` of axis `a`.
fn are_apart(prior: &Prior, axes: usize) -> bool {
    let n = prior.mean.len();
    (0..n).all(|i| (0..n).all(|j| i % axes == j % axes || prior.cov.at(i, j) == 0.0))
}

/// A Kalman filter for each of `A` axes of `O` derivatives.
#[derive(Clone, Copy)]
pub(crate) struct Chains<const A: usize, const O: usize> {
    /// Density of the driving noise per axis.
    psd: [f64; A],
    /// Of a position that comes without one of its own.
    sd: f64,
}

impl<const A: usize, const O: usize> Chains<A, O> {
    /// The filters of a model with that many axes and derivatives.
    pub fn new(model: &KinematicSpec, sd: f64) -> Self {
        Self { psd: core::array::from_fn(|axis| model.noise[axis]), sd }
    }
}

impl<const N: usize, const A: usize, const O: usize> Recursion<N> for Chains<A, O> {
    type Known = [Chain<f64, O>; A];

    fn begin(&self, belief: &Belief<N>) -> Self::Known {
        const { assert!(A * O == N, "as many components as axes have derivatives") };
        core::array::from_fn(|axis| {
            let mut chain = Chain { mean: [0.0; O], cov: [[0.0; O]; O] };
            for i in 0..O {
                chain.mean[i] = belief.mean[i * A + axis];
                for j in i..O {
                    chain.cov[i][j] = belief.cov[(i * A + axis, j * A + axis)];
                }
            }
            chain
        })
    }

    fn belief(known: &Self::Known) -> Belief<N> {
        let mut belief: Belief<N> = Belief { mean: nalgebra::zero(), cov: nalgebra::zero() };
        for (axis, chain) in known.iter().enumerate() {
            for i in 0..O {
                belief.mean[i * A + axis] = chain.mean[i];
                for j in i..O {
                    belief.cov[(i * A + axis, j * A + axis)] = chain.cov[i][j];
                    belief.cov[(j * A + axis, i * A + axis)] = chain.cov[i][j];
                }
            }
        }
        belief
    }

    fn predict(&self, _model: &Model<N>, known: &Self::Known, over: &Interval<N>) -> Self::Known {
        core::array::from_fn(|axis| known[axis].predict(&Leap::new(self.psd[axis], over.dt_s)))
    }

    fn update(
        &self,
        model: &Model<N>,
        step: &Step<'_>,
        prior: &Self::Known,
        rows: &mut Vec<Row<N>>,
        used: Option<&mut Vec<Row<N>>>,
    ) -> Result<(Self::Known, Evidence), StepError> {
        let (mut known, mut evidence) = (*prior, Evidence::default());
        for packet in step.packets {
            let Content::Position(position) = &packet.content else { continue };
            let sd = packet.sd.unwrap_or(self.sd);
            for (chain, z) in known.iter_mut().zip(position) {
                if let Some(z) = z {
                    *chain = measure(chain, *z, sd * sd, &mut evidence).map_err(StepError::Core)?;
                }
            }
        }
        if let Some(used) = used {
            rows.clear();
            model.sensing.rows(step, &<Self as Recursion<N>>::belief(prior).mean, rows);
            used.extend_from_slice(rows);
        }
        Ok((known, evidence))
    }
}

/// One position of one axis.
#[inline(always)]
fn measure<const O: usize>(
    chain: &Chain<f64, O>,
    z: f64,
    var: f64,
    evidence: &mut Evidence,
) -> Result<Chain<f64, O>, fixtrail_core::StepError> {
    let e = z - chain.mean[0];
    // To the kernel a NaN is a measurement that was lost; here it is a broken one.
    if !e.is_finite() {
        return Err(fixtrail_core::StepError::NotFinite { component: 0 });
    }
    let (next, s) = chain.checked_update(z, var)?;
    let fit = e * e / s;
    evidence.nis += fit;
    evidence.dof += 1;
    evidence.misfits += u32::from(fit > MISFIT);
    Ok(next)
}

/// All positions of some targets at once, side by side, for a spec whose trackers have one fix per instant and nothing else to say.
#[derive(Clone, Debug)]
pub struct Series {
    axes: usize,
    order: usize,
    psd: [f64; 3],
    sd: f64,
    mean: Vec<f64>,
    /// Row by row.
    cov: Vec<f64>,
}

/// The positions of a target.
#[derive(Clone, Copy, Debug)]
pub struct Positions<'a> {
    /// Instants, growing.
    pub t_s: &'a [f64],
    /// Their coordinates, instant by instant.
    pub positions: &'a [f64],
}

/// Room that calls of [`Series::track`] need, for the next one.
#[derive(Debug, Default)]
pub struct Room {
    input: Vec<f64>,
    out: Vec<f64>,
}

impl Series {
    /// The series of a spec; `None` where targets have to be tracked step by step.
    pub fn of(spec: &Spec) -> Option<Series> {
        let (model, sd) = kinematic(spec)?;
        let prior = model.prior.as_ref()?;
        let is_in_order = spec.link.receiver == Receiver::Stamped { late_s: None };
        if !is_in_order || spec.link.arrival.is_some() || spec.link.duplicates == Duplicates::Detect {
            return None;
        }
        let n = prior.mean.len();
        let mut psd = [0.0; 3];
        psd[..model.axes].copy_from_slice(&model.noise[..model.axes]);
        Some(Series {
            axes: model.axes,
            order: model.order,
            psd,
            sd,
            mean: prior.mean.clone(),
            cov: (0..n * n).map(|i| prior.cov.at(i / n, i % n)).collect(),
        })
    }

    /// Number of coordinates of a position.
    pub fn axes(&self) -> usize {
        self.axes
    }

    /// Hands the trail of each target to `take`, in their order, with the number of its first instant that cannot be taken, if there is one, and
    /// why: the trail holds those before.
    ///
    /// # Panics
    /// When there are not as many coordinates as instants ask for.
    pub fn track(
        &self,
        targets: &[Positions<'_>],
        room: &mut Room,
        take: impl FnMut(Trail, Result<(), (usize, StepError)>),
    ) {
        for target in targets {
            assert_eq!(target.positions.len(), self.axes * target.t_s.len(), "coordinates of positions");
        }
        match (self.axes, self.order) {
            (1, 1) => self.run::<1, 1, 1, 4>(targets, room, take),
            (2, 1) => self.run::<2, 1, 2, 4>(targets, room, take),
            (3, 1) => self.run::<3, 1, 3, 4>(targets, room, take),
            (1, 2) => self.run::<1, 2, 2, 7>(targets, room, take),
            (2, 2) => self.run::<2, 2, 4, 7>(targets, room, take),
            (3, 2) => self.run::<3, 2, 6, 7>(targets, room, take),
            (1, _) => self.run::<1, 3, 3, 11>(targets, room, take),
            (2, _) => self.run::<2, 3, 6, 11>(targets, room, take),
            _ => self.run::<3, 3, 9, 11>(targets, room, take),
        }
    }

    /// `A` axes of `O` derivatives, `N` states, `M` numbers of an instant of one axis.
    fn run<const A: usize, const O: usize, const N: usize, const M: usize>(
        &self,
        targets: &[Positions<'_>],
        room: &mut Room,
        mut take: impl FnMut(Trail, Result<(), (usize, StepError)>),
    ) {
        let longest = targets.iter().map(|target| target.t_s.len()).max().unwrap_or(0);
        let trail = |target: &Positions<'_>| {
            let mut trail = Trail::new(N, false);
            trail.reserve(target.t_s.len());
            (trail, Ok(()))
        };
        let mut trails: Vec<_> = targets.iter().map(trail).collect();
        let mut axes: [Vec<Chain<f64, O>>; A] =
            core::array::from_fn(|axis| vec![self.start::<A, O, N>(axis); targets.len()]);
        for from in (0..longest).step_by(STRETCH) {
            let steps = STRETCH.min(longest - from);
            let instants = targets.len() * steps;
            let Room { input, out } = room;
            input.resize(2 * instants, 0.0);
            out.resize(A * M * instants, 0.0);
            for (axis, (tracks, out)) in axes.iter_mut().zip(out.chunks_exact_mut(M * instants)).enumerate() {
                for (target, input) in targets.iter().zip(input.chunks_exact_mut(2 * steps)) {
                    target.stretch::<A>(from, axis, input.as_chunks_mut::<2>().0);
                }
                let problem = Integrators { psd: self.psd[axis], var: self.sd * self.sd, goes_on: from > 0 };
                integrators::<O, M>(&problem, tracks, input, steps, out);
            }
            for (i, (target, (trail, end))) in targets.iter().zip(&mut trails).enumerate() {
                let Some(t_s) = target.t_s.get(from..).filter(|_| end.is_ok()) else { continue };
                let of_axis = |axis: usize| &out[M * (axis * instants + i * steps)..][..M * steps];
                *end = append::<A, O, N, M>(trail, &t_s[..steps.min(t_s.len())], core::array::from_fn(of_axis));
            }
        }
        trails.into_iter().for_each(|(trail, end)| take(trail, end));
    }

    /// What is known of an axis at the first instant.
    fn start<const A: usize, const O: usize, const N: usize>(&self, axis: usize) -> Chain<f64, O> {
        let mut chain = Chain { mean: [0.0; O], cov: [[0.0; O]; O] };
        for i in 0..O {
            chain.mean[i] = self.mean[i * A + axis];
            for j in i..O {
                chain.cov[i][j] = self.cov[(i * A + axis) * N + j * A + axis];
            }
        }
        chain
    }
}

/// Instants of a call: what they bring stays in the innermost cache.
const STRETCH: usize = 64;

impl Positions<'_> {
    /// The seconds since the instant before and the position on an axis, of the instants from one on, as far as there are any.
    fn stretch<const A: usize>(&self, from: usize, axis: usize, out: &mut [[f64; 2]]) {
        let there = out.len().min(self.t_s.len().saturating_sub(from));
        let mut before = if from > 0 && there > 0 { self.t_s[from - 1] } else { 0.0 };
        for (k, out) in out[..there].iter_mut().enumerate() {
            let now = self.t_s[from + k];
            *out = [now - before, self.positions[(from + k) * A + axis]];
            before = now;
        }
    }
}

/// Appends the fixes of some instants from what [`integrators`] says of each axis, as far as that can be taken.
fn append<const A: usize, const O: usize, const N: usize, const M: usize>(
    trail: &mut Trail,
    t_s: &[f64],
    axes: [&[f64]; A],
) -> Result<(), (usize, StepError)> {
    let axes = axes.map(|axis| axis.as_chunks::<M>().0);
    let refused = |k: usize| axes.iter().find_map(|instants| check::<O, M>(&instants[k]).err());
    let odd = (0..t_s.len()).find_map(|k| refused(k).map(|error| (k, error)));
    let rows = odd.map_or(t_s.len(), |(k, _)| k);
    let mean = |k: usize| {
        let mut mean = [0.0; N];
        for (axis, instants) in axes.iter().enumerate() {
            (0..O).for_each(|i| mean[i * A + axis] = instants[k][i]);
        }
        mean
    };
    let cov = |k: usize| {
        let mut packed = [0.0; 45];
        for (axis, instants) in axes.iter().enumerate() {
            let mut at = O;
            for i in 0..O {
                for j in i..O {
                    packed[Trail::packed_index(N, i * A + axis, j * A + axis)] = instants[k][at];
                    at += 1;
                }
            }
        }
        packed
    };
    let nis = |k: usize| axes.iter().fold(0.0, |nis, of| nis + of[k][M - 2] * of[k][M - 2] / of[k][M - 1]);
    let start = trail.len();
    trail.append_updated(&t_s[..rows], (mean, cov), (nis, A as u32));
    match odd {
        None => Ok(()),
        Some((k, error)) => Err((start + k, StepError::Core(error))),
    }
}

/// Whether an update can be taken, as [`measure`] has it.
#[inline(always)]
fn check<const O: usize, const M: usize>(instant: &[f64; M]) -> Result<(), fixtrail_core::StepError> {
    let (e, s) = (instant[M - 2], instant[M - 1]);
    if !e.is_finite() {
        return Err(fixtrail_core::StepError::NotFinite { component: 0 });
    }
    if !(s > 0.0 && s.is_finite()) {
        return Err(fixtrail_core::StepError::InnovationVariance { var: s });
    }
    // Diagonal elements stand `O`, `O − 1`, … apart.
    let mut at = O;
    for component in 0..O {
        if !(instant[component].is_finite() && instant[at].is_finite()) {
            return Err(fixtrail_core::StepError::NotFinite { component });
        }
        at += O - component;
    }
    Ok(())
}
