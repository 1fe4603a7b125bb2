//! Finite-memory estimates of a time-invariant linear model, the algorithm chosen by what was lost.

use crate::estimators::diffuse::{Diffuse, Joint};
use crate::estimators::fms::gain::{Column, Gain, Invariant, Shape};
use crate::estimators::fms::lost::{LostRows, MOST_LOST};
use crate::estimators::fms::two_filter::{TwoFilter, inverse_of, take_row};
use crate::estimators::fms::varying::Varying;
use crate::estimators::fms::{Align, STACKS_FROM};
use crate::estimators::kalman::finite;
use crate::estimators::smoother::{Arrive, Backward, Instant, StartState};
use crate::linalg::{cholesky, whiten};
use crate::storage::Store;
use crate::types::{Belief, Matrix, Row, StepError, Transition, Vector};

/// Most components of a measurement vector.
pub const MOST_COMPONENTS: usize = 6;

/// Largest number of scalars in a window for which the lost-row correction is prepared: its matrix has the square of it.
const CORRECTED_UP_TO: usize = 256;

/// Lost scalars up to which correcting them is quicker than stacks.
const FEW_LOST: usize = 6;

/// Lost scalars, and scalars in a window, up to which correcting them is quicker than two filters that meet.
const FEW_LOST_OF_FEW: (usize, usize) = (2, 40);

/// Number of scalars in a window up to which the gain is quicker than two filters that meet: it has a column for each.
const GAIN_UP_TO: usize = 128;

/// A time-invariant linear model as a window needs it.
#[derive(Clone, Copy, Debug)]
pub struct Model<'a, const N: usize> {
    /// A.
    pub a: &'a Matrix<N, N>,
    /// `G Q Gᵀ`.
    pub w: &'a Matrix<N, N>,
    /// Columns of B.
    pub b: &'a [Vector<N>],
    /// Rows of C.
    pub c: &'a [Vector<N>],
    /// R, row by row.
    pub r: &'a [f64],
}

/// A sliding window over a time-invariant linear model.
#[derive(Clone)]
pub struct InvariantWindow<const N: usize, S: Store> {
    leap: Transition<N>,
    b: S::Of<Vector<N>>,
    p_u: usize,
    c: [Vector<N>; MOST_COMPONENTS],
    r: [f64; MOST_COMPONENTS * MOST_COMPONENTS],
    /// What whitens the only component where there is but one.
    alone: f64,
    /// Diagonal of R⁻¹: the bound of W's diagonal.
    precision: [f64; MOST_COMPONENTS],
    q: usize,
    shape: Shape,
    gain: Option<Gain<N, S>>,
    lost_rows: Option<LostRows<S>>,
    /// Doubled rings: the window's data lie contiguous, oldest first. A lost component is 0 here and `false` in `got`.
    z: S::Of<f64>,
    got: S::Of<bool>,
    u: S::Of<f64>,
    scratch: S::Of<f64>,
    head: usize,
    len: usize,
    lost: usize,
    /// A⁻¹, for estimates without a lag.
    inverse: Option<Matrix<N, N>>,
    /// Estimates without a lag; empty while not in use.
    two: Option<TwoFilter<N, S>>,
    /// Fallback of long windows; empty while not in use.
    varying: Option<Varying<N, S>>,
}

