//! A commented spec made from a survey.

use super::findings::short;
use super::{KindSurvey, Severity, Survey};
use crate::packet::Kind;
use core::fmt::Write as _;

/// Why no spec can be proposed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ProposeError {
    /// Matrices cannot be guessed.
    #[error(
        "`z1` … are measurements of a linear model, whose matrices cannot be guessed: expected a spec (`-c SPEC.toml`)"
    )]
    Linear,
    /// Nothing but kinds without a sensor.
    #[error("has rows of kind {0} only, for which there is no sensor yet, expected `position` or `range`")]
    NoSensor(String),
    /// Not a single row.
    #[error("has no rows, expected measurements")]
    Empty,
}

/// What the packets do not say.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Circumstances<'a> {
    /// Name of the data, for the first line of the spec.
    pub data: &'a str,
    /// Whether positions came as latitude and longitude.
    pub geodetic: bool,
    /// The anchors file, when it is not `anchors.csv` beside the data.
    pub anchors: Option<&'a str>,
}

/// A ranging radio in a room errs by this much even when its readings hardly jitter, metres.
const LEAST_RANGE_SD: f64 = 0.1;
/// A satellite receiver smooths its fixes, so they jitter far less than they err, metres.
const LEAST_SATELLITE_SD: f64 = 1.5;
/// A position source of unknown make, metres.
const LEAST_POSITION_SD: f64 = 0.01;
/// Hardly moves at all: a drift of about 1 cm/s in a minute, m²/s³.
const LEAST_PSD: f64 = 1e-6;

/// Text of a spec that suits the data, with the reason beside each number.
///
/// # Errors
/// [`ProposeError`] when the data are linear measurements, hold no kind that has a sensor, or nothing at all.
pub fn propose(survey: &Survey, circumstances: &Circumstances<'_>) -> Result<String, ProposeError> {
    let of = |kind: Kind| survey.kinds.iter().find(|k| k.kind == kind);
    if of(Kind::Linear).is_some() {
        return Err(ProposeError::Linear);
    }
    let (position, range) = (of(Kind::Position), of(Kind::Range));
    if position.is_none() && range.is_none() {
        let names: Vec<String> = survey.kinds.iter().map(|k| format!("`{}`", k.kind.name())).collect();
        return Err(if names.is_empty() { ProposeError::Empty } else { ProposeError::NoSensor(names.join(", ")) });
    }
    let mut text = String::new();
    // Writing to a string cannot fail.
    let _ = write(&mut text, survey, circumstances, position, range);
    Ok(text)
}

fn write(
    out: &mut String,
    survey: &Survey,
    circumstances: &Circumstances<'_>,
    position: Option<&KindSurvey>,
    range: Option<&KindSurvey>,
) -> core::fmt::Result {
    writeln!(
        out,
        "# Proposed from {}: {} rows, {}.",
        comment(circumstances.data),
        survey.rows,
        match survey.targets.len() {
            1 => "1 target".to_owned(),
            n => format!("{n} targets"),
        }
    )?;
    writeln!(out, "# Every number is an estimate from these data; change what you know better.")?;
    for finding in survey.findings.iter().filter(|f| f.severity > Severity::Note) {
        writeln!(out, "# {}: {}.", finding.severity.name(), comment(&finding.text))?;
    }
    writeln!(out, "version = 1")?;
    if let Some(anchors) = circumstances.anchors {
        writeln!(out, "anchors = {}", quoted(anchors))?;
    }
    model(out, position, range)?;
    writeln!(out, "\n[estimator]")?;
    match range {
        Some(_) => writeln!(out, "kind = \"ekf\"           # ranges are not linear in the position")?,
        None => writeln!(out, "kind = \"kalman\"        # or \"rts\": every instant given the whole recording")?,
    }
    if let Some(position) = position {
        position_sensor(out, position, circumstances.geodetic)?;
    }
    if let Some(range) = range {
        range_sensor(out, range, survey, position)?;
    }
    let unused: Vec<&KindSurvey> =
        survey.kinds.iter().filter(|k| !matches!(k.kind, Kind::Position | Kind::Range)).collect();
    for kind in unused {
        writeln!(out, "\n# {} rows of kind `{}` have no sensor yet and are left out.", kind.rows, kind.kind.name())?;
    }
    Ok(())
}

