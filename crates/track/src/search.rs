//! Nonlinear start: Gauss–Newton over the first instants, until they determine where the target is.

use crate::error::StepError;
use crate::filter::Linearised;
use crate::heap::Heap;
use crate::model::Model;
use crate::packet::{Content, Packet};
use crate::tracker::Step;
use fixtrail_core::estimators::fms::newton::{ColdStart, MOST_ROWS, Newton, WindowModel};
use fixtrail_core::estimators::smoother::Arrive;
use fixtrail_core::linalg::compress;
use fixtrail_core::{Belief, Row, Transition, Vector};
use std::collections::VecDeque;

/// Most instants that the start looks back over; older ones are forgotten.
const START_INSTANTS: usize = 64;

/// One instant of a nonlinear window with its packets.
pub(crate) struct Kept {
    pub(crate) k: u64,
    pub(crate) t_s: Option<f64>,
    /// Seconds since the instant before.
    pub(crate) dt_s: f64,
    pub(crate) packets: Vec<Packet>,
}

impl Kept {
    /// Keeps an instant in the room of one that is no longer needed.
    pub(crate) fn new(step: &Step<'_>, dt_s: f64, mut room: Vec<Packet>) -> Self {
        room.clear();
        room.extend_from_slice(step.packets);
        Self { k: step.k, t_s: step.t_s, dt_s, packets: room }
    }

    pub(crate) fn step(&self) -> Step<'_> {
        Step { k: self.k, t_s: self.t_s, packets: &self.packets }
    }
}

/// A window of kept instants under a model, as Gauss–Newton sees it.
pub(crate) struct KeptWindow<'a, const N: usize> {
    pub(crate) model: &'a Model<N>,
    pub(crate) kept: &'a VecDeque<Kept>,
    pub(crate) rows: &'a mut Vec<Row<N>>,
}

impl<const N: usize> WindowModel<N> for KeptWindow<'_, N> {
    fn leap(&mut self, i: usize, x: &Vector<N>) -> Transition<N> {
        let from = &self.kept[i - 1];
        self.model.motion.leap(from.k, self.kept[i].dt_s, &self.model.drive(&from.step()), x)
    }

    fn rows(&mut self, i: usize, x: &Vector<N>, out: &mut [Row<N>; MOST_ROWS]) -> usize {
        self.rows.clear();
        self.model.sensing.rows(&self.kept[i].step(), x, self.rows);
        let count = if self.rows.len() > MOST_ROWS { compress(self.rows).0 } else { self.rows.len() };
        out[..count].copy_from_slice(&self.rows[..count]);
        count
    }
}

/// Whether the packets of a window can fix a position: enough different anchors, or positions themselves.
pub(crate) fn enough<'a>(axes: usize, kept: impl Iterator<Item = &'a Kept>) -> bool {
    // One more than the axes: with as many, two mirrored positions fit.
    let mut anchors = [0; 4];
    let mut count = 0;
    for packet in kept.flat_map(|k| &k.packets) {
        match &packet.content {
            Content::Range { anchor, .. } => {
                if !anchors[..count].contains(anchor) {
                    anchors[count] = *anchor;
                    count += 1;
                }
                if count > axes {
                    return true;
                }
            }
            Content::Position(_) | Content::Linear { .. } => return true,
            Content::Rssi { .. } | Content::Tdoa { .. } | Content::Bearing { .. } => {}
        }
    }
    false
}

/// Where a search without a trajectory begins: at the centre of the anchors, as far out as the longest range says.
pub(crate) fn cold_start<'a, const N: usize>(model: &Model<N>, kept: impl Iterator<Item = &'a Kept>) -> ColdStart<N> {
    let axes = model.layout.axes;
    let mut reach_m: f64 = 1.0;
    for packet in kept.flat_map(|k| &k.packets) {
        if let Content::Range { value_m, .. } = packet.content {
            reach_m = reach_m.max(value_m);
        }
    }
    let guess = Vector::from_fn(|i, _| if i < axes { model.centre_m[i] } else { 0.0 });
    // Components beyond the position: a vehicle's speed; accelerations and turn rates are smaller in number.
    let spread = Vector::from_fn(|i, _| if i < axes { reach_m } else { 10.0 });
    ColdStart { guess, spread }
}

/// The search for a first estimate.
pub struct Search<const N: usize> {
    newton: Newton<N, Heap>,
    kept: VecDeque<Kept>,
    rows: Vec<Row<N>>,
    newest: Vector<N>,
}

impl<const N: usize> Search<N> {
    /// A search before its first instant.
    ///
    /// # Errors
    /// [`StepError`] when there is no room for the window.
    pub fn new() -> Result<Self, StepError> {
        let room = fixtrail_core::StepError::WindowFull { capacity: 0, needed: START_INSTANTS };
        let newton = Newton::new(START_INSTANTS).ok_or(StepError::Core(room))?;
        Ok(Self { newton, kept: VecDeque::new(), rows: Vec::new(), newest: Vector::zeros() })
    }

    /// The point that the newest instant was linearised at.
    pub fn newest(&self) -> Vector<N> {
        self.newest
    }

    /// Takes one instant; returns the state once the window determines it, and then appends the window to `record`.
    ///
    /// # Errors
    /// [`StepError`]; nothing has changed then.
    pub fn step(
        &mut self,
        model: &Model<N>,
        step: &Step<'_>,
        dt_s: f64,
        record: Option<&mut Vec<Linearised<N>>>,
    ) -> Result<Option<Belief<N>>, StepError> {
        self.kept.push_back(Kept::new(step, dt_s, Vec::new()));
        let found = if enough(model.layout.axes, self.kept.iter()) {
            let cold = cold_start(model, self.kept.iter());
            let mut view = KeptWindow { model, kept: &self.kept, rows: &mut self.rows };
            self.newton.solve(&mut view, self.kept.len(), None, &cold).map_err(StepError::Core)?.filter
        } else {
            None
        };
        match found {
            Some(belief) => {
                self.newest = self.newton.nominal().last().copied().unwrap_or(belief.mean);
                if let Some(record) = record {
                    self.linearise(model, record);
                }
                Ok(Some(belief))
            }
            None => {
                if self.kept.len() == START_INSTANTS {
                    self.kept.pop_front();
                    self.newton.drop_front(1);
                    if let Some(record) = record {
                        record.push(forgotten());
                    }
                }
                Ok(None)
            }
        }
    }

    /// Appends the instants kept so far as forgotten ones.
    pub fn give_up(&mut self, record: &mut Vec<Linearised<N>>) {
        record.extend(self.kept.drain(..).map(|_| forgotten()));
    }

    fn linearise(&self, model: &Model<N>, record: &mut Vec<Linearised<N>>) {
        let nominal = self.newton.nominal();
        let mut scratch = Vec::new();
        let mut view = KeptWindow { model, kept: &self.kept, rows: &mut scratch };
        for (i, kept) in self.kept.iter().enumerate() {
            let arrive = (i > 0).then(|| {
                let leap = view.leap(i, &nominal[i - 1]);
                Arrive { f: leap.f, offset: leap.next - nominal[i], q: leap.q }
            });
            let mut rows = Vec::new();
            model.sensing.rows(&kept.step(), &nominal[i], &mut rows);
            record.push(Linearised { nominal: nominal[i], arrive, rows, forgotten: false });
        }
    }
}

fn forgotten<const N: usize>() -> Linearised<N> {
    Linearised { nominal: Vector::zeros(), arrive: None, rows: Vec::new(), forgotten: true }
}
