//! `fixtrail tune`: numbers of a spec from recordings.

use crate::data::{DataArguments, FormatName, SpecText, Wanted};
use crate::failure::Failure;
use crate::figures::short;
use crate::output::{Results, say};
use crate::progress::Progress;
use crate::whole;
use clap::Args;
use fixtrail_batch::Table;
use fixtrail_track::spec;
use fixtrail_tune::{Merit, Options, Recording, Tuned, tune, write};
use serde_json::json;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Estimate noise, biases, path loss, process noise, windows, lags and arrival rates from recordings
#[derive(Args)]
#[command(after_help = "\
Examples:
  fixtrail tune walk1.csv walk2.csv --truth truth1.csv --truth truth2.csv -o tuned.toml
  fixtrail tune -c spec.toml measurements.csv -o tuned.toml       without truth: by how well the next measurements are foretold
  fixtrail track -c tuned.toml walk3.csv -o trail.csv

Score the result on data that it was not tuned on.")]
pub struct Arguments {
    /// Measurements of one or more recordings: CSV, NDJSON or Parquet
    #[arg(required = true)]
    inputs: Vec<PathBuf>,
    /// What to start from (TOML); without it the spec that the first recording suggests
    #[arg(short = 'c', long = "config", value_name = "SPEC.toml")]
    spec: Option<PathBuf>,
    /// Known positions (t,target,x,y,z): one file for each input, in their order, or one for all
    #[arg(long, value_name = "FILE")]
    truth: Vec<PathBuf>,
    /// The tuned spec
    #[arg(short, long, value_name = "TUNED.toml")]
    output: PathBuf,
    /// The anchors table of all inputs [default: the spec's, else anchors.csv beside each input]
    #[arg(long, value_name = "FILE")]
    anchors: Option<PathBuf>,
    /// Use the first part of each recording only, a share from 0.01 to 1: the rest is left to score the result
    #[arg(long, value_name = "SHARE", default_value_t = 1.0, value_parser = share)]
    first: f64,
    /// Tune numbers only: the kind of motion, drift and the treatment of outliers stay
    #[arg(long)]
    keep_structure: bool,
    /// Format of the inputs, for unusual file names
    #[arg(long, value_enum)]
    format: Option<FormatName>,
    /// Skip rows that cannot be understood instead of stopping at the first
    #[arg(long)]
    skip_bad_rows: bool,
    /// Number of threads [default: one per processor]; the result does not depend on it
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

fn share(text: &str) -> Result<f64, String> {
    let valid = |v: &f64| (0.01..=1.0).contains(v);
    text.parse().ok().filter(valid).ok_or_else(|| "expected a number from 0.01 to 1".to_owned())
}

impl Arguments {
    /// As if `input` were tracked.
    fn data(&self, input: &Path, spec: Option<&Path>) -> DataArguments {
        DataArguments {
            input: input.to_owned(),
            spec: spec.map(Path::to_owned),
            anchors: self.anchors.clone(),
            format: self.format,
            skip_bad_rows: self.skip_bad_rows,
            write_spec: None,
            json: self.json,
        }
    }

