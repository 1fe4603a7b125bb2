//! Positions from the measurements of one moment: a front end for filters that take positions, and a first guess for those that do not.
//!
//! Everything is for `N` = 2 or 3 axes; two axes with a known height use anchors in space, two axes without one ignore the anchors'
//! heights. A linear stage needs no guess, Gauss–Newton about its result gives the most likely position with its covariance. What the
//! measurements do not determine is said ([`Location`]), never made up.

mod descent;
pub mod lateration;
pub mod rss;
pub mod rss_ml;
pub mod tdoa;

use crate::types::{Belief, Vector};

/// Two fits whose sums of squares differ by more than this are no longer a choice. With noise alone between them the wrong one of two
/// positions is ahead by `T` with a probability of at most `Φ(−√T)`: 3e-5.
const DECISIVE: f64 = 16.0;
/// Fits closer than this fraction of their standard deviation are the same minimum; Gauss–Newton settles far below.
const SAME: f64 = 1e-3;

/// A minimum of the weighted sum of squared residuals.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point<const N: usize> {
    /// Position in metres (and what else was unknown), covariance `(JᵀWJ)⁻¹` at it.
    pub belief: Belief<N>,
    /// The weighted sum of squared residuals there.
    pub chi2: f64,
}

/// What the measurements of one moment say of a position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Location<const N: usize> {
    /// One position.
    Unique(Point<N>),
    /// Two positions that fit as well: mirrored at the line or the plane of the anchors, or both on the same curves. The better one is first.
    Pair([Point<N>; 2]),
    /// The measurements contradict each other: no position, or only one in the anchors' own line or plane, fits.
    NoIntersection,
    /// Too few anchors, or anchors that see the same.
    NotDetermined,
}

impl<const N: usize> Location<N> {
    /// The position, or of two the one closer to `hint`, which is where the target is expected; `None` where there is none.
    pub fn near(&self, hint: &Vector<N>) -> Option<Point<N>> {
        match self {
            Location::Unique(point) => Some(*point),
            Location::Pair([a, b]) => {
                let away = |p: &Point<N>| (p.belief.mean - hint).norm_squared();
                Some(if away(b) < away(a) { *b } else { *a })
            }
            Location::NoIntersection | Location::NotDetermined => None,
        }
    }
}

/// Up to four minima that different starts led to.
struct Candidates<const N: usize> {
    found: [Option<Point<N>>; 4],
    count: usize,
}

impl<const N: usize> Candidates<N> {
    fn new() -> Self {
        Self { found: [None; 4], count: 0 }
    }

    /// Adds a minimum, unless it is there already.
    ///
    /// # Panics
    /// With a fifth: a bug of ours.
    fn add(&mut self, point: Option<Point<N>>) {
        let Some(point) = point else { return };
        let same = |other: &Point<N>| {
            let apart = (other.belief.mean - point.belief.mean).norm_squared();
            apart <= SAME * SAME * point.belief.cov.trace().min(other.belief.cov.trace())
        };
        if !self.found.iter().flatten().any(same) {
            self.found[self.count] = Some(point);
            self.count += 1;
        }
    }

    /// The minima that nothing decides between; `none` when there is no minimum.
    fn decide(self, none: Location<N>) -> Location<N> {
        let best = self.found.iter().flatten().fold(None, |best: Option<&Point<N>>, p| match best {
            Some(b) if b.chi2 <= p.chi2 => Some(b),
            _ => Some(p),
        });
        let Some(best) = best else { return none };
        let mut rivals = self.found.iter().flatten().filter(|p| *p != best && p.chi2 <= best.chi2 + DECISIVE);
        match (rivals.next(), rivals.next()) {
            (None, _) => Location::Unique(*best),
            (Some(rival), None) => Location::Pair([*best, *rival]),
            _ => Location::NotDetermined,
        }
    }
}
