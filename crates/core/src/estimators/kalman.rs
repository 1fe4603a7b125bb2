//! Kalman filter and extended Kalman filter: one implementation, linear and nonlinear models differ in who linearises.
//!
//! ```text
//! x⁻ = f(x)              P⁻ = F P Fᵀ + Q
//! e  = z − h(x⁻)         s  = hᵀP⁻h + r        k = P⁻h/s
//! x  = x⁻ + k e          P  = (I − k hᵀ) P⁻ (I − k hᵀ)ᵀ + k r kᵀ
//! ```
//!
//! The functions are kept inline: handing a belief over through memory costs as much as its arithmetic (3 states: 82 ns a step against
//! 48, `fixtrail-bench`).
//!
//! Measurements of one instant are taken one scalar row at a time, all linearised at the prediction; correlated components are
//! whitened before. The Joseph form keeps the covariance positive semidefinite.

use crate::types::{Belief, Matrix, Row, StepError, Transition, Vector};

/// What an update does with a row that does not fit.
///
/// A gate judges a row given the rows before it. The other two weigh it by `ν = e/√s` given the prediction alone, before any row of the
/// instant is taken, so that the order of rows does not matter:
///
/// ```text
/// x = x⁻ + P⁻h/√s · ψ(ν),   ψ(ν) = w(ν) ν          the robust update of [MAM77]
/// s/w = hᵀP⁻h + r'   with   r' = r + s (1/w − 1)   the same as an ordinary update by a row of variance r'
/// ```
///
/// With several rows at one instant each has the variance r' of its own, and they are taken as ordinary rows are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Robust {
    /// Uses every row as it is.
    None,
    /// Leaves a row out when `e²/s` exceeds the threshold.
    Gate(f64),
    /// Huber's weight `min(1, c/|ν|)` \[HUB64\]: no row moves the state by more than `c P⁻h/√s`. At c = 1.345 the mean of normal data
    /// loses 5 % of its efficiency.
    Huber(f64),
    /// Tukey's biweight `(1 − ν²/c²)²` \[BTU74\], 0 from |ν| = c on: the row is left out. It is smooth and, unlike the Cauchy and Student
    /// weights, reaches 0. At c = 4.685 the mean of normal data loses 5 % of its efficiency.
    Redescending(f64),
}

impl Robust {
    /// Returns the weight of a row by its squared normalised innovation `ν²`, from 0 (left out) to 1 (used as it is).
    #[inline(always)]
    pub fn weight(&self, fit: f64) -> f64 {
        match *self {
            Robust::None => 1.0,
            Robust::Gate(limit) => f64::from(u8::from(!(fit > limit))),
            Robust::Huber(c) if fit > c * c => c / libm::sqrt(fit),
            Robust::Huber(_) => 1.0,
            Robust::Redescending(c) => {
                let rest = 1.0 - fit / (c * c);
                if rest > 0.0 { rest * rest } else { 0.0 }
            }
        }
    }
}

/// Squared normalised innovation above which a row counts as a misfit: three standard deviations.
pub const MISFIT: f64 = 9.0;

/// What the measurements of one instant said of the prediction.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Evidence {
    /// Normalised innovation squared `Σ e²/s`, rejected rows included.
    pub nis: f64,
    /// Number of scalar rows behind `nis`.
    pub dof: u32,
    /// Rows left out: of weight 0.
    pub rejected: u32,
    /// Rows further than three standard deviations from what was expected of them, [`MISFIT`].
    pub misfits: u32,
}

/// One row's innovation, given the rows before it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Innovation {
    /// Index of the row.
    pub row: usize,
    /// Innovation.
    pub e: f64,
    /// Its variance.
    pub s: f64,
    /// The row's noise variance as it was used: inflated where the row has a weight below 1.
    pub var: f64,
}

impl Innovation {
    /// Logarithm of the innovation's normal density; over all rows used they add up to the log-likelihood of the data.
    pub fn log_density(&self) -> f64 {
        -0.5 * (self.e * self.e / self.s + libm::log(core::f64::consts::TAU * self.s))
    }
}

/// Returns the belief after one interval of motion: `next` is the mean, `F P Fᵀ + Q` the covariance.
#[inline(always)]
pub fn predict<const N: usize>(posterior: &Belief<N>, transition: &Transition<N>) -> Belief<N> {
    Belief { mean: transition.next, cov: propagate(&posterior.cov, &transition.f, &transition.q) }
}

/// Returns `F P Fᵀ + Q`, symmetric to the bit.
#[inline(always)]
pub(crate) fn propagate<const N: usize>(p: &Matrix<N, N>, f: &Matrix<N, N>, q: &Matrix<N, N>) -> Matrix<N, N> {
    let fp = f * p;
    let mut out = *q;
    for j in 0..N {
        for i in 0..=j {
            let mut v = 0.5 * (q[(i, j)] + q[(j, i)]);
            for k in 0..N {
                v += fp[(i, k)] * f[(j, k)];
            }
            out[(i, j)] = v;
            out[(j, i)] = v;
        }
    }
    out
}

