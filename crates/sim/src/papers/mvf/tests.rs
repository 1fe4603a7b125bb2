//! Every number against those of an independent implementation, at equal settings.

use super::{linear, losses, schedule};
use crate::papers::{Effort, Entry, Measured};
use std::sync::atomic::{AtomicUsize, Ordering};

const EFFORT: Effort = Effort { runs: None, quick: true, seed: 11 };

/// Standard deviations between ours and another's, of which the standard error is known or as ours from another number of runs.
struct Deviations(Vec<(String, f64)>);

impl Deviations {
    fn add(&mut self, what: &str, ours: Measured, theirs: f64, their_se: f64) {
        let z = (ours.mean - theirs) / (ours.se.powi(2) + their_se.powi(2)).sqrt();
        self.0.push((what.to_owned(), z));
    }

    /// All within 4, and those beyond 3 at most 1 % of them, or one.
    fn check(&self) {
        let listed: Vec<String> = self.0.iter().map(|(what, z)| format!("{z:+.2} {what}")).collect();
        let beyond = |limit: f64| self.0.iter().filter(|(_, z)| !(z.abs() < limit)).count();
        assert!(beyond(4.0) == 0 && beyond(3.0) <= (self.0.len() / 100).max(1), "{}", listed.join("\n"));
    }
}

fn find<'a>(entries: &'a [Entry], place: &str, what: &str) -> &'a Entry {
    entries.iter().find(|e| e.place == place && e.what == what).unwrap_or_else(|| panic!("{place}: {what}"))
}

#[test]
fn figure_2_is_that_of_an_independent_implementation() {
    // 4000 runs in 40 experiments of 100: mean, and standard deviation of one experiment.
    let done = AtomicUsize::new(0);
    let (entries, figures) = linear::account(&EFFORT, &|| {
        done.fetch_add(1, Ordering::Relaxed);
    });
    assert_eq!(done.load(Ordering::Relaxed), linear::pieces(&EFFORT));
    let mut found = Deviations(Vec::new());
    for (what, theirs, spread) in [
        ("mean |error| of state 1, p = 0.1", 0.5532, 0.0016),
        ("mean |error| of state 2, p = 0.1", 0.7517, 0.0023),
        ("mean |error| of state 1, p = 1", 0.3243, 0.0007),
        ("mean |error| of state 2, p = 1", 0.3566, 0.0009),
    ] {
        let ours = find(&entries, "Figure 2", what).reading.as_ref().unwrap().measured;
        // The spread of a few experiments is uncertain itself: theirs is used.
        let ours = Measured { se: spread / 2_f64.sqrt(), ..ours };
        found.add(what, ours, theirs, spread / 40_f64.sqrt());
    }
    let curve = [
        [0.5532, 0.5315, 0.5075, 0.4828, 0.4554, 0.4279, 0.4006, 0.3741, 0.3485, 0.3243],
        [0.7517, 0.7100, 0.6662, 0.6236, 0.5772, 0.5310, 0.4851, 0.4405, 0.3972, 0.3566],
    ];
    for (ours, theirs) in figures[0].curves.iter().zip(curve) {
        for (point, theirs) in ours.points.iter().zip(theirs) {
            // One experiment at most rates.
            let ours = Measured { mean: point[1], se: 0.0023, spread: 0.0 };
            found.add(&format!("curve at p = {}", point[0]), ours, theirs, 0.0023 / 40_f64.sqrt());
        }
    }
    found.check();
    // True over exact and true over claimed: exact moments.
    let mut found = Deviations(Vec::new());
    let [optimal, claimed] =
        ["Theorem 1", "eq. (16)"].map(|place| entries.iter().find(|e| e.place == place).unwrap().literal.unwrap());
    found.add("true over the exact linear estimate's", optimal, 1.41, 0.005);
    found.add("true over claimed", claimed, 1.38, 0.005);
    found.check();
}

