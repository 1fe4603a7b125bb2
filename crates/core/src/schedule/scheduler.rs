//! The decision: which sensor, after which interval.

use super::{Battery, DesignError, MOST_AWAKE, Radio};

/// Most sample intervals to choose from.
pub const MOST_INTERVALS: usize = 16;

/// How a sensor is chosen from those that are awake.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Choice {
    /// Of those accurate enough the cheapest: (43) and (44).
    Cost {
        /// `φ_0`: the accuracy that is enough.
        enough: f64,
        /// `w`: weight of the accuracy where none is enough; 1 − w is that of the energy.
        weight: f64,
    },
    /// The one nearest to the target.
    Nearest,
    /// The one that leaves the smallest uncertainty.
    Accuracy,
}

/// What a scheduler goes by.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Policy<'a> {
    /// How one is chosen.
    pub choice: Choice,
    /// Sample intervals, ascending, s; all but [`Choice::Cost`] take the shortest.
    pub intervals_s: &'a [f64],
    /// How many sensors are awake around the target.
    pub group: usize,
    /// How far a sensor sees, m; infinite where it sees everything.
    pub range_m: f64,
}

/// What the filter foretells of a decision, from its estimate now.
pub trait Foresight {
    /// What it fails with.
    type Error;

    /// Where the target will be `interval_s` from now.
    ///
    /// # Errors
    /// The filter's.
    fn position_m(&mut self, interval_s: f64) -> Result<[f64; 2], Self::Error>;

    /// How uncertain it will be `interval_s` from now, after a measurement by `sensor`: φ.
    ///
    /// # Errors
    /// The filter's.
    fn accuracy(&mut self, interval_s: f64, sensor: usize) -> Result<f64, Self::Error>;
}

/// One way to go on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// T, s.
    pub interval_s: f64,
    /// Place of the sensor in the group, the nearest first.
    pub rank: usize,
    /// The sensor.
    pub sensor: usize,
    /// φ.
    pub accuracy: f64,
    /// E, mJ.
    pub energy_mj: f64,
}

/// Why a plan is what it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// The accuracy is good enough, or was not asked for.
    Satisfied,
    /// It is not: accuracy and energy are weighed at the shortest interval.
    Weighed,
    /// No sensor sees the target: it coasts for the shortest interval.
    Coasting,
}

/// A decision.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plan {
    /// Until the next instant, s.
    pub interval_s: f64,
    /// What measures there; `None` while coasting.
    pub chosen: Option<Candidate>,
    /// Why.
    pub mode: Mode,
    /// Whether a new group has woken up for it.
    pub handoff: bool,
}

/// Sensors, the group that is awake, and the sensor in charge.
///
/// `S` is storage for the sensors, `AsMut<[Battery]>`: an array or a box.
#[derive(Clone, Debug, PartialEq)]
pub struct Scheduler<S> {
    sensors: S,
    radio: Radio,
    choice: Choice,
    intervals_s: [f64; MOST_INTERVALS],
    intervals: usize,
    size: usize,
    range_m: f64,
    group: [usize; MOST_AWAKE],
    /// Sensors of the group; 0 while coasting.
    awake: usize,
    /// Largest energy that a sensor may have to spend at once: what it must have left to be asked.
    reserve_mj: f64,
    task: usize,
    spent_mj: f64,
}

