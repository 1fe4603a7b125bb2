//! What can be known of a target before its first packet: the error that a spec leaves at an arrival rate, and the rate it needs.
//!
//! \[SIN04\] for the spec's model and sensors, see [`fixtrail_core::riccati`]. The bounds are those of a Kalman filter that knows which packets
//! have arrived; each instant's packets arrive together or not at all, independently of other instants.

use crate::dims::with_size;
use crate::model::{process_noise, row_vectors, square};
use crate::packet::Kind;
use crate::registry;
use crate::spec::{ArrivalSpec, KinematicSpec, ModelSpec, Receiver, SensorSpec, Spec};
use crate::survey::{Basis, Loss, Survey, short};
use fixtrail_core::Vector;
use fixtrail_core::models::Integrators;
pub use fixtrail_core::riccati::CriticalRate;
use fixtrail_core::riccati::Lossy;

/// What theory says of a spec at an arrival rate.
#[derive(Clone, Debug, PartialEq)]
pub struct Theory {
    /// Probability that an instant's packets arrive.
    pub arrival: f64,
    /// The interval between instants that it holds for, seconds; `None` for a linear model, whose step is its own.
    pub interval_s: Option<f64>,
    /// Largest magnitude of an eigenvalue of A.
    pub spectral_radius: f64,
    /// Whether the state runs away by itself.
    pub is_unstable: bool,
    /// The arrival rate above which the error stays bounded.
    pub critical: CriticalRate,
    /// Whether it does at this arrival rate.
    pub verdict: Verdict,
    /// Each component of the state.
    pub states: Vec<StateBounds>,
    /// What makes errors larger than that.
    pub caveats: Vec<&'static str>,
}

/// Whether the expected squared error stays bounded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// From any start.
    Bounded,
    /// Not from every start.
    Unbounded,
    /// The arrival rate lies between the bounds on the critical one.
    Undecided,
}

impl Verdict {
    /// The word for it.
    pub fn name(self) -> &'static str {
        match self {
            Verdict::Bounded => "bounded",
            Verdict::Unbounded => "unbounded",
            Verdict::Undecided => "undecided",
        }
    }
}

/// The error of one component of the state in the long run: roots of mean variances.
#[derive(Clone, Debug, PartialEq)]
pub struct StateBounds {
    /// Its name.
    pub name: String,
    /// Before an instant's packets are used.
    pub predicted: Bounds,
    /// After.
    pub filtered: Bounds,
}

/// Bounds on a standard deviation, in the unit of the state. `None` where there is none, or where its computation does not settle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// At least this much at the arrival rate.
    pub lower: Option<f64>,
    /// At most this much.
    pub upper: Option<f64>,
    /// Exactly this much when nothing is lost.
    pub lossless: Option<f64>,
}

/// Where an arrival rate comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// `link.arrival`.
    Spec,
    /// Measured in the data.
    Measured(Basis),
    /// Nothing is known of losses: none are assumed.
    Assumed,
}

impl Source {
    /// Where it comes from, in words.
    pub fn text(self) -> String {
        match self {
            Source::Spec => "by `link.arrival`".to_owned(),
            Source::Measured(basis) => format!("measured by {}", basis.name()),
            Source::Assumed => "assumed, the data do not tell their losses".to_owned(),
        }
    }
}

const HELD_UNSTABLE: &str = "without time stamps no linear filter (`lmvf`, `lmmse`, `emvf`) keeps a bounded error at any arrival rate \
                             below 1: the old and the new value that it cannot tell apart differ ever more. `gpb1` tells most of them \
                             apart, time stamps all";
const HELD: &str = "the bounds are for a filter that knows which values are new; without time stamps errors are larger";

const BURSTS: &str = "the bounds are for independent losses; these come in bursts, which do more harm";

