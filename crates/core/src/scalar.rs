//! The numbers that the smallest filters run on: `f64`, `f32` and, where there is no floating-point unit, Q16.16.

use core::fmt::Debug;
use core::ops::{Add, Div, Mul, Sub};

/// A number with the four operations. A result that does not fit is not finite, and stays so in sums and products.
pub trait Scalar:
    Copy + Debug + PartialOrd + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self>
{
    /// What to multiply by in place of many divisions by one number.
    type Inverse: Copy;

    /// 0.
    const ZERO: Self;
    /// 1/2.
    const HALF: Self;

    /// Whether this is a number within range.
    fn is_finite(self) -> bool;

    /// Returns the nearest number to `value`.
    fn from_f64(value: f64) -> Self;

    /// Returns the same number as an `f64`.
    fn to_f64(self) -> f64;

    /// Returns the inverse of a positive finite number.
    fn inverse(self) -> Self::Inverse;

    /// Returns this number times an inverse.
    fn times(self, inverse: Self::Inverse) -> Self;
}

impl Scalar for f64 {
    type Inverse = f64;

    const ZERO: f64 = 0.0;
    const HALF: f64 = 0.5;

    fn is_finite(self) -> bool {
        f64::is_finite(self)
    }

    fn from_f64(value: f64) -> f64 {
        value
    }

    fn to_f64(self) -> f64 {
        self
    }

    fn inverse(self) -> f64 {
        1.0 / self
    }

    fn times(self, inverse: f64) -> f64 {
        self * inverse
    }
}

impl Scalar for f32 {
    type Inverse = f32;

    const ZERO: f32 = 0.0;
    const HALF: f32 = 0.5;

    fn is_finite(self) -> bool {
        f32::is_finite(self)
    }

    fn from_f64(value: f64) -> f32 {
        value as f32
    }

    fn to_f64(self) -> f64 {
        f64::from(self)
    }

    fn inverse(self) -> f32 {
        1.0 / self
    }

    fn times(self, inverse: f32) -> f32 {
        self * inverse
    }
}

/// A fixed-point number of 16 bits before the point and 16 after: from −32768 to 32768 in steps of 1/65536.
///
/// Products and quotients are formed in 64 bits and rounded to nearest. What leaves the range stops at its end, and the ends count as not
/// finite: an overflow is seen, it never turns a sign.
///
/// ```
/// use fixtrail_core::scalar::{Q16, Scalar};
///
/// let third = Q16::from_f64(1.0) / Q16::from_f64(3.0);
/// assert!((third.to_f64() - 1.0 / 3.0).abs() < 1.0 / 131072.0);
/// assert!(!(Q16::from_f64(300.0) * Q16::from_f64(300.0)).is_finite());
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Q16(i32);

/// The inverse of a positive [`Q16`], to 31 bits whatever its size: 1/16 as a [`Q16`] has 13, too few for a filter's slow variances.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Q16Inverse {
    /// From 2³⁰ to 2³¹.
    mantissa: i64,
    /// A product with a number of bits b/65536 has (b · mantissa) / 2^shift of them.
    shift: u32,
}

/// Bits after the point.
const POINT: u32 = 16;

impl Q16 {
    /// Returns the number of `bits`/65536.
    pub const fn from_bits(bits: i32) -> Self {
        Q16(bits)
    }

    /// Returns 65536 times the number.
    pub const fn to_bits(self) -> i32 {
        self.0
    }

    /// Returns the number of `bits`/65536, or the end of the range.
    fn clamped(bits: i64) -> Self {
        Q16(bits.clamp(i64::from(i32::MIN), i64::from(i32::MAX)) as i32)
    }

    /// Returns the end of the range of that sign.
    fn end(is_negative: bool) -> Self {
        Q16(if is_negative { i32::MIN } else { i32::MAX })
    }
}

impl Add for Q16 {
    type Output = Q16;

    fn add(self, other: Q16) -> Q16 {
        match (self.is_finite(), other.is_finite()) {
            (true, true) => Q16(self.0.saturating_add(other.0)),
            (false, _) => self,
            (true, false) => other,
        }
    }
}

impl Sub for Q16 {
    type Output = Q16;

    fn sub(self, other: Q16) -> Q16 {
        match (self.is_finite(), other.is_finite()) {
            (true, true) => Q16(self.0.saturating_sub(other.0)),
            (false, _) => self,
            (true, false) => Q16::end(other.0 > 0),
        }
    }
}

impl Mul for Q16 {
    type Output = Q16;

    fn mul(self, other: Q16) -> Q16 {
        if !(self.is_finite() && other.is_finite()) {
            return Q16::end((self.0 < 0) != (other.0 < 0));
        }
        let product = i64::from(self.0) * i64::from(other.0);
        Q16::clamped((product + (1 << (POINT - 1))) >> POINT)
    }
}

impl Div for Q16 {
    type Output = Q16;

    fn div(self, other: Q16) -> Q16 {
        if other.0 == 0 || !(self.is_finite() && other.is_finite()) {
            return Q16::end((self.0 < 0) != (other.0 < 0));
        }
        let (n, d) = (i64::from(self.0) << POINT, i64::from(other.0));
        // Division truncates: half the divisor, with the sign of the numerator, makes it round.
        let half = d.abs() / 2;
        Q16::clamped((if n < 0 { n - half } else { n + half }) / d)
    }
}

impl Scalar for Q16 {
    type Inverse = Q16Inverse;

    const ZERO: Q16 = Q16(0);
    const HALF: Q16 = Q16(1 << (POINT - 1));

    fn is_finite(self) -> bool {
        self.0 != i32::MIN && self.0 != i32::MAX
    }

    fn from_f64(value: f64) -> Q16 {
        if value.is_nan() {
            return Q16::end(false);
        }
        // A cast from a float stops at the ends of the range.
        Q16(libm::round(value * f64::from(1u32 << POINT)) as i32)
    }

    fn to_f64(self) -> f64 {
        f64::from(self.0) / f64::from(1u32 << POINT)
    }

    fn inverse(self) -> Q16Inverse {
        let d = self.0.max(1);
        let length = i32::BITS - d.leading_zeros();
        let d = i64::from(d);
        Q16Inverse { mantissa: ((1i64 << (30 + length)) + d / 2) / d, shift: 30 + length - POINT }
    }

    fn times(self, inverse: Q16Inverse) -> Q16 {
        let product = i64::from(self.0) * inverse.mantissa;
        Q16::clamped((product + (1 << (inverse.shift - 1))) >> inverse.shift)
    }
}
