//! One file per family of estimators: what each emits, and when.

pub mod alpha_beta;
pub mod axes;
pub mod fixed_lag;
pub mod fms;
pub mod fms_newton;
pub mod fosb;
pub mod held;
pub mod kalman;
pub mod marginal;
pub mod rts;
pub mod ufir;

use crate::error::StepError;
use crate::filter::Outcome;
use crate::fix::{Estimate, Fix, Lagged, Sink, Status};
use crate::spec::Span;
use crate::tracker::Step;
use fixtrail_core::{Belief, Row, Transition};

/// Which of filter and smoother a tracker emits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum LaggedMode {
    /// The estimator's own: a smoother's rows stand at the time they describe; `fms` emits its filter.
    #[default]
    Own,
    /// Filter and smoother side by side, on the row of the newest data.
    Both,
}

/// What is known of an instant besides its estimate.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Meta {
    pub(crate) k: u64,
    pub(crate) t_s: Option<f64>,
    pub(crate) status: Status,
    pub(crate) nis: Option<f64>,
    pub(crate) nis_dof: u32,
    /// Whether anything arrived.
    pub(crate) arrived: bool,
}

impl Meta {
    fn of<const N: usize>(step: &Step<'_>, outcome: &Outcome<N>) -> Self {
        Self {
            k: step.k,
            t_s: step.t_s,
            status: outcome.status,
            nis: outcome.nis,
            nis_dof: outcome.nis_dof,
            arrived: !step.lost(),
        }
    }

    /// The status of an estimate that uses later data too.
    fn smoothed_status(&self) -> Status {
        match self.status {
            Status::Unobservable if self.arrived => Status::Updated,
            Status::Unobservable => Status::Predicted,
            status => status,
        }
    }
}

fn estimate<const N: usize>(belief: &Belief<N>) -> Estimate<'_> {
    Estimate { mean: belief.mean.as_slice(), cov: belief.cov.as_slice() }
}

/// Emits the row of an instant; without a belief the row is unobservable.
fn emit<const N: usize>(
    sink: &mut dyn Sink,
    meta: &Meta,
    belief: Option<&Belief<N>>,
    lagged: Option<(&Meta, Option<&Belief<N>>)>,
) {
    let status = if belief.is_some() { meta.status } else { Status::Unobservable };
    let lagged = lagged.map(|(at, belief)| Lagged {
        k: at.k,
        t_s: at.t_s,
        estimate: belief.map(estimate),
        status: if belief.is_some() { at.smoothed_status() } else { Status::Unobservable },
    });
    sink.fix(&Fix {
        k: meta.k,
        t_s: meta.t_s,
        estimate: belief.map(estimate),
        status,
        nis: meta.nis.filter(|_| belief.is_some()),
        nis_dof: meta.nis_dof,
        lagged,
    });
}

/// Emits a smoothed row at the instant it describes.
fn emit_smoothed<const N: usize>(sink: &mut dyn Sink, meta: &Meta, belief: Option<&Belief<N>>) {
    emit(sink, &Meta { status: meta.smoothed_status(), ..*meta }, belief, None);
}

/// How many of the oldest instants have left a span that ends at the newest; `times` oldest first.
pub(crate) fn outside(span: Span, times: impl ExactSizeIterator<Item = Option<f64>>, newest_s: Option<f64>) -> usize {
    match span {
        Span::Instants(count) => times.len().saturating_sub(count),
        // A nanosecond of slack: times are differences of decimal numbers.
        Span::Seconds(s) => {
            times.take_while(|t| matches!((t, newest_s), (Some(t), Some(newest)) if newest - t > s + 1e-9)).count()
        }
    }
}

/// How many instants a window is first given room for.
pub(crate) fn room(span: Span) -> usize {
    match span {
        Span::Instants(count) => count + 1,
        Span::Seconds(_) => 64,
    }
}

/// Checks that a step's numbers are numbers, before a window takes them in.
pub(crate) fn sound<const N: usize>(arrive: &Transition<N>, rows: &[Row<N>]) -> Result<(), StepError> {
    let finite = arrive.f.iter().chain(&arrive.q).chain(&arrive.next).all(|v| v.is_finite());
    let component =
        rows.iter().position(|r| !(r.residual.is_finite() && r.var > 0.0 && r.h.iter().all(|v| v.is_finite())));
    match (finite, component) {
        (true, None) => Ok(()),
        (_, component) => {
            Err(StepError::Core(fixtrail_core::StepError::NotFinite { component: component.unwrap_or(0) }))
        }
    }
}

/// The transition that leads to a first instant.
pub(crate) fn still<const N: usize>() -> Transition<N> {
    Transition { next: nalgebra::zero(), f: nalgebra::one(), q: nalgebra::zero() }
}
