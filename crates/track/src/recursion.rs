//! What a filter does once it knows the state: one Kalman filter, or one for each mode of motion.

use crate::error::StepError;
use crate::model::{Model, Motion};
use crate::tracker::Step;
use fixtrail_core::estimators::imm::Imm;
use fixtrail_core::estimators::kalman::{self, Evidence, Innovation};
use fixtrail_core::models::Switching;
use fixtrail_core::{Belief, Row, Vector};
use std::sync::Arc;

/// The interval from one instant to the next.
#[derive(Clone, Copy, Debug)]
pub struct Interval<const N: usize> {
    /// Index of the instant that it begins at.
    pub k: u64,
    /// Its length, seconds; 0 where a linear run has no times.
    pub dt_s: f64,
    /// The known input's push at its beginning.
    pub drive: Vector<N>,
}

/// Prediction and update of a filter that knows the state. Nothing is changed in place: what is known is a value.
pub trait Recursion<const N: usize>: Clone + Send {
    /// What is known of the state.
    type Known: Clone + Send;

    /// What is known where all that is known is `belief`.
    fn begin(&self, belief: &Belief<N>) -> Self::Known;

    /// Mean and covariance of the state.
    fn belief(known: &Self::Known) -> Belief<N>;

    /// What is known after an interval of motion.
    fn predict(&self, model: &Model<N>, known: &Self::Known, over: &Interval<N>) -> Self::Known;

    /// What is known after the measurements of one instant, and what those said of the prediction. `rows` is room to work in; `used` takes
    /// the rows, linearised at the mean of the prediction, with the variance that they were used with.
    ///
    /// # Errors
    /// [`StepError`].
    fn update(
        &self,
        model: &Model<N>,
        step: &Step<'_>,
        prior: &Self::Known,
        rows: &mut Vec<Row<N>>,
        used: Option<&mut Vec<Row<N>>>,
    ) -> Result<(Self::Known, Evidence), StepError>;
}

/// One Kalman filter: `kalman`, `ekf` and what smoothers go back over.
#[derive(Clone, Copy, Debug, Default)]
pub struct Single;

impl<const N: usize> Recursion<N> for Single {
    type Known = Belief<N>;

    fn begin(&self, belief: &Belief<N>) -> Belief<N> {
        *belief
    }

    fn belief(known: &Belief<N>) -> Belief<N> {
        *known
    }

    fn predict(&self, model: &Model<N>, known: &Belief<N>, over: &Interval<N>) -> Belief<N> {
        kalman::predict(known, &model.motion.leap(over.k, over.dt_s, &over.drive, &known.mean))
    }

    fn update(
        &self,
        model: &Model<N>,
        step: &Step<'_>,
        prior: &Belief<N>,
        rows: &mut Vec<Row<N>>,
        mut used: Option<&mut Vec<Row<N>>>,
    ) -> Result<(Belief<N>, Evidence), StepError> {
        rows.clear();
        model.sensing.rows(step, &prior.mean, rows);
        kalman::update_noting(prior, rows, model.robust, |i| note(&mut used, rows, i)).map_err(StepError::Core)
    }
}

/// A Kalman filter for each mode of motion: `imm`.
#[derive(Clone)]
pub struct Modes<const N: usize> {
    motions: Vec<Arc<dyn Motion<N>>>,
    switching: Switching,
}

impl<const N: usize> Modes<N> {
    /// Modes that move by `motions` and take turns by `switching`; `None` when those are not as many.
    pub fn new(motions: Vec<Arc<dyn Motion<N>>>, switching: Switching) -> Option<Self> {
        (motions.len() == switching.count()).then_some(Self { motions, switching })
    }
}

impl<const N: usize> Recursion<N> for Modes<N> {
    type Known = Imm<N>;

    fn begin(&self, belief: &Belief<N>) -> Imm<N> {
        Imm::start(belief, &self.switching)
    }

    fn belief(known: &Imm<N>) -> Belief<N> {
        known.belief()
    }

    fn predict(&self, _model: &Model<N>, known: &Imm<N>, over: &Interval<N>) -> Imm<N> {
        let mixed = known.mix(&self.switching.over(over.dt_s));
        mixed.predict(|mode, x| self.motions[mode].leap(over.k, over.dt_s, &over.drive, x))
    }

    fn update(
        &self,
        model: &Model<N>,
        step: &Step<'_>,
        prior: &Imm<N>,
        rows: &mut Vec<Row<N>>,
        mut used: Option<&mut Vec<Row<N>>>,
    ) -> Result<(Imm<N>, Evidence), StepError> {
        rows.clear();
        model.sensing.rows(step, &prior.belief().mean, rows);
        let count = rows.len();
        for mode in prior.modes() {
            model.sensing.rows(step, &mode.mean, rows);
        }
        let (combined, each) = rows.split_at(count);
        prior.update(combined, each, model.robust, |i| note(&mut used, combined, i)).map_err(StepError::Core)
    }
}

/// Keeps a row as it was used.
fn note<const N: usize>(used: &mut Option<&mut Vec<Row<N>>>, rows: &[Row<N>], innovation: Innovation) {
    if let Some(used) = used {
        used.push(Row { var: innovation.var, ..rows[innovation.row] });
    }
}
