//! The models of a spec, run forwards: states and measurements that are as the spec says they are.
//! [`registry::simulator`](crate::registry::simulator) builds one.

use crate::model::{HeldRows, Model};
use crate::packet::Content;
use crate::tracker::Step;
use fixtrail_core::linalg::{cholesky, semidefinite_factor};
use fixtrail_core::{Matrix, Vector, cramer_rao};

/// Standard normal deviates, one at a call.
pub type Normal<'a> = dyn FnMut() -> f64 + 'a;

/// Simulates one spec's motion and measurements. States have `n` components in the order of the layout.
pub trait Simulator: Send + Sync {
    /// Number of state components.
    fn n(&self) -> usize;

    /// A start from the prior; its mean when `normal` is absent. Zeros without a prior.
    fn start(&self, normal: Option<&mut Normal<'_>>) -> Vec<f64>;

    /// The state `dt_s` after instant `k`, with process noise when `normal` is there.
    fn leap(&self, k: u64, dt_s: f64, x: &[f64], normal: Option<&mut Normal<'_>>) -> Vec<f64>;

    /// Fills in what the packets of `step`, of which only kinds and anchors count, measure at `x`.
    fn measure(&self, step: &Step<'_>, x: &[f64], normal: &mut Normal<'_>) -> Vec<f64>;

    /// `eᵀ P⁻¹ e`; `None` when P is not positive definite.
    fn nees(&self, error: &[f64], cov: &[f64]) -> Option<f64>;

    /// Covariance of the prior; zeros without one.
    fn start_cov(&self) -> Vec<f64>;

    /// The Cramér–Rao bound `dt_s` after instant `k`, from that of a target at `x`
    /// ([`cramer_rao::moved`]); `noisy`: whether targets have the model's process noise.
    fn bound_moved(&self, k: u64, dt_s: f64, x: &[f64], bound: &[f64], noisy: bool) -> Vec<f64>;

    /// The bound of a target at `x` once the packets of `step`, of which only kinds and anchors count, arrive together with probability
    /// `arrival` ([`cramer_rao::measured`]).
    fn bound_measured(&self, step: &Step<'_>, x: &[f64], bound: &[f64], arrival: f64) -> Vec<f64>;
}

impl<const N: usize> Simulator for Model<N> {
    fn n(&self) -> usize {
        N
    }

    fn start(&self, normal: Option<&mut Normal<'_>>) -> Vec<f64> {
        let Some(prior) = &self.prior else { return vec![0.0; N] };
        let mut x = prior.mean;
        if let Some(normal) = normal {
            x += semidefinite_factor(&prior.cov) * Vector::<N>::from_fn(|_, _| normal());
        }
        x.as_slice().to_vec()
    }

    fn leap(&self, k: u64, dt_s: f64, x: &[f64], normal: Option<&mut Normal<'_>>) -> Vec<f64> {
        let leap = self.motion.leap(k, dt_s, &Vector::zeros(), &Vector::from_column_slice(x));
        let mut next = leap.next;
        if let Some(normal) = normal {
            next += semidefinite_factor(&leap.q) * Vector::<N>::from_fn(|_, _| normal());
        }
        next.as_slice().to_vec()
    }

    fn measure(&self, step: &Step<'_>, x: &[f64], normal: &mut Normal<'_>) -> Vec<f64> {
        let mut rows = HeldRows::default();
        self.sensing.held(step, &Vector::from_column_slice(x), &mut rows);
        let q = rows.values.len();
        // The spec has checked that R is positive definite.
        let factored = cholesky(&mut rows.r, q);
        debug_assert!(factored);
        let deviates: Vec<f64> = (0..q).map(|_| normal()).collect();
        let noise = |i: usize| (0..=i).map(|j| rows.r[i * q + j] * deviates[j]).sum::<f64>();
        (0..q).map(|i| rows.expected[i] + noise(i)).collect()
    }

    fn nees(&self, error: &[f64], cov: &[f64]) -> Option<f64> {
        let (inverse, _) = fixtrail_core::linalg::definite_inverse(&Matrix::<N, N>::from_column_slice(cov))?;
        let e = Vector::<N>::from_column_slice(error);
        Some(e.dot(&(inverse * e)))
    }

    fn start_cov(&self) -> Vec<f64> {
        self.prior.as_ref().map_or(vec![0.0; N * N], |prior| prior.cov.as_slice().to_vec())
    }

    fn bound_moved(&self, k: u64, dt_s: f64, x: &[f64], bound: &[f64], noisy: bool) -> Vec<f64> {
        let leap = self.motion.leap(k, dt_s, &Vector::zeros(), &Vector::from_column_slice(x));
        let q = if noisy { leap.q } else { Matrix::zeros() };
        cramer_rao::moved(&Matrix::<N, N>::from_column_slice(bound), &leap.f, &q).as_slice().to_vec()
    }

    fn bound_measured(&self, step: &Step<'_>, x: &[f64], bound: &[f64], arrival: f64) -> Vec<f64> {
        let mut rows = Vec::new();
        self.sensing.rows(step, &Vector::from_column_slice(x), &mut rows);
        cramer_rao::measured(&Matrix::<N, N>::from_column_slice(bound), &rows, arrival).as_slice().to_vec()
    }
}

/// A content of the same kind and anchors that holds `values`; missing ones are 0.
pub fn filled(content: &Content, values: &[f64]) -> Content {
    let at = |i: usize| values.get(i).copied().unwrap_or(0.0);
    match *content {
        Content::Position(p) => {
            let mut values = values.iter();
            Content::Position(p.map(|v| v.and_then(|_| values.next().copied())))
        }
        Content::Range { anchor, .. } => Content::Range { anchor, value_m: at(0) },
        Content::Rssi { anchor, .. } => Content::Rssi { anchor, value_dbm: at(0) },
        Content::Tdoa { anchor, reference, .. } => Content::Tdoa { anchor, reference, value_m: at(0) },
        Content::Bearing { anchor, .. } => Content::Bearing { anchor, value_rad: at(0) },
        Content::Linear { ref u, .. } => Content::Linear { z: values.iter().map(|v| Some(*v)).collect(), u: u.clone() },
    }
}
