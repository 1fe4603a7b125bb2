//! `lmvf`, `lmmse`, `emvf`, `gpb1`: estimates from what a receiver without time stamps holds.

use crate::error::StepError;
use crate::filter::interval;
use crate::fix::{Sink, Status};
use crate::layout::Layout;
use crate::model::{HeldRows, Model};
use crate::tracker::{Step, Tracker};
use crate::trackers::{Meta, emit};
use fixtrail_core::estimators::augmented::{Sensed, Shown};
use fixtrail_core::estimators::emvf::Emvf;
use fixtrail_core::estimators::gpb1::Gpb1;
use fixtrail_core::estimators::kalman::Evidence;
use fixtrail_core::estimators::lmmse::Lmmse;
use fixtrail_core::estimators::lmvf::Lmvf;
use fixtrail_core::{Belief, Matrix, Transition, Vector};

/// An estimator that is told what the receiver shows, and how likely that is new.
pub trait HeldEstimator<const N: usize, const M: usize>: Clone + Send {
    /// x̂_{k|k} and its covariance.
    fn belief(&self) -> Belief<N>;

    /// Takes one step.
    ///
    /// # Errors
    /// [`fixtrail_core::StepError`]; nothing has changed then.
    fn step(
        &mut self,
        leap: &Transition<N>,
        sensed: &Sensed<N, M>,
        shown: &Shown<M>,
        arrival: f64,
    ) -> Result<Evidence, fixtrail_core::StepError>;
}

macro_rules! held_estimator {
    ($estimator:ident, $belief:ident => $from:expr) => {
        impl<const N: usize, const M: usize> HeldEstimator<N, M> for $estimator<N, M> {
            fn belief(&self) -> Belief<N> {
                let $belief = self;
                $from
            }

            fn step(
                &mut self,
                leap: &Transition<N>,
                sensed: &Sensed<N, M>,
                shown: &Shown<M>,
                arrival: f64,
            ) -> Result<Evidence, fixtrail_core::StepError> {
                $estimator::step(self, leap, sensed, shown, arrival).map(|found| found.evidence)
            }
        }
    };
}
held_estimator!(Lmvf, e => Lmvf::belief(e));
held_estimator!(Emvf, e => Emvf::belief(e));
held_estimator!(Lmmse, e => e.joint().belief());
held_estimator!(Gpb1, e => e.joint().belief());

/// Makes the estimator from x̂_{0|0} and the first measurement's linearisation.
pub type Start<const N: usize, const M: usize, E> = fn(&Begin<N>, &Sensed<N, M>) -> E;

/// What an estimator starts from.
#[derive(Clone, Copy, Debug)]
pub struct Begin<const N: usize> {
    /// x̂_{0|0} and P_{0|0}.
    pub belief: Belief<N>,
    /// S_0.
    pub second_moment: Matrix<N, N>,
    /// What else the spec says of the estimator.
    pub options: Options,
}

/// Keys of the estimators.
#[derive(Clone, Copy, Debug, Default)]
pub struct Options {
    /// `square_root` of `lmvf`.
    pub square_root: bool,
    /// `variant` and `range_mixture` of `emvf`.
    pub emvf: fixtrail_core::estimators::emvf::Options,
    /// Whether a value of exactly 0 says that two were lost, `model1-skip`.
    pub skips_zero: bool,
    /// `link.hold`.
    pub hold: fixtrail_core::estimators::augmented::Hold,
    /// Whether motion or a sensor is nonlinear.
    pub nonlinear: bool,
}

/// The tracker; M is at least the number of values at an instant. Components beyond them are never seen.
pub struct Held<const N: usize, const M: usize, E> {
    model: Model<N>,
    begin: Begin<N>,
    start: Start<N, M, E>,
    estimator: Option<E>,
    /// Number of the last instant, its time and its known input.
    past: Option<(u64, Option<f64>, Vector<N>)>,
    /// Values at an instant.
    count: usize,
    rows: HeldRows<N>,
}

impl<const N: usize, const M: usize, E: Clone> Clone for Held<N, M, E> {
    fn clone(&self) -> Self {
        Self {
            model: self.model.clone(),
            begin: self.begin,
            start: self.start,
            estimator: self.estimator.clone(),
            past: self.past,
            count: self.count,
            rows: self.rows.clone(),
        }
    }
}

