//! `fixtrail verify`: runs conformance vectors through the library.

use crate::failure::Failure;
use crate::figures::{counted, grouped};
use crate::output::{Results, error, table};
use crate::progress::Progress;
use clap::Args;
use fixtrail_track::verify::{FileVerdict, verify};
use serde_json::{Value, json};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Run conformance vectors through the library and compare
#[derive(Args)]
#[command(after_help = "\
Examples:
  fixtrail verify golden/fms/01_paper_model.json
  fixtrail verify golden/*/*.json --json

Exit code 1 when a quantity leaves its tolerance, 2 for a file that is not understood.")]
pub struct Arguments {
    /// Files of vectors
    #[arg(required = true, value_name = "FILE.json")]
    files: Vec<PathBuf>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// Runs the command. A file that is not understood does not keep the others from being run.
///
/// # Errors
/// [`Failure`] when standard output cannot be written.
pub fn run(arguments: &Arguments) -> Result<ExitCode, Failure> {
    let bar = Progress::pieces(arguments.files.len() as u64, "verifying");
    let verdicts: Vec<(&PathBuf, Result<FileVerdict, Failure>)> = arguments
        .files
        .iter()
        .map(|path| {
            let verdict = verdict(path);
            bar.add(1);
            (path, verdict)
        })
        .collect();
    drop(bar);
    let understood = || verdicts.iter().filter_map(|(_, v)| v.as_ref().ok());
    let refused = || verdicts.iter().filter_map(|(path, v)| v.as_ref().err().map(|e| (*path, e)));
    let failed = understood().filter(|v| !v.passed()).count();
    if arguments.json {
        Results::Stdout.json(&json!({
            "passed": failed == 0 && refused().count() == 0,
            "files": understood().map(json_of).collect::<Vec<_>>(),
            "not_understood": refused()
                .map(|(path, e)| json!({ "file": path.to_string_lossy(), "error": e.to_string() })).collect::<Vec<_>>(),
        }))?;
    } else {
        let blocks: Vec<String> = understood().map(text_of).collect();
        if !blocks.is_empty() {
            Results::Stdout.line(format_args!("{}\n", blocks.join("\n\n")))?;
        }
        let total = counted(understood().count() as u64, "file");
        if understood().count() > 0 {
            Results::Stdout.line(match failed {
                0 => format!("{total} verified, all within tolerance"),
                n => format!("{total} verified, {n} outside of tolerance"),
            })?;
        }
    }
    refused().for_each(|(_, e)| error(e));
    Ok(match (refused().count(), failed) {
        (0, 0) => ExitCode::SUCCESS,
        (0, _) => ExitCode::from(1),
        _ => ExitCode::from(2),
    })
}

fn verdict(path: &Path) -> Result<FileVerdict, Failure> {
    let text =
        fs::read_to_string(path).map_err(|e| Failure::Bad(format!("{}: cannot be read: {e}", path.display())))?;
    Ok(verify(&text, path)?)
}

fn word(passed: bool) -> &'static str {
    if passed { "ok" } else { "FAILED" }
}

fn text_of(verdict: &FileVerdict) -> String {
    let rows: Vec<Vec<String>> = verdict
        .quantities
        .iter()
        .map(|q| {
            vec![
                q.name.clone(),
                grouped(q.compared as u64),
                format!("{:.1e}", q.worst),
                format!("{:.0e}", q.tolerance),
                word(q.passed()).to_owned(),
            ]
        })
        .collect();
    let table = table(&["quantity", "numbers", "worst", "tolerance", "verdict"], &rows);
    format!("{} ({}): {}\n{table}", verdict.file, verdict.kind, word(verdict.passed()))
}

fn json_of(verdict: &FileVerdict) -> Value {
    json!({
        "file": verdict.file,
        "kind": verdict.kind,
        "passed": verdict.passed(),
        "quantities": verdict.quantities.iter().map(|q| json!({
            "name": q.name,
            "compared": q.compared,
            // JSON has no infinity: the two sides do not even have the same shape.
            "worst": q.worst.is_finite().then_some(q.worst),
            "tolerance": q.tolerance,
            "passed": q.passed(),
        })).collect::<Vec<_>>(),
    })
}
