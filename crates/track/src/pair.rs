//! Two filters from two starts that the data did not tell apart, until one is decisively more likely.
//!
//! Each filter is told the same. What it did not expect counts against it:
//!
//! ```text
//! surprise = Σ ρ(e²/s) + ln s          minus twice the logarithm of the density of an instant's rows, without constants
//! ```
//!
//! with the innovation `e` of each row given the rows before it, its variance `s`, and `ρ` the loss of the robust weight, so that no outlier
//! decides alone: of a gate `min(ν², g)`, of Huber `2c|ν| − c²` beyond c, of the biweight `c²/3 (1 − (1 − ν²/c²)³)`, `c²/3` beyond c.

use crate::error::StepError;
use crate::filter::{Filter, Outcome};
use crate::linearised::Linearised;
use crate::mirror::Mirror;
use crate::recursion::Recursion;
use crate::tracker::Step;
use fixtrail_core::Belief;
use fixtrail_core::estimators::kalman::Robust;

/// Two fits whose sums of squares differ by more than this are no longer a choice: noise alone puts the wrong one of two ahead by `T` with
/// a probability of at most `Φ(−√T)`, 3e-5.
pub(crate) const DECISIVE: f64 = 16.0;
/// Two estimates closer than this share of every standard deviation of the position are the same.
const SAME: f64 = 0.1;
/// Standard deviations beside the mirror from which on two filters that agree have the same side.
const BESIDE: f64 = 3.0;
/// Most instants that wait for a decision to be smoothed; older ones are forgotten.
const MOST_WAITING: usize = 10_000;

/// Which of the two filters is right.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Verdict {
    /// Nothing decides.
    Open,
    /// The one at this place.
    Right(usize),
    /// Both have lost their target; the instant is not taken.
    Neither,
}

/// The two filters.
#[derive(Clone)]
pub(crate) struct Pair<const N: usize, R: Recursion<N>> {
    filters: [Filter<N, R>; 2],
    /// By how much the second has been surprised more than the first.
    lead: f64,
    mirror: Mirror,
    /// How each linearised the instants since its start, for a smoother.
    records: [Vec<Linearised<N>>; 2],
}

impl<const N: usize, R: Recursion<N>> Pair<N, R> {
    /// Two filters of which the first fits better by `lead`, mirrored at `mirror`.
    pub(crate) fn new(filters: [Filter<N, R>; 2], lead: f64, mirror: Mirror, records: [Vec<Linearised<N>>; 2]) -> Self {
        Self { filters, lead, mirror, records }
    }

    /// Takes one instant; says which is right, and the outcome of the one that is ahead. Appends what is forgotten to `record`.
    ///
    /// # Errors
    /// [`StepError`]; nothing has changed then.
    pub(crate) fn step(
        &mut self,
        step: &Step<'_>,
        record: Option<&mut Vec<Linearised<N>>>,
    ) -> Result<(Verdict, Outcome<N>), StepError> {
        let mut filters = self.filters.clone();
        let mut new = [Vec::new(), Vec::new()];
        let [mut first, mut second] = new.each_mut().map(|r| record.is_some().then_some(r));
        let [a, b] = &mut filters;
        let lead = self.lead + b.surprise(step)? - a.surprise(step)?;
        let outcomes = [a.step(step, first.take())?, b.step(step, second.take())?];
        let lost = [0, 1].map(|i| filters[i].restarts() > self.filters[i].restarts());
        let ahead = usize::from(lead < 0.0);
        if lost == [true; 2] {
            return Ok((Verdict::Neither, outcomes[ahead]));
        }
        (self.filters, self.lead) = (filters, lead);
        for (all, new) in self.records.iter_mut().zip(new) {
            all.extend(new);
        }
        if let Some(record) = record {
            let over = self.records[0].len().saturating_sub(MOST_WAITING);
            if over > 0 {
                self.records.iter_mut().for_each(|r| forget(r, over));
                record.extend((0..over).map(|_| Linearised::forgotten()));
            }
        }
        let verdict = match lost {
            [true, _] => Verdict::Right(1),
            [_, true] => Verdict::Right(0),
            _ if lead.abs() > DECISIVE || self.agree(&outcomes) => Verdict::Right(ahead),
            _ => Verdict::Open,
        };
        Ok((verdict, outcomes[ahead]))
    }

    /// Whether both have come to the same place on the same side. On the mirror itself their places are the same too, and their sides are not.
    fn agree(&self, outcomes: &[Outcome<N>; 2]) -> bool {
        let [Some(a), Some(b)] = [&outcomes[0].belief, &outcomes[1].belief] else { return false };
        let axes = self.filters[0].model.layout.axes;
        let near = |i: usize| (a.mean[i] - b.mean[i]).abs() <= SAME * a.cov[(i, i)].min(b.cov[(i, i)]).sqrt();
        let beside = |belief: &Belief<N>| self.mirror.deviations_off(belief) > BESIDE;
        (0..axes).all(near) && beside(a) && beside(b)
    }

    /// The filter at `place`, and how it linearised the instants that wait.
    pub(crate) fn take(self, place: usize) -> (Filter<N, R>, Vec<Linearised<N>>) {
        let ([a, b], [of_a, of_b]) = (self.filters, self.records);
        if place == 0 { (a, of_a) } else { (b, of_b) }
    }

    /// Number of instants that wait for a decision.
    pub(crate) fn waiting(&self) -> usize {
        self.records[0].len()
    }
}

/// Takes the `count` oldest instants away; the next one begins.
fn forget<const N: usize>(record: &mut Vec<Linearised<N>>, count: usize) {
    record.drain(..count);
    if let Some(first) = record.first_mut() {
        first.arrive = None;
    }
}

/// Twice the loss of the squared normalised innovation `fit`, `fit` itself without a robust weight.
pub(crate) fn loss(robust: Robust, fit: f64) -> f64 {
    match robust {
        Robust::None => fit,
        Robust::Gate(limit) => fit.min(limit),
        Robust::Huber(c) if fit > c * c => 2.0 * c * fit.sqrt() - c * c,
        Robust::Huber(_) => fit,
        Robust::Redescending(c) => {
            let rest = (1.0 - fit / (c * c)).max(0.0);
            c * c / 3.0 * (1.0 - rest * rest * rest)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn losses_are_those_of_the_weights() {
        // ρ(ν) = 2 ∫ ψ with ψ(ν) = w(ν) ν: the derivative of the loss by ν² is the weight.
        for robust in [Robust::None, Robust::Huber(1.345), Robust::Redescending(4.685)] {
            for fit in [0.5, 1.5, 4.0, 20.0, 40.0] {
                let slope = (loss(robust, fit + 1e-5) - loss(robust, fit - 1e-5)) / 2e-5;
                assert!((slope - robust.weight(fit)).abs() < 1e-7, "{robust:?} {fit}: {slope}");
            }
            assert_eq!(loss(robust, 0.0), 0.0);
        }
        assert_eq!([loss(Robust::Gate(9.0), 4.0), loss(Robust::Gate(9.0), 1e6)], [4.0, 9.0]);
    }
}
