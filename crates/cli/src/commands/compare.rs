//! `fixtrail compare`: several estimators on the same data.

mod contenders;
mod entries;
mod text;
mod verdict;

use crate::data::{Data, DataArguments, SpecText, Wanted};
use crate::failure::Failure;
use crate::figures::counted;
use crate::output::{Results, say};
use crate::progress::Progress;
use crate::whole;
use clap::Args;
use contenders::contenders;
use entries::{Entry, Measure, entries};
use fixtrail_batch::{Table, TimeForm};
use fixtrail_report::{Comparison, Page, Series, render_comparison};
use fixtrail_track::registry;
use fixtrail_track::spec::Receiver;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use verdict::Verdict;

/// Compare estimators on the same measurements, against truth or by how well they foretell
#[derive(Args)]
#[command(after_help = "\
Examples:
  fixtrail compare measurements.csv
  fixtrail compare -c spec.toml measurements.csv --truth truth.csv --report compare.html
  fixtrail compare -c spec.toml measurements.csv --estimators ekf,fms:window=15,lag=5,fixed-lag-kalman:lag=5

An estimator is written as its `kind`, a colon and the other keys of [estimator]. What is left out comes from the
spec if that has the same kind. `fixtrail list estimators` has the kinds.

Without truth every measurement is foretold from the last estimate before it. The score is the mean log density of
what came: larger is better. A smoother is judged by its filter then, as its own estimates have seen the data.")]
pub struct Arguments {
    #[command(flatten)]
    data: DataArguments,
    /// What to compare [default: the spec's estimator and those that suit model, sensors and link]
    #[arg(long, value_name = "A,B,…")]
    estimators: Option<String>,
    /// Known positions to compare with (t,target,x,y,z)
    #[arg(long, value_name = "FILE")]
    truth: Option<PathBuf>,
    /// Write a self-contained HTML page
    #[arg(long, value_name = "FILE.html")]
    report: Option<PathBuf>,
}

impl Arguments {
    /// Finds out before the run what would stop it at its end.
    fn check_outputs(&self) -> Result<(), Failure> {
        let mut outputs: Vec<(&str, &Path)> = Vec::new();
        outputs.extend(self.report.as_deref().map(|p| ("report", p)));
        outputs.extend(self.data.write_spec.as_deref().map(|p| ("spec", p)));
        let mut inputs = self.data.files();
        inputs.extend(self.truth.as_deref().map(|p| ("truth", p)));
        whole::apart(&outputs, &inputs)?;
        outputs.iter().try_for_each(|(_, path)| whole::check(path))
    }
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Bad`] for input, spec or estimators that cannot be used and outputs that cannot be written, [`Failure::Run`] when a step
/// cannot be taken.
pub fn run(arguments: &Arguments) -> Result<ExitCode, Failure> {
    arguments.check_outputs()?;
    let Data { table, spec, unused, .. } = arguments.data.load(Wanted::Spec)?;
    let spec = spec.map_err(|why| arguments.data.no_spec(&why))?;
    let truth =
        arguments.truth.as_deref().map(|path| Ok::<_, Failure>((path, spec.truth(path, &table)?))).transpose()?;
    let measure = truth.as_ref().map_or(Measure::Prediction, |(path, truth)| Measure::Truth { path, truth });
    if let (Measure::Prediction, Receiver::Unstamped { .. }) = (measure, spec.spec.link.receiver) {
        return Err(Failure::Bad(format!(
            "{}: `link.stamped` is false, so that nobody knows which values are new: expected `--truth` to compare with",
            spec.name().display()
        )));
    }
    let specs = contenders(arguments.estimators.as_deref(), &spec, &table, measure)?;
    arguments.data.announce(&spec);

    let rows: u64 = table.targets.iter().map(|t| t.packets.len() as u64).sum();
    let bar = Progress::packets(rows * specs.len() as u64);
    let mut all = Vec::new();
    for spec in &specs {
        all.extend(entries(&arguments.data.input_name(), &table, spec, measure, &bar)?);
    }
    drop(bar);
    let verdict =
        Verdict::of(&all, measure, table.time == TimeForm::Index).ok_or_else(|| nothing(arguments, measure))?;

    if let Some(path) = &arguments.report {
        whole::write(path, page(arguments, &table, &spec, &all, measure, &verdict).as_bytes())?;
    }
    if let Some(path) = &arguments.data.write_spec {
        whole::write(path, spec.text.as_bytes())?;
    }
    let mut lines = arguments.data.reading(&table.counts, table.targets.len() as u64, &unused);
    if let Some(path) = &arguments.report {
        lines.push(format!("{}: the report, opens in any browser", path.display()));
    }
    say(lines.join("\n"));
    if arguments.data.json {
        Results::Stdout.json(&text::json(arguments, &table, &spec, &all, measure, &verdict))?;
    } else {
        Results::Stdout.line(text::text(&all, measure, &verdict))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Why no estimator can be judged.
fn nothing(arguments: &Arguments, measure: Measure<'_>) -> Failure {
    Failure::Bad(match measure {
        Measure::Truth { path, .. } => {
            format!(
                "{}: has no instant at which every estimator has an estimate, expected one at least",
                path.display()
            )
        }
        Measure::Prediction => format!(
            "{}: has no measurement after every estimator's first estimate, expected more to judge them by",
            arguments.data.input_name()
        ),
    })
}

fn page(
    arguments: &Arguments,
    table: &Table,
    spec: &SpecText,
    all: &[Entry],
    measure: Measure<'_>,
    verdict: &Verdict,
) -> String {
    let series: Vec<Series<'_>> =
        all.iter().map(|e| Series { name: &e.name, trails: &e.trails, score: e.score.as_ref() }).collect();
    let entries: Vec<fixtrail_report::Entry<'_>> = all
        .iter()
        .enumerate()
        .map(|(i, e)| fixtrail_report::Entry {
            note: e.note(),
            best: verdict.is_best(i),
            us_per_instant: e.us_per_instant(),
            foretold: e.foretold.as_ref(),
            losses: &e.losses,
        })
        .collect();
    let by = match &spec.path {
        Some(path) => format!("by the spec {}", path.display()),
        None => "by the spec that the data suggest".to_owned(),
    };
    let against = match measure {
        Measure::Truth { .. } => "against truth",
        Measure::Prediction => "by how well they foretell the next measurements",
    };
    let n = all.len() as u64;
    let title = "Estimators compared";
    let page = Page {
        title,
        subtitle: &format!("{}: {} compared {against}, {by}", arguments.data.input_name(), counted(n, "estimator")),
        notes: &[],
        layout: &registry::layout(&spec.spec),
        series: &series,
        truth: match measure {
            Measure::Truth { truth, .. } => truth,
            Measure::Prediction => &[],
        },
        anchors: &table.anchors,
        theory: None,
        packets: &table.targets,
    };
    render_comparison(&page, &Comparison { entries: &entries, sentences: &verdict.sentences })
}