impl<const N: usize, S: Store> InvariantWindow<N, S> {
    /// Prepares a window: designs the gain and, for windows that are not too long, the lost-row correction.
    ///
    /// # Errors
    /// [`StepError::WindowFull`] when the store has no room for the window's data; [`StepError::InnovationVariance`] when R is not
    /// positive definite.
    ///
    /// # Panics
    /// When C has more than [`MOST_COMPONENTS`] rows or R is not q × q: the caller's shapes are checked before.
    pub fn new(model: &Model<'_, N>, shape: Shape) -> Result<Self, StepError> {
        let (q, m, p_u) = (model.c.len(), shape.window, model.b.len());
        assert!(q <= MOST_COMPONENTS && model.r.len() == q * q, "C has {q} rows, R has {} entries", model.r.len());
        let full = StepError::WindowFull { capacity: 0, needed: m };
        let mut c = [Vector::zeros(); MOST_COMPONENTS];
        c[..q].copy_from_slice(model.c);
        let mut r = [0.0; MOST_COMPONENTS * MOST_COMPONENTS];
        r[..q * q].copy_from_slice(model.r);
        let mut factor = r;
        if !cholesky(&mut factor[..q * q], q) {
            return Err(StepError::InnovationVariance { var: r[0] });
        }
        let mut b = S::filled(p_u, Vector::zeros()).ok_or(full)?;
        b.as_mut()[..p_u].copy_from_slice(model.b);
        let leap = Transition { next: Vector::zeros(), f: *model.a, q: *model.w };
        let inverse = if shape.lag == 0 { inverse_of(model.a) } else { None };
        let mut window = Self {
            leap,
            b,
            p_u,
            c,
            r,
            alone: 1.0 / libm::sqrt(r[0]),
            precision: precision(&factor[..q * q], q),
            q,
            shape,
            gain: None,
            lost_rows: None,
            z: S::filled(2 * m * q, 0.0).ok_or(full)?,
            got: S::filled(2 * m * q, false).ok_or(full)?,
            u: S::filled(2 * m * p_u, 0.0).ok_or(full)?,
            scratch: S::filled(m * q, 0.0).ok_or(full)?,
            head: 0,
            len: 0,
            lost: 0,
            two: if inverse.is_some() { TwoFilter::new(m) } else { None },
            inverse,
            varying: if m >= STACKS_FROM { Varying::new(m + 1) } else { None },
        };
        let mut white = [Row { h: Vector::zeros(), residual: 0.0, var: 1.0 }; MOST_COMPONENTS];
        for (row, h) in white.iter_mut().zip(model.c) {
            row.h = *h;
        }
        let mut work = r;
        if !whiten(&mut white[..q], &mut work[..q * q]) {
            return Err(StepError::InnovationVariance { var: r[0] });
        }
        let mut h = [Vector::zeros(); MOST_COMPONENTS];
        for (h, row) in h.iter_mut().zip(&white) {
            *h = row.h;
        }
        let invariant = Invariant { leap: &leap, rows: &h[..q], b: model.b };
        window.gain = Gain::design(&invariant, shape)?.filter(|gain| gain.joint.is_finite());
        if let Some(gain) = &mut window.gain {
            unwhiten(gain.z.as_mut(), &factor[..q * q], q, m);
            if m * q <= CORRECTED_UP_TO {
                window.lost_rows = LostRows::design(&invariant, m, &factor[..q * q])?;
            }
        }
        Ok(window)
    }

    /// The gain in use, in raw measurement coordinates, when the full window determines both estimates.
    pub fn gain(&self) -> Option<&Gain<N, S>> {
        self.gain.as_ref()
    }

    /// Number of instants in the window.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether the window is empty.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Adds an instant: its measurement, lost components absent (`z` shorter than q: the rest is lost), and the input that acts from it
    /// to the next (shorter than p_u: the rest is 0). The oldest instant leaves a full window.
    ///
    /// # Errors
    /// [`StepError::WindowFull`] when the store has no room for the fallback of long windows; nothing has changed then.
    #[inline]
    pub fn push(&mut self, z: &[Option<f64>], u: &[f64]) -> Result<(), StepError> {
        let (m, q) = (self.shape.window, self.q);
        if let Some(varying) = &mut self.varying
            && !varying.is_empty()
        {
            let newest = self.len - 1;
            let arrive = Transition { next: self.drive(newest), ..self.leap };
            let mut rows = [Row { h: Vector::zeros(), residual: 0.0, var: 1.0 }; MOST_COMPONENTS];
            let count = rows_of(&self.c, &self.r, self.alone, q, |i| z.get(i).copied().flatten(), &mut rows);
            let varying = self.varying.as_mut().expect("it was there two lines above");
            varying.push(&arrive, &mut rows[..count])?;
            if self.len == m {
                varying.drop_front(1);
            }
        }
        let slot = if self.len == m {
            let oldest = self.head;
            for got in &self.got.as_ref()[oldest * q..(oldest + 1) * q] {
                self.lost -= usize::from(!got);
            }
            self.head = if oldest + 1 == m { 0 } else { oldest + 1 };
            if let Some(two) = &mut self.two {
                two.drop_front(1);
            }
            oldest
        } else {
            // Until it is full the window starts at slot 0.
            self.len += 1;
            self.len - 1
        };
        for i in 0..q {
            let value = z.get(i).copied().flatten();
            self.lost += usize::from(value.is_none());
            for copy in [slot, slot + m] {
                self.z.as_mut()[copy * q + i] = value.unwrap_or(0.0);
                self.got.as_mut()[copy * q + i] = value.is_some();
            }
        }
        for i in 0..self.p_u {
            for copy in [slot, slot + m] {
                self.u.as_mut()[copy * self.p_u + i] = u.get(i).copied().unwrap_or(0.0);
            }
        }
        if self.two.as_ref().is_some_and(|two| !two.is_empty()) {
            self.push_two();
        }
        Ok(())
    }

