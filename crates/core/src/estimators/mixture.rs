//! The gain of [`lmvf`](super::lmvf) and [`emvf`](super::emvf): what is shown is one of three measurements with known probabilities.
//!
//! ```text
//! y ≈ Σ q_i (G_i x + c_i) + noise,   q = (p⁺, (1−p⁺) p, (1−p⁺)(1−p))
//! J = Σ q_i G_i                                                                        (17)
//! M = Σ_{i<j} q_i q_j (G_i−G_j) S (G_i−G_j)ᵀ + (1−Σq_i) Σ q_i G_i S G_iᵀ + noise
//! D = J P Jᵀ + M + q_1 C W Cᵀ                                                          (15), pairwise: no cancellation
//! K = (A P Jᵀ + q_1 W Cᵀ) D⁻¹
//! P⁺ = F P Fᵀ + q_1 (I−KC) W (I−KC)ᵀ + (1−q_1) W + K M Kᵀ,   F = A − K J               = (16), semidefinite for any K
//! ```

use crate::estimators::augmented::Shown;
use crate::estimators::kalman::Evidence;
use crate::linalg::{Lu, definite_inverse, semidefinite_factor, symmetrised};
use crate::types::{Matrix, StepError, Transition, Vector};

/// Returns the probabilities that y is the newest measurement, the one before and the one before that, as \[MVF10\] has them.
pub(crate) fn weights(arrival: f64, arrival_before: f64) -> [f64; 3] {
    let lost = 1.0 - arrival;
    [arrival, lost * arrival_before, lost * (1.0 - arrival_before)]
}

/// Returns `G Φ⁻¹`.
///
/// # Errors
/// [`StepError::SingularTransition`].
pub(crate) fn back<const N: usize, const M: usize>(
    g: &Matrix<M, N>,
    phi: &Matrix<N, N>,
) -> Result<Matrix<M, N>, StepError> {
    let lu = Lu::new(*phi).ok_or(StepError::SingularTransition)?;
    let out = lu.solve_transposed(g.transpose()).transpose();
    if out.iter().all(|v| v.is_finite()) { Ok(out) } else { Err(StepError::SingularTransition) }
}

/// Unconditional mean and second moment of the state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Moment<const N: usize> {
    pub(crate) mean: Vector<N>,
    pub(crate) second: Matrix<N, N>,
}

impl<const N: usize> Moment<N> {
    /// Returns the moments after `x⁺ = F x + b + w`. \[MVF10\] after (17) for b = 0.
    pub(crate) fn leap(&self, leap: &Transition<N>, b: &Vector<N>) -> Self {
        let fx = leap.f * self.mean;
        let second = crate::estimators::kalman::propagate(&self.second, &leap.f, &leap.q);
        let second = second + fx * b.transpose() + b * fx.transpose() + b * b.transpose();
        Self { mean: fx + b, second: symmetrised(&second) }
    }

    /// Returns `E[(G x + c)(G x + c)ᵀ]`.
    fn of<const M: usize>(&self, g: &Matrix<M, N>, c: &Vector<M>) -> Matrix<M, M> {
        let gm = g * self.mean;
        g * self.second * g.transpose() + gm * c.transpose() + c * gm.transpose() + c * c.transpose()
    }
}

/// One thing that y may be: `G x + c` with probability `q`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Part<const N: usize, const M: usize> {
    pub(crate) q: f64,
    pub(crate) g: Matrix<M, N>,
    pub(crate) c: Vector<M>,
}

impl<const N: usize, const M: usize> Part<N, M> {
    /// A part that does not occur.
    pub(crate) fn never() -> Self {
        Self { q: 0.0, g: Matrix::zeros(), c: Vector::zeros() }
    }
}

