//! Trails read at the instants of truth.

use super::stats::chi_square_quantile;
use fixtrail_core::Vector;
use fixtrail_core::models::GaussMarkov;
use fixtrail_track::layout::Layout;
use fixtrail_track::spec::GaussMarkovSpec;
use fixtrail_track::trail::Trail;
use fixtrail_track::truth::{TargetTruth, TruthPoint};

/// How a trail is read between its fixes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Causal: predicted from the last fix at or before the instant.
    Filter,
    /// Smoothed: interpolated between the neighbours, predicted after the last.
    Smoother,
}

/// A position and its covariance; entries beyond the model's axes are 0.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Position {
    /// Mean, metres.
    pub mean_m: [f64; 3],
    /// Covariance, square metres.
    pub cov_m2: [[f64; 3]; 3],
}

/// Carries a mean and its packed covariance (upper triangle, row-major) forward by `dt_s ≥ 0` and returns the position.
pub type Predict<'a> = dyn Fn(&[f64], &[f64], f64) -> Position + 'a;

/// One truth instant and what the trail says there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Instant {
    /// The instant, seconds.
    pub t_s: f64,
    /// Whether the truth lacks a coordinate that is compared; then there is no comparison.
    pub incomplete: bool,
    /// Coordinates compared: 2 in the plane and in space, 1 on a line.
    pub dof: usize,
    /// Estimate less truth along x and y, metres; `None` when there is no estimate.
    pub offset_m: Option<[f64; 2]>,
    /// Error in three dimensions, where the model has three axes and the truth a height.
    pub error_3d_m: Option<f64>,
    /// `eᵀ P⁻¹ e` of the compared coordinates; `None` without an estimate or with a singular P.
    pub nees: Option<f64>,
    /// Natural logarithm of the determinant of the compared coordinates' covariance; `None` where there is no `nees`.
    pub log_det: Option<f64>,
    /// Radius of the claimed 95 % ellipse in the direction of the error, metres: the truth is outside when the error is larger.
    pub radius95_m: Option<f64>,
}

impl Instant {
    /// The distance between estimate and truth, metres; `None` when there is nothing to compare.
    pub fn error_m(&self) -> Option<f64> {
        self.offset_m.map(|[x, y]| x.hypot(y))
    }

    /// Whether the true position is inside the claimed 95 % ellipse; never for a singular covariance.
    pub fn inside95(&self) -> bool {
        self.nees.is_some_and(|nees| nees <= chi95(self.dof))
    }
}

/// Quantiles for one and two degrees of freedom are asked for at every instant: `−2 ln 0.05` and the square of the normal's.
fn chi95(dof: usize) -> f64 {
    match dof {
        1 => 3.841_458_820_694_124,
        2 => 5.991_464_547_107_979,
        _ => chi_square_quantile(dof, 0.95),
    }
}

/// A [`Predict`] for chains of integrators: `p + v·dt + a·dt²/2`, as far as the layout has velocity and acceleration.
///
/// `noise` is the power spectral density of the highest modelled derivative's driving noise, one number per axis as in a
/// spec; an empty slice adds none. Its share of the position's variance is `noise · dt^(2m−1) / ((2m−1) ((m−1)!)²)` for m
/// modelled derivatives (Bar-Shalom, Li & Kirubarajan 2001, sec. 6.2). Further states are ignored, so a turning target is
/// carried along its tangent.
pub fn kinematic<'a>(layout: &Layout, noise: &'a [f64]) -> impl Fn(&[f64], &[f64], f64) -> Position + 'a {
    let (n, axes) = (layout.n(), layout.axes);
    let has_acceleration = layout.has_velocity && layout.names.get(2 * axes).is_some_and(|name| name == "ax");
    let order = 1 + usize::from(layout.has_velocity) + usize::from(has_acceleration);
    move |mean, cov, dt_s| {
        let weight = [1.0, dt_s, 0.5 * dt_s * dt_s];
        let mut out = Position::default();
        for i in 0..axes {
            out.mean_m[i] = (0..order).map(|d| weight[d] * mean[d * axes + i]).sum();
            for j in 0..axes {
                for a in 0..order {
                    for b in 0..order {
                        out.cov_m2[i][j] += weight[a] * weight[b] * packed(cov, n, a * axes + i, b * axes + j);
                    }
                }
            }
            let share = match order {
                1 => dt_s,
                2 => dt_s.powi(3) / 3.0,
                _ => dt_s.powi(5) / 20.0,
            };
            out.cov_m2[i][i] += noise.get(i).copied().unwrap_or(0.0) * share;
        }
        out
    }
}

