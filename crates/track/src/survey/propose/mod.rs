//! A commented spec made from a survey.

mod chosen;
mod model;
mod sensors;
mod text;

use super::findings::short;
use super::{Severity, Survey};
use chosen::Chosen;
use core::fmt::Write as _;
use model::model;
use sensors::{bearing_sensor, height_sensor, position_sensor, range_sensor, rssi_sensor, tdoa_sensor};
use text::{comment, quoted};

/// Why no spec can be proposed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ProposeError {
    /// Matrices cannot be guessed.
    #[error(
        "`z1` … are measurements of a linear model, whose matrices cannot be guessed: expected a spec (`-c SPEC.toml`)"
    )]
    Linear,
    /// Nothing that says where in the plan a target is.
    #[error("has heights alone, expected positions, ranges, strengths, time differences or bearings beside them")]
    Heights,
    /// A kind that needs more anchors than there are.
    #[error("has rows of kind `{kind}` from {anchors} {} only, expected at least {least}, or rows of kind `position` or `range`", if *anchors == 1 { "anchor" } else { "anchors" })]
    FewAnchors {
        /// The kind.
        kind: &'static str,
        /// How many anchors there are.
        anchors: usize,
        /// How many it takes.
        least: usize,
    },
    /// Not a single row.
    #[error("has no rows, expected measurements")]
    Empty,
}

/// A spec that suits the data.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Proposal {
    /// The spec, with the reason beside each number.
    pub text: String,
    /// What was chosen and why, a line per choice.
    pub reasons: Vec<String>,
    /// What fitting to data with known positions would gain.
    pub tune: String,
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

/// Targets that are heard of less often than this, in the median, need what comes later to say where they were.
const FEW_INSTANTS: f64 = 4.0;
/// Hardly moves at all: a drift of about 1 cm/s in a minute, m²/s³.
const LEAST_PSD: f64 = 1e-6;

/// A spec that suits the data, with the reason beside each number.
///
/// # Errors
/// [`ProposeError`] when the data are linear measurements, do not say where targets are, or are nothing at all.
pub fn propose(survey: &Survey, circumstances: &Circumstances<'_>) -> Result<Proposal, ProposeError> {
    let chosen = Chosen::of(survey)?;
    let mut text = String::new();
    let mut reasons = Vec::new();
    // Writing to a string cannot fail.
    let _ = write(&mut text, &mut reasons, survey, circumstances, &chosen);
    Ok(Proposal { text, reasons, tune: tune(&chosen) })
}

fn write(
    out: &mut String,
    reasons: &mut Vec<String>,
    survey: &Survey,
    circumstances: &Circumstances<'_>,
    chosen: &Chosen<'_>,
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
    model(out, reasons, survey, chosen)?;
    writeln!(out, "\n[estimator]")?;
    let linear = [chosen.range, chosen.rssi, chosen.tdoa, chosen.bearing].iter().all(Option::is_none);
    let instants = super::stats::median(survey.targets.iter().map(|t| t.instants as f64)).unwrap_or(0.0);
    let (name, aside, why) = match linear {
        false if chosen.tdoa.is_some() && instants < FEW_INSTANTS => {
            ("rts", "   ", "most targets are heard of a few times only, and what comes later tells where they were")
        }
        false => ("ekf", "   ", "what is measured is not linear in the position"),
        true => ("kalman", "", "positions are linear; `rts` would give every instant all of the recording"),
    };
    writeln!(out, "kind = \"{name}\"{aside}        # {why}")?;
    reasons.push(format!("estimator `{name}`: {why}"));
    if let Some(position) = chosen.position {
        position_sensor(out, position, circumstances.geodetic)?;
        let sd =
            position.quick_sd.map_or("too few rows to tell".to_owned(), |sd| format!("they jitter by {} m", short(sd)));
        reasons.push(format!("sensor `position`: {sd}"));
    }
    if let Some(heights) = chosen.heights {
        height_sensor(out, heights)?;
        reasons.push("sensor `position`: rows with a height alone, an altimeter".to_owned());
    }
    if let Some(range) = chosen.range {
        range_sensor(out, reasons, range, survey, chosen)?;
    }
    if let Some(rssi) = chosen.rssi {
        rssi_sensor(out, reasons, rssi, survey, chosen)?;
    }
    if let Some(tdoa) = chosen.tdoa {
        tdoa_sensor(out, reasons, tdoa, survey, chosen)?;
    }
    if let Some(bearing) = chosen.bearing {
        bearing_sensor(out, reasons, bearing, chosen)?;
    }
    for (kind, why) in &chosen.left_out {
        writeln!(out, "\n# {} rows of kind `{}` are left out: {why}.", kind.rows, kind.kind.name())?;
        reasons.push(format!("no sensor for the {} rows of kind `{}`: {why}", kind.rows, kind.kind.name()));
    }
    Ok(())
}

/// What `tune` could do better than this look at the data.
fn tune(chosen: &Chosen<'_>) -> String {
    let gain = if let Some(range) = chosen.range {
        let misfit =
            range.fit_sd.map_or(String::new(), |sd| format!(", which still miss a common point by {} m", short(sd)));
        format!("a bias for each anchor{misfit}")
    } else if let Some(rssi) = chosen.rssi {
        let misfit = rssi.law.map_or(6.0, |l| l.sd_db);
        format!("a level for each anchor and the exponent; strengths miss one law by {} dB", short(misfit))
    } else if chosen.tdoa.is_some() {
        "the noise level for these receivers, and the height of the targets".to_owned()
    } else if chosen.bearing.is_some() {
        "how each anchor is turned".to_owned()
    } else {
        "noise levels that make the claimed uncertainty true; what neighbouring rows are off by together is not seen here"
            .to_owned()
    };
    format!("`fixtrail tune` would gain: {gain}")
}