/// Returns what the uncertainty about which part it is adds to the covariance of y. Parts and pairs without weight are not formed.
///
/// # Errors
/// [`StepError::SecondMoment`] when the moments are needed and not finite.
pub(crate) fn spread<const N: usize, const M: usize>(
    parts: &[Part<N, M>; 3],
    moment: &Moment<N>,
) -> Result<Matrix<M, M>, StepError> {
    let mut m = Matrix::<M, M>::zeros();
    for i in 0..3 {
        for j in i + 1..3 {
            let weight = parts[i].q * parts[j].q;
            if weight > 0.0 {
                m += moment.of(&(parts[i].g - parts[j].g), &(parts[i].c - parts[j].c)) * weight;
            }
        }
    }
    let nothing = 1.0 - parts.iter().map(|p| p.q).sum::<f64>();
    // Rounding leaves a few ε of three weights that add up to 1.
    if nothing > 4.0 * f64::EPSILON {
        for part in parts.iter().filter(|p| p.q > 0.0) {
            m += moment.of(&part.g, &part.c) * (nothing * part.q);
        }
    }
    if m.iter().all(|v| v.is_finite()) { Ok(symmetrised(&m)) } else { Err(StepError::SecondMoment) }
}

/// What a step used, by the names of \[MVF10\].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Used<const N: usize, const M: usize> {
    /// J.
    pub j: Matrix<M, N>,
    /// D.
    pub d: Matrix<M, M>,
    /// K; 0 in the columns of what is not seen.
    pub gain: Matrix<N, M>,
    /// y less its expectation, 0 for what is not seen.
    pub innovation: Vector<M>,
    /// The innovation normalised.
    pub evidence: Evidence,
}

/// The covariance a filter goes on with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Form<const N: usize> {
    /// P.
    Full(Matrix<N, N>),
    /// L with P = L Lᵀ.
    Root(Matrix<N, N>),
}

impl<const N: usize> Form<N> {
    pub(crate) fn cov(&self) -> Matrix<N, N> {
        match self {
            Form::Full(p) => *p,
            Form::Root(l) => symmetrised(&(l * l.transpose())),
        }
    }
}

/// One step's linear algebra: what it takes.
pub(crate) struct Step<'a, const N: usize, const M: usize> {
    pub(crate) leap: &'a Transition<N>,
    /// C of the new instant.
    pub(crate) c: Matrix<M, N>,
    pub(crate) j: Matrix<M, N>,
    /// M.
    pub(crate) noise: Matrix<M, M>,
    /// q_1.
    pub(crate) fresh: f64,
}

impl<const N: usize, const M: usize> Step<'_, N, M> {
    /// Returns D, K and the next covariance.
    ///
    /// # Errors
    /// [`StepError::InnovationVariance`] when D is not positive definite.
    pub(crate) fn take(
        &self,
        form: &Form<N>,
        shown: &Shown<M>,
    ) -> Result<(Matrix<M, M>, Matrix<N, M>, Form<N>), StepError> {
        match form {
            Form::Full(p) => self.full(p, shown),
            Form::Root(l) => self.root(l, shown),
        }
    }

    fn full(&self, p: &Matrix<N, N>, shown: &Shown<M>) -> Result<(Matrix<M, M>, Matrix<N, M>, Form<N>), StepError> {
        let Step { leap, c, j, noise, fresh } = self;
        let (pj, wc) = (p * j.transpose(), leap.q * c.transpose() * *fresh);
        let d = symmetrised(&(j * pj + noise + c * wc));
        let (inverse, _) =
            definite_inverse(&shown.decoupled(&d)).ok_or(StepError::InnovationVariance { var: d[(0, 0)] })?;
        let gain = (leap.f * pj + wc) * shown.restricted(&inverse);
        let f = leap.f - gain * j;
        let rest = Matrix::identity() - gain * c;
        let next = f * p * f.transpose()
            + rest * leap.q * rest.transpose() * *fresh
            + leap.q * (1.0 - fresh)
            + gain * noise * gain.transpose();
        Ok((d, gain, Form::Full(symmetrised(&next))))
    }

    /// The same without ever forming a covariance: the rows
    ///
    /// ```text
    /// [ (J P^½)ᵀ      (A P^½)ᵀ        ]
    /// [ √q_1 (C W^½)ᵀ  √q_1 (W^½)ᵀ     ]     made triangular     [ D^½ᵀ  D^-½(…) ]
    /// [ (M^½)ᵀ         0              ]     ───────────────►     [ 0     P⁺^½ᵀ   ]
    /// [ 0              √(1−q_1)(W^½)ᵀ  ]
    /// ```
    fn root(&self, l: &Matrix<N, N>, shown: &Shown<M>) -> Result<(Matrix<M, M>, Matrix<N, M>, Form<N>), StepError> {
        let Step { leap, c, j, noise, fresh } = self;
        let seen = |v: Vector<M>| Vector::<M>::from_fn(|i, _| if shown.seen[i] { v[i] } else { 0.0 });
        let mut array = Triangle::<N, M>::new(shown);
        let (jl, fl) = (j * l, leap.f * l);
        let w = semidefinite_factor(&leap.q);
        let (with, without) = (libm::sqrt(*fresh), libm::sqrt(1.0 - fresh));
        let (w_fresh, cw) = (w * with, c * w * with);
        let m = semidefinite_factor(noise);
        for i in 0..N {
            array.add(seen(jl.column(i).into()), fl.column(i).into());
            array.add(seen(cw.column(i).into()), w_fresh.column(i).into());
            array.add(Vector::zeros(), w.column(i) * without);
        }
        for i in 0..M {
            array.add(seen(m.column(i).into()), Vector::zeros());
        }
        let d = symmetrised(&(jl * jl.transpose() + noise + cw * cw.transpose()));
        let gain = array.gain(shown).ok_or(StepError::InnovationVariance { var: d[(0, 0)] })?;
        Ok((d, gain, Form::Root(array.rest.transpose())))
    }
}

