//! The `fixtrail` binary: arguments in, a command run, an exit code out.

mod commands;
mod data;
mod failure;
mod figures;
mod output;
mod progress;
mod runs;
mod scores;
mod tables;
mod whole;

use clap::{Parser, Subcommand};
use failure::Failure;
use std::process::ExitCode;

/// Tables are read and written by several threads in pieces of a megabyte, which the system's allocator fetches anew each time.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Know where things are when the network that tells you is bad.
#[derive(Parser)]
#[command(
    name = "fixtrail",
    version,
    arg_required_else_help = true,
    after_help = "\
Examples:
  fixtrail demo                                     a first look, no data needed
  fixtrail check measurements.csv                   what is in the data, and what is wrong with it
  fixtrail track measurements.csv -o trail.csv      measurements in, trail out
  fixtrail compare measurements.csv                 which estimator is best on them
  fixtrail tune measurements.csv -o tuned.toml      numbers of a spec from recordings

Every command explains itself: fixtrail track --help"
)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Track(commands::track::Arguments),
    Compare(commands::compare::Arguments),
    Check(commands::check::Arguments),
    Demo(commands::demo::Arguments),
    Tune(commands::tune::Arguments),
    Simulate(commands::simulate::Arguments),
    Reproduce(commands::reproduce::Arguments),
    Verify(commands::verify::Arguments),
    List(commands::list::Arguments),
}

fn main() -> ExitCode {
    let result = match Arguments::parse().command {
        Command::Track(arguments) => commands::track::run(&arguments),
        Command::Compare(arguments) => commands::compare::run(&arguments),
        Command::Check(arguments) => commands::check::run(&arguments),
        Command::Demo(arguments) => commands::demo::run(&arguments),
        Command::Tune(arguments) => commands::tune::run(&arguments),
        Command::Simulate(arguments) => commands::simulate::run(&arguments),
        Command::Reproduce(arguments) => commands::reproduce::run(&arguments),
        Command::Verify(arguments) => commands::verify::run(&arguments),
        Command::List(arguments) => commands::list::run(&arguments),
    };
    match result {
        Ok(code) => code,
        Err(Failure::ReaderGone) => ExitCode::SUCCESS,
        Err(failure) => {
            output::error(&failure);
            failure.code()
        }
    }
}
