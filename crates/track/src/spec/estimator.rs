//! `[estimator]`: what estimates the targets.

use super::model::{DENSITY, densities};
use super::names::{ALIGNMENTS, ESTIMATORS, VARIANTS, choose, list};
use super::value::{Field, Table};
use super::{Align, EmvfVariant, EstimatorSpec, FosbNoise, ModeSpec, ModelSpec, Robust, SensorSpec, Span};
use crate::error::BuildError;
use crate::packet::Kind;
use fixtrail_core::models::MOST_MODES;

/// Largest number of instants of a window or a lag.
pub const MAX_WINDOW: usize = 100_000;

/// The estimator of a spec that names none.
pub(super) fn default(model: &ModelSpec, sensors: &[SensorSpec]) -> EstimatorSpec {
    if bent(model, sensors).is_none() { EstimatorSpec::Kalman } else { EstimatorSpec::Ekf }
}

/// The estimator in `table`, if it suits `model` and `sensors`.
pub(super) fn estimator(
    table: &Table<'_>,
    model: &ModelSpec,
    sensors: &[SensorSpec],
) -> Result<EstimatorSpec, BuildError> {
    let field = table.require("kind", &format!("one of {}", list(ESTIMATORS.iter().map(|(name, _)| *name))))?;
    let kind = choose(&field, ESTIMATORS, &[])?;
    let keys: &[&str] = match kind {
        "fixed-lag-kalman" => &["kind", "lag", "lag_s"],
        "fms" => &["kind", "window", "window_s", "lag", "lag_s", "align"],
        "ufir" => &["kind", "window", "window_s"],
        "lmvf" => &["kind", "square_root"],
        "emvf" => &["kind", "variant", "range_mixture"],
        "imm" => &["kind", "mode"],
        "fosb" => &["kind", "q", "q11", "q33", "speed_sd"],
        "alpha-beta" => &["kind", "alpha", "beta", "interval_s"],
        _ => &["kind"],
    };
    table.only(&format!("the estimator `{kind}`"), keys, &[])?;
    let instead = match kind {
        "kalman" => Some("`ekf`"),
        "lmvf" => Some("`emvf`, `lmmse` or `gpb1`"),
        "ufir" => Some("`fms` or `ekf`"),
        _ => None,
    };
    if let (Some(instead), Some(bent)) = (instead, bent(model, sensors)) {
        return Err(
            field.error(format!("is {kind:?}, which is for linear models and sensors, but {bent}, expected {instead}"))
        );
    }
    if let ("fosb" | "alpha-beta", Some((what, instead))) = (kind, of_two_states(kind, model, sensors)) {
        return Err(field.error(format!(
            "is {kind:?}, which is for constant velocity and positions, each axis by itself, but {what}, expected {instead}"
        )));
    }
    Ok(match kind {
        "kalman" => EstimatorSpec::Kalman,
        "ekf" => EstimatorSpec::Ekf,
        "rts" => EstimatorSpec::Rts,
        "fixed-lag-kalman" => EstimatorSpec::FixedLagKalman { lag: required(table, &LAG)?.0 },
        "ufir" => EstimatorSpec::Ufir { window: required(table, &WINDOW)?.0 },
        "lmvf" => EstimatorSpec::Lmvf { square_root: flag(table, "square_root")? },
        "lmmse" => EstimatorSpec::Lmmse,
        "gpb1" => EstimatorSpec::Gpb1,
        "imm" => EstimatorSpec::Imm { modes: modes(table, &field, model)? },
        "fosb" => EstimatorSpec::Fosb { noise: fosb_noise(table)?, speed_sd: optional(table, "speed_sd", SPEED)? },
        "alpha-beta" => alpha_beta(table, &field, model)?,
        "emvf" => EstimatorSpec::Emvf { variant: variant(table)?, range_mixture: flag(table, "range_mixture")? },
        _ => fms(table)?,
    })
}

/// Modes of a spec that gives none: a tenth of the model's noise, for this long on average …
const QUIET_S: f64 = 20.0;
/// … and ten times as much, for this long. 20 × 0.1 + 2 × 10 = 22 × 1: in the long run the noise is the model's.
const AGILE_S: f64 = 2.0;