/// Rows made triangular by Givens rotations.
struct Triangle<const N: usize, const M: usize> {
    r: Matrix<M, M>,
    side: Matrix<M, N>,
    rest: Matrix<N, N>,
}

impl<const N: usize, const M: usize> Triangle<N, M> {
    fn new(shown: &Shown<M>) -> Self {
        // What is not seen gets a row of its own that nothing is rotated into.
        let r = Matrix::from_fn(|i, j| if i == j && !shown.seen[i] { 1.0 } else { 0.0 });
        Self { r, side: Matrix::zeros(), rest: Matrix::zeros() }
    }

    fn add(&mut self, mut a: Vector<M>, mut b: Vector<N>) {
        for i in 0..M {
            if let Some((c, s)) = rotation(&mut self.r[(i, i)], a[i]) {
                for j in i + 1..M {
                    rotate(c, s, &mut self.r[(i, j)], &mut a[j]);
                }
                for j in 0..N {
                    rotate(c, s, &mut self.side[(i, j)], &mut b[j]);
                }
            }
        }
        for i in 0..N {
            if let Some((c, s)) = rotation(&mut self.rest[(i, i)], b[i]) {
                for j in i + 1..N {
                    rotate(c, s, &mut self.rest[(i, j)], &mut b[j]);
                }
            }
        }
    }

    /// `Kᵀ = R⁻¹ side`.
    fn gain(&self, shown: &Shown<M>) -> Option<Matrix<N, M>> {
        let mut k = self.side;
        for i in (0..M).rev() {
            let d = self.r[(i, i)];
            if !(d != 0.0 && d.is_finite()) {
                return None;
            }
            for col in 0..N {
                let mut v = k[(i, col)];
                for j in i + 1..M {
                    v -= self.r[(i, j)] * k[(j, col)];
                }
                k[(i, col)] = if shown.seen[i] { v / d } else { 0.0 };
            }
        }
        Some(k.transpose())
    }
}

/// Rotates `b` into `a`, the diagonal; returns cosine and sine unless there is nothing to do.
fn rotation(a: &mut f64, b: f64) -> Option<(f64, f64)> {
    if b == 0.0 {
        return None;
    }
    let rho = libm::hypot(*a, b);
    let (c, s) = (*a / rho, b / rho);
    *a = rho;
    Some((c, s))
}

fn rotate(c: f64, s: f64, a: &mut f64, b: &mut f64) {
    (*a, *b) = (c * *a + s * *b, c * *b - s * *a);
}
