//! `fms` over linear models and sensors: filter and lagged smoother from a sliding window.

use crate::error::StepError;
use crate::filter::interval;
use crate::fix::{Sink, Status};
use crate::heap::Heap;
use crate::layout::Layout;
use crate::model::Model;
use crate::packet::Content;
use crate::spec::{Align, Span};
use crate::tracker::{Step, Tracker};
use crate::trackers::ufir::no_room;
use crate::trackers::{LaggedMode, Meta, emit, outside, room, sound, still};
use fixtrail_core::estimators::diffuse::Joint;
use fixtrail_core::estimators::fms::invariant::InvariantWindow;
use fixtrail_core::estimators::fms::posterior_nis;
use fixtrail_core::estimators::fms::varying::Varying;
use fixtrail_core::estimators::kalman::{self, Robust};
use fixtrail_core::{Row, Transition, Vector};
use std::collections::VecDeque;

/// The window's shape as the spec gives it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FmsSpec {
    /// Length of the window.
    pub window: Span,
    /// Lag of the smoother.
    pub lag: Span,
    /// Where the window ends.
    pub align: Align,
}

/// The window: one gain for all steps, or one linearisation per step.
#[derive(Clone)]
pub enum Window<const N: usize> {
    /// Time-invariant linear model.
    Invariant(Box<InvariantWindow<N, Heap>>),
    /// Anything else that is linear.
    Varying(Box<Varying<N, Heap>>),
}

/// Finite-memory filter and smoother.
#[derive(Clone)]
pub struct Fms<const N: usize> {
    model: Model<N>,
    spec: FmsSpec,
    mode: LaggedMode,
    window: Window<N>,
    /// Instants that may still be described: those of the window, and the newest.
    metas: VecDeque<Meta>,
    /// How many of the newest metas are in the window.
    inside: usize,
    past: Option<(u64, Option<f64>, Vector<N>)>,
    rows: Vec<Row<N>>,
    scratch: Vec<Row<N>>,
    /// Whether a row after the last measurement is due: a linear run with a predicting window.
    ends_beyond: bool,
}

impl<const N: usize> Fms<N> {
    /// A tracker before its first instant.
    pub fn new(model: Model<N>, spec: FmsSpec, mode: LaggedMode, window: Window<N>) -> Self {
        let ends_beyond = spec.align == Align::Predicted && model.layout.is_linear();
        Self {
            model,
            spec,
            mode,
            window,
            metas: VecDeque::new(),
            inside: 0,
            past: None,
            rows: Vec::new(),
            scratch: Vec::new(),
            ends_beyond,
        }
    }

    /// A window for a model that varies.
    ///
    /// # Errors
    /// [`StepError`] when there is no room for it.
    pub fn varying(window: Span) -> Result<Window<N>, StepError> {
        let capacity = room(window);
        Ok(Window::Varying(Box::new(Varying::new(capacity).ok_or_else(|| no_room(capacity))?)))
    }

    fn leap_to(&self, t_s: Option<f64>) -> Option<Transition<N>> {
        let (k, from_s, drive) = self.past?;
        Some(self.model.motion.leap(k, interval(from_s, t_s), &drive, &Vector::zeros()))
    }

    /// How many instants before the newest meta the smoother stands; `None` before there is one that far back.
    fn lag(&self) -> Option<usize> {
        let newest = self.metas.back()?;
        match self.spec.lag {
            Span::Instants(lag) => (lag < self.metas.len()).then_some(lag),
            Span::Seconds(s) => self
                .metas
                .iter()
                .rev()
                .position(|m| matches!((m.t_s, newest.t_s), (Some(t), Some(n)) if n - t >= s - 1e-9)),
        }
    }

    fn emit(&self, sink: &mut dyn Sink, joint: &Joint<N>, lag: Option<usize>) {
        let Some(newest) = self.metas.back() else { return };
        let lagged = lag.map(|lag| &self.metas[self.metas.len() - 1 - lag]);
        match self.mode {
            LaggedMode::Own => emit(sink, newest, joint.filter.as_ref(), None),
            LaggedMode::Both => {
                let lagged = lagged.map(|meta| (meta, joint.lagged.as_ref()));
                emit(sink, newest, joint.filter.as_ref(), lagged);
            }
        }
    }

    /// Forgets what has left the window.
    fn slide(&mut self, newest_s: Option<f64>) {
        let times = self.metas.iter().skip(self.metas.len() - self.inside).map(|m| m.t_s);
        let gone = outside(self.spec.window, times, newest_s);
        if let Window::Varying(varying) = &mut self.window {
            varying.drop_front(gone);
        }
        self.inside -= gone;
        // The smoother of a predicting window reaches at most its oldest instant, and the newest meta stands outside it.
        let keep = self.inside.max(1) + usize::from(self.spec.align == Align::Predicted);
        self.metas.drain(..self.metas.len().saturating_sub(keep));
    }

