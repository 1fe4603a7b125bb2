//! When the copies of one packet arrive.

/// The delays after which copies of one packet arrive, ascending; none when it is lost.
///
/// Holds up to [`Arrivals::CAPACITY`] copies; of more only the earliest are kept.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Arrivals {
    // Beyond `len` all are zero, so that equal arrivals are equal values.
    delays_s: [f64; Arrivals::CAPACITY],
    len: usize,
}

impl Arrivals {
    /// The largest number of copies.
    pub const CAPACITY: usize = 8;

    /// Returns the arrivals of a lost packet: none.
    pub fn lost() -> Arrivals {
        Arrivals { delays_s: [0.0; Arrivals::CAPACITY], len: 0 }
    }

    /// Returns the arrival of a single copy after `delay_s` seconds.
    pub fn one(delay_s: f64) -> Arrivals {
        Arrivals::lost().and(delay_s)
    }

    /// Returns these arrivals and one more after `delay_s` seconds, without the latest when there are too many.
    #[must_use]
    pub fn and(mut self, delay_s: f64) -> Arrivals {
        let at = self.delays_s().partition_point(|d| *d <= delay_s);
        if at < Arrivals::CAPACITY {
            self.len = (self.len + 1).min(Arrivals::CAPACITY);
            self.delays_s[at..self.len].rotate_right(1);
            self.delays_s[at] = delay_s;
        }
        self
    }

    /// Returns the delays in seconds, ascending.
    pub fn delays_s(&self) -> &[f64] {
        &self.delays_s[..self.len]
    }

    /// Returns whether no copy arrives.
    pub fn is_lost(&self) -> bool {
        self.len == 0
    }
}
