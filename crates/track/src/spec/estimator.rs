//! `[estimator]`: what estimates the targets.

use super::names::{ALIGNMENTS, ESTIMATORS, LATER_ESTIMATORS, VARIANTS, choose, list};
use super::value::{Field, Table};
use super::{Align, EmvfVariant, EstimatorSpec, ModelSpec, SensorSpec, Span};
use crate::error::BuildError;
use crate::packet::Kind;

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
    let kind = choose(&field, ESTIMATORS, LATER_ESTIMATORS)?;
    let keys: &[&str] = match kind {
        "fixed-lag-kalman" => &["kind", "lag", "lag_s"],
        "fms" => &["kind", "window", "window_s", "lag", "lag_s", "align"],
        "ufir" => &["kind", "window", "window_s"],
        "lmvf" => &["kind", "square_root"],
        "emvf" => &["kind", "variant", "range_mixture"],
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
    Ok(match kind {
        "kalman" => EstimatorSpec::Kalman,
        "ekf" => EstimatorSpec::Ekf,
        "rts" => EstimatorSpec::Rts,
        "fixed-lag-kalman" => EstimatorSpec::FixedLagKalman { lag: required(table, &LAG)?.0 },
        "ufir" => EstimatorSpec::Ufir { window: required(table, &WINDOW)?.0 },
        "lmvf" => EstimatorSpec::Lmvf { square_root: flag(table, "square_root")? },
        "lmmse" => EstimatorSpec::Lmmse,
        "gpb1" => EstimatorSpec::Gpb1,
        "emvf" => EstimatorSpec::Emvf { variant: variant(table)?, range_mixture: flag(table, "range_mixture")? },
        _ => fms(table)?,
    })
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
