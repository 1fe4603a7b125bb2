//! How well a causal trail foretells the measurements that come after each of its fixes: a score that needs no truth.
//!
//! Every scalar of an instant is judged by the last fix *before* that instant, carried there by the spec's motion, so the estimate has
//! not seen it, nor anything of its instant:
//!
//! ```text
//! x⁻ = f(x̂)            P⁻ = F P Fᵀ + Q
//! ν  = z − h(x⁻)       S  = hᵀP⁻h + r
//! ```
//!
//! The score is the mean over all scalars of the logarithm of a contaminated normal density, after \[TUK60\], its outliers spread like a
//! Cauchy distribution C:
//!
//! ```text
//! p(ν) = 0.95 N(ν; 0, S) + 0.05 C(ν; 0, 10 √S),   C(ν; 0, g) = 1 / (π g (1 + ν²/g²)).
//! ```
//!
//! Under the normal density alone a scalar 50 standard deviations off costs 1251 and decides the mean of thousands: an estimator that makes
//! room for one outlier would win over one that foretells all the rest better. Here it costs 10, and one a million standard deviations off,
//! as when two ships share a number, 29: outliers spread like another normal density of 100 S would cost 5e9 there. Innovations of ordinary
//! size count as they would without outliers. A larger score is better, and mean *and* covariance must be right for a large one, unlike for
//! small innovations, which say nothing of the covariance, and for a small `ν²/S`, which any covariance large enough gives.
//!
//! Scalars are judged one by one, not jointly: the density of several would need an update by all but the last, which an outlier among them
//! would spoil, and their order would matter. Hence they are taken with their own variance `r`, in their own unit; that they may share noise
//! plays no part. A sum of logarithms of marginal densities still favours the right ones.

use crate::anchors::Anchors;
use crate::error::BuildError;
use crate::link::Link;
use crate::model::{HeldRows, Model};
use crate::packet::{Content, Kind, Packet};
use crate::pipeline::arriving;
use crate::registry;
use crate::spec::{Hold, Receiver, Spec};
use crate::target::TargetPackets;
use crate::tracker::Step;
use crate::trail::Trail;
use fixtrail_core::estimators::kalman;
use fixtrail_core::{Belief, Matrix, Vector};
use std::collections::BTreeMap;
use std::convert::Infallible;

/// Share of scalars that the density takes for outliers.
const CONTAMINATION: f64 = 0.05;
/// How far half of the outliers are off, in standard deviations of a good scalar.
const SPREAD: f64 = 10.0;

/// One scalar and what the trail foretold of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Foretold {
    /// Index of the instant.
    pub k: u64,
    /// The instant, seconds; absent in a linear run without times.
    pub t_s: Option<f64>,
    /// What measured it.
    pub kind: Kind,
    /// Measured less foretold, in the unit of the kind.
    pub innovation: f64,
    /// Variance foretold of the innovation.
    pub var: f64,
    /// What was foretold of the value of two instants before, where it may be that.
    pub old: Option<Old>,
}

/// The other thing that a value without a time may be: that of two instants before.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Old {
    /// Probability, before the value is looked at.
    pub probability: f64,
    /// Measured less foretold.
    pub innovation: f64,
    /// Variance foretold.
    pub var: f64,
}

impl Foretold {
    /// Logarithm of the contaminated normal density of the innovation, or of the mixture of two; −∞ for an estimate that is no number.
    pub fn log_density(&self) -> f64 {
        let new = log_density(self.innovation, self.var);
        let Some(old) = self.old else { return new };
        let (a, b) = ((1.0 - old.probability).ln() + new, old.probability.ln() + log_density(old.innovation, old.var));
        let (more, less) = if a > b { (a, b) } else { (b, a) };
        if more == f64::NEG_INFINITY { more } else { more + (less - more).exp().ln_1p() }
    }

    /// `ν²/S`, 1 on average if the trail's covariance is right; of two things that a value may be, by their share in the density.
    pub fn nis(&self) -> f64 {
        let new = self.innovation * self.innovation / self.var;
        let Some(old) = self.old else { return new };
        let share = (old.probability.ln() + log_density(old.innovation, old.var) - self.log_density()).exp();
        (1.0 - share) * new + share * old.innovation * old.innovation / old.var
    }
}

