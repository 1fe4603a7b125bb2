//! `sequence`: the steps of a time-varying linear model, one JSON object per line.

use super::LinearStep;
use super::linear::{Matrices, STEP_KEYS, Sources};
use super::matrix::shape;
use super::value::{Field, Node, Table};
use crate::error::BuildError;
use serde_core::de::{Deserialize, Deserializer, MapAccess, Visitor};
use std::path::Path;

/// The first step, or the base where it is whole, and every step of the file that `field` of `spec` names.
pub(super) fn read(
    field: &Field<'_>,
    spec: &Path,
    given: &Matrices,
    sources: &mut Sources<'_>,
) -> Result<(LinearStep, Vec<LinearStep>), BuildError> {
    let expected = "the name of an NDJSON file";
    let name = field.text(expected)?;
    if name.is_empty() {
        return Err(field.misfit(expected));
    }
    let path = spec.parent().unwrap_or(Path::new("")).join(name);
    let bytes = sources(&path).map_err(|e| {
        field.error(format!("is {}, expected a file that can be read, but `{}`: {e}", field.shown(), path.display()))
    })?;
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&bytes);

    let mut base = None;
    let mut steps: Vec<LinearStep> = Vec::new();
    for (i, text) in bytes.split(|&b| b == b'\n').enumerate() {
        if text.trim_ascii().is_empty() {
            continue;
        }
        let line = i as u64 + 1;
        let node = Node::from_json(members(&path, line, text)?, line);
        let table = node.field(&path, "").table("a JSON object")?;
        table.only("a step", &STEP_KEYS, &[])?;
        let own = Matrices::read(&table)?;
        if steps.is_empty() && given.is_whole() && (given.b.is_some() || own.b.is_none()) {
            base = Some(given.clone().complete(&table, "")?);
        }
        let step = own.over(given).complete(&table, " in every step, as `[model]` has none")?;
        same_sizes(&table, &step, base.as_ref().or(steps.first()))?;
        steps.push(step);
    }
    let first = steps.first().ok_or_else(|| {
        BuildError::new(
            &path,
            None,
            None,
            "is empty, expected one step per line, a JSON object with any of A, B, G, C, Q, R",
        )
    })?;
    Ok((base.unwrap_or_else(|| first.clone()), steps))
}

/// Nothing, if states, inputs and measurements are as many as in `reference`; the noise may have any size.
fn same_sizes(table: &Table<'_>, step: &LinearStep, reference: Option<&LinearStep>) -> Result<(), BuildError> {
    let Some(reference) = reference else { return Ok(()) };
    for (key, m, first) in [("A", &step.a, &reference.a), ("B", &step.b, &reference.b), ("C", &step.c, &reference.c)] {
        if (m.rows, m.cols) != (first.rows, first.cols) {
            let what = format!("is {}, expected {} as in the steps before or in `[model]`", shape(m), shape(first));
            return Err(table.error(key, what));
        }
    }
    Ok(())
}

/// The members of the object on one line, in order.
fn members(path: &Path, line: u64, text: &[u8]) -> Result<Vec<(String, serde_json::Value)>, BuildError> {
    let step: Step = serde_json::from_slice(text).map_err(|e| {
        let message = e.to_string();
        // The place that serde_json adds counts from this line's own beginning.
        let what = message.rsplit_once(" at line ").map_or(message.as_str(), |(what, _)| what);
        let column = e.column();
        BuildError::new(
            path,
            Some(line),
            None,
            format!("is no step, a JSON object is expected (column {column}: {what})"),
        )
    })?;
    Ok(step.0)
}

/// A JSON object whose keys are different: `serde_json`'s own would keep the last of two.
struct Step(Vec<(String, serde_json::Value)>);

impl<'de> Deserialize<'de> for Step {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Step, D::Error> {
        struct Members;
        impl<'de> Visitor<'de> for Members {
            type Value = Step;

            fn expecting(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                f.write_str("a JSON object")
            }

            fn visit_map<M: MapAccess<'de>>(self, mut map: M) -> Result<Step, M::Error> {
                let mut members: Vec<(String, serde_json::Value)> = Vec::new();
                while let Some((key, value)) = map.next_entry::<String, serde_json::Value>()? {
                    if members.iter().any(|(k, _)| *k == key) {
                        return Err(serde_core::de::Error::custom(format!("duplicate key `{key}`")));
                    }
                    members.push((key, value));
                }
                Ok(Step(members))
            }
        }
        deserializer.deserialize_map(Members)
    }
}
