//! The scheduler against the decision written out in full.

mod splitmix;

use fixtrail_core::schedule::{
    Battery, Candidate, Choice, DesignError, Foresight, MOST_AWAKE, Mode, Policy, Radio, Scheduler,
};
use splitmix::Random;

/// A target that moves on a line and becomes uncertain with time, less so the nearer the sensor.
#[derive(Clone)]
struct Line<'a> {
    at_m: [f64; 2],
    velocity: [f64; 2],
    sensors: &'a [Battery],
    fails: bool,
}

impl Foresight for Line<'_> {
    type Error = &'static str;

    fn position_m(&mut self, interval_s: f64) -> Result<[f64; 2], &'static str> {
        Ok([0, 1].map(|i| self.at_m[i] + interval_s * self.velocity[i]))
    }

    fn accuracy(&mut self, interval_s: f64, sensor: usize) -> Result<f64, &'static str> {
        if self.fails {
            return Err("no forecast");
        }
        let at = self.position_m(interval_s)?;
        // In steps, so that ties happen.
        Ok((interval_s * (4.0 + self.sensors[sensor].distance_m(at) / 10.0)).ceil())
    }
}

fn field(random: &mut Random, count: usize, residual_mj: f64) -> Vec<Battery> {
    (0..count)
        .map(|_| Battery { position_m: [100.0 * random.unit(), 100.0 * random.unit()], residual_mj, alive: true })
        .collect()
}

/// The decision as `notes` of the paper has it, with lists and sorts.
struct Written {
    group: Vec<usize>,
    task: usize,
    sensors: Vec<Battery>,
    radio: Radio,
}

impl Written {
    fn send(&self, i: usize, j: usize) -> f64 {
        let d = self.sensors[i].distance_m(self.sensors[j].position_m);
        (self.radio.send_mj_per_bit + self.radio.amplify_mj_per_bit * d.powf(self.radio.path_exponent))
            * self.radio.sent_bits
    }

    fn usable(&self, i: usize) -> bool {
        let n = self.sensors.len();
        let farthest =
            (0..n).flat_map(|a| (0..n).map(move |b| (a, b))).map(|(a, b)| self.send(a, b)).fold(0.0, f64::max);
        let own =
            self.radio.sense_mj_per_bit * self.radio.sensed_bits + self.radio.receive_mj_per_bit * self.radio.sent_bits;
        self.sensors[i].alive && self.sensors[i].residual_mj >= own + farthest
    }

    fn energy(&self, j: usize) -> f64 {
        let sense = self.radio.sense_mj_per_bit * self.radio.sensed_bits;
        if self.radio.free_self && self.task == j {
            return sense;
        }
        let sent = if self.usable(self.task) { self.send(self.task, j) } else { 0.0 };
        sense + self.radio.receive_mj_per_bit * self.radio.sent_bits + sent
    }

    /// Mode, interval and sensor.
    fn decide(&mut self, policy: &Policy<'_>, foresight: &mut Line<'_>) -> (Mode, f64, Option<usize>) {
        let here = foresight.at_m;
        let mut near: Vec<usize> = (0..self.sensors.len()).filter(|i| self.usable(*i)).collect();
        near.sort_by(|a, b| {
            self.sensors[*a].distance_m(here).total_cmp(&self.sensors[*b].distance_m(here)).then(a.cmp(b))
        });
        near.truncate(policy.group);
        let stale = self.group.is_empty()
            || self.group.iter().any(|i| !self.usable(*i))
            || near.first().is_none_or(|first| !self.group.contains(first));
        if stale {
            self.group = near;
        }
        let mut all: Vec<Candidate> = Vec::new();
        for interval_s in policy.intervals_s {
            let then = foresight.position_m(*interval_s).unwrap();
            for (rank, sensor) in self.group.iter().copied().enumerate() {
                if self.sensors[sensor].distance_m(then) > policy.range_m {
                    continue;
                }
                let accuracy = foresight.accuracy(*interval_s, sensor).unwrap();
                let energy_mj = self.energy(sensor);
                all.push(Candidate { interval_s: *interval_s, rank, sensor, accuracy, energy_mj });
            }
        }
        let shortest = policy.intervals_s[0];
        let short = all.iter().filter(|c| c.interval_s == shortest);
        let best = match policy.choice {
            Choice::Nearest => short.min_by_key(|c| c.rank).map(|c| (Mode::Satisfied, c)),
            Choice::Accuracy => short
                .min_by(|a, b| a.accuracy.total_cmp(&b.accuracy).then(a.rank.cmp(&b.rank)))
                .map(|c| (Mode::Satisfied, c)),
            Choice::Cost { enough, weight } => {
                let per = |c: &Candidate| c.energy_mj / c.interval_s;
                let satisfied = all.iter().filter(|c| c.accuracy <= enough).min_by(|a, b| {
                    per(a).total_cmp(&per(b)).then(b.interval_s.total_cmp(&a.interval_s)).then(a.rank.cmp(&b.rank))
                });
                let cost = |c: &Candidate| weight * c.accuracy + (1.0 - weight) * per(c);
                let weighed = short.min_by(|a, b| cost(a).total_cmp(&cost(b)).then(a.rank.cmp(&b.rank)));
                satisfied.map(|c| (Mode::Satisfied, c)).or(weighed.map(|c| (Mode::Weighed, c)))
            }
        };
        let Some((mode, best)) = best else {
            self.group.clear();
            return (Mode::Coasting, shortest, None);
        };
        let (sensor, energy_mj) = (best.sensor, best.energy_mj);
        let sense = self.radio.sense_mj();
        if self.radio.free_self && sensor == self.task {
            self.sensors[sensor].residual_mj -= sense;
        } else {
            let sent = if self.usable(self.task) { self.send(self.task, sensor) } else { 0.0 };
            assert!((energy_mj - sense - self.radio.receive_mj() - sent).abs() < 1e-15);
            self.sensors[self.task].residual_mj -= sent;
            self.sensors[sensor].residual_mj -= sense + self.radio.receive_mj();
        }
        self.task = sensor;
        (mode, best.interval_s, Some(sensor))
    }
}