/// Returns what theory says of `spec` for the data of a survey, and where the arrival rate comes from.
///
/// The rate is `link.arrival` where it is one number, else one less the measured loss; the interval is the usual one.
///
/// # Errors
/// As [`theory`].
pub fn theory_for(spec: &Spec, survey: &Survey) -> Result<(Theory, Source), String> {
    let (arrival, source) = match (&spec.link.arrival, &survey.loss) {
        (Some(ArrivalSpec::Constant(p)), _) => (*p, Source::Spec),
        (_, Some(loss)) => (1.0 - loss.rate(), Source::Measured(loss.basis)),
        (_, None) => (1.0, Source::Assumed),
    };
    let mut told = theory(spec, survey.usual_interval_s(), arrival)?;
    if survey.loss.as_ref().is_some_and(Loss::is_bursty) {
        told.caveats.push(BURSTS);
    }
    Ok((told, source))
}

/// Returns what theory says of `spec` when each instant's packets arrive with probability `arrival`.
///
/// `interval_s` is the interval between instants of a kinematic model; a linear model needs none.
///
/// # Errors
/// A clause that says why nothing can be said: matrices that vary, a model or sensor that is not linear, no interval, an arrival rate that
/// is no probability.
pub fn theory(spec: &Spec, interval_s: Option<f64>, arrival: f64) -> Result<Theory, String> {
    if !(0.0..=1.0).contains(&arrival) {
        return Err(format!("the arrival rate is {arrival}, expected a probability"));
    }
    let n = registry::layout(spec).n();
    let unknown = || Err("the state has a size that is not known".to_owned());
    with_size!(n, N => Ok(describe(spec, &system::<N>(spec, interval_s)?, interval_s, arrival)), unknown())
}

/// Returns the standard deviation of each component of the state in the long run that a smoother leaves which stands each of `lags` instants
/// behind the newest data, nothing lost; no lag is one that has all later data. `None` for a lag at which there is no steady state.
///
/// # Errors
/// As [`theory`].
pub fn smoothed(spec: &Spec, interval_s: Option<f64>, lags: &[Option<u32>]) -> Result<Vec<Option<Vec<f64>>>, String> {
    fn each<const N: usize>(system: &Lossy<N>, lags: &[Option<u32>]) -> Vec<Option<Vec<f64>>> {
        let steady = system.upper_bound(1.0);
        let of_lag = |lag: &Option<u32>| {
            let p = system.lagged(steady.as_ref()?, *lag)?;
            Some((0..N).map(|i| p[(i, i)].max(0.0).sqrt()).collect())
        };
        lags.iter().map(of_lag).collect()
    }
    let n = registry::layout(spec).n();
    let unknown = || Err("the state has a size that is not known".to_owned());
    with_size!(n, N => Ok(each(&system::<N>(spec, interval_s)?, lags)), unknown())
}

/// The spec's model as one linear time-invariant system.
fn system<const N: usize>(spec: &Spec, interval_s: Option<f64>) -> Result<Lossy<N>, String> {
    let refused = || "its matrices make no system".to_owned();
    match &spec.model {
        ModelSpec::Turn(_) => Err("a coordinated turn is not linear".to_owned()),
        ModelSpec::GaussMarkov(_) => Err("a stationary motion is bounded at every arrival rate".to_owned()),
        ModelSpec::Linear(linear) if !linear.sequence.is_empty() => {
            Err("the matrices vary from step to step".to_owned())
        }
        ModelSpec::Linear(linear) => {
            let step = &linear.base;
            let (w, c) = (process_noise(step), row_vectors(&step.c));
            Lossy::new(&square(&step.a), &w, &c, &step.r.data).ok_or_else(refused)
        }
        ModelSpec::Kinematic(model) => {
            let position = positions(&spec.sensors)?;
            let dt_s = interval_s.filter(|dt| *dt > 0.0 && dt.is_finite());
            let dt_s = dt_s.ok_or_else(|| "the interval between instants is not known".to_owned())?;
            let leap = integrators::<N>(model).ok_or_else(refused)?.leap(&Vector::zeros(), dt_s);
            let axes = model.axes;
            let c: Vec<Vector<N>> =
                (0..axes).map(|axis| Vector::from_fn(|i, _| if i == axis { 1.0 } else { 0.0 })).collect();
            let r: Vec<f64> =
                (0..axes * axes).map(|e| if e / axes == e % axes { position.sd.powi(2) } else { 0.0 }).collect();
            Lossy::new(&leap.f, &leap.q, &c, &r).ok_or_else(refused)
        }
    }
}

