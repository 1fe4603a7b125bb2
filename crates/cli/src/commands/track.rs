//! `fixtrail track`: measurements in, trail out.

mod link;
mod summary;

use crate::data::{Data, DataArguments, SpecText, Wanted, read_spec};
use crate::failure::Failure;
use crate::output::{Results, say};
use crate::progress::Progress;
use crate::runs::{self, Tracked};
use crate::{scores, whole};
use clap::{Args, ValueEnum};
use fixtrail_batch::{
    FileError, FileOutcome, FileRun, Input, Order, OutFormat, Output, Phase, Table, Totals, WriteError, WriteOptions,
    read_anchors, track_file, write_trails,
};
use fixtrail_report::{Page, Series, render};
use fixtrail_sim::metrics::Score;
use fixtrail_track::pipeline::TrackError;
use fixtrail_track::registry;
use fixtrail_track::survey::{self, Survey};
use fixtrail_track::target::TargetTrail;
use fixtrail_track::theory::{self, Source, Theory};
use fixtrail_track::trackers::LaggedMode;
use fixtrail_track::truth::TargetTruth;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;
use summary::Summary;

/// Turn measurements into trails with honest uncertainty
#[derive(Args)]
#[command(after_help = "\
Examples:
  fixtrail track measurements.csv -o trail.csv
  fixtrail track -c spec.toml measurements.csv -o trail.parquet --truth truth.csv --report report.html
  cat measurements.ndjson | fixtrail track -c spec.toml - --format ndjson -o - | head

