//! The sensors of a proposal, one of each kind.

use super::LEAST_PSD;
use super::chosen::Chosen;
use super::text::{key, rounded, tidy};
use crate::packet::Kind;
use crate::survey::findings::short;
use crate::survey::{KindSurvey, Law, Survey};
use core::fmt::Write as _;

/// A ranging radio in a room errs by this much even when its readings hardly jitter, metres.
const LEAST_RANGE_SD: f64 = 0.15;
/// One height for all targets costs time differences this many times their misfit.
const HEIGHTS_DIFFER: f64 = 4.0;
/// A time difference does so too, metres.
const LEAST_DIFFERENCE_SD: f64 = 0.15;
/// A direction, radians: a degree.
const LEAST_BEARING_SD: f64 = 0.017;
/// Shadowing lasts: strengths of one place err alike, and weigh less by this than their misfit says.
const LASTING_SHADOWS: f64 = 2.5;
/// A satellite receiver smooths its fixes, so they jitter far less than they err, metres.
const LEAST_SATELLITE_SD: f64 = 1.5;
/// A position source of unknown make, metres.
const LEAST_POSITION_SD: f64 = 0.01;

pub(super) fn height_sensor(out: &mut String, heights: &KindSurvey) -> core::fmt::Result {
    writeln!(
        out,
        "\n[[sensor]]\nkind = \"position\"\n# Heights alone, metres: an altimeter. Pressure says them to some ten metres."
    )?;
    let sd = heights.quick_sd_z.unwrap_or(10.0).max(LEAST_POSITION_SD);
    writeln!(out, "sd = {}", rounded(sd))?;
    own_sd(out, heights)
}

/// The height of targets on a planar track, where the anchors have heights.
fn height(
    out: &mut String,
    kind: &KindSurvey,
    survey: &Survey,
    chosen: &Chosen<'_>,
) -> Result<Option<f64>, core::fmt::Error> {
    let (2, Some(geometry)) = (chosen.axes(), &survey.geometry) else { return Ok(None) };
    if geometry.is_plan() && kind.fit_height_m.is_none() {
        return Ok(None);
    }
    let [low, high] = geometry.heights_m.map(short);
    match (kind.kind, kind.fit_height_m) {
        (Kind::Rssi, _) => writeln!(
            out,
            "# Height of the target, metres: well below the anchors ({low} to {high} m), which keeps the law from growing without\n\
             # bound close to one. The truth may be less good."
        )?,
        (Kind::Tdoa, Some(_)) => writeln!(
            out,
            "# Height of the targets, metres: the one at which the differences of one moment fit best; one for all. With heights in\n\
             # the data (`position` rows with z alone) the track is in space and better."
        )?,
        (_, Some(_)) => writeln!(
            out,
            "# Height of the target, metres: the one at which the ranges of one moment fit best, to 0.25 m, if it is below the\n\
             # anchors ({low} to {high} m). Ranges that are too long look the same. Measure yours."
        )?,
        (_, None) if low == high => {
            writeln!(out, "# Height of the target, metres: not known, so that of the anchors. Measure yours.")?
        }
        (_, None) => writeln!(
            out,
            "# Height of the target, metres: not known, so the median of the anchors' ({low} to {high} m). Measure yours."
        )?,
    }
    let height_m = kind.fit_height_m.unwrap_or(geometry.height_m);
    writeln!(out, "height_m = {}", tidy(height_m))?;
    Ok(Some(height_m))
}

pub(super) fn rssi_sensor(
    out: &mut String,
    reasons: &mut Vec<String>,
    rssi: &KindSurvey,
    survey: &Survey,
    chosen: &Chosen<'_>,
) -> core::fmt::Result {
    writeln!(out, "\n[[sensor]]\nkind = \"rssi\"")?;
    let law = rssi.law.unwrap_or(Law { exponent: 2.0, at_1m_dbm: -50.0, sd_db: 6.0, fitted: false });
    let sd = LASTING_SHADOWS * law.sd_db;
    // What is too strong for its place pulls harder than what is too weak pushes: a level that is too high ends far outside.
    let level = if law.fitted { law.at_1m_dbm - law.sd_db } else { law.at_1m_dbm };
    match law.fitted {
        true => writeln!(
            out,
            "# dB. One law misses the strengths by {} dB where they fit best; as shadows last, they weigh less than that.",
            short(law.sd_db)
        )?,
        false => writeln!(out, "# dB. Shadowing of the usual radios; too few moments with enough anchors to see it.")?,
    }
    writeln!(out, "sd = {}", rounded(sd))?;
    match law.fitted {
        true => writeln!(
            out,
            "# The law that fits best if targets are among the anchors, its level lower by one misfit: a level too high drives\n\
             # targets out of the room, one too low keeps them in it. Measure yours."
        )?,
        false => writeln!(
            out,
            "# Free space, with the level that puts the median strength at the usual distance. Measure yours."
        )?,
    }
    writeln!(out, "path_loss = {{ exponent = {:?}, at_1m_dbm = {:?} }}", law.exponent, level.round())?;
    reasons.push(format!(
        "sensor `rssi`, exponent {:?} and {:?} dBm at 1 m: {}",
        law.exponent,
        level.round(),
        if law.fitted {
            "the law that fits best if targets are among the anchors"
        } else {
            "free space, too few data to fit"
        }
    ));
    reasons.push(format!("sd {} dB: the misfit is {} dB, and shadows last", rounded(sd), short(law.sd_db)));
    height(out, rssi, survey, chosen)?;
    own_sd(out, rssi)?;
    guard(out, reasons, chosen)
}

