//! How the anchors stand, and what that allows.

use super::stats::median;
use crate::anchors::Anchors;
use crate::packet::AnchorId;
use nalgebra::{Matrix3, Vector3};

/// Shape of the set of anchors that were heard.
#[derive(Clone, Debug, PartialEq)]
pub struct Geometry {
    /// How many there are.
    pub count: usize,
    /// Standard deviations along the principal directions, metres, largest first.
    pub spread_m: [f64; 3],
    /// Standard deviations along the principal directions of the plan (x, y), metres, largest first.
    pub plan_spread_m: [f64; 2],
    /// Median height, metres.
    pub height_m: f64,
    /// Lowest and highest anchor, metres.
    pub heights_m: [f64; 2],
    /// Median place in the plan, metres.
    pub middle_m: [f64; 2],
}

/// Anchors thinner than this share of their largest extent stand, for a tracker, on one line or plane.
const THIN: f64 = 0.05;

impl Geometry {
    /// The shape of the anchors `heard`; `None` without any.
    pub(super) fn of(anchors: &Anchors, heard: &[AnchorId]) -> Option<Geometry> {
        let positions: Vec<Vector3<f64>> = heard.iter().map(|id| Vector3::from(anchors.position_m(*id))).collect();
        let count = positions.len();
        let heights = || positions.iter().map(|p| p.z);
        let height_m = median(heights())?;
        let mean = positions.iter().sum::<Vector3<f64>>() / count as f64;
        let scatter: Matrix3<f64> =
            positions.iter().map(|p| (p - mean) * (p - mean).transpose()).sum::<Matrix3<f64>>() / count as f64;
        let descending = |mut v: Vec<f64>| {
            v.sort_unstable_by(|a, b| b.total_cmp(a));
            v.into_iter().map(|e| e.max(0.0).sqrt()).collect::<Vec<f64>>()
        };
        let space = descending(scatter.symmetric_eigenvalues().iter().copied().collect());
        let plan =
            descending(scatter.fixed_view::<2, 2>(0, 0).into_owned().symmetric_eigenvalues().iter().copied().collect());
        Some(Geometry {
            count,
            spread_m: [space[0], space[1], space[2]],
            plan_spread_m: [plan[0], plan[1]],
            height_m,
            middle_m: [median(positions.iter().map(|p| p.x))?, median(positions.iter().map(|p| p.y))?],
            heights_m: [heights().fold(f64::MAX, f64::min), heights().fold(f64::MIN, f64::max)],
        })
    }

    /// Whether the anchors' table has no heights: all are 0, as on a plan.
    pub fn is_plan(&self) -> bool {
        self.heights_m == [0.0, 0.0]
    }

    /// Whether the anchors stand on one line in the plan: positions to its left and right look alike.
    pub fn is_collinear(&self) -> bool {
        self.count < 3 || self.plan_spread_m[1] <= THIN * self.plan_spread_m[0]
    }

    /// Whether the anchors stand in one plane: positions on its two sides look alike.
    pub fn is_coplanar(&self) -> bool {
        self.count < 4 || self.spread_m[2] <= THIN * self.spread_m[0]
    }

    /// Whether ranges of `typical_m` settle the height too: the thinnest direction must subtend a tenth of the distance.
    pub fn settles_height(&self, typical_m: f64) -> bool {
        !self.is_coplanar() && self.spread_m[2] >= 0.1 * typical_m
    }
}
