//! Nonlinear start: Gauss–Newton over the first instants, until they determine where the target is.

use crate::error::StepError;
use crate::heap::Heap;
use crate::linearised::Linearised;
use crate::mirror::Mirror;
use crate::model::Model;
use crate::packet::{Content, Kind, Packet};
use crate::pair::DECISIVE;
use crate::tracker::Step;
use fixtrail_core::estimators::fms::newton::{ColdStart, MOST_ROWS, Newton, WindowModel};
use fixtrail_core::estimators::kalman::{self, Robust};
use fixtrail_core::estimators::smoother::Arrive;
use fixtrail_core::linalg::{compress, semidefinite_factor};
use fixtrail_core::{Belief, Matrix, Row, Transition, Vector};
use std::cmp::Ordering;
use std::collections::VecDeque;

/// Most instants that the start looks back over; older ones are forgotten.
const START_INSTANTS: usize = 64;
/// Standard deviations by which a robust start may miss a measurement.
const MISSED: f64 = 3.0;
/// A window that did not agree with itself is tried again once it has grown by one instant in this many, and one instant in this many, begun
/// ones counted, loses a measurement between two solutions: the tries grow geometrically and a try solves a bounded number of times, so
/// that a window costs in all what its length does, however many tries of it fail. Up to this length nothing is put off.
const GROWTH: usize = 8;
/// Share of the worst miss from which on a measurement goes with the worst one: an error of its own, hardly what that one bends.
const ALIKE: f64 = 0.5;
/// Largest share of a standard deviation by which one standard deviation of the start may bend model or sensors.
pub(crate) const BENT: f64 = 0.3;

/// One instant of a nonlinear window with its packets.
#[derive(Clone)]
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
        Step::new(self.k, self.t_s, &self.packets)
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
        if i == 0 {
            self.rows.extend(self.model.known_rows(x));
        }
        self.model.sensing.rows(&self.kept[i].step(), x, self.rows);
        let count = if self.rows.len() > MOST_ROWS { compress(self.rows).0 } else { self.rows.len() };
        out[..count].copy_from_slice(&self.rows[..count]);
        count
    }
}

/// What the packets of a window may fix.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Enough {
    /// No position.
    No,
    /// Two: the distances are as many as the axes.
    Pair,
    /// One position: enough different anchors, or positions themselves. Anchors in one line may still leave two.
    Yes,
}

/// What the packets of a window may fix.
pub(crate) fn enough<'a>(axes: usize, kept: impl Iterator<Item = &'a Kept>) -> Enough {
    // One more than the axes: with as many, two positions fit. A strength says what a range does.
    let mut seen = [(Kind::Position, [None; 2]); 4];
    let mut count = 0;
    for packet in kept.flat_map(|k| &k.packets) {
        let (kind, anchors) = packet.source();
        let height_alone = matches!(packet.content, Content::Position([None, None, _]));
        if height_alone && axes < 3 {
            continue;
        }
        let source = match kind {
            // A height is one thing known, like a range.
            Kind::Position if height_alone => (kind, anchors),
            Kind::Position | Kind::Linear => return Enough::Yes,
            Kind::Range | Kind::Rssi => (Kind::Range, anchors),
            Kind::Tdoa | Kind::Bearing => (kind, anchors),
        };
        if seen[..count].contains(&source) {
            continue;
        }
        // In the plane two directions have one point in common, and so have a direction and a distance from the same anchor.
        let settles = |other: &(Kind, _)| match (source.0, other.0) {
            (Kind::Bearing, Kind::Bearing) => true,
            (Kind::Bearing, Kind::Range) | (Kind::Range, Kind::Bearing) => other.1 == anchors,
            _ => false,
        };
        if axes == 2 && seen[..count].iter().any(settles) {
            return Enough::Yes;
        }
        seen[count] = source;
        count += 1;
        if count > axes {
            return Enough::Yes;
        }
    }
    let distances = seen[..count].iter().all(|(kind, _)| *kind == Kind::Range);
    if axes > 1 && count == axes && distances { Enough::Pair } else { Enough::No }
}

