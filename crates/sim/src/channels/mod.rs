//! Simulated media: each decides packet by packet whether, when and how often it arrives.
//!
//! Their names stand in [`fixtrail_track::spec::CHANNELS`].

mod arrivals;
mod bernoulli;
mod gilbert_elliott;

pub use arrivals::Arrivals;
pub use bernoulli::Bernoulli;
pub use gilbert_elliott::GilbertElliott;

use rand::Rng;

/// A medium that loses, delays and repeats packets.
///
/// Every implementation draws from `rng` alone and depends on nothing but its own state, so equal seeds give equal arrivals.
/// Delays are finite and not negative.
pub trait Channel: Send {
    /// Returns the delays after which copies of the next packet arrive, ascending; none when it is lost.
    fn transmit(&mut self, rng: &mut dyn Rng) -> Arrivals;
}

/// A channel that cannot exist.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum DesignError {
    /// A probability is outside its interval.
    #[error("the loss rate is {value}, expected a number from 0 up to, but not including, 1")]
    LossRate {
        /// The offending value.
        value: f64,
    },
    /// Bursts are shorter than the loss rate allows.
    #[error("the mean burst is {value} packets, expected at least {min} for this loss rate")]
    MeanBurst {
        /// The offending value.
        value: f64,
        /// The shortest mean burst of a two-state chain with this loss rate.
        min: f64,
    },
}

fn checked_loss_rate(value: f64) -> Result<f64, DesignError> {
    if (0.0..1.0).contains(&value) { Ok(value) } else { Err(DesignError::LossRate { value }) }
}
