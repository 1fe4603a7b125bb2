//! What a kernel calculates with.

use core::ops::{Add, Mul, Sub};

/// A number, or one of each of several tracks side by side.
///
/// The operations are those of IEEE 754, in the order in which they stand, whatever the implementation: results do not depend on it.
pub trait Real: Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> {
    /// 0, of as many tracks.
    fn zero(self) -> Self;

    /// 1, of as many tracks.
    fn one(self) -> Self;

    /// 1/x.
    fn inverse(self) -> Self;

    /// `self` where `z` is a number, `other` where it is NaN.
    fn where_number(self, z: Self, other: Self) -> Self;
}

impl Real for f64 {
    #[inline(always)]
    fn zero(self) -> f64 {
        0.0
    }

    #[inline(always)]
    fn one(self) -> f64 {
        1.0
    }

    #[inline(always)]
    fn inverse(self) -> f64 {
        1.0 / self
    }

    #[inline(always)]
    fn where_number(self, z: f64, other: f64) -> f64 {
        if z.is_nan() { other } else { self }
    }
}
