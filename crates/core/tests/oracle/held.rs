//! Short runs over a link without time stamps, and what everything that may have arrived makes of them.
//!
//! All randomness of a run is one vector ξ (first state, process noises, measurement noises). What arrived decides which instant each
//! value shown is from; given that, states and values are affine in ξ. The oracle goes through every sequence of arrivals.

use super::Posterior;
use super::fixed::square;
use super::random::Random;
use fixtrail_core::estimators::augmented::{Hold, Sensed, Shown};
use fixtrail_core::estimators::emvf::Emvf;
use fixtrail_core::estimators::gpb1::Gpb1;
use fixtrail_core::estimators::kalman::Evidence;
use fixtrail_core::estimators::lmmse::Lmmse;
use fixtrail_core::estimators::lmvf::Lmvf;
use fixtrail_core::{Belief, Matrix, StepError, Transition, Vector, linalg};
use nalgebra::{DMatrix, DVector};

/// The estimators under test, by one name.
pub trait Filter<const N: usize, const M: usize>: Clone + std::fmt::Debug {
    fn belief(&self) -> Belief<N>;

    fn take(
        &mut self,
        leap: &Transition<N>,
        sensed: &Sensed<N, M>,
        shown: &Shown<M>,
        arrival: f64,
    ) -> Result<Evidence, StepError>;
}

macro_rules! filter {
    ($type:ident, $self:ident => $belief:expr) => {
        impl<const N: usize, const M: usize> Filter<N, M> for $type<N, M> {
            fn belief(&$self) -> Belief<N> {
                $belief
            }

            fn take(
                &mut self,
                leap: &Transition<N>,
                sensed: &Sensed<N, M>,
                shown: &Shown<M>,
                arrival: f64,
            ) -> Result<Evidence, StepError> {
                self.step(leap, sensed, shown, arrival).map(|found| found.evidence)
            }
        }
    };
}
filter!(Lmvf, self => Lmvf::belief(self));
filter!(Emvf, self => Emvf::belief(self));
filter!(Lmmse, self => self.joint().belief());
filter!(Gpb1, self => self.joint().belief());

/// One instant: its measurement, what is shown, and the leap to the next.
#[derive(Clone, Debug)]
pub struct At {
    pub a: DMatrix<f64>,
    pub b: DVector<f64>,
    pub w: DMatrix<f64>,
    pub c: DMatrix<f64>,
    pub r: DMatrix<f64>,
    pub arrival: f64,
    pub y: DVector<f64>,
    pub seen: Vec<bool>,
}

#[derive(Clone, Debug)]
pub struct HeldRun {
    pub mean: DVector<f64>,
    pub cov: DMatrix<f64>,
    pub instants: Vec<At>,
}

/// Which instant each value of 0..=k is from, and how probable that is.
pub struct Path {
    pub probability: f64,
    pub source: Vec<usize>,
}

/// `offset + map ξ`.
#[derive(Clone)]
pub struct Affine {
    pub offset: DVector<f64>,
    pub map: DMatrix<f64>,
}

impl Affine {
    pub fn then(&self, m: &DMatrix<f64>) -> Self {
        Self { offset: m * &self.offset, map: m * &self.map }
    }

    pub fn less(&self, other: &Self) -> Self {
        Self { offset: &self.offset - &other.offset, map: &self.map - &other.map }
    }

    fn stacked(parts: &[Self], cols: usize) -> Self {
        let rows: usize = parts.iter().map(|p| p.offset.len()).sum();
        let mut out = Self { offset: DVector::zeros(rows), map: DMatrix::zeros(rows, cols) };
        let mut at = 0;
        for part in parts {
            out.offset.rows_mut(at, part.offset.len()).copy_from(&part.offset);
            out.map.rows_mut(at, part.offset.len()).copy_from(&part.map);
            at += part.offset.len();
        }
        out
    }
}

/// What a random run is like.
#[derive(Clone, Copy, Debug)]
pub struct Kind {
    pub n: usize,
    pub m: usize,
    /// Instants after the first.
    pub steps: usize,
    pub hold: Hold,
    /// Probability that an instant, or a component of one, is not seen.
    pub missing: f64,
    /// All arrival rates; random and different ones without.
    pub arrival: Option<f64>,
}