Without a spec the one that `fixtrail check` would propose is used; --write-spec saves it.")]
pub struct Arguments {
    #[command(flatten)]
    data: DataArguments,
    /// The trail: .csv, .parquet, .ndjson or .geojson; `-` is standard output
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Known positions to compare with (t,target,x,y,z)
    #[arg(long, value_name = "FILE")]
    truth: Option<PathBuf>,
    /// Write a self-contained HTML page
    #[arg(long, value_name = "FILE.html")]
    report: Option<PathBuf>,
    /// Add the packed covariance to the trail
    #[arg(long)]
    covariance: bool,
    /// Filter and smoother side by side [default: the estimator's own rows]
    #[arg(long, value_enum)]
    lagged: Option<Lagged>,
    /// Order of the rows
    #[arg(long, value_enum, default_value = "target")]
    order: OrderName,
    /// Number of threads [default: one per processor]; the trail does not depend on it
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Lagged {
    /// Filter and smoother side by side
    Both,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum OrderName {
    /// By target, then time
    Target,
    /// By time, then target
    Time,
}

impl Arguments {
    fn mode(&self) -> LaggedMode {
        match self.lagged {
            None => LaggedMode::Own,
            Some(Lagged::Both) => LaggedMode::Both,
        }
    }

    fn destination(&self) -> Output {
        if self.output.as_os_str() == "-" { Output::Stdout } else { Output::File(self.output.clone()) }
    }

    fn write_options(&self, format: OutFormat) -> WriteOptions {
        let order = match self.order {
            OrderName::Target => Order::Target,
            OrderName::Time => Order::Time,
        };
        WriteOptions { covariance: self.covariance, order, format }
    }

    /// Where results go that are not the trail.
    fn results(&self) -> Results {
        if self.destination() == Output::Stdout { Results::Stderr } else { Results::Stdout }
    }

    /// Says of a large file what keeps it in memory, before it fills it.
    fn warn_of_memory(&self, has_spec: bool) {
        let Input::File(path) = self.data.input() else { return };
        let Ok(bytes) = std::fs::metadata(&path).map(|file| file.len()) else { return };
        if bytes < LARGE_INPUT {
            return;
        }
        let flags = [
            ("a run without `-c`", !has_spec),
            ("`--report`", self.report.is_some()),
            ("`--truth`", self.truth.is_some()),
            ("`--order time`", self.order == OrderName::Time),
        ];
        let causes: Vec<&str> = flags.into_iter().filter_map(|(name, is_set)| is_set.then_some(name)).collect();
        say(format_args!(
            "{}: {:.1} GB are kept in memory, where a table of text takes about twenty times that, for {}; `-c SPEC` alone takes a file of any size",
            path.display(),
            bytes as f64 * 1e-9,
            causes.join(" and "),
        ));
    }

    /// Finds out before the run what would stop it at its end.
    fn check_outputs(&self) -> Result<OutFormat, Failure> {
        let destination = self.destination();
        let format = OutFormat::of(&destination).map_err(|e| write_failure(e, &self.output))?;
        let mut outputs: Vec<(&str, &Path)> = Vec::new();
        if let Output::File(path) = &destination {
            outputs.push(("trail", path));
        }
        outputs.extend(self.report.as_deref().map(|p| ("report", p)));
        outputs.extend(self.data.write_spec.as_deref().map(|p| ("spec", p)));
        let mut inputs = self.data.files();
        inputs.extend(self.truth.as_deref().map(|p| ("truth", p)));
        whole::apart(&outputs, &inputs)?;
        outputs.iter().try_for_each(|(_, path)| whole::check(path))?;
        Ok(format)
    }
}

/// Bytes of input from which on it is said that the run keeps all of it.
const LARGE_INPUT: u64 = 200_000_000;

/// What the run made.
struct Outcome {
    trails: Vec<TargetTrail>,
    truth: Vec<TargetTruth>,
    score: Option<Score>,
    /// The smoother's comparison, when both stand side by side.
    smoother: Option<(Vec<TargetTrail>, Option<Score>)>,
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Bad`] for input or spec that cannot be used and outputs that cannot be written, [`Failure::Run`] when a step
/// cannot be taken.
pub fn run(arguments: &Arguments) -> Result<ExitCode, Failure> {
    let format = arguments.check_outputs()?;
    if let Some(threads) = arguments.threads {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads.into()).build_global();
        pool.map_err(|e| Failure::Run(format!("{threads} threads cannot be started: {e}")))?;
    }
    let started = Instant::now();
    let given = arguments.data.spec.as_deref().map(read_spec).transpose()?;
    let options = arguments.write_options(format);
    // A report, a comparison and an order by time need every trail at once; a proposal needs every row.
    let streams = arguments.report.is_none() && arguments.truth.is_none() && options.order == Order::Target;
    let given = match given {
        Some(spec) if streams => return stream(arguments, &spec, &options, started),
        given => given,
    };
    arguments.warn_of_memory(given.is_some());
    let Data { table, survey, spec, unused } = arguments.data.load_with(given, Wanted::Spec)?;
    let spec = spec.map_err(|why| arguments.data.no_spec(&why))?;
    check_mode(&spec, arguments.lagged)?;
    spec.try_build(&table.anchors, arguments.mode())?;
    let truth = match &arguments.truth {
        Some(path) => spec.truth(path, &table)?,
        None => Vec::new(),
    };
    arguments.data.announce(&spec);
    let outcome = track_all(arguments, &table, &spec, truth)?;

    let layout = registry::layout(&spec.spec);
    let page = arguments.report.as_ref().map(|_| {
        let theory = promise(&spec, &table, survey.as_ref());
        page(arguments, &table, &spec, &outcome, theory.as_ref())
    });
    write_trails(&arguments.destination(), &outcome.trails, &layout, &table, &options)
        .map_err(|e| write_failure(e, &arguments.output))?;
    if let (Some(path), Some(page)) = (&arguments.report, page) {
        whole::write(path, page.as_bytes())?;
    }
    if let Some(path) = &arguments.data.write_spec {
        whole::write(path, spec.text.as_bytes())?;
    }

    let packets = table.targets.iter().map(|t| t.packets.len() as u64).sum();
    let totals = Totals::of(&outcome.trails, packets);
    finish(&Summary {
        arguments,
        counts: &table.counts,
        origin: table.origin,
        survey: survey.as_ref(),
        spec: &spec,
        unused: &unused,
        totals: &totals,
        scores: [outcome.score.as_ref(), outcome.smoother.as_ref().and_then(|(_, score)| score.as_ref())],
        seconds: started.elapsed().as_secs_f64(),
    })
}

/// Tracks a file in bounded memory.
fn stream(
    arguments: &Arguments,
    spec: &SpecText,
    options: &WriteOptions,
    started: Instant,
) -> Result<ExitCode, Failure> {
    check_mode(spec, arguments.lagged)?;
    let input = arguments.data.input();
    let anchors = read_anchors(&input, arguments.data.anchors_table(Some(spec)).as_deref())?;
    spec.try_build(&anchors, arguments.mode())?;
    let (reading, tracking) = (Progress::bytes(), Progress::packets(0));
    let run = FileRun {
        input: &input,
        anchors: &anchors,
        read: &arguments.data.read_options(Some(&spec.spec)),
        spec: &spec.spec,
        lagged: arguments.mode(),
        output: &arguments.destination(),
        write: options,
    };
    let outcome = track_file(&run, &|phase, done, total| match phase {
        Phase::Reading => reading.set(done, total),
        Phase::Tracking => tracking.set(done, total),
    });
    drop((reading, tracking));
    let FileOutcome { counts, meta, totals } = outcome.map_err(|error| match error {
        FileError::Read(e) => e.into(),
        FileError::Track(TrackError::Build(e)) => spec.rename(e).into(),
        FileError::Track(e) => Failure::Run(format!("{}: {e}", arguments.data.input_name())),
        FileError::Write(e) => write_failure(e, &arguments.output),
        other => Failure::Run(other.to_string()),
    })?;
    finish(&Summary {
        arguments,
        counts: &counts,
        origin: meta.origin,
        survey: None,
        spec,
        unused: &counts.ignored_kinds,
        totals: &totals,
        scores: [None; 2],
        seconds: started.elapsed().as_secs_f64(),
    })
}

/// Says what was done.
fn finish(summary: &Summary<'_>) -> Result<ExitCode, Failure> {
    let arguments = summary.arguments;
    say(summary.text());
    if arguments.data.json {
        arguments.results().json(&summary.json())?;
    } else if let Some(scores) = summary.scores() {
        arguments.results().line(scores)?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Refuses `--lagged` where there is no smoother.
fn check_mode(spec: &SpecText, lagged: Option<Lagged>) -> Result<(), Failure> {
    let estimator = &spec.spec.estimator;
    if lagged.is_none() || estimator.has_smoother() {
        return Ok(());
    }
    Err(Failure::Bad(format!(
        "{}: `estimator.kind` is \"{}\", which has no smoother: `--lagged` expects \"rts\", \"fixed-lag-kalman\", \"fms\" \
         or \"fosb\"",
        spec.name().display(),
        estimator.name()
    )))
}

fn track_all(
    arguments: &Arguments,
    table: &Table,
    spec: &SpecText,
    truth: Vec<TargetTruth>,
) -> Result<Outcome, Failure> {
    let mode = arguments.mode();
    let bar = Progress::packets(table.targets.iter().map(|t| t.packets.len() as u64).sum());
    let Tracked { trails, .. } = runs::tracks(&arguments.data.input_name(), table, spec, mode, &bar)?;
    drop(bar);

    let judge = |kind, trails: &[TargetTrail]| match truth.is_empty() {
        true => Ok(None),
        false => fixtrail_sim::metrics::judge(&spec.spec, kind, trails, &truth).map(Some).map_err(|what| {
            let file = arguments.truth.as_deref().unwrap_or(Path::new("-"));
            Failure::Bad(format!("{}: {what}", file.display()))
        }),
    };
    let score = judge(scores::kind(&spec.spec, mode), &trails)?;
    let smoother = match mode {
        LaggedMode::Both => {
            let alone = scores::smoothers(&trails);
            let score = judge(fixtrail_sim::metrics::Kind::Smoother, &alone)?;
            Some((alone, score))
        }
        _ => None,
    };
    Ok(Outcome { trails, truth, score, smoother })
}

/// What theory says of the spec at the loss of the data; `None` where it says nothing.
fn promise(spec: &SpecText, table: &Table, survey: Option<&Survey>) -> Option<(Theory, Source)> {
    // A look at the data takes a while; a spec without a theory, at whatever interval and loss, needs none.
    theory::theory(&spec.spec, Some(1.0), 1.0).ok()?;
    let looked;
    let survey = match survey {
        Some(survey) => survey,
        None => {
            looked = survey::survey(&table.targets, &table.anchors);
            &looked
        }
    };
    theory::theory_for(&spec.spec, survey).ok()
}

fn page(
    arguments: &Arguments,
    table: &Table,
    spec: &SpecText,
    outcome: &Outcome,
    theory: Option<&(Theory, Source)>,
) -> String {
    let name = spec.spec.estimator.name();
    let smoother_name = format!("{name}, smoothed");
    let mut series = vec![Series { name, trails: &outcome.trails, score: outcome.score.as_ref() }];
    if let Some((trails, score)) = &outcome.smoother {
        series.push(Series { name: &smoother_name, trails, score: score.as_ref() });
    }
    let input = arguments.data.input_name();
    let subtitle = match &spec.path {
        Some(path) => format!("{name}, by the spec {}", path.display()),
        None => format!("{name}, by the spec that the data suggest"),
    };
    render(&Page {
        title: &input,
        subtitle: &subtitle,
        notes: &[],
        layout: &registry::layout(&spec.spec),
        series: &series,
        truth: &outcome.truth,
        anchors: &table.anchors,
        theory,
        packets: &table.targets,
    })
}

/// A trail that could not be written.
fn write_failure(error: WriteError, path: &Path) -> Failure {
    match error {
        WriteError::BrokenPipe { .. } => Failure::ReaderGone,
        WriteError::Io { source, .. } => Failure::unwritable(path, &source),
        // An estimate that is no number is our failure, not the user's.
        e @ WriteError::NotFinite { .. } => Failure::Run(e.to_string()),
        e => Failure::Bad(e.to_string()),
    }
}
