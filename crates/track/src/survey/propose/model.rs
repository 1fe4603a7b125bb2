//! The motion of a proposal.

use super::LEAST_PSD;
use super::chosen::Chosen;
use super::text::{rounded, tidy};
use crate::survey::Survey;
use crate::survey::findings::short;
use core::fmt::Write as _;

/// What strengths are too coarse to show: a person or a vehicle indoors that mostly goes straight, m²/s³.
const STRENGTH_PSD: f64 = 0.05;
/// Its speed, m/s.
const STRENGTH_SPEED: f64 = 0.5;

pub(super) fn model(
    out: &mut String,
    reasons: &mut Vec<String>,
    survey: &Survey,
    chosen: &Chosen<'_>,
) -> core::fmt::Result {
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
