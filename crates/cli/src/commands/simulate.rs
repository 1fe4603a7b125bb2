//! `fixtrail simulate`: targets, a channel and estimators from a scenario; or a recording sent through a channel.

mod rows;
mod text;

use crate::failure::Failure;
use crate::output::{Results, say};
use crate::progress::Progress;
use crate::{tables, whole};
use clap::Args;
use fixtrail_batch::{Input, OutFormat, Output, ReadOptions, read_packet_trace, read_table, write_plain};
use fixtrail_report::{Channel, Simulation, render_simulation};
use fixtrail_sim::channels::Variant;
use fixtrail_sim::monte_carlo::{Outcome, ScenarioError, World as Run, informed, outcome};
use fixtrail_sim::replay::{Replay, replay};
use fixtrail_sim::scheduling::{Scheduled, scheduled};
use fixtrail_track::packet::{Content, Packet};
use fixtrail_track::registry;
use fixtrail_track::spec::{ChannelSpec, LossSpec, Recorded, Scenario, Simulated, World, parse_scenario};
use fixtrail_track::target::TargetPackets;
use fixtrail_track::trace::TracePacket;
use fixtrail_track::truth::{TargetTruth, TruthPoint};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;

/// Simulate targets behind a channel, or send a recording through one
#[derive(Args)]
#[command(after_help = "\
Examples:
  fixtrail simulate -c scenario.toml                 compares the scenario's contenders over its runs
  fixtrail simulate -c scenario.toml -o DIR          writes measurements.csv, truth.csv, anchors.csv of one run
  fixtrail simulate -c scenario.toml --runs 50 --json
  fixtrail simulate -c scenario.toml --results runs.parquet --report report.html

