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
];

/// `estimator.kind`, one day.
pub(super) const LATER_ESTIMATORS: &[&str] = &["lmvf", "lmmse", "emvf", "gpb1", "fosb", "alpha-beta", "imm"];

/// `model.kind`.
pub const MODELS: &[Named] = &[
    ("random-walk", "position driven by white noise, 1 to 3 axes"),
    ("constant-velocity", "velocity driven by white noise, 1 to 3 axes"),
    ("constant-acceleration", "acceleration driven by white noise, 1 to 3 axes"),
    ("coordinated-turn", "velocity turning at a slowly varying rate, in the plane"),
    ("linear", "matrices A, B, G, C, Q, R from the spec, fixed or step by step"),
    ("fms-paper", "the finite-memory smoother paper's one-axis model: position, velocity, acceleration"),
];

/// `sensor.kind`.
pub const SENSORS: &[Named] = &[
    ("position", "coordinates in metres, or latitude and longitude"),
    ("range", "distance to an anchor in metres, 2 or 3 axes"),
];

/// `sensor.kind`, one day.
pub(super) const LATER_SENSORS: &[&str] = &["rssi", "tdoa", "bearing"];

/// What a link can be.
pub const LINKS: &[Named] =
    &[("stamped", "every packet says when it was sensed; lost and late packets are known as such")];

/// How measurements can be scheduled.
pub const SCHEDULERS: &[Named] = &[];

/// What a simulated channel can do to packets.
pub const CHANNELS: &[Named] = &[
    ("bernoulli", "each packet is lost independently"),
    ("gilbert-elliott", "losses come in bursts: a good and a bad state"),
    ("random-delay", "what arrives is delayed at random within a bound, and overtaken"),
    ("duplication", "some of what arrives arrives a second time, a little later"),
    ("trace", "what a real link did is done again, packet by packet"),
];

/// `sensor.robust`.
pub(super) const ROBUST: &[Named] = &[("none", "uses every measurement"), ("gate", "leaves out what does not fit")];

/// `sensor.robust`, one day.
pub(super) const LATER_ROBUST: &[&str] = &["huber", "redescending"];

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
