//! `[model]`: how targets move.

use super::linear::{self, Sources};
use super::matrix::{Definite, covariance, shape, vector};
use super::names::{MODELS, choose};
use super::value::{Field, Table};
use super::{GaussMarkovSpec, KinematicSpec, LinearSpec, LinearStep, ModelSpec, Prior, TurnSpec};
use crate::error::BuildError;
use crate::mat::Mat;

/// The model in `table`.
pub(super) fn model(table: &Table<'_>, sources: &mut Sources<'_>) -> Result<ModelSpec, BuildError> {
    let kind = choose(&table.require("kind", "the name of a model, such as \"constant-velocity\"")?, MODELS, &[])?;
    let whose = format!("the model `{kind}`");
    Ok(match kind {
        "random-walk" => ModelSpec::Kinematic(kinematic(table, &whose, 1)?),
        "constant-velocity" => ModelSpec::Kinematic(kinematic(table, &whose, 2)?),
        "constant-acceleration" => ModelSpec::Kinematic(kinematic(table, &whose, 3)?),
        "gauss-markov" => ModelSpec::GaussMarkov(gauss_markov(table, &whose)?),
        "coordinated-turn" => ModelSpec::Turn(turn(table, &whose)?),
        "fms-paper" => ModelSpec::Linear(fms_paper(table, &whose)?),
        _ => ModelSpec::Linear(linear::linear(table, &whose, sources)?),
    })
}

pub(super) const DENSITY: &str = "a finite power spectral density, at least 0";

fn kinematic(table: &Table<'_>, whose: &str, order: usize) -> Result<KinematicSpec, BuildError> {
    table.only(whose, &["kind", "axes", "noise", "side", "x0", "P0", "S0"], &[])?;
    let axes = table.get("axes").map_or(Ok(2), |field| field.count(1, 3))?;
    let noise = noise(table, axes)?;
    Ok(KinematicSpec { order, axes, noise, prior: prior(table, order * axes)? })
}

fn turn(table: &Table<'_>, whose: &str) -> Result<TurnSpec, BuildError> {
    table.only(whose, &["kind", "noise", "turn_noise", "side", "x0", "P0", "S0"], &[])?;
    let noise = noise(table, 2)?;
    let (turn_noise, per_step) = turn_noise(&table.require("turn_noise", TURN_NOISE)?)?;
    Ok(TurnSpec { noise: [noise[0], noise[1]], turn_noise, per_step, prior: prior(table, 5)? })
}

/// A point on the side that targets are on.
pub(super) fn side(table: &Table<'_>, model: &ModelSpec) -> Result<Option<[f64; 3]>, BuildError> {
    let axes = match model {
        ModelSpec::Kinematic(m) => m.axes,
        ModelSpec::Turn(_) => 2,
        ModelSpec::GaussMarkov(_) | ModelSpec::Linear(_) => return Ok(None),
    };
    let Some(field) = table.get("side") else { return Ok(None) };
    if axes < 2 {
        return Err(field.misfit("no `side`, as there is one axis"));
    }
    let point = vector(&field, axes, "a point on the side of the anchors that targets are on, metres")?;
    Ok(Some(core::array::from_fn(|i| point.get(i).copied().unwrap_or(0.0))))
}

const TURN_NOISE: &str = "a finite power spectral density, at least 0, or a table with `per_step`";

/// A density, or a variance per step and the exponent of the step's length.
fn turn_noise(field: &Field<'_>) -> Result<(f64, Option<u8>), BuildError> {
    if !field.is_table() {
        return Ok((field.number(TURN_NOISE, |v| v >= 0.0)?, None));
    }
    let table = field.table(TURN_NOISE)?;
    table.only("the noise of a turn rate", &["per_step", "power"], &[])?;
    let expected = "a finite variance, at least 0";
    let variance = table.require("per_step", expected)?.number(expected, |v| v >= 0.0)?;
    let power = table.get("power").map_or(Ok(0), |field| field.count(0, 2))?;
    Ok((variance, Some(power as u8)))
}

fn gauss_markov(table: &Table<'_>, whose: &str) -> Result<GaussMarkovSpec, BuildError> {
    table.only(whose, &["kind", "axes", "centre_m", "spread_m", "speed_mps", "x0", "P0", "S0"], &[])?;
    let axes = table.get("axes").map_or(Ok(2), |field| field.count(1, 3))?;
    // Squares of them, and of their ratio, stay finite and above 0.
    let positive = |v: f64| (1e-9..=1e9).contains(&v);
    let sized = |key: &str, expected: &str, valid: fn(f64) -> bool| per_axis(table, key, axes, expected, valid);
    Ok(GaussMarkovSpec {
        axes,
        centre_m: sized("centre_m", "where the target lives, a finite number of metres", |_| true)?,
        spread_m: sized("spread_m", "a standard deviation of the position, 1e-9 to 1e9 m", positive)?,
        speed_mps: sized("speed_mps", "a standard deviation of the velocity, 1e-9 to 1e9 m/s", positive)?,
        prior: prior(table, 2 * axes)?,
    })
}

