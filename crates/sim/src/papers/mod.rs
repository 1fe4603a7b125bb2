//! What three papers print and state, and what comes of it here.
//!
//! An [`Account`] has an [`Entry`] for every printed number and every stated claim, and our curves for every figure. Verdicts are computed
//! from what was measured, never written down.

pub mod fms;
pub mod fosb;
pub mod mvf;

use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use std::fmt;

/// A paper that is accounted for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Paper {
    /// \[FMS19\], the finite-memory filter and smoother.
    Fms,
    /// \[MVF10\], optimal filters with multiple packet losses.
    Mvf,
    /// \[FOSB12\], forward and one-step-backward message passing.
    Fosb,
}

impl Paper {
    /// Every paper, in the order of the accounts.
    pub const ALL: [Paper; 3] = [Paper::Fms, Paper::Mvf, Paper::Fosb];

    /// Its short name.
    pub fn name(self) -> &'static str {
        match self {
            Paper::Fms => "fms",
            Paper::Mvf => "mvf",
            Paper::Fosb => "fosb",
        }
    }

    /// Authors, title, year.
    pub fn title(self) -> &'static str {
        match self {
            Paper::Fms => {
                "P. S. Kim, Finite Memory Structure Filtering and Smoothing for Target Tracking in Wireless Network Environments, 2019"
            }
            Paper::Mvf => {
                "Y. Liu, B. Xu, L. Feng, S. Li, Optimal Filters with Multiple Packet Losses and its Application in Wireless Sensor \
                 Networks, 2010"
            }
            Paper::Fosb => {
                "Y.-S. Chiou, F. Tsai, C.-L. Wang, C.-T. Huang, A reduced-complexity scheme using message passing for location tracking, \
                 2012"
            }
        }
    }

    /// Returns what comes of it here. `progress` is called [`Paper::pieces`] times, from any thread; the result does not depend on the
    /// number of threads.
    pub fn account(self, effort: &Effort, progress: &(dyn Fn() + Sync)) -> Account {
        match self {
            Paper::Fms => fms::account(effort, progress),
            Paper::Mvf => mvf::account(effort, progress),
            Paper::Fosb => fosb::account(effort, progress),
        }
    }

    /// Returns how often [`Paper::account`] reports progress.
    pub fn pieces(self, effort: &Effort) -> usize {
        match self {
            Paper::Fms => fms::pieces(effort),
            Paper::Mvf => mvf::pieces(effort),
            Paper::Fosb => fosb::pieces(effort),
        }
    }
}

/// What is said of one paper.
#[derive(Clone, Debug, PartialEq)]
pub struct Account {
    /// Its short name: `fms`, `mvf` or `fosb`.
    pub paper: &'static str,
    /// Authors, title, year.
    pub title: &'static str,
    /// One entry for every printed number and stated claim, in the order of the paper.
    pub entries: Vec<Entry>,
    /// Our curves for every figure.
    pub figures: Vec<Figure>,
}

/// One printed number or stated claim, and ours.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    /// Where the paper has it: `Table 2`, `Figure 5`, `section 3.2`.
    pub place: String,
    /// What it is: `position error of the FMS filter, step, m`.
    pub what: String,
    /// What the paper says.
    pub printed: Printed,
    /// Ours when the text is taken by its letter; absent where the letter makes no experiment.
    pub literal: Option<Measured>,
    /// Another reading of the text, and what it gives.
    pub reading: Option<Reading>,
    /// What theory allows or foretells.
    pub bound: Option<Bound>,
    /// Whether it holds.
    pub verdict: Verdict,
    /// Why, in a sentence; empty where the numbers say all.
    pub reason: String,
}

/// What a paper says.
#[derive(Clone, Debug, PartialEq)]
pub enum Printed {
    /// A number with this many digits behind the point.
    Number {
        /// The number.
        value: f64,
        /// Digits behind the point.
        digits: u32,
    },
    /// A sentence.
    Claim(String),
    /// A table or curve whose values are not in the text.
    NotInText,
}

/// A number from experiments.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measured {
    /// The mean over our experiments.
    pub mean: f64,
    /// Its standard error; 0 of what is exact.
    pub se: f64,
    /// Standard deviation of one experiment of the paper's size: what the printed number may be off by chance.
    pub spread: f64,
}

