//! Which column of a file holds what.

use crate::cell::clip;
use std::collections::BTreeMap;

/// A column we know: the name in the contract, and its alias.
pub(crate) struct Known {
    /// Its name.
    pub name: &'static str,
    /// A second name for the same thing.
    pub alias: Option<&'static str>,
}

/// Makes a [`Known`] without an alias.
pub(crate) const fn known(name: &'static str) -> Known {
    Known { name, alias: None }
}

/// Makes a [`Known`] with an alias.
pub(crate) const fn aliased(name: &'static str, alias: &'static str) -> Known {
    Known { name, alias: Some(alias) }
}

/// Whether the names of a table's columns are all there.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Extent {
    /// Every name: a CSV header, a Parquet schema, or the keys of a whole NDJSON file.
    Whole,
    /// The keys of the NDJSON rows read so far.
    SoFar,
}

/// What is wrong with a header: the column, and the sentence.
pub(crate) type HeaderError = (Option<String>, String);

/// Refuses a name that stands twice.
pub(crate) fn check_unique(names: &[String]) -> Result<(), HeaderError> {
    let mut seen = BTreeMap::new();
    for (i, name) in names.iter().enumerate() {
        if let Some(first) = seen.insert(name, i) {
            let what = format!("is the name of columns {} and {}, expected each name once", first + 1, i + 1);
            return Err((Some(clip(name).into_owned()), what));
        }
    }
    Ok(())
}

/// The position of a column of ours among the file's `names`.
pub(crate) fn find(
    names: &[String],
    wanted: &str,
    alias: Option<&str>,
    mapping: &BTreeMap<String, String>,
    extent: Extent,
) -> Result<Option<usize>, HeaderError> {
    let position = |name: &str| names.iter().position(|n| n == name);
    if let Some(mapped) = mapping.get(wanted).or_else(|| alias.and_then(|a| mapping.get(a))) {
        let found = position(mapped);
        if found.is_none() && extent == Extent::Whole {
            let what = format!("is missing, `[columns]` says it holds `{wanted}`; there are {}", list(names));
            return Err((Some(mapped.clone()), what));
        }
        return Ok(found);
    }
    match (position(wanted), alias.and_then(position)) {
        (Some(_), Some(_)) => Err((
            alias.map(str::to_owned),
            format!("stands beside `{wanted}`, expected one of the two names for the same thing"),
        )),
        (a, b) => Ok(a.or(b)),
    }
}

/// Names for a message: "`t`, `x`, `y`".
pub(crate) fn list(names: &[String]) -> String {
    const SHOWN: usize = 12;
    let mut text = names.iter().take(SHOWN).map(|n| format!("`{}`", clip(n))).collect::<Vec<_>>().join(", ");
    if names.len() > SHOWN {
        text.push_str(&format!(" and {} more", names.len() - SHOWN));
    }
    text
}

/// The error for a column that must be there.
pub(crate) fn missing(wanted: &str, why: &str, names: &[String]) -> HeaderError {
    let what = format!("is missing, {why}; there are {} (`[columns]` renames)", list(names));
    (Some(wanted.to_owned()), what)
}
