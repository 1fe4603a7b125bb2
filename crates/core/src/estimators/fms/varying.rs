//! Finite-memory estimates when anything varies from step to step: irregular time, lost rows, time-varying matrices.
//!
//! The newest state comes from two filters that meet inside the window. With a lag, or where they cannot decide, short windows are passed
//! over at each step by the exact-diffuse filter, and windows of [`STACKS_FROM`] instants and more are aggregated in two queues, split at
//! the lagged instant. Where the stacks cannot decide either (ill-conditioned or unobservable), the pass does: all give the same answer.

use crate::estimators::diffuse::{Diffuse, Joint};
use crate::estimators::fms::element::{Information, LEAST_PIVOT};
use crate::estimators::fms::stacks::Stacks;
use crate::estimators::fms::two_filter::{TwoFilter, inverse_of, take_row};
use crate::estimators::fms::window::{Node, Window};
use crate::estimators::fms::{STACKS_FROM, TWO_FILTER_FROM};
use crate::estimators::kalman::{finite, propagate};
use crate::estimators::smoother::{Arrive, Backward, Instant, StartState};
use crate::storage::Store;
use crate::types::{Belief, Matrix, Row, StepError, Transition};

/// A window over a time-varying linear model.
#[derive(Clone)]
pub struct Varying<const N: usize, S: Store> {
    window: Window<N, S>,
    /// Estimates without a lag; empty while not in use.
    two: Option<TwoFilter<N, S>>,
    queues: Option<Queues<N, S>>,
}

/// Elements of the nodes before the lagged instant, and from it on. The newest node is in neither: its leap is not known yet.
#[derive(Clone)]
struct Queues<const N: usize, S: Store> {
    early: Stacks<N, S>,
    late: Stacks<N, S>,
    valid: bool,
}

impl<const N: usize, S: Store> Varying<N, S> {
    /// An empty window that expects about `capacity` instants, or `None` when the store has no room for them.
    pub fn new(capacity: usize) -> Option<Self> {
        let queues = if capacity >= STACKS_FROM {
            match (Stacks::new(capacity), Stacks::new(capacity)) {
                (Some(early), Some(late)) => Some(Queues { early, late, valid: false }),
                _ => None,
            }
        } else {
            None
        };
        let two = if capacity >= TWO_FILTER_FROM { TwoFilter::new(capacity) } else { None };
        Some(Self { window: Window::new(capacity)?, two, queues })
    }

    /// Number of instants in the window.
    pub fn len(&self) -> usize {
        self.window.len()
    }

    /// Whether the window is empty.
    pub fn is_empty(&self) -> bool {
        self.window.is_empty()
    }

    /// Adds an instant: the transition that led to it and its rows, linearised at 0. `rows` is overwritten when there are more than N.
    ///
    /// # Errors
    /// [`StepError::WindowFull`] when the store has no more room; nothing has changed then.
    pub fn push(&mut self, arrive: &Transition<N>, rows: &mut [Row<N>]) -> Result<(), StepError> {
        let len = self.window.len();
        self.window.push(Node::new(arrive, rows))?;
        if let Some(two) = &mut self.two {
            two.push(|future| {
                future.leap(&arrive.f, &arrive.next, &arrive.q);
                self.window.get(len).rows().iter().try_for_each(|row| take_row(future, row))
            });
        }
        if let (Some(queues), true) = (&mut self.queues, len > 0)
            && queues.valid
        {
            queues.valid = queues.late.push(self.window.get(len - 1).rows(), arrive).is_ok();
        }
        Ok(())
    }

    /// Forgets the `count` oldest instants.
    pub fn drop_front(&mut self, count: usize) {
        self.window.drop_front(count);
        if let Some(two) = &mut self.two {
            two.drop_front(count);
        }
        if let Some(queues) = &mut self.queues
            && queues.valid
        {
            for _ in 0..count {
                let popped = if queues.early.is_empty() { queues.late.pop() } else { queues.early.pop() };
                queues.valid &= popped.is_some();
            }
        }
    }

    /// Forgets everything.
    pub fn clear(&mut self) {
        self.window.drop_front(self.window.len());
        if let Some(two) = &mut self.two {
            two.clear();
        }
        if let Some(queues) = &mut self.queues {
            queues.valid = false;
        }
    }

    /// Estimates of the newest instant and of the one `lag` instants before it, from the window. A lag beyond the window has no
    /// estimate, and neither has a window whose covariances leave the range of numbers.
    pub fn filtered(&mut self, lag: usize) -> Joint<N> {
        match lag {
            0 => self.latest(None),
            _ => self.estimate(self.window.len().checked_sub(lag + 1), None),
        }
    }

    /// Estimates of the instant that `leap` leads to and of the one `lag` instants before it, from the window; see
    /// [`Varying::filtered`].
    pub fn predicted(&mut self, lag: usize, leap: &Transition<N>) -> Joint<N> {
        match lag {
            0 => self.latest(Some(leap)),
            _ => self.estimate(self.window.len().checked_sub(lag), Some(leap)),
        }
    }

