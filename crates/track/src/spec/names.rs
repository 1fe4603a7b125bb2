//! The names that specs use, in one list each: the parser accepts them, `fixtrail list` prints them.

use super::value::Field;
use crate::error::BuildError;

/// A name and one line about it.
pub type Named = (&'static str, &'static str);

/// `estimator.kind`.
pub const ESTIMATORS: &[Named] = &[
    ("kalman", "Kalman filter, for linear models and position sensors"),
    ("ekf", "extended Kalman filter, for every model and sensor"),
    ("rts", "Rauch-Tung-Striebel smoother: every instant given the whole recording"),
    ("fixed-lag-kalman", "Kalman smoother a fixed `lag` behind the newest data"),
    ("fms", "finite-memory filter and smoother: best linear unbiased over a `window`, no prior"),
    (
        "ufir",
        "unbiased finite impulse response filter: least squares over a `window`, process noise ignored, linear only",
    ),
    ("lmvf", "linear minimum-variance filter for a receiver that holds values (Theorem 1 of its paper)"),
    ("lmmse", "exact linear minimum mean square error for a receiver that holds values; linearised for other models"),
    ("emvf", "extended minimum-variance filter for a receiver that holds values (Theorem 2 of its paper)"),
    ("gpb1", "two hypotheses, new or held, weighed by how well they fit: arrivals unknown, every model and sensor"),
    ("imm", "interacting multiple models: a filter for each mode of motion, kinematic models and every sensor"),
    (
        "fosb",
        "message passing, one axis at a time: constant velocity and positions; sure of places up to 1.5 times too much, of speeds too little",
    ),
    ("alpha-beta", "fixed gains, one axis at a time, for constant velocity and positions"),
];

/// `model.kind`.
pub const MODELS: &[Named] = &[
    ("random-walk", "position driven by white noise, 1 to 3 axes"),
    ("constant-velocity", "velocity driven by white noise, 1 to 3 axes"),
    ("constant-acceleration", "acceleration driven by white noise, 1 to 3 axes"),
    ("gauss-markov", "about a centre: position and velocity keep to a stationary law, 1 to 3 axes"),
    ("coordinated-turn", "velocity turning at a slowly varying rate, in the plane"),
    ("linear", "matrices A, B, G, C, Q, R from the spec, fixed or step by step"),
    ("fms-paper", "the finite-memory smoother paper's one-axis model: position, velocity, acceleration"),
];

/// `sensor.kind`.
pub const SENSORS: &[Named] = &[
    ("position", "coordinates in metres, or latitude and longitude"),
    ("range", "distance to an anchor in metres, 2 or 3 axes"),
    ("rssi", "signal strength at or from an anchor in dBm, by a log-distance law"),
    ("tdoa", "distance to an anchor less that to a reference anchor, in metres"),
    ("bearing", "direction from an anchor in radians, counter-clockwise from x, seen from above"),
];

/// What a link can be.
pub const LINKS: &[Named] = &[
    ("stamped", "every packet says when it was sensed; lost and late packets are known as such"),
    ("unstamped", "the receiver shows what it holds (`hold`), new or old"),
];

/// `link.hold`.
pub(super) const HOLDS: &[Named] = &[
    ("paper", "this instant's value, else the one before, else the one before that, come what may"),
    ("last-received", "the last value that came, for as long as nothing comes"),
];

/// `link.duplicates`.
pub(super) const DUPLICATES: &[Named] =
    &[("keep", "a repeated value counts as new"), ("detect", "a repeated value counts as lost")];

/// `estimator.variant` of `emvf`.
pub(super) const VARIANTS: &[Named] = &[
    ("model2", "after a double loss the receiver holds the value before"),
    ("model1-zero", "after a double loss it shows 0, which is used as it is"),
    ("model1-skip", "after a double loss it shows 0, which is not used"),
];

/// How measurements can be scheduled.
pub const SCHEDULERS: &[Named] = &[
    ("idgss", "the cheapest sensor and interval of those that are accurate enough, from a group around the target"),
    ("nearest", "the sensor nearest to the target, at a fixed interval"),
    ("minimum-trace", "the sensor of the group that leaves the least uncertainty, at a fixed interval"),
    ("fixed-interval", "as `idgss`, at one interval"),
];

/// `schedule.accuracy`.
pub(super) const ACCURACIES: &[Named] = &[
    ("trace", "mean square of the position error"),
    ("sum", "variance of x + y, which is what the paper's formula says"),
];

/// What a simulated channel can do to packets.
pub const CHANNELS: &[Named] = &[
    ("bernoulli", "each packet is lost independently"),
    ("gilbert-elliott", "losses come in bursts: a good and a bad state"),
    ("random-delay", "what arrives is delayed at random within a bound, and overtaken"),
    ("duplication", "some of what arrives arrives a second time, a little later"),
    ("trace", "what a real link did is done again, packet by packet"),
];

/// `motion.kind` of a scenario.
pub const MOTIONS: &[Named] = &[
    ("model", "as `[model]` says"),
    ("circle", "round a centre at constant speed"),
    ("constant-speed", "at constant velocity, with noise on the position alone"),
    ("acceleration", "at constant velocity, with an acceleration in each interval that is then forgotten"),
    ("bouncing", "straight on until the wall of a rectangle, then on in another direction"),
    ("profile", "an acceleration over time: a step, a ramp or a triangle"),
];

/// `sensor.robust`.
pub(super) const ROBUST: &[Named] = &[
    ("none", "uses every measurement"),
    ("gate", "leaves out what does not fit"),
    ("huber", "limits the pull of what does not fit"),
    ("redescending", "lets the pull of what does not fit go to zero"),
];

/// `estimator.align`.
pub(super) const ALIGNMENTS: &[Named] = &[("filtered", "ends at z_k"), ("predicted", "ends at z_{k-1}")];

/// The name in `field`, one of `available`; `later` are names that will be available one day.
pub(super) fn choose(
    field: &Field<'_>,
    available: &'static [Named],
    later: &[&str],
) -> Result<&'static str, BuildError> {
    let names = || available.iter().map(|(name, _)| *name);
    let expected = format!("one of {}", list(names()));
    let text = field.text(&expected)?;
    if let Some(name) = names().find(|name| *name == text) {
        return Ok(name);
    }
    if later.contains(&text) {
        return Err(field.error(format!("is {text:?}, which is not available yet, expected {expected}")));
    }
    Err(field.misfit(format!("{expected}{}", suggestion(text, names()))))
}

/// Names in backquotes, with commas.
pub(super) fn list<'n>(names: impl Iterator<Item = &'n str>) -> String {
    names.map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ")
}

/// " (did you mean `NAME`?)" for the name closest to `text`, nothing when none is close.
pub(super) fn suggestion<'n>(text: &str, names: impl Iterator<Item = &'n str>) -> String {
    // One slip in three letters, and at least one: what a hand does to a word it knows.
    let within = (text.chars().count() / 3).max(1);
    let lower = text.to_lowercase();
    let slips = |name: &str| strsim::osa_distance(&lower, &name.to_lowercase());
    match names.map(|name| (slips(name), name)).filter(|(slips, _)| *slips <= within).min() {
        // Of a one-letter name everything is one slip away; only the case of the letter says something.
        Some((slips, name)) if slips == 0 || name.len() > 1 => format!(" (did you mean `{name}`?)"),
        _ => String::new(),
    }
}
