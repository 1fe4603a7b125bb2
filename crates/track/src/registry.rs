//! Names become types: one tracker per target from a checked spec.

use crate::anchors::Anchors;
use crate::chains::{Chains, kinematic};
use crate::dims::with_size;
use crate::error::{BuildError, StepError};
use crate::layout::Layout;
use crate::mat::Mat;
use crate::model::{
    Drifting, LinearModel, Model, Motion, Radios, Sensing, column_vectors, process_noise, robust, row_vectors, square,
};
use crate::packet::Kind;
use crate::predictive::{Carried, Foreteller};
use crate::recursion::{Modes, Single};
use crate::simulator::Simulator;
use crate::spec::{
    Align, EmvfVariant, EstimatorSpec, KinematicSpec, Lasting, LinearSpec, ModeSpec, ModelSpec, Prior, Receiver,
    SensorSpec, Span, Spec,
};
use crate::tracker::Tracker;
use crate::trackers::LaggedMode;
use crate::trackers::alpha_beta::{AlphaBeta, AlphaBetaAxis};
use crate::trackers::axes::Axes;
use crate::trackers::fixed_lag::FixedLag;
use crate::trackers::fms::{Fms, FmsSpec, Window};
use crate::trackers::fms_newton::FmsNewton;
use crate::trackers::fosb::{FosbAxis, FosbRules};
use crate::trackers::held::{Begin, Held, Options};
use crate::trackers::kalman::Kalman;
use crate::trackers::marginal::Marginal;
use crate::trackers::rts::Rts;
use crate::trackers::ufir::Ufir;
use fixtrail_core::Belief;
use fixtrail_core::estimators::emvf::{self, Emvf, Variant};
use fixtrail_core::estimators::fms::gain::Shape;
use fixtrail_core::estimators::fms::invariant::{self, InvariantWindow};
use fixtrail_core::estimators::gpb1::Gpb1;
use fixtrail_core::estimators::lmmse::{Lmmse, Spread};
use fixtrail_core::estimators::lmvf::Lmvf;
use fixtrail_core::models::{CoordinatedTurn, Drift, GaussMarkov, Integrators, MOST_MODES, Switching, TurnNoise};
use std::sync::Arc;

/// Most values at an instant of a link without time stamps.
pub const MAX_HELD: usize = 8;

/// What the caller wants of a tracker besides the spec.
#[derive(Clone, Copy, Debug, Default)]
pub struct BuildOptions {
    /// Filter, smoother or both.
    pub lagged: LaggedMode,
}

/// Names and order of the state that a spec's model has.
pub fn layout(spec: &Spec) -> Layout {
    match &spec.model {
        ModelSpec::Kinematic(k) => Layout::kinematic(k.order, k.axes, &[]),
        ModelSpec::GaussMarkov(g) => Layout::kinematic(2, g.axes, &[]),
        ModelSpec::Turn(_) => Layout::kinematic(2, 2, &["omega"]),
        ModelSpec::Linear(l) => Layout::linear(l.base.a.rows),
    }
}

/// Builds the tracker of one target.
///
/// # Errors
/// [`BuildError`] when the numbers of the spec, all well-formed, still do not make an estimator: a bias of an unknown anchor, a
/// gain that cannot be designed.
pub fn build(spec: &Spec, anchors: &Anchors, options: &BuildOptions) -> Result<Box<dyn Tracker>, BuildError> {
    if let Some((model, sd)) = kinematic(spec) {
        return match (model.axes, model.order) {
            (1, 1) => chains::<1, 1, 1>(spec, anchors, model, sd),
            (2, 1) => chains::<2, 1, 2>(spec, anchors, model, sd),
            (3, 1) => chains::<3, 1, 3>(spec, anchors, model, sd),
            (1, 2) => chains::<1, 2, 2>(spec, anchors, model, sd),
            (2, 2) => chains::<2, 2, 4>(spec, anchors, model, sd),
            (3, 2) => chains::<3, 2, 6>(spec, anchors, model, sd),
            (1, _) => chains::<1, 3, 3>(spec, anchors, model, sd),
            (2, _) => chains::<2, 3, 6>(spec, anchors, model, sd),
            _ => chains::<3, 3, 9>(spec, anchors, model, sd),
        };
    }
    modelled(spec, anchors, Tracking { spec, options })
}

/// Builds the simulator of a spec's model and sensors.
///
/// # Errors
/// As [`build`].
pub fn simulator(spec: &Spec, anchors: &Anchors) -> Result<Box<dyn Simulator>, BuildError> {
    modelled(spec, anchors, Simulating)
}

