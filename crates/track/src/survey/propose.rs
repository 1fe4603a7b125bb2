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
/// What strengths are too coarse to show: a person or a vehicle indoors that mostly goes straight, m²/s³.
const STRENGTH_PSD: f64 = 0.05;
/// Its speed, m/s.
const STRENGTH_SPEED: f64 = 0.5;
/// Targets that are heard of less often than this, in the median, need what comes later to say where they were.
const FEW_INSTANTS: f64 = 4.0;
/// A satellite receiver smooths its fixes, so they jitter far less than they err, metres.
const LEAST_SATELLITE_SD: f64 = 1.5;
/// A position source of unknown make, metres.
const LEAST_POSITION_SD: f64 = 0.01;
/// Hardly moves at all: a drift of about 1 cm/s in a minute, m²/s³.
const LEAST_PSD: f64 = 1e-6;

/// The kinds that a proposal uses.
#[derive(Default)]
struct Chosen<'a> {
    position: Option<&'a KindSurvey>,
    heights: Option<&'a KindSurvey>,
    range: Option<&'a KindSurvey>,
    rssi: Option<&'a KindSurvey>,
    tdoa: Option<&'a KindSurvey>,
    bearing: Option<&'a KindSurvey>,
    /// The others, and why not.
    left_out: Vec<(&'a KindSurvey, &'static str)>,
}

impl<'a> Chosen<'a> {
    fn of(survey: &'a Survey) -> Result<Self, ProposeError> {
        let of = |kind: Kind| survey.kinds.iter().find(|k| k.kind == kind);
        if of(Kind::Linear).is_some() {
            return Err(ProposeError::Linear);
        }
        let mut chosen = Chosen {
            position: of(Kind::Position).filter(|k| !k.only_heights),
            heights: of(Kind::Position).filter(|k| k.only_heights),
            range: of(Kind::Range),
            tdoa: of(Kind::Tdoa),
            bearing: of(Kind::Bearing),
            ..Chosen::default()
        };
        let metric = chosen.position.is_some()
            || chosen.range.is_some_and(|k| k.anchors >= 3)
            || chosen.tdoa.is_some_and(|k| k.anchors >= 4)
            || chosen.bearing.is_some_and(|k| k.anchors >= 2);
        match of(Kind::Rssi) {
            Some(rssi) if metric => {
                chosen.left_out.push((rssi, "a strength says far less of a distance than what stands beside it"));
            }
            rssi => chosen.rssi = rssi,
        }
        let others = [chosen.position, chosen.range, chosen.rssi, chosen.tdoa, chosen.bearing];
        let used: Vec<&KindSurvey> = others.into_iter().flatten().collect();
        match used.as_slice() {
            [] if chosen.heights.is_some() => Err(ProposeError::Heights),
            [] => Err(ProposeError::Empty),
            [only] => {
                let least = match only.kind {
                    Kind::Rssi | Kind::Tdoa => 3,
                    Kind::Bearing => 2,
                    _ => 0,
                };
                match only.anchors < least {
                    true => Err(ProposeError::FewAnchors { kind: only.kind.name(), anchors: only.anchors, least }),
                    false => Ok(chosen),
                }
            }
            _ => Ok(chosen),
        }
    }

    /// Axes of the track: positions decide where there are any.
    fn axes(&self) -> usize {
        match self.heights {
            Some(_) => 3,
            None => self.position.or(self.range).map_or(2, |k| k.axes),
        }
    }

    /// Whether nothing but strengths says where targets are.
    fn strengths_alone(&self) -> bool {
        self.rssi.is_some() && [self.position, self.range, self.tdoa, self.bearing].iter().all(Option::is_none)
    }

    /// The kind that shows best how targets move.
    fn lively(&self) -> Option<&'a KindSurvey> {
        let all = || [self.position, self.range, self.tdoa, self.bearing, self.rssi].into_iter().flatten();
        all().find(|k| k.psd.is_some()).or_else(|| all().next())
    }

    /// How updates treat what does not fit.
    fn robust(&self) -> &'static str {
        if self.tdoa.is_some() { "redescending" } else { "huber" }
    }
}

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

