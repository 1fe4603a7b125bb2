//! What the data look like before any filter sees them: rate, losses, silences, repeats, noise, anchors.
//!
//! [`survey`](fn@survey) looks at packets and says what it finds; [`propose`] turns that into a commented spec.

mod findings;
mod fixes;
mod geometry;
mod kinds;
mod loss;
mod noise;
mod propose;
mod series;
mod stats;
mod strengths;
mod timing;

#[cfg(test)]
mod tests;

pub(crate) use findings::short;
pub use geometry::Geometry;
pub use loss::{Basis, Loss, MAX_BURST};
pub use propose::{Circumstances, Proposal, ProposeError, propose};
pub use stats::Quantiles;
pub use strengths::Law;
pub use timing::{Late, Silences};

use crate::anchors::Anchors;
use crate::packet::{AnchorId, Content, Kind, Packet};
use crate::target::TargetPackets;
use kinds::KindFit;
use noise::{Liveliness, Samples};
use std::collections::BTreeMap;

/// What the data look like.
#[derive(Clone, Debug, PartialEq)]
pub struct Survey {
    /// Number of rows.
    pub rows: u64,
    /// Each target, in the order given.
    pub targets: Vec<TargetSurvey>,
    /// Each kind of measurement.
    pub kinds: Vec<KindSurvey>,
    /// Every anchor, in the order of their ids.
    pub anchors: Vec<AnchorSurvey>,
    /// How the anchors that were heard stand.
    pub geometry: Option<Geometry>,
    /// Losses of all targets together, where they can be told.
    pub loss: Option<Loss>,
    /// Rows that repeat another.
    pub duplicates: u64,
    /// Rows older than a row above them.
    pub disordered: u64,
    /// What deserves attention, in sentences, the worst first.
    pub findings: Vec<Finding>,
}

/// One target.
#[derive(Clone, Debug, PartialEq)]
pub struct TargetSurvey {
    /// Its id.
    pub target: Option<String>,
    /// Number of rows.
    pub rows: u64,
    /// Number of instants with at least one row.
    pub instants: u64,
    /// First instant, seconds.
    pub start_s: f64,
    /// Last instant, seconds.
    pub end_s: f64,
    /// Intervals between instants, seconds; `None` with fewer than two.
    pub interval_s: Option<Quantiles>,
    /// The usual interval between two reports of one source, seconds; `None` when reports are irregular.
    pub period_s: Option<f64>,
    /// Times without any packet.
    pub silences: Silences,
    /// Losses, where they can be told.
    pub loss: Option<Loss>,
    /// Rows that repeat another.
    pub duplicates: u64,
    /// Rows that came late.
    pub late: Late,
}

/// One kind of measurement over all targets.
#[derive(Clone, Debug, PartialEq)]
pub struct KindSurvey {
    /// The kind.
    pub kind: Kind,
    /// Number of rows.
    pub rows: u64,
    /// Number of rows that bring their own standard deviation.
    pub with_sd: u64,
    /// Median magnitude of the value: how far the target usually is, for a range.
    pub typical: Option<f64>,
    /// Standard deviation of the quick part of the noise; of the noisiest horizontal coordinate for a position.
    pub quick_sd: Option<f64>,
    /// The same of the height of a position.
    pub quick_sd_z: Option<f64>,
    /// Number of anchors that its rows name.
    pub anchors: usize,
    /// Standard deviation about the points that fit the measurements of one moment best.
    pub fit_sd: Option<f64>,
    /// Planar ranges and time differences: the height of the target at which they fit best, where that is clearly better than the anchors' height.
    pub fit_height_m: Option<f64>,
    /// Range: by how much all of them are too long, where that explains them best.
    pub fit_bias_m: Option<f64>,
    /// Signal strength: the law of its loss.
    pub law: Option<Law>,
    /// Position: whether all of them are heights alone.
    pub only_heights: bool,
    /// 95 % quantile of the speed: of approach for a range, over ground for a position.
    pub speed: Option<f64>,
    /// Power spectral density of the acceleration per axis, unit²/s³.
    pub psd: Option<f64>,
    /// The same of the height of a position.
    pub psd_z: Option<f64>,
    /// Values that stand out alone from their neighbours.
    pub outliers: u64,
    /// The worst of them.
    pub worst_outlier: Option<Outlier>,
    /// Position: number of coordinates that say something (2 when there is no height or it never changes).
    pub axes: usize,
}

/// A value far from its neighbours.
#[derive(Clone, Debug, PartialEq)]
pub struct Outlier {
    /// The target.
    pub target: Option<String>,
    /// The anchor.
    pub anchor: Option<AnchorId>,
    /// When.
    pub t_s: f64,
    /// How far from the line between its neighbours.
    pub off: f64,
}

/// One anchor.
#[derive(Clone, Debug, PartialEq)]
pub struct AnchorSurvey {
    /// Its name.
    pub name: String,
    /// Rows that name it.
    pub rows: u64,
    /// Share of all rows that name an anchor.
    pub share: f64,
}

