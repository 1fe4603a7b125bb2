//! Text for people: messages on standard error, tables, and JSON for programs.

use crate::failure::Failure;
use clap::builder::styling::{AnsiColor, Style};
use comfy_table::{CellAlignment, Table};
use serde_json::Value;
use std::fmt::Display;
use std::io::{self, IsTerminal, Write};

/// Prints `error: …`.
pub fn error(failure: &Failure) {
    let coloured = io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none_or(|v| v.is_empty());
    let style = if coloured { AnsiColor::Red.on_default().bold() } else { Style::new() };
    say(format_args!("{style}error:{style:#} {failure}"));
}

/// Prints a plain message to standard error.
pub fn say(text: impl Display) {
    // Nobody left to tell is no reason to stop.
    let _ = writeln!(io::stderr().lock(), "{text}");
}

/// Where results go: standard output, or standard error when the trail itself takes standard output.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Results {
    /// The usual place.
    Stdout,
    /// Beside a trail on standard output.
    Stderr,
}

impl Results {
    /// Prints `text` and a line end.
    ///
    /// # Errors
    /// [`Failure`] when it cannot be written.
    pub fn line(self, text: impl Display) -> Result<(), Failure> {
        match self {
            Results::Stdout => {
                let mut out = io::stdout().lock();
                writeln!(out, "{text}")?;
                out.flush()?;
            }
            Results::Stderr => say(text),
        }
        Ok(())
    }

    /// Prints one JSON object.
    ///
    /// # Errors
    /// [`Failure`] when it cannot be written.
    pub fn json(self, value: &Value) -> Result<(), Failure> {
        self.line(format_args!("{value:#}"))
    }
}

/// A table: the first column left, the others right-aligned, no lines.
///
/// A row that is shorter than the header ends in empty cells.
pub fn table(header: &[&str], rows: &[Vec<String>]) -> String {
    let mut table = Table::new();
    table.load_style(comfy_table::presets::NOTHING).set_header(header);
    for row in rows {
        table.add_row(row);
    }
    for (i, column) in table.column_iter_mut().enumerate() {
        column.set_padding((0, 2));
        column.set_cell_alignment(if i == 0 { CellAlignment::Left } else { CellAlignment::Right });
    }
    let lines: Vec<String> = table.lines().map(|l| format!("  {}", l.trim_end())).collect();
    lines.join("\n")
}
