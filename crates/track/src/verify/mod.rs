//! Conformance: runs a file of vectors computed by independent code through the library and compares.

mod fms;
mod fosb;
mod json;
mod kf;
mod mvf;
mod position;
mod run;
mod schedule;

use crate::error::BuildError;
use json::Json;
use std::path::Path;

/// What a file's vectors said.
#[derive(Clone, Debug, PartialEq)]
pub struct FileVerdict {
    /// The file.
    pub file: String,
    /// The kind of vectors, as the file names it.
    pub kind: String,
    /// One entry per compared quantity.
    pub quantities: Vec<Quantity>,
}

impl FileVerdict {
    /// Whether every quantity is within its tolerance.
    pub fn passed(&self) -> bool {
        !self.quantities.is_empty() && self.quantities.iter().all(Quantity::passed)
    }
}

/// One compared quantity.
#[derive(Clone, Debug, PartialEq)]
pub struct Quantity {
    /// Its name in the file.
    pub name: String,
    /// Worst deviation relative to the scale that the file's tolerance is stated for; infinite where one side has a value and the
    /// other has none, or one is not a number.
    pub worst: f64,
    /// The file's tolerance.
    pub tolerance: f64,
    /// Numbers compared.
    pub compared: usize,
}

impl Quantity {
    /// Whether the worst deviation is within the tolerance and anything was compared.
    pub fn passed(&self) -> bool {
        self.worst <= self.tolerance && self.compared > 0
    }
}

/// Runs the vectors of a file's text.
///
/// # Errors
/// [`BuildError`] when the text is not JSON, is of a kind that this version does not understand, or lacks what its kind needs.
pub fn verify(text: &str, file: &Path) -> Result<FileVerdict, BuildError> {
    let value: serde_json::Value = serde_json::from_str(text)
        .map_err(|e| BuildError::new(file, Some(e.line() as u64), None, format!("is not JSON: {e}")))?;
    let root = Json::root(file, &value);
    let named = |key: &str| root.value.get(key).and_then(|v| v.as_str()).map(str::to_owned);
    let (kind, quantities) = match (named("format"), named("schema"), named("kind")) {
        (Some(format), _, _) if format == "fms-golden-1" => (format, fms::quantities(&root)?),
        (_, Some(schema), Some(kind)) if schema == "fosb-golden/1" && kind == "fosb" => {
            (format!("{schema} {kind}"), fosb::runs(&root)?)
        }
        (_, Some(schema), Some(kind)) if schema == "fosb-golden/1" && kind == "fosb_literal_init" => {
            (format!("{schema} {kind}"), fosb::literal(&root)?)
        }
        (_, Some(schema), Some(kind)) if schema == "fosb-golden/1" && kind == "steady_state" => {
            (format!("{schema} {kind}"), fosb::steady_states(&root)?)
        }
        (_, Some(schema), Some(kind)) if schema == "fosb-golden/1" && kind == "statistics" => {
            (format!("{schema} {kind}"), fosb::statistics(&root)?)
        }
        (_, Some(schema), Some(kind)) if schema == "fosb-golden/1" && kind == "kf2_rts_lag1" => {
            (format!("{schema} {kind}"), kf::two_state(&root)?)
        }
        (_, Some(schema), Some(kind)) if schema == "fosb-golden/1" && kind == "kf4" => {
            (format!("{schema} {kind}"), kf::four_state(&root)?)
        }
        (_, Some(schema), Some(kind)) if schema == "fosb-golden/1" && kind == "lateration" => {
            (format!("{schema} {kind}"), position::laterations(&root)?)
        }
        (_, Some(schema), Some(kind)) if schema == "fosb-golden/1" && kind == "tdoa" => {
            (format!("{schema} {kind}"), position::time_differences(&root)?)
        }
        (_, Some(schema), Some(kind)) if schema == "fosb-golden/1" && kind == "rss_ml" => {
            (format!("{schema} {kind}"), position::likelihoods(&root)?)
        }
        (_, Some(schema), Some(kind)) if schema == "fosb-golden/1" && kind == "rss_to_range" => {
            (format!("{schema} {kind}"), position::distances(&root)?)
        }
        (_, None, Some(kind)) if kind == "linear" => (format!("mvf {kind}"), mvf::linear(&root)?),
        (_, None, Some(kind)) if kind == "emvf" => (format!("mvf {kind}"), mvf::extended(&root)?),
        (_, None, Some(kind)) if kind == "scheduler" => (format!("mvf {kind}"), schedule::closed_loops(&root)?),
        (_, None, Some(kind)) if kind == "ct" => (format!("mvf {kind}"), mvf::turn(&root)?),
        (format, schema, kind) => {
            let found: Vec<String> = [("format", format), ("schema", schema), ("kind", kind)]
                .into_iter()
                .filter_map(|(key, value)| value.map(|v| format!("{key} `{}`", shortened(&v))))
                .collect();
            let found = match found.as_slice() {
                [] => "names no format, schema or kind".to_owned(),
                named => format!("{} is not understood", named.join(", ")),
            };
            let what = format!(
                "{found}, expected format `fms-golden-1`, schema `fosb-golden/1` of kind `fosb`, `fosb_literal_init`, `steady_state`, \
                 `statistics`, `kf2_rts_lag1`, `kf4`, `lateration`, `tdoa`, `rss_ml` or `rss_to_range`, or kind `linear`, `emvf`, \
                 `scheduler` or `ct`"
            );
            return Err(BuildError::new(file, None, None, what));
        }
    };
    Ok(FileVerdict { file: file.display().to_string(), kind, quantities })
}

