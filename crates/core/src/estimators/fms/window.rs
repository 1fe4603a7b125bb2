//! The instants of a sliding window, in a ring.

use crate::linalg::compress;
use crate::storage::Store;
use crate::types::{Matrix, Row, StepError, Transition, Vector};

/// One instant of a window: how the state came here, and what was measured.
#[derive(Clone, Copy, Debug)]
pub struct Node<const N: usize> {
    /// Transition from the instant before; not used on the oldest node of a window.
    pub arrive: Transition<N>,
    rows: [Row<N>; N],
    len: usize,
}

impl<const N: usize> Node<N> {
    /// A node with the given rows; more than `N` are replaced by `N` that say the same (`rows` is overwritten).
    pub fn new(arrive: &Transition<N>, rows: &mut [Row<N>]) -> Self {
        let (len, _) = compress(rows);
        let mut node = Self { arrive: *arrive, ..Self::zero() };
        node.len = len;
        node.rows[..len].copy_from_slice(&rows[..len]);
        node
    }

    /// A placeholder for storage.
    pub fn zero() -> Self {
        Self {
            arrive: Transition { next: Vector::zeros(), f: Matrix::identity(), q: Matrix::zeros() },
            rows: [Row { h: Vector::zeros(), residual: 0.0, var: 1.0 }; N],
            len: 0,
        }
    }

    /// Its rows.
    pub fn rows(&self) -> &[Row<N>] {
        &self.rows[..self.len]
    }
}

/// A ring of nodes, oldest first.
#[derive(Clone)]
pub struct Window<const N: usize, S: Store> {
    nodes: S::Of<Node<N>>,
    head: usize,
    len: usize,
}

impl<const N: usize, S: Store> Window<N, S> {
    /// An empty window with room for `capacity` nodes, or `None` when the store has no such room.
    pub fn new(capacity: usize) -> Option<Self> {
        Some(Self { nodes: S::filled(capacity.max(1), Node::zero())?, head: 0, len: 0 })
    }

    /// Number of nodes.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether there are no nodes.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Node `i`, the oldest is 0.
    pub fn get(&self, i: usize) -> &Node<N> {
        let nodes = self.nodes.as_ref();
        &nodes[(self.head + i) % nodes.len()]
    }

    /// Adds the newest node, asking the store for twice the room when it is full.
    ///
    /// # Errors
    /// [`StepError::WindowFull`] when the store has no more room; nothing has changed then.
    pub fn push(&mut self, node: Node<N>) -> Result<(), StepError> {
        let capacity = self.nodes.as_ref().len();
        if self.len == capacity {
            let full = StepError::WindowFull { capacity, needed: capacity + 1 };
            let mut larger = S::filled(2 * capacity, Node::zero()).ok_or(full)?;
            if larger.as_ref().len() <= capacity {
                return Err(full);
            }
            for i in 0..self.len {
                larger.as_mut()[i] = *self.get(i);
            }
            self.nodes = larger;
            self.head = 0;
        }
        let slots = self.nodes.as_mut();
        let at = (self.head + self.len) % slots.len();
        slots[at] = node;
        self.len += 1;
        Ok(())
    }

    /// Forgets the `count` oldest nodes.
    pub fn drop_front(&mut self, count: usize) {
        let count = count.min(self.len);
        self.head = (self.head + count) % self.nodes.as_ref().len();
        self.len -= count;
    }
}
