//! The spec: what the user says about model, sensors, link and estimator, checked and typed.
//!
//! [`parse()`] turns TOML text into a [`Spec`] in which every shape agrees, every covariance is positive semidefinite and
//! every number is finite; [`registry`](crate::registry) builds trackers from it without further checks of form.

mod compact;
mod estimator;
mod linear;
mod link;
mod matrix;
mod model;
mod motion;
mod names;
mod parse;
mod scenario;
mod schedule;
mod sensor;
mod sequence;
mod value;

#[cfg(test)]
mod tests;

pub use compact::split_estimators;
pub use estimator::MAX_WINDOW;
pub use matrix::{MAX_INPUT, MAX_MEASUREMENT, MAX_STATE};
pub use motion::{MotionSpec, Shape, Walls};
pub use names::{CHANNELS, ESTIMATORS, LINKS, MODELS, MOTIONS, Named, SCHEDULERS, SENSORS};
pub use parse::parse;
pub use scenario::{
    ChannelSpec, Contender, FieldSpec, LossSpec, Per, Recorded, Scenario, Shows, Simulated, Start, World,
    parse_scenario,
};
pub use schedule::ScheduleSpec;

use crate::mat::Mat;
use crate::packet::Kind;
pub use fixtrail_core::estimators::augmented::Hold;
use fixtrail_core::models::MOST_MODES;
use fixtrail_core::sensors::PathLoss;
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
    /// `model.side`: a point on the side of the anchors' line or plane that targets are on; missing axes are 0.
    pub side_m: Option<[f64; 3]>,
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
pub enum ModelSpec {
    /// `random-walk`, `constant-velocity`, `constant-acceleration`.
    Kinematic(KinematicSpec),
    /// `gauss-markov`: positions, then velocities, about a centre.
    GaussMarkov(GaussMarkovSpec),
    /// `coordinated-turn`: state x, y, vx, vy, omega.
    Turn(TurnSpec),
    /// `linear`, and `fms-paper` written out as the linear model it is.
    Linear(LinearSpec),
}

impl ModelSpec {
    /// The prior of the first instant.
    pub fn prior(&self) -> Option<&Prior> {
        match self {
            ModelSpec::Kinematic(m) => m.prior.as_ref(),
            ModelSpec::GaussMarkov(m) => m.prior.as_ref(),
            ModelSpec::Turn(m) => m.prior.as_ref(),
            ModelSpec::Linear(m) => m.prior.as_ref(),
        }
    }

