//! From the arguments to a spec and a table: what `track`, `check` and `compare` share.

use crate::failure::Failure;
use crate::figures::{counted, grouped};
use crate::output::say;
use crate::progress::Progress;
use clap::{Args, ValueEnum};
use fixtrail_batch::{Counts, Format, Input, LinearShape, ReadOptions, Table, read_table, read_truth};
use fixtrail_track::anchors::Anchors;
use fixtrail_track::error::BuildError;
use fixtrail_track::packet::Kind;
use fixtrail_track::registry::{self, BuildOptions};
use fixtrail_track::spec::{self, ArrivalSpec, ModelSpec, Receiver, Spec};
use fixtrail_track::survey::{Circumstances, Proposal, ProposeError, Survey, propose, survey};
use fixtrail_track::trackers::LaggedMode;
use fixtrail_track::truth::TargetTruth;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// Where measurements come from and how they are read.
#[derive(Args)]
pub struct DataArguments {
    /// Measurements: CSV, NDJSON or Parquet; `-` is standard input
    pub input: PathBuf,
    /// What moves, what measures, what estimates (TOML); without it the data decide
    #[arg(short = 'c', long = "config", value_name = "SPEC.toml")]
    pub spec: Option<PathBuf>,
    /// The anchors table [default: the spec's, else anchors.csv beside the input]
    #[arg(long, value_name = "FILE")]
    pub anchors: Option<PathBuf>,
    /// Format of the input, for standard input or an unusual file name
    #[arg(long, value_enum)]
    pub format: Option<FormatName>,
    /// Skip rows that cannot be understood instead of stopping at the first
    #[arg(long)]
    pub skip_bad_rows: bool,
    /// Save the proposed spec to FILE
    #[arg(long, value_name = "FILE", conflicts_with = "spec")]
    pub write_spec: Option<PathBuf>,
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

/// Names of the formats.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum FormatName {
    /// Comma-separated values
    Csv,
    /// One JSON object per line
    Ndjson,
    /// Apache Parquet
    Parquet,
}

impl From<FormatName> for Format {
    fn from(name: FormatName) -> Format {
        match name {
            FormatName::Csv => Format::Csv,
            FormatName::Ndjson => Format::Ndjson,
            FormatName::Parquet => Format::Parquet,
        }
    }
}

/// A spec with the text it was made from.
pub struct SpecText {
    /// The file it came from; `None` for a proposal.
    pub path: Option<PathBuf>,
    /// TOML.
    pub text: String,
    /// What it says.
    pub spec: Spec,
    /// Why a proposal is as it is, a line per choice, and what tuning would gain.
    pub reasons: Vec<String>,
}

impl SpecText {
    /// The name that messages use.
    pub fn name(&self) -> &Path {
        self.path.as_deref().unwrap_or(Path::new("proposed spec"))
    }

    /// Refuses a spec whose numbers make no estimator.
    ///
    /// # Errors
    /// [`Failure::Bad`] in the name of the spec.
    pub fn try_build(&self, anchors: &Anchors, lagged: LaggedMode) -> Result<(), Failure> {
        let built = registry::build(&self.spec, anchors, &BuildOptions { lagged });
        built.map(drop).map_err(|e| self.rename(e).into())
    }

    /// The truth in the table at `path`, if trails of this spec can be compared with it.
    ///
    /// # Errors
    /// [`Failure::Bad`] for a linear model, and for a table that cannot be understood.
    pub fn truth(&self, path: &Path, table: &Table) -> Result<Vec<TargetTruth>, Failure> {
        if registry::layout(&self.spec).is_linear() {
            return Err(Failure::Bad(format!(
                "{}: `model.kind` is \"linear\", `--truth` expects a model with positions",
                self.name().display()
            )));
        }
        Ok(read_truth(path, table)?)
    }

    /// An error of the spec in the name of its file.
    pub fn rename(&self, mut error: BuildError) -> BuildError {
        if error.place.file == Path::new("spec") {
            error.place.file = self.name().to_owned();
        }
        error
    }
}

/// What a command needs of its data besides the rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wanted {
    /// A spec: the data are surveyed only when one has to be proposed.
    Spec,
    /// A survey in any case.
    Survey,
}

