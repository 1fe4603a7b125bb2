//! The charts of a page: each returns a figure with a caption that says how to read it, or nothing when there is nothing to draw.

pub mod cdf;
pub mod errors;
pub mod foretold;
pub mod nis;
pub mod plan;
pub mod states;
pub mod timeline;

use crate::svg::{Frame, TimeAxis};
use crate::{Page, Series};
use fixtrail_track::trail::Trail;
use maud::{Markup, html};

/// A chart over time of one target.
pub struct Detail<'a> {
    /// The page.
    pub page: &'a Page<'a>,
    /// The target.
    pub target: Option<&'a str>,
    /// Unique part of the ids of its figures.
    pub id: String,
    /// Its time axis.
    pub time: TimeAxis,
}

impl<'a> Detail<'a> {
    /// The charts of `target`, over the time of all its trails, packets and truth.
    pub fn new(page: &'a Page<'a>, target: Option<&'a str>, index: usize) -> Detail<'a> {
        let trails = || page.series.iter().filter_map(|s| s.trail(target));
        let time = if page.layout.is_linear() {
            TimeAxis::index(trails().filter_map(|t| t.k.last().copied()).max().unwrap_or(0))
        } else {
            let of_trails = trails().flat_map(|t| t.t_s.iter().flatten().copied());
            let of_packets = packets_of(page, target).iter().map(|p| p.t_s);
            let [low, high] = extent(of_trails.chain(of_packets));
            TimeAxis::seconds(if low.is_finite() { low } else { 0.0 }, if high.is_finite() { high } else { 1.0 })
        };
        Detail { page, target, id: index.to_string(), time }
    }

    /// The series that have a trail of the target, with their colour class.
    pub fn series(&self) -> impl Iterator<Item = (String, &'a Series<'a>, &'a Trail)> + '_ {
        let target = self.target;
        self.page.series.iter().enumerate().filter_map(move |(i, s)| Some((series_class(i), s, s.trail(target)?)))
    }

    /// Where row `row` of a trail stands on the time axis, in its units.
    pub fn at(&self, trail: &Trail, row: usize) -> Option<f64> {
        if self.page.layout.is_linear() { Some(trail.k[row] as f64) } else { trail.t_s[row].map(|t| self.time.of(t)) }
    }
}

/// The packets of a target; a lone nameless table belongs to a lone target.
pub fn packets_of<'a>(page: &Page<'a>, target: Option<&str>) -> &'a [fixtrail_track::packet::Packet] {
    let packets = page.packets;
    packets.iter().find(|t| t.target.as_deref() == target).map_or(&[], |t| &t.packets)
}

/// The class that colours a series.
pub fn series_class(index: usize) -> String {
    format!("s{}", index % COLOURS)
}

/// How many colours the style sheet has.
pub const COLOURS: usize = 8;

/// Smallest and largest of the finite values; infinite when there are none.
pub fn extent(values: impl IntoIterator<Item = f64>) -> [f64; 2] {
    values
        .into_iter()
        .filter(|v| v.is_finite())
        .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], v| [low.min(v), high.max(v)])
}

/// The value below which the fraction `p` of the finite `values` lies; 0 when there are none.
pub fn quantile(values: impl IntoIterator<Item = f64>, p: f64) -> f64 {
    let mut sorted: Vec<f64> = values.into_iter().filter(|v| v.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    sorted.get((p * sorted.len().saturating_sub(1) as f64).round() as usize).copied().unwrap_or(0.0)
}

/// Width, ends of the horizontal axis and class of a chart over time, half or all of the page wide.
pub fn size(wide: bool) -> (f64, [f64; 2], &'static str) {
    if wide { (Frame::WIDE, Frame::WIDE_X_PX, "wide time") } else { (Frame::WIDTH, Frame::X_PX, "time") }
}

/// A card with a heading, a chart and a caption.
pub fn figure(class: &str, title: &str, chart: &Markup, caption: &str) -> Markup {
    html! {
        figure class=(class) {
            h3 { (title) }
            (chart)
            figcaption { (caption) }
        }
    }
}