/// A random time-varying run with data drawn from it, some of it repeated.
pub fn held_run(rng: &mut Random, kind: &Kind) -> HeldRun {
    let Kind { n, m, steps, .. } = *kind;
    let mut instants: Vec<At> = (0..=steps)
        .map(|_| {
            let rate = if rng.chance(0.1) { 1.0 } else { 0.1 + 0.85 * rng.uniform() };
            let row_missing = rng.chance(kind.missing);
            At {
                a: DMatrix::identity(n, n) * 0.7 + rng.matrix(n, n) * (0.4 / (n as f64).sqrt()),
                b: rng.matrix(n, 1).column(0) * 0.5,
                w: rng.covariance(n, n, 0.4),
                c: rng.matrix(m, n),
                r: rng.definite(m, 0.5),
                arrival: kind.arrival.unwrap_or(rate),
                y: DVector::zeros(m),
                seen: (0..m).map(|_| !row_missing && !rng.chance(kind.missing)).collect(),
            }
        })
        .collect();
    let mean = rng.matrix(n, 1).column(0) * 2.0;
    let cov = rng.definite(n, 1.0);
    let drawn = |rng: &mut Random, cov: &DMatrix<f64>| {
        let root = cov.clone().cholesky().expect("positive definite").l();
        (root * rng.matrix(cov.nrows(), 1)).column(0).into_owned()
    };
    let mut x = &mean + drawn(rng, &cov);
    let mut shown: Vec<(bool, DVector<f64>, DVector<f64>)> = Vec::new();
    for k in 0..=steps {
        let at = &mut instants[k];
        let z = &at.c * &x + drawn(rng, &at.r);
        let came = k == 0 || rng.chance(at.arrival);
        at.y = match (came, kind.hold) {
            (true, _) => z.clone(),
            (false, Hold::LastReceived) => shown[k - 1].2.clone(),
            (false, Hold::Paper) => if shown[k - 1].0 { &shown[k - 1] } else { &shown[k - 2] }.1.clone(),
        };
        shown.push((came, z, at.y.clone()));
        x = &at.a * x + &at.b + drawn(rng, &at.w);
    }
    HeldRun { mean, cov, instants }
}

impl HeldRun {
    pub fn steps(&self) -> usize {
        self.instants.len() - 1
    }

    pub fn start<const N: usize>(&self) -> Belief<N> {
        Belief { mean: self.mean.fixed_rows::<N>(0).into(), cov: square(&self.cov) }
    }

    /// E[x_0 x_0ᵀ].
    pub fn second<const N: usize>(&self) -> Matrix<N, N> {
        square(&(&self.cov + &self.mean * self.mean.transpose()))
    }

    /// The leap to instant k, linearised at `x`.
    pub fn leap<const N: usize>(&self, k: usize, x: &Vector<N>) -> Transition<N> {
        let from = &self.instants[k - 1];
        let f: Matrix<N, N> = square(&from.a);
        Transition { next: f * x + from.b.fixed_rows::<N>(0), f, q: linalg::symmetrised(&square(&from.w)) }
    }

    pub fn sensed<const N: usize, const M: usize>(&self, k: usize, x: &Vector<N>) -> Sensed<N, M> {
        let at = &self.instants[k];
        let h = Matrix::from_fn(|i, j| at.c[(i, j)]);
        Sensed { expected: h * x, h, r: square(&at.r) }
    }

    pub fn shown<const M: usize>(&self, k: usize) -> Shown<M> {
        let at = &self.instants[k];
        Shown { y: at.y.fixed_rows::<M>(0).into(), seen: std::array::from_fn(|i| at.seen[i]) }
    }

    /// Takes the filter to instant k from the one before.
    pub fn step<const N: usize, const M: usize>(&self, filter: &mut impl Filter<N, M>, k: usize) -> Evidence {
        let leap = self.leap(k, &filter.belief().mean);
        let sensed = self.sensed(k, &leap.next);
        filter.take(&leap, &sensed, &self.shown(k), self.instants[k].arrival).expect("a sound step")
    }

    /// Every sequence of arrivals up to instant k, z_0 having come.
    pub fn paths(&self, hold: Hold, k: usize) -> Vec<Path> {
        let mut out = Vec::new();
        for bits in 0..1_usize << k {
            let came = |i: usize| i == 0 || bits >> (i - 1) & 1 == 1;
            let probability = (1..=k)
                .map(|i| if came(i) { self.instants[i].arrival } else { 1.0 - self.instants[i].arrival })
                .product();
            let source = |i: usize| match hold {
                Hold::LastReceived => (0..=i).rev().find(|j| came(*j)).expect("the first came"),
                Hold::Paper => [i, i.saturating_sub(1)].into_iter().find(|j| came(*j)).unwrap_or(i.saturating_sub(2)),
            };
            out.push(Path { probability, source: (0..=k).map(source).collect() });
        }
        out
    }

    /// Number of entries of ξ.
    fn width(&self) -> usize {
        let (n, m) = (self.mean.len(), self.instants[0].y.len());
        self.instants.len() * (n + m)
    }

    /// Covariance of ξ = (x_0 − mean, w_0, w_1, …, v_0, v_1, …).
    pub fn noise(&self) -> DMatrix<f64> {
        let (n, m, len) = (self.mean.len(), self.instants[0].y.len(), self.instants.len());
        let mut out = DMatrix::zeros(self.width(), self.width());
        out.view_mut((0, 0), (n, n)).copy_from(&self.cov);
        for (k, at) in self.instants.iter().enumerate() {
            if k + 1 < len {
                out.view_mut((n * (k + 1), n * (k + 1)), (n, n)).copy_from(&at.w);
            }
            out.view_mut((n * len + m * k, n * len + m * k), (m, m)).copy_from(&at.r);
        }
        out
    }

