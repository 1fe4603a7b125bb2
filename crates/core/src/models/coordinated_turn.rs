//! Coordinated turn in the plane with unknown turn rate.

use super::{DesignError, check_densities};
use crate::types::{Matrix, Transition, Vector};

/// A target that turns at a rate `ω` which is part of the state: `x y vx vy ω`, in m, m/s and rad/s.
///
/// The motion model of \[MVF10, sec. 4.2.1\] for any interval. Its printed `∂x/∂ω` has two misprints (a lost sign and a
/// misplaced term); here it stands as derived.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CoordinatedTurn {
    acceleration_psd: [f64; 2],
    turn_noise: TurnNoise,
}

/// How the turn rate changes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TurnNoise {
    /// A random walk of this density, rad²/s³: its variance grows with time, whatever the steps.
    Density(f64),
    /// Changes by `variance · dt^power` in every step, rad²/s². \[MVF10\] has power 0: two short steps shake more than a long one.
    PerStep {
        /// At steps of a second.
        variance: f64,
        /// Exponent of the step's length.
        power: u8,
    },
}

impl From<f64> for TurnNoise {
    fn from(density: f64) -> Self {
        TurnNoise::Density(density)
    }
}

impl TurnNoise {
    /// Variance of the change over an interval, rad²/s².
    fn over(&self, dt_s: f64) -> f64 {
        match *self {
            TurnNoise::Density(density) => density * dt_s,
            // No step, no change.
            TurnNoise::PerStep { .. } if dt_s == 0.0 => 0.0,
            TurnNoise::PerStep { variance, power } => variance * libm::pow(dt_s, power.into()),
        }
    }
}

impl CoordinatedTurn {
    /// Returns the model driven by white acceleration noise of density `acceleration_psd` per axis (m²/s³) and by a
    /// random walk of the turn rate: a density (rad²/s³) or a [`TurnNoise`].
    ///
    /// # Errors
    /// [`DesignError::NoiseDensity`] when a density is negative or not finite (index 2 is the turn rate's).
    pub fn new(acceleration_psd: [f64; 2], turn_noise: impl Into<TurnNoise>) -> Result<Self, DesignError> {
        let turn_noise = turn_noise.into();
        let (TurnNoise::Density(size) | TurnNoise::PerStep { variance: size, .. }) = turn_noise;
        check_densities(&[acceleration_psd[0], acceleration_psd[1], size])?;
        Ok(CoordinatedTurn { acceleration_psd, turn_noise })
    }

    /// Returns the motion over `dt_s` seconds, linearised at `x`.
    ///
    /// With `θ = ω dt`, `s = sin θ/θ`, `c = (1 − cos θ)/θ` and their derivatives `s′ c′`:
    /// `x⁺ = x + dt (s vx − c vy)`, `y⁺ = y + dt (c vx + s vy)`, the velocity turns by θ, ω stays; the column of ω is
    /// `dt² (s′vx − c′vy)`, `dt² (c′vx + s′vy)`, `−dt vy⁺`, `dt vx⁺`, 1.
    ///
    /// Noise: per axis that of constant velocity, `psd [[dt³/3, dt²/2], [dt²/2, dt]]`, which leaves the turn within the
    /// interval out (of relative order θ); on ω, that of the [`TurnNoise`].
    /// `dt_s` must be finite and at least 0; 0 gives the identity without noise.
    pub fn leap(&self, x: &Vector<5>, dt_s: f64) -> Transition<5> {
        debug_assert!(dt_s >= 0.0 && dt_s.is_finite(), "an interval of {dt_s} s");
        let Turn { sin, cos, s, c, ds, dc } = turn(x[4] * dt_s);
        let (vx, vy) = (x[2], x[3]);
        let (vx_next, vy_next) = (cos * vx - sin * vy, sin * vx + cos * vy);
        let dt2 = dt_s * dt_s;
        let next =
            Vector::from([x[0] + dt_s * (s * vx - c * vy), x[1] + dt_s * (c * vx + s * vy), vx_next, vy_next, x[4]]);
        #[rustfmt::skip]
        let f = Matrix::<5, 5>::new(
            1.0, 0.0, dt_s * s, -dt_s * c, dt2 * (ds * vx - dc * vy),
            0.0, 1.0, dt_s * c,  dt_s * s, dt2 * (dc * vx + ds * vy),
            0.0, 0.0, cos,      -sin,      -dt_s * vy_next,
            0.0, 0.0, sin,       cos,       dt_s * vx_next,
            0.0, 0.0, 0.0,       0.0,       1.0,
        );
        let mut q = Matrix::<5, 5>::zeros();
        for (axis, psd) in self.acceleration_psd.into_iter().enumerate() {
            let velocity = axis + 2;
            q[(axis, axis)] = psd * (dt2 * dt_s / 3.0);
            q[(axis, velocity)] = psd * (dt2 / 2.0);
            q[(velocity, axis)] = q[(axis, velocity)];
            q[(velocity, velocity)] = psd * dt_s;
        }
        q[(4, 4)] = self.turn_noise.over(dt_s);
        Transition { next, f, q }
    }
}

/// What a turn by θ needs.
struct Turn {
    sin: f64,
    cos: f64,
    /// sin θ/θ
    s: f64,
    /// (1 − cos θ)/θ
    c: f64,
    /// ds/dθ
    ds: f64,
    /// dc/dθ
    dc: f64,
}

/// Below this angle the closed forms of s′ and c′ cancel; the series does not.
const SERIES_BELOW: f64 = 0.5;

/// With θ² ≤ 1/4 the first term left out is below 1e-30 of the sum.
const TERMS: usize = 12;

/// Coefficients in powers of θ² of `s`, `c/θ`, `s′/θ` and `c′`.
const SERIES: [[f64; TERMS]; 4] = {
    let mut series = [[0.0; TERMS]; 4];
    let mut sign = 1.0;
    let mut factorial = 1.0; // (2k + 1)!
    let mut k = 0;
    while k < TERMS {
        let odd = (2 * k + 1) as f64;
        series[0][k] = sign / factorial;
        series[1][k] = sign / (factorial * (odd + 1.0));
        series[2][k] = -sign / (factorial * (odd + 2.0)); // −(2k + 2)/(2k + 3)!
        series[3][k] = sign * odd / (factorial * (odd + 1.0));
        factorial *= (odd + 1.0) * (odd + 2.0);
        sign = -sign;
        k += 1;
    }
    series
};

fn turn(theta: f64) -> Turn {
    if theta.abs() < SERIES_BELOW {
        let square = theta * theta;
        let mut sum = [0.0; 4];
        for k in (0..TERMS).rev() {
            for (sum, series) in sum.iter_mut().zip(&SERIES) {
                *sum = *sum * square + series[k];
            }
        }
        let [s, c, ds, dc] = [sum[0], sum[1] * theta, sum[2] * theta, sum[3]];
        Turn { sin: s * theta, cos: 1.0 - c * theta, s, c, ds, dc }
    } else {
        let (sin, cos) = libm::sincos(theta);
        let half = libm::sin(theta / 2.0);
        let (s, c) = (sin / theta, 2.0 * half * half / theta);
        Turn { sin, cos, s, c, ds: (cos - s) / theta, dc: (sin - c) / theta }
    }
}
