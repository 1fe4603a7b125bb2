//! The numbers of a spec that a search can turn.

use fixtrail_track::spec::{DriftSpec, Lasting, ModelSpec, Robust, Spec};

/// Where a number stands; a sensor by its place in the spec.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// `model.noise`, all axes by the same factor.
    Noise,
    /// `model.turn_noise`.
    TurnNoise,
    /// `model.speed_mps`, all axes by the same factor.
    Speed,
    /// `sensor.sd`.
    Sd(usize),
    /// `sensor.drift.sd`.
    DriftSd(usize),
    /// `sensor.drift.time_s`.
    DriftTime(usize),
    /// `sensor.drift.shared_sd`.
    SharedSd(usize),
    /// `sensor.drift.shared_time_s`.
    SharedTime(usize),
    /// `sensor.threshold` or `sensor.gate`.
    Threshold(usize),
}

/// A spec on the way, and by how much each sensor's times have been moved since its packets were read.
#[derive(Clone, Debug)]
pub struct Setting {
    /// The spec; its `latency_s` are those the packets were read with.
    pub spec: Spec,
    /// Seconds subtracted from the times of each sensor's packets on top.
    pub shift_s: Vec<f64>,
}

impl Place {
    /// All that a search by the causal trail can turn: a latency would make up for the delay of the filter itself.
    pub fn all(spec: &Spec) -> Vec<Place> {
        let mut out = match &spec.model {
            ModelSpec::Kinematic(_) => vec![Place::Noise],
            ModelSpec::Turn(_) => vec![Place::Noise, Place::TurnNoise],
            ModelSpec::GaussMarkov(_) => vec![Place::Speed],
            ModelSpec::Linear(_) => Vec::new(),
        };
        for (i, sensor) in spec.sensors.iter().enumerate() {
            out.push(Place::Sd(i));
            if sensor.drift.is_some_and(|d| d.each.is_some()) {
                out.extend([Place::DriftSd(i), Place::DriftTime(i)]);
            }
            if sensor.drift.is_some_and(|d| d.shared.is_some()) {
                out.extend([Place::SharedSd(i), Place::SharedTime(i)]);
            }
            if sensor.robust != Robust::None {
                out.push(Place::Threshold(i));
            }
        }
        out
    }

    /// The number as it stands, and the least and the largest it may become.
    pub fn get(self, setting: &Setting) -> (f64, [f64; 2]) {
        let sensor = |i: usize| &setting.spec.sensors[i];
        let first = |of: &[f64]| of.first().copied().unwrap_or(0.0);
        match (self, &setting.spec.model) {
            (Place::Noise, ModelSpec::Kinematic(m)) => (first(&m.noise), [1e-9, 1e9]),
            (Place::Noise, ModelSpec::Turn(m)) => (m.noise[0], [1e-9, 1e9]),
            (Place::TurnNoise, ModelSpec::Turn(m)) => (m.turn_noise, [1e-9, 1e3]),
            (Place::Speed, ModelSpec::GaussMarkov(m)) => {
                // A target that crosses its place in less than some samples, or hardly ever, is described by something else.
                let spread = m.spread_m.iter().copied().fold(0.0, f64::max);
                (first(&m.speed_mps), [1e-3 * spread, 2.0 * spread])
            }
            (Place::Noise | Place::TurnNoise | Place::Speed, _) => (0.0, [0.0, 0.0]),
            (Place::Sd(i), _) => (sensor(i).sd, [1e-6, 1e6]),
            (Place::DriftSd(i) | Place::DriftTime(i) | Place::SharedSd(i) | Place::SharedTime(i), _) => {
                let lasting = sensor(i).drift.and_then(|mut drift| self.lasting(&mut drift).copied());
                match self {
                    Place::DriftSd(_) | Place::SharedSd(_) => (lasting.map_or(0.0, |l| l.sd), [1e-6, 1e6]),
                    _ => (lasting.map_or(0.0, |l| l.time_s), [0.1, 1e4]),
                }
            }
            (Place::Threshold(i), _) => match sensor(i).robust {
                Robust::None => (0.0, [0.0, 0.0]),
                Robust::Gate(gate) => (gate, [4.0, 100.0]),
                Robust::Huber(c) => (c, [0.5, 5.0]),
                Robust::Redescending(c) => (c, [2.5, 15.0]),
            },
        }
    }

    /// The setting with the number moved by the factor `step`, up or down, inside its limits. `None` when it would not change.
    pub fn moved(self, setting: &Setting, step: f64, up: bool) -> Option<Setting> {
        let (now, [least, most]) = self.get(setting);
        // A noise of 0 has no larger multiple.
        let next = if up { now.max(least) * step } else { now / step };
        let next = next.clamp(least, most);
        (next != now).then(|| self.set(setting, next))
    }

    fn set(self, setting: &Setting, value: f64) -> Setting {
        let mut out = setting.clone();
        let scale = |of: &mut [f64]| {
            let by = value / of.first().copied().unwrap_or(1.0);
            for v in of {
                *v = if by.is_finite() { *v * by } else { value };
            }
        };
        match (self, &mut out.spec.model) {
            (Place::Noise, ModelSpec::Kinematic(m)) => scale(&mut m.noise),
            (Place::Noise, ModelSpec::Turn(m)) => scale(&mut m.noise),
            (Place::TurnNoise, ModelSpec::Turn(m)) => m.turn_noise = value,
            (Place::Speed, ModelSpec::GaussMarkov(m)) => scale(&mut m.speed_mps),
            (Place::Noise | Place::TurnNoise | Place::Speed, _) => {}
            (Place::Sd(i), _) => out.spec.sensors[i].sd = value,
            (Place::DriftSd(i) | Place::DriftTime(i) | Place::SharedSd(i) | Place::SharedTime(i), _) => {
                let lasting = out.spec.sensors[i].drift.as_mut().and_then(|drift| self.lasting(drift));
                match (self, lasting) {
                    (Place::DriftSd(_) | Place::SharedSd(_), Some(lasting)) => lasting.sd = value,
                    (_, Some(lasting)) => lasting.time_s = value,
                    (_, None) => {}
                }
            }
            (Place::Threshold(i), _) => {
                let sensor = &mut out.spec.sensors[i];
                sensor.robust = match sensor.robust {
                    Robust::None => Robust::None,
                    Robust::Gate(_) => Robust::Gate(value),
                    Robust::Huber(_) => Robust::Huber(value),
                    Robust::Redescending(_) => Robust::Redescending(value),
                };
            }
        }
        out
    }

    /// The error that the number belongs to.
    fn lasting(self, drift: &mut DriftSpec) -> Option<&mut Lasting> {
        match self {
            Place::DriftSd(_) | Place::DriftTime(_) => drift.each.as_mut(),
            Place::SharedSd(_) | Place::SharedTime(_) => drift.shared.as_mut(),
            _ => None,
        }
    }

    /// The step that a search begins with.
    pub fn first_step(self) -> f64 {
        match self {
            Place::Noise | Place::TurnNoise => 16.0,
            Place::Speed | Place::DriftTime(_) | Place::SharedTime(_) => 3.0,
            Place::Sd(_) | Place::DriftSd(_) | Place::SharedSd(_) => 2.0,
            Place::Threshold(_) => 1.5,
        }
    }
}
