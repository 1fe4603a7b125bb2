//! Finite-memory estimates with nonlinear sensors or motion: Gauss–Newton over the window.
//!
//! Each iteration linearises motion and sensors along a nominal trajectory, solves the linear window exactly (diffuse pass and
//! backward information, [`smoother`](crate::estimators::smoother)) for the trajectory's correction, and moves the nominal. The trajectory of the
//! window before, moved by one instant, is the warm start.

use crate::estimators::diffuse::Joint;
use crate::estimators::smoother::{Arrive, Forward, Instant, smooth};
use crate::linalg::compress;
use crate::storage::Store;
use crate::types::{Belief, Row, StepError, Transition, Vector};

/// Most iterations before the window is given up.
const MOST_ITERATIONS: usize = 30;
/// A correction below this fraction of every standard deviation ends the iteration.
const CONVERGED: f64 = 1e-7;
/// Iterations of a cold start that keep a weak prior about the starting point.
const DAMPED_ITERATIONS: usize = 4;
/// Most scalar rows of one instant that are handed over at once.
pub const MOST_ROWS: usize = 64;

/// The nonlinear model of a window.
pub trait WindowModel<const N: usize> {
    /// Transition from instant `i − 1`, where the state is `x`, to instant `i`.
    fn leap(&mut self, i: usize, x: &Vector<N>) -> Transition<N>;

    /// Writes the rows of instant `i`, linearised at `x`, and returns how many there are.
    fn rows(&mut self, i: usize, x: &Vector<N>, out: &mut [Row<N>; MOST_ROWS]) -> usize;
}

/// Where a window without a trajectory starts.
#[derive(Clone, Copy, Debug)]
pub struct ColdStart<const N: usize> {
    /// First guess of the oldest state.
    pub guess: Vector<N>,
    /// How far from it the state may plausibly be, per component.
    pub spread: Vector<N>,
}

/// The nominal trajectory of a window and the room to work in.
#[derive(Clone)]
pub struct Newton<const N: usize, S: Store> {
    nominal: S::Of<Vector<N>>,
    instants: S::Of<Instant<N>>,
    rows: S::Of<Row<N>>,
    len: usize,
}

impl<const N: usize, S: Store> Newton<N, S> {
    /// Room for windows of `capacity` instants, or `None` when the store has none.
    pub fn new(capacity: usize) -> Option<Self> {
        Some(Self {
            nominal: S::filled(capacity, Vector::zeros())?,
            instants: S::filled(capacity, Instant::zero())?,
            rows: S::filled(capacity * N, Row { h: Vector::zeros(), residual: 0.0, var: 1.0 })?,
            len: 0,
        })
    }

    /// Number of instants that fit.
    pub fn capacity(&self) -> usize {
        self.nominal.as_ref().len()
    }

    /// Forgets the `count` oldest instants of the nominal trajectory.
    pub fn drop_front(&mut self, count: usize) {
        let count = count.min(self.len);
        self.nominal.as_mut().copy_within(count..self.len, 0);
        self.len -= count;
    }

    /// The nominal trajectory, oldest first.
    pub fn nominal(&self) -> &[Vector<N>] {
        &self.nominal.as_ref()[..self.len]
    }

    /// Forgets the nominal trajectory: the next window starts cold.
    pub fn clear(&mut self) {
        self.len = 0;
    }

    /// Estimates the newest of `len` instants and the one at index `lagged`. Both are `None` when the window does not determine the
    /// trajectory or the iteration does not settle; the next window then starts cold. The cross-covariance is not computed.
    ///
    /// # Errors
    /// [`StepError::WindowFull`] when the window does not fit; nothing has changed then.
    pub fn solve(
        &mut self,
        model: &mut impl WindowModel<N>,
        len: usize,
        lagged: Option<usize>,
        cold: &ColdStart<N>,
    ) -> Result<Joint<N>, StepError> {
        if len > self.capacity() {
            return Err(StepError::WindowFull { capacity: self.capacity(), needed: len });
        }
        let was_cold = self.len == 0;
        if was_cold && len > 0 {
            self.nominal.as_mut()[0] = cold.guess;
            self.len = 1;
        }
        while self.len < len {
            let leap = model.leap(self.len, &self.nominal.as_ref()[self.len - 1]);
            self.nominal.as_mut()[self.len] = leap.next;
            self.len += 1;
        }
        for iteration in 0..MOST_ITERATIONS {
            let damping = (was_cold && iteration < DAMPED_ITERATIONS).then_some(&cold.spread);
            let Some(step) = self.iterate(model, lagged, damping) else { break };
            if !step.largest.is_finite() {
                break;
            }
            if step.largest < CONVERGED && damping.is_none() {
                return Ok(step.joint);
            }
        }
        if !was_cold {
            // The warm start may have been led astray: once more from the guess.
            self.clear();
            return self.solve(model, len, lagged, cold);
        }
        self.clear();
        Ok(Joint::none())
    }

    /// One linearisation and its exact solution; moves the nominal trajectory. `None` when the window does not determine it.
    fn iterate(
        &mut self,
        model: &mut impl WindowModel<N>,
        lagged: Option<usize>,
        damping: Option<&Vector<N>>,
    ) -> Option<Settled<N>> {
        let mut forward = Forward::start(None);
        let mut buffer = [Row { h: Vector::zeros(), residual: 0.0, var: 1.0 }; MOST_ROWS];
        let mut count = 0;
        for i in 0..self.len {
            let at = self.nominal.as_ref()[i];
            let arrive = (i > 0).then(|| {
                let leap = model.leap(i, &self.nominal.as_ref()[i - 1]);
                Arrive { f: leap.f, offset: leap.next - at, q: leap.q }
            });
            let mut instant = forward.leap(arrive.as_ref());
            let given = model.rows(i, &at, &mut buffer);
            let (rows, _) = compress(&mut buffer[..given]);
            for row in &buffer[..rows] {
                forward.update(row);
                self.rows.as_mut()[count] = *row;
                count += 1;
            }
            instant.rows = rows;
            self.instants.as_mut()[i] = instant;
        }
        let start = match damping {
            Some(spread) => forward.damped_start(spread),
            None => forward.start_state(),
        };
        if !start.is_determined() {
            return None;
        }
        let nominal = self.nominal.as_mut();
        let newest = self.len - 1;
        let mut out = Settled { largest: 0.0, joint: Joint::none() };
        smooth(&start, &self.instants.as_ref()[..self.len], &self.rows.as_ref()[..count], |i, delta| {
            let Some(delta) = delta else { return };
            for c in 0..N {
                let sd = libm::sqrt(delta.cov[(c, c)].max(f64::MIN_POSITIVE));
                // NaN must not be lost in a maximum.
                let ratio = delta.mean[c].abs() / sd;
                out.largest = if ratio.is_nan() || ratio > out.largest { ratio } else { out.largest };
            }
            nominal[i] += delta.mean;
            let belief = Belief { mean: nominal[i], cov: delta.cov };
            if i == newest {
                out.joint.filter = Some(belief);
            }
            if lagged == Some(i) {
                out.joint.lagged = Some(belief);
            }
        });
        Some(out)
    }
}

/// The outcome of one iteration.
struct Settled<const N: usize> {
    largest: f64,
    joint: Joint<N>,
}