/// Where a search without a trajectory begins: at the centre of the anchors, as far out as the longest range says, or the outermost anchor
/// where other sensors than ranges are used.
pub(crate) fn cold_start<'a, const N: usize>(model: &Model<N>, kept: impl Iterator<Item = &'a Kept>) -> ColdStart<N> {
    let axes = model.layout.axes;
    let mut reach_m: f64 = 1.0;
    for packet in kept.flat_map(|k| &k.packets) {
        match packet.content {
            Content::Range { value_m, .. } => reach_m = reach_m.max(value_m),
            Content::Rssi { .. } | Content::Tdoa { .. } | Content::Bearing { .. } => {
                reach_m = reach_m.max(model.extent_m)
            }
            Content::Position(_) | Content::Linear { .. } => {}
        }
    }
    let guess = Vector::from_fn(|i, _| if i < axes { model.centre_m[i] } else { 0.0 });
    // Components beyond the position: a vehicle's speed; accelerations and turn rates are smaller in number.
    let spread = Vector::from_fn(|i, _| if i < axes { reach_m } else { 10.0 });
    ColdStart { guess, spread }
}

/// Two solutions closer than this share of their standard deviations are one.
const SAME: f64 = 1e-3;

/// What the search has found.
#[derive(Clone, Copy, Debug)]
pub struct Found<const N: usize> {
    /// The newest state.
    pub belief: Belief<N>,
    /// Another one that the window does not tell from it.
    pub(crate) rival: Option<Rival<N>>,
    /// Whether a filter can go on from it, or two can; the search is over then.
    pub settled: bool,
}

/// A second solution of a window.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rival<const N: usize> {
    /// The newest state.
    pub(crate) belief: Belief<N>,
    /// The point that the newest instant was linearised at.
    pub(crate) newest: Vector<N>,
    /// By how much it fits worse.
    pub(crate) lead: f64,
    /// Where it was looked for.
    pub(crate) mirror: Mirror,
}

/// The solution of a window, and perhaps another.
type Solution<const N: usize> = (Belief<N>, Option<Rival<N>>);

/// The search for a first estimate.
#[derive(Clone)]
pub struct Search<const N: usize> {
    newton: Newton<N, Heap>,
    /// The trajectory of a second solution.
    rival: Option<Newton<N, Heap>>,
    kept: VecDeque<Kept>,
    rows: Vec<Row<N>>,
    newest: Vector<N>,
    /// Whether the window determined one state when last tried.
    found: bool,
    /// Fewest instants of a window that is looked through for measurements that miss.
    next_try: usize,
    /// The measurements of the window that miss, the worst of each instant.
    missed: Vec<Miss>,
}

/// A packet of a window that misses its solution.
#[derive(Clone, Copy)]
struct Miss {
    instant: usize,
    packet: usize,
    /// Standard deviations.
    by: f64,
}

impl<const N: usize> Search<N> {
    /// A search before its first instant.
    ///
    /// # Errors
    /// [`StepError`] when there is no room for the window.
    pub fn new() -> Result<Self, StepError> {
        let room = fixtrail_core::StepError::WindowFull { capacity: 0, needed: START_INSTANTS };
        let newton = Newton::new(START_INSTANTS).ok_or(StepError::Core(room))?;
        Ok(Self {
            newton,
            rival: None,
            kept: VecDeque::new(),
            rows: Vec::new(),
            newest: Vector::zeros(),
            found: false,
            next_try: 0,
            missed: Vec::new(),
        })
    }

    /// The point that the newest instant was linearised at.
    pub fn newest(&self) -> Vector<N> {
        self.newest
    }

