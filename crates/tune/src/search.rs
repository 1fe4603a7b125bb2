//! Compass search (Kolda, Lewis & Torczon 2003): one number at a time, up and down, with steps that shrink where nothing is gained.

use crate::knobs::{Place, Setting};
use crate::merit::{Merit, Recording, merit};

/// Least gain in the score that counts: less is chance.
const LEAST_GAIN: f64 = 1e-4;
/// Most steps in one direction before the next number has its turn.
const MOST_IN_A_ROW: usize = 4;

/// How long to search.
#[derive(Clone, Copy, Debug)]
pub struct Effort {
    /// How often the steps are shrunk to their square root.
    pub shrinks: usize,
    /// Most rounds over all numbers.
    pub rounds: usize,
}

/// A setting and its merit.
#[derive(Clone, Debug)]
pub struct Candidate {
    /// The setting.
    pub setting: Setting,
    /// Its merit.
    pub merit: Merit,
}

impl Candidate {
    /// The setting with its merit on `recordings`.
    pub fn of(setting: Setting, recordings: &[Recording]) -> Self {
        let merit = merit(&setting.spec, recordings, &setting.shift_s);
        Self { setting, merit }
    }
}

/// The best setting that a search from `start` over `places` finds; `tried` is told of every merit that was computed.
pub fn search(
    start: Candidate,
    places: &[Place],
    recordings: &[Recording],
    effort: Effort,
    tried: &(dyn Fn(u64) + Sync),
) -> Candidate {
    let mut best = start;
    let mut shrunk = vec![0; places.len()];
    for _ in 0..effort.rounds {
        let mut gained = false;
        for (place, shrunk) in places.iter().zip(&mut shrunk) {
            if *shrunk > effort.shrinks {
                continue;
            }
            let step = step(*place, *shrunk);
            if climb(&mut best, *place, step, recordings, tried) {
                gained = true;
            } else {
                *shrunk += 1;
            }
        }
        if !gained && shrunk.iter().all(|s| *s > effort.shrinks) {
            break;
        }
    }
    best
}

fn step(place: Place, shrunk: usize) -> f64 {
    place.first_step().powf(0.5f64.powi(i32::try_from(shrunk).unwrap_or(i32::MAX)))
}

/// Moves one number as long as that gains; whether it did.
fn climb(
    best: &mut Candidate,
    place: Place,
    step: f64,
    recordings: &[Recording],
    tried: &(dyn Fn(u64) + Sync),
) -> bool {
    let attempt = |up: bool| {
        let found = place.moved(&best.setting, step, up).map(|setting| Candidate::of(setting, recordings));
        tried(1);
        found
    };
    // Both ways at once; the better one, so that the result does not depend on the threads.
    let (up, down) = rayon::join(|| attempt(true), || attempt(false));
    let score = |c: &Option<Candidate>| c.as_ref().map_or(f64::NEG_INFINITY, |c| c.merit.score);
    let is_up = score(&up) >= score(&down);
    let mut next = if is_up { up } else { down };
    let mut gained = false;
    for _ in 0..MOST_IN_A_ROW {
        let Some(candidate) = next.filter(|c| c.merit.score > best.merit.score + LEAST_GAIN) else { break };
        gained = true;
        *best = candidate;
        next = place.moved(&best.setting, step, is_up).map(|setting| Candidate::of(setting, recordings));
        tried(1);
    }
    gained
}

/// What a number's half and double would lose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Profile {
    /// The number.
    pub place: Place,
    /// Loss of the score at the smaller and the larger value; `None` where there is no such value.
    pub loss: [Option<f64>; 2],
}

/// The profile of every number around the best.
pub fn profiles(
    best: &Candidate,
    places: &[Place],
    recordings: &[Recording],
    tried: &(dyn Fn(u64) + Sync),
) -> Vec<Profile> {
    let one = |place: &Place| {
        let loss = |up: bool| {
            let there = place.moved(&best.setting, 2.0, up).map(|setting| Candidate::of(setting, recordings));
            tried(1);
            there.map(|c| best.merit.score - c.merit.score)
        };
        Profile { place: *place, loss: [loss(false), loss(true)] }
    };
    places.iter().map(one).collect()
}
