//! Files that appear whole: written beside their place, then renamed to it.

use crate::failure::Failure;
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// The folder a file is in.
pub fn folder(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

/// Finds out before a long run whether `path` can be written at its end.
///
/// # Errors
/// [`Failure::Bad`] when it cannot: the folder is missing or closed, or `path` is a folder itself.
pub fn check(path: &Path) -> Result<(), Failure> {
    let bad = |what: String| Err(Failure::Bad(format!("{}: cannot be written: {what}", path.display())));
    match fs::metadata(path) {
        Ok(meta) if meta.is_dir() => return bad("it is a folder, expected the name of a file".to_owned()),
        // A device or a pipe is written directly, when the time comes.
        Ok(meta) if !meta.is_file() => return Ok(()),
        _ => {}
    }
    let folder = folder(path);
    if path.file_name().is_none() {
        return bad("it is no name of a file".to_owned());
    }
    match fs::metadata(folder) {
        Ok(meta) if !meta.is_dir() => return bad(format!("`{}` is no folder", folder.display())),
        Ok(_) => {}
        Err(e) if e.kind() == io::ErrorKind::NotFound => {
            return bad(format!("the folder `{}` does not exist", folder.display()));
        }
        Err(e) => return bad(e.to_string()),
    }
    match tempfile::Builder::new().prefix(".fixtrail-").tempfile_in(folder) {
        Ok(_) => Ok(()),
        Err(e) => bad(e.error_without_path()),
    }
}

/// An i/o error without the name of a temporary file that nobody knows.
trait WithoutPath {
    fn error_without_path(&self) -> String;
}

impl WithoutPath for io::Error {
    fn error_without_path(&self) -> String {
        match self.raw_os_error() {
            Some(code) => io::Error::from_raw_os_error(code).to_string(),
            None => match io::Error::from(self.kind()) {
                plain if self.kind() != io::ErrorKind::Other => plain.to_string(),
                _ => self.to_string(),
            },
        }
    }
}

/// Writes `content` to `path`: whole or not at all for a file, directly for anything else.
///
/// # Errors
/// [`Failure`] when it cannot be written; a file of that name is as it was then.
pub fn write(path: &Path, content: &[u8]) -> Result<(), Failure> {
    let failed = |e: io::Error| Failure::unwritable(path, &e);
    if fs::metadata(path).is_ok_and(|meta| !meta.is_file()) {
        return File::options().write(true).open(path).and_then(|mut f| f.write_all(content)).map_err(failed);
    }
    let mut builder = tempfile::Builder::new();
    builder.prefix(".fixtrail-");
    // As a file made in the ordinary way: the user's mask decides who may read it.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    let mut file = builder.tempfile_in(folder(path)).map_err(failed)?;
    file.write_all(content).map_err(failed)?;
    file.persist(path).map(drop).map_err(|e| failed(e.error))
}

/// Whether two paths name one existing file.
pub fn same(a: &Path, b: &Path) -> bool {
    match (a.canonicalize(), b.canonicalize()) {
        (Ok(a), Ok(b)) => a == b,
        _ => false,
    }
}

/// Refuses outputs that would overwrite an input or one another.
///
/// # Errors
/// [`Failure::Bad`] with the pair.
pub fn apart(outputs: &[(&str, &Path)], inputs: &[(&str, &Path)]) -> Result<(), Failure> {
    for (i, (role, output)) in outputs.iter().enumerate() {
        if let Some((other, _)) = inputs.iter().find(|(_, input)| same(output, input) && is_file(output)) {
            return Err(Failure::Bad(format!(
                "{}: the {role} would overwrite the {other}, expected another name",
                output.display()
            )));
        }
        if let Some((other, _)) = outputs[..i].iter().find(|(_, earlier)| absolute(earlier) == absolute(output)) {
            return Err(Failure::Bad(format!(
                "{}: is both the {other} and the {role}, expected two names",
                output.display()
            )));
        }
    }
    Ok(())
}

fn is_file(path: &Path) -> bool {
    fs::metadata(path).is_ok_and(|m| m.is_file())
}

/// The path from the root, its folder resolved.
fn absolute(path: &Path) -> PathBuf {
    match (folder(path).canonicalize(), path.file_name()) {
        (Ok(folder), Some(name)) => folder.join(name),
        _ => path.to_owned(),
    }
}
