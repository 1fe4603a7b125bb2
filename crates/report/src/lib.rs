//! One self-contained page about a trail: an HTML file with tables and charts that loads nothing and opens offline.
//!
//! Fill a [`Page`] and [`render`] it, or [`render_comparison`] one whose series are estimators compared with one another;
//! [`render_reproduction`] makes the page of what comes of papers, [`render_simulation`] that of a scenario's runs. Every text that comes from a
//! user is escaped; equal pages give equal bytes.

mod charts;
mod comparison;
mod format;
mod link;
mod page;
mod reproduction;
mod simulation;
mod svg;
mod tables;

pub use comparison::{Comparison, Entry};
pub use page::{render, render_comparison};
pub use reproduction::render_reproduction;
pub use simulation::{Channel, Simulation, render_simulation};

use fixtrail_sim::metrics::Score;
use fixtrail_track::anchors::Anchors;
use fixtrail_track::layout::Layout;
use fixtrail_track::target::{TargetPackets, TargetTrail};
use fixtrail_track::theory::{Source, Theory};
use fixtrail_track::truth::TargetTruth;

/// What a page shows. Absent parts are empty slices; their charts are left out.
#[derive(Clone, Copy, Debug)]
pub struct Page<'a> {
    /// Heading of the page and of the browser's tab.
    pub title: &'a str,
    /// One line below it: what was tracked, with what.
    pub subtitle: &'a str,
    /// Remarks, one paragraph each.
    pub notes: &'a [String],
    /// Names and order of the state, the same for all series.
    pub layout: &'a Layout,
    /// One entry per estimator, in the order of the legend.
    pub series: &'a [Series<'a>],
    /// Where the targets really were.
    pub truth: &'a [TargetTruth],
    /// The fixed radios.
    pub anchors: &'a Anchors,
    /// What theory says of the error, and where the arrival rate in it comes from.
    pub theory: Option<&'a (Theory, Source)>,
    /// What arrived: positions are drawn in the plan, and every packet in the timeline.
    pub packets: &'a [TargetPackets],
}

/// One estimator's trails.
#[derive(Clone, Copy, Debug)]
pub struct Series<'a> {
    /// The estimator's name, as the legend shows it.
    pub name: &'a str,
    /// Its trails, one per target.
    pub trails: &'a [TargetTrail],
    /// Its comparison with truth.
    pub score: Option<&'a Score>,
}

impl<'a> Page<'a> {
    /// Every target of any series, in the order of the series.
    fn targets(&self) -> Vec<Option<&'a str>> {
        let mut out: Vec<Option<&str>> = Vec::new();
        let mut seen = std::collections::HashSet::new();
        for trail in self.series.iter().flat_map(|s| s.trails) {
            if seen.insert(trail.target.as_deref()) {
                out.push(trail.target.as_deref());
            }
        }
        out
    }

    /// The truth of a target; a lone one without a partner of its name belongs to a lone target.
    fn truth_of(&self, target: Option<&str>) -> Option<&'a TargetTruth> {
        let lone = self.truth.len() == 1 && self.series.iter().all(|s| s.trails.len() == 1);
        self.truth.iter().find(|t| t.target.as_deref() == target || (lone && (target.is_none() || t.target.is_none())))
    }
}

impl<'a> Series<'a> {
    fn trail(&self, target: Option<&str>) -> Option<&'a fixtrail_track::trail::Trail> {
        self.trails.iter().find(|t| t.target.as_deref() == target).map(|t| &t.trail)
    }

    fn target_score(&self, target: Option<&str>) -> Option<&'a fixtrail_sim::metrics::TargetScore> {
        self.score?.targets.iter().find(|t| t.target.as_deref() == target)
    }
}
