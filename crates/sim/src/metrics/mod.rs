//! How far trails are from the truth, and whether they know it.
//!
//! [`score`] compares trails with truth; [`nis`] judges a trail by its own innovations, without truth. Percentiles interpolate
//! linearly between order statistics: of n sorted values, the p-th stands at position p·(n − 1).

mod at_truth;
mod gauss;
mod histogram;
mod nis;
mod ranking;
mod row;
mod stats;

pub use at_truth::{Instant, Kind, Position, Predict, at_truth, gauss_markov, kinematic};
pub use gauss::nees;
pub use histogram::Histogram;
pub use nis::{Nis, nis};
pub use ranking::{Difference, Loss, Losses, Ranking, rank};
pub use row::{Consistency, Errors, ScoreRow};
pub use stats::{chi_square_quantile, mean_band95, student_quantile};

use fixtrail_track::layout::Layout;
use fixtrail_track::registry;
use fixtrail_track::spec::{ModelSpec, Spec};
use fixtrail_track::target::TargetTrail;
use fixtrail_track::trail::Trail;
use fixtrail_track::truth::TargetTruth;

/// Trails compared with truth.
#[derive(Clone, Debug, PartialEq)]
pub struct Score {
    /// The targets that have both a trail and truth, in the order of the trails.
    pub targets: Vec<TargetScore>,
    /// All instants of all targets taken together.
    pub overall: ScoreRow,
    /// Targets with truth but without a trail.
    pub without_trail: Vec<Option<String>>,
    /// Targets with a trail but without truth.
    pub without_truth: Vec<Option<String>>,
}

/// One target compared with truth.
#[derive(Clone, Debug, PartialEq)]
pub struct TargetScore {
    /// The target's id, as in the trail.
    pub target: Option<String>,
    /// Key figures.
    pub row: ScoreRow,
    /// The comparison instant by instant, in order of time.
    pub instants: Vec<Instant>,
}

/// Compares trails that `spec` makes with truth, carried between their fixes by the spec's own motion; otherwise as [`score`].
///
/// # Errors
/// As [`score`].
pub fn judge(spec: &Spec, kind: Kind, trails: &[TargetTrail], truth: &[TargetTruth]) -> Result<Score, String> {
    let layout = registry::layout(spec);
    let noise: &[f64] = match &spec.model {
        ModelSpec::GaussMarkov(stationary) => return score(trails, &layout, &gauss_markov(stationary), truth, kind),
        ModelSpec::Kinematic(k) => &k.noise,
        ModelSpec::Turn(t) => &t.noise,
        ModelSpec::Linear(_) => &[],
    };
    score(trails, &layout, &kinematic(&layout, noise), truth, kind)
}

/// Compares `trails` with `truth` at the truth instants.
///
/// `kind` says how to read a trail between its fixes and `predict` how to carry a fix forward ([`kinematic`] for chains of
/// integrators). Targets are matched by id; a single truth or trail without id matches a single partner of any id.
///
/// # Errors
/// One sentence when there is nothing to compare: a linear model, or no target in common.
pub fn score(
    trails: &[TargetTrail],
    layout: &Layout,
    predict: &Predict<'_>,
    truth: &[TargetTruth],
    kind: Kind,
) -> Result<Score, String> {
    if layout.is_linear() {
        return Err("the model is linear, expected one with positions to compare with truth".to_owned());
    }
    let lone_pair = trails.len() == 1 && truth.len() == 1 && (trails[0].target.is_none() || truth[0].target.is_none());
    let partner = |trail: &TargetTrail| truth.iter().position(|t| lone_pair || t.target == trail.target);

    let mut targets = Vec::new();
    let mut without_truth = Vec::new();
    let mut matched = vec![false; truth.len()];
    let mut all = Vec::new();
    for trail in trails {
        let Some(i) = partner(trail) else {
            without_truth.push(trail.target.clone());
            continue;
        };
        matched[i] = true;
        let instants = at_truth(&trail.trail, layout, predict, &truth[i], kind);
        let row = ScoreRow::new(&instants, nis([&trail.trail]));
        all.extend_from_slice(&instants);
        targets.push(TargetScore { target: trail.target.clone(), row, instants });
    }
    if targets.is_empty() {
        let names = |ids: Vec<&Option<String>>| match ids.first() {
            None => "nothing".to_owned(),
            Some(first) => {
                let first = first.as_deref().unwrap_or("(no id)");
                if ids.len() == 1 { format!("`{first}`") } else { format!("`{first}` and {} more", ids.len() - 1) }
            }
        };
        return Err(format!(
            "the trail and the truth have no target in common: the trail has {}, the truth {}",
            names(trails.iter().map(|t| &t.target).collect()),
            names(truth.iter().map(|t| &t.target).collect()),
        ));
    }
    let without_trail = truth.iter().zip(&matched).filter(|(_, m)| !**m).map(|(t, _)| t.target.clone()).collect();
    let scored: Vec<&Trail> = trails.iter().filter(|t| partner(t).is_some()).map(|t| &t.trail).collect();
    Ok(Score { targets, overall: ScoreRow::new(&all, nis(scored)), without_trail, without_truth })
}