/// `[[estimator.mode]]` of `imm`, the estimator in `table`; `kind` is where it is named.
fn modes(table: &Table<'_>, kind: &Field<'_>, model: &ModelSpec) -> Result<[Option<ModeSpec>; MOST_MODES], BuildError> {
    let ((noise, axes), turn_noise) = match model {
        ModelSpec::Kinematic(m) => ((&m.noise[..], m.axes), None),
        ModelSpec::Turn(m) if m.per_step.is_some() => {
            return Err(kind.error(
                "is \"imm\", whose modes have densities of noise, but `model.turn_noise` is one per step, expected a number there",
            ));
        }
        ModelSpec::Turn(m) => ((&m.noise[..], 2), Some(m.turn_noise)),
        ModelSpec::GaussMarkov(_) => {
            return Err(kind.error(
                "is \"imm\", whose modes differ in noise, but the model has a `speed_mps`, expected `ekf`, `rts` or another model",
            ));
        }
        ModelSpec::Linear(_) => {
            return Err(kind.error(
                "is \"imm\", which is for kinematic models, but the model gives matrices per step, expected `kalman`",
            ));
        }
    };
    let three = |noise: &[f64]| core::array::from_fn(|axis| noise.get(axis).copied().unwrap_or(0.0));
    let mut modes = [None; MOST_MODES];
    let Some(field) = table.get("mode") else {
        for (mode, (times, mean_s)) in modes.iter_mut().zip([(0.1, QUIET_S), (10.0, AGILE_S)]) {
            let noise = three(noise).map(|psd: f64| psd * times);
            *mode = Some(ModeSpec { noise, turn_noise: turn_noise.map_or(0.0, |psd| psd * times), mean_s });
        }
        return Ok(modes);
    };
    let expected = format!("2 to {MOST_MODES} tables `[[estimator.mode]]`, or none");
    let tables = field.elements().filter(|tables| (2..=MOST_MODES).contains(&tables.len()));
    for (mode, field) in modes.iter_mut().zip(tables.ok_or_else(|| field.misfit(&expected))?) {
        let table = field.table(&expected)?;
        match turn_noise {
            Some(_) => table.only("a mode", &["noise", "turn_noise", "mean_s"], &[])?,
            None => table.only("a mode", &["noise", "mean_s"], &[])?,
        }
        let of_mode = table.get("noise").map(|field| densities(&field, axes)).transpose()?;
        let turning = table.get("turn_noise").map(|field| field.number(DENSITY, |v| v >= 0.0)).transpose()?;
        let seconds = "a finite number of seconds from 1e-9: how long the mode lasts on average";
        *mode = Some(ModeSpec {
            noise: three(of_mode.as_deref().unwrap_or(noise)),
            turn_noise: turning.or(turn_noise).unwrap_or(0.0),
            mean_s: table.require("mean_s", seconds)?.number(seconds, |v| v >= 1e-9)?,
        });
    }
    Ok(modes)
}

fn flag(table: &Table<'_>, key: &str) -> Result<bool, BuildError> {
    table.get(key).map_or(Ok(false), |field| field.flag())
}

fn variant(table: &Table<'_>) -> Result<EmvfVariant, BuildError> {
    Ok(match table.get("variant").map(|field| choose(&field, VARIANTS, &[])).transpose()? {
        Some("model1-zero") => EmvfVariant::Model1Zero,
        Some("model1-skip") => EmvfVariant::Model1Skip,
        _ => EmvfVariant::Model2,
    })
}

/// What is not linear about `model` and `sensors`.
fn bent(model: &ModelSpec, sensors: &[SensorSpec]) -> Option<&'static str> {
    if matches!(model, ModelSpec::Turn(_)) {
        return Some("`model.kind` is \"coordinated-turn\"");
    }
    let position = |sensor: &SensorSpec| sensor.kind == Kind::Position;
    (!sensors.iter().all(position)).then_some("`sensor.kind` is \"range\"")
}

/// Why `model` and `sensors` are not what the estimator `kind` takes, location and speed of each axis by itself, and what to do instead.
fn of_two_states(kind: &str, model: &ModelSpec, sensors: &[SensorSpec]) -> Option<(&'static str, &'static str)> {
    let ModelSpec::Kinematic(kinematic) = model else {
        return Some(match model {
            ModelSpec::Linear(_) => ("the model gives matrices per step", "`kalman`"),
            _ => ("the model is another", "`ekf`, or `model.kind` \"constant-velocity\""),
        });
    };
    if kinematic.order != 2 {
        return Some((
            "the model has another number of derivatives",
            "`kalman`, or `model.kind` \"constant-velocity\"",
        ));
    }
    if sensors.iter().any(|s| s.kind != Kind::Position) {
        return Some(("`sensor.kind` is another", "`ekf`"));
    }
    if sensors.iter().any(|s| s.robust != Robust::None) {
        return Some(("`sensor.robust` judges fixes by a variance, which this filter does not know well", "`kalman`"));
    }
    let prior = kinematic.prior.as_ref()?;
    let n = kinematic.axes;
    let correlated = |i: usize, j: usize| i != j && prior.cov.at(i, j) != 0.0 && (kind == "fosb" || i % n != j % n);
    let any = (0..2 * n).any(|i| (0..2 * n).any(|j| correlated(i, j)));
    any.then_some(("`model.P0` has covariances that it does not keep", "`kalman`, or a diagonal `P0`"))
}

const SPEED: &str = "a standard deviation in m/s, a finite number from 1e-9";

fn optional(table: &Table<'_>, key: &str, expected: &str) -> Result<Option<f64>, BuildError> {
    table.get(key).map(|field| field.number(expected, |v| v >= 1e-9)).transpose()
}