/// The position sensor, when there is no other kind.
fn positions(sensors: &[SensorSpec]) -> Result<&SensorSpec, String> {
    if let Some(other) = sensors.iter().find(|s| s.kind != Kind::Position) {
        return Err(format!("values of kind `{}` are not linear in the state", other.kind.name()));
    }
    sensors.first().ok_or_else(|| "nothing is measured".to_owned())
}

fn integrators<const N: usize>(model: &KinematicSpec) -> Option<Integrators<N>> {
    let mut psd = [0.0; 3];
    for (p, noise) in psd.iter_mut().zip(&model.noise) {
        *p = *noise;
    }
    Integrators::new(model.order, model.axes, psd).ok()
}

fn describe<const N: usize>(spec: &Spec, system: &Lossy<N>, interval_s: Option<f64>, arrival: f64) -> Theory {
    let critical = system.critical_rate();
    let is_unstable = system.is_unstable();
    let spread = system.lower_bound(arrival);
    let verdict = match critical.upper {
        // At rate 0 it is what the model alone allows.
        Some(upper) if arrival > upper || (arrival >= upper && spread.is_some()) => Verdict::Bounded,
        Some(_) if spread.is_some() => Verdict::Undecided,
        _ => Verdict::Unbounded,
    };
    let bound = |exists: bool, arrival: f64| if exists { system.upper_bound(arrival) } else { None };
    let upper = bound(verdict == Verdict::Bounded, arrival);
    let lossless = bound(critical.upper.is_some(), 1.0);
    let after = upper.map(|x| system.filtered(&x, arrival));
    let lossless_after = lossless.map(|x| system.filtered(&x, 1.0));
    let states = registry::layout(spec)
        .names
        .into_iter()
        .enumerate()
        .map(|(i, name)| {
            // Losses never help, so the error without them bounds every other from below too.
            let bounds = |least: Option<f64>, most: Option<f64>, lossless: Option<f64>| Bounds {
                lower: least.map(|v| v.max(lossless.unwrap_or(0.0)).max(0.0).sqrt()),
                upper: most.map(|v| v.max(0.0).sqrt()),
                lossless: lossless.map(|v| v.max(0.0).sqrt()),
            };
            let at = |m: &Option<fixtrail_core::Matrix<N, N>>| m.as_ref().map(|m| m[(i, i)]);
            StateBounds {
                name,
                predicted: bounds(at(&spread), at(&upper), at(&lossless)),
                filtered: bounds(at(&spread).map(|v| (1.0 - arrival) * v), at(&after), at(&lossless_after)),
            }
        })
        .collect();
    let caveats = match spec.link.receiver {
        Receiver::Stamped { .. } => Vec::new(),
        Receiver::Unstamped { .. } => vec![if is_unstable { HELD_UNSTABLE } else { HELD }],
    };
    Theory {
        arrival,
        interval_s: interval_s.filter(|_| matches!(spec.model, ModelSpec::Kinematic(_))),
        spectral_radius: system.spectral_radius(),
        is_unstable,
        critical,
        verdict,
        states,
        caveats,
    }
}

impl Theory {
    /// Returns the assumption in a clause: "when 90 % of the packets arrive (by `link.arrival`), an instant every 0.1 s".
    pub fn assumption(&self, source: Source) -> String {
        let every = self.interval_s.map_or(String::new(), |s| format!(", an instant every {} s", short(s)));
        format!("when {} % of the packets arrive ({}){every}", short(100.0 * self.arrival), source.text())
    }

