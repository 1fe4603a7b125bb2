//! `fixtrail reproduce`: what three papers print and state, and what comes of it here.

mod text;

use crate::failure::Failure;
use crate::output::{Results, say};
use crate::progress::Progress;
use crate::whole;
use clap::{Args, ValueEnum};
use fixtrail_report::render_reproduction;
use fixtrail_sim::papers::{Account, Effort, Paper};
use serde_json::json;
use std::path::PathBuf;
use std::process::ExitCode;

/// Run the experiments of a paper and hold its numbers and claims against them
#[derive(Args)]
#[command(after_help = "\
Examples:
  fixtrail reproduce fms --quick
  fixtrail reproduce all --report papers.html

fms   finite-memory filter and smoother (Kim 2019)
mvf   filters for multiple packet losses (Liu et al. 2010)
fosb  forward and one-step-backward tracking (Chiou et al. 2012)

Ours is a mean over experiments of the paper's own size with its standard error. A printed number is reproduced when it
is within three standard deviations of ours: those of one experiment, of our mean and of the printing.")]
pub struct Arguments {
    /// Which paper
    #[arg(value_enum)]
    paper: Which,
    /// How often each experiment of the paper's own size is run, 2 at least [default: as the paper needs]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..))]
    runs: Option<u32>,
    /// A look in seconds: fewer experiments, wider errors
    #[arg(long)]
    quick: bool,
    /// Seed of all chance: equal seeds give equal bytes
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Number of threads [default: one per processor]; the result does not depend on it
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Write a self-contained HTML page with our curves for every figure
    #[arg(long, value_name = "FILE.html")]
    report: Option<PathBuf>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Which {
    Fms,
    Mvf,
    Fosb,
    All,
}

impl Which {
    fn papers(self) -> &'static [Paper] {
        match self {
            Which::Fms => &[Paper::Fms],
            Which::Mvf => &[Paper::Mvf],
            Which::Fosb => &[Paper::Fosb],
            Which::All => &Paper::ALL,
        }
    }
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Bad`] when the report cannot be written.
pub fn run(arguments: &Arguments) -> Result<ExitCode, Failure> {
    if let Some(path) = &arguments.report {
        whole::check(path)?;
    }
    if let Some(threads) = arguments.threads {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads.into()).build_global();
        pool.map_err(|e| Failure::Run(format!("{threads} threads cannot be started: {e}")))?;
    }
    let effort = Effort { runs: arguments.runs.map(|n| n as usize), quick: arguments.quick, seed: arguments.seed };
    let papers = arguments.paper.papers();
    let bar = Progress::runs(papers.iter().map(|p| p.pieces(&effort) as u64).sum());
    let accounts: Vec<Account> = papers.iter().map(|p| p.account(&effort, &|| bar.add(1))).collect();
    drop(bar);
    if let Some(path) = &arguments.report {
        whole::write(path, render_reproduction(&accounts, &command(arguments)).as_bytes())?;
    }
    if arguments.json {
        Results::Stdout.json(&json!({
            "seed": arguments.seed,
            "quick": arguments.quick,
            "runs": arguments.runs,
            "papers": accounts.iter().map(text::json).collect::<Vec<_>>(),
        }))?;
    } else {
        Results::Stdout.line(accounts.iter().map(text::text).collect::<Vec<_>>().join("\n\n"))?;
    }
    if let Some(path) = &arguments.report {
        say(format_args!("{}: the report, opens in any browser", path.display()));
    }
    Ok(ExitCode::SUCCESS)
}

/// The command that gives the same numbers.
fn command(arguments: &Arguments) -> String {
    let mut out = format!(
        "fixtrail reproduce {}",
        arguments.paper.to_possible_value().map_or(String::new(), |v| v.get_name().to_owned())
    );
    if let Some(runs) = arguments.runs {
        out += &format!(" --runs {runs}");
    }
    if arguments.quick {
        out += " --quick";
    }
    out + &format!(" --seed {}", arguments.seed)
}