/// How bad a finding is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// Worth knowing.
    Note,
    /// Makes the trail worse than it need be.
    Warning,
    /// Makes the trail wrong or impossible.
    Problem,
}

impl Severity {
    /// The word for it.
    pub fn name(self) -> &'static str {
        match self {
            Severity::Note => "note",
            Severity::Warning => "warning",
            Severity::Problem => "problem",
        }
    }
}

/// One thing that deserves attention.
#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
    /// How bad it is.
    pub severity: Severity,
    /// What it is: one sentence.
    pub text: String,
}

/// A value this many usual deviations from its neighbours is no noise: one in 10¹⁵ if it were normal.
const OUTLIER_DEVIATIONS: f64 = 8.0;

/// Looks at all packets. `anchors` are those that the packets name by id.
pub fn survey(targets: &[TargetPackets], anchors: &Anchors) -> Survey {
    let split: Vec<_> = targets.iter().map(|t| series::split(&t.packets)).collect();
    let surveyed: Vec<TargetSurvey> =
        targets.iter().zip(&split).map(|(target, sources)| survey_target(target, sources)).collect();
    let heard = anchor_rows(targets, anchors);
    let ids: Vec<AnchorId> = (0..anchors.len() as AnchorId).filter(|id| heard[*id as usize] > 0).collect();
    let geometry = Geometry::of(anchors, &ids);
    let fit = |kind| geometry.as_ref().map(|g| kinds::fit(kind, targets, &surveyed, anchors, g)).unwrap_or_default();
    let kinds: Vec<KindSurvey> =
        Kind::NAMES.iter().filter_map(|(_, kind)| survey_kind(*kind, targets, &split, fit)).collect();
    let total: u64 = heard.iter().sum();
    let mut loss: Option<Loss> = None;
    for one in surveyed.iter().filter_map(|t| t.loss.as_ref()) {
        loss.get_or_insert_with(|| Loss::new(one.basis)).add(one);
    }
    let mut survey = Survey {
        rows: surveyed.iter().map(|t| t.rows).sum(),
        duplicates: surveyed.iter().map(|t| t.duplicates).sum(),
        disordered: surveyed.iter().map(|t| t.late.disordered).sum(),
        targets: surveyed,
        kinds,
        anchors: (0..anchors.len())
            .map(|i| AnchorSurvey {
                name: anchors.names()[i].clone(),
                rows: heard[i],
                share: if total == 0 { 0.0 } else { heard[i] as f64 / total as f64 },
            })
            .collect(),
        geometry,
        loss,
        findings: Vec::new(),
    };
    survey.findings = findings::findings(&survey);
    survey
}

impl Survey {
    /// The usual interval between the instants of a target, seconds: the median over targets, of the period where reports are regular.
    pub fn usual_interval_s(&self) -> Option<f64> {
        stats::median(self.targets.iter().filter_map(|t| t.period_s.or_else(|| t.interval_s.map(|q| q.p50))))
    }

    /// The survey with what was seen of the rows before they were sorted: a table that holds no row twice any more had
    /// `duplicates` of them, and `disordered` rows older than a row above.
    pub fn with_table_counts(mut self, duplicates: u64, disordered: u64) -> Survey {
        self.duplicates += duplicates;
        self.disordered += disordered;
        self.findings = findings::findings(&self);
        self
    }
}

fn survey_target(target: &TargetPackets, sources: &BTreeMap<series::Source, series::Series>) -> TargetSurvey {
    let instants = timing::instants(&target.packets);
    let interval_s = timing::intervals(&instants);
    let periods = sources.values().filter_map(|s| loss::period(&s.t_s));
    let period_s = periods.fold(None, |longest: Option<f64>, p| Some(longest.map_or(p, |l| l.max(p))));
    TargetSurvey {
        target: target.target.clone(),
        rows: target.packets.len() as u64,
        instants: instants.len() as u64,
        start_s: instants.first().copied().unwrap_or(0.0),
        end_s: instants.last().copied().unwrap_or(0.0),
        silences: interval_s.as_ref().map_or_else(Silences::default, |q| timing::silences(&instants, q, period_s)),
        interval_s,
        period_s,
        loss: timing::losses(&target.packets, sources),
        duplicates: timing::duplicates(&target.packets),
        late: timing::late(&target.packets),
    }
}

/// Rows that name each anchor.
fn anchor_rows(targets: &[TargetPackets], anchors: &Anchors) -> Vec<u64> {
    let mut rows = vec![0; anchors.len()];
    for packet in targets.iter().flat_map(|t| &t.packets) {
        let source = series::source(&packet.content);
        for id in [source.anchor, source.reference].into_iter().flatten() {
            if let Some(count) = rows.get_mut(id as usize) {
                *count += 1;
            }
        }
    }
    rows
}

impl KindSurvey {
    /// Standard deviation of errors that neighbouring rows share: what misfit there is beyond jitter.
    pub fn lasting_sd(&self) -> Option<f64> {
        lasting_sd(self.fit_sd, self.quick_sd)
    }
}

