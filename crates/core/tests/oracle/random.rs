//! Random systems, seeded.

use super::{Instant, Run};
use nalgebra::{DMatrix, DVector};
use rand_distr::{Distribution, StandardNormal, StandardUniform};
use rand_pcg::Pcg64;

/// A seeded source of what tests need.
pub struct Random(Pcg64);

impl Random {
    pub fn new(seed: u128) -> Self {
        Self(Pcg64::new(seed, 1))
    }

    pub fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.0)
    }

    /// Between 0 and 1.
    pub fn uniform(&mut self) -> f64 {
        StandardUniform.sample(&mut self.0)
    }

    pub fn chance(&mut self, p: f64) -> bool {
        self.uniform() < p
    }

    /// One of `low..=high`.
    pub fn count(&mut self, low: usize, high: usize) -> usize {
        low + ((self.uniform() * (high - low + 1) as f64) as usize).min(high - low)
    }

    pub fn matrix(&mut self, rows: usize, cols: usize) -> DMatrix<f64> {
        DMatrix::from_fn(rows, cols, |_, _| self.normal())
    }

    /// A covariance of the given rank, its standard deviations about `sd`.
    pub fn covariance(&mut self, n: usize, rank: usize, sd: f64) -> DMatrix<f64> {
        let root = self.matrix(n, rank) * (sd / (rank.max(1) as f64).sqrt());
        let m = &root * root.transpose();
        (&m + m.transpose()) * 0.5
    }

    /// A correlated covariance that is far from singular.
    pub fn definite(&mut self, n: usize, sd: f64) -> DMatrix<f64> {
        self.covariance(n, n, sd) + DMatrix::identity(n, n) * (0.3 * sd * sd)
    }
}

/// What a random run may have.
#[derive(Clone, Copy, Debug)]
pub struct Family {
    pub len: usize,
    pub n: usize,
    pub q: usize,
    /// Largest number of process noises and of inputs.
    pub p: usize,
    pub varying: bool,
    pub prior: bool,
    /// Probability that a row, or a component of the rest, is lost.
    pub loss: f64,
    /// Whether A may be singular.
    pub singular: bool,
}

fn transition(rng: &mut Random, family: &Family) -> DMatrix<f64> {
    let n = family.n;
    // Of spectral norm about 1: half of them a little unstable.
    let mut a = rng.matrix(n, n) * (0.9 / (n as f64).sqrt()) + DMatrix::identity(n, n) * 0.3;
    if family.singular && rng.chance(0.4) {
        // One direction is forgotten at once.
        let forgotten = rng.matrix(n, 1).normalize();
        let keep = DMatrix::identity(n, n) - &forgotten * forgotten.transpose();
        a *= keep;
    }
    a
}

fn instant(rng: &mut Random, family: &Family, p_w: usize, p_u: usize) -> Instant {
    let (n, q) = (family.n, family.q);
    let rank = if rng.chance(0.3) { rng.count(0, p_w) } else { p_w };
    Instant {
        a: transition(rng, family),
        b: rng.matrix(n, p_u),
        g: rng.matrix(n, p_w),
        q: rng.covariance(p_w, rank, 0.4),
        c: rng.matrix(q, n),
        r: rng.definite(q, 0.5),
        z: vec![None; q],
        u: vec![0.0; p_u],
    }
}

/// A run of the family, with data drawn from it.
pub fn run(rng: &mut Random, family: &Family) -> Run {
    let (n, q) = (family.n, family.q);
    let p_w = rng.count(1, family.p.min(n));
    let p_u = rng.count(0, family.p);
    let mut instants = vec![instant(rng, family, p_w, p_u)];
    for _ in 1..family.len {
        let next = if family.varying { instant(rng, family, p_w, p_u) } else { instants[0].clone() };
        instants.push(next);
    }
    let prior = family.prior.then(|| {
        let rank = rng.count(0, n);
        (rng.matrix(n, 1).column(0) * 3.0, rng.covariance(n, rank, 2.0))
    });
    let mut x: DVector<f64> = rng.matrix(n, 1).column(0) * 5.0;
    for at in &mut instants {
        // The data need not be drawn from the very model; their size must fit.
        let noise = at.r.clone().cholesky().expect("positive definite").l() * rng.matrix(q, 1);
        let z = &at.c * &x + noise;
        let row_lost = rng.chance(family.loss);
        at.z = (0..q).map(|i| (!row_lost && !rng.chance(family.loss)).then_some(z[i])).collect();
        if !row_lost || rng.chance(0.5) {
            at.u.iter_mut().for_each(|u| *u = rng.normal());
        }
        let w = &at.g * (rng.matrix(p_w, 1) * 0.4);
        x = &at.a * x + &at.b * DVector::from_column_slice(&at.u) + w.column(0);
    }
    Run { instants, prior }
}
