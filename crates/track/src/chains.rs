//! Positions of a target whose axes move apart from each other, by the kernels of the core: the same equations as the general filter, with
//! the known zeros left out.
//!
//! `Chains` is what trackers step by; [`Series`] takes all positions of a target at once, and gives the same bits.

use crate::error::StepError;
use crate::fix::Status;
use crate::model::Model;
use crate::packet::{Content, Kind};
use crate::recursion::{Interval, Recursion};
use crate::spec::{Duplicates, EstimatorSpec, KinematicSpec, ModelSpec, Prior, Receiver, Robust, Spec};
use crate::tracker::Step;
use crate::trail::Trail;
use fixtrail_core::estimators::kalman::{Evidence, MISFIT};
use fixtrail_core::kernels::{Chain, Leap};
use fixtrail_core::{Belief, Row};

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

/// All positions of a target at once, for a spec whose trackers have one fix per instant and nothing else to say.
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

    /// Appends the fixes of a target to `trail`: `t_s` are the instants, growing, `positions` their coordinates, instant by instant.
    ///
    /// # Errors
    /// The number of the instant that cannot be taken, and why; `trail` holds those before.
    ///
    /// # Panics
    /// When there are not as many coordinates as instants ask for.
    pub fn track(&self, t_s: &[f64], positions: &[f64], trail: &mut Trail) -> Result<(), (usize, StepError)> {
        assert_eq!(positions.len(), self.axes * t_s.len(), "coordinates of positions");
        match (self.axes, self.order) {
            (1, 1) => self.run::<1, 1, 1>(t_s, positions, trail),
            (2, 1) => self.run::<2, 1, 2>(t_s, positions, trail),
            (3, 1) => self.run::<3, 1, 3>(t_s, positions, trail),
            (1, 2) => self.run::<1, 2, 2>(t_s, positions, trail),
            (2, 2) => self.run::<2, 2, 4>(t_s, positions, trail),
            (3, 2) => self.run::<3, 2, 6>(t_s, positions, trail),
            (1, _) => self.run::<1, 3, 3>(t_s, positions, trail),
            (2, _) => self.run::<2, 3, 6>(t_s, positions, trail),
            _ => self.run::<3, 3, 9>(t_s, positions, trail),
        }
    }

    fn run<const A: usize, const O: usize, const N: usize>(
        &self,
        t_s: &[f64],
        positions: &[f64],
        trail: &mut Trail,
    ) -> Result<(), (usize, StepError)> {
        let mut chains: [Chain<f64, O>; A] = core::array::from_fn(|axis| {
            let mut chain = Chain { mean: [0.0; O], cov: [[0.0; O]; O] };
            for i in 0..O {
                chain.mean[i] = self.mean[i * A + axis];
                for j in i..O {
                    chain.cov[i][j] = self.cov[(i * A + axis) * N + j * A + axis];
                }
            }
            chain
        });
        let var = self.sd * self.sd;
        let mut leaps: [Leap<f64, O>; A] = core::array::from_fn(|axis| Leap::new(self.psd[axis], 0.0));
        let (mut before, mut dt_s) = (None, 0.0);
        trail.reserve(t_s.len());
        for (k, (now, position)) in t_s.iter().zip(positions.chunks_exact(A)).enumerate() {
            if let Some(before) = before {
                let dt: f64 = now - before;
                if dt != dt_s {
                    dt_s = dt;
                    leaps = core::array::from_fn(|axis| Leap::new(self.psd[axis], dt_s));
                }
                for axis in 0..A {
                    chains[axis] = chains[axis].predict(&leaps[axis]);
                }
            }
            before = Some(now);
            let (mut next, mut evidence) = (chains, Evidence::default());
            for axis in 0..A {
                next[axis] =
                    measure(&chains[axis], position[axis], var, &mut evidence).map_err(|e| (k, StepError::Core(e)))?;
            }
            chains = next;
            let mut mean = [0.0; N];
            let mut packed = [0.0; 45];
            for (axis, chain) in chains.iter().enumerate() {
                for i in 0..O {
                    mean[i * A + axis] = chain.mean[i];
                    for j in i..O {
                        packed[Trail::packed_index(N, i * A + axis, j * A + axis)] = chain.cov[i][j];
                    }
                }
            }
            let packed = &packed[..Trail::packed_len(N)];
            trail.push(k as u64, *now, &mean, packed, Status::Updated, (evidence.nis, evidence.dof));
        }
        Ok(())
    }
}
