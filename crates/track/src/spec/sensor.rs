//! `[sensor]` or `[[sensor]]`: what measures the targets.

use super::names::{ROBUST, SENSORS, choose};
use super::value::{Field, Table};
use super::{DriftSpec, Lasting, ModelSpec, Robust, SensorSpec};
use crate::error::BuildError;
use crate::packet::Kind;
use fixtrail_core::sensors::PathLoss;
use std::collections::BTreeMap;

/// Threshold of `robust = "gate"` when none is given: three standard deviations.
const DEFAULT_GATE: f64 = 9.0;
/// Threshold of `robust = "huber"` when none is given: normal data lose 5 % of their efficiency.
const DEFAULT_HUBER: f64 = 1.345;
/// Threshold of `robust = "redescending"` when none is given: the same 5 % for the biweight.
const DEFAULT_BIWEIGHT: f64 = 4.685;

/// The sensors of the spec `root`, if they suit `model`.
pub(super) fn sensors(root: &Table<'_>, model: &ModelSpec) -> Result<Vec<SensorSpec>, BuildError> {
    let axes = match model {
        ModelSpec::Kinematic(kinematic) => kinematic.axes,
        ModelSpec::GaussMarkov(stationary) => stationary.axes,
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
        if sensors.iter().any(|other| !may_stand_beside(other.robust, sensor.robust)) {
            let what = "differs from another sensor's, expected one kind of `robust` for all sensors that have one";
            return Err(table.error("robust", what));
        }
        sensors.push(sensor);
    }
    Ok(sensors)
}

/// Keys that every sensor takes.
const COMMON: &[&str] = &["kind", "sd", "latency_s", "robust", "gate", "threshold"];

fn sensor(table: &Table<'_>, axes: usize) -> Result<SensorSpec, BuildError> {
    let kind_field = table.require("kind", "\"position\", \"range\", \"rssi\", \"tdoa\" or \"bearing\"")?;
    let name = choose(&kind_field, SENSORS, &[])?;
    let (kind, own, unit): (_, &[&str], _) = match name {
        "range" => (Kind::Range, &["bias", "drift", "height_m"], "metres"),
        "rssi" => (Kind::Rssi, &["path_loss", "bias", "drift", "height_m"], "dB"),
        "tdoa" => (Kind::Tdoa, &["height_m"], "metres"),
        "bearing" => (Kind::Bearing, &["bias"], "radians"),
        _ => (Kind::Position, &[], "metres"),
    };
    table.only(&format!("a `{name}` sensor"), &[COMMON, own].concat(), &[])?;
    if kind != Kind::Position && axes == 1 {
        return Err(kind_field.misfit(format!("\"position\", as `model.axes` is 1 and a `{name}` sensor needs 2 or 3")));
    }
    let expected = format!("a standard deviation in {unit}, a finite number from 1e-9");
    let sd = table
        .require("sd", &format!("{expected} (rows with an `sd` of their own use that instead)"))?
        .number(&expected, |v| v >= 1e-9)?;
    let finite = |key: &str, expected: &str| table.get(key).map(|f| f.number(expected, |_| true)).transpose();
    let height_m = finite("height_m", "a finite number of metres")?;
    if let (Some(field), 3) = (table.get("height_m"), axes) {
        return Err(field.misfit("no known height, as `model.axes` is 3 and the height is estimated"));
    }
    Ok(SensorSpec {
        kind,
        sd,
        path_loss: if kind == Kind::Rssi { Some(path_loss(table)?) } else { None },
        bias: table.get("bias").map_or(Ok(BTreeMap::new()), |field| bias(&field, unit))?,
        drift: table.get("drift").map(|field| drift(&field, unit)).transpose()?,
        height_m,
        latency_s: finite("latency_s", "a finite number of seconds")?.unwrap_or(0.0),
        robust: robust(table)?,
    })
}