fn fosb_noise(table: &Table<'_>) -> Result<FosbNoise, BuildError> {
    let variance = |field: &Field<'_>, unit: &str| {
        field.number(&format!("a variance in {unit}, a finite number of at least 0"), |v| v >= 0.0)
    };
    let both = "`q11` and `q33`, the variances of location and speed per instant, together";
    match (table.get("q"), table.get("q11"), table.get("q33")) {
        (None, None, None) => Ok(FosbNoise::Model),
        (Some(q), None, None) => Ok(FosbNoise::Acceleration { q: variance(&q, "m²/s⁴")? }),
        (Some(q), _, _) => {
            Err(q.error(format!("is {} beside `q11` or `q33`, expected only one of the two kinds of noise", q.shown())))
        }
        (None, Some(q11), Some(q33)) => {
            Ok(FosbNoise::Speed { q11: variance(&q11, "m²")?, q33: variance(&q33, "m²/s²")? })
        }
        (None, Some(_), None) => Err(table.missing("q33", both)),
        (None, None, Some(_)) => Err(table.missing("q11", both)),
    }
}

fn alpha_beta(table: &Table<'_>, kind: &Field<'_>, model: &ModelSpec) -> Result<EstimatorSpec, BuildError> {
    let interval_s = optional(table, "interval_s", "seconds between fixes, a finite number from 1e-9")?;
    let expected = "a positive number with 2 `alpha` + `beta` below 4: other gains let errors grow";
    let gains = match (table.get("alpha"), table.get("beta")) {
        (None, None) => None,
        (Some(alpha), Some(field)) => {
            let alpha = alpha.number(expected, |v| v > 0.0 && v < 2.0)?;
            Some([alpha, field.number(expected, |v| v > 0.0 && 2.0 * alpha + v < 4.0)?])
        }
        (Some(_), None) => return Err(table.missing("beta", "the gain of the speed beside `alpha`")),
        (None, Some(_)) => return Err(table.missing("alpha", "the gain of the location beside `beta`")),
    };
    let still = matches!(model, ModelSpec::Kinematic(m) if m.noise.contains(&0.0));
    if gains.is_none() && still {
        let what = "is \"alpha-beta\", whose gains at a `model.noise` of 0 are 0, expected `alpha` and `beta`, noise above 0, or `kalman`";
        return Err(kind.error(what));
    }
    Ok(EstimatorSpec::AlphaBeta { gains, interval_s })
}

/// The two keys of a span.
struct Keys {
    instants: &'static str,
    seconds: &'static str,
    /// Fewest instants.
    least: usize,
}

const WINDOW: Keys = Keys { instants: "window", seconds: "window_s", least: 1 };
const LAG: Keys = Keys { instants: "lag", seconds: "lag_s", least: 0 };

fn fms(table: &Table<'_>) -> Result<EstimatorSpec, BuildError> {
    let align = match table.get("align").map(|field| choose(&field, ALIGNMENTS, &[])).transpose()? {
        Some("predicted") => Align::Predicted,
        _ => Align::Filtered,
    };
    let (window, _) = required(table, &WINDOW)?;
    let Some((lag, field)) = span(table, &LAG)? else {
        return Ok(EstimatorSpec::Fms { window, lag: Span::Instants(0), align });
    };
    // A span in instants against one in seconds is known only from the data.
    match (window, lag, align) {
        (Span::Instants(m), Span::Instants(d), Align::Predicted) if d > m => {
            Err(field.misfit(format!("at most {m}, the `window`")))
        }
        (Span::Instants(m), Span::Instants(d), Align::Filtered) if d >= m => Err(field
            .misfit(format!("at most {}, one less than the `window` of {m}: it ends at the newest instant", m - 1))),
        (Span::Seconds(m), Span::Seconds(d), _) if d > m => Err(field.misfit(format!("at most {m:?}, the `window_s`"))),
        _ => Ok(EstimatorSpec::Fms { window, lag, align }),
    }
}

/// The span under one of `keys`, with where it stands.
fn span<'a>(table: &Table<'a>, keys: &Keys) -> Result<Option<(Span, Field<'a>)>, BuildError> {
    match (table.get(keys.instants), table.get(keys.seconds)) {
        (Some(_), Some(field)) => {
            Err(field.error(format!("is {} beside `{}`, expected only one of the two", field.shown(), keys.instants)))
        }
        (Some(field), None) => Ok(Some((Span::Instants(field.count(keys.least, MAX_WINDOW)?), field))),
        (None, Some(field)) => {
            let zero = keys.least == 0;
            let expected =
                if zero { "a finite number of seconds, at least 0" } else { "a positive finite number of seconds" };
            let seconds = field.number(expected, |v| v > 0.0 || (zero && v == 0.0))?;
            Ok(Some((Span::Seconds(seconds), field)))
        }
        (None, None) => Ok(None),
    }
}

fn required<'a>(table: &Table<'a>, keys: &Keys) -> Result<(Span, Field<'a>), BuildError> {
    let expected = || format!("a number of instants, or `{}` in seconds", keys.seconds);
    span(table, keys)?.ok_or_else(|| table.missing(keys.instants, expected()))
}