/// Axes of the track: positions decide where there are any.
fn axes(position: Option<&KindSurvey>, range: Option<&KindSurvey>) -> usize {
    position.or(range).map_or(2, |k| k.axes)
}

fn model(out: &mut String, position: Option<&KindSurvey>, range: Option<&KindSurvey>) -> core::fmt::Result {
    let axes = axes(position, range);
    writeln!(out, "\n[model]\nkind = \"constant-velocity\"")?;
    let why = match (position.is_some(), axes) {
        (true, 3) => "positions have a height that changes",
        (true, _) => "positions have no height, or one that never changes",
        (false, 3) => "the anchors stand at different enough heights to settle the target's",
        (false, _) => "the anchors do not settle a height",
    };
    writeln!(out, "axes = {axes}               # {why}")?;
    let lively = position.filter(|k| k.psd.is_some()).or(range.filter(|k| k.psd.is_some())).or(position.or(range));
    let psd = lively.and_then(|k| k.psd);
    let plane = psd.unwrap_or(1.0).max(LEAST_PSD);
    match (psd, lively.and_then(|k| k.speed)) {
        (Some(_), Some(speed)) => writeln!(
            out,
            "# Density of the acceleration noise, m²/s³: from how much the data bend over the shortest time at which motion\n\
             # outweighs noise; speeds reach about {} m/s. Larger follows turns faster, smaller is smoother.",
            short(speed)
        )?,
        _ => writeln!(
            out,
            "# Density of the acceleration noise, m²/s³: too few data to tell, 1 suits a walking person.\n\
             # Larger follows turns faster, smaller is smoother."
        )?,
    }
    let height = lively.and_then(|k| k.psd_z).unwrap_or(plane).max(LEAST_PSD);
    if axes == 3 && position.is_some() {
        let (plane, height) = (rounded(plane), rounded(height));
        writeln!(out, "noise = [{plane}, {plane}, {height}]")
    } else {
        writeln!(out, "noise = {}", rounded(plane))
    }
}

fn position_sensor(out: &mut String, position: &KindSurvey, geodetic: bool) -> core::fmt::Result {
    writeln!(out, "\n[[sensor]]\nkind = \"position\"")?;
    let floor = if geodetic { LEAST_SATELLITE_SD } else { LEAST_POSITION_SD };
    match position.quick_sd {
        Some(quick) if quick >= floor => writeln!(
            out,
            "# Jitter from one row to the next, metres. An error that neighbouring rows share is not seen in it: if `--truth` says\n\
             # over-confident, raise it."
        )?,
        Some(quick) => writeln!(
            out,
            "# Rows jitter by {} m only, {}.",
            short(quick),
            if geodetic {
                "but satellite fixes are smoothed and err by more"
            } else {
                "less than positions usually err"
            }
        )?,
        None => writeln!(out, "# Too few rows to tell, metres.")?,
    }
    let sd = position.quick_sd.unwrap_or(if geodetic { 3.0 } else { 1.0 }).max(floor);
    writeln!(out, "sd = {}", rounded(sd))?;
    if let (3, Some(z)) = (position.axes, position.quick_sd_z) {
        writeln!(out, "# The height alone jitters by {} m.", short(z))?;
    }
    own_sd(out, position)?;
    robust(out, position)
}

