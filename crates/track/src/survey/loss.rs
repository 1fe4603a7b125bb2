//! How many packets the network lost, and whether it lost them one by one or in bursts.

use super::stats::{ascending, median, quantile};
use std::collections::BTreeMap;

/// Where the number of expected packets comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Basis {
    /// Sequence numbers.
    Sequence,
    /// The rate at which each source usually reports.
    Rate,
    /// The rows of a linear run.
    Rows,
    /// The outcome of each packet is known, as in a simulation or a packet trace.
    Outcomes,
}

impl Basis {
    /// Where the number comes from, in words.
    pub fn name(self) -> &'static str {
        match self {
            Basis::Sequence => "sequence numbers",
            Basis::Rate => "the usual rate of each source",
            Basis::Rows => "the rows of the run",
            Basis::Outcomes => "the outcome of each packet",
        }
    }
}

/// Expected and lost packets, and the lengths of the bursts in which they were lost.
#[derive(Clone, Debug, PartialEq)]
pub struct Loss {
    /// Where the number of expected packets comes from.
    pub basis: Basis,
    /// Packets that should have come.
    pub expected: u64,
    /// Packets that did not.
    pub lost: u64,
    /// Number of bursts by length: 1, 2, … 9, and 10 or more.
    pub bursts: [u64; 10],
    /// Length of the longest burst.
    pub longest_burst: u64,
    /// Sum of the burst lengths after [`MAX_BURST`] was applied, see [`Loss::mean_burst`].
    burst_packets: u64,
}

/// Longer silences are outages (out of range, switched off), not bursts of a channel: they count as lost, not as a burst.
pub const MAX_BURST: u64 = 1000;

impl Loss {
    pub(super) fn new(basis: Basis) -> Loss {
        Loss { basis, expected: 0, lost: 0, bursts: [0; 10], longest_burst: 0, burst_packets: 0 }
    }

    /// Returns the losses of one sender: whether each of its packets was lost, in the order in which they were sent.
    pub fn of(lost: impl IntoIterator<Item = bool>) -> Loss {
        let mut loss = Loss::new(Basis::Outcomes);
        let mut length = 0;
        for is_lost in lost {
            if is_lost {
                length += 1;
            } else {
                loss.burst(core::mem::take(&mut length));
                loss.came(1);
            }
        }
        loss.burst(length);
        loss
    }

    /// Counts packets that came.
    pub(super) fn came(&mut self, packets: u64) {
        self.expected += packets;
    }

    /// Counts a burst of `length` lost packets.
    pub(super) fn burst(&mut self, length: u64) {
        if length == 0 {
            return;
        }
        self.expected += length;
        self.lost += length;
        self.longest_burst = self.longest_burst.max(length);
        if length <= MAX_BURST {
            self.bursts[(length - 1).min(9) as usize] += 1;
            self.burst_packets += length;
        }
    }

    /// Adds the counts of another source.
    pub fn add(&mut self, other: &Loss) {
        self.expected += other.expected;
        self.lost += other.lost;
        self.longest_burst = self.longest_burst.max(other.longest_burst);
        self.burst_packets += other.burst_packets;
        for (mine, theirs) in self.bursts.iter_mut().zip(&other.bursts) {
            *mine += theirs;
        }
    }

    /// Share of the expected packets that were lost.
    pub fn rate(&self) -> f64 {
        if self.expected == 0 { 0.0 } else { self.lost as f64 / self.expected as f64 }
    }

    /// Number of bursts.
    pub fn burst_count(&self) -> u64 {
        self.bursts.iter().sum()
    }

    /// Mean burst length; `None` without a burst.
    pub fn mean_burst(&self) -> Option<f64> {
        let count = self.burst_count();
        (count > 0).then(|| self.burst_packets as f64 / count as f64)
    }