/// `ln(0.95 N(ν; 0, S) + 0.05 C(ν; 0, 10 √S))`, the larger part taken out of the sum so that it never vanishes.
fn log_density(innovation: f64, var: f64) -> f64 {
    use std::f64::consts::{PI, TAU};
    let fit = innovation * innovation / var;
    let good = (1.0 - CONTAMINATION).ln() - 0.5 * (fit + TAU.ln());
    let outlier = (CONTAMINATION / (PI * SPREAD)).ln() - (fit / (SPREAD * SPREAD)).ln_1p();
    let (more, less) = if good > outlier { (good, outlier) } else { (outlier, good) };
    let log = more + (less - more).exp().ln_1p() - 0.5 * var.ln();
    if log.is_nan() { f64::NEG_INFINITY } else { log }
}

/// How large the innovations of one kind are, in its unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Size {
    /// Scalars.
    pub scalars: usize,
    /// Root mean square innovation.
    pub rms: f64,
    /// Median of the innovations without their sign.
    pub median: f64,
}

/// How well one or more trails foretold what was measured.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Score {
    /// Scalars judged.
    pub scalars: usize,
    /// Scalars that no estimate came before: until the first fix, and while the state is unobservable.
    pub unforetold: usize,
    log_density: f64,
    nis: f64,
    /// Innovations without their sign.
    sizes: BTreeMap<Kind, Vec<f64>>,
}

impl Score {
    /// Takes one scalar.
    pub fn push(&mut self, told: &Foretold) {
        self.scalars += 1;
        self.log_density += told.log_density();
        self.nis += told.nis();
        self.sizes.entry(told.kind).or_default().push(told.innovation.abs());
    }

    /// Takes what another score has, as if its scalars had come here.
    pub fn add(&mut self, other: &Score) {
        self.scalars += other.scalars;
        self.unforetold += other.unforetold;
        self.log_density += other.log_density;
        self.nis += other.nis;
        for (kind, sizes) in &other.sizes {
            self.sizes.entry(*kind).or_default().extend_from_slice(sizes);
        }
    }

    /// Mean logarithm of the density per scalar, the larger the better; `None` when nothing was judged.
    pub fn mean_log_density(&self) -> Option<f64> {
        self.mean(self.log_density)
    }

    /// Mean of `ν²/S`, 1 if the covariance is right; a single outlier may decide it.
    pub fn mean_nis(&self) -> Option<f64> {
        self.mean(self.nis)
    }

    fn mean(&self, sum: f64) -> Option<f64> {
        (self.scalars > 0).then(|| sum / self.scalars as f64)
    }

    /// How large the innovations are, for every kind that was judged.
    pub fn sizes(&self) -> impl Iterator<Item = (Kind, Size)> + '_ {
        self.sizes.iter().filter(|(_, sizes)| !sizes.is_empty()).map(|(kind, sizes)| (*kind, size(sizes)))
    }
}

fn size(sizes: &[f64]) -> Size {
    let n = sizes.len();
    let mut sorted = sizes.to_vec();
    let (below, upper, _) = sorted.select_nth_unstable_by(n / 2, f64::total_cmp);
    let upper = *upper;
    let median = if n % 2 == 1 { upper } else { 0.5 * (upper + below.iter().copied().fold(0.0, f64::max)) };
    let rms = (sizes.iter().map(|v| v * v).sum::<f64>() / n as f64).sqrt();
    Size { scalars: n, rms, median }
}

