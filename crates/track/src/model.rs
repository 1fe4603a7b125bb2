//! A spec's model and sensors at their dimension: what linearises motion and measurements for every tracker.

use crate::anchors::Anchors;
use crate::layout::Layout;
use crate::packet::{AnchorId, Content, Kind, Packet};
use crate::spec::{LinearStep, ModeSpec, Robust, SensorSpec};
use crate::tracker::Step;
use fixtrail_core::linalg::{Common, whiten};
use fixtrail_core::models::{CoordinatedTurn, Drift, GaussMarkov, Integrators};
use fixtrail_core::position::{Point, tdoa};
use fixtrail_core::sensors::{Pair, PathLoss};
use fixtrail_core::{Belief, Matrix, Row, Transition, Vector, sensors};
use std::sync::Arc;

/// How a target moves.
pub trait Motion<const N: usize>: Send + Sync {
    /// The motion from instant `k` to the next, `dt_s` later, linearised at `x`; `drive` is the known input's push `B u`.
    fn leap(&self, k: u64, dt_s: f64, drive: &Vector<N>, x: &Vector<N>) -> Transition<N>;

    /// `B u` at instant `k`.
    fn drive(&self, _k: u64, _u: &[f64]) -> Vector<N> {
        Vector::zeros()
    }

    /// The same motion under the noise of a mode; `None` where noise is no density in continuous time.
    fn in_mode(&self, _mode: &ModeSpec) -> Option<Arc<dyn Motion<N>>> {
        None
    }
}