/// Measurements, and the spec to track them with.
pub struct Data {
    /// The measurements.
    pub table: Table,
    /// What they look like, where that was asked for or a spec had to be proposed.
    pub survey: Option<Survey>,
    /// The user's spec, or the one that the survey proposes.
    pub spec: Result<SpecText, ProposeError>,
    /// Rows of a kind that the spec does not use.
    pub unused: BTreeMap<String, u64>,
}

impl DataArguments {
    /// The input.
    pub fn input(&self) -> Input {
        if self.input.as_os_str() == "-" { Input::Stdin } else { Input::File(self.input.clone()) }
    }

    /// The input's name, for messages and titles.
    pub fn input_name(&self) -> String {
        self.input().name().display().to_string()
    }

    /// Says which spec is used when the user gave none.
    pub fn announce(&self, spec: &SpecText) {
        if spec.path.is_some() {
            return;
        }
        match &self.write_spec {
            Some(path) => {
                say(format_args!("no spec given: using the one the data suggest, saved to {}", path.display()));
            }
            None => say("no spec given: using the one the data suggest (--write-spec FILE saves it)"),
        }
        spec.reasons.iter().for_each(|reason| say(format_args!("  {reason}")));
    }

    /// What was read, and what of it is not used, in a few lines.
    pub fn reading(&self, counts: &Counts, targets: u64, unused: &BTreeMap<String, u64>) -> Vec<String> {
        let mut lines = Vec::new();
        let mut read =
            format!("{}: {}, {}", self.input.display(), counted(counts.rows, "row"), counted(targets, "target"));
        if counts.duplicates > 0 {
            read += &format!(", {} dropped", counted(counts.duplicates, "duplicate"));
        }
        if counts.out_of_order > 0 {
            read += &format!(", {} out of order", grouped(counts.out_of_order));
        }
        lines.push(read);
        if counts.skipped_bad > 0 {
            let first = counts.first_bad.as_deref().unwrap_or_default();
            lines.push(format!("skipped {}, the first: {first}", counted(counts.skipped_bad, "bad row")));
        }
        if !unused.is_empty() {
            let kinds: Vec<String> =
                unused.iter().map(|(kind, n)| format!("{} of kind `{kind}`", counted(*n, "row"))).collect();
            lines.push(format!("not used, no sensor for them: {}", kinds.join(", ")));
        }
        if !counts.ignored_columns.is_empty() {
            lines.push(format!("columns not used: {}", counts.ignored_columns.join(", ")));
        }
        lines
    }

    /// Files that are read, for [`apart`](crate::whole::apart).
    pub fn files(&self) -> Vec<(&'static str, &Path)> {
        let mut files = vec![("input", self.input.as_path())];
        files.extend(self.spec.as_deref().map(|p| ("spec", p)));
        files.extend(self.anchors.as_deref().map(|p| ("anchors table", p)));
        files
    }

    /// Reads spec and measurements, and surveys them when that is `wanted` or there is no spec.
    ///
    /// # Errors
    /// [`Failure::Bad`] for anything in them that cannot be used.
    pub fn load(&self, wanted: Wanted) -> Result<Data, Failure> {
        let given = self.spec.as_deref().map(read_spec).transpose()?;
        self.load_with(given, wanted)
    }

    /// Where the anchors table is, if the user or the spec says so.
    pub fn anchors_table(&self, spec: Option<&SpecText>) -> Option<PathBuf> {
        self.anchors.clone().or_else(|| spec.and_then(spec_anchors))
    }

    /// As [`load`](Self::load), with a spec that has been read.
    ///
    /// # Errors
    /// [`Failure::Bad`] for anything that cannot be used.
    pub fn load_with(&self, given: Option<SpecText>, wanted: Wanted) -> Result<Data, Failure> {
        let options = self.read_options(given.as_ref().map(|s| &s.spec));
        let anchors = self.anchors_table(given.as_ref());
        let bar = Progress::bytes();
        let table = read_table(&self.input(), anchors.as_deref(), &options, &mut |done, total| bar.set(done, total))?;
        drop(bar);
        let look = || {
            survey(&table.targets, &table.anchors).with_table_counts(table.counts.duplicates, table.counts.out_of_order)
        };
        let mut unused = table.counts.ignored_kinds.clone();
        let (survey, spec) = match given {
            Some(given) => ((wanted == Wanted::Survey).then(look), Ok(given)),
            None => {
                let survey = look();
                let spec = self.propose(&survey, table.origin.is_some())?;
                if let Ok(spec) = &spec {
                    for kind in survey.kinds.iter().filter(|k| !spec.spec.uses(k.kind)) {
                        *unused.entry(kind.kind.name().to_owned()).or_default() += kind.rows;
                    }
                }
                (Some(survey), spec)
            }
        };
        Ok(Data { table, survey, spec, unused })
    }

