//! `[sensor]` or `[[sensor]]`: what measures the targets.

use super::names::{LATER_ROBUST, LATER_SENSORS, ROBUST, SENSORS, choose};
use super::value::{Field, Table};
use super::{ModelSpec, Robust, SensorSpec};
use crate::error::BuildError;
use crate::packet::Kind;
use std::collections::BTreeMap;

/// Threshold of `robust = "gate"` when none is given: three standard deviations.
const DEFAULT_GATE: f64 = 9.0;

/// The sensors of the spec `root`, if they suit `model`.
pub(super) fn sensors(root: &Table<'_>, model: &ModelSpec) -> Result<Vec<SensorSpec>, BuildError> {
    let axes = match model {
        ModelSpec::Kinematic(kinematic) => kinematic.axes,
        ModelSpec::Turn(_) => 2,
        ModelSpec::Linear(_) => {
            return match root.get("sensor") {
                None => Ok(Vec::new()),
                Some(field) => {
                    Err(field.error("does not fit a linear model, expected `C` and `R` in `[model]` instead"))
                }
            };
        }
    };
    let expected = "a table `[sensor]` with `kind` and `sd`";
    let field = root.require("sensor", expected)?;
    let tables = match field.elements() {
        None => vec![field],
        Some(_) => field.list(expected)?,
    };
    let mut sensors: Vec<SensorSpec> = Vec::new();
    for field in &tables {
        let table = field.table(expected)?;
        let sensor = sensor(&table, axes)?;
        if sensors.iter().any(|other| other.kind == sensor.kind) {
            let what = format!("is {:?} a second time, expected one `[[sensor]]` of each kind", sensor.kind.name());
            return Err(table.error("kind", what));
        }
        sensors.push(sensor);
    }
    Ok(sensors)
}

fn sensor(table: &Table<'_>, axes: usize) -> Result<SensorSpec, BuildError> {
    let kind_field = table.require("kind", "\"position\" or \"range\"")?;
    let name = choose(&kind_field, SENSORS, LATER_SENSORS)?;
    let (kind, keys): (_, &[&str]) = match name {
        "range" => (Kind::Range, &["kind", "sd", "bias", "height_m", "latency_s", "robust", "gate"]),
        _ => (Kind::Position, &["kind", "sd", "latency_s", "robust", "gate"]),
    };
    table.only(&format!("a `{name}` sensor"), keys, &["path_loss"])?;
    if kind == Kind::Range && axes == 1 {
        return Err(kind_field.misfit("\"position\", as `model.axes` is 1 and a range needs 2 or 3"));
    }
    let metres = "a standard deviation in metres, a finite number from 1e-9";
    let sd = table
        .require("sd", &format!("{metres} (rows with an `sd` of their own use that instead)"))?
        .number(metres, |v| v >= 1e-9)?;
    let finite = |key: &str, expected: &str| table.get(key).map(|f| f.number(expected, |_| true)).transpose();
    let height_m = finite("height_m", "a finite number of metres")?;
    if let (Some(field), 3) = (table.get("height_m"), axes) {
        return Err(field.misfit("no known height, as `model.axes` is 3 and the height is estimated"));
    }
    Ok(SensorSpec {
        kind,
        sd,
        bias: table.get("bias").map_or(Ok(BTreeMap::new()), |field| bias(&field))?,
        height_m,
        latency_s: finite("latency_s", "a finite number of seconds")?.unwrap_or(0.0),
        robust: robust(table)?,
    })
}

fn bias(field: &Field<'_>) -> Result<BTreeMap<String, f64>, BuildError> {
    let anchors = field.table("a table of anchors and metres, such as { A1 = 0.18 }")?;
    anchors.fields().map(|(name, f)| Ok((name.to_owned(), f.number("a finite number of metres", |_| true)?))).collect()
}

fn robust(table: &Table<'_>) -> Result<Robust, BuildError> {
    let name = table.get("robust").map_or(Ok("none"), |field| choose(&field, ROBUST, LATER_ROBUST))?;
    match (name, table.get("gate")) {
        ("gate", None) => Ok(Robust::Gate(DEFAULT_GATE)),
        ("gate", Some(field)) => field
            .number("a positive finite number, the largest squared innovation over its variance", |v| v > 0.0)
            .map(Robust::Gate),
        (_, None) => Ok(Robust::None),
        (_, Some(field)) => Err(field.misfit("no `gate`, or `robust = \"gate\"` beside it")),
    }
}
