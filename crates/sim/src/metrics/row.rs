//! Key figures of a comparison, and the verdict.

use super::at_truth::Instant;
use super::nis::Nis;
use super::stats::{mean_band95, percentile};

/// Key figures of one target, or of all.
#[derive(Clone, Debug, PartialEq)]
pub struct ScoreRow {
    /// Truth instants with an estimate to compare.
    pub instants: usize,
    /// Truth instants without one: before the first fix, or while the state is unobservable.
    pub missing: usize,
    /// Truth instants that lack a coordinate of the plane; they count in neither of the above.
    pub incomplete: usize,
    /// Sizes of the errors; `None` when `instants` is 0.
    pub errors: Option<Errors>,
    /// Fraction of the instants whose true position is inside the claimed 95 % ellipse.
    pub coverage95: Option<f64>,
    /// Mean of the position's normalised estimation error squared (NEES); `nees_dof` is expected. `None` also when a
    /// covariance is singular, which makes it infinite.
    pub mean_nees: Option<f64>,
    /// Coordinates compared: the degrees of freedom of one NEES value.
    pub nees_dof: usize,
    /// Central 95 % interval of `mean_nees` for a consistent filter if the instants were independent. Errors at neighbouring
    /// truth instants are correlated, so the mean of a consistent filter spreads wider than this.
    pub nees_band95: Option<(f64, f64)>,
    /// Innovation statistics of the trail, which need no truth.
    pub nis: Option<Nis>,
    /// What `coverage95` and `mean_nees` amount to.
    pub consistency: Consistency,
    /// The same in one sentence.
    pub verdict: String,
}

/// Distances between estimate and truth in the plane (or on the line, for one axis), metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Errors {
    /// Root of the mean square.
    pub rmse_m: f64,
    /// Mean.
    pub mean_m: f64,
    /// Median.
    pub p50_m: f64,
    /// 60 % are smaller.
    pub p60_m: f64,
    /// 90 % are smaller.
    pub p90_m: f64,
    /// 95 % are smaller.
    pub p95_m: f64,
    /// Largest.
    pub max_m: f64,
    /// Mean of estimate less truth along x and y: what averaging does not remove.
    pub bias_m: [f64; 2],
    /// Root mean square in three dimensions, where both have a height.
    pub rmse_3d_m: Option<f64>,
}

/// Whether claimed and real errors agree.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Consistency {
    /// Errors are larger than claimed.
    OverConfident,
    /// Errors are as claimed.
    Consistent,
    /// Errors are smaller than claimed.
    UnderConfident,
    /// Nothing to compare.
    NotJudged,
}

/// More than twice the 5 % that may lie outside.
const TOO_MANY_OUTSIDE: f64 = 0.10;
/// Claimed variances this much too small (beyond what chance explains) are called over-confident.
const NEES_TOO_LARGE: f64 = 1.5;
/// Claimed variances twice too large are called under-confident.
const NEES_TOO_SMALL: f64 = 0.5;

impl ScoreRow {
    pub(super) fn new(all: &[Instant], nis: Option<Nis>) -> ScoreRow {
        let compared: Vec<&Instant> = all.iter().filter(|i| i.error_m().is_some()).collect();
        let incomplete = all.iter().filter(|i| i.incomplete).count();
        let n = compared.len();
        let dof = compared.first().map_or(0, |i| i.dof);
        let mean = |f: &dyn Fn(&Instant) -> f64| compared.iter().map(|i| f(i)).sum::<f64>() / n as f64;
        let coverage95 = (n > 0).then(|| mean(&|i| f64::from(u8::from(i.inside95()))));
        let mean_nees = (n > 0).then(|| mean(&|i| i.nees.unwrap_or(f64::INFINITY))).filter(|m| m.is_finite());
        let nees_band95 = mean_band95(n, dof);
        let consistency = judge(coverage95, mean_nees, dof, nees_band95);
        let verdict = sentence(consistency, coverage95, mean_nees, dof);
        ScoreRow {
            instants: n,
            missing: all.len() - n - incomplete,
            incomplete,
            errors: Errors::new(&compared),
            coverage95,
            mean_nees,
            nees_dof: dof,
            nees_band95,
            nis,
            consistency,
            verdict,
        }
    }
}

impl Errors {
    fn new(compared: &[&Instant]) -> Option<Errors> {
        let mut sorted: Vec<f64> = compared.iter().filter_map(|i| i.error_m()).collect();
        sorted.sort_by(f64::total_cmp);
        let max_m = *sorted.last()?;
        let n = sorted.len() as f64;
        let squares_3d: Vec<f64> = compared.iter().filter_map(|i| i.error_3d_m).map(|e| e * e).collect();
        let bias = |axis: usize| compared.iter().map(|i| i.offset_m.map_or(0.0, |o| o[axis])).sum::<f64>() / n;
        Some(Errors {
            rmse_m: (sorted.iter().map(|e| e * e).sum::<f64>() / n).sqrt(),
            mean_m: sorted.iter().sum::<f64>() / n,
            p50_m: percentile(&sorted, 0.5),
            p60_m: percentile(&sorted, 0.6),
            p90_m: percentile(&sorted, 0.9),
            p95_m: percentile(&sorted, 0.95),
            max_m,
            bias_m: [bias(0), bias(1)],
            rmse_3d_m: (!squares_3d.is_empty())
                .then(|| (squares_3d.iter().sum::<f64>() / squares_3d.len() as f64).sqrt()),
        })
    }
}

fn judge(coverage: Option<f64>, nees: Option<f64>, dof: usize, band: Option<(f64, f64)>) -> Consistency {
    let (Some(coverage), Some((low, high))) = (coverage, band) else { return Consistency::NotJudged };
    // Without a mean NEES a covariance is singular: certain of itself and wrong.
    let nees = nees.unwrap_or(f64::INFINITY);
    let by_chance = (low..=high).contains(&nees);
    let ratio = nees / dof as f64;
    if by_chance {
        Consistency::Consistent
    } else if nees > high && (1.0 - coverage > TOO_MANY_OUTSIDE || ratio > NEES_TOO_LARGE) {
        Consistency::OverConfident
    } else if ratio < NEES_TOO_SMALL {
        Consistency::UnderConfident
    } else {
        Consistency::Consistent
    }
}

fn sentence(consistency: Consistency, coverage: Option<f64>, nees: Option<f64>, dof: usize) -> String {
    let region = if dof == 1 { "interval" } else { "ellipse" };
    let inside = 100.0 * coverage.unwrap_or(0.0);
    let ratio = nees.map_or(f64::INFINITY, |m| m / dof.max(1) as f64);
    match consistency {
        Consistency::OverConfident if 100.0 - inside > 100.0 * TOO_MANY_OUTSIDE => format!(
            "over-confident: the true position leaves the claimed 95 % {region} in {:.0} % of instants",
            100.0 - inside
        ),
        Consistency::OverConfident if ratio.is_finite() => format!(
            "over-confident at its worst: {inside:.0} % of instants are inside the claimed 95 % {region}, but squared errors \
             are {ratio:.1} times what is claimed"
        ),
        Consistency::OverConfident => "over-confident: it claims to know a position exactly and is wrong".to_owned(),
        Consistency::Consistent => {
            format!("consistent: the true position is inside the claimed 95 % {region} in {inside:.0} % of instants")
        }
        Consistency::UnderConfident => {
            format!("under-confident: squared errors are {ratio:.2} times what is claimed")
        }
        Consistency::NotJudged => "not judged: no truth instant has an estimate".to_owned(),
    }
}
