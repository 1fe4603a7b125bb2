//! Coordinated turn in the plane with unknown turn rate.

use super::{DesignError, check_densities};
use crate::kernels::Arc;
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
        let Arc { sin, cos, along: s, aside: c, along_slope: ds, aside_slope: dc } = Arc::of(x[4] * dt_s);
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