/// Builds what foretells measurements by a spec's model and sensors.
///
/// # Errors
/// As [`build`].
pub(crate) fn foreteller(spec: &Spec, anchors: &Anchors) -> Result<Box<dyn Foreteller>, BuildError> {
    modelled(spec, anchors, Foretelling)
}

/// What is made of a model once its dimension is known.
trait Purpose {
    type Made;

    fn make<const N: usize>(self, model: Model<N>) -> Result<Self::Made, BuildError>;
}

struct Tracking<'a> {
    spec: &'a Spec,
    options: &'a BuildOptions,
}

impl Purpose for Tracking<'_> {
    type Made = Box<dyn Tracker>;

    fn make<const N: usize>(self, model: Model<N>) -> Result<Box<dyn Tracker>, BuildError> {
        let layout = model.layout.clone();
        let tracker = estimator(self.spec, self.options, model)?;
        // Errors of sensors are estimated and not shown.
        Ok(if layout.n() < N { Box::new(Marginal::new(tracker, layout, N)) } else { tracker })
    }
}

struct Simulating;

impl Purpose for Simulating {
    type Made = Box<dyn Simulator>;

    fn make<const N: usize>(self, model: Model<N>) -> Result<Box<dyn Simulator>, BuildError> {
        if model.layout.n() < N {
            let what = "is for estimates, expected none: errors of simulated sensors do not drift";
            return Err(BuildError::new("spec", None, Some("sensor.drift"), what));
        }
        Ok(Box::new(model))
    }
}

struct Foretelling;

impl Purpose for Foretelling {
    type Made = Box<dyn Foreteller>;

    fn make<const N: usize>(self, model: Model<N>) -> Result<Box<dyn Foreteller>, BuildError> {
        Ok(Box::new(Carried::new(model)))
    }
}

/// Gives the spec's model its dimension, and makes of it what is wanted.
fn modelled<P: Purpose>(spec: &Spec, anchors: &Anchors, purpose: P) -> Result<P::Made, BuildError> {
    for sensor in &spec.sensors {
        if let Some(name) = sensor.bias.keys().find(|name| anchors.id(name).is_none()) {
            let known = anchors.names().join(", ");
            let what = format!("names an anchor that is not in the anchors table, expected one of {known}");
            return Err(BuildError::new("spec", None, Some(&format!("sensor.bias.{name}")), what));
        }
    }
    match &spec.model {
        ModelSpec::Turn(turn) => {
            if spec.sensors.iter().any(|s| s.drift.is_some()) {
                let what = "does not go with a coordinated turn, expected another `model.kind`, or no `drift`";
                return Err(BuildError::new("spec", None, Some("sensor.drift"), what));
            }
            let noise = match turn.per_step {
                None => TurnNoise::Density(turn.turn_noise),
                Some(power) => TurnNoise::PerStep { variance: turn.turn_noise, power },
            };
            let motion = CoordinatedTurn::new(turn.noise, noise).map_err(|e| fail(e.to_string()))?;
            purpose.make(assemble(spec, anchors, Arc::new(motion), turn.prior.as_ref(), Vec::new(), true))
        }
        _ => {
            let (shown, limit) = (layout(spec).n(), crate::spec::MAX_STATE);
            let n = shown + drifts(spec, anchors).iter().map(|d| d.count).sum::<usize>();
            let too_many = || {
                let what =
                    format!("makes {n} states with the errors of {} anchors, expected at most {limit}", anchors.len());
                BuildError::new("spec", None, Some(if n > shown { "sensor.drift" } else { "model" }), what)
            };
            with_size!(n, N => purpose.make(sized::<N>(spec, anchors)?), Err(too_many()))
        }
    }
}