fn range_sensor(
    out: &mut String,
    range: &KindSurvey,
    survey: &Survey,
    position: Option<&KindSurvey>,
) -> core::fmt::Result {
    writeln!(out, "\n[[sensor]]\nkind = \"range\"")?;
    match (range.fit_sd, range.quick_sd) {
        (Some(fit), Some(quick)) => {
            let shared = shared_instants(range, survey);
            writeln!(
                out,
                "# Metres. The ranges of one moment miss the best common point by {} m and jitter by {} m: what",
                short(fit),
                short(quick)
            )?;
            writeln!(
                out,
                "# stays between rows does not average out over the {shared:.0} instants that the filter remembers, so it weighs as much more."
            )?;
            let lasting = range.lasting_sd().unwrap_or(0.0);
            writeln!(out, "sd = {}", rounded((quick.powi(2) + lasting.powi(2) * shared).sqrt().max(LEAST_RANGE_SD)))?;
        }
        (Some(fit), None) => {
            writeln!(out, "# Metres: how far the ranges of one moment miss the best common point.")?;
            writeln!(out, "sd = {}", rounded(fit.max(LEAST_RANGE_SD)))?;
        }
        (None, Some(quick)) => {
            writeln!(
                out,
                "# Metres: three times the jitter from one row to the next, as errors that stay are not seen in it."
            )?;
            writeln!(out, "sd = {}", rounded((3.0 * quick).max(LEAST_RANGE_SD)))?;
        }
        (None, None) => writeln!(out, "# Metres: too few rows to tell.\nsd = 0.3")?,
    }
    if let (2, Some(geometry)) = (axes(position, Some(range)), &survey.geometry) {
        let [low, high] = geometry.heights_m.map(short);
        match range.fit_height_m {
            Some(_) => writeln!(
                out,
                "# Height of the target, metres: the one at which the ranges of one moment fit best, to 0.25 m, if it is below the\n\
                 # anchors ({low} to {high} m). Ranges that are too long look the same. Measure yours."
            )?,
            None if low == high => {
                writeln!(out, "# Height of the target, metres: not known, so that of the anchors. Measure yours.")?
            }
            None => writeln!(
                out,
                "# Height of the target, metres: not known, so the median of the anchors' ({low} to {high} m). Measure yours."
            )?,
        }
        writeln!(out, "height_m = {}", tidy(range.fit_height_m.unwrap_or(geometry.height_m)))?;
    }
    own_sd(out, range)?;
    robust(out, range)
}

/// Number of instants that a filter for these ranges averages over.
///
/// For a model of constant velocity it is about `(sd² Δt/psd)^¼` seconds.
fn shared_instants(range: &KindSurvey, survey: &Survey) -> f64 {
    let period_s = survey.targets.iter().filter_map(|t| t.period_s).fold(f64::INFINITY, f64::min);
    let (Some(fit), Some(psd)) = (range.fit_sd, range.psd) else { return 1.0 };
    let memory_s = (fit.powi(2) * period_s / psd.max(LEAST_PSD)).powf(0.25);
    let instants = memory_s / period_s;
    if instants.is_finite() { instants.clamp(1.0, 100.0) } else { 1.0 }
}

fn own_sd(out: &mut String, kind: &KindSurvey) -> core::fmt::Result {
    match kind.with_sd {
        0 => Ok(()),
        n => writeln!(out, "# {n} of {} rows bring an `sd` of their own, which is used instead.", kind.rows),
    }
}

/// Gross errors can be kept from pulling. Not by default: on data without any it costs some accuracy.
fn robust(out: &mut String, kind: &KindSurvey) -> core::fmt::Result {
    if kind.outliers as f64 > 1e-4 * kind.rows as f64 {
        let (outliers, rows) = (kind.outliers, kind.rows);
        writeln!(
            out,
            "# {outliers} of {rows} values lie far from their neighbours. The next line would limit what pulls by"
        )?;
        writeln!(out, "# more than 1.3 deviations, and start a lost track anew.")?;
        writeln!(out, "# robust = \"huber\"")?;
    }
    Ok(())
}

/// Two significant digits, as TOML reads a float.
fn rounded(value: f64) -> String {
    let text = format!("{value:.1e}");
    let short = text.parse::<f64>().unwrap_or(value);
    let plain = format!("{short:?}");
    if plain.len() <= 12 { plain } else { text }
}

/// Centimetres, as TOML reads a float.
fn tidy(value: f64) -> String {
    format!("{:?}", (100.0 * value).round() / 100.0)
}

/// Text that stays on its line of comment.
fn comment(text: &str) -> String {
    text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect()
}

/// A basic TOML string.
fn quoted(text: &str) -> String {
    let mut out = String::from("\"");
    for c in text.chars() {
        match c {
            '"' | '\\' => out.extend(['\\', c]),
            c if c.is_control() => {
                let _ = write!(out, "\\u{:04X}", c as u32);
            }
            c => out.push(c),
        }
    }
    out + "\""
}