/// A reading of the text that is not the literal one.
#[derive(Clone, Debug, PartialEq)]
pub struct Reading {
    /// What is read differently.
    pub text: String,
    /// What that gives.
    pub measured: Measured,
}

/// A number that theory gives.
#[derive(Clone, Debug, PartialEq)]
pub struct Bound {
    /// What it is.
    pub text: String,
    /// The number.
    pub value: f64,
}

/// Whether what the paper says comes out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// By the letter of the text.
    Reproduced,
    /// Under another reading of the text.
    UnderReading,
    /// Under none that we know.
    NotReproducible,
    /// The opposite comes out.
    Contradicted,
    /// The paper's values are not in its text.
    NotInText,
}

impl Verdict {
    /// Every verdict, the best first.
    pub const ALL: [Verdict; 5] = [
        Verdict::Reproduced,
        Verdict::UnderReading,
        Verdict::NotReproducible,
        Verdict::Contradicted,
        Verdict::NotInText,
    ];

    /// The verdict in words.
    pub fn name(self) -> &'static str {
        match self {
            Verdict::Reproduced => "reproduced",
            Verdict::UnderReading => "reproduced under a reading",
            Verdict::NotReproducible => "not reproducible",
            Verdict::Contradicted => "contradicted",
            Verdict::NotInText => "not in the text",
        }
    }
}

impl fmt::Display for Measured {
    /// `0.2721 ± 0.0002`: down to the first digit of the standard error; four digits where there is none.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Measured { mean, se, .. } = *self;
        let leading = |v: f64| v.abs().log10().floor() as i32;
        if se > 0.0 && se.is_finite() {
            let decimals = (-leading(se)).clamp(0, 9) as usize;
            return write!(f, "{mean:.decimals$} ± {se:.decimals$}");
        }
        match mean {
            whole if whole == whole.trunc() && whole.abs() < 1e6 => write!(f, "{whole}"),
            far if !(1e-3..1e6).contains(&far.abs()) => write!(f, "{far:.1e}"),
            other => write!(f, "{other:.*}", (3 - leading(other)).max(0) as usize),
        }
    }
}

/// Standard deviations that a printed number may be off and still be reproduced.
pub const WITHIN: f64 = 3.0;

impl Measured {
    /// A number that is exact.
    pub fn exact(value: f64) -> Measured {
        Measured { mean: value, se: 0.0, spread: 0.0 }
    }

    /// Mean of experiments of the paper's size.
    pub fn of(experiments: &[f64]) -> Measured {
        let count = experiments.len() as f64;
        let mean = experiments.iter().sum::<f64>() / count;
        let square: f64 = experiments.iter().map(|v| (v - mean) * (v - mean)).sum();
        let spread = if count > 1.0 { (square / (count - 1.0)).sqrt() } else { 0.0 };
        Measured { mean, se: spread / count.sqrt(), spread }
    }

    /// Standard deviations between a printed number and this one: by chance of both experiments, and by the printing.
    pub fn deviation(&self, value: f64, digits: u32) -> f64 {
        // A number printed with d digits is off by up to half of the last: uniform.
        let rounding = 10_f64.powi(-(digits as i32)) / 12_f64.sqrt();
        (value - self.mean) / (self.se.powi(2) + self.spread.powi(2) + rounding.powi(2)).sqrt()
    }
}

impl Entry {
    /// The entry of a printed number; the verdict follows from the numbers. `missed` is the verdict when neither fits.
    pub fn number(place: &str, what: &str, (value, digits): (f64, u32), missed: Verdict) -> Entry {
        Entry {
            place: place.to_owned(),
            what: what.to_owned(),
            printed: Printed::Number { value, digits },
            literal: None,
            reading: None,
            bound: None,
            verdict: missed,
            reason: String::new(),
        }
    }

    /// The entry of a claim that `holds` or not; the numbers are what it was judged by.
    pub fn claim(place: &str, claim: &str, holds: bool, reason: String) -> Entry {
        Entry {
            place: place.to_owned(),
            what: String::new(),
            printed: Printed::Claim(claim.to_owned()),
            literal: None,
            reading: None,
            bound: None,
            verdict: if holds { Verdict::Reproduced } else { Verdict::Contradicted },
            reason,
        }
    }