/// A [`Predict`] for the stationary motion of a spec, by its own transition ([`GaussMarkov`](fixtrail_core::models::GaussMarkov)).
pub fn gauss_markov(spec: &GaussMarkovSpec) -> impl Fn(&[f64], &[f64], f64) -> Position + '_ {
    move |mean, cov, dt_s| {
        let mut out = Position::default();
        let (n, axes) = (2 * spec.axes, spec.axes);
        let mut from_position = [0.0; 3];
        let mut from_velocity = [0.0; 3];
        for i in 0..axes {
            // One axis at a time: the motion does not couple them. The spec has been checked.
            let (centre, spread, speed) = ([spec.centre_m[i]; 3], [spec.spread_m[i]; 3], [spec.speed_mps[i]; 3]);
            let Ok(motion) = GaussMarkov::<2>::new(1, centre, spread, speed) else { continue };
            let leap = motion.leap(&Vector::from([mean[i], mean[axes + i]]), dt_s);
            out.mean_m[i] = leap.next[0];
            (from_position[i], from_velocity[i]) = (leap.f[(0, 0)], leap.f[(0, 1)]);
            out.cov_m2[i][i] = leap.q[(0, 0)];
        }
        for i in 0..axes {
            for j in 0..axes {
                let (pi, vi, pj, vj) = (from_position[i], from_velocity[i], from_position[j], from_velocity[j]);
                out.cov_m2[i][j] += pi * pj * packed(cov, n, i, j)
                    + pi * vj * packed(cov, n, i, axes + j)
                    + vi * pj * packed(cov, n, axes + i, j)
                    + vi * vj * packed(cov, n, axes + i, axes + j);
            }
        }
        out
    }
}

fn packed(cov: &[f64], n: usize, i: usize, j: usize) -> f64 {
    cov[Trail::packed_index(n, i.min(j), i.max(j))]
}

/// Reads `trail` at every point of `truth`.
///
/// A causal trail is predicted from its last fix at or before the instant. A smoothed one is interpolated (position by a cubic
/// Hermite where there is a velocity, else linearly; covariance linearly, plus what the driving noise may do between two fixes that
/// are both known) and predicted after its last fix. There is no estimate before the first fix, nor where the fix or one of the two
/// neighbours is unobservable.
pub fn at_truth(
    trail: &Trail,
    layout: &Layout,
    predict: &Predict<'_>,
    truth: &TargetTruth,
    kind: Kind,
) -> Vec<Instant> {
    let rows: Vec<(f64, usize)> = trail.t_s.iter().enumerate().filter_map(|(row, t)| t.map(|t| (t, row))).collect();
    let mut next = 0;
    truth
        .points
        .iter()
        .map(|point| {
            while next < rows.len() && rows[next].0 <= point.t_s {
                next += 1;
            }
            let position = next.checked_sub(1).and_then(|last| {
                let (t_s, row) = rows[last];
                let dt_s = point.t_s - t_s;
                match (kind, rows.get(next)) {
                    (Kind::Smoother, Some(&(after_s, after))) if dt_s > 0.0 => {
                        interpolated(trail, layout, predict, [row, after], dt_s, after_s - t_s)
                    }
                    _ => Some(predict(trail.mean(row)?, trail.cov(row)?, dt_s)),
                }
            });
            compared(point, layout.axes, position)
        })
        .collect()
}

