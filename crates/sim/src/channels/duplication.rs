//! Packets that arrive twice.

use super::{Arrivals, Channel, DesignError, checked_delay};
use rand::{Rng, RngExt};

/// Repeats some of the packets that another channel delivers.
///
/// A packet is repeated once, a uniform lag after its first copy, whatever the number of copies the inner channel delivers.
pub struct Duplication {
    inner: Box<dyn Channel>,
    rate: f64,
    longest_lag_s: f64,
}

impl Duplication {
    /// A channel that repeats the fraction `rate` of the packets that arrive, up to `longest_lag_s` later.
    ///
    /// # Errors
    /// [`DesignError::DuplicationRate`] outside [0, 1]; [`DesignError::DuplicationLag`] outside [0, 1e12] s.
    pub fn new(inner: Box<dyn Channel>, rate: f64, longest_lag_s: f64) -> Result<Duplication, DesignError> {
        if !(0.0..=1.0).contains(&rate) {
            return Err(DesignError::DuplicationRate { value: rate });
        }
        let longest_lag_s = checked_delay(longest_lag_s).ok_or(DesignError::DuplicationLag { value: longest_lag_s })?;
        Ok(Duplication { inner, rate, longest_lag_s })
    }
}

impl Channel for Duplication {
    fn transmit(&mut self, rng: &mut dyn Rng) -> Arrivals {
        let sent = self.inner.transmit(rng);
        match sent.delays_s().first() {
            Some(first_s) if rng.random_bool(self.rate) => sent.and(first_s + self.longest_lag_s * rng.random::<f64>()),
            _ => sent,
        }
    }
}
