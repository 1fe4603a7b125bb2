//! A coordinated turn in the plane: `x y vx vy ω`, the transition's zeros known.
//!
//! ```text
//!      1 0 a −b g        a = dt s, b = dt c                       Q: per axis position, velocity and their
//!      0 1 b  a g′       (g g′) = dt² (s′vx − c′vy, c′vx + s′vy)     product; ω alone
//! F =  0 0 c −s −dt vy⁺
//!      0 0 s  c dt vx⁺   s, c and their derivatives: Arc of θ = ω dt
//!      0 0 0  0 1
//! ```

use super::{Arc, Motion, Packed, Real};
use crate::models::CoordinatedTurn;
use crate::types::{Matrix, Vector};

/// A coordinated turn over one interval, as [`CoordinatedTurn::leap`] has it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Turn<T> {
    dt: T,
    /// Of each axis the variances of position and velocity and their covariance.
    axes: [[T; 3]; 2],
    /// Variance of the turn rate's change.
    rate: T,
}

impl Turn<f64> {
    /// Returns the motion over `dt_s` seconds.
    #[inline]
    pub fn new(motion: &CoordinatedTurn, dt_s: f64) -> Self {
        Turn::with_noise(dt_s, &motion.leap(&Vector::zeros(), dt_s).q)
    }

    /// Returns the motion over `dt_s` seconds with any noise `q` of each axis and of the turn rate; covariances between these are left out.
    #[inline]
    pub fn with_noise(dt_s: f64, q: &Matrix<5, 5>) -> Self {
        Turn { dt: dt_s, axes: [0, 1].map(|i| [q[(i, i)], q[(i + 2, i + 2)], q[(i, i + 2)]]), rate: q[(4, 4)] }
    }

    /// The same in other numbers.
    #[inline(always)]
    pub fn map<T>(&self, to: impl Fn(f64) -> T) -> Turn<T> {
        Turn { dt: to(self.dt), axes: self.axes.map(|axis| axis.map(&to)), rate: to(self.rate) }
    }
}

impl<T: Real> Motion<T, 5> for Turn<T> {
    #[inline(always)]
    fn after(&self, belief: &Packed<T, 5>) -> Packed<T, 5> {
        let [x, y, vx, vy, rate] = belief.mean;
        let dt = self.dt;
        let arc = Arc::of(rate * dt);
        let (a, b) = (dt * arc.along, dt * arc.aside);
        let (sin, cos) = (arc.sin, arc.cos);
        let (vx_next, vy_next) = (cos * vx - sin * vy, sin * vx + cos * vy);
        let dt2 = dt * dt;
        // Rows 0 to 3 in the columns of velocity and turn rate; beside them is the identity in the first two, nothing in the others.
        let zero = dt.zero();
        let f0 = [a, zero - b, dt2 * (arc.along_slope * vx - arc.aside_slope * vy)];
        let f1 = [b, a, dt2 * (arc.aside_slope * vx + arc.along_slope * vy)];
        let f2 = [cos, zero - sin, zero - dt * vy_next];
        let f3 = [sin, cos, dt * vx_next];
        let [[p00, p01, p02, p03, p04], [_, p11, p12, p13, p14], [_, _, p22, p23, p24], [_, _, _, p33, p34], last] =
            belief.cov;
        let (p2, p3, p4) = ([p22, p23, p24], [p23, p33, p34], [p24, p34, last[4]]);
        // Rows of F P in the same columns. Written out: loops of this size are not unrolled, and lose the registers.
        let h0 = [p02 + dot(&f0, &p2), p03 + dot(&f0, &p3), p04 + dot(&f0, &p4)];
        let h1 = [p12 + dot(&f1, &p2), p13 + dot(&f1, &p3), p14 + dot(&f1, &p4)];
        let h2 = [dot(&f2, &p2), dot(&f2, &p3), dot(&f2, &p4)];
        let h3 = [dot(&f3, &p2), dot(&f3, &p3), dot(&f3, &p4)];
        let [[q0, q2, q02], [q1, q3, q13]] = self.axes;
        let mut cov = belief.cov;
        cov[0][0] = (p00 + dot(&f0, &[p02, p03, p04])) + (dot(&f0, &h0) + q0);
        cov[0][1] = (p01 + dot(&f0, &[p12, p13, p14])) + dot(&f1, &h0);
        cov[0][2] = dot(&f2, &h0) + q02;
        cov[0][3] = dot(&f3, &h0);
        cov[0][4] = h0[2];
        cov[1][1] = (p11 + dot(&f1, &[p12, p13, p14])) + (dot(&f1, &h1) + q1);
        cov[1][2] = dot(&f2, &h1);
        cov[1][3] = dot(&f3, &h1) + q13;
        cov[1][4] = h1[2];
        cov[2][2] = dot(&f2, &h2) + q2;
        cov[2][3] = dot(&f3, &h2);
        cov[2][4] = h2[2];
        cov[3][3] = dot(&f3, &h3) + q3;
        cov[3][4] = h3[2];
        cov[4][4] = last[4] + self.rate;
        Packed { mean: [x + (a * vx - b * vy), y + (b * vx + a * vy), vx_next, vy_next, rate], cov }
    }
}

#[inline(always)]
fn dot<T: Real>(a: &[T; 3], b: &[T; 3]) -> T {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
