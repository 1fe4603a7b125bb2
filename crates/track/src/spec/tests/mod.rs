//! Good specs become the values they mean, broken ones say what is wrong where, and nothing panics.

mod broken;
mod damaged;
mod good;
mod schedule;

use super::{Spec, parse};
use crate::error::BuildError;
use std::io::{Error, ErrorKind};
use std::path::Path;

/// The spec in `text` as `site/spec.toml`, with `steps` as `site/steps.ndjson` and no other file.
fn parse_with(text: &str, steps: &[u8]) -> Result<Spec, BuildError> {
    parse(text, Path::new("site/spec.toml"), &mut |path| {
        if path == Path::new("site/steps.ndjson") { Ok(steps.to_vec()) } else { Err(Error::from(ErrorKind::NotFound)) }
    })
}
