//! \[MVF10\]: nothing yet.

use super::{Account, Effort, Paper};

/// Returns the account. `progress` is called [`pieces`] times, from any thread.
pub fn account(_effort: &Effort, _progress: &(dyn Fn() + Sync)) -> Account {
    Account { paper: "mvf", title: Paper::Mvf.title(), entries: Vec::new(), figures: Vec::new() }
}

/// Returns how often [`account`] reports progress.
pub fn pieces(_effort: &Effort) -> usize {
    0
}
