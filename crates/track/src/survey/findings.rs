//! What deserves attention in a survey, in sentences.

use super::{Finding, KindSurvey, Severity, Survey, TargetSurvey};
use crate::packet::Kind;

/// "target `T1`", or "the target" of a table without ids.
fn name(target: Option<&str>) -> String {
    target.map_or("the target".to_owned(), |t| format!("target `{t}`"))
}

/// "1 row", "2 rows".
fn count(n: u64, noun: &str) -> String {
    if n == 1 { format!("1 {noun}") } else { format!("{n} {noun}s") }
}

/// A number with about three significant digits.
pub(crate) fn short(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return format!("{value}");
    }
    let magnitude = value.abs().log10().floor() as i32;
    if !(-4..7).contains(&magnitude) {
        return format!("{value:.2e}");
    }
    let text = format!("{value:.*}", (2 - magnitude).max(0) as usize);
    match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => text,
    }
}

/// All findings, the worst first.
pub(super) fn findings(survey: &Survey) -> Vec<Finding> {
    let mut list = Vec::new();
    timing(survey, &mut list);
    order(survey, &mut list);
    anchors(survey, &mut list);
    for kind in &survey.kinds {
        values(kind, survey, &mut list);
    }
    list.sort_by_key(|f| core::cmp::Reverse(f.severity));
    list
}

fn add(list: &mut Vec<Finding>, severity: Severity, text: String) {
    list.push(Finding { severity, text });
}

fn timing(survey: &Survey, list: &mut Vec<Finding>) {
    for lonely in survey.targets.iter().filter(|t| t.instants < 2) {
        let text = format!("{} has {} only", name(lonely.target.as_deref()), count(lonely.instants, "instant"));
        add(list, Severity::Note, text);
    }
    if let Some(loss) = survey.loss.as_ref().filter(|l| l.lost > 0) {
        let percent = 100.0 * loss.rate();
        let mut text = format!(
            "the network lost {} % of the slots ({} of {}, by {})",
            short(percent),
            loss.lost,
            loss.expected,
            loss.basis.name()
        );
        if let (true, Some(mean), Some(geometric)) = (loss.is_bursty(), loss.mean_burst(), loss.geometric_mean_burst())
        {
            text += &format!(
                ", in bursts: {} packets in a row on average where independent losses would give {}, at worst {}",
                short(mean),
                short(geometric),
                loss.longest_burst
            );
        }
        add(list, if percent > 5.0 { Severity::Warning } else { Severity::Note }, text);
    }
    let silent: Vec<&TargetSurvey> = survey.targets.iter().filter(|t| t.silences.count > 0).collect();
    if let Some(worst) = silent.iter().max_by(|a, b| a.silences.longest_s.total_cmp(&b.silences.longest_s)) {
        let times: u64 = silent.iter().map(|t| t.silences.count).sum();
        let text = format!(
            "{} without any packet, the longest {} s at t = {} s, {}",
            count(times, "silence"),
            short(worst.silences.longest_s),
            short(worst.silences.longest_at_s),
            name(worst.target.as_deref())
        );
        add(list, Severity::Note, text);
    }
    let irregular = survey.targets.iter().filter(|t| t.period_s.is_none() && t.instants > 8).count();
    if irregular > 0 && survey.kinds.iter().any(|k| k.kind != Kind::Linear) {
        let of = survey.targets.len();
        let whose =
            if of == 1 { "reports come".to_owned() } else { format!("reports of {irregular} of {of} targets come") };
        add(list, Severity::Note, format!("{whose} at no fixed rate, so their losses cannot be told"));
    }
}

