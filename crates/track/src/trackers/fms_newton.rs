//! `fms` with nonlinear motion or sensors: Gauss–Newton over the window.

use crate::error::StepError;
use crate::filter::interval;
use crate::fix::{Sink, Status};
use crate::heap::Heap;
use crate::layout::Layout;
use crate::model::Model;
use crate::packet::Packet;
use crate::search::{Enough, Kept, KeptWindow, cold_start, enough, image, is_right, mirror};
use crate::spec::{Align, Span};
use crate::tracker::{Step, Tracker};
use crate::trackers::fms::FmsSpec;
use crate::trackers::ufir::no_room;
use crate::trackers::{LaggedMode, Meta, emit, outside, room};
use fixtrail_core::estimators::diffuse::Joint;
use fixtrail_core::estimators::fms::newton::Newton;
use fixtrail_core::estimators::fms::posterior_nis;
use fixtrail_core::{Belief, Row, Vector, estimators::kalman};
use std::collections::VecDeque;

/// Finite-memory filter and smoother of a nonlinear model.
#[derive(Clone)]
pub struct FmsNewton<const N: usize> {
    model: Model<N>,
    spec: FmsSpec,
    mode: LaggedMode,
    newton: Newton<N, Heap>,
    kept: VecDeque<Kept>,
    metas: VecDeque<Meta>,
    rows: Vec<Row<N>>,
    /// Room of instants that have left the window.
    spare: Vec<Vec<Packet>>,
}

impl<const N: usize> FmsNewton<N> {
    /// A tracker before its first instant.
    ///
    /// # Errors
    /// [`StepError`] when there is no room for the window.
    pub fn new(model: Model<N>, spec: FmsSpec, mode: LaggedMode) -> Result<Self, StepError> {
        let capacity = room(spec.window);
        Ok(Self {
            model,
            spec,
            mode,
            newton: Newton::new(capacity).ok_or_else(|| no_room(capacity))?,
            kept: VecDeque::new(),
            metas: VecDeque::new(),
            rows: Vec::new(),
            spare: Vec::new(),
        })
    }

    /// Index of the smoothed instant among the metas that lie in the window.
    fn lagged(&self, newest_s: Option<f64>) -> Option<usize> {
        match self.spec.lag {
            // The newest meta of a predicting window is not among the kept ones.
            Span::Instants(lag) => (self.metas.len()).checked_sub(lag + 1),
            Span::Seconds(s) => {
                self.metas.iter().rposition(|m| matches!((m.t_s, newest_s), (Some(t), Some(n)) if n - t >= s - 1e-9))
            }
        }
    }

    fn slide(&mut self, newest_s: Option<f64>) {
        let gone = outside(self.spec.window, self.kept.iter().map(|k| k.t_s), newest_s);
        self.spare.extend(self.kept.drain(..gone).map(|k| k.packets));
        self.newton.drop_front(gone);
    }

    fn solve(&mut self, lagged: Option<usize>) -> Result<Joint<N>, StepError> {
        if enough(self.model.layout.axes, self.kept.iter()) != Enough::Yes {
            self.newton.clear();
            return Ok(Joint::none());
        }
        if self.kept.len() > self.newton.capacity() {
            let larger = 2 * self.kept.len();
            self.newton = Newton::new(larger).ok_or_else(|| no_room(larger))?;
        }
        let cold = cold_start(&self.model, self.kept.iter());
        let is_first = self.newton.nominal().is_empty();
        let mut view = KeptWindow { model: &self.model, kept: &self.kept, rows: &mut self.rows };
        let len = self.kept.len();
        let lagged = lagged.filter(|i| *i < len);
        let joint = self.newton.solve(&mut view, len, lagged, &cold).map_err(StepError::Core)?;
        // A window that goes on from the one before stays on its side.
        let (Some(best), true) = (&joint.filter, is_first) else { return Ok(joint) };
        let Some(mirror) = mirror(&self.model, self.kept.iter()) else { return Ok(joint) };
        let other = image(&self.model, &self.kept, &self.newton, &cold, &mirror, best, &mut self.rows)?;
        let Some(image) = other else { return Ok(joint) };
        match is_right(&self.model, &mirror, best, &image) {
            Some(false) => Ok(joint),
            Some(true) => {
                self.newton = image.newton;
                let mut view = KeptWindow { model: &self.model, kept: &self.kept, rows: &mut self.rows };
                self.newton.solve(&mut view, len, lagged, &cold).map_err(StepError::Core)
            }
            None => {
                self.newton.clear();
                Ok(Joint::none())
            }
        }
    }