    /// Returns in sentences what arrival rate the model needs, whether it has it, and what else has to be said.
    pub fn sentences(&self) -> Vec<String> {
        let radius = short(self.spectral_radius);
        let nature = match self.spectral_radius {
            _ if self.is_unstable => format!("the model runs away by itself (spectral radius {radius})"),
            r if r < 1.0 - 1e-9 => format!("the model comes to rest by itself (spectral radius {radius})"),
            _ => "the model keeps what it has (spectral radius 1)".to_owned(),
        };
        let need = match self.critical {
            CriticalRate { upper: None, .. } => {
                "its measurements do not show all of it, so errors grow without bound whatever arrives".to_owned()
            }
            CriticalRate { upper: Some(0.0), .. } if self.spectral_radius < 1.0 - 1e-9 => {
                "errors stay bounded whatever arrives".to_owned()
            }
            CriticalRate { upper: Some(0.0), .. } => "errors stay bounded at any arrival rate above 0".to_owned(),
            CriticalRate { lower, upper: Some(upper) } if upper - lower < 5e-4 => {
                format!("errors stay bounded when the arrival rate is above {}, and not below", short(upper))
            }
            CriticalRate { lower, upper: Some(upper) } => format!(
                "errors stay bounded when the arrival rate is above {}, and not when it is below {}; between them theory does not decide",
                short(upper),
                short(lower)
            ),
        };
        let mut out = vec![format!("{nature}: {need}")];
        let rate = short(self.arrival);
        let settled = self.states.iter().all(|s| s.predicted.upper.is_some());
        match self.verdict {
            _ if self.critical.upper.is_none() => {}
            Verdict::Bounded if !settled => {
                out.push(format!("at {rate} they are, but so close to that rate that no upper bound was found"));
            }
            Verdict::Bounded if self.is_unstable => out.push(format!("at {rate} they do")),
            Verdict::Bounded => {}
            Verdict::Unbounded => out.push(format!("at {rate} they grow without bound")),
            Verdict::Undecided => out.push(format!("{rate} lies between")),
        }
        out.extend(self.caveats.iter().map(|c| (*c).to_owned()));
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spec::parse;
    use std::path::Path;

    fn spec(text: &str) -> Spec {
        parse(
            &format!("version = 1\n{text}"),
            Path::new("spec.toml"),
            &mut |_| Err(std::io::ErrorKind::NotFound.into()),
        )
        .unwrap_or_else(|e| panic!("{e}: {text}"))
    }

    fn linear(a: &str, c: &str, r: &str, link: &str) -> Spec {
        let identity = "[[20, 0], [0, 20]]";
        let prior = "x0 = [0, 0]\nP0 = [[1, 0], [0, 1]]";
        let estimator = if link.is_empty() { "kalman" } else { "gpb1" };
        spec(&format!(
            "[model]\nkind = \"linear\"\nA = {a}\nC = {c}\nQ = {identity}\nR = {r}\n{prior}\n[estimator]\nkind = \"{estimator}\"\n{link}"
        ))
    }

    fn walk(kind: &str, noise: &str, sd: f64, more: &str) -> Spec {
        spec(&format!(
            "[model]\nkind = \"{kind}\"\naxes = 2\nnoise = {noise}\n[estimator]\nkind = \"kalman\"\n[sensor]\nkind = \"position\"\nsd = {sd}\n{more}"
        ))
    }

    const UNSTABLE: &str = "[[1.25, 0], [1, 1.1]]";

    #[test]
    fn verdict_changes_at_both_bounds_of_the_critical_rate() {
        let spec = linear(UNSTABLE, "[[1, 1]]", "[[2.5]]", "");
        // 0.36 and 0.4711, as the tests of the core show.
        for (arrival, verdict) in [
            (0.0, Verdict::Unbounded),
            (0.355, Verdict::Unbounded),
            (0.365, Verdict::Undecided),
            (0.466, Verdict::Undecided),
            (0.476, Verdict::Bounded),
            (1.0, Verdict::Bounded),
        ] {
            let theory = theory(&spec, None, arrival).expect("linear");
            assert_eq!(theory.verdict, verdict, "{arrival}");
            for state in &theory.states {
                assert_eq!(state.predicted.upper.is_some(), verdict == Verdict::Bounded, "{arrival}");
                assert_eq!(state.predicted.lower.is_some(), verdict != Verdict::Unbounded, "{arrival}");
                assert!(state.predicted.lossless.is_some() && state.filtered.lossless.is_some());
            }
        }
    }

    #[test]
    fn bounds_enclose_one_another_and_meet_at_certain_arrival() {
        let spec = linear(UNSTABLE, "[[1, 1]]", "[[2.5]]", "");
        let mut last = f64::INFINITY;
        for arrival in [0.5, 0.6, 0.8, 0.95, 1.0] {
            let theory = theory(&spec, None, arrival).expect("linear");
            for state in &theory.states {
                for b in [state.predicted, state.filtered] {
                    let (lower, upper, lossless) = (b.lower.unwrap(), b.upper.unwrap(), b.lossless.unwrap());
                    // At rate 1 all three are one number.
                    assert!(lossless <= lower && lower <= upper, "{arrival}: {b:?}");
                    assert!(arrival < 1.0 || upper == lossless, "{b:?}");
                }
                assert!(state.filtered.upper < state.predicted.upper, "{state:?}");
            }
            let upper = theory.states[0].predicted.upper.unwrap();
            assert!(upper < last, "{arrival}: {upper} after {last}");
            last = upper;
        }
    }

    #[test]
    fn random_walk_at_an_interval_has_the_closed_form_on_every_axis() {
        let (psd, sd, dt, arrival) = (0.04_f64, 0.5_f64, 0.25_f64, 0.7_f64);
        let theory = theory(&walk("random-walk", "0.04", sd, ""), Some(dt), arrival).expect("positions");
        assert_eq!((theory.verdict, theory.interval_s, theory.is_unstable), (Verdict::Bounded, Some(dt), false));
        // a = 1: x = x + w − λx²/(x + r)  ⇔  λx² − w x − w r = 0, with w = psd dt, r = sd².
        let (w, r) = (psd * dt, sd * sd);
        let upper = |p: f64| (w + (w * w + 4.0 * p * w * r).sqrt()) / (2.0 * p);
        for state in &theory.states {
            let of = |b: Option<f64>| b.unwrap().powi(2);
            // The recursion promises 1e-9 of a variance.
            assert!((of(state.predicted.upper) / upper(arrival) - 1.0).abs() < 1e-9);
            assert!((of(state.predicted.lossless) / upper(1.0) - 1.0).abs() < 1e-9);
            // Filtered is predicted less one interval's noise.
            assert!((of(state.filtered.upper) / (upper(arrival) - w) - 1.0).abs() < 1e-8);
        }
        assert_eq!(theory.states.iter().map(|s| s.name.as_str()).collect::<Vec<_>>(), ["x", "y"]);
        let doubled = super::theory(&walk("random-walk", "0.04", sd, ""), Some(2.0 * dt), arrival).expect("positions");
        assert!(doubled.states[0].predicted.upper > theory.states[0].predicted.upper);
    }

    #[test]
    fn kinematic_chain_is_bounded_at_any_rate_above_zero() {
        for kind in ["random-walk", "constant-velocity", "constant-acceleration"] {
            let spec = walk(kind, "[0.5, 0.1]", 0.3, "");
            let at = |p| theory(&spec, Some(0.1), p).expect("positions");
            assert_eq!(
                [0.0, 0.05, 1.0].map(|p| at(p).verdict),
                [Verdict::Unbounded, Verdict::Bounded, Verdict::Bounded],
                "{kind}"
            );
            assert_eq!((at(0.5).critical.lower, at(0.5).critical.upper), (0.0, Some(0.0)), "{kind}");
            // The livelier axis errs more.
            assert!(at(0.5).states[0].filtered.upper > at(0.5).states[1].filtered.upper, "{kind}");
        }
    }

    #[test]
    fn stable_model_is_bounded_without_any_arrival() {
        let theory = theory(&linear("[[0.6, 0], [0.8, 0.5]]", "[[1, 0]]", "[[1]]", ""), None, 0.0).expect("linear");
        assert_eq!((theory.verdict, theory.critical.upper), (Verdict::Bounded, Some(0.0)));
        // 20/(1 − 0.36) = 31.25, the first state by itself.
        assert!((theory.states[0].predicted.upper.unwrap().powi(2) / 31.25 - 1.0).abs() < 1e-9);
        assert!(theory.sentences()[0].contains("whatever arrives"), "{:?}", theory.sentences());
    }

    #[test]
    fn unseen_state_is_unbounded_whatever_arrives() {
        let theory = theory(&linear("[[1, 0], [0, 1.2]]", "[[1, 0]]", "[[1]]", ""), None, 1.0).expect("linear");
        assert_eq!((theory.verdict, theory.critical.upper), (Verdict::Unbounded, None));
        assert!(theory.sentences()[0].contains("do not show all of it"), "{:?}", theory.sentences());
    }

    #[test]
    fn link_without_time_stamps_warns_of_linear_filters_where_the_model_is_unstable() {
        let unstamped = "[link]\nstamped = false\narrival = 0.9";
        let caveat =
            |a: &str, link: &str| theory(&linear(a, "[[1, 1]]", "[[2.5]]", link), None, 0.9).expect("linear").caveats;
        let warning = caveat(UNSTABLE, unstamped)[0];
        assert!(warning.contains("`lmvf`, `lmmse`, `emvf`") && warning.contains("`gpb1`"), "{warning}");
        assert!(!caveat("[[0.6, 0], [0.8, 0.5]]", unstamped)[0].contains("`lmvf`"));
        assert!(caveat(UNSTABLE, "").is_empty());
    }

    #[test]
    fn rate_is_the_spec_s_or_the_measured_one_and_bursts_are_told() {
        use crate::packet::{Content, Packet};
        use crate::target::TargetPackets;
        let looked = |is_lost: fn(u64) -> bool| {
            let packets = (0..1000).filter(|k| !is_lost(*k)).map(|k| Packet {
                seq: Some(k),
                ..Packet::new(0.5 * k as f64, Content::Position([Some(0.0), Some(0.0), None]), k + 1)
            });
            let target = TargetPackets { target: None, packets: packets.collect() };
            crate::survey::survey(&[target], &crate::anchors::Anchors::default())
        };
        let (single, burst) = (looked(|k| k % 10 == 5), looked(|k| k % 40 >= 20 && k % 40 < 24));
        let own = walk("random-walk", "0.04", 0.5, "");
        for (survey, caveats) in [(&single, 0), (&burst, 1)] {
            let (told, source) = theory_for(&own, survey).expect("positions");
            // 100 of 1000 lost, all between others.
            assert_eq!((told.arrival, source, told.interval_s), (0.9, Source::Measured(Basis::Sequence), Some(0.5)));
            assert_eq!(told.caveats.len(), caveats, "{:?}", told.caveats);
        }
        let given = walk("random-walk", "0.04", 0.5, "[link]\narrival = 0.7\n");
        let (told, source) = theory_for(&given, &single).expect("positions");
        assert_eq!((told.arrival, source), (0.7, Source::Spec));
        let silent = crate::survey::Survey { loss: None, ..single };
        let (told, source) = theory_for(&own, &silent).expect("positions");
        assert_eq!((told.arrival, source), (1.0, Source::Assumed));
    }

    #[test]
    fn what_is_not_linear_or_varies_is_refused_with_a_reason() {
        let ranges = spec(
            "[model]\nkind = \"constant-velocity\"\naxes = 2\nnoise = 0.5\n[estimator]\nkind = \"ekf\"\n[sensor]\nkind = \"range\"\nsd = 0.1",
        );
        let turn = spec(
            "[model]\nkind = \"coordinated-turn\"\nnoise = 0.5\nturn_noise = 0.1\n[estimator]\nkind = \"ekf\"\n[sensor]\nkind = \"position\"\nsd = 0.1",
        );
        let mut varying = linear(UNSTABLE, "[[1, 1]]", "[[2.5]]", "");
        if let ModelSpec::Linear(model) = &mut varying.model {
            model.sequence = vec![model.base.clone()];
        }
        let walk = walk("random-walk", "0.04", 0.5, "");
        for (spec, interval_s, arrival, part) in [
            (&ranges, Some(0.1), 0.9, "`range` are not linear"),
            (&turn, Some(0.1), 0.9, "turn is not linear"),
            (&varying, None, 0.9, "vary from step to step"),
            (&walk, None, 0.9, "interval"),
            (&walk, Some(0.0), 0.9, "interval"),
            (&walk, Some(0.1), 1.1, "1.1"),
            (&walk, Some(0.1), f64::NAN, "NaN"),
        ] {
            let why = theory(spec, interval_s, arrival).expect_err(part);
            assert!(why.contains(part), "{why}");
        }
    }
}
