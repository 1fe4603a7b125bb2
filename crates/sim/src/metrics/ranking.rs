//! Which of several estimators of the same data is best, and whether the difference is more than chance.
//!
//! Each instant costs an estimator a loss: its squared error, or what its prediction of the measurements lacks in log density. Estimators
//! are compared at the instants that all of them have. What one instant says is much like what the next one says, so the standard error
//! of a difference is taken from blocks of time: with block sums `D_j` of the difference and `w_j` of the weight,
//!
//! ```text
//! d̄ = Σ D_j / Σ w_j        se² = B/(B−1) · Σ (D_j − w_j d̄)² / (Σ w_j)²
//! ```
//!
//! for B blocks, which counts them as independent. A block is as long as asked for at least, and longer where that would make more than
//! √n blocks of n instants: the longer the data, the longer the blocks and the more of them.

/// Fewest blocks that say anything of the spread of their mean.
const LEAST_BLOCKS: usize = 8;
/// Share of the instants of the fullest estimator that another must have to be ranked: the hard instants may not be left out.
const LEAST_SHARE: f64 = 0.95;

/// What one instant cost an estimator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Loss {
    /// The instant, seconds, or its number in a run without times.
    pub t: f64,
    /// Loss.
    pub sum: f64,
    /// What the mean divides by: 1, or the number of scalars.
    pub weight: f64,
}

/// The losses of one target at the instants of the data, the same for every estimator; `None` where there is no estimate.
pub type Losses = Vec<Option<Loss>>;

/// Estimators in order of their mean loss.
#[derive(Clone, Debug, PartialEq)]
pub struct Ranking {
    /// Indices of the estimators that were ranked, the best first.
    pub order: Vec<usize>,
    /// Mean loss of each of `order` at the common instants.
    pub means: Vec<f64>,
    /// Instants that all of them have.
    pub instants: usize,
    /// Mean loss of each but the first, less that of the first.
    pub differences: Vec<Difference>,
    /// Indices of those that lack too many instants.
    pub left_out: Vec<usize>,
}

/// A difference of mean losses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Difference {
    /// The difference.
    pub mean: f64,
    /// Its standard error; `None` for fewer than eight blocks.
    pub standard_error: Option<f64>,
    /// Blocks behind it.
    pub blocks: usize,
    /// Length of a block, seconds or instants.
    pub block: f64,
}

impl Difference {
    /// The difference in standard errors.
    pub fn ratio(&self) -> Option<f64> {
        self.standard_error.map(|se| if se > 0.0 { self.mean / se } else { f64::INFINITY }).filter(|_| self.mean > 0.0)
    }
}

/// Ranks estimators by their losses, one list of targets each. `least_block` is the shortest block, in the unit of [`Loss::t`].
///
/// Ranked are those that have at least 95 % of the instants of the one that has most. `None` when there is no common instant.
pub fn rank(estimators: &[&[Losses]], least_block: f64) -> Option<Ranking> {
    let known = |losses: &[Losses]| losses.iter().flatten().flatten().count();
    let most = estimators.iter().map(|e| known(e)).max()?;
    let (mut ranked, left_out): (Vec<usize>, Vec<usize>) =
        (0..estimators.len()).partition(|i| known(estimators[*i]) as f64 >= LEAST_SHARE * most as f64);
    // Targets and places in them that all have.
    let first = estimators[*ranked.first()?];
    let at = |e: usize, target: usize, i: usize| estimators[e].get(target)?.get(i).copied().flatten();
    let common: Vec<(usize, usize)> = (0..first.len())
        .flat_map(|target| (0..first[target].len()).map(move |i| (target, i)))
        .filter(|(target, i)| ranked.iter().all(|e| at(*e, *target, *i).is_some()))
        .collect();
    let losses = |e: usize| common.iter().filter_map(move |(target, i)| at(e, *target, *i).map(|loss| (*target, loss)));
    let mean = |e: usize| {
        let (sum, weight) = losses(e).fold((0.0, 0.0), |(s, w), (_, loss)| (s + loss.sum, w + loss.weight));
        sum / weight
    };
    if common.is_empty() {
        return None;
    }
    let mut means: Vec<(f64, usize)> = ranked.iter().map(|e| (mean(*e), *e)).collect();
    means.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    ranked = means.iter().map(|(_, e)| *e).collect();
    let best: Vec<(usize, Loss)> = losses(ranked[0]).collect();
    let differences = ranked[1..].iter().map(|e| difference(&best, losses(*e).map(|(_, loss)| loss), least_block));
    Some(Ranking {
        differences: differences.collect(),
        means: means.into_iter().map(|(mean, _)| mean).collect(),
        instants: common.len(),
        order: ranked,
        left_out,
    })
}

