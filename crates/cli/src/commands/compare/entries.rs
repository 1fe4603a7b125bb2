//! What each estimator made of the data, and what that cost it.

use crate::data::SpecText;
use crate::failure::Failure;
use crate::progress::Progress;
use crate::runs::{self, Tracked};
use crate::scores;
use fixtrail_batch::Table;
use fixtrail_sim::metrics::{Kind, Loss, Losses, Score, judge};
use fixtrail_track::error::BuildError;
use fixtrail_track::predictive;
use fixtrail_track::spec::{EstimatorSpec, Span};
use fixtrail_track::target::TargetTrail;
use fixtrail_track::trackers::LaggedMode;
use fixtrail_track::truth::TargetTruth;
use rayon::prelude::*;
use std::path::Path;

/// What estimators are measured by.
#[derive(Clone, Copy)]
pub enum Measure<'a> {
    /// Known positions, and where they come from.
    Truth {
        /// The table.
        path: &'a Path,
        /// What is in it.
        truth: &'a [TargetTruth],
    },
    /// How well the next measurements are foretold.
    Prediction,
}

/// What an estimate knows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Knows {
    /// The data up to its instant.
    Past,
    /// Data later than its instant, too.
    Later,
    /// The data up to its instant: the filter inside a smoother.
    OwnFilter,
}

/// One line of a comparison.
pub struct Entry {
    /// The estimator in its compact form.
    pub name: String,
    /// What its estimates know.
    pub knows: Knows,
    /// Its trails, one per target.
    pub trails: Vec<TargetTrail>,
    /// How long they took to make, by the clock.
    pub seconds: f64,
    /// The comparison with truth.
    pub score: Option<Score>,
    /// How well it foretold the measurements.
    pub foretold: Option<predictive::Score>,
    /// What each instant cost it, one list per target.
    pub losses: Vec<Losses>,
}

impl Entry {
    /// What to say beside the name.
    pub fn note(&self) -> &'static str {
        match self.knows {
            Knows::Past => "",
            Knows::Later => "uses later data",
            Knows::OwnFilter => "its filter alone",
        }
    }

    /// Microseconds by the clock for each instant of the trails.
    pub fn us_per_instant(&self) -> f64 {
        let instants: usize = self.trails.iter().map(|t| t.trail.len()).sum();
        1e6 * self.seconds / instants.max(1) as f64
    }
}

/// Tracks the table by a spec and measures what comes out: one entry, or two where a finite-memory filter has a smoother beside it.
///
/// # Errors
/// [`Failure::Run`] when a step cannot be taken, [`Failure::Bad`] when there is nothing in common with the truth.
pub fn entries(
    input: &str,
    table: &Table,
    spec: &SpecText,
    measure: Measure<'_>,
    bar: &Progress,
) -> Result<Vec<Entry>, Failure> {
    let estimator = &spec.spec.estimator;
    let name = estimator.compact();
    match measure {
        Measure::Prediction => {
            // Side by side the first half is the filter's.
            let mode = if estimator.is_smoother() { LaggedMode::Both } else { LaggedMode::Own };
            let tracked = runs::tracks(input, table, spec, mode, bar)?;
            let knows = if estimator.is_smoother() { Knows::OwnFilter } else { Knows::Past };
            Ok(vec![foretold(table, spec, name, knows, tracked)?])
        }
        Measure::Truth { path, truth } => {
            let mode = if has_lag(estimator) { LaggedMode::Both } else { LaggedMode::Own };
            let Tracked { trails, seconds } = runs::tracks(input, table, spec, mode, bar)?;
            let lagged = (mode == LaggedMode::Both).then(|| scores::smoothers(&trails));
            let entry = |name: String, kind: Kind, trails: Vec<TargetTrail>| {
                let score = judge(&spec.spec, kind, &trails, truth)
                    .map_err(|what| Failure::Bad(format!("{}: {what}", path.display())))?;
                let knows = if kind == Kind::Smoother { Knows::Later } else { Knows::Past };
                let losses = squared_errors(&score);
                Ok::<_, Failure>(Entry { name, knows, trails, seconds, score: Some(score), foretold: None, losses })
            };
            let mut entries = vec![entry(name.clone(), scores::kind(&spec.spec, mode), trails)?];
            if let Some(lagged) = lagged {
                entries.push(entry(format!("{name}, smoothed"), Kind::Smoother, lagged)?);
            }
            Ok(entries)
        }
    }
}

/// Whether a finite-memory filter is asked for its smoother.
fn has_lag(estimator: &EstimatorSpec) -> bool {
    match estimator {
        EstimatorSpec::Fms { lag, .. } => !matches!(lag, Span::Instants(0)) && *lag != Span::Seconds(0.0),
        _ => false,
    }
}

/// The squared distance to the truth at each of its instants.
fn squared_errors(score: &Score) -> Vec<Losses> {
    let of = |i: &fixtrail_sim::metrics::Instant| i.error_m().map(|e| Loss { t: i.t_s, sum: e * e, weight: 1.0 });
    score.targets.iter().map(|t| t.instants.iter().map(of).collect()).collect()
}

/// The entry of causal trails, by the log density of what they foretold: the negative sum over the scalars of each instant.
fn foretold(table: &Table, spec: &SpecText, name: String, knows: Knows, tracked: Tracked) -> Result<Entry, Failure> {
    let one = |(packets, trail): (&_, &TargetTrail)| -> Result<(predictive::Score, Losses), BuildError> {
        let mut score = predictive::Score::default();
        let mut losses: Losses = Vec::new();
        score.unforetold = predictive::each(&spec.spec, &table.anchors, packets, &trail.trail, None, &mut |told| {
            score.push(told);
            let k = told.k as usize;
            losses.resize(losses.len().max(k + 1), None);
            let t = told.t_s.unwrap_or(told.k as f64);
            let loss = losses[k].get_or_insert(Loss { t, sum: 0.0, weight: 0.0 });
            loss.sum -= told.log_density();
            loss.weight += 1.0;
        })?;
        Ok((score, losses))
    };
    let each: Vec<_> = table.targets.par_iter().zip(&tracked.trails).map(one).collect();
    let mut sum = predictive::Score::default();
    let mut losses = Vec::new();
    for made in each {
        let (score, of_target) = made.map_err(|e| spec.rename(e))?;
        sum.add(&score);
        losses.push(of_target);
    }
    let Tracked { trails, seconds } = tracked;
    Ok(Entry { name, knows, trails, seconds, score: None, foretold: Some(sum), losses })
}