impl<const N: usize, const M: usize, E: HeldEstimator<N, M>> Held<N, M, E> {
    /// A tracker before its first instant.
    pub fn new(model: Model<N>, begin: Begin<N>, start: Start<N, M, E>) -> Self {
        Self { model, begin, start, estimator: None, past: None, count: 0, rows: HeldRows::default() }
    }

    /// The measurement of an instant, linearised at `x`, and what is shown of it.
    fn sense(&mut self, step: &Step<'_>, x: &Vector<N>) -> Result<(Sensed<N, M>, Shown<M>), StepError> {
        self.rows.clear();
        self.model.sensing.held(step, x, &mut self.rows);
        let rows = &self.rows;
        let count = rows.values.len();
        if count > M {
            return Err(StepError::Misfit(format!(
                "an instant has {}, expected at most {M} on a link without time stamps",
                values(count)
            )));
        }
        if self.estimator.is_some() && count != self.count {
            return Err(StepError::Misfit(format!(
                "an instant has {}, expected {} as at the first: a link without time stamps holds as many as come",
                values(count),
                self.count
            )));
        }
        let sensed = Sensed {
            expected: Vector::from_fn(|i, _| rows.expected.get(i).copied().unwrap_or(0.0)),
            h: Matrix::from_fn(|i, j| rows.h.get(i).map_or(0.0, |h| h[j])),
            r: Matrix::from_fn(|i, j| match (i < count && j < count, i == j) {
                (true, _) => rows.r[i * count + j],
                (false, true) => 1.0,
                (false, false) => 0.0,
            }),
        };
        let mut shown = Shown::nothing();
        if !step.packets.is_empty() {
            for (i, value) in rows.values.iter().enumerate() {
                if let Some(value) = value {
                    shown.y[i] = *value;
                    shown.seen[i] = true;
                }
            }
            // What is shown, before a bias is taken from it.
            let shows_zero = || step.packets.iter().flat_map(|p| p.content.values()).flatten().all(|v| v == 0.0);
            if self.begin.options.skips_zero && shows_zero() {
                shown = Shown::nothing();
            }
        }
        Ok((sensed, shown))
    }
}

fn values(count: usize) -> String {
    if count == 1 { "1 value".to_owned() } else { format!("{count} values") }
}

impl<const N: usize, const M: usize, E: HeldEstimator<N, M> + 'static> Tracker for Held<N, M, E> {
    fn layout(&self) -> &Layout {
        &self.model.layout
    }

    fn boxed_clone(&self) -> Box<dyn Tracker> {
        Box::new(self.clone())
    }

    fn step(&mut self, step: &Step<'_>, sink: &mut dyn Sink) -> Result<(), StepError> {
        let evidence = match (&self.estimator, self.past) {
            (Some(estimator), Some((k, t_s, drive))) => {
                let mut next = estimator.clone();
                let belief = next.belief();
                let leap = self.model.motion.leap(k, interval(t_s, step.t_s), &drive, &belief.mean);
                let (sensed, shown) = self.sense(step, &leap.next)?;
                let evidence = next.step(&leap, &sensed, &shown, step.arrival).map_err(StepError::Core)?;
                self.estimator = Some(next);
                evidence
            }
            _ => {
                let mean = self.begin.belief.mean;
                let (sensed, _) = self.sense(step, &mean)?;
                self.count = self.rows.values.len();
                self.estimator = Some((self.start)(&self.begin, &sensed));
                Evidence::default()
            }
        };
        self.past = Some((step.k, step.t_s, self.model.drive(step)));
        let used = evidence.dof > 0;
        let meta = Meta {
            k: step.k,
            t_s: step.t_s,
            status: if used { Status::Updated } else { Status::Predicted },
            nis: used.then_some(evidence.nis),
            nis_dof: evidence.dof,
            arrived: used,
        };
        let belief = self.estimator.as_ref().map(HeldEstimator::belief);
        emit(sink, &meta, belief.as_ref(), None);
        Ok(())
    }

    fn finish(&mut self, _sink: &mut dyn Sink) -> Result<(), StepError> {
        Ok(())
    }
}
