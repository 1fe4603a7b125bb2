//! Channels lose what they promise, and equal seeds lose the same.

use fixtrail_sim::channels::{Arrivals, Bernoulli, Channel, DesignError, GilbertElliott};
use fixtrail_track::spec::CHANNELS;
use fixtrail_track::survey::Loss;
use rand_pcg::Pcg64;

fn arrivals(channel: &mut dyn Channel, packets: usize, seed: u128) -> Vec<Arrivals> {
    let mut rng = Pcg64::new(seed, 1);
    (0..packets).map(|_| channel.transmit(&mut rng)).collect()
}

fn loss(channel: &mut dyn Channel, packets: usize, seed: u128) -> Loss {
    Loss::of(arrivals(channel, packets, seed).iter().map(Arrivals::is_lost))
}

#[test]
fn bernoulli_loss_rate_is_within_four_standard_deviations() {
    let loss = loss(&mut Bernoulli::new(0.3).unwrap(), 100_000, 7);
    // sd = sqrt(0.3·0.7/1e5) = 1.45e-3.
    assert!((loss.rate() - 0.3).abs() < 4.0 * 1.45e-3, "{}", loss.rate());
    // Bursts are geometric with mean 1/0.7 and sd sqrt(0.3)/0.7 = 0.782; there are about 1e5·0.3·0.7 = 21 000.
    let mean = loss.mean_burst().unwrap();
    assert!((mean - 1.0 / 0.7).abs() < 4.0 * 0.782 / (loss.burst_count() as f64).sqrt(), "{mean}");
}

#[test]
fn gilbert_elliott_loss_rate_and_burst_length_are_within_four_standard_deviations() {
    let (rate, burst, n) = (0.25, 5.0, 200_000);
    let loss = loss(&mut GilbertElliott::new(rate, burst).unwrap(), n, 11);
    // States have autocorrelation rho^k with rho = 1 - p - r = 1 - 0.2/3 - 0.2 = 0.7333; the variance of the mean is
    // rate(1-rate)/n · (1+rho)/(1-rho) = 0.1875/2e5 · 6.5, sd 2.47e-3.
    assert!((loss.rate() - rate).abs() < 4.0 * 2.47e-3, "{}", loss.rate());
    // Bursts are geometric with mean 5 and sd sqrt(1 - 1/5)·5 = 4.47; there are about n·rate/5 = 10 000.
    let mean = loss.mean_burst().unwrap();
    assert!((mean - burst).abs() < 4.0 * 4.47 / (loss.burst_count() as f64).sqrt(), "{mean}");
}

#[test]
fn gilbert_elliott_with_memoryless_burst_equals_independent_losses() {
    // With mean burst 1/(1 - rate) the chain forgets: P(bad | bad) = P(bad | good) = rate.
    let arrived = arrivals(&mut GilbertElliott::new(0.5, 2.0).unwrap(), 100_000, 3);
    let pairs = arrived.windows(2).filter(|w| w[0].is_lost() && w[1].is_lost()).count() as f64 / 99_999.0;
    // Product of two independent halves: 0.25, sd below sqrt(0.25·0.75·3/1e5) = 2.4e-3.
    assert!((pairs - 0.25).abs() < 4.0 * 2.4e-3, "{pairs}");
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
}

/// A channel of each name that files use.
fn named(name: &str) -> Box<dyn Channel> {
    match name {
        "bernoulli" => Box::new(Bernoulli::new(0.25).unwrap()),
        "gilbert-elliott" => Box::new(GilbertElliott::new(0.25, 5.0).unwrap()),
        _ => panic!("the list names a channel that this test cannot build: {name}"),
    }
}

#[test]
fn every_name_in_the_list_builds_a_channel_and_equal_seeds_give_equal_arrivals() {
    let names: Vec<&str> = CHANNELS.iter().map(|(name, _)| *name).collect();
    assert_eq!(names, ["bernoulli", "gilbert-elliott"]);
    for name in names {
        let run = |seed| arrivals(&mut *named(name), 1000, seed);
        assert_eq!(run(5), run(5), "{name}");
        assert_ne!(run(5), run(6), "{name}");
        for arrivals in run(5) {
            let delays_s = arrivals.delays_s();
            assert!(
                delays_s.is_sorted() && delays_s.iter().all(|d| d.is_finite() && *d >= 0.0),
                "{name}: {delays_s:?}"
            );
        }
    }
}

#[test]
fn channels_without_delay_deliver_one_copy_at_once() {
    for name in ["bernoulli", "gilbert-elliott"] {
        let arrived = arrivals(&mut *named(name), 1000, 2);
        assert!(arrived.iter().all(|a| a.is_lost() || *a == Arrivals::one(0.0)), "{name}");
    }
}

#[test]
fn arrivals_ascend_whatever_the_order_they_are_given_in_and_keep_the_earliest() {
    assert!(Arrivals::lost().is_lost() && Arrivals::lost().delays_s().is_empty());
    assert_eq!(Arrivals::one(0.5).delays_s(), [0.5]);
    assert!(!Arrivals::one(0.0).is_lost());
    let both_ways = [Arrivals::one(0.5).and(0.25).and(0.75), Arrivals::one(0.75).and(0.5).and(0.25)];
    assert_eq!(both_ways[0].delays_s(), [0.25, 0.5, 0.75]);
    assert_eq!(both_ways[0], both_ways[1]);
    // Ten copies, the latest first: the two latest have no place.
    let many = (0..10).rev().fold(Arrivals::lost(), |a, i| a.and(f64::from(i)));
    assert_eq!(many.delays_s(), [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);
    assert_eq!(many.and(7.0), many);
    assert_eq!(many.and(0.0).delays_s(), [0.0, 0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
}