impl<S: AsRef<[Battery]> + AsMut<[Battery]>> Scheduler<S> {
    /// Returns the scheduler of a target first seen at `start_m`: the nearest sensor is in charge, the nearest group awake.
    ///
    /// # Errors
    /// [`DesignError`].
    pub fn new(sensors: S, radio: Radio, policy: &Policy<'_>, start_m: [f64; 2]) -> Result<Self, DesignError> {
        let radio = radio.checked()?;
        let count = sensors.as_ref().len();
        if count == 0 {
            return Err(DesignError::NoSensor);
        }
        let most = count.min(MOST_AWAKE);
        if !(1..=most).contains(&policy.group) {
            return Err(DesignError::Group { group: policy.group, most });
        }
        let given = policy.intervals_s;
        let ascending = given.windows(2).all(|pair| pair[0] < pair[1]);
        let positive = given.iter().all(|t| *t > 0.0 && t.is_finite());
        if !((1..=MOST_INTERVALS).contains(&given.len()) && ascending && positive) {
            return Err(DesignError::Intervals);
        }
        if let Choice::Cost { weight, .. } = policy.choice
            && !(0.0..=1.0).contains(&weight)
        {
            return Err(DesignError::Weight { weight });
        }
        let mut intervals_s = [0.0; MOST_INTERVALS];
        intervals_s[..given.len()].copy_from_slice(given);
        let farthest_mj = (sensors.as_ref().iter())
            .flat_map(|a| sensors.as_ref().iter().map(|b| radio.send_mj(a.distance_m(b.position_m))))
            .fold(0.0, f64::max);
        let mut scheduler = Scheduler {
            sensors,
            radio,
            choice: policy.choice,
            intervals_s,
            intervals: if matches!(policy.choice, Choice::Cost { .. }) { given.len() } else { 1 },
            size: policy.group,
            range_m: policy.range_m,
            group: [0; MOST_AWAKE],
            awake: 0,
            reserve_mj: radio.sense_mj() + radio.receive_mj() + farthest_mj,
            task: 0,
            spent_mj: 0.0,
        };
        scheduler.task = scheduler.nearest(start_m, |_| true).0[0];
        (scheduler.group, scheduler.awake) = scheduler.nearest(start_m, |i| scheduler.usable(i));
        Ok(scheduler)
    }

    /// The sensor in charge.
    pub fn task(&self) -> usize {
        self.task
    }

    /// Energy spent so far, mJ.
    pub fn spent_mj(&self) -> f64 {
        self.spent_mj
    }

    /// The sensors.
    pub fn sensors(&self) -> &[Battery] {
        self.sensors.as_ref()
    }

    /// The sensors that are awake, the nearest first.
    pub fn group(&self) -> &[usize] {
        &self.group[..self.awake]
    }

    /// Takes a sensor that has failed out of service.
    pub fn fail(&mut self, sensor: usize) {
        if let Some(sensor) = self.sensors.as_mut().get_mut(sensor) {
            sensor.alive = false;
        }
    }

    /// Whether a sensor works and could pay for whatever it might be asked.
    pub fn usable(&self, sensor: usize) -> bool {
        self.sensors().get(sensor).is_some_and(|s| s.alive && s.residual_mj >= self.reserve_mj)
    }

    /// Returns the energy of measuring with `to` when `from` is in charge, mJ. A sensor that is not usable hands over nothing: the sink does.
    pub fn energy_mj(&self, from: usize, to: usize) -> f64 {
        if self.radio.free_self && from == to {
            return self.radio.sense_mj();
        }
        self.radio.sense_mj() + self.radio.receive_mj() + self.send_mj(from, to)
    }

    fn send_mj(&self, from: usize, to: usize) -> f64 {
        let sensors = self.sensors();
        if self.usable(from) { self.radio.send_mj(sensors[from].distance_m(sensors[to].position_m)) } else { 0.0 }
    }

