//! The spec: what the user says about model, sensors, link and estimator, checked and typed.
//!
//! [`parse()`] turns TOML text into a [`Spec`] in which every shape agrees, every covariance is positive semidefinite and
//! every number is finite; [`registry`](crate::registry) builds trackers from it without further checks of form.

mod estimator;
mod linear;
mod matrix;
mod model;
mod names;
mod parse;
mod sensor;
mod sequence;
mod value;

#[cfg(test)]
mod tests;

pub use estimator::MAX_WINDOW;
pub use matrix::{MAX_INPUT, MAX_MEASUREMENT, MAX_STATE};
pub use names::{CHANNELS, ESTIMATORS, LINKS, MODELS, Named, SCHEDULERS, SENSORS};
pub use parse::parse;

use crate::mat::Mat;
use crate::packet::Kind;
use std::collections::BTreeMap;

/// A checked spec.
#[derive(Clone, Debug, PartialEq)]
pub struct Spec {
    /// How targets move.
    pub model: ModelSpec,
    /// What estimates them.
    pub estimator: EstimatorSpec,
    /// What the network does.
    pub link: LinkSpec,
    /// What measures them, in the order of the spec. Empty for a linear model (its C and R are in the model).
    pub sensors: Vec<SensorSpec>,
    /// `[columns]`: our column name → the file's.
    pub columns: BTreeMap<String, String>,
    /// `anchors = "FILE"`, relative to the spec's folder.
    pub anchors: Option<String>,
}

impl Spec {
    /// Whether packets of this kind are measurements for the spec's model.
    pub fn uses(&self, kind: Kind) -> bool {
        match self.model {
            ModelSpec::Linear(_) => kind == Kind::Linear,
            _ => self.sensors.iter().any(|s| s.kind == kind),
        }
    }
}

/// `[model]`.
#[derive(Clone, Debug, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "there is one per run")]
pub enum ModelSpec {
    /// `random-walk`, `constant-velocity`, `constant-acceleration`.
    Kinematic(KinematicSpec),
    /// `coordinated-turn`: state x, y, vx, vy, omega.
    Turn(TurnSpec),
    /// `linear`, and `fms-paper` written out as the linear model it is.
    Linear(LinearSpec),
}

/// A chain of integrators per axis, driven by white noise at the last one.
#[derive(Clone, Debug, PartialEq)]
pub struct KinematicSpec {
    /// Modelled derivatives: 1 random walk, 2 constant velocity, 3 constant acceleration.
    pub order: usize,
    /// 1, 2 or 3.
    pub axes: usize,
    /// Power spectral density of the driving noise per axis: m²/s, m²/s³ or m²/s⁵.
    pub noise: Vec<f64>,
    /// Prior of the first instant.
    pub prior: Option<Prior>,
}

/// Coordinated turn in the plane.
#[derive(Clone, Debug, PartialEq)]
pub struct TurnSpec {
    /// `noise`: PSD of the acceleration noise per axis, m²/s³.
    pub noise: [f64; 2],
    /// `turn_noise`: PSD of the turn rate's driving noise, rad²/s³.
    pub turn_noise: f64,
    /// Prior of the first instant.
    pub prior: Option<Prior>,
}

/// x_{k+1} = A x_k + B u_k + G w_k, z_k = C x_k + v_k.
#[derive(Clone, Debug, PartialEq)]
pub struct LinearSpec {
    /// Step matrices when nothing varies, or the first step's.
    pub base: LinearStep,
    /// Steps read from `sequence`; the base fills what a step does not name. Empty: time-invariant.
    pub sequence: Vec<LinearStep>,
    /// Prior of x_0.
    pub prior: Option<Prior>,
}

/// The matrices of one step, complete (B has no columns when there is no input; G is I by default).
#[derive(Clone, Debug, PartialEq)]
pub struct LinearStep {
    /// n × n.
    pub a: Mat,
    /// n × p_u.
    pub b: Mat,
    /// n × p_w.
    pub g: Mat,
    /// q × n.
    pub c: Mat,
    /// p_w × p_w.
    pub q: Mat,
    /// q × q, positive definite.
    pub r: Mat,
}

/// Mean and covariance of the state before the first measurement is used.
#[derive(Clone, Debug, PartialEq)]
pub struct Prior {
    /// `x0`.
    pub mean: Vec<f64>,
    /// `P0`.
    pub cov: Mat,
}

/// Length of a window or lag.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Span {
    /// `window`, `lag`: instants.
    Instants(usize),
    /// `window_s`, `lag_s`: seconds.
    Seconds(f64),
}

/// Where a finite-memory window ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Align {
    /// At z_k (the default).
    Filtered,
    /// At z_{k-1}: the paper's form, a prediction.
    Predicted,
}

/// `[estimator]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum EstimatorSpec {
    /// `kalman`: linear model and sensors only.
    Kalman,
    /// `ekf`.
    Ekf,
    /// `rts`.
    Rts,
    /// `fixed-lag-kalman`.
    FixedLagKalman {
        /// `lag` or `lag_s`.
        lag: Span,
    },
    /// `fms`.
    Fms {
        /// `window` or `window_s`.
        window: Span,
        /// `lag` or `lag_s`; default 0.
        lag: Span,
        /// `align`.
        align: Align,
    },
    /// `ufir`.
    Ufir {
        /// `window` or `window_s`.
        window: Span,
    },
}

/// `[link]`: stamped links only.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct LinkSpec {
    /// `late_s`: how far back a late packet is still used exactly; in a file run every row is in time.
    pub late_s: Option<f64>,
}

/// `[sensor]` or one of `[[sensor]]`.
#[derive(Clone, Debug, PartialEq)]
pub struct SensorSpec {
    /// `kind`: position or range.
    pub kind: Kind,
    /// `sd`: of the value, or of each coordinate.
    pub sd: f64,
    /// `bias`: anchor name → metres, subtracted from the value.
    pub bias: BTreeMap<String, f64>,
    /// `height_m`: known target height; a planar track from three-dimensional anchors.
    pub height_m: Option<f64>,
    /// `latency_s`: how late this sensor's time stamps are; subtracted from t.
    pub latency_s: f64,
    /// `robust`.
    pub robust: Robust,
}

/// What an update does with a measurement that does not fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Robust {
    /// Uses it as it is.
    None,
    /// Leaves it out when its squared innovation over its variance exceeds `gate` (default 9).
    Gate(f64),
}

impl EstimatorSpec {
    /// The name that specs use.
    pub fn name(&self) -> &'static str {
        match self {
            EstimatorSpec::Kalman => "kalman",
            EstimatorSpec::Ekf => "ekf",
            EstimatorSpec::Rts => "rts",
            EstimatorSpec::FixedLagKalman { .. } => "fixed-lag-kalman",
            EstimatorSpec::Fms { .. } => "fms",
            EstimatorSpec::Ufir { .. } => "ufir",
        }
    }
}
