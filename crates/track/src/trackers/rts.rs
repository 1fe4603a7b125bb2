//! `rts`: every instant given all data of the run.

use crate::error::StepError;
use crate::filter::{Filter, Outcome};
use crate::fix::Sink;
use crate::layout::Layout;
use crate::linearised::Linearised;
use crate::model::Model;
use crate::tracker::{Step, Tracker};
use crate::trackers::{LaggedMode, Meta, emit, emit_smoothed};
use fixtrail_core::Belief;
use fixtrail_core::estimators::smoother::{Forward, Instant, smooth};

/// Fixed-interval smoother. It holds the run's linearisation until the end.
#[derive(Clone)]
pub struct Rts<const N: usize> {
    filter: Filter<N>,
    mode: LaggedMode,
    metas: Vec<(Meta, Option<Belief<N>>)>,
    run: Vec<Linearised<N>>,
}

impl<const N: usize> Rts<N> {
    /// A tracker before its first instant.
    pub fn new(model: Model<N>, mode: LaggedMode) -> Self {
        Self { filter: Filter::new(model), mode, metas: Vec::new(), run: Vec::new() }
    }

    /// Smoothed beliefs of the run; `None` where the data do not determine them.
    fn smoothed(&self) -> Vec<Option<Belief<N>>> {
        let mut out = vec![None; self.run.len()];
        let first = self.run.iter().take_while(|l| l.forgotten).count();
        let run = &self.run[first..];
        let Some(oldest) = run.first() else { return out };
        let prior = self.filter.model.prior.map(|p| Belief { mean: p.mean - oldest.nominal, cov: p.cov });
        let mut forward = Forward::start(prior.as_ref());
        let mut instants: Vec<Instant<N>> = Vec::with_capacity(run.len());
        let mut rows = Vec::new();
        for at in run {
            let mut instant = forward.leap(at.arrive.as_ref().filter(|_| !instants.is_empty()));
            for row in &at.rows {
                forward.update(row);
            }
            rows.extend_from_slice(&at.rows);
            instant.rows = at.rows.len();
            instants.push(instant);
        }
        smooth(&forward.start_state(), &instants, &rows, |i, belief| {
            out[first + i] = belief.map(|b| Belief { mean: b.mean + run[i].nominal, cov: b.cov });
        });
        out
    }
}

impl<const N: usize> Tracker for Rts<N> {
    fn layout(&self) -> &Layout {
        &self.filter.model.layout
    }

    fn boxed_clone(&self) -> Box<dyn Tracker> {
        Box::new(self.clone())
    }

    fn step(&mut self, step: &Step<'_>, _sink: &mut dyn Sink) -> Result<(), StepError> {
        let outcome: Outcome<N> = self.filter.step(step, Some(&mut self.run))?;
        self.metas.push((Meta::of(step, &outcome), outcome.belief));
        Ok(())
    }

    fn finish(&mut self, sink: &mut dyn Sink) -> Result<(), StepError> {
        self.filter.finish(&mut self.run);
        for ((meta, filtered), smoothed) in self.metas.iter().zip(self.smoothed()) {
            match self.mode {
                LaggedMode::Both => emit(sink, meta, filtered.as_ref(), Some((meta, smoothed.as_ref()))),
                LaggedMode::Own => emit_smoothed(sink, meta, smoothed.as_ref()),
            }
        }
        Ok(())
    }
}
