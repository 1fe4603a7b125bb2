//! The line (plane) that the anchors stand nearest to, and states mirrored at it.
//!
//! Distances to anchors in one line, in the plane, or in one plane, in space, are those of a mirrored target as well. Motion without a
//! preferred direction does not tell the two apart either: only an anchor off the line, another sensor or a prior does.

use crate::layout::Layout;
use fixtrail_core::{Belief, Vector};
use nalgebra::{Matrix3, Vector3};

/// A mirror through anchors.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Mirror {
    axes: usize,
    /// Position, velocity, acceleration: components that turn with space, `axes` of each.
    vectors: usize,
    centre_m: Vector3<f64>,
    /// Of length 1.
    normal: Vector3<f64>,
    /// Whether the anchors are in it, or as good as.
    pub(crate) narrow: bool,
}

/// Anchors are as good as in line where they are this many times as far spread along it as across: from between them little is seen across.
const NARROW: f64 = 10.0;

impl Mirror {
    /// The mirror with the least sum of squared distances to the places of anchors; `None` where they leave it open: fewer than two, or in
    /// space than three, and where space has one axis or none.
    pub(crate) fn of(layout: &Layout, sites: &[[f64; 3]]) -> Option<Self> {
        let axes = layout.axes;
        if !(2..=3).contains(&axes) || sites.len() < axes {
            return None;
        }
        let flat = |site: &[f64; 3]| Vector3::from_fn(|i, _| if i < axes { site[i] } else { 0.0 });
        let centre_m = sites.iter().map(flat).sum::<Vector3<f64>>() / sites.len() as f64;
        let mut scatter = Matrix3::zeros();
        for site in sites {
            let off = flat(site) - centre_m;
            scatter += off * off.transpose();
        }
        if axes == 2 {
            // The normal stays in the plane.
            scatter[(2, 2)] = 1.0 + 2.0 * scatter.trace();
        }
        let eigen = scatter.symmetric_eigen();
        let normal = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
        let vectors = ["x", "vx", "ax"].iter().filter(|name| layout.names.iter().any(|n| n == *name)).count();
        // Squares of the spreads; the third of a plane says nothing.
        let mut spreads: Vec<f64> = eigen.eigenvalues.iter().copied().collect();
        spreads.sort_by(f64::total_cmp);
        let narrow = spreads[0] * NARROW * NARROW <= spreads[1];
        Some(Self { axes, vectors, centre_m, normal, narrow })
    }

    /// The mirrored state. What does not turn with space, errors of sensors, stays; so does a turn rate, which ought to change its sign, but
    /// this is where a search starts.
    pub(crate) fn reflected<const N: usize>(&self, x: &Vector<N>) -> Vector<N> {
        let mut out = *x;
        for vector in 0..self.vectors {
            let first = vector * self.axes;
            let origin = if vector == 0 { self.centre_m } else { Vector3::zeros() };
            let across: f64 = (0..self.axes).map(|i| (x[first + i] - origin[i]) * self.normal[i]).sum();
            (0..self.axes).for_each(|i| out[first + i] -= 2.0 * across * self.normal[i]);
        }
        out
    }

    /// The state `by_m` further along the normal.
    pub(crate) fn beside<const N: usize>(&self, x: &Vector<N>, by_m: f64) -> Vector<N> {
        Vector::from_fn(|i, _| x[i] + if i < self.axes { by_m * self.normal[i] } else { 0.0 })
    }

    /// Whether a state lies on the same side as a point.
    pub(crate) fn is_on_side_of<const N: usize>(&self, x: &Vector<N>, point_m: &[f64; 3]) -> bool {
        let off = |at: &dyn Fn(usize) -> f64| {
            (0..self.axes).map(|i| (at(i) - self.centre_m[i]) * self.normal[i]).sum::<f64>()
        };
        off(&|i| x[i]) * off(&|i| point_m[i]) > 0.0
    }

    /// Distance of a position from the mirror over its standard deviation.
    pub(crate) fn deviations_off<const N: usize>(&self, belief: &Belief<N>) -> f64 {
        let (mut off, mut var) = (0.0, 0.0);
        for i in 0..self.axes {
            off += (belief.mean[i] - self.centre_m[i]) * self.normal[i];
            var += (0..self.axes).map(|j| self.normal[i] * belief.cov[(i, j)] * self.normal[j]).sum::<f64>();
        }
        off.abs() / var.max(f64::MIN_POSITIVE).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_state_mirrored_twice_is_itself_and_distances_stay() {
        let layout = Layout::kinematic(2, 2, &[]);
        // Anchors on the line through (0, −1) along (1, 2)/√5.
        let sites = [[0.0, -1.0, 3.0], [1.0, 1.0, 2.0], [3.0, 5.0, 0.0]];
        let mirror = Mirror::of(&layout, &sites).unwrap();
        let x = Vector::<4>::from([4.0, -2.0, 0.5, 1.5]);
        let other = mirror.reflected(&x);
        for site in sites {
            let distance = |x: &Vector<4>| (x[0] - site[0]).hypot(x[1] - site[1]);
            let rate = |x: &Vector<4>| ((x[0] - site[0]) * x[2] + (x[1] - site[1]) * x[3]) / distance(x);
            assert!((distance(&x) - distance(&other)).abs() < 1e-12, "{other}");
            assert!((rate(&x) - rate(&other)).abs() < 1e-12, "{other}");
        }
        assert!(mirror.narrow && !Mirror::of(&layout, &[sites[0], sites[1], [3.0, -5.0, 0.0]]).unwrap().narrow);
        assert!((other - x).norm() > 1.0 && (mirror.reflected(&other) - x).norm() < 1e-12, "{other}");
        // (4, −2) less (0, −1) is (4, −1); its part across is (4·2 + 1)/√5.
        let belief = Belief { mean: x, cov: fixtrail_core::Matrix::identity() * 0.25 };
        assert!((mirror.deviations_off(&belief) - 2.0 * 9.0 / 5f64.sqrt()).abs() < 1e-12);
    }

    #[test]
    fn a_plane_in_space_mirrors_and_too_few_anchors_leave_it_open() {
        let space = Layout::kinematic(1, 3, &[]);
        let ceiling = [[0.0, 0.0, 3.0], [8.0, 0.0, 3.0], [0.0, 6.0, 3.0]];
        let mirror = Mirror::of(&space, &ceiling).unwrap();
        let below = Vector::<3>::from([2.0, 1.0, 1.0]);
        assert!((mirror.reflected(&below) - Vector::from([2.0, 1.0, 5.0])).norm() < 1e-12);
        assert!(Mirror::of(&space, &ceiling[..2]).is_none());
        assert!(Mirror::of(&Layout::kinematic(2, 2, &[]), &ceiling[..1]).is_none());
        assert!(Mirror::of(&Layout::linear(4), &ceiling).is_none());
    }
}