fn interpolated(
    trail: &Trail,
    layout: &Layout,
    predict: &Predict<'_>,
    [before, after]: [usize; 2],
    dt_s: f64,
    interval_s: f64,
) -> Option<Position> {
    let (m0, m1) = (trail.mean(before)?, trail.mean(after)?);
    let p0 = predict(m0, trail.cov(before)?, 0.0);
    let p1 = predict(m1, trail.cov(after)?, 0.0);
    let s = dt_s / interval_s;
    // A chain of integrators pinned at both ends spreads in between like a free one after the interval a·b/(a + b), a and b the times
    // to the two fixes: `noise · (ab/(a+b))^(2m−1) / ((2m−1) ((m−1)!)²)`.
    let n = layout.n();
    let bridge = predict(&vec![0.0; n], &vec![0.0; Trail::packed_len(n)], dt_s * (1.0 - s));
    let mut out = Position::default();
    for i in 0..layout.axes {
        out.mean_m[i] = if layout.has_velocity {
            let (v0, v1) = (m0[layout.axes + i] * interval_s, m1[layout.axes + i] * interval_s);
            // Cubic Hermite basis.
            let (s2, s3) = (s * s, s * s * s);
            (2.0 * s3 - 3.0 * s2 + 1.0) * p0.mean_m[i]
                + (s3 - 2.0 * s2 + s) * v0
                + (3.0 * s2 - 2.0 * s3) * p1.mean_m[i]
                + (s3 - s2) * v1
        } else {
            p0.mean_m[i] + s * (p1.mean_m[i] - p0.mean_m[i])
        };
        for j in 0..layout.axes {
            let between = p0.cov_m2[i][j] + s * (p1.cov_m2[i][j] - p0.cov_m2[i][j]);
            out.cov_m2[i][j] = between + bridge.cov_m2[i][j];
        }
    }
    Some(out)
}

fn compared(point: &TruthPoint, axes: usize, position: Option<Position>) -> Instant {
    let dof = axes.min(2);
    let incomplete = point.position_m[..dof].iter().any(Option::is_none);
    let mut instant = Instant {
        t_s: point.t_s,
        incomplete,
        dof,
        offset_m: None,
        error_3d_m: None,
        nees: None,
        log_det: None,
        radius95_m: None,
    };
    let (Some(position), false) = (position, incomplete) else { return instant };
    let mut offset = [0.0; 3];
    for (i, o) in offset.iter_mut().enumerate().take(axes) {
        *o = position.mean_m[i] - point.position_m[i].unwrap_or(f64::NAN);
    }
    let [x, y, z] = offset;
    let error_m = x.hypot(y);
    instant.offset_m = Some([x, y]);
    instant.error_3d_m = (axes == 3 && z.is_finite()).then(|| error_m.hypot(z));
    let [[a, b, _], [_, d, _], _] = position.cov_m2;
    let (inverse_times, largest) = if dof == 1 {
        ((a > 0.0).then(|| x * x / a), a)
    } else {
        let det = a * d - b * b;
        // Relative to a·d the determinant of a usable covariance is far above rounding.
        let regular = a > 0.0 && d > 0.0 && det > 1e-14 * a * d;
        (
            regular.then(|| (d * x * x - 2.0 * b * x * y + a * y * y) / det),
            0.5 * (a + d) + (0.25 * (a - d).powi(2) + b * b).sqrt(),
        )
    };
    instant.nees = inverse_times;
    let determinant = if dof == 1 { a } else { a * d - b * b };
    instant.log_det = inverse_times.map(|_| determinant.ln());
    // Along the error the ellipse ends where NEES reaches its quantile; an error of 0 has no direction, the long axis stands in.
    instant.radius95_m = inverse_times
        .map(|nees| if nees > 0.0 { error_m * (chi95(dof) / nees).sqrt() } else { (chi95(dof) * largest).sqrt() });
    instant
}
