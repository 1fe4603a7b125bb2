//! `fixtrail demo`: a walk through a lossy network, tracked in several ways.

use crate::failure::Failure;
use crate::figures::percent;
use crate::output::{Results, say, table};
use crate::progress::Progress;
use crate::{scores, tables, whole};
use clap::Args;
use fixtrail_report::{Page, Series, render};
use fixtrail_sim::metrics::{Kind, Score};
use fixtrail_sim::scenario::{Demo, demo};
use fixtrail_track::pipeline::track;
use fixtrail_track::registry;
use fixtrail_track::spec::{self, Spec};
use fixtrail_track::target::TargetTrail;
use fixtrail_track::trackers::LaggedMode;
use serde_json::json;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Simulate a walk through a lossy network and track it with several estimators
#[derive(Args)]
#[command(after_help = "\
Examples:
  fixtrail demo
  fixtrail demo --seed 7 -o walk7

The folder also gets the data and a spec, so that `fixtrail track` can replay the run.")]
pub struct Arguments {
    /// Seed of all chance: equal seeds give equal bytes
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Folder for the report, the data and the spec
    #[arg(short, long, value_name = "DIR", default_value = "fixtrail-demo")]
    output: PathBuf,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// The spec of the demo, up to its estimator.
const SPEC: &str = "\
# The walk of `fixtrail demo`: ranges between a tag and six anchors, five rounds a second, a quarter of them lost.
version = 1

[model]
kind = \"constant-velocity\"
axes = 2
noise = 0.6             # how much a walker accelerates: power spectral density, m²/s³

[[sensor]]
kind = \"range\"
sd = 0.15               # of a range, metres
height_m = 1.0          # the tag is carried at this height, so the track is planar

[estimator]
";

/// A scenario that sends the walk through a worse network.
const NETWORK: &str = "\
# What a worse network would make of this walk: fixtrail simulate -c network.toml -o DIR
version = 1

[recording]
measurements = \"measurements.csv\"

[channel]
kind = \"gilbert-elliott\"   # losses in bursts
loss_rate = 0.3
mean_burst = 4.0
delay_s = [0.0, 2.0]       # what comes is up to 2 s late, and overtaken
duplication = 0.05         # and sometimes comes twice
duplication_lag_s = 1.0
";

/// One way to estimate the walk.
struct Contender {
    name: &'static str,
    about: &'static str,
    estimator: &'static str,
    mode: LaggedMode,
}

const CONTENDERS: [Contender; 5] = [
    Contender {
        name: "ekf",
        about: "now, given everything so far",
        estimator: "kind = \"ekf\"",
        mode: LaggedMode::Own,
    },
    Contender {
        name: "fms",
        about: "now, given the last 12 rounds only",
        estimator: "kind = \"fms\"\nwindow = 12",
        mode: LaggedMode::Own,
    },
    Contender {
        name: "fms, 4 rounds ago",
        about: "4 rounds ago, given the last 12 rounds only",
        estimator: "kind = \"fms\"\nwindow = 12\nlag = 4",
        mode: LaggedMode::Both,
    },
    Contender {
        name: "fixed-lag-kalman",
        about: "10 rounds ago, given everything so far",
        estimator: "kind = \"fixed-lag-kalman\"\nlag = 10",
        mode: LaggedMode::Own,
    },
    Contender {
        name: "rts",
        about: "any time, given the whole walk",
        estimator: "kind = \"rts\"",
        mode: LaggedMode::Own,
    },
];

/// What a contender made of the walk.
struct Run {
    contender: &'static Contender,
    spec: Spec,
    trails: Vec<TargetTrail>,
    score: Score,
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Bad`] when the folder cannot be written.
pub fn run(arguments: &Arguments) -> Result<ExitCode, Failure> {
    let folder = &arguments.output;
    fs::create_dir_all(folder).map_err(|e| Failure::unwritable(folder, &e))?;
    let files = ["report.html", "measurements.csv", "anchors.csv", "truth.csv", "spec.toml", "network.toml"]
        .map(|n| folder.join(n));
    files.iter().try_for_each(|path| whole::check(path))?;
    let [report, measurements, anchors, truth, spec, network] = &files;

    let walk = demo(arguments.seed);
    let bar = Progress::pieces(CONTENDERS.len() as u64, "tracking");
    let mut runs = Vec::new();
    for contender in &CONTENDERS {
        runs.push(contend(contender, &walk)?);
        bar.add(1);
    }
    drop(bar);

    whole::write(measurements, tables::measurements(&walk.packets, &walk.anchors).as_bytes())?;
    whole::write(anchors, tables::anchors(&walk.anchors).as_bytes())?;
    whole::write(truth, tables::truth(&walk.truth).as_bytes())?;
    whole::write(spec, spec_text(&CONTENDERS[0]).as_bytes())?;
    whole::write(network, NETWORK.as_bytes())?;
    whole::write(report, page(arguments.seed, &walk, &runs).as_bytes())?;

    if arguments.json {
        Results::Stdout.json(&json!({
            "seed": arguments.seed,
            "loss_rate": walk.loss_rate,
            "longest_burst": walk.longest_burst,
            "estimators": runs.iter().map(|run| {
                let mut row = scores::json_row(&run.score.overall);
                row["name"] = json!(run.contender.name);
                row["about"] = json!(run.contender.about);
                row
            }).collect::<Vec<_>>(),
            "files": files.iter().map(|p| p.to_string_lossy()).collect::<Vec<_>>(),
        }))?;
    } else {
        Results::Stdout.line(text(&walk, &runs))?;
    }
    say(format_args!(
        "\nOpen {} in a browser. Next, the same from files:\n  fixtrail track -c {} {} -o trail.csv --truth {}",
        report.display(),
        spec.display(),
        measurements.display(),
        truth.display()
    ));
    Ok(ExitCode::SUCCESS)
}

fn spec_text(contender: &Contender) -> String {
    format!("{SPEC}{}\n", contender.estimator)
}

fn contend(contender: &'static Contender, walk: &Demo) -> Result<Run, Failure> {
    let mut no_file = |_: &Path| Err(std::io::ErrorKind::NotFound.into());
    let spec = spec::parse(&spec_text(contender), Path::new("spec.toml"), &mut no_file)?;
    let failed = |e: &dyn std::fmt::Display| Failure::Run(format!("{}: {e}", contender.name));
    let trails = walk
        .packets
        .iter()
        .map(|target| track(&spec, &walk.anchors, target, contender.mode).map_err(|e| failed(&e)))
        .collect::<Result<Vec<_>, _>>()?;
    // Both: the row of a comparison is the smoother's half, the filter has a row of its own.
    let (trails, kind) = match contender.mode {
        LaggedMode::Both => (scores::smoothers(&trails), Kind::Smoother),
        LaggedMode::Own => (trails, scores::kind(&spec, contender.mode)),
    };
    let score = fixtrail_sim::metrics::judge(&spec, kind, &trails, &walk.truth).map_err(|e| failed(&e))?;
    Ok(Run { contender, spec, trails, score })
}

fn headline(walk: &Demo) -> String {
    format!(
        "A person walks {} s through a hall with {} anchors; the network lost {} of the reports, up to {} in a row.",
        fixtrail_sim::scenario::DURATION_S,
        walk.anchors.len(),
        percent(walk.loss_rate),
        walk.longest_burst
    )
}

fn text(walk: &Demo, runs: &[Run]) -> String {
    let rows: Vec<Vec<String>> = runs.iter().map(|run| scores::line(run.contender.name, &run.score.overall)).collect();
    let width = CONTENDERS.iter().map(|c| c.name.len()).max().unwrap_or(0);
    let verdicts: Vec<String> = runs
        .iter()
        .map(|run| {
            let (name, about) = (run.contender.name, run.contender.about);
            format!("  {name:width$}  {about}\n  {:width$}  {}", "", run.score.overall.verdict)
        })
        .collect();
    format!("{}\n\n{}\n\n{}", headline(walk), table(&scores::HEADER, &rows), verdicts.join("\n"))
}

fn page(seed: u64, walk: &Demo, runs: &[Run]) -> String {
    let series: Vec<Series<'_>> = runs
        .iter()
        .map(|run| Series { name: run.contender.name, trails: &run.trails, score: Some(&run.score) })
        .collect();
    let notes: Vec<String> =
        CONTENDERS.iter().map(|c| format!("{}: where the walker was {}.", c.name, c.about)).collect();
    render(&Page {
        title: "A walk through a lossy network",
        subtitle: &format!("{} Seed {seed}.", headline(walk)),
        notes: &notes,
        layout: &registry::layout(&runs[0].spec),
        series: &series,
        truth: &walk.truth,
        anchors: &walk.anchors,
        theory: None,
        packets: &walk.packets,
    })
}
