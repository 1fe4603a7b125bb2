//! The walk over a spec: text in, typed spec out.

use super::linear::Sources;
use super::matrix::{MAX_INPUT, MAX_MEASUREMENT};
use super::names::{list, suggestion};
use super::value::{Field, Node, Table};
use super::{LinkSpec, Spec, estimator, link, model, sensor};
use crate::error::BuildError;
use std::collections::BTreeMap;
use std::path::Path;

/// The checked spec in `text`, the content of `file`.
///
/// `read` fetches the NDJSON file that `model.sequence` names, which is relative to the folder of `file`.
///
/// # Errors
/// [`BuildError`] with file, line and dotted key for the first thing that is wrong, table by table: model, sensors,
/// estimator, link, columns.
pub fn parse(
    text: &str,
    file: &Path,
    read: &mut dyn FnMut(&Path) -> std::io::Result<Vec<u8>>,
) -> Result<Spec, BuildError> {
    let node = Node::of_toml(text, file)?;
    spec(&node.field(file, "").table("a spec")?, read)
}

fn spec(root: &Table<'_>, read: &mut Sources<'_>) -> Result<Spec, BuildError> {
    root.only("a spec", &["version", "anchors", "model", "estimator", "link", "sensor", "columns"], &[])?;
    if let Some(field) = root.get("version") {
        field.number("1, the only version there is", |v| v == 1.0)?;
    }
    let anchors = root.get("anchors").map(|field| name(&field, "the name of a CSV file")).transpose()?;
    let expected = "a table `[model]` with a `kind`";
    let table = root.require("model", expected)?.table(expected)?;
    let model = model::model(&table, read)?;
    let side_m = model::side(&table, &model)?;
    let sensors = sensor::sensors(root, &model)?;
    let estimator = match root.get("estimator") {
        None => estimator::default(&model, &sensors),
        Some(field) => estimator::estimator(&field.table("a table `[estimator]` with a `kind`")?, &model, &sensors)?,
    };
    let link = root.get("link").map_or(Ok(LinkSpec::default()), |field| link::link(&field))?;
    link::suits(root, &link, &estimator, &model)?;
    let columns = root.get("columns").map_or(Ok(BTreeMap::new()), |field| columns(&field))?;
    Ok(Spec { model, estimator, link, sensors, columns, anchors, side_m })
}

/// The columns of a table of measurements, less `z1 …` and `u1 …`.
const COLUMNS: [&str; 16] = [
    "t", "target", "kind", "anchor", "anchor2", "value", "x", "y", "z", "lat", "lon", "alt", "sd", "seq", "received",
    "k",
];

fn columns(field: &Field<'_>) -> Result<BTreeMap<String, String>, BuildError> {
    let table = field.table("a table of our column names and the file's")?;
    let numbered = |letter: char, most: usize| (1..=most).map(move |i| format!("{letter}{i}"));
    let ours = |key: &str| {
        COLUMNS.contains(&key) || numbered('z', MAX_MEASUREMENT).chain(numbered('u', MAX_INPUT)).any(|name| name == key)
    };
    let mut columns = BTreeMap::new();
    for (key, field) in table.fields() {
        if !ours(key) {
            let known = list(COLUMNS.into_iter());
            let hint = suggestion(key, COLUMNS.into_iter());
            return Err(field.error(format!(
                "is no column of ours, expected {known}, `z1` to `z{MAX_MEASUREMENT}` or `u1` to `u{MAX_INPUT}`{hint}"
            )));
        }
        columns.insert(key.to_owned(), name(&field, "the name of a column of the file")?);
    }
    Ok(columns)
}

fn name(field: &Field<'_>, expected: &str) -> Result<String, BuildError> {
    match field.text(expected)? {
        "" => Err(field.misfit(expected)),
        name => Ok(name.to_owned()),
    }
}