/// Rows of one instant are judged in one way: sensors may differ in the threshold, not in the kind.
fn may_stand_beside(a: Robust, b: Robust) -> bool {
    let none = |r: Robust| r == Robust::None;
    none(a) || none(b) || core::mem::discriminant(&a) == core::mem::discriminant(&b)
}

fn path_loss(sensor: &Table<'_>) -> Result<PathLoss, BuildError> {
    let expected = "a table such as { exponent = 2.5, at_1m_dbm = -40 }";
    let table = sensor.require("path_loss", expected)?.table(expected)?;
    table.only("`path_loss`", &["exponent", "at_1m_dbm"], &[])?;
    // Far outside of what radios do, and far inside of what can be computed.
    let exponent = "the exponent of the distance, a number from 0.1 to 100, 2 in free space";
    let level = "the strength one metre from an anchor, a finite number of dBm";
    Ok(PathLoss {
        exponent: table.require("exponent", exponent)?.number(exponent, |v| (0.1..=100.0).contains(&v))?,
        at_1m_dbm: table.require("at_1m_dbm", level)?.number(level, |_| true)?,
    })
}

fn drift(field: &Field<'_>, unit: &str) -> Result<DriftSpec, BuildError> {
    let table = field.table("a table such as { sd = 0.3, time_s = 30 }")?;
    table.only("`drift`", &["sd", "time_s", "shared_sd", "shared_time_s"], &[])?;
    let size = format!("a standard deviation in {unit}, a finite number from 1e-9");
    let time = "how long an error lasts, a positive finite number of seconds";
    let lasting = |sd: &str, time_s: &str| -> Result<Lasting, BuildError> {
        Ok(Lasting {
            sd: table.require(sd, &size)?.number(&size, |v| v >= 1e-9)?,
            time_s: table.require(time_s, time)?.number(time, |v| v > 0.0)?,
        })
    };
    let has = |keys: [&str; 2]| keys.iter().any(|key| table.get(key).is_some());
    let shared = if has(["shared_sd", "shared_time_s"]) { Some(lasting("shared_sd", "shared_time_s")?) } else { None };
    // A table without either is one that lacks `sd`.
    let each = if shared.is_none() || has(["sd", "time_s"]) { Some(lasting("sd", "time_s")?) } else { None };
    Ok(DriftSpec { each, shared })
}

fn bias(field: &Field<'_>, unit: &str) -> Result<BTreeMap<String, f64>, BuildError> {
    let anchors = field.table(&format!("a table of anchors and {unit}, such as {{ A1 = 0.18 }}"))?;
    let expected = format!("a finite number of {unit}");
    anchors.fields().map(|(name, f)| Ok((name.to_owned(), f.number(&expected, |_| true)?))).collect()
}

fn robust(table: &Table<'_>) -> Result<Robust, BuildError> {
    let name = table.get("robust").map_or(Ok("none"), |field| choose(&field, ROBUST, &[]))?;
    if let (Some(field), true) = (table.get("gate"), name != "gate") {
        return Err(field.misfit("no `gate`, or `robust = \"gate\"` beside it"));
    }
    let weighted = matches!(name, "huber" | "redescending");
    if let (Some(field), false) = (table.get("threshold"), weighted) {
        return Err(field.misfit("no `threshold`, or `robust` \"huber\" or \"redescending\" beside it"));
    }
    let number = |key: &str, default: f64, expected: &str| {
        table.get(key).map_or(Ok(default), |field| field.number(expected, |v| v > 0.0))
    };
    let deviations = "a positive finite number of standard deviations";
    Ok(match name {
        "gate" => Robust::Gate(number(
            "gate",
            DEFAULT_GATE,
            "a positive finite number, the largest squared innovation over its variance",
        )?),
        "huber" => Robust::Huber(number("threshold", DEFAULT_HUBER, deviations)?),
        "redescending" => Robust::Redescending(number("threshold", DEFAULT_BIWEIGHT, deviations)?),
        _ => Robust::None,
    })
}