fn sized<const N: usize>(spec: &Spec, anchors: &Anchors) -> Result<Model<N>, BuildError> {
    match &spec.model {
        ModelSpec::Kinematic(k) => {
            let mut psd = [0.0; 3];
            for (p, noise) in psd.iter_mut().zip(&k.noise) {
                *p = *noise;
            }
            let motion = Integrators::<N>::new(k.order, k.axes, psd).map_err(|e| fail(e.to_string()))?;
            Ok(assemble(spec, anchors, Arc::new(motion), k.prior.as_ref(), Vec::new(), false))
        }
        ModelSpec::GaussMarkov(g) => {
            let three = |of: &[f64]| core::array::from_fn(|axis| of.get(axis).copied().unwrap_or(0.0));
            let motion = GaussMarkov::<N>::new(g.axes, three(&g.centre_m), three(&g.spread_m), three(&g.speed_mps))
                .map_err(|e| fail(e.to_string()))?;
            let known = (0..N).filter_map(|i| motion.stationary(i).map(|(mean, sd)| (i, mean, sd))).collect();
            Ok(assemble(spec, anchors, Arc::new(motion), g.prior.as_ref(), known, false))
        }
        ModelSpec::Linear(l) => {
            let steps = if l.sequence.is_empty() { std::slice::from_ref(&l.base) } else { &l.sequence[..] };
            let model = Arc::new(LinearModel::<N>::new(steps));
            Ok(Model {
                layout: layout(spec),
                motion: model.clone(),
                sensing: model,
                prior: l.prior.as_ref().map(belief),
                known: Vec::new(),
                nonlinear: false,
                robust: fixtrail_core::estimators::kalman::Robust::None,
                centre_m: [0.0; 3],
                extent_m: 0.0,
                side_m: None,
            })
        }
        ModelSpec::Turn(_) => Err(fail("is a coordinated turn of another dimension".to_owned())),
    }
}

/// A kinematic model with its sensors.
fn assemble<const N: usize>(
    spec: &Spec,
    anchors: &Anchors,
    motion: Arc<dyn Motion<N>>,
    prior: Option<&Prior>,
    mut known: Vec<(usize, f64, f64)>,
    nonlinear_motion: bool,
) -> Model<N> {
    let layout = layout(spec);
    let centre_m = centre(anchors);
    let drifts = drifts(spec, anchors);
    let mut first = drifts.iter().map(|d| d.first);
    let components = |s: &SensorSpec| {
        let drift = s.drift?;
        Some([drift.each, drift.shared].map(|lasting| lasting.and_then(|_| first.next())))
    };
    let sensing: Arc<dyn Sensing<N>> = Arc::new(Radios::new(layout.axes, &spec.sensors, anchors, components));
    let nonlinear = nonlinear_motion || spec.sensors.iter().any(|s| s.kind != Kind::Position);
    for drift in &drifts {
        known.extend((drift.first..drift.first + drift.count).map(|i| (i, 0.0, drift.sd)));
    }
    let mut prior = prior.map(|prior| {
        let mut all: Belief<N> = Belief { mean: fixtrail_core::Vector::zeros(), cov: fixtrail_core::Matrix::zeros() };
        let n = prior.mean.len();
        all.mean.as_mut_slice()[..n].copy_from_slice(&prior.mean);
        for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))) {
            all.cov[(i, j)] = prior.cov.at(i, j);
        }
        for (i, mean, sd) in known.iter().filter(|(i, ..)| *i >= n) {
            all.mean[*i] = *mean;
            all.cov[(*i, *i)] = sd * sd;
        }
        all
    });
    // Where nothing is nonlinear, a law of all components is a prior like any other.
    if prior.is_none() && !nonlinear && known.len() == N {
        let mut all: Belief<N> = Belief { mean: fixtrail_core::Vector::zeros(), cov: fixtrail_core::Matrix::zeros() };
        for (i, mean, sd) in &known {
            all.mean[*i] = *mean;
            all.cov[(*i, *i)] = sd * sd;
        }
        prior = Some(all);
    }
    let motion: Arc<dyn Motion<N>> = if drifts.is_empty() { motion } else { Arc::new(Drifting { motion, drifts }) };
    Model {
        layout,
        motion,
        sensing,
        prior,
        known,
        nonlinear,
        robust: robust(&spec.sensors),
        centre_m,
        extent_m: extent(anchors, centre_m),
        side_m: spec.side_m,
    }
}

/// Where the drifting errors of the sensors stand in the state, behind what is shown.
fn drifts(spec: &Spec, anchors: &Anchors) -> Vec<Drift> {
    let mut first = layout(spec).n();
    let mut out = Vec::new();
    for drift in spec.sensors.iter().filter_map(|s| s.drift) {
        for (lasting, count) in [(drift.each, anchors.len()), (drift.shared, 1)] {
            let Some(Lasting { sd, time_s }) = lasting else { continue };
            out.push(Drift { first, count, sd, time_s });
            first += count;
        }
    }
    out
}

