//! The demo: a person walks through a hall, a bursty network loses a quarter of the reports.

use crate::channels::{Channel, GilbertElliott};
use fixtrail_track::anchors::Anchors;
use fixtrail_track::packet::{Content, Packet};
use fixtrail_track::survey::Loss;
use fixtrail_track::target::TargetPackets;
use fixtrail_track::truth::{TargetTruth, TruthPoint};
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

/// Length of the walk, seconds.
pub const DURATION_S: f64 = 120.0;
/// Interval between two rounds of ranging, seconds.
pub const ROUND_S: f64 = 0.2;
/// Standard deviation of a range, metres.
pub const RANGE_SD_M: f64 = 0.15;
/// Height at which the tag is carried, metres.
pub const TAG_HEIGHT_M: f64 = 1.0;
/// Fraction of the reports that the network loses.
pub const LOSS_RATE: f64 = 0.25;
/// Mean number of reports lost in a row.
pub const MEAN_BURST: f64 = 5.0;

const TARGET: &str = "walker";
const TRUTH_PER_S: usize = 10;
/// Steps of the simulated walk between two truth points.
const SUBSTEPS: usize = 10;

/// Anchors on the walls of a 20 m × 12 m hall.
const ANCHORS: [(&str, [f64; 3]); 6] = [
    ("A1", [0.0, 0.0, 2.4]),
    ("A2", [10.0, 0.0, 3.0]),
    ("A3", [20.0, 0.0, 2.4]),
    ("A4", [20.0, 12.0, 2.8]),
    ("A5", [10.0, 12.0, 2.2]),
    ("A6", [0.0, 12.0, 2.8]),
];

/// Where the walker goes: x and y in metres, and how long he stops there, seconds.
const WAYPOINTS: [[f64; 3]; 12] = [
    [17.0, 2.5, 0.0],
    [18.0, 6.0, 3.0],
    [16.5, 9.5, 0.0],
    [11.0, 10.0, 0.0],
    [10.0, 6.5, 0.0],
    [5.5, 5.5, 0.0],
    [3.0, 9.5, 4.0],
    [1.8, 5.0, 0.0],
    [4.0, 2.0, 0.0],
    [9.0, 3.5, 2.5],
    [13.5, 6.5, 0.0],
    [13.0, 2.0, 0.0],
];

/// A simulated run: what the network delivered and where the walker really was.
#[derive(Clone, Debug, PartialEq)]
pub struct Demo {
    /// The fixed radios.
    pub anchors: Anchors,
    /// Ranges that arrived.
    pub packets: Vec<TargetPackets>,
    /// The walk, ten points a second.
    pub truth: Vec<TargetTruth>,
    /// Fraction of the reports that were lost.
    pub loss_rate: f64,
    /// Largest number of reports lost in a row.
    pub longest_burst: u64,
}

/// The demo of `seed`: equal seeds give equal bytes.
///
/// Every [`ROUND_S`] the tag measures its range to six anchors and sends them in one report; a [`GilbertElliott`] network loses
/// [`LOSS_RATE`] of the reports in bursts of [`MEAN_BURST`] on average.
pub fn demo(seed: u64) -> Demo {
    // One stream per purpose, so that changing the network leaves the walk as it is.
    let stream = |n: u64| Pcg64::new(u128::from(seed), u128::from(n));
    let points = walk(&mut stream(1));
    let mut noise = stream(2);
    let mut network = stream(3);
    #[allow(clippy::expect_used)] // The constants above are a possible channel; a test builds it.
    let mut channel = GilbertElliott::new(LOSS_RATE, MEAN_BURST).expect("the demo's channel exists");

    let mut anchors = Anchors::default();
    let ids: Vec<_> = ANCHORS.iter().filter_map(|(name, position)| anchors.add(name, *position)).collect();
    let mut packets = Vec::new();
    let every = (ROUND_S * TRUTH_PER_S as f64).round() as usize;
    let mut lost = Vec::new();
    for (round, point) in points.iter().step_by(every).enumerate() {
        let ranges: Vec<f64> =
            ids.iter().map(|&id| distance_m(point, anchors.position_m(id)) + RANGE_SD_M * normal(&mut noise)).collect();
        lost.push(channel.transmit(&mut network).is_lost());
        if lost[round] {
            continue;
        }
        for (&anchor, value_m) in ids.iter().zip(ranges) {
            packets.push(Packet {
                seq: Some(round as u64),
                ..Packet::new(point.t_s, Content::Range { anchor, value_m }, packets.len() as u64 + 1)
            });
        }
    }
    let loss = Loss::of(lost);
    Demo {
        anchors,
        packets: vec![TargetPackets { target: Some(TARGET.to_owned()), packets }],
        loss_rate: loss.rate(),
        truth: vec![TargetTruth { target: Some(TARGET.to_owned()), points }],
        longest_burst: loss.longest_burst,
    }
}