    /// Decides how to go on from an estimate at `now_m`; `seen` is told of every candidate, by interval and then by distance.
    ///
    /// # Errors
    /// The foresight's; nothing has changed then.
    pub fn plan<F: Foresight>(
        &mut self,
        now_m: [f64; 2],
        foresight: &mut F,
        mut seen: impl FnMut(&Candidate),
    ) -> Result<Plan, F::Error> {
        let (near, count) = self.nearest(now_m, |i| self.usable(i));
        let awake = self.group();
        let left = count == 0 || !awake.contains(&near[0]);
        let handoff = awake.is_empty() || awake.iter().any(|i| !self.usable(*i)) || left;
        let (group, awake) = if handoff { (near, count) } else { (self.group, self.awake) };

        let mut satisfied: Option<Candidate> = None;
        let mut weighed: Option<(f64, Candidate)> = None;
        let shortest_s = self.intervals_s[0];
        for interval_s in self.intervals_s[..self.intervals].iter().copied() {
            let then_m = foresight.position_m(interval_s)?;
            for (rank, sensor) in group[..awake].iter().copied().enumerate() {
                // A place that is not finite is out of every range.
                if !(self.sensors()[sensor].distance_m(then_m) <= self.range_m) {
                    continue;
                }
                let accuracy = foresight.accuracy(interval_s, sensor)?;
                let energy_mj = self.energy_mj(self.task, sensor);
                let candidate = Candidate { interval_s, rank, sensor, accuracy, energy_mj };
                seen(&candidate);
                let better = |best: &Option<Candidate>| best.is_none_or(|best| self.precedes(&candidate, &best));
                let enough = match self.choice {
                    Choice::Cost { enough, .. } => accuracy <= enough,
                    Choice::Nearest | Choice::Accuracy => true,
                };
                if enough && better(&satisfied) {
                    satisfied = Some(candidate);
                }
                if let (Choice::Cost { weight, .. }, true) = (self.choice, interval_s == shortest_s) {
                    let cost = weight * accuracy + (1.0 - weight) * energy_mj / interval_s;
                    // Ties go to the nearer sensor, which came first.
                    if weighed.is_none_or(|(least, _)| cost < least) {
                        weighed = Some((cost, candidate));
                    }
                }
            }
        }
        let (chosen, mode) = match (satisfied, weighed) {
            (Some(best), _) => (Some(best), Mode::Satisfied),
            (None, Some((_, best))) => (Some(best), Mode::Weighed),
            (None, None) => (None, Mode::Coasting),
        };
        // While coasting nobody is awake: the next decision wakes a group anew.
        (self.group, self.awake) = (group, if mode == Mode::Coasting { 0 } else { awake });
        let interval_s = chosen.map_or(shortest_s, |c| c.interval_s);
        Ok(Plan { interval_s, chosen, mode, handoff })
    }

    /// Whether `a` goes before `b`, of two that are accurate enough.
    fn precedes(&self, a: &Candidate, b: &Candidate) -> bool {
        let key = |c: &Candidate| match self.choice {
            Choice::Cost { .. } => [c.energy_mj / c.interval_s, -c.interval_s, c.rank as f64],
            Choice::Nearest => [c.rank as f64, 0.0, 0.0],
            Choice::Accuracy => [c.accuracy, c.rank as f64, 0.0],
        };
        // Numbers, or not comparable: a NaN precedes nothing.
        key(a).partial_cmp(&key(b)) == Some(core::cmp::Ordering::Less)
    }

    /// Takes the energy of a plan that is carried out, and puts its sensor in charge.
    pub fn settle(&mut self, plan: &Plan) {
        let Some(Candidate { sensor, energy_mj, .. }) = plan.chosen else { return };
        let from = self.task;
        let alone = self.radio.free_self && from == sensor;
        let sent_mj = if alone { 0.0 } else { self.send_mj(from, sensor) };
        let own_mj = self.radio.sense_mj() + if alone { 0.0 } else { self.radio.receive_mj() };
        self.spent_mj += energy_mj;
        let sensors = self.sensors.as_mut();
        sensors[from].residual_mj -= sent_mj;
        sensors[sensor].residual_mj -= own_mj;
        self.task = sensor;
    }

    /// The nearest sensors for which `ready` holds, at most as many as a group has, the nearest first and of equals the first.
    fn nearest(&self, to_m: [f64; 2], ready: impl Fn(usize) -> bool) -> ([usize; MOST_AWAKE], usize) {
        let mut best = [(f64::INFINITY, 0_usize); MOST_AWAKE];
        let mut count = 0;
        for (i, sensor) in self.sensors().iter().enumerate().filter(|(i, _)| ready(*i)) {
            let [dx, dy] = [sensor.position_m[0] - to_m[0], sensor.position_m[1] - to_m[1]];
            let distance = dx * dx + dy * dy;
            let place = best[..count].partition_point(|(other, _)| *other <= distance);
            if place < self.size {
                count = (count + 1).min(self.size);
                best[place..count].rotate_right(1);
                best[place] = (distance, i);
            }
        }
        (best.map(|(_, i)| i), count)
    }
}
