//! Which is best, and by how much more than chance.

use super::entries::{Entry, Knows, Measure};
use crate::figures::{grouped, short};
use fixtrail_sim::metrics::{Difference, Losses, Ranking, rank};

/// Shortest block of time whose errors are taken as independent of those of the next.
const BLOCK_S: f64 = 10.0;
/// Differences of this many standard errors are hardly chance.
const CLEAR: f64 = 2.0;

/// A ranking among some of the entries.
pub struct Ranked {
    /// Indices of the entries it is among.
    pub among: Vec<usize>,
    /// The ranking, by indices of `among`.
    pub ranking: Ranking,
}

/// What a comparison comes to.
pub struct Verdict {
    /// Of all entries.
    pub all: Ranked,
    /// Of those that use no later data, where others do.
    pub causal: Option<Ranked>,
    /// The same in sentences.
    pub sentences: Vec<String>,
}

impl Verdict {
    /// The verdict on `entries`; `None` when they have no instant in common. `is_index`: whether instants have numbers and no times.
    pub fn of(entries: &[Entry], measure: Measure<'_>, is_index: bool) -> Option<Verdict> {
        let ranked = |among: Vec<usize>| {
            let losses: Vec<&[Losses]> = among.iter().map(|i| entries[*i].losses.as_slice()).collect();
            rank(&losses, if is_index { 0.0 } else { BLOCK_S }).map(|ranking| Ranked { among, ranking })
        };
        let all = ranked((0..entries.len()).collect())?;
        let past: Vec<usize> = (0..entries.len()).filter(|i| entries[*i].knows != Knows::Later).collect();
        let is_mixed = past.len() < entries.len() && !past.is_empty();
        let causal = if is_mixed { ranked(past) } else { None };
        let words = Words { entries, measure, is_index };
        let mut sentences = words.about(&all, "best");
        if let Some(causal) = causal.as_ref().filter(|c| c.best() != all.best()) {
            sentences.extend(words.about(causal, "best of those that use no later data"));
        }
        Some(Verdict { all, causal, sentences })
    }

    /// Whether an entry is the best of all, or of those that use no later data.
    pub fn is_best(&self, entry: usize) -> bool {
        self.all.best() == entry || self.causal.as_ref().is_some_and(|c| c.best() == entry)
    }
}

impl Ranked {
    /// The best entry.
    pub fn best(&self) -> usize {
        self.among[self.ranking.order[0]]
    }
}

struct Words<'a> {
    entries: &'a [Entry],
    measure: Measure<'a>,
    is_index: bool,
}

impl Words<'_> {
    fn about(&self, ranked: &Ranked, best: &str) -> Vec<String> {
        let name = |i: usize| self.entries[ranked.among[i]].name.as_str();
        let ranking = &ranked.ranking;
        let first = ranking.order[0];
        let note = match self.entries[ranked.among[first]].note() {
            "" => String::new(),
            note => format!(" ({note})"),
        };
        let by = match self.measure {
            Measure::Truth { .. } => format!("root mean square error {} m", short(ranking.means[0].sqrt())),
            Measure::Prediction => format!("score {}", short(-ranking.means[0])),
        };
        let instants = grouped(ranking.instants as u64);
        let mut out = match ranking.order.len() {
            1 if ranked.among.len() == 1 && best == "best" => {
                vec![format!("{}{note}: {by} at {instants} instants; there is no other to compare with", name(first))]
            }
            1 => vec![format!("{best}: {}{note}, {by} at {instants} instants", name(first))],
            _ => vec![format!("{best}: {}{note}, {by} at the {instants} instants that all have", name(first))],
        };
        if let (Some(second), Some(difference)) = (ranking.order.get(1), ranking.differences.first()) {
            out.push(self.difference(name(*second), difference));
        }
        if !ranking.left_out.is_empty() {
            let names: Vec<&str> = ranking.left_out.iter().map(|i| name(*i)).collect();
            out.push(format!("not ranked, too many instants without an estimate: {}", names.join(", ")));
        }
        out
    }

    /// How the second best falls behind.
    fn difference(&self, second: &str, difference: &Difference) -> String {
        let amount = match self.measure {
            Measure::Truth { .. } => format!("a mean square error {} m² larger", short(difference.mean)),
            Measure::Prediction => format!("a score {} smaller", short(difference.mean)),
        };
        // A block is as long as it is for reasons of its own: to the second is enough.
        let (block, blocks) = (difference.block.round(), difference.blocks);
        let block = if self.is_index { format!("{block} instants") } else { format!("{block} s") };
        let chance = match (difference.ratio(), difference.standard_error) {
            _ if difference.mean == 0.0 => return format!("next: {second}, exactly as good"),
            (Some(ratio), Some(_)) if ratio >= CLEAR => {
                format!("{} standard errors of the difference: clearly worse", short(ratio))
            }
            (Some(ratio), Some(_)) if ratio >= 1.0 => {
                format!("{} standard errors of the difference: worse, unless by chance", short(ratio))
            }
            (Some(ratio), Some(_)) => {
                format!("{} standard errors of the difference: the data do not tell the two apart", short(ratio))
            }
            _ => "too few blocks to say whether by chance".to_owned(),
        };
        format!("next: {second}, {amount}, {chance} ({blocks} blocks of {block})")
    }
}
