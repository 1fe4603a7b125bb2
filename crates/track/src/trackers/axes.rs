//! Filters of location and speed that take one axis at a time: what `fosb` and `alpha-beta` share.
//!
//! Rows of one instant on one axis are first made one, weighed by their variances. A lost instant, or a lost coordinate, is a prediction.

use crate::error::StepError;
use crate::filter::interval;
use crate::fix::{Sink, Status};
use crate::layout::Layout;
use crate::model::Model;
use crate::tracker::{Step, Tracker};
use crate::trackers::{LaggedMode, Meta, emit};
use fixtrail_core::estimators::fosb::Gauss;
use fixtrail_core::{Belief, Matrix, Row, Vector};

/// Covariance of the noise that an interval adds to location and speed of one axis: Q11, Q13 and Q33.
pub type AxisNoise = Matrix<2, 2>;

/// What the measurement of one axis said of its prediction.
#[derive(Clone, Copy, Debug)]
pub struct Judged {
    /// Innovation.
    pub e: f64,
    /// Its variance.
    pub s: f64,
}

/// A filter of one axis.
pub trait AxisFilter: Copy + Send {
    /// What the spec says of it.
    type Rules: Clone + Send;

    /// After a first measurement, with nothing known before.
    fn begin(rules: &Self::Rules, z: Gauss<f64>) -> Self;

    /// Before a first measurement, with location and speed known.
    fn with_prior(belief: &Belief<2>) -> Self;

    /// Goes on by an interval; `noise` is the model's of that interval.
    ///
    /// # Errors
    /// [`fixtrail_core::StepError`].
    fn predict(&mut self, rules: &Self::Rules, dt_s: f64, noise: &AxisNoise) -> Result<(), fixtrail_core::StepError>;

    /// Takes a measurement; `noise` gives the model's noise of any interval. `None` where there was no prediction to judge.
    ///
    /// # Errors
    /// [`fixtrail_core::StepError`].
    fn update(
        &mut self,
        rules: &Self::Rules,
        z: Gauss<f64>,
        noise: &dyn Fn(f64) -> AxisNoise,
    ) -> Result<Option<Judged>, fixtrail_core::StepError>;

    /// Location and speed; `None` while the speed is unknown.
    fn belief(&self) -> Option<Belief<2>>;

    /// The speed at the instant before, given all so far, when the last step was an update that tells of it.
    fn refined(&self) -> Option<Gauss<f64>> {
        None
    }
}

/// Tracker of up to three axes: positions, then velocities.
#[derive(Clone)]
pub struct Axes<const N: usize, F: AxisFilter> {
    model: Model<N>,
    rules: F::Rules,
    mode: LaggedMode,
    /// By axis; `None` before its first measurement.
    filters: [Option<F>; 3],
    past: Option<(Meta, Option<Belief<N>>)>,
    rows: Vec<Row<N>>,
}

impl<const N: usize, F: AxisFilter> Axes<N, F> {
    /// A tracker before its first instant, of a model of N/2 axes.
    pub fn new(model: Model<N>, rules: F::Rules, mode: LaggedMode) -> Self {
        let mut filters = [None; 3];
        if let Some(prior) = &model.prior {
            for (axis, filter) in filters.iter_mut().enumerate().take(N / 2) {
                *filter = Some(F::with_prior(&part(prior, axis)));
            }
        }
        Self { model, rules, mode, filters, past: None, rows: Vec::new() }
    }

    /// The model's noise on one axis over an interval.
    fn noise(model: &Model<N>, axis: usize, dt_s: f64) -> AxisNoise {
        let q = model.motion.leap(0, dt_s, &Vector::zeros(), &Vector::zeros()).q;
        let at = [axis, axis + N / 2];
        Matrix::from_fn(|i, j| q[(at[i], at[j])])
    }

    fn belief(filters: &[Option<F>; 3]) -> Option<Belief<N>> {
        let mut out = Belief { mean: Vector::zeros(), cov: Matrix::zeros() };
        for (axis, filter) in filters.iter().enumerate().take(N / 2) {
            let known = filter.as_ref()?.belief()?;
            let at = [axis, axis + N / 2];
            for i in 0..2 {
                out.mean[at[i]] = known.mean[i];
                for j in 0..2 {
                    out.cov[(at[i], at[j])] = known.cov[(i, j)];
                }
            }
        }
        Some(out)
    }

