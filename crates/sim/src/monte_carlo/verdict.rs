//! Whether a contender errs as it claims, in one sentence.

use super::sample::Sample;
use super::summary::Estimated;
use crate::metrics::student_quantile;

/// What a contender's claims are worth.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Claim {
    /// Errors are as claimed, as far as the runs can tell.
    Consistent,
    /// Errors are larger: the claimed variance is too small.
    Optimistic,
    /// Errors are smaller: the claimed variance is too large.
    Pessimistic,
    /// Nothing to judge, or a single run.
    NotJudged,
}

impl Claim {
    /// The word for it.
    pub fn name(self) -> &'static str {
        match self {
            Claim::Consistent => "consistent",
            Claim::Optimistic => "optimistic",
            Claim::Pessimistic => "pessimistic",
            Claim::NotJudged => "not judged",
        }
    }
}

/// The verdict on a contender.
#[derive(Clone, Debug, PartialEq)]
pub struct Verdict {
    /// Of the runs that did not lose their target.
    pub claim: Claim,
    /// By how much the claimed variance is too small or too large in these runs: 1 or more, with its standard error; none of others.
    pub factor: Option<Estimated>,
    /// Share of the runs that lost their target.
    pub diverges: Estimated,
    /// All of it in words.
    pub sentence: String,
}

/// Chance of a wrong word about a consistent contender, both sides together.
const CHANCE: f64 = 0.01;

impl Verdict {
    /// The verdict on a contender's samples.
    ///
    /// Errors of neighbouring instants are correlated, so the mean NEES of each run counts as one value: the claim is judged by the 99 %
    /// interval of their mean, by Student's distribution.
    pub fn of<'a>(samples: impl Iterator<Item = &'a Sample> + Clone) -> Verdict {
        let diverges = Estimated::of(samples.clone().map(|s| f64::from(u8::from(s.lost))));
        let kept = samples.filter(|s| !s.lost && s.estimated > 0);
        let ratio = Estimated::of(kept.clone().map(|s| s.nees));
        let runs = kept.count();
        let reach = if runs > 1 { student_quantile(runs as f64 - 1.0, 1.0 - 0.5 * CHANCE) * ratio.se } else { 0.0 };
        let claim = match () {
            () if runs < 2 => Claim::NotJudged,
            () if ratio.mean.is_infinite() || ratio.mean - reach > 1.0 => Claim::Optimistic,
            () if ratio.mean + reach < 1.0 => Claim::Pessimistic,
            () => Claim::Consistent,
        };
        let factor = match claim {
            Claim::Optimistic => Some(ratio),
            // The error of 1/f is that of f over f².
            Claim::Pessimistic => Some(Estimated { mean: 1.0 / ratio.mean, se: ratio.se / (ratio.mean * ratio.mean) }),
            _ => None,
        };
        let sentence = sentence(claim, ratio, factor, diverges, runs);
        Verdict { claim, factor, diverges, sentence }
    }
}

fn sentence(claim: Claim, ratio: Estimated, factor: Option<Estimated>, diverges: Estimated, runs: usize) -> String {
    let shown = |v: Estimated| format!("{:.2} ± {:.2}", v.mean, v.se);
    let judged = match (claim, factor) {
        (Claim::NotJudged, _) if runs == 1 => "not judged by a single run".to_owned(),
        (Claim::NotJudged, _) => "nothing to judge".to_owned(),
        (Claim::Optimistic, _) if ratio.mean.is_infinite() => "claims to know exactly what it does not".to_owned(),
        (Claim::Optimistic, Some(f)) => {
            format!("optimistic by a factor of {}: the variance that it claims is too small", shown(f))
        }
        (Claim::Pessimistic, Some(f)) => {
            format!("pessimistic by a factor of {}: the variance that it claims is too large", shown(f))
        }
        _ => format!("consistent: squared errors are {} times what it claims", shown(ratio)),
    };
    match diverges.mean {
        0.0 => judged,
        1.0 => "diverges in every run".to_owned(),
        share => format!(
            "diverges in {:.1} ± {:.1} % of the runs; in the others {judged}",
            100.0 * share,
            100.0 * diverges.se
        ),
    }
}
