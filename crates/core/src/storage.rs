//! Storage lent to estimators that remember a window: arrays where there is no heap, boxes where there is one.

/// Makes slices of a wanted length.
pub trait Store {
    /// What holds the values.
    type Of<T: Copy>: AsRef<[T]> + AsMut<[T]> + Clone;

    /// Returns room for at least `len` copies of `value`, or `None` when there is none.
    fn filled<T: Copy>(len: usize, value: T) -> Option<Self::Of<T>>;
}

/// Arrays of `CAP` entries.
#[derive(Clone, Copy, Debug)]
pub struct Fixed<const CAP: usize>;

impl<const CAP: usize> Store for Fixed<CAP> {
    type Of<T: Copy> = [T; CAP];

    fn filled<T: Copy>(len: usize, value: T) -> Option<[T; CAP]> {
        (len <= CAP).then_some([value; CAP])
    }
}