#[test]
fn every_decision_is_the_one_written_out() {
    let mut random = Random(7);
    let mut modes = [0; 3];
    for case in 0..300 {
        let sensors = field(&mut random, 3 + case % 18, if case % 3 == 0 { f64::INFINITY } else { 2.0 });
        let choices = [
            // Often just what a candidate reaches.
            Choice::Cost { enough: 1.0 + (2.5 * random.unit()).floor(), weight: random.unit() },
            Choice::Nearest,
            Choice::Accuracy,
        ];
        let intervals = [0.1, 0.2, 0.3, 0.4, 0.5];
        let policy = Policy {
            choice: choices[(case / 3) % 3],
            intervals_s: if case % 2 == 0 { &intervals } else { &intervals[2..3] },
            group: 1 + case % 3,
            range_m: if case % 5 == 0 { 25.0 } else { 1e9 },
        };
        // Energy that costs nothing makes all choices alike, but for the interval and the distance.
        let bits = if case % 7 == 0 { 0.0 } else { 1024.0 };
        let radio = Radio { free_self: case % 2 == 1, sensed_bits: bits, sent_bits: bits, ..Radio::default() };
        let start = [30.0, 70.0];
        let mut ours = Scheduler::new(sensors.clone(), radio, &policy, start).unwrap();
        let mut written = Written { group: Vec::new(), task: ours.task(), sensors: sensors.clone(), radio };
        let mut line = Line { at_m: start, velocity: [20.0, -15.0], sensors: &sensors, fails: false };
        for k in 0..25 {
            if k % 7 == 3 {
                let dead = (random.unit() * sensors.len() as f64) as usize;
                ours.fail(dead);
                written.sensors[dead].alive = false;
            }
            let plan = ours.plan(line.at_m, &mut line.clone(), |_| ()).unwrap();
            ours.settle(&plan);
            let (mode, interval_s, sensor) = written.decide(&policy, &mut line.clone());
            let found = (plan.mode, plan.interval_s, plan.chosen.map(|c| c.sensor));
            assert_eq!(found, (mode, interval_s, sensor), "case {case}, decision {k}");
            assert_eq!(ours.group(), &written.group[..], "case {case}, decision {k}");
            assert_eq!(ours.task(), written.task);
            for (a, b) in ours.sensors().iter().zip(&written.sensors) {
                assert!(a.residual_mj == b.residual_mj || (a.residual_mj - b.residual_mj).abs() < 1e-12);
            }
            modes[mode as usize] += 1;
            line.at_m = line.position_m(interval_s).unwrap();
            // Back and forth, so that the target stays in the field.
            if !(0.0..=100.0).contains(&line.at_m[0]) || !(0.0..=100.0).contains(&line.at_m[1]) {
                line.velocity = line.velocity.map(|v| -v);
            }
        }
    }
    assert!(modes.iter().all(|count| *count > 100), "every mode was met: {modes:?}");
}

