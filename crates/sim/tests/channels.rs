//! Channels lose what they promise, and equal seeds lose the same.

use fixtrail_sim::channels::{
    Arrivals, Bernoulli, Channel, DesignError, Duplication, GilbertElliott, RandomDelay, Trace, TracePacket,
};
use fixtrail_track::spec::CHANNELS;
use fixtrail_track::survey::Loss;
use rand_pcg::Pcg64;
use std::sync::Arc;

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
        "random-delay" => Box::new(RandomDelay::uniform(named("bernoulli"), 0.0, 0.5).unwrap()),
        "duplication" => Box::new(Duplication::new(named("bernoulli"), 0.25, 0.5).unwrap()),
        "trace" => Box::new(Trace::new(recorded(), 0).unwrap()),
        _ => panic!("the list names a channel that this test cannot build: {name}"),
    }
}

#[test]
fn every_name_in_the_list_builds_a_channel_and_equal_seeds_give_equal_arrivals() {
    let names: Vec<&str> = CHANNELS.iter().map(|(name, _)| *name).collect();
    assert_eq!(names, ["bernoulli", "gilbert-elliott", "random-delay", "duplication", "trace"]);
    for name in names {
        let run = |seed| arrivals(&mut *named(name), 1000, seed);
        assert_eq!(run(5), run(5), "{name}");
        // A recording is the same whatever the seed.
        assert_eq!(run(5) == run(6), name == "trace", "{name}");
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

fn perfect() -> Box<dyn Channel> {
    Box::new(Bernoulli::new(0.0).unwrap())
}

/// The delays of all copies, seconds, in the order of sending.
fn delays_s(channel: &mut dyn Channel, packets: usize, seed: u128) -> Vec<f64> {
    arrivals(channel, packets, seed).iter().flat_map(|a| a.delays_s().to_vec()).collect()
}

#[test]
fn discrete_delays_have_the_given_probabilities_and_the_last_possible_one_as_bound() {
    let (probabilities, n) = ([0.5, 0.3, 0.0, 0.2, 0.0], 100_000);
    let mut channel = RandomDelay::discrete(perfect(), &probabilities, 0.25).unwrap();
    assert_eq!(channel.longest_s(), 0.75);
    let delays = delays_s(&mut channel, n, 21);
    assert_eq!(delays.len(), n);
    for (intervals, p) in probabilities.iter().enumerate() {
        // Whole multiples of 1/4 are exact. sd sqrt(p(1-p)/n), nothing where the delay is impossible.
        let share = delays.iter().filter(|d| **d == 0.25 * intervals as f64).count() as f64 / n as f64;
        assert!((share - p).abs() <= 4.0 * (p * (1.0 - p) / n as f64).sqrt(), "{intervals}: {share}");
    }
    assert!(delays.iter().all(|d| (4.0 * d).fract() == 0.0 && *d <= channel.longest_s()));
}

#[test]
fn uniform_delays_fill_their_bounds_evenly_and_independently() {
    let (min_s, max_s, n) = (0.25, 1.25, 100_000);
    let mut channel = RandomDelay::uniform(perfect(), min_s, max_s).unwrap();
    assert_eq!(channel.longest_s(), max_s);
    let mut delays = delays_s(&mut channel, n, 22);
    assert!(delays.iter().all(|d| (min_s..=max_s).contains(d)));
    // Products of two deviations have mean 0 and sd 1/12 of the squared width; those that share a factor are uncorrelated,
    // so the sd of their mean is 1/12/sqrt(n) = 2.64e-4.
    let covariance = delays.windows(2).map(|w| (w[0] - 0.75) * (w[1] - 0.75)).sum::<f64>() / (n - 1) as f64;
    assert!(covariance.abs() < 4.0 * 2.64e-4, "{covariance}");
    // Kolmogorov-Smirnov: the largest distance to the straight line exceeds 2.23/sqrt(n) once in 10 000 (2 exp(-2·2.23²)).
    delays.sort_by(f64::total_cmp);
    let distance = delays.iter().enumerate().map(|(i, d)| ((i as f64 + 0.5) / n as f64 - (d - min_s)).abs());
    let distance = distance.fold(0.0, f64::max);
    assert!(distance < 2.23 / (n as f64).sqrt(), "{distance}");
}

#[test]
fn packets_overtake_each_other_as_often_as_the_delays_say_and_never_beyond_the_bound() {
    let (interval_s, n) = (0.25, 100_000);
    let overtaken = |channel: &mut dyn Channel| {
        let arrived: Vec<f64> =
            delays_s(channel, n, 23).iter().enumerate().map(|(k, d)| k as f64 * interval_s + d).collect();
        arrived.windows(2).filter(|w| w[1] < w[0]).count() as f64 / (n - 1) as f64
    };
    // Delays 0, 1, 2 intervals: the next packet overtakes when its delay is 2 less, 1/4 · 1/4. Neighbouring pairs share a
    // packet and cannot both be overtaken, which makes the variance less than p(1-p)/n: sd below 7.66e-4.
    let share = overtaken(&mut RandomDelay::discrete(perfect(), &[0.25, 0.5, 0.25], interval_s).unwrap());
    assert!((share - 0.0625).abs() < 4.0 * 7.66e-4, "{share}");
    // Uniform on twice the interval: a triangular difference, 1/2 · (1/2)² = 1/8. Both of two neighbouring pairs need a
    // fall of two intervals in all, which has probability 0: sd below sqrt(0.109/n) = 1.05e-3.
    let share = overtaken(&mut RandomDelay::uniform(perfect(), 0.0, 2.0 * interval_s).unwrap());
    assert!((share - 0.125).abs() < 4.0 * 1.05e-3, "{share}");
    assert_eq!(overtaken(&mut RandomDelay::uniform(perfect(), 0.0, interval_s).unwrap()), 0.0);
}

#[test]
fn delay_without_spread_shifts_every_packet_alike() {
    for mut channel in [
        RandomDelay::uniform(perfect(), 0.0, 0.0).unwrap(),
        RandomDelay::discrete(perfect(), &[1.0], 0.25).unwrap(),
        RandomDelay::discrete(perfect(), &[1.0, 0.0], 0.25).unwrap(),
    ] {
        assert_eq!(channel.longest_s(), 0.0);
        assert!(arrivals(&mut channel, 100, 1).iter().all(|a| *a == Arrivals::one(0.0)));
    }
    // Delays add up, and of one channel in the other the bound is that of the outer one alone.
    let inner = RandomDelay::discrete(perfect(), &[0.0, 1.0], 0.25).unwrap();
    let mut both = RandomDelay::uniform(Box::new(inner), 0.5, 0.5).unwrap();
    assert_eq!(both.longest_s(), 0.5);
    assert!(arrivals(&mut both, 100, 1).iter().all(|a| *a == Arrivals::one(0.75)));
}

#[test]
fn delay_leaves_losses_as_they_are() {
    let channel = GilbertElliott::new(0.25, 5.0).unwrap();
    let loss = loss(&mut RandomDelay::uniform(Box::new(channel), 0.0, 0.5).unwrap(), 200_000, 12);
    // The bounds of the channel alone, derived above.
    assert!((loss.rate() - 0.25).abs() < 4.0 * 2.47e-3, "{}", loss.rate());
    let mean = loss.mean_burst().unwrap();
    assert!((mean - 5.0).abs() < 4.0 * 4.47 / (loss.burst_count() as f64).sqrt(), "{mean}");
}

#[test]
fn impossible_delays_are_refused() {
    let discrete = |p: &[f64], interval_s| RandomDelay::discrete(perfect(), p, interval_s).err().unwrap();
    let uniform = |min_s, max_s| RandomDelay::uniform(perfect(), min_s, max_s).err().unwrap();
    for value in [0.0, -0.25, 1.1e12, f64::INFINITY] {
        assert_eq!(discrete(&[1.0], value), DesignError::DelayInterval { value });
    }
    assert!(matches!(discrete(&[1.0], f64::NAN), DesignError::DelayInterval { .. }));
    assert_eq!(discrete(&[0.5, 1.5, -1.0], 1.0), DesignError::DelayProbability { intervals: 1, value: 1.5 });
    assert!(matches!(discrete(&[f64::NAN], 1.0), DesignError::DelayProbability { intervals: 0, .. }));
    assert_eq!(discrete(&[], 1.0), DesignError::DelayProbabilities { sum: 0.0 });
    assert_eq!(discrete(&[0.5, 0.25], 1.0), DesignError::DelayProbabilities { sum: 0.75 });
    // On both sides of the tolerance of 1e-9.
    assert!(matches!(discrete(&[0.5, 0.5 + 2e-9], 1.0), DesignError::DelayProbabilities { .. }));
    assert!(RandomDelay::discrete(perfect(), &[0.5, 0.5 - 0.5e-9], 1.0).is_ok());
    for (min_s, max_s) in [(0.5, 0.25), (-0.1, 1.0), (0.0, f64::INFINITY), (0.0, 1.1e12)] {
        assert_eq!(uniform(min_s, max_s), DesignError::DelayBounds { min_s, max_s });
    }
    assert!(matches!(uniform(f64::NAN, 1.0), DesignError::DelayBounds { .. }));
    for (error, text) in [
        (
            discrete(&[1.0], -0.25),
            "the interval of the delays is -0.25 s, expected a positive number of seconds up to 1e12",
        ),
        (discrete(&[0.0, 2.0], 1.0), "`probabilities[1]` of the delays is 2, expected a number from 0 to 1"),
        (discrete(&[0.5], 1.0), "the probabilities of the delays add up to 0.5, expected 1 within 1e-9"),
        (
            uniform(0.5, 0.25),
            "the delays are from 0.5 s to 0.25 s, expected ascending numbers of seconds from 0 to 1e12",
        ),
    ] {
        assert_eq!(error.to_string(), text);
    }
}

#[test]
fn duplication_repeats_its_share_of_what_arrives_within_the_lag() {
    let (loss_rate, rate, lag_s, n) = (0.25, 0.3, 0.5, 100_000);
    let inner = Box::new(Bernoulli::new(loss_rate).unwrap());
    let arrived = arrivals(&mut Duplication::new(inner, rate, lag_s).unwrap(), n, 31);
    let share = |copies| arrived.iter().filter(|a| a.delays_s().len() == copies).count() as f64 / n as f64;
    // Lost, once and twice: 1/4, 3/4 · 0.7 and 3/4 · 0.3, each with sd sqrt(p(1-p)/n) up to 1.58e-3.
    for (copies, p) in [(0, 0.25), (1, 0.525), (2, 0.225)] {
        assert!((share(copies) - p).abs() < 4.0 * 1.58e-3, "{copies}: {}", share(copies));
    }
    let mut lags: Vec<f64> = arrived.iter().filter_map(|a| a.delays_s().get(1).copied()).collect();
    assert!(arrived.iter().all(|a| a.delays_s().first().is_none_or(|d| *d == 0.0)));
    assert!(lags.iter().all(|lag| (0.0..=lag_s).contains(lag)));
    // Uniform, by the bound of the uniform delays above.
    lags.sort_by(f64::total_cmp);
    let m = lags.len() as f64;
    let distance =
        lags.iter().enumerate().map(|(i, lag)| ((i as f64 + 0.5) / m - lag / lag_s).abs()).fold(0.0, f64::max);
    assert!(distance < 2.23 / m.sqrt(), "{distance}");
}

#[test]
fn duplication_without_chance_repeats_nothing_or_everything() {
    let all = |rate, lag_s| arrivals(&mut Duplication::new(perfect(), rate, lag_s).unwrap(), 1000, 32);
    assert!(all(0.0, 0.5).iter().all(|a| *a == Arrivals::one(0.0)));
    assert!(all(1.0, 0.0).iter().all(|a| *a == Arrivals::one(0.0).and(0.0)));
    // Of a packet that has several copies already, one more, after the first.
    let twice = Box::new(Duplication::new(perfect(), 1.0, 0.0).unwrap());
    let mut channel = Duplication::new(twice, 1.0, 0.5).unwrap();
    for arrived in arrivals(&mut channel, 100, 33) {
        assert_eq!((arrived.delays_s().len(), &arrived.delays_s()[..2]), (3, &[0.0, 0.0][..]));
    }
}

#[test]
fn copies_of_a_packet_are_delayed_each_on_its_own() {
    let n = 100_000;
    let twice = Box::new(Duplication::new(perfect(), 1.0, 0.0).unwrap());
    let arrived = arrivals(&mut RandomDelay::discrete(twice, &[0.5, 0.5], 0.25).unwrap(), n, 34);
    assert!(arrived.iter().all(|a| a.delays_s().len() == 2 && a.delays_s().is_sorted()));
    let apart = arrived.iter().filter(|a| a.delays_s()[0] < a.delays_s()[1]).count() as f64 / n as f64;
    // Two fair coins differ half of the time: sd sqrt(0.25/n) = 1.58e-3.
    assert!((apart - 0.5).abs() < 4.0 * 1.58e-3, "{apart}");
}

#[test]
fn impossible_duplications_are_refused() {
    let refused = |rate, lag_s| Duplication::new(perfect(), rate, lag_s).err().unwrap();
    for value in [-0.1, 1.1] {
        assert_eq!(refused(value, 0.5), DesignError::DuplicationRate { value });
    }
    assert!(matches!(refused(f64::NAN, 0.5), DesignError::DuplicationRate { .. }));
    for value in [-0.5, f64::INFINITY, 1.1e12] {
        assert_eq!(refused(0.5, value), DesignError::DuplicationLag { value });
    }
    assert!(matches!(refused(0.5, f64::NAN), DesignError::DuplicationLag { .. }));
    assert_eq!(refused(1.5, 0.5).to_string(), "the duplication rate is 1.5, expected a number from 0 to 1");
    assert_eq!(
        refused(0.5, -1.0).to_string(),
        "the longest lag of a repeated packet is -1 s, expected a number of seconds from 0 to 1e12"
    );
}

const LOST: TracePacket = TracePacket { received: false, delay_s: 0.0, copies: 0 };

fn received(delay_s: f64, copies: u32) -> TracePacket {
    TracePacket { received: true, delay_s, copies }
}

fn recorded() -> Arc<[TracePacket]> {
    Arc::new([received(0.25, 1), LOST, received(0.0, 2), received(1.5, 12)])
}

#[test]
fn trace_does_again_what_was_recorded_from_its_start_on_and_begins_anew_at_its_end() {
    let copies = |delay_s: f64, n: usize| (0..n).fold(Arrivals::lost(), |a, _| a.and(delay_s));
    let expected = [copies(0.25, 1), Arrivals::lost(), copies(0.0, 2), copies(1.5, Arrivals::CAPACITY)];
    for start in 0..4 {
        let mut channel = Trace::new(recorded(), start).unwrap();
        for (k, arrived) in arrivals(&mut channel, 11, 1).iter().enumerate() {
            assert_eq!(*arrived, expected[(start + k) % 4], "start {start}, packet {k}");
        }
    }
    let mut only = Trace::new(Arc::new([received(0.5, 1)]), 0).unwrap();
    assert_eq!(arrivals(&mut only, 3, 1), [Arrivals::one(0.5); 3]);
}

#[test]
fn trace_leaves_the_random_numbers_to_others() {
    let mut rng = Pcg64::new(41, 1);
    let mut channel = Trace::new(recorded(), 0).unwrap();
    for _ in 0..10 {
        channel.transmit(&mut rng);
    }
    assert_eq!(rng, Pcg64::new(41, 1));
}

#[test]
fn impossible_traces_are_refused() {
    let refused = |packets: &[TracePacket], start| Trace::new(packets.into(), start).unwrap_err();
    assert_eq!(refused(&[], 0), DesignError::TraceStart { value: 0, packets: 0 });
    assert_eq!(refused(&[LOST, LOST], 2), DesignError::TraceStart { value: 2, packets: 2 });
    assert!(Trace::new(Arc::new([LOST, LOST]), 1).is_ok());
    for value in [-0.5, f64::INFINITY, 1.1e12] {
        assert_eq!(refused(&[LOST, received(value, 1)], 0), DesignError::TraceDelay { packet: 1, value });
    }
    assert!(matches!(refused(&[received(f64::NAN, 1)], 0), DesignError::TraceDelay { packet: 0, .. }));
    assert_eq!(refused(&[LOST, received(0.5, 0)], 0), DesignError::TraceCopies { packet: 1 });
    // What a recording says of the delay of a lost packet has no meaning, and does no harm.
    assert!(Trace::new(Arc::new([TracePacket { delay_s: f64::NAN, ..LOST }]), 0).is_ok());
    for (error, text) in [
        (refused(&[LOST], 5), "the trace starts at packet 5, expected a number below that of its packets, 1"),
        (
            refused(&[received(-1.0, 1)], 0),
            "the delay of packet 0 of the trace is -1 s, expected a number of seconds from 0 to 1e12",
        ),
        (refused(&[received(1.0, 0)], 0), "packet 0 of the trace was received in 0 copies, expected at least 1"),
    ] {
        assert_eq!(error.to_string(), text);
    }
}
