//! Losses in bursts.

use super::{Arrivals, Channel, DesignError, checked_loss_rate};
use rand::{Rng, RngExt};

/// Loses every packet of a bad state and none of a good one; the states form a Markov chain.
///
/// With `P(bad → good) = r` and `P(good → bad) = p`, the loss rate is `p/(p + r)` and a burst lasts `1/r` packets on average
/// (Gilbert 1960, "Capacity of a burst-noise channel", with error probability 1 in the bad state). The first packet is drawn
/// from the stationary distribution. What is not lost arrives at once.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GilbertElliott {
    loss_rate: f64,
    good_to_bad: f64,
    bad_to_good: f64,
    bad: Option<bool>,
}

impl GilbertElliott {
    /// A channel that loses the fraction `loss_rate` of its packets in bursts of `mean_burst` packets on average.
    ///
    /// # Errors
    /// [`DesignError::LossRate`] outside [0, 1); [`DesignError::MeanBurst`] when bursts are shorter than 1 or so short that
    /// the good state would have to be left more often than always.
    pub fn new(loss_rate: f64, mean_burst: f64) -> Result<GilbertElliott, DesignError> {
        let loss_rate = checked_loss_rate(loss_rate)?;
        let min = (loss_rate / (1.0 - loss_rate)).max(1.0);
        if !(mean_burst >= min && mean_burst.is_finite()) {
            return Err(DesignError::MeanBurst { value: mean_burst, min });
        }
        let bad_to_good = 1.0 / mean_burst;
        let good_to_bad = (bad_to_good * loss_rate / (1.0 - loss_rate)).min(1.0);
        Ok(GilbertElliott { loss_rate, good_to_bad, bad_to_good, bad: None })
    }
}

impl Channel for GilbertElliott {
    fn transmit(&mut self, rng: &mut dyn Rng) -> Arrivals {
        let bad = match self.bad {
            None => rng.random_bool(self.loss_rate),
            Some(true) => !rng.random_bool(self.bad_to_good),
            Some(false) => rng.random_bool(self.good_to_bad),
        };
        self.bad = Some(bad);
        if bad { Arrivals::lost() } else { Arrivals::one(0.0) }
    }
}