/// How a target is measured.
pub trait Sensing<const N: usize>: Send + Sync {
    /// Appends the rows of one instant's packets, linearised at `x`. Packets of kinds without a sensor add nothing.
    fn rows(&self, step: &Step<'_>, x: &Vector<N>, out: &mut Vec<Row<N>>);

    /// Appends what the receiver of a link without time stamps holds at an instant, linearised at `x`: every value that a packet has room
    /// for, also one that is lost, with noise that may be correlated.
    fn held(&self, step: &Step<'_>, x: &Vector<N>, out: &mut HeldRows<N>);

    /// Places that one instant's packets suggest by themselves, the likeliest first: starts for a search. None where any start will do.
    fn places(&self, _step: &Step<'_>) -> Vec<[f64; 3]> {
        Vec::new()
    }

    /// Appends where the anchors behind one instant's packets stand.
    fn sites(&self, _step: &Step<'_>, _out: &mut Vec<[f64; 3]>) {}
}

/// What a receiver holds at one instant.
#[derive(Clone, Debug)]
pub struct HeldRows<const N: usize> {
    /// Values; absent where a component was lost.
    pub values: Vec<Option<f64>>,
    /// Values expected at the linearisation point.
    pub expected: Vec<f64>,
    /// Gradients.
    pub h: Vec<Vector<N>>,
    /// Noise covariance, row by row.
    pub r: Vec<f64>,
    /// Reference anchors of time differences, whose noise they share; used by the sensors that have them alone.
    references: Vec<Option<AnchorId>>,
}

impl<const N: usize> Default for HeldRows<N> {
    fn default() -> Self {
        Self { values: Vec::new(), expected: Vec::new(), h: Vec::new(), r: Vec::new(), references: Vec::new() }
    }
}

impl<const N: usize> HeldRows<N> {
    /// Forgets all.
    pub fn clear(&mut self) {
        self.values.clear();
        self.expected.clear();
        self.h.clear();
        self.r.clear();
        self.references.clear();
    }
}

/// Everything a tracker needs to know of a spec, at its dimension.
#[derive(Clone)]
pub struct Model<const N: usize> {
    /// Names of the state.
    pub layout: Layout,
    /// How the target moves.
    pub motion: Arc<dyn Motion<N>>,
    /// How it is measured.
    pub sensing: Arc<dyn Sensing<N>>,
    /// Prior of the first instant; none: the start is unknown.
    pub prior: Option<Belief<N>>,
    /// Mean and standard deviation of the components that are known at any start, independent of all others.
    pub known: Vec<(usize, f64, f64)>,
    /// Whether motion or a sensor is nonlinear.
    pub nonlinear: bool,
    /// What an update does with a row that does not fit.
    pub robust: fixtrail_core::estimators::kalman::Robust,
    /// Position around which an unknown start is searched when the model is nonlinear.
    pub centre_m: [f64; 3],
    /// How far from there the outermost anchor is.
    pub extent_m: f64,
    /// A point on the side of the anchors' line or plane that the target is on.
    pub side_m: Option<[f64; 3]>,
}

impl<const N: usize> Model<N> {
    /// The components known at any start as rows, linearised at `x`.
    pub fn known_rows<'a>(&'a self, x: &'a Vector<N>) -> impl Iterator<Item = Row<N>> + 'a {
        self.known.iter().map(|(i, mean, sd)| Row {
            h: Vector::from_fn(|j, _| if j == *i { 1.0 } else { 0.0 }),
            residual: mean - x[*i],
            var: sd * sd,
        })
    }

    /// `B u` of the inputs on an instant's packets.
    pub fn drive(&self, step: &Step<'_>) -> Vector<N> {
        for packet in step.held {
            if let Content::Linear { u, .. } = &packet.content {
                return self.motion.drive(step.k, u);
            }
        }
        Vector::zeros()
    }
}

impl<const N: usize> Motion<N> for Integrators<N> {
    fn leap(&self, _k: u64, dt_s: f64, _drive: &Vector<N>, x: &Vector<N>) -> Transition<N> {
        Integrators::leap(self, x, dt_s)
    }

    fn in_mode(&self, mode: &ModeSpec) -> Option<Arc<dyn Motion<N>>> {
        Some(Arc::new(Integrators::new(self.order(), self.axes(), mode.noise).ok()?))
    }
}

impl<const N: usize> Motion<N> for GaussMarkov<N> {
    fn leap(&self, _k: u64, dt_s: f64, _drive: &Vector<N>, x: &Vector<N>) -> Transition<N> {
        GaussMarkov::leap(self, x, dt_s)
    }
}

/// A motion beside which errors of sensors drift.
pub struct Drifting<const N: usize> {
    /// Of the target.
    pub motion: Arc<dyn Motion<N>>,
    /// One per drifting sensor.
    pub drifts: Vec<Drift>,
}

impl<const N: usize> Motion<N> for Drifting<N> {
    fn leap(&self, k: u64, dt_s: f64, drive: &Vector<N>, x: &Vector<N>) -> Transition<N> {
        let mut leap = self.motion.leap(k, dt_s, drive, x);
        for drift in &self.drifts {
            drift.apply(x, dt_s, &mut leap);
        }
        leap
    }

    fn in_mode(&self, mode: &ModeSpec) -> Option<Arc<dyn Motion<N>>> {
        Some(Arc::new(Drifting { motion: self.motion.in_mode(mode)?, drifts: self.drifts.clone() }))
    }
}

impl Motion<5> for CoordinatedTurn {
    fn leap(&self, _k: u64, dt_s: f64, _drive: &Vector<5>, x: &Vector<5>) -> Transition<5> {
        CoordinatedTurn::leap(self, x, dt_s)
    }

    fn in_mode(&self, mode: &ModeSpec) -> Option<Arc<dyn Motion<5>>> {
        let [x, y, _] = mode.noise;
        Some(Arc::new(CoordinatedTurn::new([x, y], mode.turn_noise).ok()?))
    }
}

/// The matrices of a linear model, one set per step or one for all.
pub struct LinearModel<const N: usize> {
    steps: Vec<LinearMatrices<N>>,
}

/// One step's matrices.
struct LinearMatrices<const N: usize> {
    a: Matrix<N, N>,
    /// `G Q Gᵀ`.
    w: Matrix<N, N>,
    b: Vec<Vector<N>>,
    c: Vec<Vector<N>>,
    r: Vec<f64>,
}

/// `rows × N` of a spec as vectors, one per row.
pub(crate) fn row_vectors<const N: usize>(m: &crate::mat::Mat) -> Vec<Vector<N>> {
    (0..m.rows).map(|i| Vector::from_fn(|j, _| m.at(i, j))).collect()
}

/// `N × cols` of a spec as vectors, one per column.
pub(crate) fn column_vectors<const N: usize>(m: &crate::mat::Mat) -> Vec<Vector<N>> {
    (0..m.cols).map(|j| Vector::from_fn(|i, _| m.at(i, j))).collect()
}

/// An `N × N` matrix of a spec.
pub(crate) fn square<const N: usize>(m: &crate::mat::Mat) -> Matrix<N, N> {
    Matrix::from_fn(|i, j| m.at(i, j))
}

/// `G Q Gᵀ`.
pub(crate) fn process_noise<const N: usize>(step: &LinearStep) -> Matrix<N, N> {
    let g: Vec<Vector<N>> = column_vectors(&step.g);
    let mut w = Matrix::zeros();
    for (i, gi) in g.iter().enumerate() {
        for (j, gj) in g.iter().enumerate() {
            w += gi * gj.transpose() * step.q.at(i, j);
        }
    }
    fixtrail_core::linalg::symmetrised(&w)
}

impl<const N: usize> LinearModel<N> {
    /// The model of the given steps; the last one stays in force.
    ///
    /// # Panics
    /// When there is no step, or one is not of dimension N: a spec is checked before.
    pub fn new(steps: &[LinearStep]) -> Self {
        assert!(!steps.is_empty(), "a linear model without a step");
        Self {
            steps: steps
                .iter()
                .map(|s| LinearMatrices {
                    a: square(&s.a),
                    w: process_noise(s),
                    b: column_vectors(&s.b),
                    c: row_vectors(&s.c),
                    r: s.r.data.clone(),
                })
                .collect(),
        }
    }

    fn at(&self, k: u64) -> &LinearMatrices<N> {
        let last = self.steps.len() - 1;
        &self.steps[usize::try_from(k).map_or(last, |k| k.min(last))]
    }
}

impl<const N: usize> Motion<N> for LinearModel<N> {
    fn leap(&self, k: u64, _dt_s: f64, drive: &Vector<N>, x: &Vector<N>) -> Transition<N> {
        let step = self.at(k);
        Transition { next: step.a * x + drive, f: step.a, q: step.w }
    }

    fn drive(&self, k: u64, u: &[f64]) -> Vector<N> {
        self.at(k).b.iter().zip(u).fold(Vector::zeros(), |sum, (b, u)| sum + b * *u)
    }
}

impl<const N: usize> Sensing<N> for LinearModel<N> {
    fn rows(&self, step: &Step<'_>, x: &Vector<N>, out: &mut Vec<Row<N>>) {
        let matrices = self.at(step.k);
        let q = matrices.c.len();
        for packet in step.packets {
            let Content::Linear { z, .. } = &packet.content else { continue };
            let first = out.len();
            let got = |i: usize| z.get(i).copied().flatten();
            for (i, c) in matrices.c.iter().enumerate() {
                if let Some(z) = got(i) {
                    out.push(sensors::linear(c, x, z, matrices.r[i * q + i]));
                }
            }
            let mut block = [0.0; crate::spec::MAX_MEASUREMENT * crate::spec::MAX_MEASUREMENT];
            let mut entries = block.iter_mut();
            for i in (0..q).filter(|i| got(*i).is_some()) {
                for j in (0..q).filter(|j| got(*j).is_some()) {
                    if let Some(entry) = entries.next() {
                        *entry = matrices.r[i * q + j];
                    }
                }
            }
            // A principal block of a positive definite R is positive definite; the spec has checked R.
            let whitened = whiten(&mut out[first..], &mut block);
            debug_assert!(whitened);
        }
    }

    fn held(&self, step: &Step<'_>, x: &Vector<N>, out: &mut HeldRows<N>) {
        let matrices = self.at(step.k);
        let z = step.held.iter().find_map(|p| match &p.content {
            Content::Linear { z, .. } => Some(z.as_slice()),
            _ => None,
        });
        for (i, c) in matrices.c.iter().enumerate() {
            out.values.push(z.and_then(|z| z.get(i).copied().flatten()));
            out.expected.push(c.dot(x));
            out.h.push(*c);
        }
        out.r.extend_from_slice(&matrices.r);
    }
}

/// The sensors of a kinematic model.
pub struct Radios {
    axes: usize,
    sensors: Vec<Radio>,
}

struct Radio {
    kind: Kind,
    sd: f64,
    path_loss: PathLoss,
    height_m: Option<f64>,
    /// Position and bias of each anchor, by id.
    anchors: Vec<([f64; 3], f64)>,
    /// Components of the state that are the drifting error of the first anchor, and that of all.
    drift: [Option<usize>; 2],
}

impl Radios {
    /// The spec's sensors on the first `axes` components of the state; `drift` says at which component the errors of a sensor's anchors begin,
    /// and which is the error that they share.
    pub fn new(
        axes: usize,
        sensors: &[SensorSpec],
        anchors: &Anchors,
        mut drift: impl FnMut(&SensorSpec) -> Option<[Option<usize>; 2]>,
    ) -> Self {
        let radio = |s: &SensorSpec| Radio {
            kind: s.kind,
            sd: s.sd,
            // The spec of a sensor of strengths has one.
            path_loss: s.path_loss.unwrap_or(PathLoss { exponent: 2.0, at_1m_dbm: 0.0 }),
            height_m: s.height_m,
            anchors: (0..anchors.len() as u32)
                .map(|id| (anchors.position_m(id), s.bias.get(anchors.name(id)).copied().unwrap_or(0.0)))
                .collect(),
            drift: drift(s).unwrap_or_default(),
        };
        Self { axes, sensors: sensors.iter().map(radio).collect() }
    }
}

impl Radios {
    /// Hands on each value of a packet, less its anchor's bias, with its row; the residual of an absent value is that of 0.
    fn each<const N: usize>(&self, packet: &Packet, x: &Vector<N>, mut hand_on: impl FnMut(Option<f64>, Row<N>)) {
        let kind = packet.content.kind();
        let Some(radio) = self.sensors.iter().find(|s| s.kind == kind) else { return };
        let drifted = |anchor: AnchorId, mut row: Row<N>| {
            let [each, shared] = radio.drift;
            for error in each.map(|first| first + anchor as usize).into_iter().chain(shared) {
                row.h[error] = 1.0;
                row.residual -= x[error];
            }
            row
        };
        let sd = packet.sd.unwrap_or(radio.sd);
        let var = sd * sd;
        match &packet.content {
            Content::Position(xyz) => {
                for (axis, value) in xyz.iter().enumerate().take(self.axes) {
                    hand_on(*value, sensors::position(x, axis, value.unwrap_or(0.0), var));
                }
            }
            Content::Range { anchor, value_m } => {
                let (at, bias) = radio.anchors[*anchor as usize];
                let value_m = value_m - bias;
                let row = sensors::range(x, self.axes, at, radio.height_m, value_m, var);
                hand_on(Some(value_m), drifted(*anchor, row));
            }
            Content::Rssi { anchor, value_dbm } => {
                let (at, bias) = radio.anchors[*anchor as usize];
                let value_dbm = value_dbm - bias;
                let row = sensors::rssi(x, self.axes, at, radio.height_m, radio.path_loss, value_dbm, var);
                hand_on(Some(value_dbm), drifted(*anchor, row));
            }
            Content::Tdoa { anchor, reference, value_m } => {
                let pair = Pair {
                    anchor_m: radio.anchors[*anchor as usize].0,
                    reference_m: radio.anchors[*reference as usize].0,
                };
                hand_on(Some(*value_m), sensors::tdoa(x, self.axes, pair, radio.height_m, *value_m, var));
            }
            Content::Bearing { anchor, value_rad } => {
                let (at, bias) = radio.anchors[*anchor as usize];
                let value_rad = value_rad - bias;
                hand_on(Some(value_rad), sensors::bearing(x, at, value_rad, var));
            }
            Content::Linear { .. } => {}
        }
    }

    /// Hands on the rows of the differences among `packets` that share a reference, made independent.
    fn differences<const N: usize>(
        &self,
        packets: &[Packet],
        shared: AnchorId,
        x: &Vector<N>,
        mut hand_on: impl FnMut(Row<N>),
    ) {
        // In units of each standard deviation the reference's part of the variance is a half.
        let mut common = Common::new(SHARED);
        for packet in packets.iter().filter(|p| reference(p) == Some(shared)) {
            self.each(packet, x, |_, row| {
                let w = 1.0 / row.var.sqrt();
                hand_on(common.next(&Row { h: row.h * w, residual: row.residual * w, var: 1.0 - SHARED }));
            });
        }
    }
}

/// Most places that one instant suggests.
const MOST_PLACES: usize = 3;

impl Radios {
    /// Where `A` axes put a target by the time differences of one instant to the reference anchor that most of them share.
    fn meets<const A: usize>(&self, step: &Step<'_>, height_m: Option<f64>) -> Vec<[f64; 3]> {
        let Some(radio) = self.sensors.iter().find(|s| s.kind == Kind::Tdoa) else { return Vec::new() };
        let of = |shared: AnchorId| step.packets.iter().filter(move |p| reference(p) == Some(shared));
        let candidates = step.packets.iter().filter_map(reference);
        let Some(shared) = candidates.max_by_key(|id| (of(*id).count(), *id)) else { return Vec::new() };
        let difference = |p: &Packet| match p.content {
            Content::Tdoa { anchor, value_m, .. } => {
                let var = p.sd.unwrap_or(radio.sd).powi(2);
                let anchor_m = radio.anchors[anchor as usize].0;
                Some(tdoa::Difference { anchor_m, difference_m: value_m, var_m2: (1.0 - SHARED) * var })
            }
            _ => None,
        };
        let differences: Vec<tdoa::Difference> = of(shared).filter_map(difference).collect();
        if differences.len() < A {
            return Vec::new();
        }
        let data = tdoa::Differences {
            reference_m: radio.anchors[shared as usize].0,
            reference_var_m2: SHARED * radio.sd * radio.sd,
            differences: &differences,
            height_m,
        };
        let flat = |p: &[f64; 3]| Vector::<A>::from_fn(|i, _| p[i]);
        let heard = || differences.iter().map(|d| &d.anchor_m).chain([&data.reference_m]);
        let centre = heard().map(flat).sum::<Vector<A>>() / heard().count() as f64;
        let mut starts = match tdoa::linear::<A>(&data) {
            tdoa::Linear::Unique { position_m, .. } => vec![position_m],
            tdoa::Linear::Roots(roots) => roots.into_iter().flatten().collect(),
            tdoa::Linear::NotDetermined => Vec::new(),
        };
        // One bad difference leads the linear start astray: the target is also sought at the centre and on the way to each anchor.
        starts.push(centre);
        starts.extend(heard().map(|a| (flat(a) + centre) * 0.5));
        let mut found: Vec<Point<A>> = starts.iter().filter_map(|s| tdoa::gauss_newton(&data, s)).collect();
        found.sort_by(|a, b| a.chi2.total_cmp(&b.chi2));
        let mut places: Vec<Point<A>> = Vec::new();
        for point in found {
            let same = |p: &Point<A>| {
                (p.belief.mean - point.belief.mean).norm_squared()
                    <= 1e-6 * p.belief.cov.trace().min(point.belief.cov.trace())
            };
            if places.len() < MOST_PLACES && !places.iter().any(same) {
                places.push(point);
            }
        }
        let place =
            |p: Point<A>| core::array::from_fn(|i| if i < A { p.belief.mean[i] } else { height_m.unwrap_or(0.0) });
        places.into_iter().map(place).collect()
    }
}

/// Correlation of two time differences of an instant that share their reference anchor: every anchor's clock and receiver have the same part
/// in the noise.
const SHARED: f64 = 0.5;

/// The reference anchor of a time difference.
fn reference(packet: &Packet) -> Option<AnchorId> {
    match packet.content {
        Content::Tdoa { reference, .. } => Some(reference),
        _ => None,
    }
}

impl<const N: usize> Sensing<N> for Radios {
    fn rows(&self, step: &Step<'_>, x: &Vector<N>, out: &mut Vec<Row<N>>) {
        for (i, packet) in step.packets.iter().enumerate() {
            match reference(packet) {
                // All of one reference together, with its first.
                Some(shared) if step.packets[..i].iter().any(|p| reference(p) == Some(shared)) => {}
                Some(shared) => self.differences(&step.packets[i..], shared, x, |row| out.push(row)),
                None => self.each(packet, x, |value, row| {
                    if value.is_some() {
                        out.push(row);
                    }
                }),
            }
        }
    }

    fn places(&self, step: &Step<'_>) -> Vec<[f64; 3]> {
        let measured = step.packets.iter().find_map(|p| match p.content {
            Content::Position([None, None, height_m]) => height_m,
            _ => None,
        });
        let known = self.sensors.iter().find(|s| s.kind == Kind::Tdoa).and_then(|s| s.height_m);
        match (self.axes, measured) {
            (2, _) => self.meets::<2>(step, known),
            (3, None) => self.meets::<3>(step, None),
            (3, height_m) => self.meets::<2>(step, height_m),
            _ => Vec::new(),
        }
    }

    fn sites(&self, step: &Step<'_>, out: &mut Vec<[f64; 3]>) {
        for packet in step.packets {
            let (kind, anchors) = packet.source();
            if let Some(radio) = self.sensors.iter().find(|s| s.kind == kind) {
                out.extend(anchors.iter().flatten().map(|id| radio.anchors[*id as usize].0));
            }
        }
    }

    fn held(&self, step: &Step<'_>, x: &Vector<N>, out: &mut HeldRows<N>) {
        for packet in step.held {
            self.each(packet, x, |value, row| {
                out.references.push(reference(packet));
                out.values.push(value);
                out.expected.push(value.unwrap_or(0.0) - row.residual);
                out.h.push(row.h);
                out.r.push(row.var);
            });
        }
        // The variances become a diagonal, all but the first beyond where they stood; beside it stands what time differences share.
        let q = out.r.len();
        out.r.resize(q * q, 0.0);
        (1..q).for_each(|i| out.r.swap(i, i * q + i));
        for (i, j) in (0..q).flat_map(|i| (0..i).map(move |j| (i, j))) {
            if out.references[i].is_some() && out.references[i] == out.references[j] {
                let shared = SHARED * (out.r[i * q + i] * out.r[j * q + j]).sqrt();
                (out.r[i * q + j], out.r[j * q + i]) = (shared, shared);
            }
        }
    }
}

/// What a spec's sensors say of rows that do not fit; the tightest threshold when several differ.
pub(crate) fn robust(sensors: &[SensorSpec]) -> fixtrail_core::estimators::kalman::Robust {
    use fixtrail_core::estimators::kalman::Robust as Core;
    let tighter = |a: Core, b: Core| match (a, b) {
        (Core::Gate(a), Core::Gate(b)) => Core::Gate(a.min(b)),
        (Core::Huber(a), Core::Huber(b)) => Core::Huber(a.min(b)),
        (Core::Redescending(a), Core::Redescending(b)) => Core::Redescending(a.min(b)),
        // The spec allows one kind, or none.
        (Core::None, other) | (other, _) => other,
    };
    let each = sensors.iter().map(|s| match s.robust {
        Robust::None => Core::None,
        Robust::Gate(limit) => Core::Gate(limit),
        Robust::Huber(threshold) => Core::Huber(threshold),
        Robust::Redescending(threshold) => Core::Redescending(threshold),
    });
    each.fold(Core::None, tighter)
}
