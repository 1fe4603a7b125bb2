//! The path loss of signal strengths, from strengths alone.
//!
//! Every target is somewhere among the anchors: for each exponent, the places of a grid that fit the moments best and the level that fits
//! the places best are found in turn, with limited pull; the exponent that leaves the least cost is taken.

use super::fixes::Moment;
use super::stats::{median, robust_sd};
use nalgebra::Vector3;

/// Exponents tried: corridors guide waves, walls stop them.
const EXPONENTS: [f64; 4] = [1.5, 2.0, 2.5, 3.0];
/// Exponent of free space, where nothing can be fitted.
const FREE_SPACE: f64 = 2.0;
/// Shadowing of the usual radios indoors, dB.
const USUAL_SHADOWING_DB: f64 = 6.0;
/// Places along each side of the anchors' bounding box, and how far it reaches beyond the anchors.
const SIDE: usize = 17;
const BEYOND: f64 = 0.1;
/// Fewer moments than this fit anything.
const FEWEST: usize = 10;
const MOST: usize = 200;
const ROUNDS: usize = 8;
/// Where the pull of a residual is limited, in deviations.
const HUBER: f64 = 1.345;

/// The log-distance law that the strengths suggest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Law {
    /// Exponent of the distance.
    pub exponent: f64,
    /// Strength at one metre, dBm.
    pub at_1m_dbm: f64,
    /// Standard deviation about it, dB.
    pub sd_db: f64,
    /// Whether the data settled the exponent; otherwise it is that of free space.
    pub fitted: bool,
}

/// Bounds of the places where targets may be, metres.
#[derive(Clone, Copy, Debug)]
pub(super) struct Site {
    pub low_m: [f64; 2],
    pub high_m: [f64; 2],
    /// Height at which targets are taken to be.
    pub height_m: f64,
}

impl Site {
    fn places(&self) -> Vec<Vector3<f64>> {
        let span = (0..2).map(|i| self.high_m[i] - self.low_m[i]).fold(0.0, f64::max);
        let at = |i: usize, k: usize| {
            let (low, high) = (self.low_m[i] - BEYOND * span, self.high_m[i] + BEYOND * span);
            low + (high - low) * k as f64 / (SIDE - 1) as f64
        };
        (0..SIDE * SIDE).map(|k| Vector3::new(at(0, k % SIDE), at(1, k / SIDE), self.height_m)).collect()
    }
}

/// The law of `moments`; one of free space at a level that puts the median strength at the usual distance where they are too few. `None` without
/// any report.
pub(super) fn law(moments: &[Moment], axes: usize, site: &Site) -> Option<Law> {
    let places = site.places();
    let loss = |place: &Vector3<f64>, anchor: &Vector3<f64>| 10.0 * (place - anchor).norm().max(0.3).log10();
    let usual = |moments: &[&Moment]| {
        let reports = || moments.iter().flat_map(|m| &m.reports);
        let strength = median(reports().map(|r| r.value))?;
        Some((strength, median(reports().flat_map(|r| places.iter().map(|p| loss(p, &r.anchor_m))))?))
    };
    let rich: Vec<&Moment> = moments.iter().filter(|m| m.reports.len() >= axes + 2).collect();
    if rich.len() < FEWEST {
        let all: Vec<&Moment> = moments.iter().take(MOST).collect();
        let (strength, loss) = usual(&all)?;
        let at_1m_dbm = strength + FREE_SPACE * loss;
        return Some(Law { exponent: FREE_SPACE, at_1m_dbm, sd_db: USUAL_SHADOWING_DB, fitted: false });
    }
    let rich: Vec<&Moment> = rich.iter().copied().step_by(rich.len().div_ceil(MOST)).collect();
    let (strength, typical) = usual(&rich)?;
    let limit = HUBER * USUAL_SHADOWING_DB;
    let cost = |off: f64| if off.abs() <= limit { off * off } else { limit * (2.0 * off.abs() - limit) };
    // The losses of all places to the radios of each moment do not depend on the law.
    let losses: Vec<Vec<f64>> = rich
        .iter()
        .map(|m| places.iter().flat_map(|p| m.reports.iter().map(|r| loss(p, &r.anchor_m))).collect())
        .collect();
    let tried = EXPONENTS.map(|exponent| {
        let mut level = strength + exponent * typical;
        let (mut total, mut residuals) = (f64::INFINITY, Vec::new());
        for _ in 0..ROUNDS {
            (total, residuals) = (0.0, Vec::new());
            for (moment, losses) in rich.iter().zip(&losses) {
                let n = moment.reports.len();
                let off = |chunk: &[f64], i: usize| moment.reports[i].value - level + exponent * chunk[i];
                let of = |chunk: &[f64]| (0..n).map(|i| cost(off(chunk, i))).sum::<f64>();
                let best = losses.chunks(n).map(|c| (of(c), c)).min_by(|a, b| a.0.total_cmp(&b.0));
                if let Some((least, chunk)) = best {
                    total += least;
                    residuals.extend((0..n).map(|i| off(chunk, i)));
                }
            }
            level += median(residuals.iter().copied()).unwrap_or(0.0);
        }
        let sd_db = robust_sd(residuals).unwrap_or(USUAL_SHADOWING_DB).max(1.0);
        (total, Law { exponent, at_1m_dbm: level, sd_db, fitted: true })
    });
    tried.into_iter().min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, law)| law)
}