#[test]
fn filters_under_loss_are_those_of_an_independent_implementation() {
    // Medians of 2000 runs in m, shares ending more than 10 m off; in the order of the contenders.
    const THEIRS: [(f64, [(f64, f64); 6]); 5] = [
        (1.0, [(0.110, 0.013), (0.110, 0.013), (0.110, 0.013), (0.110, 0.013), (0.110, 0.013), (0.110, 0.013)]),
        (0.98, [(3.25, 0.39), (15.5, 0.58), (0.302, 0.14), (0.281, 0.09), (0.278, 0.09), (0.112, 0.014)]),
        (0.95, [(14.1, 0.61), (32.2, 0.78), (1.31, 0.22), (0.541, 0.16), (0.506, 0.15), (0.113, 0.013)]),
        (0.9, [(18.7, 0.72), (69.8, 0.86), (2.85, 0.31), (1.59, 0.26), (1.08, 0.22), (0.119, 0.016)]),
        (0.8, [(23.9, 0.74), (160.0, 0.93), (5.53, 0.42), (8.05, 0.48), (4.47, 0.35), (0.128, 0.017)]),
    ];
    const RUNS: f64 = 200.0;
    let table = losses::table(&Effort { runs: Some(RUNS as usize), ..EFFORT });
    let mut found = Deviations(Vec::new());
    for ((p, ours), (rate, theirs)) in table.iter().zip(THEIRS) {
        assert_eq!(*p, rate);
        for (i, ((median, lost), (their_median, their_lost))) in ours.iter().zip(theirs).enumerate() {
            let from_more = (RUNS / 2000.0_f64).sqrt();
            // Printed to three digits.
            let median = Measured { se: median.se.max(5e-4), ..*median };
            found.add(&format!("median of {i} at p = {p}"), median, their_median, median.se * from_more);
            found.add(&format!("lost by {i} at p = {p}"), *lost, their_lost, lost.se * from_more + 0.003);
        }
    }
    found.check();
}

#[test]
fn the_schedule_is_that_of_an_independent_implementation() {
    let done = AtomicUsize::new(0);
    let (entries, _) = schedule::account(&EFFORT, &|| {
        done.fetch_add(1, Ordering::Relaxed);
    });
    assert_eq!(done.load(Ordering::Relaxed), schedule::pieces(&EFFORT));
    let mut found = Deviations(Vec::new());
    for (place, p, literal, reading) in [
        ("Figure 12", 1.0, 14.0, 14.1),
        ("Figure 13", 0.98, 16.4, 44.1),
        ("Figure 14", 0.95, 20.6, 51.9),
        ("Figure 15", 0.9, 25.8, 55.9),
    ] {
        let entry = find(&entries, place, &format!("time steps, p = {p}"));
        let (ours, read) = (entry.literal.unwrap(), entry.reading.as_ref().unwrap().measured);
        // Theirs is a mean of as many runs or more, printed to a tenth.
        found.add(&format!("steps at p = {p}"), ours, literal, ours.se + 0.03);
        found.add(&format!("steps at p = {p}, other reading"), read, reading, read.se + 0.03);
    }
    let columns = ["Δt = 0.1 s", "Δt = 0.2 s", "Δt = 0.3 s", "Δt = 0.4 s", "Δt = 0.5 s", "IDGSS"];
    let usual = [15.82, 8.05, 5.46, 4.05, 3.35, 3.35];
    let fitted = [14.84, 9.06, 7.15, 6.20, 5.58, 5.33];
    let accuracy = [0.317, 0.343, 0.360, 0.389, 0.402, 0.428];
    for (i, column) in columns.iter().enumerate() {
        let energy = find(&entries, "Table 1", &format!("consumed energy, {column}, mJ"));
        let (ours, read) = (energy.literal.unwrap(), energy.reading.as_ref().unwrap().measured);
        // Two experiments say little of their spread: a fifth of a per cent to two is seen.
        let at_least = |m: Measured, share: f64| Measured { se: m.se.max(share * m.mean), ..m };
        found.add(&format!("energy, {column}"), at_least(ours, 0.002), usual[i], 0.005);
        found.add(&format!("fitted energy, {column}"), at_least(read, 0.006), fitted[i], 0.005);
        let of = find(&entries, "Table 1", &format!("estimation accuracy, {column}, m"));
        let ours = of.reading.as_ref().unwrap().measured;
        found.add(&format!("accuracy, {column}"), at_least(ours, 0.02), accuracy[i], 0.0005);
    }
    found.check();
}

#[test]
fn threads_do_not_change_the_account() {
    let effort = Effort { runs: Some(20), ..EFFORT };
    let done = AtomicUsize::new(0);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            losses::account(&effort, &|| {
                done.fetch_add(1, Ordering::Relaxed);
            })
        })
    };
    assert_eq!(on(1), on(2));
    assert_eq!(done.load(Ordering::Relaxed), 2 * losses::pieces(&effort));
}