/// Scores what a receiver without time stamps showed, by what the causal `trail` of some estimator foretold of it: otherwise as [`score`].
///
/// A value that repeats the one before, or is known to be old, says nothing of the trail and is left out. A value that is not is new where
/// the receiver holds what it last received. With `hold = "paper"` it is z_{k−2} with probability `(1 − p)³ / (p + (1 − p)³)`: nothing came, now
/// and the two times before, and that value was not shown then. Its density is the mixture of what was foretold of z_k and of z_{k−2}.
///
/// # Errors
/// [`BuildError`] when the spec makes no model.
pub fn score_held(spec: &Spec, anchors: &Anchors, packets: &TargetPackets, trail: &Trail) -> Result<Score, BuildError> {
    let mut score = Score::default();
    let mut foreteller = registry::foreteller(spec, anchors)?;
    let paper = matches!(spec.link.receiver, Receiver::Unstamped { hold: Hold::Paper });
    let mut shown: Vec<Content> = Vec::new();
    let mut link = Link::new(&spec.link, spec.model.prior().is_some());
    let mut unforetold = 0;
    let mut one = |step: &Step<'_>| -> Result<(), Infallible> {
        let repeats = step.held.iter().map(|p| &p.content).eq(&shown);
        shown.clear();
        shown.extend(step.held.iter().map(|p| p.content.clone()));
        let lost = 1.0 - step.arrival;
        let thrice = lost * lost * lost;
        let old = if paper { thrice / (step.arrival + thrice) } else { 0.0 };
        let mut take = |told: &Foretold| score.push(told);
        let counts = !repeats && !step.packets.is_empty();
        unforetold += foreteller.step(step, trail, old, counts.then_some(&mut take));
        Ok(())
    };
    for packet in arriving(spec, packets) {
        let Ok(()) = link.push(packet.clone(), &mut one);
    }
    let Ok(()) = link.flush(&mut one);
    score.unforetold = unforetold;
    Ok(score)
}

/// Scores the causal `trail` that some estimator made of `packets`, by `spec`'s motion and sensors.
///
/// `packets` are as tables are read, less the sensors' latency, and become instants as [`track`](crate::pipeline::track) makes them.
/// `trail` has the state of the spec's model, and its rows must not have seen data later than themselves: the filter's half of a
/// smoother, never its smoothed rows. Only instants from `from_s` on are scored or counted, all without it; in a linear run without times
/// `from_s` is an instant's number.
///
/// # Errors
/// [`BuildError`] when the spec makes no model, or its link does not say when values were sensed.
pub fn score(
    spec: &Spec,
    anchors: &Anchors,
    packets: &TargetPackets,
    trail: &Trail,
    from_s: Option<f64>,
) -> Result<Score, BuildError> {
    let mut score = Score::default();
    let unforetold = each(spec, anchors, packets, trail, from_s, &mut |told| score.push(told))?;
    score.unforetold = unforetold;
    Ok(score)
}

/// As [`score`]; hands on the scalars in order of their instants, and returns how many no estimate came before.
///
/// # Errors
/// As [`score`].
pub fn each(
    spec: &Spec,
    anchors: &Anchors,
    packets: &TargetPackets,
    trail: &Trail,
    from_s: Option<f64>,
    hand_on: &mut dyn FnMut(&Foretold),
) -> Result<usize, BuildError> {
    if let Receiver::Unstamped { .. } = spec.link.receiver {
        let what = "is false: what the receiver holds may be old, and a predictive score expects values of known age";
        return Err(BuildError::new("spec", None, Some("link.stamped"), what));
    }
    let marginal = without_drift(spec);
    let mut foreteller = registry::foreteller(&marginal, anchors)?;
    if foreteller.n() != trail.n() {
        let what = format!("has {} states, the trail has {}", foreteller.n(), trail.n());
        return Err(BuildError::new("spec", None, Some("model"), what));
    }
    let from_s = from_s.unwrap_or(f64::NEG_INFINITY);
    let mut unforetold = 0;
    let mut link = Link::new(&spec.link, spec.model.prior().is_some());
    let mut one = |step: &Step<'_>| -> Result<(), Infallible> {
        let counts = step.packets.first().is_some_and(|p| p.t_s >= from_s);
        unforetold += foreteller.step(step, trail, 0.0, counts.then_some(&mut *hand_on));
        Ok(())
    };
    for packet in arriving(spec, packets) {
        let Ok(()) = link.push(packet.clone(), &mut one);
    }
    let Ok(()) = link.flush(&mut one);
    Ok(unforetold)
}

/// The spec with each drifting error as what it is to one who sees the trail alone: more noise.
fn without_drift(spec: &Spec) -> Spec {
    let mut spec = spec.clone();
    for sensor in &mut spec.sensors {
        if let Some(drift) = sensor.drift.take() {
            sensor.sd = drift.all().fold(sensor.sd, |sd, lasting| sd.hypot(lasting.sd));
        }
    }
    spec
}

/// A spec's motion and sensors carried along a trail, their dimension erased.
pub(crate) trait Foreteller {
    /// Number of state components.
    fn n(&self) -> usize;

