//! The two-filter form of a sliding window: one state inside it has what the data before say of it, from a filter that runs backward in
//! time, and what the data after say.
//!
//! With the state at the boundary as the first one of an [`Element`], the data after are one element, to which an instant is added by
//! its rows and its leap. So are the data before, with time reversed, `x = F⁻¹ (x⁺ − b − w)`: its η and J are what they say of the same
//! state when that of the window's first instant is unknown. Both add up \[FRP69\] (there the backward filter takes the later data):
//!
//! ```text
//! x̂ = (J_past + J)⁻¹ (η_past + η) at the boundary,   F x̂ + b and C + F (J_past + J)⁻¹ Fᵀ at the end
//! ```
//!
//! The backward filter leaves its (η, J) at each instant: dropping the oldest instant is a step back along them. When they are used up
//! it starts again from the newest instant, so an instant is taken once in either direction, and nothing is subtracted or drifts.

use crate::estimators::fms::element::{Element, Information};
use crate::linalg::Lu;
use crate::storage::Store;
use crate::types::{Belief, Matrix, Row};

/// Largest ratio of a row's variance given the boundary to that of its noise, where six digits of the covariance go: an F that forgets makes its
/// inverse grow, a long gap the covariance either way.
const MOST: f64 = 1e6;

/// Largest `Σ_k |F_ik F⁻¹_ki|` over i, where three digits of the inverse go; 1 for triangular F.
const MOST_INVERSE: f64 = 1e3;

/// Scaled pivot of the information on the boundary below which others decide. What a stable F without noise says of a late state grows
/// for ever in some directions against time, and leaves fewer digits to the rest than a first state has.
const LEAST_PIVOT: f64 = 1e-3;

/// A window as two filters that meet.
#[derive(Clone)]
pub struct TwoFilter<const N: usize, S: Store> {
    /// Entry i: what the i + 1 newest instants before the boundary say of the state there.
    past: S::Of<Information<N>>,
    past_len: usize,
    future: Element<N>,
    future_len: usize,
    /// Instants to come before a window is taken anew: one that could not be taken is asked for again at each step.
    rest: usize,
}

impl<const N: usize, S: Store> TwoFilter<N, S> {
    /// An empty window with room for `capacity` instants, or `None` when the store has no such room.
    pub fn new(capacity: usize) -> Option<Self> {
        let past = S::filled(capacity.max(1), Information::none())?;
        Some(Self { past, past_len: 0, future: Element::identity(), future_len: 0, rest: 0 })
    }

    /// Number of instants; 0 when the window is to be taken anew.
    pub fn len(&self) -> usize {
        self.past_len + self.future_len
    }

    /// Whether the window is to be taken anew.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Forgets everything.
    pub fn clear(&mut self) {
        self.past_len = 0;
        self.future_len = 0;
    }

    /// Adds the newest instant to a window that is not empty: `instant` takes its rows by [`take_row`] and the leap to it or from it, as
    /// [`turn`](TwoFilter::turn) did. Where that loses digits the window is empty, and taken anew once as many instants have come.
    #[inline]
    pub fn push(&mut self, instant: impl FnOnce(&mut Element<N>) -> Option<()>) {
        if self.is_empty() {
            self.rest = self.rest.saturating_sub(1);
        } else if instant(&mut self.future).is_some() {
            self.future_len += 1;
        } else {
            self.rest = self.len();
            self.clear();
        }
    }

    /// Forgets the `count` oldest instants, or everything when the boundary is among them.
    #[inline]
    pub fn drop_front(&mut self, count: usize) {
        match self.past_len.checked_sub(count) {
            Some(left) => self.past_len = left,
            None => self.clear(),
        }
    }

    /// Takes a window of `len` instants, the boundary at its end. `back(i, past)` goes back over instant `i`: the leap that follows
    /// it, if it is before the boundary, by [`Element::leap_back`], and its rows by [`take_row`]. `None` when that loses digits or the store
    /// has no room, and then until as many instants have come; the window is empty then.
    pub fn turn(&mut self, len: usize, mut back: impl FnMut(usize, &mut Element<N>) -> Option<()>) -> Option<()> {
        self.clear();
        if self.rest > 0 {
            return None;
        }
        self.rest = len;
        if self.past.as_ref().len() < len {
            self.past = S::filled(len, Information::none())?;
        }
        let room = self.past.as_mut().get_mut(..len)?;
        let mut past = Element::identity();
        for (i, entry) in (0..len).rev().zip(room) {
            back(i, &mut past)?;
            *entry = *past.told();
        }
        self.rest = 0;
        self.past_len = len;
        self.future = Element::identity();
        Some(())
    }

    /// The estimate at the end of the window, its first state unknown. `None` when the information on the boundary is too
    /// ill-conditioned to be decided upon here.
    #[inline]
    pub fn filtered(&self) -> Option<Belief<N>> {
        match self.past_len {
            0 => self.future.filtered(&Information::none(), LEAST_PIVOT),
            len => self.future.filtered(&self.past.as_ref()[len - 1], LEAST_PIVOT),
        }
    }
}

/// Takes a row in either filter; `None` when too many digits would go.
#[inline]
pub fn take_row<const N: usize>(filter: &mut Element<N>, row: &Row<N>) -> Option<()> {
    (filter.row(row) <= MOST * row.var).then_some(())
}

/// Returns F⁻¹; `None` when F is singular or its inverse would lose digits.
pub fn inverse_of<const N: usize>(f: &Matrix<N, N>) -> Option<Matrix<N, N>> {
    let inverse = Lu::new(*f)?.solve(Matrix::identity());
    let size = |i: usize| (0..N).map(|k| (f[(i, k)] * inverse[(k, i)]).abs()).sum::<f64>();
    (0..N).all(|i| size(i) <= MOST_INVERSE).then_some(inverse)
}