/// The mean of `others` less that of `best`, which holds targets and losses at the same instants.
fn difference(best: &[(usize, Loss)], others: impl Iterator<Item = Loss>, least_block: f64) -> Difference {
    let lasted: f64 = best.chunk_by(|a, b| a.0 == b.0).map(|target| target[target.len() - 1].1.t - target[0].1.t).sum();
    let block = least_block.max(lasted / (best.len() as f64).sqrt());
    // Target and number of a block, the sum of its differences, its weight.
    let mut blocks: Vec<((usize, u64), f64, f64)> = Vec::new();
    let mut began = (usize::MAX, 0.0);
    for ((target, a), b) in best.iter().zip(others) {
        if began.0 != *target {
            began = (*target, a.t);
        }
        let number = if block > 0.0 { ((a.t - began.1) / block) as u64 } else { 0 };
        match blocks.last_mut().filter(|(key, ..)| *key == (*target, number)) {
            Some((_, sum, weight)) => (*sum, *weight) = (*sum + b.sum - a.sum, *weight + a.weight),
            None => blocks.push(((*target, number), b.sum - a.sum, a.weight)),
        }
    }
    let n = blocks.len();
    let weight: f64 = blocks.iter().map(|b| b.2).sum();
    let mean = blocks.iter().map(|b| b.1).sum::<f64>() / weight;
    let squares: f64 = blocks.iter().map(|(_, sum, w)| (sum - w * mean).powi(2)).sum();
    let standard_error = (n >= LEAST_BLOCKS).then(|| (n as f64 / (n - 1) as f64 * squares).sqrt() / weight);
    Difference { mean, standard_error, blocks: n, block }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_distr::{Distribution, StandardNormal};
    use rand_pcg::Pcg64;

    fn series(values: impl IntoIterator<Item = f64>) -> Losses {
        let loss = |(i, sum)| Some(Loss { t: i as f64, sum, weight: 1.0 });
        values.into_iter().enumerate().map(loss).collect()
    }

    #[test]
    fn order_and_means_are_those_of_the_common_instants() {
        let a = [series([1.0, 2.0, 3.0]), series([5.0; 37])];
        let mut b = [series([2.0, 2.0, 9.0]), series([4.0; 37])];
        b[0][2] = None;
        // Good where it has an estimate, which is not often.
        let c = [series([0.0]), Vec::new()];
        let ranking = rank(&[&a, &b, &c], 1.0).unwrap();
        assert_eq!((&ranking.order[..], ranking.instants, &ranking.left_out[..]), (&[1, 0][..], 39, &[2][..]));
        assert_eq!(ranking.means, [(4.0 + 37.0 * 4.0) / 39.0, (3.0 + 37.0 * 5.0) / 39.0]);
        assert!((ranking.differences[0].mean - 36.0 / 39.0).abs() < 1e-12);
        assert_eq!(rank(&[&[series([])][..]], 1.0), None);
        assert_eq!(rank(&[], 1.0), None);
    }

    #[test]
    fn standard_error_is_the_formula_in_weighted_blocks() {
        // Blocks of 10 instants; t = 0 … 99, √100 blocks are 10.
        let weight = |i: usize| 1.0 + (i % 3) as f64;
        let loss = |i: usize, sum: f64| Some(Loss { t: i as f64, sum, weight: weight(i) });
        let a = [(0..100).map(|i| loss(i, 0.0)).collect::<Losses>()];
        let b = [(0..100).map(|i| loss(i, weight(i) * (1.0 + (i / 10) as f64))).collect::<Losses>()];
        let found = rank(&[&a, &b], 10.0).unwrap().differences[0];
        let w: Vec<f64> = (0..10).map(|j| (0..10).map(|i| weight(10 * j + i)).sum()).collect();
        let total: f64 = w.iter().sum();
        let mean = (0..10).map(|j| w[j] * (1.0 + j as f64)).sum::<f64>() / total;
        let squares: f64 = (0..10).map(|j| (w[j] * (1.0 + j as f64 - mean)).powi(2)).sum();
        assert!((found.mean - mean).abs() < 1e-12 && found.blocks == 10 && found.block == 10.0, "{found:?}");
        assert!((found.standard_error.unwrap() - (10.0 / 9.0 * squares).sqrt() / total).abs() < 1e-12);
        // Seven blocks say too little.
        assert_eq!(rank(&[&[series([1.0; 7])][..], &[series([2.0; 7])]], 1.0).unwrap().differences[0].ratio(), None);
    }

    #[test]
    fn standard_error_of_correlated_differences_is_that_of_their_mean() {
        // An autoregression with φ = 0.9 of unit innovations: the mean of n values has the variance 1/(1−φ)²/n = 100/n, not 5.3/n as
        // independent values of the same variance would. Over 100 runs of 4000 instants, 63 blocks each: blocks of 63 instants lose
        // 2 φ/(1 − φ²)/63 = 15 % of the variance at their ends; a mean variance from 100 runs of 62 degrees of freedom errs by 2 %.
        let (n, runs) = (4000, 100);
        let mut ours = 0.0;
        for seed in 0..runs {
            let mut rng = Pcg64::new(seed, 1);
            let mut x = 0.0;
            let mut next = || {
                let e: f64 = StandardNormal.sample(&mut rng);
                x = 0.9 * x + e;
                x
            };
            let b = [series((0..n).map(|_| next()))];
            let zero = [series((0..n).map(|_| 0.0))];
            let found = rank(&[&zero, &b], 10.0).unwrap().differences[0];
            assert!((62..=65).contains(&found.blocks), "{found:?}");
            ours += found.standard_error.unwrap().powi(2) / runs as f64;
        }
        let ratio = ours / (100.0 / n as f64);
        assert!(ratio > 0.75 && ratio < 1.0, "{ratio}");
    }
}
