//! Two-stack sliding aggregation: the combined element of a queue, with amortised O(1) combinations per push and pop and no
//! subtraction, so nothing drifts.

use crate::estimators::fms::element::Element;
use crate::storage::Store;
use crate::types::{Row, StepError, Transition};

/// A queue of elements that knows the combination of all of them.
///
/// The front stack holds suffix aggregates, the back only its aggregate and its elements, which become the next front.
#[derive(Clone)]
pub struct Stacks<const N: usize, S: Store> {
    front: S::Of<Element<N>>,
    front_len: usize,
    back: S::Of<Element<N>>,
    back_len: usize,
    back_all: Element<N>,
}

impl<const N: usize, S: Store> Stacks<N, S> {
    /// An empty queue with room for `capacity` elements, or `None` when the store has no such room.
    pub fn new(capacity: usize) -> Option<Self> {
        Some(Self {
            front: S::filled(capacity.max(1), Element::identity())?,
            front_len: 0,
            back: S::filled(capacity.max(1), Element::identity())?,
            back_len: 0,
            back_all: Element::identity(),
        })
    }

    /// Number of elements.
    pub fn len(&self) -> usize {
        self.front_len + self.back_len
    }

    /// Whether there are no elements.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Forgets everything.
    pub fn clear(&mut self) {
        self.front_len = 0;
        self.back_len = 0;
        self.back_all = Element::identity();
    }

    /// Adds an instant at the end: its rows, then the leap to the next.
    ///
    /// # Errors
    /// [`StepError::WindowFull`] when the store has no more room.
    pub fn push(&mut self, rows: &[Row<N>], leap: &Transition<N>) -> Result<(), StepError> {
        let capacity = self.back.as_ref().len();
        if self.back_len == capacity {
            let full = StepError::WindowFull { capacity, needed: capacity + 1 };
            let mut back = S::filled(2 * capacity, Element::identity()).ok_or(full)?;
            let mut front = S::filled(2 * capacity, Element::identity()).ok_or(full)?;
            if back.as_ref().len() <= capacity {
                return Err(full);
            }
            back.as_mut()[..self.back_len].copy_from_slice(&self.back.as_ref()[..self.back_len]);
            front.as_mut()[..self.front_len].copy_from_slice(&self.front.as_ref()[..self.front_len]);
            self.back = back;
            self.front = front;
        }
        rows.iter().for_each(|row| {
            self.back_all.row(row);
        });
        self.back_all.leap(&leap.f, &leap.next, &leap.q);
        self.back.as_mut()[self.back_len] = Element::instant(rows, Some(leap));
        self.back_len += 1;
        Ok(())
    }

    /// Removes the oldest element. `None` when there is none, or when a combination cannot be formed in working precision.
    pub fn pop(&mut self) -> Option<()> {
        if self.front_len == 0 {
            let mut suffix = Element::identity();
            for i in 0..self.back_len {
                suffix = self.back.as_ref()[self.back_len - 1 - i].combine(&suffix)?;
                self.front.as_mut()[i] = suffix;
            }
            self.front_len = self.back_len;
            self.back_len = 0;
            self.back_all = Element::identity();
        }
        self.front_len = self.front_len.checked_sub(1)?;
        Some(())
    }

    /// The combination of all elements, oldest first.
    pub fn all(&self) -> Option<Element<N>> {
        match self.front_len {
            0 => Some(self.back_all),
            n => self.front.as_ref()[n - 1].combine(&self.back_all),
        }
    }
}