    fn prior_mut(&mut self) -> Option<&mut Prior> {
        match self {
            ModelSpec::Kinematic(m) => m.prior.as_mut(),
            ModelSpec::GaussMarkov(m) => m.prior.as_mut(),
            ModelSpec::Turn(m) => m.prior.as_mut(),
            ModelSpec::Linear(m) => m.prior.as_mut(),
        }
    }
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

/// Second-order Gauss–Markov motion: a target that lives about a centre.
#[derive(Clone, Debug, PartialEq)]
pub struct GaussMarkovSpec {
    /// 1, 2 or 3.
    pub axes: usize,
    /// `centre_m`: mean of the position per axis.
    pub centre_m: Vec<f64>,
    /// `spread_m`: standard deviation of the position per axis.
    pub spread_m: Vec<f64>,
    /// `speed_mps`: standard deviation of the velocity per axis.
    pub speed_mps: Vec<f64>,
    /// Prior of the first instant; none: the stationary law.
    pub prior: Option<Prior>,
}

/// Coordinated turn in the plane.
#[derive(Clone, Debug, PartialEq)]
pub struct TurnSpec {
    /// `noise`: PSD of the acceleration noise per axis, m²/s³.
    pub noise: [f64; 2],
    /// `turn_noise`: PSD of the turn rate's driving noise, rad²/s³; with a `per_step`, the variance of its change in a step of a second.
    pub turn_noise: f64,
    /// `turn_noise.power` where noise comes by steps: the exponent of a step's length.
    pub per_step: Option<u8>,
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
    /// `S0`: E[x_0 x_0ᵀ] for `lmvf` and `emvf`; none: `P0 + x0 x0ᵀ`.
    pub second_moment: Option<Mat>,
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

/// `variant` of `emvf`: what the receiver shows after two losses in a row, and what the filter makes of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum EmvfVariant {
    /// `model2`: the value before both.
    #[default]
    Model2,
    /// `model1-zero`: 0, which is used as it is.
    Model1Zero,
    /// `model1-skip`: 0, which is not used.
    Model1Skip,
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
    /// `lmvf`.
    Lmvf {
        /// `square_root`.
        square_root: bool,
    },
    /// `lmmse`.
    Lmmse,
    /// `emvf`.
    Emvf {
        /// `variant`.
        variant: EmvfVariant,
        /// `range_mixture`.
        range_mixture: bool,
    },
    /// `gpb1`.
    Gpb1,
    /// `imm`: kinematic models only.
    Imm {
        /// `mode`: 2 to 4 of them, the first places taken.
        modes: [Option<ModeSpec>; MOST_MODES],
    },
    /// `fosb`: constant velocity and positions only.
    Fosb {
        /// `q`, or `q11` and `q33`.
        noise: FosbNoise,
        /// `speed_sd`: how far a first speed of 0 may be off; none: nothing is known of it.
        speed_sd: Option<f64>,
    },
    /// `alpha-beta`: constant velocity and positions only.
    AlphaBeta {
        /// `alpha` and `beta`; none: those that a Kalman filter settles at.
        gains: Option<[f64; 2]>,
        /// `interval_s`: the interval that gains are for; none: the actual one.
        interval_s: Option<f64>,
    },
}

/// What moves the speed of `fosb`.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub enum FosbNoise {
    /// The model's own noise over the interval.
    #[default]
    Model,
    /// `q11`, `q33`: variances per instant, whatever the interval.
    Speed {
        /// Of the location, m².
        q11: f64,
        /// Of the speed, m²/s².
        q33: f64,
    },
    /// `q`: variance of an acceleration that holds over an interval, m²/s⁴.
    Acceleration {
        /// The variance.
        q: f64,
    },
}

/// One of `[[estimator.mode]]`: how a target moves for a while.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ModeSpec {
    /// `noise`: PSD per axis, in the units of the model's; entries beyond its axes are 0.
    pub noise: [f64; 3],
    /// `turn_noise`: PSD of the turn rate's driving noise, rad²/s³; 0 of models without a turn rate.
    pub turn_noise: f64,
    /// `mean_s`: how long the mode lasts on average.
    pub mean_s: f64,
}

/// `[link]`: what the network does between sensor and receiver.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct LinkSpec {
    /// `stamped`: whether packets say when they were sensed, and what follows from that.
    pub receiver: Receiver,
    /// `arrival`: the probability p_k that what is received at instant k was sensed at k. None: learnt where it is needed.
    pub arrival: Option<ArrivalSpec>,
    /// `duplicates`.
    pub duplicates: Duplicates,
}

/// What the receiver knows of a packet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Receiver {
    /// When it was sensed.
    Stamped {
        /// `late_s`: how far back a late packet is still used exactly. None: packets are taken in order of time, as a table sorts them.
        late_s: Option<f64>,
    },
    /// Only what it holds now: y_k.
    Unstamped {
        /// `hold`.
        hold: Hold,
    },
}

impl Default for Receiver {
    fn default() -> Self {
        Receiver::Stamped { late_s: None }
    }
}

/// `arrival`.
#[derive(Clone, Debug, PartialEq)]
pub enum ArrivalSpec {
    /// One probability for all instants.
    Constant(f64),
    /// One per instant from row 0 on; the last stays in force. Not empty.
    List(Vec<f64>),
    /// `{ column = "p" }`: the column of the input that holds it.
    Column(String),
    /// `"estimate"`: learnt on line from sequence numbers or repeated values.
    Estimate,
}

/// `duplicates`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Duplicates {
    /// A value equal to the one before counts as new.
    #[default]
    Keep,
    /// A value equal to the one before, bit for bit, counts as lost.
    Detect,
}

