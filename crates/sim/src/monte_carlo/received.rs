//! What a receiver has and shows at each instant.

use crate::channels::Channel;
use fixtrail_track::spec::Shows;
use rand::Rng;

/// Arrivals of a run, instant by instant. Row 0 is the start: its measurement has come and is used.
#[derive(Clone, Debug, PartialEq)]
pub struct Reception {
    /// What arrived from one instant to the next, in order of arrival; copies included.
    pub arrived: Vec<Vec<Arrival>>,
    /// Whether the measurement of each instant arrived before the next one.
    pub in_time: Vec<bool>,
}

/// One copy that arrived.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Arrival {
    /// The instant at which it was sensed.
    pub sensed: usize,
    /// When it arrived, seconds.
    pub at_s: f64,
}

/// Sends one packet at each of `count` instants `interval_s` apart.
pub fn receive(channel: &mut dyn Channel, count: usize, interval_s: f64, rng: &mut dyn Rng) -> Reception {
    let mut all: Vec<Arrival> = Vec::new();
    for sensed in 1..count {
        let arrivals = channel.transmit(rng);
        let at_s = |delay_s: &f64| sensed as f64 * interval_s + delay_s;
        all.extend(arrivals.delays_s().iter().map(|delay_s| Arrival { sensed, at_s: at_s(delay_s) }));
    }
    all.sort_by(|a, b| a.at_s.total_cmp(&b.at_s).then(a.sensed.cmp(&b.sensed)));
    let mut reception = Reception { arrived: vec![Vec::new(); count], in_time: vec![false; count] };
    reception.in_time[0] = true;
    for arrival in all {
        // A delay of whole intervals is a quotient of decimal numbers.
        let k = (arrival.at_s / interval_s + 1e-9).floor() as usize;
        if k < count {
            reception.arrived[k].push(arrival);
            reception.in_time[arrival.sensed] |= k == arrival.sensed;
        }
    }
    reception
}

/// What is shown at an instant without being told when it was sensed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shown {
    /// The measurement of an instant.
    Sensed(usize),
    /// 0.
    Zero,
}

impl Reception {
    /// What a receiver shows at each instant.
    pub fn shown(&self, shows: Shows) -> Vec<Shown> {
        let mut last = 0;
        (0..self.in_time.len())
            .map(|k| {
                last = self.arrived[k].last().map_or(last, |arrival| arrival.sensed);
                match shows {
                    _ if k == 0 => Shown::Sensed(0),
                    Shows::LastReceived => Shown::Sensed(last),
                    _ if self.in_time[k] => Shown::Sensed(k),
                    Shows::Zero => Shown::Zero,
                    _ if self.in_time[k - 1] => Shown::Sensed(k - 1),
                    Shows::Model1 => Shown::Zero,
                    Shows::Paper => Shown::Sensed(k - 2),
                }
            })
            .collect()
    }
}