/// One density for each of `axes`.
fn noise(table: &Table<'_>, axes: usize) -> Result<Vec<f64>, BuildError> {
    per_axis(table, "noise", axes, DENSITY, |v| v >= 0.0)
}

/// A number for every axis, or one for all.
fn per_axis(
    table: &Table<'_>,
    key: &str,
    axes: usize,
    expected: &str,
    valid: fn(f64) -> bool,
) -> Result<Vec<f64>, BuildError> {
    of_axes(&table.require(key, expected)?, axes, expected, valid)
}

/// One density for each of `axes`.
pub(super) fn densities(field: &Field<'_>, axes: usize) -> Result<Vec<f64>, BuildError> {
    of_axes(field, axes, DENSITY, |v| v >= 0.0)
}

fn of_axes(field: &Field<'_>, axes: usize, expected: &str, valid: fn(f64) -> bool) -> Result<Vec<f64>, BuildError> {
    let Some(entries) = field.elements() else {
        return Ok(vec![field.number(expected, valid)?; axes]);
    };
    if entries.len() != axes {
        return Err(field.misfit(format!("one number or a list of {axes}, one for each axis")));
    }
    entries.iter().map(|entry| entry.number(expected, valid)).collect()
}

/// `x0`, `P0` and `S0` of a state of `n` components.
pub(super) fn prior(table: &Table<'_>, n: usize) -> Result<Option<Prior>, BuildError> {
    let (x0, p0) = match (table.get("x0"), table.get("P0")) {
        (None, None) => {
            return match table.get("S0") {
                None => Ok(None),
                Some(field) => Err(field.misfit("no `S0` without `x0` and `P0`")),
            };
        }
        (Some(x0), Some(p0)) => (x0, p0),
        (Some(_), None) => return Err(table.missing("P0", "the covariance of `x0` beside it")),
        (None, Some(_)) => return Err(table.missing("x0", "the mean that `P0` is the covariance of beside it")),
    };
    let mean = vector(&x0, n, "one for each state component")?;
    let of_state = |field: &Field<'_>| match covariance(field, n, Definite::Semi)? {
        m if m.rows == n => Ok(m),
        m => Err(field.error(format!("is {}, expected {n} × {n}, the size of the state", shape(&m)))),
    };
    let second_moment = table.get("S0").map(|field| of_state(&field)).transpose()?;
    Ok(Some(Prior { mean, cov: of_state(&p0)?, second_moment }))
}

/// The finite-memory smoother paper's model (16): position, velocity and acceleration sampled every `T` seconds.
fn fms_paper(table: &Table<'_>, whose: &str) -> Result<LinearSpec, BuildError> {
    table.only(whose, &["kind", "T", "Q", "R", "x0", "P0", "S0"], &[])?;
    let t = table.get("T").map_or(Ok(2.0), |field| field.number("a positive finite number of seconds", |v| v > 0.0))?;
    let sized = |key: &str, n: usize, definite: Definite, default: Vec<f64>| match table.get(key) {
        None => Ok(Mat { rows: n, cols: n, data: default }),
        Some(field) => match covariance(&field, n, definite)? {
            m if m.rows == n => Ok(m),
            m => Err(field.error(format!("is {}, expected {n} × {n}", shape(&m)))),
        },
    };
    let base = LinearStep {
        a: Mat { rows: 3, cols: 3, data: vec![1.0, t, t * t / 2.0, 0.0, 1.0, t, 0.0, 0.0, 1.0] },
        b: Mat { rows: 3, cols: 0, data: Vec::new() },
        g: Mat { rows: 3, cols: 2, data: vec![t / 2.0, 0.0, 1.0, 0.0, 0.0, 1.0] },
        c: Mat { rows: 1, cols: 3, data: vec![1.0, 0.0, 0.0] },
        q: sized("Q", 2, Definite::Semi, vec![0.173 * 0.173, 0.0, 0.0, 0.01 * 0.01])?,
        r: sized("R", 1, Definite::Strictly, vec![0.05 * 0.05])?,
    };
    if !base.a.data.iter().all(|v| v.is_finite()) {
        return Err(table.error("T", format!("is {t:?}, expected a number of seconds whose square is finite")));
    }
    Ok(LinearSpec { base, sequence: Vec::new(), prior: prior(table, 3)? })
}