    /// Takes one instant; returns the state when the window determines it, or two. Appends the window to `record` once one is settled.
    ///
    /// # Errors
    /// [`StepError`]; nothing has changed then.
    pub fn step(
        &mut self,
        model: &Model<N>,
        step: &Step<'_>,
        dt_s: f64,
        record: Option<&mut Vec<Linearised<N>>>,
    ) -> Result<Option<Found<N>>, StepError> {
        self.kept.push_back(Kept::new(step, dt_s, Vec::new()));
        let solution = self.solve(model)?;
        self.found = matches!(solution, Some((_, None)));
        let full = self.kept.len() == START_INSTANTS;
        let Some((belief, rival)) = solution else {
            if full {
                self.kept.pop_front();
                self.newton.drop_front(1);
                if let Some(record) = record {
                    record.push(Linearised::forgotten());
                }
            }
            return Ok(None);
        };
        self.newest = self.newton.nominal().last().copied().unwrap_or(belief.mean);
        // A window that leaves two goes on as long as it can: each of its instants is linearised at both, as no filter does it.
        let settled = full || rival.is_none() && self.is_nearly_linear(model, step, &belief);
        if let (Some(record), true, None) = (record, settled, rival) {
            linearise(model, &self.kept, &self.newton, record);
        }
        Ok(Some(Found { belief, rival, settled }))
    }

    /// The window as the two solutions that it was left with linearise it.
    pub(crate) fn records(&self, model: &Model<N>) -> [Vec<Linearised<N>>; 2] {
        [Some(&self.newton), self.rival.as_ref()].map(|newton| {
            let mut record = Vec::new();
            newton.into_iter().for_each(|newton| linearise(model, &self.kept, newton, &mut record));
            record
        })
    }

    /// The newest state as the window determines it; a robust one only once the window has rows to spare and agrees with itself.
    ///
    /// The measurement that misses by most of its standard deviations is taken out of the window, of a long one the worst of several instants,
    /// and the rest solved again, until none misses by more than three (data snooping \[BAA68\]) or a quarter is gone: then the window is left
    /// whole and determines nothing until it has grown. A full window is taken as it is: its sensors are noisier than the model says.
    fn solve(&mut self, model: &Model<N>) -> Result<Option<Solution<N>>, StepError> {
        let robust = model.robust != Robust::None && self.kept.len() < START_INSTANTS;
        if robust && self.kept.len() < self.next_try {
            return Ok(None);
        }
        let whole = robust.then(|| (self.kept.clone(), self.newton.clone()));
        let (mut taken_out, mut tries) = (0, 0_u32);
        let found = loop {
            let enough = enough(model.layout.axes, self.kept.iter());
            if enough == Enough::No {
                break None;
            }
            let cold = cold_start(model, self.kept.iter());
            let solution = self.best(model, &cold)?;
            if enough == Enough::Pair && !matches!(solution, Some((_, Some(_)))) {
                break None;
            }
            if !robust || solution.is_none() {
                break solution;
            }
            let count = self.misses(model);
            // Rows to spare: twice as many as there are unknowns.
            if count < 2 * (N - model.known.len()).max(model.layout.axes) {
                break None;
            }
            let Some(worst) = self.missed.first().copied() else { break solution };
            let room = ((count + taken_out) / 4).saturating_sub(taken_out);
            if room == 0 {
                self.next_try = self.kept.len() + self.kept.len().div_ceil(GROWTH);
                break None;
            }
            let at_once = self.kept.len().div_ceil(GROWTH).min(room);
            for miss in self.missed.iter().take(at_once).take_while(|miss| miss.by >= ALIKE * worst.by) {
                self.kept[miss.instant].packets.remove(miss.packet);
                taken_out += 1;
            }
            tries += 1;
            // What was gross, and may have led the trajectory astray, goes first. To start anew each time would cost most of the time.
            if tries.is_power_of_two() {
                self.newton.clear();
            }
        };
        if let (None, Some((kept, newton))) = (&found, whole) {
            (self.kept, self.newton) = (kept, newton);
        }
        Ok(found)
    }

