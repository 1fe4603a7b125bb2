//! Noise, gross errors and liveliness of a series of numbers, from its local differences.

use super::stats::{MAD_TO_SD, ascending, median, quantile, robust_sd};

/// A scalar series: instants and values without holes.
#[derive(Clone, Debug, Default)]
pub(super) struct Samples {
    pub t_s: Vec<f64>,
    pub value: Vec<f64>,
}

impl Samples {
    /// The samples that were measured.
    pub(super) fn of(t_s: &[f64], value: &[f64]) -> Samples {
        let (t_s, value) = t_s.iter().zip(value).filter(|(_, v)| v.is_finite()).map(|(t, v)| (*t, *v)).unzip();
        Samples { t_s, value }
    }
}

/// Fewer differences than this say nothing.
const ENOUGH: usize = 20;

/// Standard deviation of the quick part of the noise.
///
/// The residual of four neighbours against the best parabola, scaled to unit gain: motion of constant acceleration leaves no trace, whatever the
/// spacing (between even and 1 : 3). The median magnitude of the residuals gives the deviation, so that gross errors hardly count.
/// An error that neighbours share (a bias, a multipath) is not seen.
pub(super) fn quick_sd(samples: &Samples) -> Option<f64> {
    let residuals: Vec<f64> = (3..samples.t_s.len())
        .filter_map(|i| {
            let t: [f64; 4] = core::array::from_fn(|j| samples.t_s[i - 3 + j]);
            let steps = [t[1] - t[0], t[2] - t[1], t[3] - t[2]];
            let (shortest, longest) = steps.iter().fold((f64::MAX, 0.0_f64), |(a, b), d| (a.min(*d), b.max(*d)));
            if !(shortest > 0.0 && longest <= 3.0 * shortest) {
                return None;
            }
            // Weights of the third divided difference.
            let w: [f64; 4] =
                core::array::from_fn(|j| (0..4).filter(|k| *k != j).map(|k| shortest / (t[j] - t[k])).product::<f64>());
            let gain = w.iter().map(|w| w * w).sum::<f64>().sqrt();
            Some((0..4).map(|j| w[j] * samples.value[i - 3 + j]).sum::<f64>() / gain)
        })
        .collect();
    if residuals.len() < ENOUGH {
        return None;
    }
    robust_sd(residuals)
}

/// Samples that stand out alone from their neighbours by more than `limit` deviations of the usual difference and 5 `sd`:
/// index and distance.
pub(super) fn outliers(samples: &Samples, sd: f64, limit: f64) -> Vec<(usize, f64)> {
    let n = samples.t_s.len();
    if n < ENOUGH {
        return Vec::new();
    }
    let Some(step) = median(samples.t_s.windows(2).map(|w| w[1] - w[0])) else { return Vec::new() };
    let bend: Vec<f64> = (1..n - 1)
        .map(|i| {
            let (t, v) = (&samples.t_s, &samples.value);
            // After a silence a value may well be elsewhere.
            if (t[i] - t[i - 1]).max(t[i + 1] - t[i]) > 3.0 * step {
                return 0.0;
            }
            let share = (t[i] - t[i - 1]) / (t[i + 1] - t[i - 1]);
            v[i] - (v[i - 1] + share * (v[i + 1] - v[i - 1]))
        })
        .collect();
    let Some(usual) = robust_sd(bend.iter().copied().filter(|b| *b != 0.0)) else { return Vec::new() };
    let threshold = (limit * usual).max(5.0 * sd);
    (0..bend.len())
        .filter(|i| {
            let size = bend[*i].abs();
            // A lone error bends its neighbours half as much the other way.
            let neighbours = [i.checked_sub(1), Some(i + 1)];
            size > threshold && neighbours.into_iter().flatten().all(|j| bend.get(j).is_none_or(|b| b.abs() < size))
        })
        .map(|i| (i + 1, bend[i]))
        .collect()
}

/// How the values change: speed and, as a model of constant velocity sees it, the density of the driving noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Liveliness {
    /// 95 % quantile of the rate of change.
    pub speed: f64,
    /// Power spectral density of the acceleration, unit²/s³.
    pub psd: f64,
}

/// Speed and acceleration density of a series with noise `sd`, and errors of `lasting_sd` that neighbours share.
///
/// For `ẍ = w` of density `s` the bend `x(t₁)` against the line through `x(t₁−a)` and `x(t₁+b)` has variance `s a²b²/(3(a + b))`, to which
/// noise adds `sd²(1 + (a² + b²)/(a + b)²)`. The span is the shortest, in powers of two of the sampling interval, at which motion outweighs
/// all errors: about the memory of a filter. Only the noise is subtracted; what lasting errors bend counts as motion. The 90 % quantile of the bends counts, so that a target that rests most of the time still may move.
pub(super) fn liveliness(samples: &Samples, sd: f64, lasting_sd: f64) -> Option<Liveliness> {
    let n = samples.t_s.len();
    let step = median(samples.t_s.windows(2).map(|w| w[1] - w[0]))?;
    let mut speed = None;
    let mut speed_is_clear = false;
    let mut psd = None;
    let mut lag = 1;
    while lag <= 64 && n >= 2 * lag + ENOUGH {
        if !speed_is_clear {
            let moves = |i: usize| (samples.value[i] - samples.value[i - lag]).abs();
            let rates = ascending((lag..n).map(|i| moves(i) / (samples.t_s[i] - samples.t_s[i - lag])));
            speed = quantile(&rates, 0.95);
            let usual_move = quantile(&ascending((lag..n).map(moves)), 0.9)?;
            speed_is_clear = usual_move > 4.0 * core::f64::consts::SQRT_2 * sd;
        }
        let mut bends = Vec::new();
        let mut noise = Vec::new();
        for i in lag..n - lag {
            let (a, b) = (samples.t_s[i] - samples.t_s[i - lag], samples.t_s[i + lag] - samples.t_s[i]);
            let even = a > 0.0 && b > 0.0 && a.max(b) <= 3.0 * a.min(b) && a.max(b) <= 3.0 * lag as f64 * step;
            if even {
                let span = a + b;
                let motion = a * a * b * b / (3.0 * span);
                let line = (samples.value[i - lag] * b + samples.value[i + lag] * a) / span;
                bends.push((samples.value[i] - line).powi(2) / motion);
                noise.push((1.0 + (a * a + b * b) / (span * span)) / motion);
            }
        }
        if bends.len() >= ENOUGH {
            // 2.706 is the 90 % quantile of a squared standard normal variable.
            let total = quantile(&ascending(bends), 0.9)? / 2.706;
            let noise = median(noise)?;
            // The longest span leaves the smallest value that noise can hide.
            psd = Some((total - sd * sd * noise).max(0.1 * sd * sd * noise));
            if total > (sd * sd + lasting_sd.max(sd).powi(2)) * noise {
                break;
            }
        }
        lag *= 2;
    }
    Some(Liveliness { speed: speed?, psd: psd? })
}

/// Robust standard deviation from a median magnitude of residuals with `dof` degrees of freedom each: `√(Σr²/dof)`.
///
/// The median of χ²/dof is `(1 − 2/(9 dof))³` (Wilson and Hilferty), within 1.5 % from one degree on.
pub(super) fn sd_from_group_residuals(rms: &[f64], dof: usize) -> Option<f64> {
    let expected = if dof == 1 { 1.0 / MAD_TO_SD } else { (1.0 - 2.0 / (9.0 * dof as f64)).powf(1.5) };
    median(rms.iter().copied()).map(|m| m / expected)
}