docs/scenario.md has every key of a scenario; examples/ has some. Results are the same on any number of threads.")]
pub struct Arguments {
    /// The scenario (TOML)
    #[arg(short = 'c', long = "config", value_name = "SCENARIO.toml")]
    scenario: PathBuf,
    /// Folder for the tables of the first run, or of the recording as it arrived
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Number of runs [default: the scenario's]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    runs: Option<u32>,
    /// Seed of all chance [default: the scenario's, else 1]
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Number of threads [default: one per processor]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// File for the results of each run and contender (.csv, .parquet, .ndjson)
    #[arg(long, value_name = "FILE")]
    results: Option<PathBuf>,
    /// File for a page with tables, verdicts and charts
    #[arg(long, value_name = "R.html")]
    report: Option<PathBuf>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// One channel's results.
pub struct Table {
    /// Loss rate of the channel.
    pub loss_rate: f64,
    /// What the runs say.
    pub outcome: Outcome,
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Bad`] for a scenario that cannot be used and outputs that cannot be written.
pub fn run(arguments: &Arguments) -> Result<ExitCode, Failure> {
    let path = &arguments.scenario;
    let text =
        fs::read_to_string(path).map_err(|e| Failure::Bad(format!("{}: cannot be read: {e}", path.display())))?;
    let scenario = parse_scenario(&text, path, &mut |p| fs::read(p))?;
    if let Some(threads) = arguments.threads {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads.into()).build_global();
        pool.map_err(|e| Failure::Run(format!("{threads} threads cannot be started: {e}")))?;
    }
    let seed = arguments.seed.unwrap_or(scenario.seed);
    match &scenario.world {
        World::Simulated(world) => simulate(arguments, world, &scenario, seed),
        World::Recorded(recorded) => resend(arguments, recorded, &scenario, seed),
    }
}

/// A file that a scenario names, relative to its folder.
fn beside(arguments: &Arguments, name: &str) -> PathBuf {
    arguments.scenario.parent().unwrap_or(Path::new("")).join(name)
}

fn variants(arguments: &Arguments, channel: &ChannelSpec, interval_s: f64) -> Result<Vec<Variant>, Failure> {
    let trace = match &channel.loss {
        LossSpec::Trace { file, link } => Some(trace(&beside(arguments, file), link.as_deref())?),
        _ => None,
    };
    Variant::all(channel, interval_s, trace).map_err(|e| bad(arguments, "channel", &e))
}

/// The packets of one link of a trace, or of all.
fn trace(path: &Path, link: Option<&str>) -> Result<Arc<[TracePacket]>, Failure> {
    let links = read_packet_trace(path)?;
    let Some(wanted) = link else { return Ok(links.into_iter().flat_map(|l| l.packets).collect()) };
    let names: Vec<String> = links.iter().take(12).map(|l| format!("`{}`", l.link)).collect();
    let found = links.into_iter().find(|l| l.link == wanted);
    let found = found.ok_or_else(|| {
        Failure::Bad(format!("{}: has no link `{wanted}`, expected one of {}", path.display(), names.join(", ")))
    })?;
    Ok(found.packets.into())
}

fn bad(arguments: &Arguments, key: &str, why: &dyn std::fmt::Display) -> Failure {
    Failure::Bad(format!("{}: `{key}`: {why}", arguments.scenario.display()))
}

/// Makes the folder and returns its files of these names.
fn files<const N: usize>(folder: &Path, names: [&str; N]) -> Result<[PathBuf; N], Failure> {
    fs::create_dir_all(folder).map_err(|e| Failure::unwritable(folder, &e))?;
    let files = names.map(|name| folder.join(name));
    files.iter().try_for_each(|path| whole::check(path))?;
    Ok(files)
}

fn simulate(arguments: &Arguments, world: &Simulated, scenario: &Scenario, seed: u64) -> Result<ExitCode, Failure> {
    let mut world = world.clone();
    world.runs = arguments.runs.map_or(world.runs, |runs| runs as usize);
    if world.contenders.is_empty() && arguments.output.is_none() {
        return Err(bad(
            arguments,
            "contender",
            &"is missing, expected tables `[[contender]]`, or `-o DIR` for data alone",
        ));
    }
    let format = writable(arguments, &world)?;
    let variants = variants(arguments, &scenario.channel, world.interval_s)?;
    let failed = |e: ScenarioError| match e {
        ScenarioError::Channel(e) => bad(arguments, "channel", &e),
        ScenarioError::Build(e) => bad(arguments, e.place.key.as_deref().unwrap_or("model"), &e.what),
    };
    match (&arguments.output, world.contenders.first().map(|first| (first, first.schedule.as_ref()))) {
        (Some(folder), Some((first, Some(schedule)))) => {
            let run = scheduled(&world, &informed(first, &variants[0]), schedule, &variants[0], seed, 0);
            write_scheduled(folder, &run.map_err(failed)?)?;
        }
        (Some(_), None) if world.schedule.is_some() => {
            return Err(bad(
                arguments,
                "contender",
                &"is missing, expected a table `[[contender]]` whose estimates the sensors are chosen by",
            ));
        }
        (Some(folder), _) => {
            let run = Run::new(&world, &variants[0], seed, 0).map_err(failed)?;
            write_run(folder, &world, scenario, &run)?;
        }
        _ => {}
    }
    if world.contenders.is_empty() {
        return Ok(ExitCode::SUCCESS);
    }
    let bar = Progress::runs((world.runs * variants.len()) as u64);
    let mut results = Vec::new();
    for variant in &variants {
        let outcome = outcome(&world, variant, seed, &|| bar.add(1)).map_err(failed)?;
        if let Some(blind) = outcome.contenders.iter().find(|c| c.energy_mj.is_some_and(|e| e.mean == 0.0)) {
            let what = format!(
                "leaves the target of `{}` out of range of all sensors in all {} runs, expected a longer range or more sensors in the `field`",
                blind.name, world.runs
            );
            return Err(bad(arguments, "schedule.range_m", &what));
        }
        results.push(Table { loss_rate: variant.loss_rate, outcome });
    }
    drop(bar);
    if let (Some(path), Some(format)) = (&arguments.results, format) {
        write_plain(&Output::File(path.clone()), &rows::table(&results), format)
            .map_err(|e| Failure::Bad(e.to_string()))?;
        say(format_args!("wrote one row for each run and contender to {}", path.display()));
    }
    if let Some(path) = &arguments.report {
        whole::write(path, page(arguments, &world, seed, &results).as_bytes())?;
        say(format_args!("wrote the report to {}, it opens in any browser", path.display()));
    }
    match arguments.json {
        true => Results::Stdout.json(&text::json(&world, seed, &results))?,
        false => Results::Stdout.line(text::report(&world, seed, &results))?,
    }
    Ok(ExitCode::SUCCESS)
}

/// Finds out before a long run whether its outputs can be written; the format of the results.
fn writable(arguments: &Arguments, world: &Simulated) -> Result<Option<OutFormat>, Failure> {
    let outputs = [("results", &arguments.results), ("report", &arguments.report)];
    let outputs: Vec<(&str, &Path)> =
        outputs.into_iter().filter_map(|(role, path)| Some((role, path.as_deref()?))).collect();
    if let (true, Some((role, path))) = (world.contenders.is_empty(), outputs.first()) {
        return Err(bad(
            arguments,
            "contender",
            &format_args!("is missing, expected tables `[[contender]]` for the {role} in {}", path.display()),
        ));
    }
    whole::apart(&outputs, &[("scenario", &arguments.scenario)])?;
    let Some(path) = &arguments.results else {
        outputs.iter().try_for_each(|(_, path)| whole::check(path))?;
        return Ok(None);
    };
    let format = OutFormat::of(&Output::File(path.clone())).map_err(|e| Failure::Bad(e.to_string()));
    let format = format.ok().filter(|format| *format != OutFormat::GeoJson).ok_or_else(|| {
        Failure::Bad(format!(
            "{}: is no name for results of runs, expected one that ends in `.csv`, `.parquet` or `.ndjson`",
            path.display()
        ))
    })?;
    outputs.iter().try_for_each(|(_, path)| whole::check(path))?;
    Ok(Some(format))
}

/// The report.
fn page(arguments: &Arguments, world: &Simulated, seed: u64, results: &[Table]) -> String {
    let name = arguments.scenario.file_stem().map_or("scenario".into(), |name| name.to_string_lossy());
    let channels: Vec<Channel<'_>> =
        results.iter().map(|t| Channel { loss_rate: t.loss_rate, outcome: &t.outcome }).collect();
    render_simulation(&Simulation { title: &name, world, seed, channels: &channels })
}

fn write_run(folder: &Path, world: &Simulated, scenario: &Scenario, run: &Run<'_>) -> Result<(), Failure> {
    let [measurements, truth, anchors, held] =
        files(folder, ["measurements.csv", "truth.csv", "anchors.csv", "held.csv"])?;
    let layout = registry::layout(&world.truth);
    let target = (!layout.is_linear()).then(|| "T".to_owned());
    let table = |packets| tables::measurements(&[TargetPackets { target: target.clone(), packets }], &run.anchors);
    whole::write(&measurements, table(run.received()).as_bytes())?;
    whole::write(&held, table(run.held(scenario.channel.shows)).as_bytes())?;
    let text = if layout.is_linear() {
        tables::states(&run.states)
    } else {
        let point = |(k, x): (usize, &Vec<f64>)| TruthPoint {
            t_s: k as f64 * world.interval_s,
            position_m: std::array::from_fn(|axis| (axis < layout.axes).then(|| x[axis])),
        };
        tables::truth(&[TargetTruth {
            target: target.clone(),
            points: run.states.iter().enumerate().map(point).collect(),
        }])
    };
    whole::write(&truth, text.as_bytes())?;
    if !run.anchors.is_empty() {
        whole::write(&anchors, tables::anchors(&run.anchors).as_bytes())?;
    }
    say(format_args!("wrote measurements.csv, held.csv and truth.csv of the first run to {}", folder.display()));
    Ok(())
}

/// What the first contender's sensors measured and what of it arrived, and where the target was at those instants.
fn write_scheduled(folder: &Path, run: &Scheduled) -> Result<(), Failure> {
    let [measurements, truth, anchors] = files(folder, ["measurements.csv", "truth.csv", "anchors.csv"])?;
    let target = Some("T".to_owned());
    let packets = run.taken.iter().filter(|t| t.arrived).filter_map(|t| {
        let content = Content::Range { anchor: t.plan.chosen?.sensor as u32, value_m: t.measured_m? };
        let (seq, received_s) = (Some(t.k), Some(t.t_s));
        Some(Packet { t_s: t.t_s, k: None, content, sd: None, seq, received_s, arrival: None, line: t.k })
    });
    let packets = TargetPackets { target: target.clone(), packets: packets.collect() };
    whole::write(&measurements, tables::measurements(&[packets], &run.anchors).as_bytes())?;
    let times = std::iter::once(0.0).chain(run.taken.iter().map(|t| t.t_s));
    let point = |(t_s, x): (f64, &Vec<f64>)| TruthPoint { t_s, position_m: [Some(x[0]), Some(x[1]), None] };
    let points = times.zip(&run.states).map(point).collect();
    whole::write(&truth, tables::truth(&[TargetTruth { target, points }]).as_bytes())?;
    whole::write(&anchors, tables::anchors(&run.anchors).as_bytes())?;
    say(format_args!("wrote measurements.csv, truth.csv and anchors.csv of the first run to {}", folder.display()));
    Ok(())
}

fn resend(arguments: &Arguments, recorded: &Recorded, scenario: &Scenario, seed: u64) -> Result<ExitCode, Failure> {
    let Some(folder) = &arguments.output else {
        return Err(Failure::Bad("a recording needs `-o DIR` for what arrives of it".to_owned()));
    };
    if let Some(path) = arguments.results.as_ref().or(arguments.report.as_ref()) {
        return Err(Failure::Bad(format!(
            "{}: nothing is estimated of a recording, expected no `--results` and no `--report`",
            path.display()
        )));
    }
    if let Some(runs) = arguments.runs {
        return Err(Failure::Bad(format!(
            "`--runs {runs}`: a recording is sent once, expected no `--runs` (`--seed` changes chance)"
        )));
    }
    let input = Input::File(beside(arguments, &recorded.measurements));
    let bar = Progress::bytes();
    let table = read_table(&input, None, &ReadOptions::default(), &mut |done, total| bar.set(done, total))?;
    drop(bar);
    let variants = variants(arguments, &scenario.channel, 1.0)?;
    if variants.len() > 1 {
        return Err(bad(arguments, "channel.loss_rate", &"is a list, expected one number for a recording"));
    }
    if table.origin.is_some() {
        return Err(bad(arguments, "recording.measurements", &"has latitudes and longitudes, expected local metres"));
    }
    let [measurements, anchors] = files(folder, ["measurements.csv", "anchors.csv"])?;
    whole::apart(&[("measurements", &measurements)], &[("recording", input.name())])?;
    let sent = replay(&table.targets, recorded.per, &variants[0], seed).map_err(|e| bad(arguments, "channel", &e))?;
    whole::write(&measurements, tables::measurements(&sent.targets, &table.anchors).as_bytes())?;
    if !table.anchors.is_empty() {
        whole::write(&anchors, tables::anchors(&table.anchors).as_bytes())?;
    }
    let Replay { sent: packets, lost, longest_burst, .. } = sent;
    match arguments.json {
        true => Results::Stdout.json(&serde_json::json!({
            "seed": seed, "packets": packets, "lost": lost, "longest_burst": longest_burst,
            "loss_rate": lost as f64 / (packets as f64).max(1.0),
        }))?,
        false => Results::Stdout.line(text::replayed(packets, lost, longest_burst, folder))?,
    }
    Ok(ExitCode::SUCCESS)
}
