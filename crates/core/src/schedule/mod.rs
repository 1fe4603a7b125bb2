//! Which sensor measures next, and when: scheduling of sensors that live on batteries.
//!
//! A [`Scheduler`] holds the sensors, their energy and the group that is awake around the target. At each decision it asks a
//! [`Foresight`] (the filter's own forecast) how accurate each candidate would be, and answers with a [`Plan`]; [`Scheduler::settle`] takes
//! the plan's energy from the batteries once it is carried out.
//!
//! ```text
//! candidate (T, j)   T of the intervals, j of the group, ‖p(f(x̂, T)) − s_j‖ ≤ range
//! φ = accuracy of P_{k+1|k+1}(T, j)      E = energy of measuring with j and handing over to it
//! some φ ≤ φ_0:      the least E/T, then the longest T, then the nearest sensor           (44)
//! none:              of the shortest T the least w φ + (1 − w) E/T                        (43)
//! no candidate:      the target coasts for the shortest T
//! ```
//!
//! Improved dynamic group scheduling of \[MVF10, sec. 4.2.3\], with the parts that the paper leaves open as `docs/equations.md` has them.

mod energy;
mod scheduler;

pub use energy::{Battery, Radio};
pub use scheduler::{Candidate, Choice, Foresight, MOST_INTERVALS, Mode, Plan, Policy, Scheduler};

/// Most sensors that are awake at a time.
pub const MOST_AWAKE: usize = 64;

/// Why sensors cannot be scheduled.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum DesignError {
    /// There is no sensor.
    #[error("the field has no sensor, expected at least 1")]
    NoSensor,
    /// A group is larger than the field, or empty.
    #[error("the group has {group} sensors, expected 1 to {most}")]
    Group {
        /// The offending size.
        group: usize,
        /// The largest possible.
        most: usize,
    },
    /// There is no interval, too many, or one that is no length of time.
    #[error("the sample intervals are not 1 to {MOST_INTERVALS} ascending positive numbers of seconds")]
    Intervals,
    /// The weight of accuracy against energy is no share.
    #[error("the weight of the accuracy is {weight}, expected a number from 0 to 1")]
    Weight {
        /// The offending weight.
        weight: f64,
    },
    /// A constant of the radio is negative or not finite.
    #[error("`{name}` of the radio is {value}, expected a finite number of at least 0")]
    Energy {
        /// Which constant.
        name: &'static str,
        /// The offending value.
        value: f64,
    },
}
