//! `fixtrail check`: what is in the data, and what is wrong with them.

mod json;
mod text;

use crate::data::{Data, DataArguments, Wanted};
use crate::failure::Failure;
use crate::output::{Results, say};
use crate::whole;
use clap::Args;
use fixtrail_track::survey::Survey;
use fixtrail_track::theory::{Source, Theory, theory_for};
use fixtrail_track::trackers::LaggedMode;
use std::process::ExitCode;

/// Look at measurements: rate, gaps, loss, noise, anchors; propose a spec
#[derive(Args)]
#[command(after_help = "\
Examples:
  fixtrail check measurements.csv
  fixtrail check measurements.csv --write-spec spec.toml     propose a spec, ready to edit
  fixtrail check measurements.csv -c spec.toml               does this spec fit these data?
  cat measurements.ndjson | fixtrail check - --format ndjson --json")]
pub struct Arguments {
    #[command(flatten)]
    data: DataArguments,
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Bad`] when the input or the spec cannot be used, or the proposed spec not be written.
pub fn run(arguments: &Arguments) -> Result<ExitCode, Failure> {
    let data_arguments = &arguments.data;
    if let Some(path) = &data_arguments.write_spec {
        whole::apart(&[("spec", path)], &data_arguments.files())?;
        whole::check(path)?;
    }
    let data = data_arguments.load(Wanted::Survey)?;
    if let Ok(spec) = &data.spec {
        spec.try_build(&data.table.anchors, LaggedMode::Own)?;
    }
    if let Some(survey) = &data.survey {
        match data_arguments.json {
            true => Results::Stdout.json(&json::report(data_arguments, &data, survey))?,
            false => Results::Stdout.line(text::report(data_arguments, &data, survey))?,
        }
    }
    save(data_arguments, &data)?;
    Ok(ExitCode::SUCCESS)
}

/// What theory says of the user's spec, or why nothing; `None` without one.
fn promise(data: &Data, survey: &Survey) -> Option<Result<(Theory, Source), String>> {
    let given = data.spec.as_ref().ok().filter(|s| s.path.is_some())?;
    Some(theory_for(&given.spec, survey))
}

/// Writes the proposed spec where the user wants it.
fn save(arguments: &DataArguments, data: &Data) -> Result<(), Failure> {
    let Some(path) = &arguments.write_spec else { return Ok(()) };
    let spec = data.spec.as_ref().map_err(|why| arguments.no_spec(why))?;
    whole::write(path, spec.text.as_bytes())?;
    say(format_args!(
        "wrote {}; next: fixtrail track -c {} {} -o trail.csv",
        path.display(),
        path.display(),
        arguments.input.display()
    ));
    Ok(())
}