/// The registry: one line per estimator.
fn estimator<const N: usize>(
    spec: &Spec,
    options: &BuildOptions,
    model: Model<N>,
) -> Result<Box<dyn Tracker>, BuildError> {
    let mode = options.lagged;
    let refused = |e: StepError| fail(e.to_string());
    Ok(match spec.estimator {
        EstimatorSpec::Kalman | EstimatorSpec::Ekf => Box::new(Kalman::new(model, Single)),
        EstimatorSpec::Imm { modes } => {
            let modes = imm(&modes, &*model.motion)?;
            Box::new(Kalman::new(model, modes))
        }
        EstimatorSpec::Rts => Box::new(Rts::new(model, mode)),
        EstimatorSpec::FixedLagKalman { lag } => Box::new(FixedLag::new(model, lag, mode)),
        EstimatorSpec::Ufir { window } => Box::new(Ufir::new(model, window).map_err(refused)?),
        EstimatorSpec::Fms { window, lag, align } if model.nonlinear => {
            Box::new(FmsNewton::new(model, FmsSpec { window, lag, align }, mode).map_err(refused)?)
        }
        EstimatorSpec::Fms { window, lag, align } => {
            let shape = FmsSpec { window, lag, align };
            let held = match (&spec.model, window, lag) {
                (ModelSpec::Linear(l), Span::Instants(window), Span::Instants(lag)) if l.sequence.is_empty() => {
                    Window::Invariant(Box::new(invariant(l, window, lag, align).map_err(refused)?))
                }
                _ => Fms::varying(window).map_err(refused)?,
            };
            Box::new(Fms::new(model, shape, mode, held))
        }
        EstimatorSpec::Fosb { .. } | EstimatorSpec::AlphaBeta { .. } => return two_states(spec, options),
        EstimatorSpec::Lmvf { .. } | EstimatorSpec::Lmmse | EstimatorSpec::Emvf { .. } | EstimatorSpec::Gpb1 => {
            return held(spec, model);
        }
    })
}

/// A Kalman filter for each axis.
fn chains<const A: usize, const O: usize, const N: usize>(
    spec: &Spec,
    anchors: &Anchors,
    model: &KinematicSpec,
    sd: f64,
) -> Result<Box<dyn Tracker>, BuildError> {
    Ok(Box::new(Kalman::new(sized::<N>(spec, anchors)?, Chains::<A, O>::new(model, sd))))
}

/// A filter of location and speed that takes one axis at a time: of three sizes alone, and compiled for no other.
fn two_states(spec: &Spec, options: &BuildOptions) -> Result<Box<dyn Tracker>, BuildError> {
    match layout(spec).n() {
        2 => axes::<2>(spec, options),
        4 => axes::<4>(spec, options),
        6 => axes::<6>(spec, options),
        n => Err(fail(format!("has {n} states, expected location and speed of 1 to 3 axes"))),
    }
}

fn axes<const N: usize>(spec: &Spec, options: &BuildOptions) -> Result<Box<dyn Tracker>, BuildError> {
    let model = sized::<N>(spec, &Anchors::default())?;
    Ok(match spec.estimator {
        EstimatorSpec::Fosb { noise, speed_sd } => {
            Box::new(Axes::<N, FosbAxis>::new(model, FosbRules { noise, speed_sd }, options.lagged))
        }
        EstimatorSpec::AlphaBeta { gains, interval_s } => {
            Box::new(Axes::<N, AlphaBetaAxis>::new(model, AlphaBeta { gains, interval_s }, options.lagged))
        }
        _ => return Err(fail("has another estimator than `fosb` and `alpha-beta`".to_owned())),
    })
}

/// The modes of `imm`: the model's motion under the noise of each.
fn imm<const N: usize>(modes: &[Option<ModeSpec>; MOST_MODES], motion: &dyn Motion<N>) -> Result<Modes<N>, BuildError> {
    let modes = || modes.iter().flatten();
    let mean_s: Vec<f64> = modes().map(|mode| mode.mean_s).collect();
    let switching = Switching::new(&mean_s).map_err(|e| fail(e.to_string()))?;
    let motions = modes().map(|mode| motion.in_mode(mode)).collect::<Option<Vec<_>>>();
    motions.and_then(|motions| Modes::new(motions, switching)).ok_or_else(|| {
        fail("is no kinematic model with densities of noise, which the estimator `imm` needs".to_owned())
    })
}

/// An estimator for a link without time stamps, with room for 2 values or for [`MAX_HELD`]: each size is compiled for every size of state.
fn held<const N: usize>(spec: &Spec, model: Model<N>) -> Result<Box<dyn Tracker>, BuildError> {
    let few = match &spec.model {
        ModelSpec::Linear(l) => l.base.c.rows <= 2,
        // How many ranges come together is known from the data alone.
        _ => model.layout.axes <= 2 && spec.sensors.len() == 1 && spec.sensors[0].kind == Kind::Position,
    };
    if few { held_sized::<N, 2>(spec, model) } else { held_sized::<N, MAX_HELD>(spec, model) }
}

