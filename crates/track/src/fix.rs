//! Where a target is, and how far to trust it.

/// Why a row says what it says.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Status {
    /// At least one measurement of the instant was used.
    Updated,
    /// Nothing usable arrived; the estimate is a prediction.
    Predicted,
    /// Everything that arrived was gated out.
    Rejected,
    /// The data do not determine the state: no estimate.
    Unobservable,
}

impl Status {
    /// The word that files use.
    pub fn name(self) -> &'static str {
        match self {
            Status::Updated => "updated",
            Status::Predicted => "predicted",
            Status::Rejected => "rejected",
            Status::Unobservable => "unobservable",
        }
    }
}

/// Mean and covariance of the state at one instant.
#[derive(Clone, Copy, Debug)]
pub struct Estimate<'a> {
    /// Mean, `n` values in the order of the [`Layout`](crate::layout::Layout).
    pub mean: &'a [f64],
    /// Covariance, `n × n` values (symmetric, so row- or column-major alike).
    pub cov: &'a [f64],
}

/// The smoother's half of a row: an estimate of an earlier instant given the same data.
#[derive(Clone, Copy, Debug)]
pub struct Lagged<'a> {
    /// Index of the instant it describes.
    pub k: u64,
    /// The instant it describes, seconds; absent for a lost row of an untimed gap.
    pub t_s: Option<f64>,
    /// `None` when the data do not determine it.
    pub estimate: Option<Estimate<'a>>,
    /// [`Status::Updated`], [`Status::Predicted`] or [`Status::Unobservable`].
    pub status: Status,
}

/// One row of a trail, borrowed from the tracker that made it.
#[derive(Clone, Copy, Debug)]
pub struct Fix<'a> {
    /// Index of the instant the estimate describes, from 0 within the target.
    pub k: u64,
    /// The instant it describes, seconds; absent for a lost row of an untimed gap.
    pub t_s: Option<f64>,
    /// `None` exactly when `status` is [`Status::Unobservable`].
    pub estimate: Option<Estimate<'a>>,
    /// What happened at this instant.
    pub status: Status,
    /// Normalised innovation squared of the instant's measurements, where there is a prediction to compare with.
    pub nis: Option<f64>,
    /// Number of scalar measurements behind `nis`: its mean if the filter is consistent.
    pub nis_dof: u32,
    /// The smoother's half, when both are asked for.
    pub lagged: Option<Lagged<'a>>,
}

/// Takes fixes as a tracker makes them.
pub trait Sink {
    /// Takes one fix. Fixes of one target come in order of the instant they describe.
    fn fix(&mut self, fix: &Fix<'_>);
}
