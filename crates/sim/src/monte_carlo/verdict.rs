//! Whether a contender errs as it claims, in one sentence.

use super::sample::Sample;
use super::summary::Estimated;
use crate::metrics::{chi_square_quantile, student_quantile};

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
    /// interval of their mean, by Student's distribution. The mean of a consistent estimator spreads no wider than if all instants of a run
    /// said the same, which is chi-square with its degrees of freedom times the runs; where that interval is the narrower one it counts, so
    /// that few very large values do not hide behind their own spread.
    pub fn of<'a>(samples: impl Iterator<Item = &'a Sample> + Clone) -> Verdict {
        let diverges = Estimated::of(samples.clone().map(|s| f64::from(u8::from(s.lost))));
        let kept = samples.filter(|s| !s.lost && s.estimated > 0);
        let ratio = Estimated::of(kept.clone().map(|s| s.nees));
        let runs = kept.clone().count();
        let n = kept.clone().next().map_or(0, |s| s.mean_square.len());
        let dof = n * runs;
        let by_chi_square = |p: f64| (chi_square_quantile(dof, p) / dof as f64 - 1.0).abs();
        let student = if runs > 1 { student_quantile(runs as f64 - 1.0, 1.0 - 0.5 * CHANCE) * ratio.se } else { 0.0 };
        let claim = match () {
            () if runs < 2 => Claim::NotJudged,
            () if !(ratio.mean - student.min(by_chi_square(1.0 - 0.5 * CHANCE)) <= 1.0) => Claim::Optimistic,
            () if ratio.mean + student.min(by_chi_square(0.5 * CHANCE)) < 1.0 => Claim::Pessimistic,
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
    let shown = |v: Estimated| {
        let decimals = if v.mean < 10.0 { 2 } else { 0 };
        format!("{:.decimals$} ± {:.decimals$}", v.mean, v.se)
    };
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Runs with these mean NEES of two components; those above 1000 have lost their target.
    fn verdict(nees: &[f64]) -> Verdict {
        let sample = |nees: &f64| Sample {
            mean_abs: vec![0.0; 2],
            mean_square: vec![0.0; 2],
            claimed: vec![0.0; 2],
            nees: *nees,
            nis: None,
            coverage: [0.0; 2],
            position_m: None,
            lost: nees.is_finite() && *nees > 1000.0,
            estimated: 1,
            missing: 0,
            failed: None,
            energy_mj: None,
            time_steps: None,
            instants: Vec::new(),
        };
        let samples: Vec<Sample> = nees.iter().map(sample).collect();
        Verdict::of(samples.iter())
    }

    #[test]
    fn a_claim_is_called_wrong_only_beyond_its_interval() {
        // Mean ± 0.01 each; Student's 99.5 % quantile of 3 degrees of freedom is 5.84: four values have a half width of 0.0337.
        let around = |mean: f64| [mean - 0.01, mean + 0.01, mean - 0.01, mean + 0.01];
        for (mean, claim) in [
            (1.03, Claim::Consistent),
            (1.04, Claim::Optimistic),
            (0.97, Claim::Consistent),
            (0.96, Claim::Pessimistic),
        ] {
            assert_eq!(verdict(&around(mean)).claim, claim, "{mean}");
        }
        let half = verdict(&around(0.5));
        assert!((half.factor.unwrap().mean - 2.0).abs() < 1e-12, "{half:?}");
        assert!(half.sentence.starts_with("pessimistic by a factor of 2.00 ± 0.02"), "{half:?}");
        assert_eq!(verdict(&[7.0]).claim, Claim::NotJudged);
    }

    #[test]
    fn few_very_large_values_do_not_hide_behind_their_own_spread() {
        // Student's interval of these reaches below 1; 5 runs of 2 components are chi-square with 10 degrees of freedom, at most 2.52 of 1.
        let found = verdict(&[1.0, 1.0, 1.0, 1.0, 400.0]);
        assert_eq!(found.claim, Claim::Optimistic, "{found:?}");
        assert_eq!(verdict(&[f64::INFINITY, 1.0]).claim, Claim::Optimistic);
    }

    #[test]
    fn lost_runs_are_told_apart_from_the_rest() {
        let found = verdict(&[1e6, 0.99, 1.01, 0.99, 1.01]);
        assert_eq!((found.claim, found.diverges.mean), (Claim::Consistent, 0.2));
        assert!(
            found.sentence.starts_with("diverges in 20.0 ± 20.0 % of the runs; in the others consistent"),
            "{found:?}"
        );
        assert_eq!(verdict(&[1e6, 1e6]).sentence, "diverges in every run");
    }
}