fn held_sized<const N: usize, const M: usize>(spec: &Spec, model: Model<N>) -> Result<Box<dyn Tracker>, BuildError> {
    let prior = model.prior.ok_or_else(|| fail("has no `x0` and `P0`".to_owned()))?;
    if model.layout.n() < N {
        let what = "does not go with a link without time stamps, expected no `drift` there";
        return Err(BuildError::new("spec", None, Some("sensor.drift"), what));
    }
    let second_moment = spec.model.prior().and_then(|p| p.second_moment.as_ref());
    let second_moment = second_moment.map_or(prior.cov + prior.mean * prior.mean.transpose(), square);
    let mut options = Options { nonlinear: model.nonlinear, ..Options::default() };
    if let Receiver::Unstamped { hold } = spec.link.receiver {
        options.hold = hold;
    }
    match spec.estimator {
        EstimatorSpec::Lmvf { square_root } => options.square_root = square_root,
        EstimatorSpec::Emvf { variant, range_mixture } => {
            let after_two = if variant == EmvfVariant::Model2 { Variant::Model2 } else { Variant::Model1 };
            options.emvf = emvf::Options { variant: after_two, range_mixture };
            options.skips_zero = variant == EmvfVariant::Model1Skip;
        }
        _ => {}
    }
    let begin = Begin { belief: prior, second_moment, options };
    Ok(match spec.estimator {
        EstimatorSpec::Lmvf { .. } => Box::new(Held::<N, M, Lmvf<N, M>>::new(model, begin, |b, sensed| {
            Lmvf::start(&b.belief, &b.second_moment, sensed, b.options.square_root)
        })),
        EstimatorSpec::Emvf { .. } => Box::new(Held::<N, M, Emvf<N, M>>::new(model, begin, |b, sensed| {
            Emvf::start(&b.belief, &b.second_moment, sensed, b.options.emvf)
        })),
        EstimatorSpec::Gpb1 => Box::new(Held::<N, M, Gpb1<N, M>>::new(model, begin, |b, sensed| {
            Gpb1::start(&b.belief, sensed, b.options.hold)
        })),
        _ => Box::new(Held::<N, M, Lmmse<N, M>>::new(model, begin, |b, sensed| {
            let spread = if b.options.nonlinear { Spread::Conditional } else { Spread::Unconditional };
            Lmmse::start(&b.belief, sensed, b.options.hold, spread)
        })),
    })
}

/// The window of a time-invariant linear model.
///
/// # Errors
/// [`StepError`] when the gain cannot be designed.
pub(crate) fn invariant<const N: usize>(
    spec: &LinearSpec,
    window: usize,
    lag: usize,
    align: Align,
) -> Result<InvariantWindow<N, crate::heap::Heap>, StepError> {
    use fixtrail_core::estimators::fms::Align as Core;
    let step = &spec.base;
    let align = match align {
        Align::Filtered => Core::Filtered,
        Align::Predicted => Core::Predicted,
    };
    let (a, w) = (square(&step.a), process_noise(step));
    let (b, c) = (column_vectors(&step.b), row_vectors(&step.c));
    let model = invariant::Model { a: &a, w: &w, b: &b, c: &c, r: &step.r.data };
    InvariantWindow::new(&model, Shape { window, lag, align }).map_err(StepError::Core)
}

fn belief<const N: usize>(prior: &Prior) -> Belief<N> {
    let cov: &Mat = &prior.cov;
    Belief { mean: fixtrail_core::Vector::from_fn(|i, _| prior.mean[i]), cov: square(cov) }
}

fn centre(anchors: &Anchors) -> [f64; 3] {
    let mut sum = [0.0; 3];
    for id in 0..anchors.len() as u32 {
        for (s, p) in sum.iter_mut().zip(anchors.position_m(id)) {
            *s += p / anchors.len() as f64;
        }
    }
    sum
}

/// Distance from `centre_m` to the outermost anchor.
fn extent(anchors: &Anchors, centre_m: [f64; 3]) -> f64 {
    let away = |id| anchors.position_m(id).iter().zip(centre_m).map(|(p, c)| (p - c) * (p - c)).sum::<f64>().sqrt();
    (0..anchors.len() as u32).map(away).fold(0.0, f64::max)
}

fn fail(what: String) -> BuildError {
    BuildError::new("spec", None, Some("model"), what)
}