    /// Returns filter and smoother for the instant the shape asks for: the newest, or with [`Align::Predicted`] the one after it. A
    /// window whose covariances leave the range of numbers has no estimate.
    #[inline]
    pub fn estimate(&mut self) -> Joint<N> {
        if self.lost == 0
            && (self.two.is_none() || self.shape.window * self.q <= GAIN_UP_TO)
            && let Some(joint) = self.gained()
        {
            return joint;
        }
        self.estimate_otherwise()
    }

    /// The estimate of a full window without losses by the gain.
    #[inline]
    fn gained(&mut self) -> Option<Joint<N>> {
        let gain = self.gain.as_ref().filter(|_| self.lost == 0 && self.len == self.shape.window)?;
        let means = gain.apply(self.data(), self.inputs());
        // The covariances are those of the design, which has looked at them.
        if !(0..N).all(|i| means.0[i].is_finite() && means.1[i].is_finite()) {
            return None;
        }
        let joint = shifted(&gain.joint, &means);
        if let Some(varying) = &mut self.varying {
            varying.clear();
        }
        if let Some(two) = &mut self.two {
            two.clear();
        }
        Some(joint)
    }

    #[cold]
    #[inline(never)]
    fn estimate_otherwise(&mut self) -> Joint<N> {
        // Stacks that are filled go on until nothing is lost: filling them costs a pass over the window.
        let has_stacks = self.varying.as_ref().is_some_and(|varying| !varying.is_empty());
        let is_few = match &self.two {
            Some(two) => {
                two.is_empty() && self.lost <= FEW_LOST_OF_FEW.0 && self.shape.window * self.q <= FEW_LOST_OF_FEW.1
            }
            None => self.shape.window < STACKS_FROM || self.lost <= FEW_LOST && !has_stacks,
        };
        if self.lost > 0
            && self.len == self.shape.window
            && is_few
            && let Some(joint) = self.corrected().filter(Joint::is_finite)
        {
            return joint;
        }
        if let Some(belief) = self.met() {
            return Joint::newest(belief);
        }
        if let Some(joint) = self.gained() {
            return joint;
        }
        if self.len >= STACKS_FROM
            && let Some(joint) = self.aggregated()
        {
            return joint;
        }
        self.passed().unwrap_or_else(|_| Joint::none())
    }

    /// Rows of instant `i` (the oldest is 0), whitened, linearised at 0. Returns how many there are.
    pub fn rows(&self, i: usize, out: &mut [Row<N>; MOST_COMPONENTS]) -> usize {
        let at = (self.head + i) * self.q;
        let (z, got) = (self.z.as_ref(), self.got.as_ref());
        rows_of(&self.c, &self.r, self.alone, self.q, |j| got[at + j].then(|| z[at + j]), out)
    }

    fn data(&self) -> &[f64] {
        &self.z.as_ref()[self.head * self.q..(self.head + self.len) * self.q]
    }

    fn inputs(&self) -> &[f64] {
        let leaps = self.shape.leaps().min(self.len);
        &self.u.as_ref()[self.head * self.p_u..(self.head + leaps) * self.p_u]
    }

    /// `B u` of instant `i`.
    fn drive(&self, i: usize) -> Vector<N> {
        let at = (self.head + i) * self.p_u;
        let mut sum = Vector::zeros();
        for (b, u) in self.b.as_ref().iter().zip(&self.u.as_ref()[at..at + self.p_u]) {
            sum += b * *u;
        }
        sum
    }