fn order(survey: &Survey, list: &mut Vec<Finding>) {
    if survey.duplicates > 0 {
        let text = format!(
            "{} an earlier one's measurement and will be used once",
            match survey.duplicates {
                1 => "1 row repeats".to_owned(),
                n => format!("{n} rows repeat"),
            }
        );
        add(list, Severity::Note, text);
    }
    let worst =
        survey.targets.iter().map(|t| t.late).max_by(|a, b| a.worst_s.total_cmp(&b.worst_s)).unwrap_or_default();
    let overtaken: u64 = survey.targets.iter().map(|t| t.late.overtaken).sum();
    if overtaken > 0 {
        let text = format!(
            "{} arrived after a newer packet, up to {} s late: a live run needs `late_s = {}` to use all of them",
            count(overtaken, "packet"),
            short(worst.worst_s),
            worst.needed_late_s()
        );
        add(list, Severity::Note, text);
    } else if survey.disordered > 0 {
        let rows = match survey.disordered {
            1 => "1 row is".to_owned(),
            n => format!("{n} rows are"),
        };
        add(list, Severity::Note, format!("{rows} older than a row of the same target above: they are sorted first"));
    }
    let delays = survey.targets.iter().filter_map(|t| t.late.delay_s);
    if let Some(lowest) = delays.map(|d| d.min).min_by(f64::total_cmp).filter(|d| *d < 0.0) {
        let text = format!(
            "packets were received up to {} s before they were sensed: the two clocks disagree",
            short(-lowest)
        );
        add(list, Severity::Warning, text);
    }
}

fn anchors(survey: &Survey, list: &mut Vec<Finding>) {
    let Some(geometry) = &survey.geometry else { return };
    let unheard: Vec<&str> = survey.anchors.iter().filter(|a| a.rows == 0).map(|a| a.name.as_str()).collect();
    if !unheard.is_empty() {
        let shown = unheard.iter().take(8).map(|n| format!("`{n}`")).collect::<Vec<_>>().join(", ");
        let more = if unheard.len() > 8 { ", …" } else { "" };
        add(
            list,
            Severity::Note,
            format!(
                "{} never heard: {shown}{more}",
                match unheard.len() {
                    1 => "1 anchor was".to_owned(),
                    n => format!("{n} anchors were"),
                }
            ),
        );
    }
    let distances = |k: &&KindSurvey| matches!(k.kind, Kind::Range | Kind::Rssi);
    let Some(kind) = survey.kinds.iter().find(distances) else { return };
    if survey.kinds.iter().any(|k| !distances(&k) && !k.only_heights) {
        return;
    }
    match geometry.count {
        0..=2 => add(
            list,
            Severity::Problem,
            format!(
                "{} to {} do not settle a position, three are needed",
                if kind.kind == Kind::Range { "ranges" } else { "strengths" },
                count(geometry.count as u64, "anchor")
            ),
        ),
        _ if geometry.is_collinear() => add(
            list,
            Severity::Problem,
            format!(
                "the {} anchors stand on one line (to {} m): a target to its left and one to its right look alike",
                geometry.count,
                short(geometry.plan_spread_m[1])
            ),
        ),
        _ if geometry.is_coplanar() => add(
            list,
            Severity::Note,
            format!(
                "the {} anchors stand in one plane (to {} m): ranges do not tell above from below, so tracks are planar",
                geometry.count,
                short(geometry.spread_m[2])
            ),
        ),
        _ => {}
    }
}

fn values(kind: &KindSurvey, survey: &Survey, list: &mut Vec<Finding>) {
    let unit = kind.kind.unit();
    if let Some(worst) = &kind.worst_outlier {
        let share = 100.0 * kind.outliers as f64 / kind.rows as f64;
        let anchor =
            worst.anchor.and_then(|id| survey.anchors.get(id as usize)).map(|a| format!(", anchor `{}`", a.name));
        let text = format!(
            "{} of kind `{}` ({} %) {} far from both neighbours, the worst by {} {unit} at t = {} s, {}{}",
            count(kind.outliers, "value"),
            kind.kind.name(),
            short(share),
            if kind.outliers == 1 { "lies" } else { "lie" },
            short(worst.off),
            short(worst.t_s),
            name(worst.target.as_deref()),
            anchor.unwrap_or_default()
        );
        // Strengths fade.
        let robust = kind.kind == Kind::Rssi;
        add(list, if share > 0.1 && !robust { Severity::Warning } else { Severity::Note }, text);
    }
    if let Some(bias) = kind.fit_bias_m {
        let text =
            format!("ranges are {} m too long at all anchors, as far as they can tell by themselves", short(bias));
        add(list, Severity::Note, text);
    }
    if let (Kind::Range, Some(quick), Some(fit)) = (kind.kind, kind.quick_sd, kind.fit_sd)
        && fit > 2.0 * quick
    {
        let text = format!(
            "ranges jitter by {} m only but miss a common point by {} m: anchors have biases, or stand elsewhere than their table says",
            short(quick),
            short(fit)
        );
        add(list, Severity::Warning, text);
    }
}
