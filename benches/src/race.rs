//! Interleaved timing, after a check that all contenders compute the same.

use std::hint::black_box;
use std::time::Instant;

/// What a run is made of.
#[derive(Clone, Copy)]
pub struct Settings {
    /// Steps of a series.
    pub steps: usize,
    /// Timed runs of each contender.
    pub rounds: usize,
    /// Seed of the input.
    pub seed: u64,
}

/// One filter that is advanced by one measurement of `Q` components and tells its state.
pub trait Stepper<const N: usize, const Q: usize> {
    /// Predicts, updates with `z` and returns the mean.
    fn step(&mut self, z: &[f64; Q]) -> [f64; N];
}

/// Writes the estimates of a whole series.
type Run<'a> = dyn Fn(&mut [f64]) + 'a;

/// Someone who can run a whole series and writes `n` values per step.
pub struct Contender<'a> {
    name: &'static str,
    run: Box<Run<'a>>,
}

impl<'a> Contender<'a> {
    /// A contender from the function that runs its series.
    pub fn new(name: &'static str, run: impl Fn(&mut [f64]) + 'a) -> Contender<'a> {
        Contender { name, run: Box::new(run) }
    }

    /// A contender that starts a [`Stepper`] and calls it once per measurement.
    pub fn stepping<S: Stepper<N, Q>, const N: usize, const Q: usize>(
        name: &'static str,
        z: &'a [[f64; Q]],
        start: impl Fn() -> S + 'a,
    ) -> Contender<'a> {
        Contender::new(name, move |out| {
            let mut filter = start();
            for (z, out) in z.iter().zip(out.as_chunks_mut::<N>().0) {
                *out = filter.step(z);
            }
        })
    }
}

/// One line of the table, before printing: nanoseconds per step of each round.
struct Times {
    name: &'static str,
    ns: Vec<f64>,
}

/// Checks that all contenders give the estimates of the first, times them in turn, and prints the table.
///
/// Each round runs every contender once, starting one further along each time, so that drift of the machine meets all
/// alike; a ratio is the median of the ratios within the rounds.
pub fn race(title: &str, n: usize, settings: &Settings, contenders: &[Contender<'_>]) -> Result<(), String> {
    let mut out = vec![0.0; settings.steps * n];
    agree(title, n, contenders, &mut out)?;
    let mut times: Vec<Times> = contenders.iter().map(|c| Times { name: c.name, ns: Vec::new() }).collect();
    for round in 0..settings.rounds {
        for turn in 0..contenders.len() {
            let i = (round + turn) % contenders.len();
            let start = Instant::now();
            (contenders[i].run)(black_box(&mut out));
            times[i].ns.push(start.elapsed().as_secs_f64() * 1e9 / settings.steps as f64);
            black_box(&out);
        }
    }
    print(title, &times);
    Ok(())
}

fn agree(title: &str, n: usize, contenders: &[Contender<'_>], out: &mut [f64]) -> Result<(), String> {
    let mut first: Vec<f64> = Vec::new();
    for (i, contender) in contenders.iter().enumerate().filter(|(_, c)| !c.name.starts_with("copying")) {
        out.fill(f64::NAN);
        (contender.run)(out);
        if i == 0 {
            first = out.to_vec();
        }
        for (at, (a, b)) in out.iter().zip(&first).enumerate() {
            // A stable filter forgets its rounding (1e-16 of 40 m) within tens of steps; a wrong term shows at once.
            let close = (a - b).abs() <= 1e-9 * b.abs().max(1.0);
            if !close {
                return Err(format!(
                    "{title}: component {} of step {} is {a} by {}, expected {b} as by {}",
                    at % n,
                    at / n,
                    contender.name,
                    contenders[0].name
                ));
            }
        }
    }
    Ok(())
}

fn print(title: &str, times: &[Times]) {
    println!("\n{:<54} {:>8}   {:>15}  {:>6}", title, "ns/step", "quartiles", "ratio");
    for line in times {
        let ratios: Vec<f64> = line.ns.iter().zip(&times[0].ns).map(|(a, b)| a / b).collect();
        let [low, median, high] = [0.25, 0.5, 0.75].map(|p| quantile(&line.ns, p));
        println!("  {:<52} {median:>8.1}   {low:>7.1} {high:>7.1}  {:>6.3}", line.name, quantile(&ratios, 0.5));
    }
}

fn quantile(values: &[f64], p: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted[((sorted.len() - 1) as f64 * p).round() as usize]
}
