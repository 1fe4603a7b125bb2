//! What the measurements of one moment say together, kind by kind.

use super::fixes::{self, Moment, Sought};
use super::noise::{self, Samples};
use super::strengths::{self, Law, Site};
use super::{Geometry, TargetSurvey, stats};
use crate::anchors::Anchors;
use crate::packet::Kind;
use crate::target::TargetPackets;

/// What one kind says of places.
#[derive(Default)]
pub(super) struct KindFit {
    /// Whether the values settle the height.
    pub spatial: bool,
    pub sd: Option<f64>,
    pub height_m: Option<f64>,
    pub bias_m: Option<f64>,
    pub law: Option<Law>,
    pub psd: Option<f64>,
    pub speed: Option<f64>,
}

/// Another explanation of the misfit must leave this share of it at most.
const CLEARLY: f64 = 0.9;
/// Moments that the search for a height looks at.
const HEIGHT_MOMENTS: usize = 100;
/// Ranges within this many usual intervals count as of one moment where those of one are too few.
const NEARLY: f64 = 4.0;
/// A strength is averaged over this long, seconds.
const STRENGTH_S: f64 = 2.0;
/// Part of the anchors' spread by which targets are taken to be below them for strengths: close to an anchor the law is too steep to follow.
const BLUNT: f64 = 0.4;
/// A target that reports rarely keeps its velocity to this part of it between two reports.
const VEERS: f64 = 0.2;

/// Each target's moments of a kind.
struct Moments(Vec<Vec<Moment>>);

impl Moments {
    fn of(
        kind: Kind,
        targets: &[TargetPackets],
        surveyed: &[TargetSurvey],
        anchors: &Anchors,
        least: usize,
    ) -> Moments {
        let gather = |within_s: &dyn Fn(&TargetSurvey) -> f64| {
            let each = |(target, timing): (&TargetPackets, _)| {
                fixes::moments(&target.packets, kind, anchors, least, within_s(timing))
            };
            Moments(targets.iter().zip(surveyed).map(each).collect())
        };
        let usual_s = |t: &TargetSurvey| t.interval_s.map_or(0.0, |q| q.p50);
        if kind == Kind::Rssi {
            return gather(&|t| STRENGTH_S.max(2.0 * usual_s(t)));
        }
        // One report of each source; irregular sources must agree in time, or nearly so where that leaves too few.
        let strict = gather(&|t| t.period_s.map_or(0.0, |p| 0.9 * p));
        let rich = strict.all().filter(|m| m.reports.len() > least).count();
        if kind != Kind::Range || rich >= fixes::FEWEST_MOMENTS {
            return strict;
        }
        gather(&|t| NEARLY * usual_s(t))
    }

    fn all(&self) -> impl Iterator<Item = &Moment> {
        self.0.iter().flatten()
    }

    /// The misfit: the median over targets, or of all together where each has too few.
    fn sd(&self, sought: Sought) -> Option<f64> {
        let each = self.0.iter().filter_map(|m| fixes::residual_sd(m, sought));
        stats::median(each).or_else(|| fixes::residual_sd(&self.some(usize::MAX), sought))
    }

    fn some(&self, most: usize) -> Vec<Moment> {
        let stride = self.all().count().div_ceil(most).max(1);
        self.all().step_by(stride).cloned().collect()
    }
}

/// What `kind` says of places; nothing for kinds without anchors.
pub(super) fn fit(
    kind: Kind,
    targets: &[TargetPackets],
    surveyed: &[TargetSurvey],
    anchors: &Anchors,
    geometry: &Geometry,
) -> KindFit {
    let moments = |least| Moments::of(kind, targets, surveyed, anchors, least);
    match kind {
        Kind::Range => ranges(targets, geometry, moments),
        Kind::Rssi => strengths(&moments(1), anchors, geometry),
        Kind::Tdoa => differences(&moments(3), geometry),
        Kind::Bearing => {
            let moments = moments(3);
            let sought = Sought { kind, axes: 2, height_m: geometry.height_m, bias: false };
            with_motion(KindFit { sd: moments.sd(sought), ..KindFit::default() }, &moments, sought)
        }
        Kind::Position | Kind::Linear => KindFit::default(),
    }
}

fn ranges(targets: &[TargetPackets], geometry: &Geometry, moments: impl Fn(usize) -> Moments) -> KindFit {
    let range = |p: &crate::packet::Packet| match p.content {
        crate::packet::Content::Range { value_m, .. } => Some(value_m),
        _ => None,
    };
    let Some(typical_m) = stats::median(targets.iter().flat_map(|t| &t.packets).filter_map(range)) else {
        return KindFit::default();
    };
    let spatial = geometry.settles_height(typical_m);
    let axes = if spatial { 3 } else { 2 };
    let moments = moments(axes + 1);
    let sought = Sought { kind: Kind::Range, axes, height_m: geometry.height_m, bias: false };
    let mut found = KindFit { spatial, sd: moments.sd(sought), ..KindFit::default() };
    let Some(at_anchors) = found.sd else { return found };
    // Anchors hang at the ceiling or stand on masts: targets are rather below them than above, and the two look alike.
    let quarters = if spatial || geometry.is_plan() { 0 } else { 16 };
    for quarter in 1..=quarters {
        let height_m = geometry.height_m - 0.25 * f64::from(quarter);
        let best = found.sd.unwrap_or(at_anchors).min(CLEARLY * at_anchors);
        if let Some(sd) = moments.sd(Sought { height_m, ..sought }).filter(|sd| *sd < best) {
            found.sd = Some(sd);
            found.height_m = Some(height_m);
        }
    }
    // Reflections and delays make all ranges too long, which looks much like a height.
    if let Some(bias_m) = fixes::common_bias(&moments.some(usize::MAX), sought, at_anchors)
        && let Some(sd) = moments.sd(Sought { bias: true, ..sought })
        && sd < found.height_m.map_or(1.0, |_| CLEARLY) * found.sd.unwrap_or(at_anchors)
    {
        (found.sd, found.bias_m, found.height_m) = (Some(sd), Some(bias_m), None);
    }
    found
}

