//! How an instant was linearised: the record that a filter leaves for smoothers.

use fixtrail_core::estimators::smoother::Arrive;
use fixtrail_core::{Row, Vector};

/// One instant as it was linearised: what a smoother goes back over.
#[derive(Clone, Debug)]
pub struct Linearised<const N: usize> {
    /// The point that state and rows are relative to.
    pub nominal: Vector<N>,
    /// How the deviation from the nominal came here; `None` on the first instant.
    pub arrive: Option<Arrive<N>>,
    /// Rows at `nominal` that were used.
    pub rows: Vec<Row<N>>,
    /// Whether the instant left a nonlinear start before the state was determined: there is no estimate of it.
    pub forgotten: bool,
}