/// `[sensor]` or one of `[[sensor]]`.
#[derive(Clone, Debug, PartialEq)]
pub struct SensorSpec {
    /// `kind`: anything but linear.
    pub kind: Kind,
    /// `sd`: of the value, or of each coordinate.
    pub sd: f64,
    /// `path_loss`: the law of signal strengths.
    pub path_loss: Option<PathLoss>,
    /// `bias`: anchor name → metres, dB or radians, subtracted from the value.
    pub bias: BTreeMap<String, f64>,
    /// `drift`: how the error of each anchor that `bias` leaves over changes.
    pub drift: Option<DriftSpec>,
    /// `height_m`: known target height; a planar track from three-dimensional anchors.
    pub height_m: Option<f64>,
    /// `latency_s`: how late this sensor's time stamps are; subtracted from t.
    pub latency_s: f64,
    /// `robust`.
    pub robust: Robust,
}

/// Errors of a sensor that stay for a while, one of the two or both.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriftSpec {
    /// `sd`, `time_s`: an error of each anchor.
    pub each: Option<Lasting>,
    /// `shared_sd`, `shared_time_s`: an error that all anchors have alike, that of the target's own radio.
    pub shared: Option<Lasting>,
}

/// An error that stays for a while: first-order Gauss–Markov, a state of its own.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lasting {
    /// Standard deviation in the sensor's unit.
    pub sd: f64,
    /// How long an error lasts.
    pub time_s: f64,
}

impl DriftSpec {
    /// The errors there are.
    pub fn all(&self) -> impl Iterator<Item = &Lasting> {
        self.each.iter().chain(&self.shared)
    }

    /// As [`all`](Self::all), to be changed.
    pub fn all_mut(&mut self) -> impl Iterator<Item = &mut Lasting> {
        self.each.iter_mut().chain(&mut self.shared)
    }
}

/// What an update does with a measurement that does not fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Robust {
    /// Uses it as it is.
    None,
    /// Leaves it out when its squared innovation over its variance exceeds `gate` (default 9).
    Gate(f64),
    /// Limits its pull beyond `threshold` standard deviations (default 1.345).
    Huber(f64),
    /// Lets its pull go to zero at `threshold` standard deviations (default 4.685).
    Redescending(f64),
}

impl EstimatorSpec {
    /// Whether the estimator knows what a receiver holds, a link without time stamps, and needs such a link.
    pub fn is_for_held(&self) -> bool {
        matches!(
            self,
            EstimatorSpec::Lmvf { .. } | EstimatorSpec::Lmmse | EstimatorSpec::Emvf { .. } | EstimatorSpec::Gpb1
        )
    }

    /// Whether the estimator has a smoother's half; that of `fosb` is the speed of the instant before.
    pub fn has_smoother(&self) -> bool {
        matches!(
            self,
            EstimatorSpec::Rts
                | EstimatorSpec::FixedLagKalman { .. }
                | EstimatorSpec::Fms { .. }
                | EstimatorSpec::Fosb { .. }
        )
    }

    /// The name that specs use.
    pub fn name(&self) -> &'static str {
        match self {
            EstimatorSpec::Kalman => "kalman",
            EstimatorSpec::Ekf => "ekf",
            EstimatorSpec::Rts => "rts",
            EstimatorSpec::FixedLagKalman { .. } => "fixed-lag-kalman",
            EstimatorSpec::Fms { .. } => "fms",
            EstimatorSpec::Ufir { .. } => "ufir",
            EstimatorSpec::Lmvf { .. } => "lmvf",
            EstimatorSpec::Lmmse => "lmmse",
            EstimatorSpec::Emvf { .. } => "emvf",
            EstimatorSpec::Gpb1 => "gpb1",
            EstimatorSpec::Imm { .. } => "imm",
            EstimatorSpec::Fosb { .. } => "fosb",
            EstimatorSpec::AlphaBeta { .. } => "alpha-beta",
        }
    }
}