    /// The entry of what the text does not have: ours stands alone.
    pub fn ours(place: &str, what: &str, measured: Measured) -> Entry {
        Entry {
            place: place.to_owned(),
            what: what.to_owned(),
            printed: Printed::NotInText,
            literal: Some(measured),
            reading: None,
            bound: None,
            verdict: Verdict::NotInText,
            reason: String::new(),
        }
    }

    /// With what the letter of the text gives.
    pub fn literally(mut self, measured: Measured) -> Entry {
        if self.fits(&measured) {
            self.verdict = Verdict::Reproduced;
        }
        self.literal = Some(measured);
        self
    }

    /// With what another reading gives.
    pub fn read_as(mut self, text: &str, measured: Measured) -> Entry {
        if self.verdict != Verdict::Reproduced && self.fits(&measured) {
            self.verdict = Verdict::UnderReading;
        }
        self.reading = Some(Reading { text: text.to_owned(), measured });
        self
    }

    /// With another reading of a claim: what that gives, and whether the claim holds under it.
    pub fn holds_read_as(mut self, text: &str, measured: Measured, holds: bool) -> Entry {
        if self.verdict == Verdict::Contradicted && holds {
            self.verdict = Verdict::UnderReading;
        }
        self.reading = Some(Reading { text: text.to_owned(), measured });
        self
    }

    /// With what theory says.
    pub fn bounded(mut self, text: &str, value: f64) -> Entry {
        self.bound = Some(Bound { text: text.to_owned(), value });
        self
    }

    /// With a sentence on why.
    pub fn because(mut self, reason: impl Into<String>) -> Entry {
        self.reason = reason.into();
        self
    }

    fn fits(&self, measured: &Measured) -> bool {
        match self.printed {
            Printed::Number { value, digits } => measured.deviation(value, digits).abs() < WITHIN,
            _ => false,
        }
    }
}

/// Our curves for one figure of a paper.
#[derive(Clone, Debug, PartialEq)]
pub struct Figure {
    /// Where the paper has it: `Figure 4`, `Figure 9a`.
    pub place: String,
    /// What it shows, and how it was made.
    pub caption: String,
    /// Name and unit of the horizontal axis.
    pub x: String,
    /// Name and unit of the vertical axis.
    pub y: String,
    /// What it looks like.
    pub kind: FigureKind,
    /// The curves, in the order of the legend.
    pub curves: Vec<Curve>,
}

/// What a figure looks like.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FigureKind {
    /// y over x.
    Lines,
    /// y over x, y positive and logarithmic.
    Logarithmic,
    /// A plan of the field, both axes in one scale.
    Plan,
}

/// One curve.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// Its name in the legend.
    pub name: String,
    /// Its points in order.
    pub points: Vec<[f64; 2]>,
    /// Whether points are joined; else they are marks.
    pub joined: bool,
}

/// How much is run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Effort {
    /// How often each experiment, of the paper's own size, is run; absent: as often as makes standard errors small.
    pub runs: Option<usize>,
    /// A look in seconds: fewer experiments, wider errors.
    pub quick: bool,
    /// Seed of all chance.
    pub seed: u64,
}

impl Effort {
    /// How many experiments there are where a full account has `full` and a quick one `quick`; 2 at least, for their spread.
    pub fn experiments(&self, full: usize, quick: usize) -> usize {
        self.runs.unwrap_or(if self.quick { quick } else { full }).max(2)
    }
}

/// Chance of one run of a paper: a stream of its own for each part of the paper, experiment and run.
fn stream(effort: &Effort, paper: Paper, part: u64, experiment: usize, run: usize) -> Pcg64 {
    let number = (paper as u128) << 112 | u128::from(part) << 80 | (experiment as u128) << 40 | run as u128;
    Pcg64::new(u128::from(effort.seed), number)
}

/// A standard normal number.
fn normal(rng: &mut Pcg64) -> f64 {
    StandardNormal.sample(rng)
}