fn lasting_sd(fit_sd: Option<f64>, quick_sd: Option<f64>) -> Option<f64> {
    Some((fit_sd?.powi(2) - quick_sd?.powi(2)).max(0.0).sqrt())
}

/// What one series says of its noise and motion.
struct SeriesSurvey {
    sd: Option<f64>,
    live: Option<Liveliness>,
}

fn survey_kind(
    kind: Kind,
    targets: &[TargetPackets],
    split: &[BTreeMap<series::Source, series::Series>],
    fit: impl Fn(Kind) -> KindFit,
) -> Option<KindSurvey> {
    let of_kind = |p: &&Packet| p.content.kind() == kind;
    let rows = targets.iter().flat_map(|t| &t.packets).filter(of_kind).count() as u64;
    if rows == 0 {
        return None;
    }
    let mut found = KindSurvey {
        kind,
        rows,
        with_sd: targets.iter().flat_map(|t| &t.packets).filter(|p| of_kind(p) && p.sd.is_some()).count() as u64,
        typical: None,
        quick_sd: None,
        quick_sd_z: None,
        anchors: 0,
        fit_sd: None,
        fit_height_m: None,
        fit_bias_m: None,
        law: None,
        only_heights: false,
        speed: None,
        psd: None,
        psd_z: None,
        outliers: 0,
        worst_outlier: None,
        axes: 2,
    };
    if kind == Kind::Linear {
        return Some(found);
    }
    let fit = fit(kind);
    let fit_sd = fit.sd.filter(|_| kind == Kind::Range);
    let sources = split.iter().flat_map(|s| s.keys()).filter(|s| s.kind == kind);
    let heard: std::collections::BTreeSet<AnchorId> = sources.flat_map(|s| [s.anchor, s.reference]).flatten().collect();
    found.anchors = heard.len();
    let is_height = |p: &Packet| matches!(p.content, Content::Position([None, None, _]));
    found.only_heights =
        kind == Kind::Position && targets.iter().flat_map(|t| &t.packets).filter(of_kind).all(is_height);
    let mut magnitudes = Vec::new();
    let mut columns: [Vec<SeriesSurvey>; 3] = Default::default();
    for (target, sources) in targets.iter().zip(split) {
        for (source, series) in sources.iter().filter(|(s, _)| s.kind == kind) {
            for (axis, values) in series.values.iter().enumerate().take(3) {
                let samples = Samples::of(&series.t_s, values);
                if kind == Kind::Position && axis == 2 && samples.value.windows(2).any(|w| w[0] != w[1]) {
                    found.axes = 3;
                }
                magnitudes.extend(samples.value.iter().map(|v| v.abs()));
                let sd = noise::quick_sd(&samples);
                let live =
                    sd.and_then(|sd| noise::liveliness(&samples, sd, lasting_sd(fit_sd, Some(sd)).unwrap_or(0.0)));
                for (i, off) in noise::outliers(&samples, sd.unwrap_or(0.0), OUTLIER_DEVIATIONS) {
                    found.outliers += 1;
                    if found.worst_outlier.as_ref().is_none_or(|w| off.abs() > w.off.abs()) {
                        let (target, anchor) = (target.target.clone(), source.anchor);
                        found.worst_outlier = Some(Outlier { target, anchor, t_s: samples.t_s[i], off });
                    }
                }
                columns[axis].push(SeriesSurvey { sd, live });
            }
        }
    }
    // Among many series the lively quarter decides: most ships lie in port, the others are the ones to be followed.
    let upper = |columns: &[&SeriesSurvey], what: &dyn Fn(&SeriesSurvey) -> Option<f64>, p: f64| {
        stats::quantile(&stats::ascending(columns.iter().filter_map(|s| what(s))), p)
    };
    let plane: Vec<&SeriesSurvey> = columns[0].iter().chain(&columns[1]).collect();
    let height: Vec<&SeriesSurvey> = columns[2].iter().collect();
    found.typical = stats::median(magnitudes);
    found.fit_sd = fit.sd;
    found.fit_height_m = fit.height_m;
    found.fit_bias_m = fit.bias_m;
    found.law = fit.law;
    if fit.spatial {
        found.axes = 3;
    }
    found.quick_sd = upper(&plane, &|s| s.sd, 0.75);
    found.quick_sd_z = upper(&height, &|s| s.sd, 0.75);
    found.psd = upper(&plane, &|s| s.live.map(|l| l.psd), 0.75);
    found.psd_z = upper(&height, &|s| s.live.map(|l| l.psd), 0.75);
    found.speed = upper(&plane, &|s| s.live.map(|l| l.speed), 0.75);
    if !matches!(kind, Kind::Position | Kind::Range) {
        // A strength or a difference does not say how the target moves, the places that they fit do.
        (found.psd, found.speed) = (fit.psd, fit.speed);
    }
    Some(found)
}