    /// The estimate by the full-window gain with the lost rows filled in.
    fn corrected(&mut self) -> Option<Joint<N>> {
        let (gain, lost_rows) = (self.gain.as_ref()?, self.lost_rows.as_ref()?);
        if self.lost > MOST_LOST || self.lost * 3 > self.shape.window * self.q {
            return None;
        }
        let q = self.q;
        let mut lost = [0; MOST_LOST];
        let mut count = 0;
        let data = &self.z.as_ref()[self.head * q..(self.head + self.len) * q];
        let got = &self.got.as_ref()[self.head * q..(self.head + self.len) * q];
        self.scratch.as_mut()[..data.len()].copy_from_slice(data);
        for (i, _) in got.iter().enumerate().filter(|(_, got)| !**got) {
            lost[count] = i;
            count += 1;
        }
        // What the known inputs alone would have done.
        let mut ends = (Vector::<N>::zeros(), Vector::<N>::zeros());
        if self.p_u > 0 {
            let mut p = Vector::<N>::zeros();
            for i in 0..=self.shape.leaps() {
                if i > 0 {
                    p = self.leap.f * p + self.drive(i - 1);
                }
                if self.shape.lagged() == Some(i) {
                    ends.1 = p;
                }
                if i < self.len {
                    for j in (0..q).filter(|j| got[i * q + j]) {
                        self.scratch.as_mut()[i * q + j] -= self.c[j].dot(&p);
                    }
                }
            }
            ends.0 = p;
        }
        let z = &self.scratch.as_ref()[..data.len()];
        let (moved, joint) = lost_rows.correct(gain, z, &lost[..count], |row| self.precision[row % q])?;
        let base = gain.apply(z, &[]);
        Some(shifted(&joint, &(base.0 + moved.0 + ends.0, base.1 + moved.1 + ends.1)))
    }

    /// Adds the newest instant to the filters that meet.
    fn push_two(&mut self) {
        let newest = self.len - 1;
        let mut rows = [Row { h: Vector::zeros(), residual: 0.0, var: 1.0 }; MOST_COMPONENTS];
        let count = self.rows(newest, &mut rows);
        let align = self.shape.align;
        let offset = match align {
            Align::Filtered => self.drive(newest - 1),
            Align::Predicted => self.drive(newest),
        };
        let (two, Transition { f, q, .. }) = (self.two.as_mut().expect("asked before"), &self.leap);
        two.push(|future| {
            if align == Align::Filtered {
                future.leap(f, &offset, q);
            }
            rows[..count].iter().try_for_each(|row| take_row(future, row))?;
            if align == Align::Predicted {
                future.leap(f, &offset, q);
            }
            Some(())
        });
    }

    /// The newest instant, or the one after it, from two filters that meet; `None` where they cannot decide.
    #[inline]
    fn met(&mut self) -> Option<Belief<N>> {
        let inverse = self.inverse?;
        let len = self.len;
        if self.two.as_ref()?.len() != len {
            let mut two = self.two.take()?;
            let leaps = len - usize::from(self.shape.align == Align::Filtered);
            let mut rows = [Row { h: Vector::zeros(), residual: 0.0, var: 1.0 }; MOST_COMPONENTS];
            let turned = two.turn(len, |i, past| {
                if i < leaps {
                    past.leap_back(&inverse, &self.drive(i), &self.leap.q);
                }
                let count = self.rows(i, &mut rows);
                rows[..count].iter().try_for_each(|row| take_row(past, row))
            });
            self.two = Some(two);
            turned?;
            if let Some(varying) = &mut self.varying {
                varying.clear();
            }
        }
        let belief = self.two.as_ref()?.filtered()?;
        finite(&belief.mean, &belief.cov).ok().map(|()| belief)
    }

    /// The estimate from the queues of a time-varying window, filled on first need; `None` without one, or without room in it.
    fn aggregated(&mut self) -> Option<Joint<N>> {
        let mut varying = self.varying.take()?;
        let mut filled = true;
        if varying.is_empty() {
            let mut rows = [Row { h: Vector::zeros(), residual: 0.0, var: 1.0 }; MOST_COMPONENTS];
            for i in 0..self.len {
                let next = if i > 0 { self.drive(i - 1) } else { Vector::zeros() };
                let count = self.rows(i, &mut rows);
                filled &= varying.push(&Transition { next, ..self.leap }, &mut rows[..count]).is_ok();
            }
        }
        if !filled {
            varying.clear();
        }
        let joint = filled.then(|| match self.shape.align {
            Align::Filtered => varying.filtered(self.shape.lag),
            Align::Predicted => {
                let leap = Transition { next: self.drive(self.len - 1), ..self.leap };
                varying.predicted(self.shape.lag, &leap)
            }
        });
        self.varying = Some(varying);
        joint
    }

