//! Numbers of several tracks in vector registers.

use fixtrail_core::kernels::Real;
use pulp::Simd;
use std::ops::{Add, Mul, Sub};

/// Registers side by side: while one waits for a division the other goes on.
pub const DEEP: usize = 2;

/// `DEEP` registers of numbers, one number for each track.
#[derive(Clone, Copy)]
pub struct Wide<S: Simd> {
    simd: S,
    registers: [S::f64s; DEEP],
}

impl<S: Simd> Wide<S> {
    /// Tracks side by side.
    pub const TRACKS: usize = DEEP * S::F64_LANES;

    /// The same number for every track.
    #[inline(always)]
    pub fn splat(simd: S, value: f64) -> Self {
        Wide { simd, registers: [simd.splat_f64s(value); DEEP] }
    }

    /// A number for each track from the first of `row`.
    #[inline(always)]
    pub fn load(simd: S, row: &[f64]) -> Self {
        let (whole, _) = S::as_simd_f64s(row);
        Wide { simd, registers: [whole[0], whole[1]] }
    }

    /// Writes the number of each track to the first of `row`.
    #[inline(always)]
    pub fn store(self, row: &mut [f64]) {
        let (whole, _) = S::as_mut_simd_f64s(row);
        [whole[0], whole[1]] = self.registers;
    }

    #[inline(always)]
    fn each(self, other: Self, f: impl Fn(S, S::f64s, S::f64s) -> S::f64s) -> Self {
        let ([a, b], [c, d]) = (self.registers, other.registers);
        Wide { simd: self.simd, registers: [f(self.simd, a, c), f(self.simd, b, d)] }
    }
}

macro_rules! operation {
    ($operation:ident, $name:ident, $of:ident) => {
        impl<S: Simd> $operation for Wide<S> {
            type Output = Self;

            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                self.each(
                    other,
                    #[inline(always)]
                    |simd, a, b| simd.$of(a, b),
                )
            }
        }
    };
}
operation!(Add, add, add_f64s);
operation!(Sub, sub, sub_f64s);
operation!(Mul, mul, mul_f64s);

impl<S: Simd> Real for Wide<S> {
    #[inline(always)]
    fn zero(self) -> Self {
        Wide::splat(self.simd, 0.0)
    }

    #[inline(always)]
    fn one(self) -> Self {
        Wide::splat(self.simd, 1.0)
    }

    #[inline(always)]
    fn inverse(self) -> Self {
        self.one().each(
            self,
            #[inline(always)]
            |simd, one, x| simd.div_f64s(one, x),
        )
    }

    #[inline(always)]
    fn where_number(self, z: Self, other: Self) -> Self {
        let ([a, b], [y, z], [c, d]) = (self.registers, z.registers, other.registers);
        let simd = self.simd;
        // A NaN is not equal to itself.
        let (first, second) = (simd.equal_f64s(y, y), simd.equal_f64s(z, z));
        Wide { simd, registers: [simd.select_f64s(first, a, c), simd.select_f64s(second, b, d)] }
    }
}