fn normal(rng: &mut impl Rng) -> f64 {
    StandardNormal.sample(rng)
}

fn distance_m(point: &TruthPoint, anchor: [f64; 3]) -> f64 {
    point.position_m.iter().zip(anchor).map(|(p, a)| (p.unwrap_or(0.0) - a).powi(2)).sum::<f64>().sqrt()
}

/// A walk along the waypoints, each moved a little by chance: limited acceleration and turn rate, slower in turns.
fn walk(rng: &mut impl Rng) -> Vec<TruthPoint> {
    const CRUISE_M_S: f64 = 1.35;
    const ACCELERATION_M_S2: f64 = 0.8;
    const TURN_RAD_S: f64 = 1.2;
    const REACHED_M: f64 = 0.6;

    let dt_s = 1.0 / (TRUTH_PER_S * SUBSTEPS) as f64;
    let goals = WAYPOINTS.map(|[x, y, stop_s]| {
        [x + rng.random_range(-0.5..0.5), y + rng.random_range(-0.5..0.5), stop_s * rng.random_range(0.7..1.3)]
    });
    let (mut x, mut y, mut heading, mut turn, mut speed) = (2.0, 2.0, 0.0_f64, 0.0_f64, 0.0_f64);
    let (mut goal, mut rest_s) = (0, 1.0);
    let mut points = Vec::new();
    for step in 0..=(DURATION_S * (TRUTH_PER_S * SUBSTEPS) as f64) as usize {
        if step % SUBSTEPS == 0 {
            let t_s = (step / SUBSTEPS) as f64 / TRUTH_PER_S as f64;
            points.push(TruthPoint { t_s, position_m: [Some(x), Some(y), Some(TAG_HEIGHT_M)] });
        }
        let [gx, gy, stop_s] = goals[goal % goals.len()];
        let distance = (gx - x).hypot(gy - y);
        let off = wrapped((gy - y).atan2(gx - x) - heading);
        let mut wanted = CRUISE_M_S * off.cos().max(0.35);
        if stop_s > 0.0 {
            wanted = wanted.min((2.0 * 0.7 * ACCELERATION_M_S2 * (distance - 0.4 * REACHED_M).max(0.0)).sqrt());
        }
        if rest_s > 0.0 {
            rest_s -= dt_s;
            wanted = 0.0;
        } else if distance < REACHED_M && (stop_s == 0.0 || speed < 0.25) {
            rest_s = stop_s;
            goal += 1;
        }
        // First-order lags make the turn rate smooth; the limits make it human.
        turn += ((1.8 * off).clamp(-TURN_RAD_S, TURN_RAD_S) - turn) * (dt_s / 0.25);
        speed += (wanted - speed).clamp(-ACCELERATION_M_S2 * dt_s, ACCELERATION_M_S2 * dt_s);
        heading = wrapped(heading + turn * dt_s * (speed / CRUISE_M_S).min(1.0));
        x += speed * heading.cos() * dt_s;
        y += speed * heading.sin() * dt_s;
    }
    points
}

fn wrapped(angle_rad: f64) -> f64 {
    angle_rad - core::f64::consts::TAU * (angle_rad / core::f64::consts::TAU).round()
}
