//! Bounded random delays.

use super::{Arrivals, Channel, DesignError, checked_delay};
use rand::{Rng, RngExt};

/// How far the probabilities of the delays may add up to something else than 1.
const SUM_TOLERANCE: f64 = 1e-9;

/// Delays every copy that another channel delivers by a random time of its own, within a bound.
///
/// The delays are independent, so copies overtake one another wherever delays differ by more than the time between two packets.
///
/// ```
/// use fixtrail_sim::channels::{Bernoulli, Channel, RandomDelay};
/// // Half of the packets arrive at once, the others one interval of 0.2 s later.
/// let mut channel = RandomDelay::discrete(Box::new(Bernoulli::new(0.0)?), &[0.5, 0.5], 0.2)?;
/// let arrivals = channel.transmit(&mut rand_pcg::Pcg64::new(1, 1));
/// assert!([0.0, 0.2].contains(&arrivals.delays_s()[0]));
/// assert_eq!(channel.longest_s(), 0.2);
/// # Ok::<(), fixtrail_sim::channels::DesignError>(())
/// ```
pub struct RandomDelay {
    inner: Box<dyn Channel>,
    law: Law,
}

/// The distribution of a delay.
enum Law {
    /// A number of intervals.
    Discrete {
        /// Probability of up to as many intervals as the index says.
        cumulative: Vec<f64>,
        interval_s: f64,
    },
    /// Anything between two bounds.
    Uniform { min_s: f64, max_s: f64 },
}

impl RandomDelay {
    /// A channel that delays by 0, 1, 2 … times `interval_s` with the `probabilities` in this order.
    ///
    /// # Errors
    /// [`DesignError::DelayInterval`] unless the interval is positive and at most 1e12 s; [`DesignError::DelayProbability`] when
    /// one is outside [0, 1]; [`DesignError::DelayProbabilities`] when they do not add up to 1 within 1e-9.
    pub fn discrete(
        inner: Box<dyn Channel>,
        probabilities: &[f64],
        interval_s: f64,
    ) -> Result<RandomDelay, DesignError> {
        if interval_s == 0.0 || checked_delay(interval_s).is_none() {
            return Err(DesignError::DelayInterval { value: interval_s });
        }
        if let Some(intervals) = probabilities.iter().position(|p| !(0.0..=1.0).contains(p)) {
            return Err(DesignError::DelayProbability { intervals, value: probabilities[intervals] });
        }
        let sum: f64 = probabilities.iter().sum();
        if (sum - 1.0).abs() > SUM_TOLERANCE {
            return Err(DesignError::DelayProbabilities { sum });
        }
        // Without the impossible delays at the end, so that the last one is the bound.
        let possible = probabilities.iter().rposition(|p| *p > 0.0).map_or(0, |last| last + 1);
        let add = |sum: &mut f64, p: &f64| {
            *sum += p;
            Some(*sum)
        };
        let cumulative = probabilities[..possible].iter().scan(0.0, add).collect();
        Ok(RandomDelay { inner, law: Law::Discrete { cumulative, interval_s } })
    }

    /// A channel that delays by a time uniform on [`min_s`, `max_s`].
    ///
    /// # Errors
    /// [`DesignError::DelayBounds`] unless 0 ≤ `min_s` ≤ `max_s` ≤ 1e12 s.
    pub fn uniform(inner: Box<dyn Channel>, min_s: f64, max_s: f64) -> Result<RandomDelay, DesignError> {
        match (checked_delay(min_s), checked_delay(max_s)) {
            (Some(min_s), Some(max_s)) if min_s <= max_s => {
                Ok(RandomDelay { inner, law: Law::Uniform { min_s, max_s } })
            }
            _ => Err(DesignError::DelayBounds { min_s, max_s }),
        }
    }

    /// Returns the longest delay in seconds that this channel adds to those of the inner one.
    pub fn longest_s(&self) -> f64 {
        match &self.law {
            Law::Discrete { cumulative, interval_s } => cumulative.len().saturating_sub(1) as f64 * interval_s,
            Law::Uniform { max_s, .. } => *max_s,
        }
    }
}

impl Law {
    fn draw_s(&self, rng: &mut dyn Rng) -> f64 {
        let u: f64 = rng.random();
        match self {
            Law::Discrete { cumulative, interval_s } => {
                // The sum may miss 1 by a rounding error, and u may lie between the two: that is the last delay.
                let intervals = cumulative.partition_point(|c| *c <= u).min(cumulative.len().saturating_sub(1));
                intervals as f64 * interval_s
            }
            // Rounding must not exceed the bound.
            Law::Uniform { min_s, max_s } => (min_s + (max_s - min_s) * u).min(*max_s),
        }
    }
}

impl Channel for RandomDelay {
    fn transmit(&mut self, rng: &mut dyn Rng) -> Arrivals {
        let sent = self.inner.transmit(rng);
        sent.delays_s().iter().fold(Arrivals::lost(), |arrivals, delay_s| arrivals.and(delay_s + self.law.draw_s(rng)))
    }
}
