//! How an instant was linearised: the record that a filter leaves for smoothers.

use fixtrail_core::estimators::smoother::Arrive;
use fixtrail_core::{Row, Vector};

/// One instant as it was linearised: what a smoother goes back over.
#[derive(Clone, Debug)]
pub struct Linearised<const N: usize> {
    /// The point that state and rows are relative to.
    pub nominal: Vector<N>,
    /// How the deviation from the nominal came here; `None` on the first instant, and on the first after a lost track was given up.
    pub arrive: Option<Arrive<N>>,
    /// Rows at `nominal` that were used.
    pub rows: Vec<Row<N>>,
    /// Whether the instant left a nonlinear start before the state was determined: there is no estimate of it.
    pub forgotten: bool,
}

impl<const N: usize> Linearised<N> {
    /// An instant of which there is no estimate.
    pub(crate) fn forgotten() -> Self {
        Self { nominal: Vector::zeros(), arrive: None, rows: Vec::new(), forgotten: true }
    }

    /// Whether nothing is carried over from the instant before: the run's first that is not forgotten, or a new start.
    pub fn begins(&self) -> bool {
        self.arrive.is_none() && !self.forgotten
    }
}
