//! What a kernel calculates with.

use core::ops::{Add, Mul, Sub};

/// A number, or one of each of several tracks side by side.
///
/// The operations are those of IEEE 754, in the order in which they stand, whatever the implementation: results do not depend on it.
pub trait Real: Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> {
    /// `value`, of as many tracks.
    fn constant(self, value: f64) -> Self;

    /// 0, of as many tracks.
    #[inline(always)]
    fn zero(self) -> Self {
        self.constant(0.0)
    }

    /// 1, of as many tracks.
    #[inline(always)]
    fn one(self) -> Self {
        self.constant(1.0)
    }

    /// 1/x.
    fn inverse(self) -> Self;

    /// x/divisor.
    fn over(self, divisor: f64) -> Self;

    /// √x.
    fn sqrt(self) -> Self;

    /// `self` where `z` is a number, `other` where it is NaN.
    fn where_number(self, z: Self, other: Self) -> Self;

    /// `self` where `x` is above `limit`, `other` elsewhere.
    fn where_above(self, x: Self, limit: f64, other: Self) -> Self;

    /// Whether every |x| is below `limit`; a NaN is not.
    fn within(self, limit: f64) -> bool;

    /// What `f` makes of each.
    fn each(self, f: impl Fn(f64) -> f64) -> Self;
}

impl Real for f64 {
    #[inline(always)]
    fn constant(self, value: f64) -> f64 {
        value
    }

    #[inline(always)]
    fn inverse(self) -> f64 {
        1.0 / self
    }

    #[inline(always)]
    fn over(self, divisor: f64) -> f64 {
        self / divisor
    }

    #[inline(always)]
    fn sqrt(self) -> f64 {
        libm::sqrt(self)
    }

    #[inline(always)]
    fn where_number(self, z: f64, other: f64) -> f64 {
        if z.is_nan() { other } else { self }
    }

    #[inline(always)]
    fn where_above(self, x: f64, limit: f64, other: f64) -> f64 {
        if x > limit { self } else { other }
    }

    #[inline(always)]
    fn within(self, limit: f64) -> bool {
        self.abs() < limit
    }

    #[inline(always)]
    fn each(self, f: impl Fn(f64) -> f64) -> f64 {
        f(self)
    }
}