fn model(out: &mut String, reasons: &mut Vec<String>, survey: &Survey, chosen: &Chosen<'_>) -> core::fmt::Result {
    let axes = chosen.axes();
    let lively = chosen.lively();
    let speed = lively.and_then(|k| k.speed);
    let kind = "constant-velocity";
    writeln!(out, "\n[model]\nkind = \"{kind}\"")?;
    let why = match (chosen.position, chosen.heights, axes) {
        (Some(_), _, 3) => "positions have a height that changes",
        (Some(_), ..) => "positions have no height, or one that never changes",
        (None, Some(_), _) => "heights are measured",
        (None, None, 3) => "the anchors stand at different enough heights to settle the target's",
        (None, None, _) => "the anchors do not settle a height",
    };
    writeln!(out, "axes = {axes}               # {why}")?;
    reasons.push(format!("model `{kind}`, {axes} axes: {why}"));
    if chosen.strengths_alone() {
        writeln!(
            out,
            "# Density of the acceleration noise, m²/s³: strengths are too coarse to show motion; this suits a person or a cart indoors\n\
             # that mostly goes straight. Larger follows turns faster, smaller is smoother.\n\
             noise = {STRENGTH_PSD:?}"
        )?;
        reasons.push(format!("noise {STRENGTH_PSD} m²/s³: strengths are too coarse to show motion, so that of a walk"));
        if let (2, Some(geometry)) = (axes, &survey.geometry) {
            let [x, y] = geometry.middle_m.map(tidy);
            let (place, speed) = (rounded(geometry.plan_spread_m[0].max(1.0).powi(2)), STRENGTH_SPEED.powi(2));
            writeln!(
                out,
                "# The start: somewhere among the anchors. Strengths alone have more than one place that fits, some far outside.\n\
                 x0 = [{x}, {y}, 0.0, 0.0]\n\
                 P0 = [[{place}, 0, 0, 0], [0, {place}, 0, 0], [0, 0, {speed:?}, 0], [0, 0, 0, {speed:?}]]"
            )?;
            reasons.push("start among the anchors: strengths alone have more than one place that fits".to_owned());
        }
        return Ok(());
    }
    let psd = lively.and_then(|k| k.psd);
    let plane = psd.unwrap_or(1.0).max(LEAST_PSD);
    match (psd, speed) {
        (Some(_), Some(speed)) => {
            writeln!(
                out,
                "# Density of the acceleration noise, m²/s³: from how much the data bend over the shortest time at which motion\n\
                 # outweighs noise; speeds reach about {} m/s. Larger follows turns faster, smaller is smoother.",
                short(speed)
            )?;
            reasons.push(format!(
                "noise {} m²/s³: from how much the data bend; speeds reach about {} m/s",
                rounded(plane),
                short(speed)
            ));
        }
        _ => {
            writeln!(
                out,
                "# Density of the acceleration noise, m²/s³: too few data to tell, 1 suits a walking person.\n\
                 # Larger follows turns faster, smaller is smoother."
            )?;
            reasons.push(format!("noise {} m²/s³: too few data to tell, as of a walking person", rounded(plane)));
        }
    }
    let height = lively.and_then(|k| k.psd_z).or(chosen.heights.and_then(|k| k.psd_z)).unwrap_or(plane).max(LEAST_PSD);
    if axes == 3 && (chosen.position.is_some() || chosen.heights.is_some()) {
        let (plane, height) = (rounded(plane), rounded(height));
        writeln!(out, "noise = [{plane}, {plane}, {height}]")
    } else {
        writeln!(out, "noise = {}", rounded(plane))
    }
}

fn height_sensor(out: &mut String, heights: &KindSurvey) -> core::fmt::Result {
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

fn rssi_sensor(
    out: &mut String,
    reasons: &mut Vec<String>,
    rssi: &KindSurvey,
    survey: &Survey,
    chosen: &Chosen<'_>,
) -> core::fmt::Result {
    writeln!(out, "\n[[sensor]]\nkind = \"rssi\"")?;
    let law = rssi.law.unwrap_or(super::Law { exponent: 2.0, at_1m_dbm: -50.0, sd_db: 6.0, fitted: false });
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

fn tdoa_sensor(
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

fn bearing_sensor(
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

/// A TOML key: bare where it may be.
fn key(name: &str) -> String {
    let bare = !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-');
    if bare { name.to_owned() } else { quoted(name) }
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