    /// Rate of loss outside outages.
    fn burst_rate(&self) -> f64 {
        let expected = self.expected - self.lost + self.burst_packets;
        if expected == 0 { 0.0 } else { self.burst_packets as f64 / expected as f64 }
    }

    /// Mean burst length that independent losses of the same rate `p` would have: `1/(1 − p)`, geometric.
    pub fn geometric_mean_burst(&self) -> Option<f64> {
        let rate = self.burst_rate();
        (rate < 1.0).then(|| 1.0 / (1.0 - rate))
    }

    /// Number of bursts of each length that independent losses of the same rate would have given.
    pub fn geometric_bursts(&self) -> [f64; 10] {
        let (count, rate) = (self.burst_count() as f64, self.burst_rate());
        core::array::from_fn(|i| {
            let at_least = count * rate.powi(i as i32);
            if i == 9 { at_least } else { at_least * (1.0 - rate) }
        })
    }

    /// Whether bursts are longer than independent losses would be: by three standard errors and by a fifth.
    ///
    /// The length of a geometric burst has variance `p/(1 − p)²`.
    pub fn is_bursty(&self) -> bool {
        let (Some(mean), Some(geometric)) = (self.mean_burst(), self.geometric_mean_burst()) else { return false };
        let rate = self.burst_rate();
        let error = (rate / (1.0 - rate).powi(2) / self.burst_count() as f64).sqrt();
        mean > 1.2 * geometric && mean - geometric > 3.0 * error
    }
}

/// The usual interval between the reports of a source, if it has one.
///
/// `times` ascend. A source has a period when half of its intervals lie within 15 % of a whole number of periods (of random
/// intervals three in ten do), six in ten are a single one (so that up to four in ten may be lost at random), and when no one
/// longer interval that comes again and again makes up most of what would be lost: that is a source with two rates.
pub(super) fn period(times: &[f64]) -> Option<f64> {
    let intervals = ascending(times.windows(2).map(|w| w[1] - w[0]).filter(|d| *d > 0.0));
    if intervals.len() < 8 {
        return None;
    }
    let base = quantile(&intervals, 0.25)?;
    let period = median(intervals.iter().copied().filter(|d| (0.5 * base..1.5 * base).contains(d)))?;
    let multiple = |d: &f64| (d / period).round().max(1.0);
    let whole = intervals.iter().filter(|d| (**d / period - multiple(d)).abs() <= 0.15).count();
    let mut counts: BTreeMap<u64, u64> = BTreeMap::new();
    for d in &intervals {
        *counts.entry(multiple(d) as u64).or_default() += 1;
    }
    let single = counts.get(&1).copied().unwrap_or(0);
    let lost: u64 = counts.iter().map(|(k, n)| (k - 1) * n).sum();
    let two_rates = counts.iter().any(|(k, n)| *k >= 3 && *n >= 10 && 2 * (k - 1) * n > lost);
    let all = intervals.len() as u64;
    (2 * whole as u64 >= all && 10 * single >= 6 * all && !two_rates).then_some(period)
}

/// Losses of a source that reports every `period` seconds; `times` ascend and hold no duplicates.
pub(super) fn by_rate(times: &[f64], period: f64) -> Loss {
    let mut loss = Loss::new(Basis::Rate);
    loss.came(times.len() as u64);
    for w in times.windows(2) {
        loss.burst(((w[1] - w[0]) / period).round().max(1.0) as u64 - 1);
    }
    loss
}

/// Losses by sequence numbers in order of time; a number that falls or leaps far is a restarted or wrapped counter, not a loss.
pub(super) fn by_sequence(numbers: &[u64]) -> Loss {
    let mut loss = Loss::new(Basis::Sequence);
    loss.came(numbers.len() as u64);
    for w in numbers.windows(2) {
        let missing = w[1].saturating_sub(w[0]).saturating_sub(1);
        if missing < 10 * MAX_BURST {
            loss.burst(missing);
        }
    }
    loss
}