    /// The estimate by one exact-diffuse pass over the window, and for the lagged instant back again from the newest.
    fn passed(&self) -> Result<Joint<N>, StepError> {
        let mut rows = [Row { h: Vector::zeros(), residual: 0.0, var: 1.0 }; MOST_COMPONENTS];
        let leaps = match self.shape.align {
            Align::Filtered => self.len.saturating_sub(1),
            Align::Predicted => self.len,
        };
        let lagged = leaps.checked_sub(self.shape.lag);
        let mut pass = Diffuse::start();
        let mut at = None;
        for i in 0..=leaps {
            if i > 0 {
                pass.leap(&self.leap.f, &self.drive(i - 1), &self.leap.q);
            }
            if lagged == Some(i) {
                pass.mark_lag();
                at = Some((i, Instant::of(&pass, None)));
            }
            if i < self.len {
                let count = self.rows(i, &mut rows);
                for row in &rows[..count] {
                    pass.update(row)?;
                }
            }
        }
        let mut joint = pass.solve();
        if let Some((lagged, at)) = at {
            let start = StartState::after(&pass);
            let mut backward = Backward::new(&start);
            for i in (lagged..self.len).rev() {
                let count = self.rows(i, &mut rows);
                rows[..count].iter().for_each(|row| backward.row(row));
                if i > lagged {
                    backward.leap(&Arrive { f: self.leap.f, offset: self.drive(i - 1), q: self.leap.q });
                }
            }
            joint.lagged = backward.smoothed(&at);
        }
        Ok(joint)
    }
}

/// The joint covariance with means added.
#[inline]
fn shifted<const N: usize>(joint: &Joint<N>, means: &Column<N>) -> Joint<N> {
    let at = |belief: &Option<Belief<N>>, mean| belief.as_ref().map(|belief| Belief { mean, cov: belief.cov });
    Joint { filter: at(&joint.filter, means.0), lagged: at(&joint.lagged, means.1), cross: joint.cross }
}

/// Whitened rows of the components that arrived; correlated components are whitened together.
/// `alone` whitens the only component where there is but one.
#[inline]
fn rows_of<const N: usize>(
    c: &[Vector<N>],
    r: &[f64],
    alone: f64,
    q: usize,
    value: impl Fn(usize) -> Option<f64>,
    out: &mut [Row<N>; MOST_COMPONENTS],
) -> usize {
    if q == 1 {
        return value(0).map_or(0, |z| {
            out[0] = Row { h: c[0] * alone, residual: z * alone, var: 1.0 };
            1
        });
    }
    let mut index = [0; MOST_COMPONENTS];
    let mut count = 0;
    for i in 0..q {
        if let Some(z) = value(i) {
            out[count] = Row { h: c[i], residual: z, var: r[i * q + i] };
            index[count] = i;
            count += 1;
        }
    }
    whiten_together(&index[..count], r, q, out);
    count
}

/// Whitens the rows of the given components.
#[inline(never)]
fn whiten_together<const N: usize>(index: &[usize], r: &[f64], q: usize, rows: &mut [Row<N>; MOST_COMPONENTS]) {
    let count = index.len();
    let mut block = [0.0; MOST_COMPONENTS * MOST_COMPONENTS];
    for i in 0..count {
        for j in 0..count {
            block[i * count + j] = r[index[i] * q + index[j]];
        }
    }
    // A principal block of a positive definite R is positive definite: `new` has checked R.
    let whitened = whiten(&mut rows[..count], &mut block[..count * count]);
    debug_assert!(whitened);
}

/// Turns gain columns of whitened components into columns of raw ones: `K_raw = K L⁻¹` per instant.
fn unwhiten<const N: usize>(columns: &mut [Column<N>], l: &[f64], q: usize, window: usize) {
    for block in 0..window {
        let columns = &mut columns[block * q..(block + 1) * q];
        for i in (0..q).rev() {
            let (mut g, mut g_lag) = columns[i];
            for k in i + 1..q {
                g -= columns[k].0 * l[k * q + i];
                g_lag -= columns[k].1 * l[k * q + i];
            }
            let d = 1.0 / l[i * q + i];
            columns[i] = (g * d, g_lag * d);
        }
    }
}

/// Diagonal of R⁻¹ from R's factor.
fn precision(l: &[f64], q: usize) -> [f64; MOST_COMPONENTS] {
    let mut out = [0.0; MOST_COMPONENTS];
    for (j, p) in out.iter_mut().enumerate().take(q) {
        let mut x = [0.0; MOST_COMPONENTS];
        for i in j..q {
            let mut sum = if i == j { 1.0 } else { 0.0 };
            for k in j..i {
                sum -= l[i * q + k] * x[k];
            }
            x[i] = sum / l[i * q + i];
            *p += x[i] * x[i];
        }
    }
    out
}
