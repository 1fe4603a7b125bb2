//! Storage from the heap, for windows whose length the spec chooses.

use fixtrail_core::storage::Store;

/// Boxes of any length.
#[derive(Clone, Copy, Debug)]
pub struct Heap;

impl Store for Heap {
    type Of<T: Copy> = Box<[T]>;

    fn filled<T: Copy>(len: usize, value: T) -> Option<Box<[T]>> {
        Some(vec![value; len].into_boxed_slice())
    }
}
