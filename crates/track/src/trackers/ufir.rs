//! `ufir`: least squares over the window, the process noise ignored.

use crate::error::StepError;
use crate::filter::interval;
use crate::fix::{Sink, Status};
use crate::heap::Heap;
use crate::layout::Layout;
use crate::model::Model;
use crate::spec::Span;
use crate::tracker::{Step, Tracker};
use crate::trackers::{Meta, emit, outside, room, sound, still};
use fixtrail_core::estimators::fms::posterior_nis;
use fixtrail_core::estimators::ufir;
use fixtrail_core::{Belief, Row, Vector};
use std::collections::VecDeque;

/// Unbiased FIR filter over a linear model.
#[derive(Clone)]
pub struct Ufir<const N: usize> {
    model: Model<N>,
    span: Span,
    window: ufir::Ufir<N, Heap>,
    times: VecDeque<Option<f64>>,
    past: Option<(u64, Option<f64>, Vector<N>)>,
    rows: Vec<Row<N>>,
}

impl<const N: usize> Ufir<N> {
    /// A tracker before its first instant.
    ///
    /// # Errors
    /// [`StepError`] when there is no room for the window.
    pub fn new(model: Model<N>, span: Span) -> Result<Self, StepError> {
        let capacity = room(span);
        let window = ufir::Ufir::new(capacity).ok_or_else(|| no_room(capacity))?;
        Ok(Self { model, span, window, times: VecDeque::new(), past: None, rows: Vec::new() })
    }
}

pub(crate) fn no_room(needed: usize) -> StepError {
    StepError::Core(fixtrail_core::StepError::WindowFull { capacity: 0, needed })
}

impl<const N: usize> Tracker for Ufir<N> {
    fn layout(&self) -> &Layout {
        &self.model.layout
    }

    fn boxed_clone(&self) -> Box<dyn Tracker> {
        Box::new(self.clone())
    }

    fn step(&mut self, step: &Step<'_>, sink: &mut dyn Sink) -> Result<(), StepError> {
        let zero = Vector::zeros();
        let arrive = match self.past {
            Some((k, t_s, drive)) => self.model.motion.leap(k, interval(t_s, step.t_s), &drive, &zero),
            None => still(),
        };
        self.rows.clear();
        self.model.sensing.rows(step, &zero, &mut self.rows);
        sound(&arrive, &self.rows)?;
        let dof = self.rows.len() as u32;
        self.window.push(&arrive, &mut self.rows).map_err(StepError::Core)?;
        self.times.push_back(step.t_s);
        let gone = outside(self.span, self.times.iter().copied(), step.t_s);
        self.times.drain(..gone);
        self.window.drop_front(gone);
        let belief: Option<Belief<N>> = self.window.estimate();
        let nis = belief.and_then(|b| posterior_nis(&b, &mut self.rows).filter(|_| dof > 0));
        let status = if step.lost() { Status::Predicted } else { Status::Updated };
        let meta = Meta { k: step.k, t_s: step.t_s, status, nis, nis_dof: dof, arrived: !step.lost() };
        emit(sink, &meta, belief.as_ref(), None);
        self.past = Some((step.k, step.t_s, self.model.drive(step)));
        Ok(())
    }

    fn finish(&mut self, _sink: &mut dyn Sink) -> Result<(), StepError> {
        Ok(())
    }
}
