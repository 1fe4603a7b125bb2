//! Modes of motion that take turns: a Markov chain in continuous time.

use super::DesignError;

/// Most modes of motion.
pub const MOST_MODES: usize = 4;

/// How long modes last: mode i for `mean_s[i]` seconds on average, whatever has been before, then any other with equal probability.
///
/// ```
/// use fixtrail_core::models::Switching;
///
/// // Straight on for 20 s on average, then a turn of 2 s.
/// let switching = Switching::new(&[20.0, 2.0])?;
/// let p = switching.over(1.0);
/// assert!((p[0][1] - 0.0385).abs() < 1e-4 && (p[1][0] - 0.385).abs() < 1e-3);
/// assert!((switching.stationary()[1] - 1.0 / 11.0).abs() < 1e-15);
/// # Ok::<(), fixtrail_core::models::DesignError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Switching {
    count: usize,
    mean_s: [f64; MOST_MODES],
}

/// Shortest time that a mode may last on average, seconds.
const SHORTEST_S: f64 = 1e-9;

/// With at most half a change of mode expected, the first term left out is `0.5¹⁷/17!`, 2e-20 of the sum.
const TERMS: u32 = 16;

impl Switching {
    /// Returns the chain of as many modes as there are entries.
    ///
    /// # Errors
    /// [`DesignError::Modes`] for none or more than [`MOST_MODES`], [`DesignError::Duration`] for a mean that is not finite or below 1e-9.
    pub fn new(mean_s: &[f64]) -> Result<Self, DesignError> {
        let count = mean_s.len();
        if !(1..=MOST_MODES).contains(&count) {
            return Err(DesignError::Modes { count });
        }
        if let Some(mode) = mean_s.iter().position(|s| !(s.is_finite() && *s >= SHORTEST_S)) {
            return Err(DesignError::Duration { mode, mean_s: mean_s[mode] });
        }
        let mut held = [1.0; MOST_MODES];
        held[..count].copy_from_slice(mean_s);
        Ok(Self { count, mean_s: held })
    }

    /// Number of modes.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Returns the share of time that each mode has in the long run: in proportion to how long it lasts. Modes that do not exist have 0.
    pub fn stationary(&self) -> [f64; MOST_MODES] {
        let total: f64 = self.mean_s[..self.count].iter().sum();
        core::array::from_fn(|i| if i < self.count { self.mean_s[i] / total } else { 0.0 })
    }

    /// Returns the probability, `[i][j]`, that mode j holds `dt_s` seconds after mode i did: `exp(G dt)` with the generator
    ///
    /// ```text
    /// G_ii = −1/mean_i        G_ij = 1/((count − 1) mean_i)
    /// ```
    ///
    /// By uniformisation: with λ the largest rate `I + G/λ` is a stochastic matrix U, and `exp(G t) = e^(−λt) Σ (λt)^k/k! U^k`. For t such
    /// that λt ≤ ½; doubled to dt by squaring. No number is negative and none is subtracted, so that small probabilities keep their digits;
    /// rows are scaled to a sum of 1.
    /// `dt_s` must be at least 0; 0 gives the identity.
    pub fn over(&self, dt_s: f64) -> [[f64; MOST_MODES]; MOST_MODES] {
        debug_assert!(dt_s >= 0.0, "an interval of {dt_s} s");
        let rate = |i: usize| 1.0 / self.mean_s[i];
        let fastest = (0..self.count).map(rate).fold(0.0, f64::max);
        let step: Square = core::array::from_fn(|i| {
            core::array::from_fn(|j| match (i < self.count && j < self.count, i == j) {
                (true, true) if self.count > 1 => 1.0 - rate(i) / fastest,
                (true, false) => rate(i) / fastest / (self.count - 1) as f64,
                (_, true) => 1.0,
                (_, false) => 0.0,
            })
        });
        // Beyond any number of changes the chain has forgotten where it began.
        let (mut changes, mut doublings) = (f64::min(fastest * dt_s, 1e300), 0);
        while changes > 0.5 {
            changes *= 0.5;
            doublings += 1;
        }
        let mut sum = IDENTITY;
        for k in (1..=TERMS).rev() {
            let next = product(&step, &sum);
            let weight = changes / f64::from(k);
            sum = core::array::from_fn(|i| core::array::from_fn(|j| IDENTITY[i][j] + weight * next[i][j]));
        }
        let mut over = stochastic(sum);
        for _ in 0..doublings {
            over = stochastic(product(&over, &over));
        }
        over
    }
}

type Square = [[f64; MOST_MODES]; MOST_MODES];

const IDENTITY: Square = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];

fn product(a: &Square, b: &Square) -> Square {
    core::array::from_fn(|i| core::array::from_fn(|j| (0..MOST_MODES).map(|k| a[i][k] * b[k][j]).sum()))
}

/// Scales rows to a sum of 1.
fn stochastic(m: Square) -> Square {
    m.map(|row| {
        let total: f64 = row.iter().sum();
        row.map(|p| p / total)
    })
}
