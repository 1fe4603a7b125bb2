//! Independent losses.

use super::{Arrivals, Channel, DesignError, checked_loss_rate};
use rand::{Rng, RngExt};

/// Loses each packet independently with one probability; the others arrive at once.
///
/// ```
/// use fixtrail_sim::channels::{Bernoulli, Channel};
/// let mut perfect = Bernoulli::new(0.0)?;
/// assert!(!perfect.transmit(&mut rand_pcg::Pcg64::new(1, 1)).is_lost());
/// # Ok::<(), fixtrail_sim::channels::DesignError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bernoulli {
    loss_rate: f64,
}

impl Bernoulli {
    /// A channel that loses the fraction `loss_rate` of its packets.
    ///
    /// # Errors
    /// [`DesignError::LossRate`] outside [0, 1).
    pub fn new(loss_rate: f64) -> Result<Bernoulli, DesignError> {
        Ok(Bernoulli { loss_rate: checked_loss_rate(loss_rate)? })
    }
}

impl Channel for Bernoulli {
    fn transmit(&mut self, rng: &mut dyn Rng) -> Arrivals {
        if rng.random_bool(self.loss_rate) { Arrivals::lost() } else { Arrivals::one(0.0) }
    }
}
