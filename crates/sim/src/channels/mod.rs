//! Simulated media: each decides packet by packet whether, when and how often it arrives.
//!
//! Their names stand in [`fixtrail_track::spec::CHANNELS`].

mod arrivals;
mod bernoulli;
mod build;
mod duplication;
mod gilbert_elliott;
mod random_delay;
mod trace;

pub use arrivals::Arrivals;
pub use bernoulli::Bernoulli;
pub use build::Variant;
pub use duplication::Duplication;
pub use fixtrail_track::trace::TracePacket;
pub use gilbert_elliott::GilbertElliott;
pub use random_delay::RandomDelay;
pub use trace::Trace;

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
    /// The interval of discrete delays is no length of time.
    #[error("the interval of the delays is {value} s, expected a positive number of seconds up to 1e12")]
    DelayInterval {
        /// The offending value.
        value: f64,
    },
    /// The probability of a discrete delay is outside its interval.
    #[error("`probabilities[{intervals}]` of the delays is {value}, expected a number from 0 to 1")]
    DelayProbability {
        /// The delay, in intervals.
        intervals: usize,
        /// The offending value.
        value: f64,
    },
    /// The probabilities of discrete delays do not belong to one distribution.
    #[error("the probabilities of the delays add up to {sum}, expected 1 within 1e-9")]
    DelayProbabilities {
        /// What they add up to; 0 without any.
        sum: f64,
    },
    /// The bounds of a uniform delay are no interval of time to come.
    #[error("the delays are from {min_s} s to {max_s} s, expected ascending numbers of seconds from 0 to 1e12")]
    DelayBounds {
        /// The shortest delay.
        min_s: f64,
        /// The longest delay.
        max_s: f64,
    },
    /// The probability of a repeated packet is outside its interval.
    #[error("the duplication rate is {value}, expected a number from 0 to 1")]
    DuplicationRate {
        /// The offending value.
        value: f64,
    },
    /// The longest lag of a repeated packet is no length of time.
    #[error("the longest lag of a repeated packet is {value} s, expected a number of seconds from 0 to 1e12")]
    DuplicationLag {
        /// The offending value.
        value: f64,
    },
    /// A trace starts at a packet that it does not have.
    #[error("the trace starts at packet {value}, expected a number below that of its packets, {packets}")]
    TraceStart {
        /// The offending value.
        value: usize,
        /// Number of packets.
        packets: usize,
    },
    /// A packet of a trace arrives before it is sent, or never.
    #[error("the delay of packet {packet} of the trace is {value} s, expected a number of seconds from 0 to 1e12")]
    TraceDelay {
        /// Number of the packet, from 0.
        packet: usize,
        /// The offending value.
        value: f64,
    },
    /// A packet of a trace was received, and yet no copy of it.
    #[error("packet {packet} of the trace was received in 0 copies, expected at least 1")]
    TraceCopies {
        /// Number of the packet, from 0.
        packet: usize,
    },
}

fn checked_loss_rate(value: f64) -> Result<f64, DesignError> {
    if (0.0..1.0).contains(&value) { Ok(value) } else { Err(DesignError::LossRate { value }) }
}

/// The longest delay in seconds, the largest number of a table: sums of such delays stay finite.
const LONGEST_DELAY_S: f64 = 1e12;

fn checked_delay(value_s: f64) -> Option<f64> {
    (0.0..=LONGEST_DELAY_S).contains(&value_s).then_some(value_s)
}