    /// Goes on to the next instant; hands on its scalars, if anyone wants them, and returns how many of them no estimate came before. With
    /// probability `old` they are those of two instants before.
    fn step(&mut self, step: &Step<'_>, trail: &Trail, old: f64, hand_on: Option<&mut dyn FnMut(&Foretold)>) -> usize;
}

/// An estimate, and when it was made.
#[derive(Clone, Copy)]
struct Known<const N: usize> {
    k: u64,
    t_s: Option<f64>,
    belief: Belief<N>,
}

/// The only [`Foreteller`].
pub(crate) struct Carried<const N: usize> {
    model: Model<N>,
    /// Rows of the trail that are older than the instant.
    row: usize,
    known: Option<Known<N>>,
    /// The row of the trail before that.
    older: Option<Belief<N>>,
    /// The instant before and its input's push.
    before: Option<(u64, Vector<N>)>,
    held: HeldRows<N>,
}

impl<const N: usize> Carried<N> {
    pub(crate) fn new(model: Model<N>) -> Self {
        Self { model, row: 0, known: None, older: None, before: None, held: HeldRows::default() }
    }

    /// Takes the newest row of the trail before an instant.
    fn catch_up(&mut self, step: &Step<'_>, trail: &Trail) {
        let by_number = self.model.layout.is_linear();
        let is_before = |row: usize| match (trail.t_s[row], step.t_s) {
            (Some(row_s), Some(step_s)) if !by_number => row_s < step_s,
            _ => trail.k[row] < step.k,
        };
        let first = self.row;
        while self.row < trail.len() && is_before(self.row) {
            self.row += 1;
        }
        if self.row > first {
            let belief = |row: usize| {
                trail.mean(row).zip(trail.cov(row)).map(|(mean, cov)| Belief {
                    mean: Vector::from_column_slice(mean),
                    cov: Matrix::from_fn(|i, j| cov[Trail::packed_index(N, i.min(j), i.max(j))]),
                })
            };
            let row = self.row - 1;
            self.known = belief(row).map(|belief| Known { k: trail.k[row], t_s: trail.t_s[row], belief });
            self.older = row.checked_sub(1).and_then(belief);
        }
    }

    /// The estimate carried to an instant.
    fn foretell(&self, step: &Step<'_>) -> Option<Belief<N>> {
        let known = self.known.as_ref()?;
        let drive = self.before.filter(|(k, _)| *k == known.k).map_or(Vector::zeros(), |(_, drive)| drive);
        let dt_s = crate::filter::interval(known.t_s, step.t_s);
        Some(kalman::predict(&known.belief, &self.model.motion.leap(known.k, dt_s, &drive, &known.belief.mean)))
    }

    /// Hands on the scalars of one packet.
    fn packet(
        &mut self,
        step: &Step<'_>,
        packet: &[Packet],
        belief: Option<&Belief<N>>,
        old: f64,
        hand_on: &mut dyn FnMut(&Foretold),
    ) -> usize {
        // Where nothing is foretold the values are merely counted.
        let x = belief.map_or(Vector::zeros(), |b| b.mean);
        self.held.clear();
        self.model.sensing.held(&Step::new(step.k, step.t_s, packet), &x, &mut self.held);
        let q = self.held.values.len();
        let present = (0..q).filter(|i| self.held.values[*i].is_some());
        let Some(belief) = belief else { return present.count() };
        let told = |held: &HeldRows<N>, belief: &Belief<N>, i: usize| {
            let h = &held.h[i];
            let innovation = held.values[i].unwrap_or(f64::NAN) - held.expected[i];
            // What rounding leaves of a variance of 0 may be negative.
            (innovation, h.dot(&(belief.cov * h)).max(0.0) + held.r[i * q + i])
        };
        let before = self.older.filter(|_| old > 0.0);
        let mut was = HeldRows::default();
        if let Some(before) = &before {
            self.model.sensing.held(&Step::new(step.k, step.t_s, packet), &before.mean, &mut was);
        }
        for i in present {
            let (innovation, var) = told(&self.held, belief, i);
            let old = before.as_ref().map(|before| {
                let (innovation, var) = told(&was, before, i);
                Old { probability: old, innovation, var }
            });
            hand_on(&Foretold { k: step.k, t_s: step.t_s, kind: packet[0].content.kind(), innovation, var, old });
        }
        0
    }
}

impl<const N: usize> Foreteller for Carried<N> {
    fn n(&self) -> usize {
        N
    }

