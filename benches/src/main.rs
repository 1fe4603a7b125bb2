//! Times Fixtrail beside its peers: same input, same estimates, one process, rounds in turn.
//!
//! ```text
//! cargo run --release -p fixtrail-bench -- [W1 W2 …] [--steps N] [--rounds N] [--seed N] [--scale]
//! ```
//!
//! Without names all workloads run; `--scale` prints costs against the size of the problem instead, and bytes per live target.
//!
//! Times vary from run to run; the ratios of one run are what counts.

mod fms;
mod input;
mod kalman;
mod race;
mod scale;
mod smoother;
mod turn;

use race::Settings;
use std::process::ExitCode;

const USAGE: &str = "usage: fixtrail-bench [W1 W2 ...] [--steps N] [--rounds N] [--seed N] [--scale]";

fn main() -> ExitCode {
    let settings = match settings(std::env::args().skip(1)) {
        Ok(settings) => settings,
        Err(message) => {
            eprintln!("{message}\n{USAGE}");
            return ExitCode::from(2);
        }
    };
    println!(
        "{} steps a series, median of {} rounds in turn, seed {}; times with their quartiles, ratios to the first line",
        settings.steps, settings.rounds, settings.seed
    );
    if std::env::args().any(|arg| arg == "--scale") {
        scale::tables(&settings);
        return ExitCode::SUCCESS;
    }
    type Workload = fn(&Settings) -> Result<(), String>;
    let workloads: [(&str, Workload); 10] = [
        ("W1", kalman::constant_acceleration),
        ("W2", |s| kalman::many(s, 0.0)),
        ("W2L", |s| kalman::many(s, 0.2)),
        ("W3", kalman::constant_velocity),
        ("W4", smoother::constant_acceleration),
        ("W4b", smoother::constant_velocity),
        ("W4L", smoother::fixed_lag),
        ("W5", turn::range_only),
        ("W5B", turn::many),
        ("W7", fms::paper),
    ];
    let wanted: Vec<String> = std::env::args().skip(1).filter(|a| a.starts_with('W')).collect();
    for (name, workload) in workloads {
        if !wanted.is_empty() && !wanted.iter().any(|w| w == name) {
            continue;
        }
        if let Err(message) = workload(&settings) {
            eprintln!("{message}");
            return ExitCode::FAILURE;
        }
    }
    ExitCode::SUCCESS
}

fn settings(mut args: impl Iterator<Item = String>) -> Result<Settings, String> {
    let mut settings = Settings { steps: 20_000, rounds: 31, seed: 1 };
    while let Some(name) = args.next() {
        if name.starts_with('W') || name == "--scale" {
            continue;
        }
        let value = args.next().ok_or_else(|| format!("`{name}` has no value, expected a number"))?;
        let number = value
            .parse::<u32>()
            .ok()
            .filter(|n| *n > 0)
            .ok_or_else(|| format!("`{name}` is `{value}`, expected a whole number above 0"))?;
        match name.as_str() {
            "--steps" => settings.steps = number as usize,
            "--rounds" => settings.rounds = number as usize,
            "--seed" => settings.seed = u64::from(number),
            _ => return Err(format!("there is no option `{name}`")),
        }
    }
    Ok(settings)
}