    /// The newest state by the solution of the window that fits best: the one that the search goes on to, or those from the places that its
    /// first and its newest instant suggest by themselves. Time differences have valleys that the centre of the anchors does not lead out of.
    /// With it the mirrored solution, where it is another one that fits as well.
    fn best(&mut self, model: &Model<N>, cold: &ColdStart<N>) -> Result<Option<Solution<N>>, StepError> {
        let len = self.kept.len();
        let mut view = KeptWindow { model, kept: &self.kept, rows: &mut self.rows };
        let mut best = self.newton.solve(&mut view, len, None, cold).map_err(StepError::Core)?.filter;
        let ends = [self.kept.front(), self.kept.back().filter(|_| len > 1)];
        let places: Vec<[f64; 3]> =
            ends.into_iter().flatten().flat_map(|kept| model.sensing.places(&kept.step())).collect();
        let mut least = if places.is_empty() || best.is_none() {
            f64::INFINITY
        } else {
            misfit(model, &self.kept, &self.newton, &mut self.rows)
        };
        for place in places {
            let guess = Vector::from_fn(|i, _| if i < model.layout.axes { place[i] } else { 0.0 });
            let mut newton = self.newton.clone();
            newton.clear();
            let mut view = KeptWindow { model, kept: &self.kept, rows: &mut self.rows };
            let start = ColdStart { guess, ..*cold };
            let Some(found) = newton.solve(&mut view, len, None, &start).map_err(StepError::Core)?.filter else {
                continue;
            };
            let misfit = misfit(model, &self.kept, &newton, &mut self.rows);
            // The same solution found again is no better.
            if misfit < least - 1e-6 * (1.0 + misfit) {
                (best, least) = (Some(found), misfit);
                self.newton = newton;
            }
        }
        let Some(mirror) = mirror(model, self.kept.iter()) else { return Ok(best.map(|b| (b, None))) };
        if best.is_none() && mirror.narrow {
            // On the mirror itself nothing is seen across it.
            let guess = mirror.beside(&cold.guess, 0.5 * cold.spread[0]);
            let mut view = KeptWindow { model, kept: &self.kept, rows: &mut self.rows };
            let start = ColdStart { guess, ..*cold };
            best = self.newton.solve(&mut view, len, None, &start).map_err(StepError::Core)?.filter;
        }
        let Some(best) = best else {
            self.rival = None;
            return Ok(None);
        };
        self.choose(model, cold, &mirror, best).map(Some)
    }

    /// The better one of a solution and its mirror image, with the other where the data do not decide.
    fn choose(
        &mut self,
        model: &Model<N>,
        cold: &ColdStart<N>,
        mirror: &Mirror,
        best: Belief<N>,
    ) -> Result<Solution<N>, StepError> {
        self.rival = None;
        let image = image(model, &self.kept, &self.newton, cold, mirror, &best, &mut self.rows)?;
        let Some(image) = image else { return Ok((best, None)) };
        let verdict = is_right(model, mirror, &best, &image);
        let Image { mut newton, belief, lead } = image;
        let (mut best, mut rival) = (best, belief);
        if verdict.unwrap_or(lead < 0.0) {
            std::mem::swap(&mut best, &mut rival);
            std::mem::swap(&mut self.newton, &mut newton);
        }
        if verdict.is_some() {
            return Ok((best, None));
        }
        let newest = newton.nominal().last().copied().unwrap_or(rival.mean);
        self.rival = Some(newton);
        Ok((best, Some(Rival { belief: rival, newest, lead: lead.abs(), mirror: *mirror })))
    }

    /// Number of rows in the window. Leaves in `missed` the packet of each instant that misses the solution by most standard deviations,
    /// where those are more than [`MISSED`], the worst first.
    fn misses(&mut self, model: &Model<N>) -> usize {
        self.missed.clear();
        let mut count = 0;
        for (instant, (kept, x)) in self.kept.iter().zip(self.newton.nominal()).enumerate() {
            let mut worst = Miss { instant, packet: 0, by: MISSED };
            for packet in 0..kept.packets.len() {
                self.rows.clear();
                model.sensing.rows(&Step::new(kept.k, kept.t_s, &kept.packets[packet..=packet]), x, &mut self.rows);
                count += self.rows.len();
                for row in &self.rows {
                    let by = row.residual.abs() / row.var.sqrt();
                    if by > worst.by {
                        worst = Miss { packet, by, ..worst };
                    }
                }
            }
            if worst.by > MISSED {
                self.missed.push(worst);
            }
        }
        // Stable: of equals the older first.
        self.missed.sort_by(|a, b| b.by.total_cmp(&a.by));
        count
    }