pub(super) fn tdoa_sensor(
    out: &mut String,
    reasons: &mut Vec<String>,
    tdoa: &KindSurvey,
    survey: &Survey,
    chosen: &Chosen<'_>,
) -> core::fmt::Result {
    writeln!(out, "\n[[sensor]]\nkind = \"tdoa\"")?;
    let (sd, why) = match (tdoa.fit_sd, tdoa.quick_sd) {
        (Some(fit), _) if tdoa.fit_height_m.is_some() && chosen.axes() == 2 => {
            let miss = format!(
                "the differences of one moment miss a common point by {} m; four times that, as heights differ",
                short(fit)
            );
            (HEIGHTS_DIFFER * fit, miss)
        }
        (Some(fit), _) => (fit, "how far the differences of one moment miss the best common point".to_owned()),
        (None, Some(quick)) => (3.0 * quick, "three times the jitter from one row to the next".to_owned()),
        (None, None) => (1.0, "too few rows to tell".to_owned()),
    };
    let sd = rounded(sd.max(LEAST_DIFFERENCE_SD));
    writeln!(out, "# Metres: {why}.\nsd = {sd}")?;
    reasons.push(format!("sensor `tdoa`, sd {sd} m: {why}"));
    if let Some(height_m) = height(out, tdoa, survey, chosen)? {
        let why = match tdoa.fit_height_m {
            Some(_) => "the one at which the differences fit best, for all targets",
            None => "that of the anchors",
        };
        reasons.push(format!("height {} m: {why}", tidy(height_m)));
    }
    own_sd(out, tdoa)?;
    guard(out, reasons, chosen)
}

pub(super) fn bearing_sensor(
    out: &mut String,
    reasons: &mut Vec<String>,
    bearing: &KindSurvey,
    chosen: &Chosen<'_>,
) -> core::fmt::Result {
    writeln!(out, "\n[[sensor]]\nkind = \"bearing\"")?;
    let (sd, why) = match (bearing.fit_sd, bearing.quick_sd) {
        (Some(fit), _) => (fit, "how far the directions of one moment miss the best common point"),
        (None, Some(quick)) => (2.0 * quick, "twice the jitter from one row to the next"),
        (None, None) => (0.1, "too few rows to tell"),
    };
    let sd = rounded(sd.max(LEAST_BEARING_SD));
    writeln!(out, "# Radians: {why}.\nsd = {sd}")?;
    reasons.push(format!("sensor `bearing`, sd {sd} rad: {why}"));
    own_sd(out, bearing)?;
    guard(out, reasons, chosen)
}

/// Real radios see reflections: what does not fit must not pull at will.
fn guard(out: &mut String, reasons: &mut Vec<String>, chosen: &Chosen<'_>) -> core::fmt::Result {
    let robust = chosen.robust();
    let why = match robust {
        "huber" => "what misses pulls no more than 1.3 deviations would, as real radios see reflections",
        _ => "what misses by 4.7 deviations is left out, as gross errors of clocks say nothing of the place",
    };
    writeln!(out, "# {why}; and a lost track starts anew.\nrobust = \"{robust}\"")?;
    let line = format!("robust `{robust}`: {why}");
    if !reasons.contains(&line) {
        reasons.push(line);
    }
    Ok(())
}

pub(super) fn position_sensor(out: &mut String, position: &KindSurvey, geodetic: bool) -> core::fmt::Result {
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

pub(super) fn range_sensor(
    out: &mut String,
    reasons: &mut Vec<String>,
    range: &KindSurvey,
    survey: &Survey,
    chosen: &Chosen<'_>,
) -> core::fmt::Result {
    writeln!(out, "\n[[sensor]]\nkind = \"range\"")?;
    let (sd, why) = match (range.fit_sd, range.quick_sd) {
        (Some(fit), Some(quick)) => {
            let shared = shared_instants(range, survey);
            let why = format!(
                "the ranges of one moment miss the best common point by {} m and jitter by {} m",
                short(fit),
                short(quick)
            );
            writeln!(out, "# Metres: {why}; what")?;
            writeln!(
                out,
                "# stays between rows does not average out over the {shared:.0} instants that the filter remembers, so it weighs as much more."
            )?;
            let lasting = range.lasting_sd().unwrap_or(0.0);
            ((quick.powi(2) + lasting.powi(2) * shared).sqrt(), why)
        }
        (Some(fit), None) => (fit, "how far the ranges of one moment miss the best common point".to_owned()),
        (None, Some(quick)) => {
            (3.0 * quick, "three times the jitter, as errors that stay are not seen in it".to_owned())
        }
        (None, None) => (0.3, "too few rows to tell".to_owned()),
    };
    if range.fit_sd.is_none() || range.quick_sd.is_none() {
        writeln!(out, "# Metres: {why}.")?;
    }
    let sd = rounded(sd.max(LEAST_RANGE_SD));
    writeln!(out, "sd = {sd}")?;
    reasons.push(format!("sensor `range`, sd {sd} m: {why}"));
    if let Some(height_m) = height(out, range, survey, chosen)? {
        let why = match range.fit_height_m {
            Some(_) => "the one at which the ranges fit best",
            None => "that of the anchors",
        };
        reasons.push(format!("height {} m: {why}", tidy(height_m)));
    }
    if let Some(bias) = range.fit_bias_m {
        let bias = tidy(bias);
        writeln!(
            out,
            "# Metres too long, of all anchors alike: with it the ranges of one moment fit best. Each anchor has its own; measure yours."
        )?;
        let heard = survey.anchors.iter().filter(|a| a.rows > 0);
        let each: Vec<String> = heard.map(|a| format!("{} = {bias}", key(&a.name))).collect();
        writeln!(out, "bias = {{ {} }}", each.join(", "))?;
        reasons.push(format!("bias {bias} m at every anchor: with it the ranges of one moment fit best"));
    }
    own_sd(out, range)?;
    guard(out, reasons, chosen)
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
