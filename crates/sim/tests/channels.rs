//! Channels lose what they promise, and equal seeds lose the same.

use fixtrail_sim::channels::{Bernoulli, Channel, DesignError, GilbertElliott, NAMES};
use rand_pcg::Pcg64;

fn losses(channel: &mut dyn Channel, packets: usize, seed: u128) -> Vec<bool> {
    let mut rng = Pcg64::new(seed, 1);
    (0..packets).map(|_| !channel.delivered(&mut rng)).collect()
}

fn fraction(lost: &[bool]) -> f64 {
    lost.iter().filter(|l| **l).count() as f64 / lost.len() as f64
}

fn bursts(lost: &[bool]) -> Vec<usize> {
    lost.split(|l| !l).map(<[bool]>::len).filter(|n| *n > 0).collect()
}

#[test]
fn bernoulli_loss_rate_is_within_four_standard_deviations() {
    let lost = losses(&mut Bernoulli::new(0.3).unwrap(), 100_000, 7);
    // sd = sqrt(0.3·0.7/1e5) = 1.45e-3.
    assert!((fraction(&lost) - 0.3).abs() < 4.0 * 1.45e-3, "{}", fraction(&lost));
    // Bursts are geometric with mean 1/0.7 and sd sqrt(0.3)/0.7 = 0.782; there are about 1e5·0.3·0.7 = 21 000.
    let b = bursts(&lost);
    let mean = b.iter().sum::<usize>() as f64 / b.len() as f64;
    assert!((mean - 1.0 / 0.7).abs() < 4.0 * 0.782 / (b.len() as f64).sqrt(), "{mean}");
}

#[test]
fn gilbert_elliott_loss_rate_and_burst_length_are_within_four_standard_deviations() {
    let (rate, burst, n) = (0.25, 5.0, 200_000);
    let lost = losses(&mut GilbertElliott::new(rate, burst).unwrap(), n, 11);
    // States have autocorrelation rho^k with rho = 1 - p - r = 1 - 0.2/3 - 0.2 = 0.7333; the variance of the mean is
    // rate(1-rate)/n · (1+rho)/(1-rho) = 0.1875/2e5 · 6.5, sd 2.47e-3.
    assert!((fraction(&lost) - rate).abs() < 4.0 * 2.47e-3, "{}", fraction(&lost));
    // Bursts are geometric with mean 5 and sd sqrt(1 - 1/5)·5 = 4.47; there are about n·rate/5 = 10 000.
    let b = bursts(&lost);
    let mean = b.iter().sum::<usize>() as f64 / b.len() as f64;
    assert!((mean - burst).abs() < 4.0 * 4.47 / (b.len() as f64).sqrt(), "{mean}");
}

#[test]
fn gilbert_elliott_with_memoryless_burst_equals_independent_losses() {
    // With mean burst 1/(1 - rate) the chain forgets: P(bad | bad) = P(bad | good) = rate.
    let lost = losses(&mut GilbertElliott::new(0.5, 2.0).unwrap(), 100_000, 3);
    let pairs = lost.windows(2).filter(|w| w[0] && w[1]).count() as f64 / 99_999.0;
    // Product of two independent halves: 0.25, sd below sqrt(0.25·0.75·3/1e5) = 2.4e-3.
    assert!((pairs - 0.25).abs() < 4.0 * 2.4e-3, "{pairs}");
}

#[test]
fn equal_seeds_lose_the_same_packets() {
    let run = |seed| losses(&mut GilbertElliott::new(0.25, 5.0).unwrap(), 1000, seed);
    assert_eq!(run(5), run(5));
    assert_ne!(run(5), run(6));
}

#[test]
fn impossible_channels_are_refused() {
    assert_eq!(Bernoulli::new(1.0), Err(DesignError::LossRate { value: 1.0 }));
    assert!(matches!(Bernoulli::new(f64::NAN), Err(DesignError::LossRate { .. })));
    assert_eq!(GilbertElliott::new(0.8, 2.0), Err(DesignError::MeanBurst { value: 2.0, min: 0.8 / (1.0 - 0.8) }));
    assert!(matches!(GilbertElliott::new(0.1, 0.5), Err(DesignError::MeanBurst { .. })));
    assert_eq!(
        GilbertElliott::new(-0.1, 2.0).unwrap_err().to_string(),
        "the loss rate is -0.1, expected a number from 0 up to, but not including, 1"
    );
    assert_eq!(NAMES.map(|(name, _)| name), ["bernoulli", "gilbert-elliott"]);
}