    /// Whether motion and sensors are as good as linear over the belief's spread. The window linearises again with every instant, a
    /// filter that goes on from its result does not: handed a turn rate known to 10 rad/s it would be sure of a wrong one for ever.
    ///
    /// One standard deviation along each column of `P = L Lᵀ`, either way, must bend the prediction over as long as the window lasts,
    /// and each measurement, by less than [`BENT`] of their standard deviation.
    fn is_nearly_linear(&mut self, model: &Model<N>, step: &Step<'_>, belief: &Belief<N>) -> bool {
        let horizon_s = self.kept.iter().skip(1).map(|k| k.dt_s).sum();
        let leap = |x: &Vector<N>| model.motion.leap(step.k, horizon_s, &Vector::zeros(), x);
        let straight = leap(&belief.mean);
        let ahead = kalman::predict(belief, &straight);
        let root = semidefinite_factor(&belief.cov);
        for j in 0..2 * N {
            let sigma = deviation(&root, j);
            let bend = leap(&(belief.mean + sigma)).next - straight.next - straight.f * sigma;
            if (0..N).any(|i| bend[i].abs() > BENT * ahead.cov[(i, i)].sqrt()) {
                return false;
            }
        }
        is_nearly_linear(model, step, belief, BENT, &mut self.rows)
    }

    /// Appends the instants kept when the data end: linearised where the window determines them, forgotten otherwise.
    pub fn finish(&mut self, model: &Model<N>, record: &mut Vec<Linearised<N>>) {
        if self.found {
            linearise(model, &self.kept, &self.newton, record);
        } else {
            record.extend(self.kept.iter().map(|_| Linearised::forgotten()));
        }
        self.kept.clear();
    }
}

/// The mirror image of a window's solution, where that is another solution.
pub(crate) struct Image<const N: usize> {
    /// Its trajectory.
    pub(crate) newton: Newton<N, Heap>,
    /// Its newest state.
    pub(crate) belief: Belief<N>,
    /// By how much it fits worse.
    pub(crate) lead: f64,
}

/// The solution that a search from the mirror image of another, `best` along `newton`, leads to; `None` where it leads back or nowhere.
pub(crate) fn image<const N: usize>(
    model: &Model<N>,
    kept: &VecDeque<Kept>,
    newton: &Newton<N, Heap>,
    cold: &ColdStart<N>,
    mirror: &Mirror,
    best: &Belief<N>,
    rows: &mut Vec<Row<N>>,
) -> Result<Option<Image<N>>, StepError> {
    let Some(oldest) = newton.nominal().first() else { return Ok(None) };
    let start = ColdStart { guess: mirror.reflected(oldest), ..*cold };
    let mut other = newton.clone();
    other.clear();
    let mut view = KeptWindow { model, kept, rows };
    let found = other.solve(&mut view, kept.len(), None, &start).map_err(StepError::Core)?.filter;
    let same = |found: &Belief<N>| {
        let near =
            |i: usize| (best.mean[i] - found.mean[i]).abs() <= SAME * best.cov[(i, i)].min(found.cov[(i, i)]).sqrt();
        (0..model.layout.axes).all(near)
    };
    let Some(belief) = found.filter(|found| !same(found)) else { return Ok(None) };
    let lead = misfit(model, kept, &other, rows) - misfit(model, kept, newton, rows);
    Ok(Some(Image { newton: other, belief, lead }))
}

