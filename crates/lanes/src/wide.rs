//! Numbers of several tracks in vector registers.

use fixtrail_core::kernels::Real;
use pulp::Simd;
use std::ops::{Add, Mul, Sub};

/// Registers side by side: while one waits for a division the others go on.
pub const DEEP: usize = 2;

/// Most numbers of a register: those of AVX-512.
pub const MOST_LANES: usize = 8;

/// Most tracks side by side.
pub const MOST: usize = MOST_LANES * DEEP;

/// `DEEP` registers of numbers, one number for each track.
#[derive(Clone, Copy)]
pub struct Wide<S: Simd> {
    simd: S,
    registers: [S::f64s; DEEP],
}

// Loops, not closures over arrays: what is not inlined loses the vector instructions that the caller was compiled for.
impl<S: Simd> Wide<S> {
    /// Tracks side by side.
    pub const TRACKS: usize = DEEP * S::F64_LANES;

    /// The same number for every track.
    #[inline(always)]
    pub fn splat(simd: S, value: f64) -> Self {
        Wide { simd, registers: [simd.splat_f64s(value); DEEP] }
    }

    /// The registers of numbers.
    #[inline(always)]
    pub fn of(simd: S, registers: [S::f64s; DEEP]) -> Self {
        Wide { simd, registers }
    }

    /// The registers.
    #[inline(always)]
    pub fn registers(self) -> [S::f64s; DEEP] {
        self.registers
    }

    /// A number for each track from the first of `row`.
    #[inline(always)]
    pub fn load(simd: S, row: &[f64]) -> Self {
        let (whole, _) = S::as_simd_f64s(row);
        Wide { simd, registers: [whole[0], whole[1]] }
    }

    /// A number of each track.
    #[inline(always)]
    pub fn gather<T>(simd: S, tracks: &[T], number: impl Fn(&T) -> f64) -> Self {
        let mut row = [0.0; MOST];
        for (value, track) in row.iter_mut().zip(tracks) {
            *value = number(track);
        }
        Wide::load(simd, &row)
    }

    /// Writes the number of each track to the first of `row`.
    #[inline(always)]
    pub fn store(self, row: &mut [f64]) {
        let (whole, _) = S::as_mut_simd_f64s(row);
        [whole[0], whole[1]] = self.registers;
    }

    #[inline(always)]
    fn pairs(self, other: Self, f: impl Fn(S, S::f64s, S::f64s) -> S::f64s) -> Self {
        let mut out = self;
        for i in 0..DEEP {
            out.registers[i] = f(self.simd, self.registers[i], other.registers[i]);
        }
        out
    }

    /// `self` where `mask` says so of `of`, `other` elsewhere.
    #[inline(always)]
    fn where_of(self, of: Self, other: Self, mask: impl Fn(S, S::f64s) -> S::m64s) -> Self {
        let (simd, mut out) = (self.simd, self);
        for i in 0..DEEP {
            out.registers[i] = simd.select_f64s(mask(simd, of.registers[i]), self.registers[i], other.registers[i]);
        }
        out
    }
}

macro_rules! operation {
    ($operation:ident, $name:ident, $of:ident) => {
        impl<S: Simd> $operation for Wide<S> {
            type Output = Self;

            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                self.pairs(
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
    fn constant(self, value: f64) -> Self {
        Wide::splat(self.simd, value)
    }

    #[inline(always)]
    fn inverse(self) -> Self {
        self.one().pairs(
            self,
            #[inline(always)]
            |simd, one, x| simd.div_f64s(one, x),
        )
    }

    #[inline(always)]
    fn over(self, divisor: f64) -> Self {
        self.pairs(
            self.constant(divisor),
            #[inline(always)]
            |simd, x, divisor| simd.div_f64s(x, divisor),
        )
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        self.pairs(
            self,
            #[inline(always)]
            |simd, x, _| simd.sqrt_f64s(x),
        )
    }

    #[inline(always)]
    fn where_number(self, z: Self, other: Self) -> Self {
        self.where_of(
            z,
            other,
            // A NaN is not equal to itself.
            #[inline(always)]
            |simd, z| simd.equal_f64s(z, z),
        )
    }

    #[inline(always)]
    fn where_above(self, x: Self, limit: f64, other: Self) -> Self {
        self.where_of(
            x,
            other,
            #[inline(always)]
            |simd, x| simd.greater_than_f64s(x, simd.splat_f64s(limit)),
        )
    }

    #[inline(always)]
    fn within(self, limit: f64) -> bool {
        let (simd, limit) = (self.simd, self.simd.splat_f64s(limit));
        let mut all = simd.equal_f64s(limit, limit);
        for x in self.registers {
            all = simd.and_m64s(all, simd.less_than_f64s(simd.abs_f64s(x), limit));
        }
        simd.first_true_m64s(simd.not_m64s(all)) == S::F64_LANES
    }

    #[inline(always)]
    fn each(self, f: impl Fn(f64) -> f64) -> Self {
        let mut row = [0.0; MOST];
        self.store(&mut row);
        Wide::load(self.simd, &row.map(f))
    }
}