    fn latest(&mut self, leap: Option<&Transition<N>>) -> Joint<N> {
        let belief = self.met(leap).or_else(|| self.estimate(None, leap).filter);
        belief.map_or_else(Joint::none, Joint::newest)
    }

    /// The newest instant from two filters; `None` where they cannot decide.
    fn met(&mut self, leap: Option<&Transition<N>>) -> Option<Belief<N>> {
        let (window, two) = (&self.window, self.two.as_mut()?);
        let len = window.len();
        if two.len() != len {
            let mut last: Option<(&Matrix<N, N>, Matrix<N, N>)> = None;
            two.turn(len, |i, past| {
                if i + 1 < len {
                    let Transition { next, f, q } = &window.get(i + 1).arrive;
                    let inverse = match last {
                        Some((of, inverse)) if of == f => inverse,
                        _ => inverse_of(f)?,
                    };
                    past.leap_back(&inverse, next, q);
                    last = Some((f, inverse));
                }
                window.get(i).rows().iter().try_for_each(|row| take_row(past, row))
            })?;
            if let Some(queues) = &mut self.queues {
                queues.valid = false;
            }
        }
        let mut belief = two.filtered()?;
        if let Some(Transition { next, f, q }) = leap {
            belief = Belief { mean: f * belief.mean + next, cov: propagate(&belief.cov, f, q) };
        }
        finite(&belief.mean, &belief.cov).ok().map(|()| belief)
    }

    fn estimate(&mut self, split: Option<usize>, leap: Option<&Transition<N>>) -> Joint<N> {
        if self.window.len() >= STACKS_FROM
            && let Some(joint) = self.aggregated(split, leap).filter(Joint::is_finite)
        {
            return joint;
        }
        self.passed(split, leap).unwrap_or_else(|_| Joint::none())
    }

    /// The estimate by one exact-diffuse pass over the window, and for the lagged instant back again from the newest.
    fn passed(&self, split: Option<usize>, leap: Option<&Transition<N>>) -> Result<Joint<N>, StepError> {
        let len = self.window.len();
        let mut pass = Diffuse::start();
        let mut at = None;
        for i in 0..len {
            let node = self.window.get(i);
            if i > 0 {
                pass.leap(&node.arrive.f, &node.arrive.next, &node.arrive.q);
            }
            if split == Some(i) {
                pass.mark_lag();
                at = Some(Instant::of(&pass, None));
            }
            for row in node.rows() {
                pass.update(row)?;
            }
        }
        let start = StartState::after(&pass);
        if let Some(leap) = leap {
            pass.leap(&leap.f, &leap.next, &leap.q);
            if split == Some(len) {
                pass.mark_lag();
                at = Some(Instant::of(&pass, None));
            }
        }
        let mut joint = pass.solve();
        if let (Some(split), Some(at)) = (split, at) {
            let mut backward = Backward::new(&start);
            for i in (split..len).rev() {
                let node = self.window.get(i);
                node.rows().iter().for_each(|row| backward.row(row));
                if i > split {
                    let Transition { next, f, q } = node.arrive;
                    backward.leap(&Arrive { f, offset: next, q });
                }
            }
            joint.lagged = backward.smoothed(&at);
        }
        Ok(joint)
    }

    /// The estimate from the queues; `None` where they cannot decide.
    fn aggregated(&mut self, split: Option<usize>, leap: Option<&Transition<N>>) -> Option<Joint<N>> {
        let len = self.window.len();
        let queues = self.queues.as_mut()?;
        let complete = len - 1;
        let wanted = split.unwrap_or(0).min(complete);
        if !queues.valid || queues.early.len() > wanted || queues.early.len() + queues.late.len() != complete {
            queues.early.clear();
            queues.late.clear();
            queues.valid = false;
            for i in 0..complete {
                queues.late.push(self.window.get(i).rows(), &self.window.get(i + 1).arrive).ok()?;
            }
            queues.valid = true;
        }
        while queues.early.len() < wanted {
            let i = queues.early.len();
            queues.valid = false;
            queues.early.push(self.window.get(i).rows(), &self.window.get(i + 1).arrive).ok()?;
            queues.late.pop()?;
            queues.valid = true;
        }
        let mut late = queues.late.all()?;
        for row in self.window.get(len - 1).rows() {
            late.row(row);
        }
        if let Some(Transition { next, f, q }) = leap {
            late.leap(f, next, q);
        }
        if split.is_none() && queues.early.is_empty() {
            let filter = late.filtered(&Information::none(), LEAST_PIVOT)?;
            return Some(Joint { filter: Some(filter), lagged: None, cross: Matrix::zeros() });
        }
        queues.early.all()?.joint(&late)
    }
}
