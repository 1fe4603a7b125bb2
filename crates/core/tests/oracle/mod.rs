//! The oracle: a short linear run as one joint Gaussian, conditioned by plain dense algebra.
//!
//! Nothing of it is recursive. The stretch's first state `s` and its process noises `n` make every state and measurement,
//! `x_k = Φ_k s + Θ_k n + known`, `z = O s + Ψ n + v + known`. With a prior, `s` is one more noise and the estimate is the conditional
//! mean; without one it is the generalised least-squares estimate of `s` and of what it leads to.

#![allow(dead_code)]

use nalgebra::{DMatrix, DVector};
use std::ops::Range;

pub mod fixed;
pub mod held;
pub mod nonlinear;
pub mod random;
pub mod twofold;

/// The matrices of one instant: its measurement, and the leap from it to the next.
#[derive(Clone, Debug)]
pub struct Instant {
    pub a: DMatrix<f64>,
    pub b: DMatrix<f64>,
    pub g: DMatrix<f64>,
    pub q: DMatrix<f64>,
    pub c: DMatrix<f64>,
    pub r: DMatrix<f64>,
    /// Measured, lost components absent.
    pub z: Vec<Option<f64>>,
    /// Input to the next instant.
    pub u: Vec<f64>,
}

/// A short linear run.
#[derive(Clone, Debug)]
pub struct Run {
    pub instants: Vec<Instant>,
    /// Mean and covariance of the first state.
    pub prior: Option<(DVector<f64>, DMatrix<f64>)>,
}

/// What is known of the first state of a stretch.
#[derive(Clone, Copy, Debug)]
pub enum Start<'a> {
    Known(&'a DVector<f64>, &'a DMatrix<f64>),
    Unknown,
}

/// An estimate with its error covariance.
#[derive(Clone, Debug)]
pub struct Posterior {
    pub mean: DVector<f64>,
    pub cov: DMatrix<f64>,
}

/// Whether data determine a state.
#[derive(Clone, Debug)]
pub enum Verdict {
    Determined(Posterior),
    Undetermined,
    /// Too near the threshold for two computations to agree.
    Borderline,
}

/// States and measurements of a stretch as linear functions of its first state and its noises.
struct Stretch {
    /// Φ, Θ and the known part of the wanted state.
    phi: DMatrix<f64>,
    theta: DMatrix<f64>,
    known: DVector<f64>,
    /// O, Ψ, covariance of v, and the data less their known part.
    o: DMatrix<f64>,
    psi: DMatrix<f64>,
    r: DMatrix<f64>,
    z: DVector<f64>,
    /// Covariance of the process noises.
    noise: DMatrix<f64>,
}

impl Run {
    pub fn n(&self) -> usize {
        self.instants[0].a.nrows()
    }

    pub fn len(&self) -> usize {
        self.instants.len()
    }

