//! Several axes that move and are measured alike: one covariance for all.

use super::{Chain, Leap, Real};

/// Means of `A` axes and the covariance that each of them has. Axes are independent of one another.
///
/// It stays one covariance as long as all axes have the same noise, the same measurement variance and lose the same measurements.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Axes<T, const A: usize, const N: usize> {
    /// Mean of each axis: position, velocity, acceleration.
    pub means: [[T; N]; A],
    /// Covariance of each, upper triangle.
    pub cov: [[T; N]; N],
}

impl<T: Real, const A: usize, const N: usize> Axes<T, A, N> {
    /// Returns the belief after one interval of motion.
    #[inline(always)]
    pub fn predict(&self, leap: &Leap<T, N>) -> Self {
        let spread = Chain { mean: self.means[0], cov: self.cov }.predict(leap);
        let mut out = Axes { means: self.means, cov: spread.cov };
        out.means[0] = spread.mean;
        for axis in 1..A {
            out.means[axis] = leap.moved(&self.means[axis]);
        }
        out
    }

    /// Returns the belief after measurements `z` of the positions, each with variance `var`. Where `z[0]` is NaN nothing was measured.
    #[inline(always)]
    pub fn update(&self, z: &[T; A], var: T) -> Self {
        let (first, gain) = Chain { mean: self.means[0], cov: self.cov }.update(z[0], var);
        let mut out = Axes { means: self.means, cov: first.cov };
        out.means[0] = first.mean;
        for axis in 1..A {
            // Nothing of a lost measurement may enter: its gain is 0, its innovation would be NaN.
            let e = (z[axis] - self.means[axis][0]).where_number(z[0], z[0].zero());
            for i in 0..N {
                out.means[axis][i] = self.means[axis][i] + gain[i] * e;
            }
        }
        out
    }
}