    fn push(&mut self, step: &Step<'_>, arrive: Option<Transition<N>>) -> Result<(), StepError> {
        match &mut self.window {
            Window::Invariant(window) => {
                let empty: (&[Option<f64>], &[f64]) = (&[], &[]);
                let (z, u) = step
                    .packets
                    .iter()
                    .find_map(|p| match &p.content {
                        Content::Linear { z, u } => Some((z.as_slice(), u.as_slice())),
                        _ => None,
                    })
                    .unwrap_or(empty);
                window.push(z, u).map_err(StepError::Core)
            }
            Window::Varying(window) => {
                self.scratch.clone_from(&self.rows);
                window.push(&arrive.unwrap_or(still()), &mut self.scratch).map_err(StepError::Core)
            }
        }
    }

    fn estimate(&mut self, lag: Option<usize>, leap: Option<&Transition<N>>) -> Joint<N> {
        match &mut self.window {
            Window::Invariant(window) if window.is_empty() => Joint::none(),
            Window::Invariant(window) => window.estimate(),
            Window::Varying(window) => {
                let lag = lag.unwrap_or(usize::MAX - 1);
                match (self.spec.align, leap) {
                    (Align::Predicted, Some(leap)) if !window.is_empty() => window.predicted(lag, leap),
                    (Align::Filtered, _) => window.filtered(lag),
                    (Align::Predicted, _) => Joint::none(),
                }
            }
        }
    }

    /// Row k from the measurements up to k − 1.
    fn predict(&mut self, step: &Step<'_>, leap: Option<&Transition<N>>, sink: &mut dyn Sink) {
        let arrived = !step.lost();
        let fed = self.metas.back().is_some_and(|m| m.arrived);
        let status = if fed { Status::Updated } else { Status::Predicted };
        self.metas.push_back(Meta { k: step.k, t_s: step.t_s, status, nis: None, nis_dof: 0, arrived });
        let lag = self.lag();
        let joint = self.estimate(lag, leap);
        if let (Some(belief), false, Some(meta)) = (&joint.filter, self.rows.is_empty(), self.metas.back_mut()) {
            // The window has not seen these rows: their residuals are innovations of its prediction.
            self.scratch.clone_from(&self.rows);
            for row in &mut self.scratch {
                row.residual -= row.h.dot(&belief.mean);
            }
            if let Ok((_, evidence)) = kalman::update(belief, &self.scratch, Robust::None) {
                meta.nis = Some(evidence.nis);
                meta.nis_dof = evidence.dof;
            }
        }
        self.emit(sink, &joint, lag);
    }
}

impl<const N: usize> Tracker for Fms<N> {
    fn layout(&self) -> &Layout {
        &self.model.layout
    }

    fn boxed_clone(&self) -> Box<dyn Tracker> {
        Box::new(self.clone())
    }

    fn step(&mut self, step: &Step<'_>, sink: &mut dyn Sink) -> Result<(), StepError> {
        let arrive = self.leap_to(step.t_s);
        self.rows.clear();
        self.model.sensing.rows(step, &Vector::zeros(), &mut self.rows);
        sound(arrive.as_ref().unwrap_or(&still()), &self.rows)?;
        match self.spec.align {
            Align::Predicted => {
                self.slide(self.past.and_then(|p| p.1));
                self.predict(step, arrive.as_ref(), sink);
                self.push(step, arrive)?;
                self.inside += 1;
            }
            Align::Filtered => {
                self.push(step, arrive)?;
                self.inside += 1;
                let arrived = !step.lost();
                let status = if arrived { Status::Updated } else { Status::Predicted };
                self.metas.push_back(Meta { k: step.k, t_s: step.t_s, status, nis: None, nis_dof: 0, arrived });
                self.slide(step.t_s);
                let lag = self.lag();
                let joint = self.estimate(lag, None);
                let dof = self.rows.len() as u32;
                if let (Some(belief), Some(meta)) = (&joint.filter, self.metas.back_mut()) {
                    meta.nis = posterior_nis(belief, &mut self.rows);
                    meta.nis_dof = dof;
                }
                self.emit(sink, &joint, lag);
            }
        }
        self.past = Some((step.k, step.t_s, self.model.drive(step)));
        Ok(())
    }

    fn finish(&mut self, sink: &mut dyn Sink) -> Result<(), StepError> {
        if self.ends_beyond
            && let Some((k, _, _)) = self.past
        {
            let beyond = Step::new(k + 1, None, &[]);
            let leap = self.leap_to(None);
            self.rows.clear();
            self.slide(self.past.and_then(|p| p.1));
            self.predict(&beyond, leap.as_ref(), sink);
        }
        Ok(())
    }
}
