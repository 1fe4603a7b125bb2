//! Why a command stopped, and what the shell is told.

use fixtrail_track::error::BuildError;
use std::fmt;
use std::io;
use std::path::Path;
use std::process::ExitCode;

/// Why a command stopped.
#[derive(Debug)]
pub enum Failure {
    /// Bad usage, bad input, or an output that cannot be written: exit code 2.
    Bad(String),
    /// A run that failed on good input: exit code 1.
    Run(String),
    /// Whoever reads our output has seen enough (`| head`): no failure at all.
    ReaderGone,
}

impl Failure {
    /// The exit code.
    pub fn code(&self) -> ExitCode {
        match self {
            Failure::Bad(_) => ExitCode::from(2),
            Failure::Run(_) => ExitCode::from(1),
            Failure::ReaderGone => ExitCode::SUCCESS,
        }
    }

    /// An output at `path` that cannot be written.
    pub fn unwritable(path: &Path, error: &io::Error) -> Failure {
        match error.kind() {
            io::ErrorKind::BrokenPipe => Failure::ReaderGone,
            _ => Failure::Bad(format!("{}: cannot be written: {error}", path.display())),
        }
    }
}

impl fmt::Display for Failure {
    /// One sentence on one line, whatever names and values are in it.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let text = match self {
            Failure::Bad(text) | Failure::Run(text) => text.as_str(),
            Failure::ReaderGone => "the reader of the output is gone",
        };
        let parts: Vec<&str> = text.split(['\n', '\r']).map(str::trim).filter(|part| !part.is_empty()).collect();
        f.write_str(&parts.join("; "))
    }
}

impl From<BuildError> for Failure {
    fn from(error: BuildError) -> Failure {
        Failure::Bad(error.to_string())
    }
}

/// Trouble on standard output.
impl From<io::Error> for Failure {
    fn from(error: io::Error) -> Failure {
        Failure::unwritable(Path::new("-"), &error)
    }
}