    /// x_k.
    pub fn state(&self, k: usize) -> Affine {
        let n = self.mean.len();
        let mut x = Affine { offset: self.mean.clone(), map: DMatrix::zeros(n, self.width()) };
        x.map.view_mut((0, 0), (n, n)).fill_with_identity();
        for (i, at) in self.instants[..k].iter().enumerate() {
            x = x.then(&at.a);
            x.offset += &at.b;
            x.map.view_mut((0, n * (i + 1)), (n, n)).fill_with_identity();
        }
        x
    }

    /// z_k.
    fn measured(&self, k: usize) -> Affine {
        let (n, m, len) = (self.mean.len(), self.instants[0].y.len(), self.instants.len());
        let mut z = self.state(k).then(&self.instants[k].c);
        z.map.view_mut((0, n * len + m * k), (m, m)).fill_with_identity();
        z
    }

    /// What is seen of y_1 … y_k on a path.
    pub fn values(&self, path: &Path, k: usize) -> Affine {
        let mut parts = Vec::new();
        for i in 1..=k {
            let z = self.measured(path.source[i]);
            for j in (0..z.offset.len()).filter(|j| self.instants[i].seen[*j]) {
                parts.push(Affine { offset: z.offset.rows(j, 1).into(), map: z.map.rows(j, 1).into() });
            }
        }
        Affine::stacked(&parts, self.width())
    }

    /// What was seen of y_1 … y_k.
    pub fn data(&self, k: usize) -> DVector<f64> {
        let seen = self.instants[1..=k]
            .iter()
            .flat_map(|at| at.y.iter().zip(&at.seen).filter(|(_, seen)| **seen).map(|(y, _)| *y));
        DVector::from_vec(seen.collect())
    }

    /// The best linear estimate of x_k: first and second moments of state and values over all paths, normal equations.
    pub fn best_linear(&self, hold: Hold, k: usize) -> Posterior {
        let (noise, x) = (self.noise(), self.state(k));
        let prior = &x.map * &noise * x.map.transpose();
        let data = self.data(k);
        if data.is_empty() {
            return Posterior { mean: x.offset, cov: prior };
        }
        let paths = self.paths(hold, k);
        let values: Vec<Affine> = paths.iter().map(|path| self.values(path, k)).collect();
        let each = || paths.iter().map(|path| path.probability).zip(&values);
        let mean = each().map(|(p, y)| &y.offset * p).sum::<DVector<f64>>();
        let cross = &x.map * &noise * each().map(|(p, y)| y.map.transpose() * p).sum::<DMatrix<f64>>();
        let cov = each()
            .map(|(p, y)| {
                let off = &y.offset - &mean;
                (&y.map * &noise * y.map.transpose() + &off * off.transpose()) * p
            })
            .sum::<DMatrix<f64>>();
        // Values that repeat for certain make it singular; nothing else is near that.
        let eigen = cov.symmetric_eigen();
        let least = 1e-11 * eigen.eigenvalues.amax();
        let inverse = eigen.eigenvalues.map(|l| if l > least { 1.0 / l } else { 0.0 });
        let inverse = &eigen.eigenvectors * DMatrix::from_diagonal(&inverse) * eigen.eigenvectors.transpose();
        let gain = &cross * inverse;
        Posterior { mean: &x.offset + &gain * (data - mean), cov: prior - &gain * cross.transpose() }
    }

    /// Mean square error matrix of the estimate of x_k that a filter makes, which is affine in the values: found by feeding it 0 and
    /// unit vectors, then averaged over all paths.
    pub fn mean_square_error<const N: usize, const M: usize>(
        &self,
        start: &impl Filter<N, M>,
        hold: Hold,
        k: usize,
    ) -> DMatrix<f64> {
        let count = self.data(k).len();
        let answer = |data: &DVector<f64>| {
            let mut run = self.clone();
            let mut next = data.iter();
            for at in &mut run.instants[1..=k] {
                for j in (0..at.y.len()).filter(|j| at.seen[*j]) {
                    at.y[j] = *next.next().expect("as many");
                }
            }
            let mut filter = start.clone();
            (1..=k).for_each(|i| {
                run.step(&mut filter, i);
            });
            let mean = filter.belief().mean;
            DVector::from_fn(N, |i, _| mean[i])
        };
        let zero = answer(&DVector::zeros(count));
        let mut gain = DMatrix::zeros(N, count);
        for j in 0..count {
            let mut unit = DVector::zeros(count);
            unit[j] = 1.0;
            gain.set_column(j, &(answer(&unit) - &zero));
        }
        let (noise, x) = (self.noise(), self.state(k));
        let mut out = DMatrix::zeros(N, N);
        for path in self.paths(hold, k) {
            let mut error = x.less(&self.values(&path, k).then(&gain));
            error.offset -= &zero;
            out += (&error.map * &noise * error.map.transpose() + &error.offset * error.offset.transpose())
                * path.probability;
        }
        out
    }
}
