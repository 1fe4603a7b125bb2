//! Random numbers that tests of several files draw.

#![allow(dead_code)] // Each takes what it needs.

/// Random numbers without a dependency: splitmix64.
pub struct Random(pub u64);

impl Random {
    /// From 0 up to, but not including, 1.
    pub fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// 10^u, u from `least` to `most`.
    pub fn decades(&mut self, least: f64, most: f64) -> f64 {
        10_f64.powf(least + (most - least) * self.unit())
    }
}