/// Whether the image of a solution is right and the solution wrong, as far as their fit or the side that the spec knows tells.
pub(crate) fn is_right<const N: usize>(
    model: &Model<N>,
    mirror: &Mirror,
    solution: &Belief<N>,
    image: &Image<N>,
) -> Option<bool> {
    if !(image.lead.abs() <= DECISIVE) {
        return Some(image.lead < 0.0);
    }
    let side_m = model.side_m?;
    let [here, there] = [solution, &image.belief].map(|b| mirror.is_on_side_of(&b.mean, &side_m));
    (here != there).then_some(there)
}

/// Sum of the squared misses of a solution's measurements over their variances.
fn misfit<const N: usize>(
    model: &Model<N>,
    kept: &VecDeque<Kept>,
    newton: &Newton<N, Heap>,
    rows: &mut Vec<Row<N>>,
) -> f64 {
    let mut sum = 0.0;
    for (kept, x) in kept.iter().zip(newton.nominal()) {
        rows.clear();
        model.sensing.rows(&kept.step(), x, rows);
        sum += rows.iter().map(|r| r.residual * r.residual / r.var).sum::<f64>();
    }
    sum
}

/// The mirror of a window's anchors.
pub(crate) fn mirror<'a, const N: usize>(model: &Model<N>, kept: impl Iterator<Item = &'a Kept>) -> Option<Mirror> {
    let mut sites = Vec::new();
    kept.for_each(|kept| model.sensing.sites(&kept.step(), &mut sites));
    sites.sort_by(|a, b| a.iter().zip(b).map(|(a, b)| a.total_cmp(b)).find(|o| o.is_ne()).unwrap_or(Ordering::Equal));
    sites.dedup();
    Mirror::of(&model.layout, &sites)
}

/// Appends a window, linearised along its solution.
fn linearise<const N: usize>(
    model: &Model<N>,
    kept: &VecDeque<Kept>,
    newton: &Newton<N, Heap>,
    record: &mut Vec<Linearised<N>>,
) {
    let nominal = newton.nominal();
    let mut scratch = Vec::new();
    let mut view = KeptWindow { model, kept, rows: &mut scratch };
    for (i, kept) in kept.iter().enumerate() {
        let arrive = (i > 0).then(|| {
            let leap = view.leap(i, &nominal[i - 1]);
            Arrive { f: leap.f, offset: leap.next - nominal[i], q: leap.q }
        });
        let mut rows = Vec::new();
        if i == 0 {
            rows.extend(model.known_rows(&nominal[i]));
        }
        model.sensing.rows(&kept.step(), &nominal[i], &mut rows);
        record.push(Linearised { nominal: nominal[i], arrive, rows, forgotten: false });
    }
}

/// One standard deviation along column `j / 2` of a factor of the covariance, forth and back.
fn deviation<const N: usize>(root: &Matrix<N, N>, j: usize) -> Vector<N> {
    root.column(j / 2) * if j.is_multiple_of(2) { 1.0 } else { -1.0 }
}

/// Whether an instant's measurements are as good as linear over a belief's spread: one standard deviation along each column of
/// `P = L Lᵀ`, either way, bends each of them by at most `most` of its innovation's standard deviation.
pub(crate) fn is_nearly_linear<const N: usize>(
    model: &Model<N>,
    step: &Step<'_>,
    belief: &Belief<N>,
    most: f64,
    scratch: &mut Vec<Row<N>>,
) -> bool {
    scratch.clear();
    model.sensing.rows(step, &belief.mean, scratch);
    let count = scratch.len();
    let root = semidefinite_factor(&belief.cov);
    for j in 0..2 * N {
        let sigma = deviation(&root, j);
        scratch.truncate(count);
        model.sensing.rows(step, &(belief.mean + sigma), scratch);
        let (rows, moved) = scratch.split_at(count);
        for (row, moved) in rows.iter().zip(moved) {
            let bend = row.residual - moved.residual - row.h.dot(&sigma);
            let var = row.h.dot(&(belief.cov * row.h)) + row.var;
            if bend.abs() > most * var.sqrt() {
                return false;
            }
        }
    }
    true
}