    fn emit(&self, sink: &mut dyn Sink, joint: &Joint<N>, lagged: Option<usize>) {
        let Some(newest) = self.metas.back() else { return };
        let meta = lagged.and_then(|i| self.metas.get(i));
        match self.mode {
            LaggedMode::Own => emit(sink, newest, joint.filter.as_ref(), None),
            LaggedMode::Both => {
                emit(sink, newest, joint.filter.as_ref(), meta.map(|m| (m, joint.lagged.as_ref())));
            }
        }
    }
}

impl<const N: usize> Tracker for FmsNewton<N> {
    fn layout(&self) -> &Layout {
        &self.model.layout
    }

    fn boxed_clone(&self) -> Box<dyn Tracker> {
        Box::new(self.clone())
    }

    fn step(&mut self, step: &Step<'_>, sink: &mut dyn Sink) -> Result<(), StepError> {
        let dt_s = self.kept.back().map_or(0.0, |k| interval(k.t_s, step.t_s));
        let arrived = !step.lost();
        let mut meta = Meta { k: step.k, t_s: step.t_s, status: Status::Predicted, nis: None, nis_dof: 0, arrived };
        match self.spec.align {
            Align::Filtered => {
                let room = self.spare.pop().unwrap_or_default();
                self.kept.push_back(Kept::new(step, dt_s, room));
                self.slide(step.t_s);
                meta.status = if arrived { Status::Updated } else { Status::Predicted };
                self.metas.push_back(meta);
                self.metas.drain(..self.metas.len().saturating_sub(self.kept.len()));
                let lagged = self.lagged(step.t_s);
                let joint = self.solve(lagged)?;
                if let (Some(belief), Some(meta)) = (&joint.filter, self.metas.back_mut()) {
                    self.rows.clear();
                    self.model.sensing.rows(step, &belief.mean, &mut self.rows);
                    meta.nis_dof = self.rows.len() as u32;
                    let at = Belief { mean: Vector::zeros(), cov: belief.cov };
                    meta.nis = posterior_nis(&at, &mut self.rows);
                }
                self.emit(sink, &joint, lagged);
            }
            Align::Predicted => {
                self.slide(self.kept.back().and_then(|k| k.t_s));
                meta.status = match self.metas.back() {
                    Some(m) if m.arrived => Status::Updated,
                    _ => Status::Predicted,
                };
                self.metas.push_back(meta);
                self.metas.drain(..self.metas.len().saturating_sub(self.kept.len() + 1));
                let lagged = self.lagged(step.t_s);
                let mut joint = self.solve(lagged)?;
                if let (Some(last), Some(from)) = (joint.filter, self.kept.back()) {
                    let drive = self.model.drive(&from.step());
                    let leap = self.model.motion.leap(from.k, dt_s, &drive, &last.mean);
                    let prior = kalman::predict(&last, &leap);
                    self.rows.clear();
                    self.model.sensing.rows(step, &prior.mean, &mut self.rows);
                    let evidence = kalman::update(&prior, &self.rows, kalman::Robust::None).map(|(_, e)| e);
                    if let (Ok(evidence), Some(meta)) = (evidence, self.metas.back_mut()) {
                        meta.nis = (evidence.dof > 0).then_some(evidence.nis);
                        meta.nis_dof = evidence.dof;
                    }
                    // An interval may be so long that nothing is known after it.
                    let finite = prior.mean.iter().chain(&prior.cov).all(|v| v.is_finite());
                    joint.filter = finite.then_some(prior);
                    if lagged == Some(self.kept.len()) {
                        joint.lagged = joint.filter;
                    }
                }
                self.emit(sink, &joint, lagged);
                let room = self.spare.pop().unwrap_or_default();
                self.kept.push_back(Kept::new(step, dt_s, room));
            }
        }
        Ok(())
    }

    fn finish(&mut self, _sink: &mut dyn Sink) -> Result<(), StepError> {
        Ok(())
    }
}
