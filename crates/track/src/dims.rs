//! The list of state sizes that are compiled.

/// Evaluates `$body` with the constant `$size` equal to `$n`, or `$other` when `$n` is not between 1 and
/// [`MAX_STATE`](crate::spec::MAX_STATE).
macro_rules! with_size {
    ($n:expr, $size:ident => $body:expr, $other:expr) => {
        $crate::dims::with_size!(@list $n, $size, $body, $other, 1 2 3 4 5 6 7 8 9 10 11 12)
    };
    (@list $n:expr, $size:ident, $body:expr, $other:expr, $($literal:literal)*) => {
        match $n {
            $($literal => { const $size: usize = $literal; $body })*
            _ => $other,
        }
    };
}
pub(crate) use with_size;
