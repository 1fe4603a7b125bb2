//! Rates of arrival learned from losses and from repeats, against every sequence of arrivals.

mod oracle;

use fixtrail_core::arrival::{Counted, Repeated};
use fixtrail_core::estimators::augmented::Hold;
use oracle::random::Random;

const HOLDS: [Hold; 2] = [Hold::Paper, Hold::LastReceived];

/// The instant that each value is from; z_0 came, and so did the one before.
fn sources(came: &[bool], hold: Hold) -> Vec<i64> {
    let mut out = vec![0];
    for k in 1..=came.len() as i64 {
        let at = |k: i64| k <= 0 || came[k as usize - 1];
        out.push(match (at(k), hold) {
            (true, _) => k,
            (false, Hold::Paper) => {
                if at(k - 1) {
                    k - 1
                } else {
                    k - 2
                }
            }
            (false, Hold::LastReceived) => out[k as usize - 1],
        });
    }
    out
}

fn repeats(came: &[bool], hold: Hold) -> Vec<bool> {
    sources(came, hold).windows(2).map(|w| w[0] == w[1]).collect()
}

/// The rates told apart, and the mean under weights proportional to `density`.
fn mean(density: impl Fn(f64) -> f64) -> f64 {
    let rates = (0..100).map(|i| (f64::from(i) + 0.5) / 100.0);
    let weights: Vec<f64> = rates.clone().map(&density).collect();
    rates.zip(&weights).map(|(p, w)| p * w).sum::<f64>() / weights.iter().sum::<f64>()
}

#[test]
fn posterior_given_repeats_equals_the_sum_over_all_arrivals() {
    let mut worst: f64 = 0.0;
    for hold in HOLDS {
        for len in 1..=10 {
            // Number of sequences of arrivals per pattern of repeats and number of arrivals.
            let mut counts = vec![[0_u32; 11]; 1 << len];
            for bits in 0..1_usize << len {
                let came: Vec<bool> = (0..len).map(|i| bits >> i & 1 == 1).collect();
                let pattern = repeats(&came, hold).iter().rev().fold(0, |sum, r| 2 * sum + usize::from(*r));
                counts[pattern][bits.count_ones() as usize] += 1;
            }
            let mut possible = 0;
            for (pattern, counts) in counts.iter().enumerate().filter(|(_, c)| c.iter().any(|c| *c > 0)) {
                possible += 1;
                let density = |p: f64| {
                    let term = |ones: usize| p.powi(ones as i32) * (1.0 - p).powi((len - ones) as i32);
                    counts
                        .iter()
                        .enumerate()
                        .map(|(ones, c)| f64::from(*c) * if *c > 0 { term(ones) } else { 0.0 })
                        .sum()
                };
                let mut learned = Repeated::start(hold);
                (0..len).for_each(|i| learned.observe(pattern >> i & 1 == 1));
                worst = worst.max((learned.mean() - mean(density)).abs());
            }
            // Everything may happen where values are kept; the paper's never repeat three times in a row.
            assert_eq!(possible == 1 << len, hold == Hold::LastReceived || len < 3, "{possible} of {len}");
        }
    }
    println!("{worst:e}");
    // 100 terms of rounding. One sequence more or less of 1024 moves a mean by more than 1e-5.
    assert!(worst < 1e-13, "{worst:e}");
}

#[test]
fn an_impossible_repeat_is_not_taken_in() {
    let mut learned = Repeated::start(Hold::Paper);
    learned.observe(true);
    learned.observe(true);
    let before = learned;
    // z_0 may stand for instants 1 and 2; instant 3 shows z_1 at the oldest.
    learned.observe(true);
    assert_eq!(learned, before);
}

/// Posterior mean and standard deviation from repeats, on a fine grid; arrivals as a hidden Markov chain by their last four.
fn fine(pattern: &[bool], hold: Hold) -> (f64, f64) {
    let rates: Vec<f64> = (0..500).map(|i| (f64::from(i) + 0.5) / 500.0).collect();
    let mut logs = Vec::new();
    for p in &rates {
        // Index: the last four arrivals, newest in bit 0. All came before the start.
        let mut state = [0.0; 16];
        state[15] = 1.0;
        let mut log = 0.0;
        for seen in pattern {
            let mut next = [0.0; 16];
            for (from, density) in state.iter().enumerate().filter(|(_, d)| **d > 0.0) {
                for came in [0, 1] {
                    let to = (2 * from + came) & 15;
                    let at = |age: usize| to >> age & 1 == 1;
                    // Ages of what is shown now and of what was shown before, now.
                    let age = |first: usize| {
                        let shown = if at(first) {
                            0
                        } else if at(first + 1) {
                            1
                        } else {
                            2
                        };
                        first + shown
                    };
                    let same = match hold {
                        Hold::Paper => age(0) == age(1),
                        Hold::LastReceived => !at(0),
                    };
                    if same == *seen {
                        next[to] += density * if came == 1 { *p } else { 1.0 - p };
                    }
                }
            }
            let total: f64 = next.iter().sum();
            log += total.ln();
            state = next.map(|d| d / total);
        }
        logs.push(log);
    }
    let top = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let weights: Vec<f64> = logs.iter().map(|l| (l - top).exp()).collect();
    let total: f64 = weights.iter().sum();
    let moment = |k: i32| rates.iter().zip(&weights).map(|(p, w)| p.powi(k) * w).sum::<f64>() / total;
    (moment(1), (moment(2) - moment(1).powi(2)).sqrt())
}

#[test]
fn rate_learned_over_20000_instants_converges_to_the_true_one() {
    let mut rng = Random::new(1);
    for hold in HOLDS {
        for p in [0.3, 0.5, 0.9] {
            let came: Vec<bool> = (0..20_000).map(|_| rng.chance(p)).collect();
            let pattern = repeats(&came, hold);
            let mut learned = Repeated::start(hold);
            pattern.iter().for_each(|r| learned.observe(*r));
            let (mean, sd) = fine(&pattern, hold);
            println!("{hold:?} {p}: {} {mean} ± {sd}", learned.mean());
            // At most 0.006, so that 4 of them are below the bias of counting every change as an arrival, (1−p)³, at p = 0.5 and less.
            assert!(sd < 0.006, "{sd}");
            assert!((mean - p).abs() < 4.0 * sd, "{mean} ± {sd} against {p}");
            // Its grid adds half a cell.
            assert!((learned.mean() - p).abs() < 4.0 * sd + 0.005, "{} ± {sd} against {p}", learned.mean());
        }
    }
}

#[test]
fn counted_rate_is_the_mean_of_the_beta_posterior() {
    // The integral of p^(1+came) (1−p)^lost over that of p^came (1−p)^lost, by the midpoint rule.
    for (came, lost) in [(0, 0), (3, 0), (0, 5), (7, 2), (40, 13)] {
        let mut counted = Counted::default();
        counted.count(came / 2, lost);
        counted.count(came - came / 2, 0);
        let parts = 100_000;
        let density = |p: f64| p.powi(came as i32) * (1.0 - p).powi(lost as i32);
        let rates = (0..parts).map(|i| (f64::from(i) + 0.5) / f64::from(parts));
        let (above, below) = rates.fold((0.0, 0.0), |(above, below), p| (above + p * density(p), below + density(p)));
        // The rule's relative error is below (53/parts)² = 3e-7; a count that is off by one moves the mean by 0.4 % at least.
        assert!((counted.mean() - above / below).abs() < 1e-6, "{came} {lost}");
    }
}
