//! A finite-memory gain that slides over one series of measurements, one instant at a time.
//!
//! ```text
//! x̂ = Σ_j gain_j z_j,   j = 0 (oldest) … M − 1 (newest)
//! ```
//!
//! What [`fms::invariant`](crate::estimators::fms::invariant) is while nothing is lost, without the covariances, which do not change. A window
//! with a lost measurement has no estimate here: that one is asked for it.

/// The last `M` measurements and the gain that they are multiplied by.
#[derive(Clone, Copy, Debug)]
pub struct Sliding<const N: usize, const M: usize> {
    gain: [[f64; N]; M],
    /// Every measurement twice, `M` apart: the window is contiguous wherever it starts.
    ring: [[f64; M]; 2],
    /// Where the oldest is, and the next will be.
    head: usize,
    /// How many measurements there must be until the window is whole.
    missing: usize,
}

impl<const N: usize, const M: usize> Sliding<N, M> {
    /// An empty window. `gain` has a column for each measurement, that of the oldest first.
    pub fn new(gain: &[[f64; N]; M]) -> Self {
        const { assert!(M > 0, "a window without measurements") };
        Sliding { gain: *gain, ring: [[0.0; M]; 2], head: 0, missing: M }
    }

    /// Takes a measurement (NaN: lost) and returns the estimate from the last `M`; `None` while there are fewer, or one of them is lost.
    #[inline(always)]
    pub fn push(&mut self, z: f64) -> Option<[f64; N]> {
        let newest = self.head;
        self.ring[0][newest] = z;
        self.ring[1][newest] = z;
        let head = if newest + 1 == M { 0 } else { newest + 1 };
        self.head = head;
        self.missing = if z.is_nan() { M } else { self.missing.saturating_sub(1) };
        if self.missing > 0 {
            return None;
        }
        let window = self.ring.as_flattened()[head..].first_chunk::<M>()?;
        // A measurement at a time: read in pairs, those that were written one by one a moment ago would be waited for. Three sums, for
        // each addition waits for the last.
        let mut sums = [[0.0; N]; 3];
        let ((gains, last_gains), (threes, last)) = (self.gain.as_chunks::<3>(), window.as_chunks::<3>());
        for (gains, threes) in gains.iter().zip(threes) {
            for (sum, (gain, z)) in sums.iter_mut().zip(gains.iter().zip(threes)) {
                add(sum, gain, *z);
            }
        }
        for (sum, (gain, z)) in sums.iter_mut().zip(last_gains.iter().zip(last)) {
            add(sum, gain, *z);
        }
        let [mut all, second, third] = sums;
        add(&mut all, &second, 1.0);
        add(&mut all, &third, 1.0);
        Some(all)
    }
}

#[inline(always)]
fn add<const N: usize>(sum: &mut [f64; N], gain: &[f64; N], z: f64) {
    for (sum, gain) in sum.iter_mut().zip(gain) {
        *sum += gain * z;
    }
}