    pub fn start(&self) -> Start<'_> {
        match &self.prior {
            Some((mean, cov)) => Start::Known(mean, cov),
            None => Start::Unknown,
        }
    }

    /// The state at `at`, from the data of `data`; what is known of the state at `data.start` is `start`.
    pub fn posterior(&self, start: Start<'_>, data: Range<usize>, at: usize) -> Verdict {
        let s = self.stretch(data, at);
        match start {
            Start::Known(mean, cov) => Verdict::Determined(s.conditioned(mean, cov)),
            Start::Unknown => s.least_squares(),
        }
    }

    /// Least squares over `data` that ignores the process noise, and its true error covariance.
    pub fn without_process_noise(&self, data: Range<usize>, at: usize) -> Verdict {
        let s = self.stretch(data, at);
        let quiet = Stretch { noise: DMatrix::zeros(s.noise.nrows(), s.noise.ncols()), ..s.clone_parts() };
        let Verdict::Determined(estimate) = quiet.least_squares() else { return quiet.least_squares() };
        // The estimate is linear in the data: its gain column by column.
        let zero = DVector::zeros(s.z.len());
        let n = s.known.len();
        let apply =
            |z: DVector<f64>| match (Stretch { z, known: DVector::zeros(n), ..quiet.clone_parts() }).least_squares() {
                Verdict::Determined(p) => p.mean,
                _ => unreachable!("the data determine it whatever they are"),
            };
        let mut gain = DMatrix::zeros(n, s.z.len());
        for i in 0..s.z.len() {
            let mut unit = zero.clone();
            unit[i] = 1.0;
            gain.set_column(i, &apply(unit));
        }
        let felt = &gain * &s.psi - &s.theta;
        let cov = &felt * &s.noise * felt.transpose() + &gain * &s.r * gain.transpose();
        Verdict::Determined(Posterior { mean: estimate.mean, cov })
    }

    /// Normalised innovation squared of the rows at `at`, expected from the data of `data`, and their number.
    pub fn nis(&self, start: Start<'_>, data: Range<usize>, at: usize) -> Option<(f64, usize)> {
        let Verdict::Determined(expected) = self.posterior(start, data, at) else { return None };
        let here = &self.instants[at];
        let got: Vec<usize> = (0..here.z.len()).filter(|i| here.z[*i].is_some()).collect();
        if got.is_empty() {
            return None;
        }
        let c = here.c.select_rows(&got);
        let r = here.r.select_rows(&got).select_columns(&got);
        let z = DVector::from_iterator(got.len(), got.iter().map(|i| here.z[*i].unwrap()));
        let innovation = z - &c * expected.mean;
        let s = &c * expected.cov * c.transpose() + r;
        let solved = s.cholesky()?.solve(&innovation);
        Some((innovation.dot(&solved), got.len()))
    }

    fn stretch(&self, data: Range<usize>, at: usize) -> Stretch {
        let n = self.n();
        let first = data.start;
        assert!(at >= first, "an estimate before its data");
        let leaps = at.max(data.end.max(first + 1) - 1) - first;
        let mut phi = DMatrix::identity(n, n);
        let mut theta = DMatrix::zeros(n, n * leaps);
        let mut known = DVector::zeros(n);
        let mut noise = DMatrix::zeros(n * leaps, n * leaps);
        let mut wanted = None;
        let (mut o, mut psi, mut z, mut blocks) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for j in 0..=leaps {
            if first + j == at {
                wanted = Some((phi.clone(), theta.clone(), known.clone()));
            }
            if data.contains(&(first + j)) {
                let here = &self.instants[first + j];
                let got: Vec<usize> = (0..here.z.len()).filter(|i| here.z[*i].is_some()).collect();
                for i in &got {
                    let c = here.c.row(*i);
                    o.push(c * &phi);
                    psi.push(c * &theta);
                    z.push(here.z[*i].unwrap() - (c * &known)[0]);
                }
                blocks.push(here.r.select_rows(&got).select_columns(&got));
            }
            if j < leaps {
                // The run's last matrices stay in force for the leap beyond it.
                let here = &self.instants[(first + j).min(self.len() - 1)];
                phi = &here.a * phi;
                theta = &here.a * theta;
                theta.view_mut((0, n * j), (n, n)).copy_from(&DMatrix::identity(n, n));
                noise.view_mut((n * j, n * j), (n, n)).copy_from(&(&here.g * &here.q * here.g.transpose()));
                known = &here.a * known + &here.b * DVector::from_column_slice(&here.u);
            }
        }
        let (phi, theta, known) = wanted.expect("`at` lies within the stretch");
        let rows = z.len();
        let mut r = DMatrix::zeros(rows, rows);
        let mut at = 0;
        for block in blocks {
            r.view_mut((at, at), block.shape()).copy_from(&block);
            at += block.nrows();
        }
        let stacked = |parts: Vec<nalgebra::RowDVector<f64>>, cols: usize| match parts.is_empty() {
            true => DMatrix::zeros(0, cols),
            false => DMatrix::from_rows(&parts),
        };
        Stretch { phi, theta, known, o: stacked(o, n), psi: stacked(psi, n * leaps), r, z: DVector::from_vec(z), noise }
    }
}

