//! `fixed-lag-kalman`: x̂_{k−d} given z_0 … z_k, with its covariance; at the end the last d instants with what there is.

use crate::error::StepError;
use crate::filter::Filter;
use crate::fix::Sink;
use crate::layout::Layout;
use crate::linearised::Linearised;
use crate::model::Model;
use crate::recursion::Single;
use crate::spec::Span;
use crate::tracker::{Step, Tracker};
use crate::trackers::{LaggedMode, Meta, emit, emit_smoothed};
use fixtrail_core::estimators::smoother::{Backward, Forward, Instant, StartState};
use fixtrail_core::{Belief, Row, Vector};
use std::collections::VecDeque;

/// One instant inside the lag.
#[derive(Clone)]
struct Held<const N: usize> {
    meta: Meta,
    nominal: Vector<N>,
    instant: Instant<N>,
    rows: Vec<Row<N>>,
    forgotten: bool,
    /// Which start it belongs to, from 1.
    start: u64,
}

/// Fixed-lag smoother. The forward pass keeps an unknown start exact for ever, so instants before the filter knew the state are
/// smoothed too.
#[derive(Clone)]
pub struct FixedLag<const N: usize> {
    filter: Filter<N>,
    lag: Span,
    mode: LaggedMode,
    forward: Option<Forward<N>>,
    /// Number of the forward pass's start, from 1.
    start: u64,
    /// Earlier starts of which instants are still held, at their end.
    ended: VecDeque<(u64, StartState<N>)>,
    /// Instants whose linearisation is not settled.
    open: VecDeque<Meta>,
    held: VecDeque<Held<N>>,
    record: Vec<Linearised<N>>,
}

impl<const N: usize> FixedLag<N> {
    /// A tracker before its first instant.
    pub fn new(model: Model<N>, lag: Span, mode: LaggedMode) -> Self {
        Self {
            filter: Filter::new(model, Single),
            lag,
            mode,
            forward: None,
            start: 0,
            ended: VecDeque::new(),
            open: VecDeque::new(),
            held: VecDeque::new(),
            record: Vec::new(),
        }
    }

    /// Runs the forward pass over the settled instants.
    fn advance(&mut self) {
        for at in self.record.drain(..) {
            let Some(meta) = self.open.pop_front() else { break };
            let mut instant = Instant::zero();
            if !at.forgotten {
                if at.begins() {
                    if let Some(forward) = self.forward.take() {
                        self.ended.push_back((self.start, forward.start_state()));
                    }
                    self.start += 1;
                }
                // The prior is that of the run's first instant.
                let prior = self.filter.model.prior.filter(|_| self.start == 1);
                let prior = prior.map(|p| Belief { mean: p.mean - at.nominal, cov: p.cov });
                let fresh = self.forward.is_none();
                let forward = self.forward.get_or_insert_with(|| Forward::start(prior.as_ref()));
                instant = forward.leap(at.arrive.as_ref().filter(|_| !fresh));
                for row in &at.rows {
                    forward.update(row);
                }
            }
            let Linearised { nominal, rows, forgotten, .. } = at;
            let held = Held { meta, nominal, instant, rows, forgotten, start: self.start };
            self.held.push_back(held);
        }
    }

    /// Smoothed beliefs of the `count` oldest instants held, given everything so far.
    fn smoothed(&self, count: usize) -> Vec<Option<Belief<N>>> {
        let mut out = vec![None; count];
        if count == 0 {
            return out;
        }
        let Some(newest) = self.forward.as_ref().map(Forward::start_state) else { return out };
        // Newest first; at the beginning of a start nothing goes on to the instants before it.
        let starts = core::iter::once((self.start, newest)).chain(self.ended.iter().rev().copied());
        for (number, start) in starts {
            let mut backward = Backward::new(&start);
            let of_it = self.held.iter().enumerate().rev().filter(|(_, h)| h.start == number && !h.forgotten);
            for (i, held) in of_it {
                for row in &held.rows {
                    backward.row(row);
                }
                if i < count {
                    let belief = backward.smoothed(&held.instant);
                    out[i] = belief.map(|b| Belief { mean: b.mean + held.nominal, cov: b.cov });
                }
                backward.leap(&held.instant.arrive);
            }
        }
        out
    }

    /// How many of the instants held have the lag behind them.
    fn due(&self, newest_s: Option<f64>) -> usize {
        match self.lag {
            Span::Instants(lag) => (self.held.len() + self.open.len()).saturating_sub(lag).min(self.held.len()),
            // Due at exactly the lag: a nanosecond of slack for times that are differences of decimal numbers.
            Span::Seconds(lag_s) => self
                .held
                .iter()
                .take_while(|h| matches!((h.meta.t_s, newest_s), (Some(t), Some(n)) if n - t >= lag_s - 1e-9))
                .count(),
        }
    }
}

impl<const N: usize> Tracker for FixedLag<N> {
    fn layout(&self) -> &Layout {
        &self.filter.model.layout
    }

    fn restarts(&self) -> u64 {
        self.filter.restarts()
    }

    fn boxed_clone(&self) -> Box<dyn Tracker> {
        Box::new(self.clone())
    }

    fn step(&mut self, step: &Step<'_>, sink: &mut dyn Sink) -> Result<(), StepError> {
        let outcome = self.filter.step(step, Some(&mut self.record))?;
        let meta = Meta::of(step, &outcome);
        self.open.push_back(meta);
        self.advance();
        let due = self.due(step.t_s);
        let smoothed = self.smoothed(due);
        if self.mode == LaggedMode::Both {
            let newest = smoothed.last().map(|belief| (&self.held[due - 1].meta, belief.as_ref()));
            emit(sink, &meta, outcome.belief.as_ref(), newest);
        } else {
            for (held, belief) in self.held.iter().zip(&smoothed) {
                emit_smoothed(sink, &held.meta, belief.as_ref());
            }
        }
        self.held.drain(..due);
        let oldest = self.held.front().map_or(self.start, |h| h.start);
        self.ended.retain(|(number, _)| *number >= oldest);
        Ok(())
    }

    fn finish(&mut self, sink: &mut dyn Sink) -> Result<(), StepError> {
        self.filter.finish(&mut self.record);
        self.advance();
        if self.mode != LaggedMode::Both {
            for (held, belief) in self.held.iter().zip(self.smoothed(self.held.len())) {
                emit_smoothed(sink, &held.meta, belief.as_ref());
            }
        }
        self.held.clear();
        Ok(())
    }
}
