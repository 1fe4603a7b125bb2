//! `fixtrail list`: the names that a spec may use.

use crate::failure::Failure;
use crate::output::Results;
use clap::{Args, ValueEnum};
use fixtrail_track::spec::{CHANNELS, ESTIMATORS, LINKS, MODELS, MOTIONS, Named, SCHEDULERS, SENSORS};
use serde_json::{Map, Value, json};
use std::process::ExitCode;

/// Print the names a spec may use
#[derive(Args)]
#[command(after_help = "Examples:\n  fixtrail list\n  fixtrail list estimators\n  fixtrail list sensors --json")]
pub struct Arguments {
    /// One list only
    #[arg(value_enum)]
    what: Option<List>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum List {
    Estimators,
    Models,
    Sensors,
    Links,
    Schedulers,
    Channels,
    Motions,
}

impl List {
    fn names(self) -> (&'static str, &'static [Named]) {
        match self {
            List::Estimators => ("estimators", ESTIMATORS),
            List::Models => ("models", MODELS),
            List::Sensors => ("sensors", SENSORS),
            List::Links => ("links", LINKS),
            List::Schedulers => ("schedulers", SCHEDULERS),
            List::Channels => ("channels", CHANNELS),
            List::Motions => ("motions", MOTIONS),
        }
    }
}

/// Runs the command.
///
/// # Errors
/// [`Failure`] when standard output cannot be written.
pub fn run(arguments: &Arguments) -> Result<ExitCode, Failure> {
    let lists = match arguments.what {
        Some(one) => vec![one.names()],
        None => List::value_variants().iter().map(|l| l.names()).collect(),
    };
    if arguments.json {
        let object = |names: &[Named]| -> Value {
            names.iter().map(|(name, about)| json!({ "name": name, "about": about })).collect()
        };
        let all: Map<String, Value> =
            lists.into_iter().map(|(title, names)| (title.to_owned(), object(names))).collect();
        Results::Stdout.json(&Value::Object(all))?;
        return Ok(ExitCode::SUCCESS);
    }
    let mut blocks = Vec::new();
    for (title, names) in lists {
        let rows: Vec<String> = if names.is_empty() {
            vec!["  none yet".to_owned()]
        } else {
            let width = names.iter().map(|(name, _)| name.len()).max().unwrap_or(0);
            names.iter().map(|(name, about)| format!("  {name:width$}  {about}")).collect()
        };
        blocks.push(format!("{title}\n{}", rows.join("\n")));
    }
    Results::Stdout.line(blocks.join("\n\n"))?;
    Ok(ExitCode::SUCCESS)
}