/// Returns the belief after the rows of one instant, linearised at `prior.mean`, and their evidence.
///
/// # Errors
/// [`StepError::InnovationVariance`] when `hᵀP⁻h + r` is not a positive number, [`StepError::NotFinite`] when the result is not
/// finite.
#[inline(always)]
pub fn update<const N: usize>(
    prior: &Belief<N>,
    rows: &[Row<N>],
    robust: Robust,
) -> Result<(Belief<N>, Evidence), StepError> {
    update_noting(prior, rows, robust, |_| {})
}

/// As [`update`]; `used` is told the innovation of every row that was not left out.
///
/// # Errors
/// As [`update`].
#[inline(always)]
pub fn update_noting<const N: usize>(
    prior: &Belief<N>,
    rows: &[Row<N>],
    robust: Robust,
    mut used: impl FnMut(Innovation),
) -> Result<(Belief<N>, Evidence), StepError> {
    update_judging(prior, rows, robust, |judged| {
        if judged.var < f64::INFINITY {
            let Judged { row, e, s, var } = judged;
            used(Innovation { row, e, s: s + (var - rows[row].var), var });
        }
    })
}

/// One row as an update judged it, whether it was used or not.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Judged {
    /// Index of the row.
    pub(crate) row: usize,
    /// Innovation given the rows before as they were used.
    pub(crate) e: f64,
    /// Its variance at the row's own noise.
    pub(crate) s: f64,
    /// The noise variance that it was used with; infinite where it was left out.
    pub(crate) var: f64,
}

/// As [`update`]; `judged` is told of every row.
#[inline(always)]
pub(crate) fn update_judging<const N: usize>(
    prior: &Belief<N>,
    rows: &[Row<N>],
    robust: Robust,
    mut judged: impl FnMut(Judged),
) -> Result<(Belief<N>, Evidence), StepError> {
    let mut cov = prior.cov;
    let mut correction = Vector::<N>::zeros();
    let mut evidence = Evidence::default();
    for (i, row) in rows.iter().enumerate() {
        let ph = cov * row.h;
        let s = row.h.dot(&ph) + row.var;
        if !(s > 0.0 && s.is_finite()) {
            return Err(StepError::InnovationVariance { var: s });
        }
        let e = row.residual - row.h.dot(&correction);
        let mut fit = e * e * (1.0 / s);
        let mut var = row.var;
        evidence.nis += fit;
        evidence.dof += 1;
        match robust {
            Robust::None => {}
            Robust::Gate(limit) if fit > limit => var = f64::INFINITY,
            Robust::Gate(_) => {}
            Robust::Huber(_) | Robust::Redescending(_) => {
                let alone = row.h.dot(&(prior.cov * row.h)) + row.var;
                fit = row.residual * row.residual / alone;
                // An infinite variance is that of a row left out.
                var += alone * (1.0 / robust.weight(fit) - 1.0);
            }
        }
        evidence.misfits += u32::from(fit > MISFIT);
        judged(Judged { row: i, e, s, var });
        if var == f64::INFINITY {
            evidence.rejected += 1;
            continue;
        }
        let s = s + (var - row.var);
        let gain = ph * (1.0 / s);
        correction += gain * e;
        cov = joseph(&cov, &row.h, var, &ph, s);
    }
    let mean = prior.mean + correction;
    finite(&mean, &cov)?;
    Ok((Belief { mean, cov }, evidence))
}

/// Returns `(I − k hᵀ) P (I − k hᵀ)ᵀ + k r kᵀ` for the gain `k = P h/s`, symmetric to the bit; `ph = P h`, `s = hᵀP h + r`.
///
/// For this gain the Joseph form is `P − (Ph)(Ph)ᵀ/s`: all its terms are multiples of `(Ph)(Ph)ᵀ`. What the subtraction loses to rounding
/// is put right along h, where the exact result `P⁺h = k r` is known without subtraction; or a small r would drown. The correction runs
/// along `P h`, in each state's own unit: along h itself, a state known well would take on the errors of others.
#[inline(always)]
pub(crate) fn joseph<const N: usize>(
    p: &Matrix<N, N>,
    h: &Vector<N>,
    var: f64,
    ph: &Vector<N>,
    s: f64,
) -> Matrix<N, N> {
    let known = h.dot(ph);
    if !(known > 0.0) {
        return *p;
    }
    let gain = ph * (1.0 / s);
    let mut out = *p;
    for j in 0..N {
        for i in 0..=j {
            let v = p[(i, j)] - gain[i] * ph[j];
            out[(i, j)] = v;
            out[(j, i)] = v;
        }
    }
    let inverse = 1.0 / known;
    let missing = (gain * var - out * h) * inverse;
    let side = missing - ph * (0.5 * h.dot(&missing) * inverse);
    for j in 0..N {
        for i in 0..=j {
            let v = out[(i, j)] + side[i] * ph[j] + ph[i] * side[j];
            out[(i, j)] = v;
            out[(j, i)] = v;
        }
    }
    out
}

/// Checks that mean and variances are numbers.
#[inline(always)]
pub(crate) fn finite<const N: usize>(mean: &Vector<N>, cov: &Matrix<N, N>) -> Result<(), StepError> {
    for i in 0..N {
        if !(mean[i].is_finite() && cov[(i, i)].is_finite()) {
            return Err(StepError::NotFinite { component: i });
        }
    }
    Ok(())
}
