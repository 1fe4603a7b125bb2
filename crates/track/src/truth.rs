//! Where targets really were.

/// One known position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TruthPoint {
    /// Instant in seconds since the table's epoch.
    pub t_s: f64,
    /// Position in metres in the local frame; an unknown coordinate is absent.
    pub position_m: [Option<f64>; 3],
}

/// The known positions of one target, sorted by time.
#[derive(Clone, Debug, PartialEq)]
pub struct TargetTruth {
    /// The target's id; `None` when the table has no target column.
    pub target: Option<String>,
    /// Points in order of time.
    pub points: Vec<TruthPoint>,
}
