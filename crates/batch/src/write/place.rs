//! Where an output appears, and how: whole, by rename, or directly.

use super::{Output, To, WriteError, io_error};
use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

/// Bytes gathered before they are handed to the system.
const BUFFER: usize = 1 << 16;

/// Whether a path names something that is there and neither a regular file nor a folder.
pub(crate) fn is_direct(path: &Path) -> bool {
    fs::metadata(path).is_ok_and(|m| !m.is_file() && !m.is_dir())
}

/// Runs `fill` on the output. A regular file takes its place only when everything has been written.
///
/// # Errors
/// Those of `fill`, and [`WriteError`] as one of them.
pub(crate) fn write<E: From<WriteError>>(output: &Output, fill: impl FnOnce(To<'_>) -> Result<(), E>) -> Result<(), E> {
    let file = output.name();
    let failed = |e: io::Error| E::from(io_error(file, e));
    match output {
        Output::Stdout => to_end(io::stdout(), file, fill).map(drop),
        Output::File(path) if is_direct(path) => {
            let open = OpenOptions::new().write(true).open(path).map_err(failed)?;
            to_end(open, file, fill).map(drop)
        }
        Output::File(path) if path.is_dir() => Err(failed(io::Error::from(io::ErrorKind::IsADirectory))),
        Output::File(path) => {
            // Through a link to the file it names; the link stays.
            let place = fs::canonicalize(path).unwrap_or_else(|_| path.clone());
            let temporary = temporary_beside(&place).map_err(failed)?;
            let temporary = to_end(temporary, file, fill)?;
            temporary.persist(&place).map_err(|e| failed(e.error))?;
            Ok(())
        }
    }
}

fn to_end<W: Write + Send, E: From<WriteError>>(
    to: W,
    file: &Path,
    fill: impl FnOnce(To<'_>) -> Result<(), E>,
) -> Result<W, E> {
    let mut to = BufWriter::with_capacity(BUFFER, to);
    let filled = fill(&mut to).and_then(|()| to.flush().map_err(|e| E::from(io_error(file, e))));
    // Dropping a BufWriter would write once more what has just failed; taking it apart does not.
    let (to, _) = to.into_parts();
    filled.map(|()| to)
}

/// A new file in the folder of `place`, removed on drop, with the permissions any new file gets.
fn temporary_beside(place: &Path) -> io::Result<tempfile::NamedTempFile<File>> {
    let folder = match place.parent() {
        Some(p) if p != Path::new("") => p.to_owned(),
        _ => PathBuf::from("."),
    };
    let mut builder = tempfile::Builder::new();
    builder.prefix(".fixtrail-").suffix(".tmp");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(fs::Permissions::from_mode(0o666));
    }
    builder.tempfile_in(folder)
}