impl Stretch {
    fn clone_parts(&self) -> Stretch {
        Stretch {
            phi: self.phi.clone(),
            theta: self.theta.clone(),
            known: self.known.clone(),
            o: self.o.clone(),
            psi: self.psi.clone(),
            r: self.r.clone(),
            z: self.z.clone(),
            noise: self.noise.clone(),
        }
    }

    /// The first state is `mean` plus one more noise of covariance `cov`.
    fn conditioned(&self, mean: &DVector<f64>, cov: &DMatrix<f64>) -> Posterior {
        let n = mean.len();
        let root = square_root(cov);
        let noise = square_root(&self.noise);
        let theta = beside(&(&self.phi * &root), &(&self.theta * &noise));
        let psi = beside(&(&self.o * &root), &(&self.psi * &noise));
        let z = &self.z - &self.o * mean;
        let none = DMatrix::zeros(n, 0);
        let mut found = solve(&none, &theta, &DMatrix::zeros(z.len(), 0), &psi, &self.r, &z, 0);
        found.mean += &self.phi * mean + &self.known;
        found
    }

    fn least_squares(&self) -> Verdict {
        let n = self.phi.nrows();
        // The contract's test of observability is on the noise-free window: its rows whitened by R alone, its columns scaled.
        let (seen, scale, v) = scaled_svd(&whitened(&self.r, &self.o), n);
        let largest = seen.max();
        let reach = DMatrix::from_fn(n, n, |i, j| self.phi[(i, j)] / scale[j]);
        let mut rank = 0;
        for (sigma, direction) in seen.iter().zip(v.column_iter()) {
            let ratio = if largest > 0.0 { sigma / largest } else { 0.0 };
            if ratio > 1e-4 {
                rank += 1;
            } else if ratio > 1e-14 {
                return Verdict::Borderline;
            } else {
                let felt = (&reach * direction).amax();
                if felt > 1e-6 * reach.amax() {
                    return Verdict::Undetermined;
                } else if felt > 1e-13 * reach.amax() {
                    return Verdict::Borderline;
                }
            }
        }
        let noise = square_root(&self.noise);
        let (theta, psi) = (&self.theta * &noise, &self.psi * &noise);
        let mut found = solve(&self.phi, &theta, &self.o, &psi, &self.r, &self.z, n - rank);
        found.mean += &self.known;
        Verdict::Determined(found)
    }
}

/// Least squares for an unknown `s` and for noises `e` of unit variance from `z = O s + Ψ e + v`; estimates `Φ s + Θ e`. The `blind`
/// weakest directions are left out: no row sees them, and what is estimated does not feel them.
fn solve(
    phi: &DMatrix<f64>,
    theta: &DMatrix<f64>,
    o: &DMatrix<f64>,
    psi: &DMatrix<f64>,
    r: &DMatrix<f64>,
    z: &DVector<f64>,
    blind: usize,
) -> Posterior {
    let (unknown, noises) = (o.ncols(), psi.ncols());
    let cols = unknown + noises;
    let mut data = DMatrix::zeros(z.len() + noises, cols);
    data.view_mut((0, 0), (z.len(), cols)).copy_from(&whitened(r, &beside(o, psi)));
    data.view_mut((z.len(), unknown), (noises, noises)).copy_from(&DMatrix::identity(noises, noises));
    let mut values = DVector::zeros(z.len() + noises);
    values
        .rows_mut(0, z.len())
        .copy_from(&whitened(r, &DMatrix::from_column_slice(z.len(), 1, z.as_slice())).column(0));
    let (sigma, scale, v) = scaled_svd(&data, cols);
    let mut order: Vec<usize> = (0..cols).collect();
    order.sort_by(|i, j| sigma[*j].total_cmp(&sigma[*i]));
    let reach = beside(phi, theta);
    let mut mean = DVector::zeros(phi.nrows());
    let mut cov = DMatrix::zeros(phi.nrows(), phi.nrows());
    for i in order.into_iter().take(cols - blind) {
        let direction = DVector::from_fn(cols, |k, _| v[(k, i)] / scale[k] / sigma[i]);
        let felt = &reach * &direction;
        mean += &felt * (&data * &direction).dot(&values);
        cov += &felt * felt.transpose();
    }
    Posterior { mean, cov }
}

