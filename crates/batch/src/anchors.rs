//! Anchors tables: `anchor,x,y,z`.

use crate::cell::Cell;
use crate::columns::{self, Extent, HeaderError};
use crate::formats::{self, Row, TableSink};
use crate::input::Input;
use fixtrail_track::anchors::Anchors;
use fixtrail_track::error::BuildError;
use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

/// The anchors table to use: `named`, else `anchors.csv` beside the input if there is one.
fn locate(input: &Input, named: Option<&Path>) -> Option<PathBuf> {
    match (named, input) {
        (Some(path), _) => Some(path.to_owned()),
        (None, Input::File(path)) => Some(path.with_file_name("anchors.csv")).filter(|p| p.is_file()),
        (None, Input::Stdin) => None,
    }
}

/// Returns the anchors in the table at `path`, else in `anchors.csv` beside the input; none where there is no such table.
///
/// # Errors
/// [`BuildError`] with file, line, column, value and expectation.
pub fn read_anchors(input: &Input, path: Option<&Path>) -> Result<Anchors, BuildError> {
    match locate(input, path) {
        Some(path) => read(&path),
        None => Ok(Anchors::default()),
    }
}

/// Returns the anchors of a table in the order of its rows. A missing z is 0: a site in the plane.
fn read(path: &Path) -> Result<Anchors, BuildError> {
    let mut sink = AnchorRows { file: path, at: [None; 4], anchors: Anchors::default(), lines: HashMap::new() };
    formats::read(&Input::File(path.to_owned()), None, &mut sink, &mut |_, _| {})?;
    Ok(sink.anchors)
}

struct AnchorRows<'a> {
    file: &'a Path,
    /// Positions of anchor, x, y, z.
    at: [Option<usize>; 4],
    anchors: Anchors,
    lines: HashMap<String, u64>,
}

const NAMES: [&str; 4] = ["anchor", "x", "y", "z"];

impl AnchorRows<'_> {
    fn resolve(&mut self, names: &[String], extent: Extent) -> Result<(), HeaderError> {
        columns::check_unique(names)?;
        for (i, name) in NAMES.iter().enumerate() {
            let alias = (i == 0).then_some("anchor_id");
            self.at[i] = columns::find(names, name, alias, &BTreeMap::new(), extent)?;
            if self.at[i].is_none() && i < 3 && extent == Extent::Whole {
                let what = format!(
                    "is missing, an anchors table needs `anchor`, `x`, `y`; there are {}",
                    columns::list(names)
                );
                return Err((Some((*name).to_owned()), what));
            }
        }
        Ok(())
    }
}

impl TableSink for AnchorRows<'_> {
    fn columns(&mut self, names: &[String], extent: Extent) -> Result<Vec<bool>, BuildError> {
        self.resolve(names, extent).map_err(|(key, what)| BuildError::new(self.file, None, key.as_deref(), what))?;
        Ok((0..names.len()).map(|i| self.at.contains(&Some(i))).collect())
    }

    fn row<R: Row>(&mut self, line: u64, row: &R) -> Result<(), BuildError> {
        let cell = |i: usize| self.at[i].map_or(Cell::Absent, |c| row.cell(c));
        let fail = |i: usize, what: String| BuildError::new(self.file, Some(line), Some(NAMES[i]), what);
        let id = cell(0);
        let name = id.name("the id of an anchor").map_err(|w| fail(0, w))?;
        let name = name.ok_or_else(|| fail(0, "is empty, expected the id of an anchor".to_owned()))?;
        let mut position_m = [0.0; 3];
        for (axis, p) in position_m.iter_mut().enumerate() {
            match cell(axis + 1).number("metres").map_err(|w| fail(axis + 1, w))? {
                Some(x) => *p = x,
                None if axis == 2 => {}
                None => return Err(fail(axis + 1, "is empty, expected metres".to_owned())),
            }
        }
        if self.anchors.add(&name, position_m).is_none() {
            let first = self.lines.get(&*name).copied().unwrap_or(0);
            let known = self.anchors.id(&name).map(|id| self.anchors.position_m(id));
            if known != Some(position_m) {
                let what =
                    format!("is `{name}` again, line {first} puts it elsewhere; expected one position per anchor");
                return Err(fail(0, what));
            }
        }
        self.lines.entry(name.into_owned()).or_insert(line);
        Ok(())
    }

    fn malformed(&mut self, error: BuildError) -> Result<(), BuildError> {
        Err(error)
    }
}