    /// The instant before: its locations as they were, its speeds as they are known now.
    fn refined(filters: &[Option<F>; 3], before: &Belief<N>) -> Belief<N> {
        let mut out = *before;
        for (axis, filter) in filters.iter().enumerate().take(N / 2) {
            if let Some(speed) = filter.as_ref().and_then(F::refined) {
                let (x, s) = (axis, axis + N / 2);
                out.mean[s] = speed.mean;
                out.cov[(s, s)] = speed.var;
                // The filter keeps none.
                out.cov[(x, s)] = 0.0;
                out.cov[(s, x)] = 0.0;
            }
        }
        out
    }
}

/// Location and speed of one axis.
fn part<const N: usize>(belief: &Belief<N>, axis: usize) -> Belief<2> {
    let at = [axis, axis + N / 2];
    Belief { mean: Vector::from_fn(|i, _| belief.mean[at[i]]), cov: Matrix::from_fn(|i, j| belief.cov[(at[i], at[j])]) }
}

/// The rows of one axis as one measurement.
fn fused<const N: usize>(rows: &[Row<N>], axis: usize) -> Option<Gauss<f64>> {
    let mut out: Option<Gauss<f64>> = None;
    for row in rows.iter().filter(|row| row.h[axis] != 0.0) {
        out = Some(match out {
            None => Gauss { mean: row.residual, var: row.var },
            Some(z) => {
                let weight = z.var / (z.var + row.var);
                Gauss { mean: z.mean + weight * (row.residual - z.mean), var: row.var * weight }
            }
        });
    }
    out
}

impl<const N: usize, F: AxisFilter + 'static> Tracker for Axes<N, F> {
    fn layout(&self) -> &Layout {
        &self.model.layout
    }

    fn boxed_clone(&self) -> Box<dyn Tracker> {
        Box::new(self.clone())
    }

    fn step(&mut self, step: &Step<'_>, sink: &mut dyn Sink) -> Result<(), StepError> {
        self.rows.clear();
        self.model.sensing.rows(step, &Vector::zeros(), &mut self.rows);
        let dt_s = self.past.map_or(0.0, |(meta, _)| interval(meta.t_s, step.t_s));
        let mut filters = self.filters;
        let (mut nis, mut dof) = (0.0, 0);
        for (axis, place) in filters.iter_mut().enumerate().take(N / 2) {
            let noise = |dt_s: f64| Self::noise(&self.model, axis, dt_s);
            if let (Some(filter), true) = (place.as_mut(), dt_s > 0.0) {
                filter.predict(&self.rules, dt_s, &noise(dt_s)).map_err(StepError::Core)?;
            }
            let Some(z) = fused(&self.rows, axis) else { continue };
            match place {
                None => *place = Some(F::begin(&self.rules, z)),
                Some(filter) => {
                    if let Some(Judged { e, s }) = filter.update(&self.rules, z, &noise).map_err(StepError::Core)? {
                        nis += e * e / s;
                        dof += 1;
                    }
                }
            }
        }
        self.filters = filters;
        let belief = Self::belief(&filters);
        let arrived = !self.rows.is_empty();
        let meta = Meta {
            k: step.k,
            t_s: step.t_s,
            status: if arrived { Status::Updated } else { Status::Predicted },
            nis: (dof > 0).then_some(nis),
            nis_dof: dof,
            arrived,
        };
        let before = self.past.map(|(meta, before)| (meta, before.map(|b| Self::refined(&filters, &b))));
        let lagged = before.as_ref().filter(|_| self.mode == LaggedMode::Both);
        emit(sink, &meta, belief.as_ref(), lagged.map(|(meta, before)| (meta, before.as_ref())));
        self.past = Some((meta, belief));
        Ok(())
    }

    fn finish(&mut self, _sink: &mut dyn Sink) -> Result<(), StepError> {
        Ok(())
    }
}