/// The start of a long text: some files explain themselves at length where a name is expected.
fn shortened(text: &str) -> String {
    const MOST: usize = 40;
    match text.char_indices().nth(MOST) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text.to_owned(),
    }
}

/// How a deviation is scaled.
#[derive(Clone, Copy)]
enum Scale {
    /// `|a − b| / max(1, |b|)`, each entry by itself.
    Entry,
    /// `|a − b| / max |b|` over the array.
    Array,
    /// `|a − b| / (|b| + absolute / relative)`: at most `relative` exactly when `|a − b| ≤ absolute + relative |b|`.
    Mixed {
        /// `absolute / relative`.
        floor: f64,
    },
}

/// Collects the worst deviation of one quantity.
struct Comparison {
    name: String,
    scale: Scale,
    tolerance: f64,
    pairs: Vec<(f64, f64)>,
    mismatched: bool,
}

impl Comparison {
    fn new(name: &str, scale: Scale, tolerance: f64) -> Self {
        Self { name: name.to_owned(), scale, tolerance, pairs: Vec::new(), mismatched: false }
    }

    /// Adds arrays of ours and of the file.
    fn add(&mut self, ours: &[f64], theirs: &[f64]) {
        self.mismatched |= ours.len() != theirs.len();
        self.pairs.extend(ours.iter().copied().zip(theirs.iter().copied()));
    }

    /// Adds an estimate that may be absent on either side.
    fn add_optional(&mut self, ours: Option<&[f64]>, theirs: Option<&[f64]>) {
        match (ours, theirs) {
            (Some(ours), Some(theirs)) => self.add(ours, theirs),
            (None, None) => {}
            _ => self.mismatched = true,
        }
    }

    fn done(self) -> Quantity {
        let largest = self.pairs.iter().fold(0.0_f64, |m, (_, b)| m.max(b.abs()));
        let mut worst: f64 = if self.mismatched { f64::INFINITY } else { 0.0 };
        for (ours, theirs) in &self.pairs {
            let scale = match self.scale {
                Scale::Entry => theirs.abs().max(1.0),
                Scale::Mixed { floor } => theirs.abs() + floor,
                Scale::Array if largest > 0.0 => largest,
                Scale::Array => 1.0,
            };
            let deviation = (ours - theirs).abs() / scale;
            worst = if deviation.is_nan() { f64::INFINITY } else { worst.max(deviation) };
        }
        Quantity { name: self.name, worst, tolerance: self.tolerance, compared: self.pairs.len() }
    }
}