    fn check(&self) -> Result<(), Failure> {
        if !matches!(self.truth.len(), 0 | 1) && self.truth.len() != self.inputs.len() {
            return Err(Failure::Bad(format!(
                "`--truth` is given {} times for {} inputs, expected once for each, or once for all",
                self.truth.len(),
                self.inputs.len()
            )));
        }
        if let Some(stdin) = self.inputs.iter().find(|p| p.as_os_str() == "-") {
            return Err(Failure::Bad(format!("`{}` is standard input, expected a file", stdin.display())));
        }
        let mut inputs: Vec<(&str, &Path)> = self.inputs.iter().map(|p| ("input", p.as_path())).collect();
        inputs.extend(self.truth.iter().map(|p| ("truth", p.as_path())));
        inputs.extend(self.spec.as_deref().map(|p| ("spec", p)));
        inputs.extend(self.anchors.as_deref().map(|p| ("anchors table", p)));
        whole::apart(&[("spec", &self.output)], &inputs)?;
        whole::check(&self.output)
    }
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Bad`] for input or spec that cannot be used and an output that cannot be written.
pub fn run(arguments: &Arguments) -> Result<ExitCode, Failure> {
    arguments.check()?;
    if let Some(threads) = arguments.threads {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads.into()).build_global();
        pool.map_err(|e| Failure::Run(format!("{threads} threads cannot be started: {e}")))?;
    }
    let (base, recordings) = load(arguments)?;
    let options = Options { keep_structure: arguments.keep_structure };
    let bar = Progress::open("tuning", "settings");
    let tuned = tune(&base.spec, &recordings, &options, &|n| bar.add(n));
    drop(bar);
    let tuned = tuned.map_err(|e| Failure::Bad(format!("{}: {e}", base.name().display())))?;
    let text = write(&base.text, &tuned, &source(arguments)).map_err(Failure::Run)?;
    // What the user will track with must read as what was found.
    spec::parse(&text, &arguments.output, &mut |p| fs::read(p))?;
    whole::write(&arguments.output, text.as_bytes())?;
    say(summary(arguments, &tuned));
    if arguments.json {
        Results::Stdout.json(&as_json(&tuned))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// The spec to start from and the recordings, read by it.
fn load(arguments: &Arguments) -> Result<(SpecText, Vec<Recording>), Failure> {
    let mut base: Option<SpecText> = None;
    let mut recordings = Vec::new();
    for (i, input) in arguments.inputs.iter().enumerate() {
        let data = arguments.data(input, arguments.spec.as_deref());
        let loaded = data.load(Wanted::Spec)?;
        let spec = loaded.spec.map_err(|why| data.no_spec(&why))?;
        spec.try_build(&loaded.table.anchors, fixtrail_track::trackers::LaggedMode::Own)?;
        let truth = arguments.truth.get(if arguments.truth.len() == 1 { 0 } else { i });
        let truth = truth.map(|path| spec.truth(path, &loaded.table)).transpose()?.unwrap_or_default();
        if base.is_none() {
            data.announce(&spec);
        }
        let base = base.get_or_insert(spec);
        recordings.push(recording(input, loaded.table, truth, base, arguments.first));
    }
    let base = base.ok_or_else(|| Failure::Bad("no input".to_owned()))?;
    Ok((base, recordings))
}

fn recording(
    input: &Path,
    table: Table,
    mut truth: Vec<fixtrail_track::truth::TargetTruth>,
    base: &SpecText,
    share: f64,
) -> Recording {
    let mut targets = table.targets;
    for target in &mut targets {
        target.packets.retain(|p| base.spec.uses(p.content.kind()));
    }
    targets.retain(|t| !t.packets.is_empty());
    if share < 1.0 {
        let times = || targets.iter().flat_map(|t| t.packets.iter().map(|p| p.t_s));
        let (first, last) = (times().fold(f64::INFINITY, f64::min), times().fold(f64::NEG_INFINITY, f64::max));
        let end = first + share * (last - first);
        targets.iter_mut().for_each(|t| t.packets.retain(|p| p.t_s < end));
        truth.iter_mut().for_each(|t| t.points.retain(|p| p.t_s < end));
    }
    Recording { name: input.display().to_string(), anchors: table.anchors, targets, truth }
}

fn source(arguments: &Arguments) -> String {
    let names: Vec<_> = arguments
        .inputs
        .iter()
        .map(|p| p.iter().rev().take(2).collect::<Vec<_>>())
        .map(|mut n| {
            n.reverse();
            n.iter().map(|s| s.to_string_lossy()).collect::<Vec<_>>().join("/")
        })
        .collect();
    let share =
        if arguments.first < 1.0 { format!(", the first {} of each", short(arguments.first)) } else { String::new() };
    let truth = if arguments.truth.is_empty() { "without truth" } else { "with truth" };
    format!("{}{share}, {truth}", names.join(", ")).replace(['\n', '\r'], " ")
}

fn merit_text(merit: &Merit) -> String {
    match (merit.rmse_m, merit.innovation) {
        (Some(rmse), _) => format!("{} m RMSE, score {:.3}", short(rmse), merit.score),
        (None, Some(innovation)) => {
            format!("innovations {} times as large as claimed, score {:.3}", short(innovation), merit.score)
        }
        _ => format!("score {:.3}", merit.score),
    }
}

/// Fewer independent errors than this leave the widths open by more than Student's factor of 1.15.
const FEW_ERRORS: f64 = 10.0;

fn summary(arguments: &Arguments, tuned: &Tuned) -> String {
    let mut out = format!("before: {}\nafter:  {}\n", merit_text(&tuned.before), merit_text(&tuned.after));
    for tried in &tuned.structures {
        let verdict = if tried.taken { "taken" } else { "not taken" };
        out += &format!("{}: {}, {verdict}\n", tried.change.name(), tried.gain_text());
    }
    if let Some(arrival) = &tuned.arrival {
        out += &format!("arrival rate {} ± {}\n", short(arrival.rate), short(arrival.sd));
    }
    if let Some((_, honesty)) = tuned.honesty.filter(|(_, honesty)| honesty.independent < FEW_ERRORS) {
        out += &format!(
            "the claimed widths rest on {:.0} independent errors: elsewhere the 95 % ellipse may hold far less; tune on more recordings with \
             truth, or longer ones\n",
            honesty.independent
        );
    }
    out + &format!("{}: tuned in {} runs", arguments.output.display(), tuned.runs)
}

fn as_json(tuned: &Tuned) -> serde_json::Value {
    let merit = |m: &Merit| json!({ "score": m.score, "rmse_m": m.rmse_m, "innovation": m.innovation });
    json!({
        "before": merit(&tuned.before),
        "after": merit(&tuned.after),
        "with_truth": tuned.with_truth,
        "changes": tuned.structures.iter().map(|t| json!({
            "change": t.change.name(), "gain": t.gain, "standard_error": t.error, "taken": t.taken,
        })).collect::<Vec<_>>(),
        "widths": tuned.honesty.map(|(scale, honesty)| json!({
            "scale": scale, "coverage95": honesty.coverage, "independent_errors": honesty.independent,
        })),
        "arrival": tuned.arrival.map(|a| json!({ "rate": a.rate, "standard_error": a.sd, "values": a.values })),
        "runs": tuned.runs,
    })
}
