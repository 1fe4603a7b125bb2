//! `[link]`: what the network does between sensor and receiver.

use super::names::{DUPLICATES, HOLDS, choose};
use super::value::{Field, Table};
use super::{ArrivalSpec, Duplicates, EstimatorSpec, Hold, LinkSpec, ModelSpec, Receiver};
use crate::error::BuildError;

const KEYS: [&str; 5] = ["stamped", "late_s", "arrival", "duplicates", "hold"];

/// The link in `field`.
pub(super) fn link(field: &Field<'_>) -> Result<LinkSpec, BuildError> {
    let table = field.table("a table `[link]`")?;
    table.only("a link", &KEYS, &[])?;
    let stamped = table.get("stamped").map_or(Ok(true), |field| field.flag())?;
    let seconds = "a finite number of seconds, at least 0";
    let late_s = table.get("late_s").map(|field| field.number(seconds, |v| v >= 0.0)).transpose()?;
    let hold = table.get("hold").map(|field| choose(&field, HOLDS, &[])).transpose()?;
    let receiver = match (stamped, table.get("late_s"), table.get("hold")) {
        (true, _, Some(field)) => {
            return Err(field.misfit("no `hold`, or `stamped = false` beside it: packets with a time are not held"));
        }
        (false, Some(field), _) => {
            return Err(field.misfit("no `late_s`, or `stamped = true`: without a time nothing is known to be late"));
        }
        (true, ..) => Receiver::Stamped { late_s },
        (false, ..) => {
            Receiver::Unstamped { hold: if hold == Some("last-received") { Hold::LastReceived } else { Hold::Paper } }
        }
    };
    let duplicates = match table.get("duplicates").map(|field| choose(&field, DUPLICATES, &[])).transpose()? {
        Some("detect") => Duplicates::Detect,
        _ => Duplicates::Keep,
    };
    let arrival = table.get("arrival").map(|field| arrival(&field)).transpose()?;
    Ok(LinkSpec { receiver, arrival, duplicates })
}

const PROBABILITY: &str = "a probability, a number from 0 to 1";

fn arrival(field: &Field<'_>) -> Result<ArrivalSpec, BuildError> {
    const EXPECTED: &str = "a probability, a list of them, { column = \"NAME\" }, or \"estimate\"";
    let probability = |field: &Field<'_>, expected: &str| field.number(expected, |v| (0.0..=1.0).contains(&v));
    if field.elements().is_some() {
        let list = field.list(EXPECTED)?;
        return Ok(ArrivalSpec::List(list.iter().map(|f| probability(f, PROBABILITY)).collect::<Result<_, _>>()?));
    }
    if let Ok(text) = field.text("") {
        return if text == "estimate" { Ok(ArrivalSpec::Estimate) } else { Err(field.misfit(EXPECTED)) };
    }
    if let Ok(table) = field.table("") {
        table.only("an arrival", &["column"], &[])?;
        let expected = "the name of a column of the input";
        return match table.require("column", expected)? {
            column if column.text(expected)?.is_empty() => Err(column.misfit(expected)),
            column => Ok(ArrivalSpec::Column(column.text(expected)?.to_owned())),
        };
    }
    probability(field, EXPECTED).map(ArrivalSpec::Constant)
}

/// Nothing, if the estimator of the spec `root` has what it needs of link and model.
pub(super) fn suits(
    root: &Table<'_>,
    link: &LinkSpec,
    estimator: &EstimatorSpec,
    model: &ModelSpec,
) -> Result<(), BuildError> {
    let timed =
        matches!(estimator, EstimatorSpec::Imm { .. } | EstimatorSpec::Fosb { .. } | EstimatorSpec::AlphaBeta { .. });
    if let (true, Receiver::Unstamped { .. }) = (timed, link.receiver) {
        let what = format!(
            "is {:?}, which needs to know when values were sensed, expected `stamped = true` in `[link]`, or `gpb1` for a link without \
             time stamps",
            estimator.name()
        );
        return Err(at(root, "estimator", "kind", what));
    }
    if !estimator.is_for_held() {
        return Ok(());
    }
    let name = estimator.name();
    let Receiver::Unstamped { hold } = link.receiver else {
        let what = format!(
            "is \"{name}\", which is for receivers that do not know when a value was sensed, expected `stamped = false` in `[link]` \
             (with time stamps `kalman` and `ekf` are exact)"
        );
        return Err(at(root, "estimator", "kind", what));
    };
    if let (Hold::LastReceived, EstimatorSpec::Lmvf { .. } | EstimatorSpec::Emvf { .. }) = (hold, estimator) {
        let what = format!(
            "is \"last-received\", expected \"paper\" for the estimator `{name}`, or `lmmse` or `gpb1` for this hold"
        );
        return Err(at(root, "link", "hold", what));
    }
    if model.prior().is_none() {
        let what =
            format!("is missing, expected the state that the estimator `{name}` starts from, and `P0` beside it");
        return Err(at(root, "model", "x0", what));
    }
    Ok(())
}

/// An error at a key of a table of the spec, whether they are there or not.
fn at(root: &Table<'_>, table: &str, key: &str, what: String) -> BuildError {
    match root.get(table).and_then(|field| field.table("").ok()) {
        Some(table) => table.error(key, what),
        None => root.error(&format!("{table}.{key}"), what),
    }
}