fn strengths(moments: &Moments, anchors: &Anchors, geometry: &Geometry) -> KindFit {
    let radios = moments.all().flat_map(|m| &m.reports).map(|r| r.anchor_m);
    let (mut low_m, mut high_m) = ([f64::MAX; 2], [f64::MIN; 2]);
    for radio in radios {
        for i in 0..2 {
            low_m[i] = low_m[i].min(radio[i]);
            high_m[i] = high_m[i].max(radio[i]);
        }
    }
    if anchors.is_empty() || low_m[0] > high_m[0] {
        return KindFit::default();
    }
    let height_m = geometry.height_m - BLUNT * geometry.plan_spread_m[0].hypot(geometry.plan_spread_m[1]);
    let law = strengths::law(&moments.some(usize::MAX), 2, &Site { low_m, high_m, height_m });
    KindFit { sd: law.map(|l| l.sd_db), height_m: Some(height_m), law, ..KindFit::default() }
}

fn differences(moments: &Moments, geometry: &Geometry) -> KindFit {
    let reports = || moments.all().flat_map(|m| &m.reports);
    let apart = stats::median(reports().filter_map(|r| Some((r.anchor_m - r.reference_m?).norm())));
    let Some(apart) = apart else { return KindFit::default() };
    let sought = Sought { kind: Kind::Tdoa, axes: 2, height_m: geometry.height_m, bias: false };
    let few = moments.some(HEIGHT_MOMENTS);
    let at = |height_m: f64| fixes::residual_sd(&few, Sought { height_m, ..sought });
    let at_anchors = at(geometry.height_m);
    let mut best: Option<(f64, f64)> = None;
    if let (Some(at_anchors), false) = (at_anchors, geometry.is_plan()) {
        // In a room targets are below the anchors, in a country above them; where both fit as well, that decides.
        let first = if apart < 1000.0 { -1.0 } else { 1.0 };
        for step in (1..=16).flat_map(|k| [first, -first].map(|side| side * f64::from(k))) {
            let height_m = geometry.height_m + 0.01 * apart * step;
            let least = best.map_or(CLEARLY * at_anchors, |(_, sd)| 0.98 * sd);
            if let Some(sd) = at(height_m).filter(|sd| *sd < least) {
                best = Some((height_m, sd));
            }
        }
    }
    let height_m = best.map(|(height_m, _)| height_m);
    let sought = Sought { height_m: height_m.unwrap_or(geometry.height_m), ..sought };
    with_motion(KindFit { sd: moments.sd(sought), height_m, ..KindFit::default() }, moments, sought)
}

/// Adds how the places that fit the moments move.
fn with_motion(mut found: KindFit, moments: &Moments, sought: Sought) -> KindFit {
    let (mut lively, mut speeds, mut intervals) = (Vec::new(), Vec::new(), Vec::new());
    for target in &moments.0 {
        let fixes: Vec<(f64, nalgebra::Vector3<f64>)> = target
            .iter()
            .filter_map(|m| Some((m.t_s, fixes::least_squares(&m.reports, sought, f64::INFINITY)?.place_m)))
            .collect();
        for pair in fixes.windows(2) {
            let dt_s = pair[1].0 - pair[0].0;
            speeds.push((pair[1].1 - pair[0].1).norm() / dt_s);
            intervals.push(dt_s);
        }
        for axis in 0..2 {
            let samples =
                Samples { t_s: fixes.iter().map(|f| f.0).collect(), value: fixes.iter().map(|f| f.1[axis]).collect() };
            lively.extend(noise::quick_sd(&samples).and_then(|sd| noise::liveliness(&samples, sd, 0.0)));
        }
    }
    let upper = |values: Vec<f64>| stats::quantile(&stats::ascending(values), 0.75);
    if lively.is_empty() {
        // Too few reports to see a bend: targets that are rarely heard are taken to veer a little in between.
        found.speed = stats::median(speeds);
        found.psd = found
            .speed
            .zip(stats::median(intervals))
            .map(|(speed, dt_s)| (VEERS * speed).powi(2) / dt_s)
            .filter(|psd| psd.is_finite());
    } else {
        found.psd = upper(lively.iter().map(|l| l.psd).collect());
        found.speed = upper(lively.iter().map(|l| l.speed).collect());
    }
    found
}
