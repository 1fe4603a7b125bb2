//! Damaged files must not end the program: the Parquet decoder panics over some of them.

use parquet::errors::ParquetError;
use std::cell::Cell;
use std::panic::{self, AssertUnwindSafe};
use std::sync::Once;

thread_local! {
    /// Whether this thread is inside [`contained`].
    static IS_CONTAINED: Cell<bool> = const { Cell::new(false) };
}

/// Returns what `decode` returns; a panic inside it is an error, and prints nothing.
///
/// The reader that `decode` worked on must not be used after an error.
pub(super) fn contained<T>(decode: impl FnOnce() -> Result<T, ParquetError>) -> Result<T, ParquetError> {
    static QUIET: Once = Once::new();
    // The hook stays and is transparent to every panic outside.
    QUIET.call_once(|| {
        let before = panic::take_hook();
        panic::set_hook(Box::new(move |info| {
            if !IS_CONTAINED.get() {
                before(info);
            }
        }));
    });
    IS_CONTAINED.set(true);
    let result = panic::catch_unwind(AssertUnwindSafe(decode));
    IS_CONTAINED.set(false);
    result.unwrap_or_else(|_| Err(ParquetError::General("its parts contradict each other".to_owned())))
}
