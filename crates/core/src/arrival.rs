//! Learning the arrival rate on line: from losses that are seen, or from values that repeat.

use crate::estimators::augmented::Hold;

/// Posterior of an arrival rate under a uniform prior, from packets that were due and known to have come or not.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Counted {
    came: f64,
    lost: f64,
}

impl Counted {
    /// Counts packets that came and packets that did not.
    pub fn count(&mut self, came: u64, lost: u64) {
        self.came += came as f64;
        self.lost += lost as f64;
    }

    /// Returns the mean of the posterior, Beta(1 + came, 1 + lost).
    pub fn mean(&self) -> f64 {
        (1.0 + self.came) / (2.0 + self.came + self.lost)
    }

    /// Returns the standard deviation of the posterior, `√(m (1 − m) / (n + 3))` with the mean m and n packets.
    pub fn sd(&self) -> f64 {
        let mean = self.mean();
        libm::sqrt(mean * (1.0 - mean) / (self.total() + 3.0))
    }

    /// Returns the number of packets that were counted.
    pub fn total(&self) -> f64 {
        self.came + self.lost
    }
}

/// Number of rates that are told apart.
const RATES: usize = 100;

/// Posterior of the arrival rate p from whether each value shown repeats the one before, under a uniform prior.
///
/// With [`Hold::LastReceived`] a value repeats exactly when nothing came. With [`Hold::Paper`] it does when nothing came and what is
/// shown then, z_{k−1}, was shown before already: losses `γ_{k−2} γ_{k−1} γ_k = 1 0 0` and `· 1 0` repeat, `0 0 0` and every 1 do not.
/// The last two arrivals are a Markov chain with four states of which repeats are a function, so the likelihood of every p on a grid of
/// 100 follows exactly from its forward recursion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Repeated {
    hold: Hold,
    /// Joint density of p on the grid and of (γ_{k−1}, γ_k); index 2 γ_{k−1} + γ_k.
    joint: [[f64; 4]; RATES],
    /// Values observed.
    count: f64,
}

impl Repeated {
    /// Returns the prior at the start, where γ_{−1} = γ_0 = 1.
    pub fn start(hold: Hold) -> Self {
        Self { hold, joint: [[0.0, 0.0, 0.0, 1.0 / RATES as f64]; RATES], count: 0.0 }
    }

    /// Takes in whether the value of the next instant repeats the one before.
    pub fn observe(&mut self, repeats: bool) {
        let mut total = 0.0;
        let mut next = [[0.0; 4]; RATES];
        for (i, (from, to)) in self.joint.iter().zip(&mut next).enumerate() {
            let p = rate(i);
            for (state, density) in from.iter().enumerate() {
                let (older, last) = (state / 2 == 1, state % 2 == 1);
                for came in [false, true] {
                    let seen = match self.hold {
                        Hold::LastReceived => !came,
                        Hold::Paper => !came && (last || older),
                    };
                    if seen == repeats {
                        to[2 * usize::from(last) + usize::from(came)] += density * if came { p } else { 1.0 - p };
                    }
                }
            }
            total += to.iter().sum::<f64>();
        }
        if total > 0.0 {
            next.iter_mut().flatten().for_each(|d| *d /= total);
            self.joint = next;
            self.count += 1.0;
        }
    }

    /// Returns the mean of the posterior.
    pub fn mean(&self) -> f64 {
        self.joint.iter().enumerate().map(|(i, d)| rate(i) * d.iter().sum::<f64>()).sum()
    }

    /// Returns the standard deviation of the posterior, that of a rate within its part of the grid included.
    pub fn sd(&self) -> f64 {
        let mean = self.mean();
        let away = |(i, d): (usize, &[f64; 4])| (rate(i) - mean) * (rate(i) - mean) * d.iter().sum::<f64>();
        let within = 1.0 / (RATES * RATES) as f64 / 12.0;
        libm::sqrt(self.joint.iter().enumerate().map(away).sum::<f64>() + within)
    }

    /// Returns the number of values that were observed.
    pub fn total(&self) -> f64 {
        self.count
    }
}

/// Midpoints of equal parts of [0, 1].
fn rate(i: usize) -> f64 {
    (i as f64 + 0.5) / RATES as f64
}
