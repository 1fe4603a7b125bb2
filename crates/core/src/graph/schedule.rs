//! Orders of sending on the graphs of a moving target.
//!
//! ```text
//! Chain        prior ─ x_0 ─ leap_0 ─ x_1 ─ leap_1 ─ x_2 …       one vector per instant, seen_k at each
//!
//! SplitChain   x_k, s_k scalars; place_k: x_{k+1} − x_k − D s_k = u;  speed_k: s_{k+1} − s_k = w;  seen_k at x_k
//! ```

use super::Send;

/// Where things are in the graph of a chain: variable k is x_k; factor 0 the prior of x_0, 1 + 2 k what is seen at k, 2 + 2 k the leap from k
/// to k + 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Chain;

impl Chain {
    /// The prior of x_0.
    pub const PRIOR: usize = 0;

    /// What is seen at instant k.
    pub fn seen(k: usize) -> usize {
        1 + 2 * k
    }

    /// The leap from instant k to the next.
    pub fn leap(k: usize) -> usize {
        2 + 2 * k
    }

    /// What instant k adds to a filter: the leap to it, or the prior, and what is seen. Afterwards the belief of x_k is x̂_{k|k}.
    pub fn onward(k: usize) -> impl Iterator<Item = Send> {
        let arrive = match k.checked_sub(1) {
            None => Send { factor: Self::PRIOR, slot: 0 },
            Some(before) => Send { factor: Self::leap(before), slot: 1 },
        };
        [arrive, Send { factor: Self::seen(k), slot: 0 }].into_iter()
    }

    /// Back from instant `from` to instant `to`, newest first. Afterwards the beliefs of those are given all up to `from`.
    pub fn back(from: usize, to: usize) -> impl Iterator<Item = Send> {
        (to..from).rev().map(|k| Send { factor: Self::leap(k), slot: 0 })
    }

    /// The Kalman filter over `len` instants.
    pub fn filter(len: usize) -> impl Iterator<Item = Send> {
        (0..len).flat_map(Self::onward)
    }

    /// The fixed-interval smoother over `len` instants: the filter, then all the way back.
    pub fn smoother(len: usize) -> impl Iterator<Item = Send> {
        Self::filter(len).chain(Self::back(len.saturating_sub(1), 0))
    }

    /// A fixed-lag smoother at instant k: onward, then `lag` instants back. What goes back does not come onward again.
    pub fn fixed_lag(k: usize, lag: usize) -> impl Iterator<Item = Send> {
        Self::onward(k).chain(Self::back(k, k.saturating_sub(lag)))
    }
}

/// Where things are in the graph of scalars: variable 2 k is x_k, 2 k + 1 is s_k; factors 0 and 1 their priors at 0; from 2 + 3 k on, those of the interval
/// from k to k + 1: the place's, the speed's, and what is seen at k + 1. Slots of the place's are x_k, s_k, x_{k+1}, of the speed's s_k, s_{k+1}.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SplitChain;

impl SplitChain {
    /// Ĝ_0, what is known of x_0, z_0 included.
    pub const PLACE_PRIOR: usize = 0;
    /// What is known of s_0.
    pub const SPEED_PRIOR: usize = 1;

    /// Variable x_k.
    pub fn place_at(k: usize) -> usize {
        2 * k
    }

    /// Variable s_k.
    pub fn speed_at(k: usize) -> usize {
        2 * k + 1
    }

    /// x_{k+1} − x_k − D s_k = u.
    pub fn place(k: usize) -> usize {
        2 + 3 * k
    }

    /// s_{k+1} − s_k = w.
    pub fn speed(k: usize) -> usize {
        3 + 3 * k
    }

    /// What is seen of x_{k+1}.
    pub fn seen(k: usize) -> usize {
        4 + 3 * k
    }

    /// The start of FOSB: the two priors.
    pub fn start() -> impl Iterator<Item = Send> {
        [Self::PLACE_PRIOR, Self::SPEED_PRIOR].into_iter().map(|factor| Send { factor, slot: 0 })
    }

    /// FOSB over the interval from k to k + 1: steps 9, 10, 5 and 8 of \[FOSB12\]; steps 11, 6 and 7 are the products at s_k, s_{k+1} and x_{k+1}. The speed goes
    /// back one instant and the location never does.
    pub fn fosb(k: usize) -> impl Iterator<Item = Send> {
        [
            Send { factor: Self::seen(k), slot: 0 },
            Send { factor: Self::place(k), slot: 1 },
            Send { factor: Self::speed(k), slot: 1 },
            Send { factor: Self::place(k), slot: 2 },
        ]
        .into_iter()
    }
}