#[test]
fn spent_energy_is_what_the_batteries_lost() {
    let mut random = Random(3);
    let sensors = field(&mut random, 12, 5.0);
    let policy = Policy {
        choice: Choice::Cost { enough: 2.0, weight: 0.7 },
        intervals_s: &[0.1, 0.2, 0.3],
        group: 4,
        range_m: f64::INFINITY,
    };
    let mut scheduler = Scheduler::new(sensors.clone(), Radio::default(), &policy, [50.0, 50.0]).unwrap();
    let mut line = Line { at_m: [50.0, 50.0], velocity: [15.0, 5.0], sensors: &sensors, fails: false };
    for _ in 0..20 {
        let plan = scheduler.plan(line.at_m, &mut line.clone(), |_| ()).unwrap();
        scheduler.settle(&plan);
        line.at_m = line.position_m(plan.interval_s).unwrap();
    }
    let lost: f64 = scheduler.sensors().iter().map(|s| 5.0 - s.residual_mj).sum();
    assert!(scheduler.spent_mj() > 1.0 && (lost - scheduler.spent_mj()).abs() < 1e-12, "{lost}");
}

#[test]
fn a_forecast_that_fails_changes_nothing() {
    let mut random = Random(1);
    let sensors = field(&mut random, 6, f64::INFINITY);
    let policy = Policy { choice: Choice::Accuracy, intervals_s: &[1.0], group: 3, range_m: f64::INFINITY };
    let mut scheduler = Scheduler::new(sensors.clone(), Radio::default(), &policy, [0.0, 0.0]).unwrap();
    let before = scheduler.clone();
    let mut line = Line { at_m: [90.0, 90.0], velocity: [0.0; 2], sensors: &sensors, fails: true };
    assert_eq!(scheduler.plan([90.0, 90.0], &mut line, |_| ()), Err("no forecast"));
    assert_eq!(scheduler, before);
}

#[test]
fn a_place_that_is_no_number_is_out_of_range() {
    let mut random = Random(2);
    let sensors = field(&mut random, 6, f64::INFINITY);
    let policy = Policy { choice: Choice::Nearest, intervals_s: &[0.5, 1.0], group: 1, range_m: f64::INFINITY };
    let mut scheduler = Scheduler::new(sensors.clone(), Radio::default(), &policy, [0.0, 0.0]).unwrap();
    let mut line = Line { at_m: [f64::NAN; 2], velocity: [0.0; 2], sensors: &sensors, fails: false };
    let plan = scheduler.plan([f64::NAN; 2], &mut line, |_| ()).unwrap();
    assert_eq!((plan.mode, plan.chosen, plan.interval_s), (Mode::Coasting, None, 0.5));
    scheduler.settle(&plan);
    assert_eq!(scheduler.spent_mj(), 0.0);
}

#[test]
fn schedules_that_cannot_be_are_refused() {
    let mut random = Random(5);
    let sensors = field(&mut random, 4, f64::INFINITY);
    let good = Policy { choice: Choice::Nearest, intervals_s: &[0.1, 0.2], group: 2, range_m: 10.0 };
    let made = |sensors: &[Battery], radio: Radio, policy: &Policy<'_>| {
        Scheduler::new(sensors.to_vec(), radio, policy, [0.0; 2]).map(|_| ()).unwrap_err()
    };
    let radio = Radio::default();
    assert_eq!(made(&[], radio, &good), DesignError::NoSensor);
    assert_eq!(made(&sensors, radio, &Policy { group: 0, ..good }), DesignError::Group { group: 0, most: 4 });
    assert_eq!(made(&sensors, radio, &Policy { group: 5, ..good }), DesignError::Group { group: 5, most: 4 });
    let many = field(&mut random, MOST_AWAKE + 1, f64::INFINITY);
    let all = Policy { group: MOST_AWAKE + 1, ..good };
    assert_eq!(made(&many, radio, &all), DesignError::Group { group: MOST_AWAKE + 1, most: MOST_AWAKE });
    for intervals_s in [&[][..], &[0.2, 0.1], &[0.1, 0.1], &[-1.0], &[0.0, 1.0], &[f64::NAN], &[1.0; 17]] {
        assert_eq!(made(&sensors, radio, &Policy { intervals_s, ..good }), DesignError::Intervals, "{intervals_s:?}");
    }
    let heavy = Choice::Cost { enough: 1.0, weight: 1.5 };
    assert_eq!(made(&sensors, radio, &Policy { choice: heavy, ..good }), DesignError::Weight { weight: 1.5 });
    let negative = Radio { sent_bits: -1.0, ..radio };
    assert_eq!(made(&sensors, negative, &good), DesignError::Energy { name: "sent_bits", value: -1.0 });
}

#[test]
fn the_first_order_radio_costs_what_its_constants_say() {
    let radio = Radio::default();
    // 1024 bits: 50 nJ/bit sensed, 135 nJ/bit received, 45 nJ/bit and 10 pJ/bit/m² sent.
    assert!((radio.sense_mj() - 0.0512).abs() < 1e-15);
    assert!((radio.receive_mj() - 0.13824).abs() < 1e-15);
    assert!((radio.send_mj(100.0) - (0.04608 + 0.1024)).abs() < 1e-15);
}