    /// How the table is read.
    pub fn read_options(&self, spec: Option<&Spec>) -> ReadOptions {
        let mut options = ReadOptions {
            skip_bad_rows: self.skip_bad_rows,
            format: self.format.map(Format::from),
            ..ReadOptions::default()
        };
        let Some(spec) = spec else { return options };
        options.columns = spec.columns.clone();
        options.unstamped = matches!(spec.link.receiver, Receiver::Unstamped { .. });
        if let Some(ArrivalSpec::Column(name)) = &spec.link.arrival {
            options.arrival = Some(name.clone());
        }
        match &spec.model {
            ModelSpec::Linear(linear) => {
                options.linear = Some(LinearShape { q: linear.base.c.rows, p_u: linear.base.b.cols });
                options.default_kind = Some(Kind::Linear);
                options.kinds = Some(vec![Kind::Linear]);
            }
            _ => {
                if let [only] = spec.sensors.as_slice() {
                    options.default_kind = Some(only.kind);
                }
                options.kinds = Some(spec.sensors.iter().map(|s| s.kind).collect());
                options.latency_s = spec.sensors.iter().map(|s| (s.kind, s.latency_s)).collect();
            }
        }
        options
    }

    fn propose(&self, survey: &Survey, geodetic: bool) -> Result<Result<SpecText, ProposeError>, Failure> {
        // A spec may be saved anywhere, so it names the anchors from the root.
        let anchors = self.anchors.as_deref().map(|a| a.canonicalize().unwrap_or_else(|_| a.to_owned()));
        let anchors = anchors.as_ref().map(|a| a.to_string_lossy());
        let name = match self.input() {
            Input::Stdin => "standard input".into(),
            Input::File(path) => path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned(),
        };
        let circumstances = Circumstances { data: &name, geodetic, anchors: anchors.as_deref() };
        match propose(survey, &circumstances) {
            Err(why) => Ok(Err(why)),
            Ok(Proposal { text, mut reasons, tune }) => {
                let path = Path::new("proposed spec");
                let spec = spec::parse(&text, path, &mut |p| fs::read(p))?;
                reasons.push(tune);
                Ok(Ok(SpecText { path: None, text, spec, reasons }))
            }
        }
    }

    /// Why there is no spec, in the name of the input.
    pub fn no_spec(&self, why: &ProposeError) -> Failure {
        Failure::Bad(format!("{}: {why}", self.input.display()))
    }
}

/// Reads a spec.
///
/// # Errors
/// [`Failure::Bad`] with file, line and key.
pub fn read_spec(path: &Path) -> Result<SpecText, Failure> {
    let bytes = fs::read(path).map_err(|e| Failure::Bad(format!("{}: cannot be read: {e}", path.display())))?;
    let text = String::from_utf8(bytes).map_err(|e| {
        let good = &e.as_bytes()[..e.utf8_error().valid_up_to()];
        let line = 1 + good.iter().filter(|b| **b == b'\n').count() as u64;
        let byte = e.as_bytes()[good.len()];
        BuildError::new(path, Some(line), None, format!("has the byte 0x{byte:02x}, expected UTF-8 text"))
    })?;
    let spec = spec::parse(&text, path, &mut |p| fs::read(p))?;
    Ok(SpecText { path: Some(path.to_owned()), text, spec, reasons: Vec::new() })
}

/// The anchors table that a spec names, relative to the spec's folder.
fn spec_anchors(spec: &SpecText) -> Option<PathBuf> {
    let name = spec.spec.anchors.as_ref()?;
    Some(spec.path.as_deref().and_then(Path::parent).unwrap_or(Path::new("")).join(name))
}