    fn step(&mut self, step: &Step<'_>, trail: &Trail, old: f64, hand_on: Option<&mut dyn FnMut(&Foretold)>) -> usize {
        self.catch_up(step, trail);
        let belief = self.foretell(step);
        let mut unforetold = 0;
        if let Some(hand_on) = hand_on {
            for packet in step.packets.chunks(1) {
                unforetold += self.packet(step, packet, belief.as_ref(), old, hand_on);
            }
        }
        if self.model.layout.is_linear() {
            // A trail may leave rows out; the matrices of a linear run are those of one step.
            self.known = belief.map(|belief| Known { k: step.k, t_s: step.t_s, belief });
        }
        self.before = Some((step.k, self.model.drive(step)));
        unforetold
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn normal(v: f64, var: f64) -> f64 {
        (-0.5 * v * v / var).exp() / (std::f64::consts::TAU * var).sqrt()
    }

    #[test]
    fn the_density_is_the_mixture_and_outliers_cost_little() {
        let cauchy = |v: f64, g: f64| 1.0 / (std::f64::consts::PI * g * (1.0 + v * v / (g * g)));
        for (v, var) in [(0.0, 1.0), (0.3, 0.02), (-4.0, 2.0), (9.0, 1.0), (1e3, 4.0)] {
            let direct = (0.95 * normal(v, var) + 0.05 * cauchy(v, 10.0 * f64::sqrt(var))).ln();
            // A few roundings of numbers of size 10.
            assert!((log_density(v, var) - direct).abs() < 1e-13, "{v} {var}");
        }
        // The numbers above: 50 and a million standard deviations off.
        assert_eq!([50.0, 1e6].map(|v| log_density(v, 1.0).round()), [-10.0, -29.0]);
        // It is a density: the midpoint rule over φ with ν = 10 √S tan φ, whose integrand is smooth and periodic.
        let integrand = |phi: f64| log_density(20.0 * phi.tan(), 4.0).exp() * 20.0 / phi.cos().powi(2);
        let n = 20_000;
        let at = |i: usize| -std::f64::consts::FRAC_PI_2 + (i as f64 + 0.5) / n as f64 * std::f64::consts::PI;
        let total: f64 = (0..n).map(|i| integrand(at(i))).sum::<f64>() * std::f64::consts::PI / n as f64;
        assert!((total - 1.0).abs() < 1e-9, "{total}");
        assert_eq!(log_density(f64::NAN, 1.0), f64::NEG_INFINITY);
    }

    #[test]
    fn a_value_that_may_be_old_has_the_density_of_the_mixture() {
        let old = Old { probability: 0.3, innovation: -2.0, var: 0.5 };
        let told = Foretold { k: 1, t_s: None, kind: Kind::Range, innovation: 1.0, var: 4.0, old: Some(old) };
        let (a, b) = (0.7 * log_density(1.0, 4.0).exp(), 0.3 * log_density(-2.0, 0.5).exp());
        assert!((told.log_density() - (a + b).ln()).abs() < 1e-12);
        assert!((told.nis() - (a * 0.25 + b * 8.0) / (a + b)).abs() < 1e-12);
        let surely_new = Foretold { old: Some(Old { probability: 0.0, ..old }), ..told };
        assert_eq!((surely_new.log_density(), surely_new.nis()), (log_density(1.0, 4.0), 0.25));
    }

    #[test]
    fn sizes_take_the_middle_and_scores_add_up() {
        let told = |innovation: f64| Foretold { k: 0, t_s: None, kind: Kind::Range, innovation, var: 4.0, old: None };
        let of = |values: &[f64]| {
            let mut score = Score::default();
            values.iter().for_each(|v| score.push(&told(*v)));
            score
        };
        let mut sum = of(&[-3.0, 1.0]);
        assert_eq!(sum.sizes().next().unwrap(), (Kind::Range, Size { scalars: 2, rms: 5.0_f64.sqrt(), median: 2.0 }));
        sum.add(&of(&[2.0]));
        assert_eq!(sum, of(&[-3.0, 1.0, 2.0]));
        assert_eq!(sum.sizes().next().unwrap().1.median, 2.0);
        assert_eq!(sum.mean_nis(), Some(14.0 / 12.0));
        assert_eq!((Score::default().mean_log_density(), Score::default().sizes().count()), (None, 0));
    }
}
