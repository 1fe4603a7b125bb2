//! `rts`: every instant given all data of the run.

use crate::error::StepError;
use crate::filter::{Filter, Outcome};
use crate::fix::Sink;
use crate::layout::Layout;
use crate::linearised::Linearised;
use crate::model::Model;
use crate::recursion::Single;
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
        Self { filter: Filter::new(model, Single), mode, metas: Vec::new(), run: Vec::new() }
    }

    /// Smoothed beliefs of the run; `None` where the data do not determine them. Each start is smoothed by itself.
    fn smoothed(&self) -> Vec<Option<Belief<N>>> {
        let mut out = vec![None; self.run.len()];
        let mut first = 0;
        while first < self.run.len() {
            if self.run[first].forgotten {
                first += 1;
                continue;
            }
            let rest = &self.run[first + 1..];
            let len = 1 + rest.iter().take_while(|l| !l.forgotten && !l.begins()).count();
            // The prior is that of the run's first instant.
            let prior = self.filter.model.prior.filter(|_| first == 0);
            segment(&self.run[first..first + len], prior, &mut out[first..first + len]);
            first += len;
        }
        out
    }
}

/// Smooths the instants of one start into `out`.
fn segment<const N: usize>(run: &[Linearised<N>], prior: Option<Belief<N>>, out: &mut [Option<Belief<N>>]) {
    let Some(oldest) = run.first() else { return };
    let prior = prior.map(|p| Belief { mean: p.mean - oldest.nominal, cov: p.cov });
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
        out[i] = belief.map(|b| Belief { mean: b.mean + run[i].nominal, cov: b.cov });
    });
}

impl<const N: usize> Tracker for Rts<N> {
    fn layout(&self) -> &Layout {
        &self.filter.model.layout
    }

    fn restarts(&self) -> u64 {
        self.filter.restarts()
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
