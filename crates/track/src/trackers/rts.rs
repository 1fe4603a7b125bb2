//! `rts`: every instant given all data of the run.
//!
//! The filter linearised motion and sensors at its predictions, and weighted rows by how they missed those; at a start, after a gap and in
//! a turn it did not foresee these are poor. So the run is smoothed twice: as the filter left it, and then linearised and weighted along
//! the smoothed trail, a step of Gauss–Newton and of iteratively reweighted least squares \[BEL94\]. One step and no more: steps until
//! nothing changes lead to the mode of a posterior that weak sensors make skewed, away from its mean.

use crate::error::StepError;
use crate::filter::{Filter, Outcome, interval};
use crate::fix::Sink;
use crate::layout::Layout;
use crate::linearised::Linearised;
use crate::model::Model;
use crate::recursion::Single;
use crate::search::Kept;
use crate::tracker::{Step, Tracker};
use crate::trackers::{LaggedMode, Meta, emit, emit_smoothed};
use fixtrail_core::estimators::kalman::Robust;
use fixtrail_core::estimators::smoother::{Arrive, Forward, Instant, smooth};
use fixtrail_core::{Belief, Row, Vector};

/// Fixed-interval smoother. It holds the run's linearisation until the end, and its packets where it linearises anew.
#[derive(Clone)]
pub struct Rts<const N: usize> {
    filter: Filter<N>,
    mode: LaggedMode,
    metas: Vec<(Meta, Option<Belief<N>>)>,
    run: Vec<Linearised<N>>,
    /// The instants of the run, where they are gone over twice.
    kept: Vec<Kept>,
}

impl<const N: usize> Rts<N> {
    /// A tracker before its first instant.
    pub fn new(model: Model<N>, mode: LaggedMode) -> Self {
        Self { filter: Filter::new(model, Single), mode, metas: Vec::new(), run: Vec::new(), kept: Vec::new() }
    }

    /// Whether the filter's linearisation or weights depend on where it was made.
    fn is_smoothed_twice(&self) -> bool {
        self.filter.model.nonlinear || self.filter.model.robust != Robust::None
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
            let smoothed = &mut out[first..first + len];
            segment(&self.run[first..first + len], prior, smoothed);
            if self.is_smoothed_twice()
                && let Some(trail) = smoothed.iter().map(|b| b.map(|b| b.mean)).collect::<Option<Vec<_>>>()
            {
                let run = along(&self.filter.model, &self.kept[first..first + len], &trail, prior.is_some());
                let mut again = vec![None; len];
                segment(&run, prior, &mut again);
                if again.iter().all(Option::is_some) {
                    smoothed.copy_from_slice(&again);
                }
            }
            first += len;
        }
        out
    }
}

/// The instants of one start, linearised along `trail` and weighted by how their rows miss it.
fn along<const N: usize>(model: &Model<N>, kept: &[Kept], trail: &[Vector<N>], has_prior: bool) -> Vec<Linearised<N>> {
    let mut scratch = Vec::new();
    let one = |(i, (kept_i, at)): (usize, (&Kept, &Vector<N>))| {
        let arrive = i.checked_sub(1).map(|before| {
            let from = &kept[before];
            let leap = model.motion.leap(from.k, kept_i.dt_s, &model.drive(&from.step()), &trail[before]);
            Arrive { f: leap.f, offset: leap.next - at, q: leap.q }
        });
        let mut rows = Vec::new();
        // As the search for a start has it; a linear start without a prior knows nothing.
        if i == 0 && !has_prior && model.nonlinear {
            rows.extend(model.known_rows(at));
        }
        scratch.clear();
        model.sensing.rows(&kept_i.step(), at, &mut scratch);
        for row in &scratch {
            let weight = model.robust.weight(row.residual * row.residual / row.var);
            if weight > 0.0 {
                rows.push(Row { var: row.var / weight, ..*row });
            }
        }
        Linearised { nominal: *at, arrive, rows, forgotten: false }
    };
    kept.iter().zip(trail).enumerate().map(one).collect()
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
        if self.is_smoothed_twice() {
            let before = self.metas.last().and_then(|(meta, _)| meta.t_s);
            self.kept.push(Kept::new(step, interval(before, step.t_s), Vec::new()));
        }
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