fn beside(a: &DMatrix<f64>, b: &DMatrix<f64>) -> DMatrix<f64> {
    let mut out = DMatrix::zeros(a.nrows(), a.ncols() + b.ncols());
    out.view_mut((0, 0), a.shape()).copy_from(a);
    out.view_mut((0, a.ncols()), b.shape()).copy_from(b);
    out
}

/// `L⁻¹ m` with `R = L Lᵀ`.
fn whitened(r: &DMatrix<f64>, m: &DMatrix<f64>) -> DMatrix<f64> {
    if m.nrows() == 0 {
        return m.clone();
    }
    let root = r.clone().cholesky().expect("R is positive definite").l();
    root.solve_lower_triangular(m).expect("its diagonal is positive")
}

/// `F` with `F Fᵀ = m`, for a positive semidefinite `m`.
fn square_root(m: &DMatrix<f64>) -> DMatrix<f64> {
    if m.nrows() == 0 {
        return m.clone();
    }
    let eigen = ((m + m.transpose()) * 0.5).symmetric_eigen();
    let roots = eigen.eigenvalues.map(|l| l.max(0.0).sqrt());
    eigen.eigenvectors * DMatrix::from_diagonal(&roots)
}

/// Singular values and right vectors of `m` with its columns scaled to unit length, and the scales (1 for a column of zeros).
fn scaled_svd(m: &DMatrix<f64>, n: usize) -> (DVector<f64>, DVector<f64>, DMatrix<f64>) {
    // Rows of zeros make it tall, so that every right vector comes out.
    let mut tall = DMatrix::zeros(m.nrows().max(n), n);
    tall.view_mut((0, 0), m.shape()).copy_from(m);
    let mut scale = DVector::repeat(n, 1.0);
    for j in 0..n {
        let norm = tall.column(j).norm();
        if norm > 0.0 {
            scale[j] = norm;
            tall.column_mut(j).scale_mut(1.0 / norm);
        }
    }
    let svd = tall.svd(false, true);
    let v = svd.v_t.expect("asked for").transpose();
    (svd.singular_values, scale, v)
}

/// Worst deviation of an estimate: its mean in standard deviations (or parts of its size, where that is larger), its covariance
/// relative to the standard deviations of the two components.
pub fn deviation(mean: &[f64], cov: impl Fn(usize, usize) -> f64, truth: &Posterior) -> f64 {
    let n = truth.mean.len();
    assert_eq!(mean.len(), n);
    // A component known nearly exactly has no scale of its own: rounding is relative to the largest one.
    let floor = 1e-2 * truth.cov.diagonal().max().max(1e-300).sqrt();
    let sd: Vec<f64> = (0..n).map(|i| truth.cov[(i, i)].max(0.0).sqrt().max(floor)).collect();
    let size = truth.mean.amax();
    let mut worst: f64 = 0.0;
    for i in 0..n {
        let off = (mean[i] - truth.mean[i]).abs() / sd[i].max(size);
        worst = if off.is_nan() { f64::INFINITY } else { worst.max(off) };
        for j in 0..n {
            let off = (cov(i, j) - truth.cov[(i, j)]).abs() / (sd[i] * sd[j]);
            worst = if off.is_nan() { f64::INFINITY } else { worst.max(off) };
        }
    }
    worst
}
