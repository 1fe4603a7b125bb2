//! `[motion]` of a scenario: how targets really move, where that is not as the model says.

use super::ModelSpec;
use super::names::{MOTIONS, Named, choose};
use super::value::{Field, Table};
use crate::error::BuildError;

/// How targets really move.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MotionSpec {
    /// `circle`.
    Circle {
        /// `centre_m`.
        centre_m: [f64; 2],
        /// `radius_m`.
        radius_m: f64,
        /// `speed_mps` along the circle, counter-clockwise; negative the other way.
        speed_mps: f64,
        /// `start_rad`: where it starts, counter-clockwise from x.
        start_rad: f64,
    },
    /// `constant-speed`: a constant velocity, and a noise that moves the position alone.
    ConstantSpeed {
        /// `velocity_mps` per axis; that of the start when absent.
        velocity_mps: Option<[f64; 3]>,
        /// `position_sd_m` of the noise per axis and instant.
        position_sd_m: f64,
    },
    /// `acceleration`: a constant velocity, and an acceleration of each interval that is forgotten at its end.
    Acceleration {
        /// `velocity_mps` per axis; that of the start when absent.
        velocity_mps: Option<[f64; 3]>,
        /// `acceleration_sd_mps2` per axis.
        acceleration_sd_mps2: f64,
    },
    /// `bouncing`: straight on until the wall of a rectangle.
    Bouncing {
        /// `area_m`: from 0 to here, on x and y.
        area_m: [f64; 2],
        /// `speed_mps`.
        speed_mps: f64,
        /// `walls`: what happens there.
        walls: Walls,
    },
    /// `profile`: an acceleration that is a function of time.
    Profile {
        /// `velocity_mps` per axis at the start; that of the start when absent.
        velocity_mps: Option<[f64; 3]>,
        /// `shape`.
        shape: Shape,
        /// `acceleration_mps2` per axis at its largest.
        acceleration_mps2: [f64; 3],
        /// `from_s` and `until_s`: when it is not 0.
        span_s: [f64; 2],
    },
}

/// What a bouncing target does at a wall.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Walls {
    /// `random`: goes on in any direction that leads inside.
    Random,
    /// `mirror`: as a ball on a table.
    Mirror,
}

/// An acceleration over time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// `step`: all of it from the start to the end.
    Step,
    /// `ramp`: rises from 0, ends at once.
    Ramp,
    /// `triangle`: rises to the middle and falls to the end.
    Triangle,
}

const WALLS: &[Named] = &[("random", "goes on in any direction that leads inside"), ("mirror", "as a ball on a table")];
const SHAPES: &[Named] =
    &[("step", "all of it from start to end"), ("ramp", "rises, ends at once"), ("triangle", "rises and falls")];

impl MotionSpec {
    /// The name that scenarios use.
    pub fn name(&self) -> &'static str {
        match self {
            MotionSpec::Circle { .. } => "circle",
            MotionSpec::ConstantSpeed { .. } => "constant-speed",
            MotionSpec::Acceleration { .. } => "acceleration",
            MotionSpec::Bouncing { .. } => "bouncing",
            MotionSpec::Profile { .. } => "profile",
        }
    }
}

/// The motion in `field`; `None` when targets move as the model says.
///
/// # Errors
/// [`BuildError`] for the first thing that is wrong.
pub(super) fn motion(field: &Field<'_>, model: &ModelSpec) -> Result<Option<MotionSpec>, BuildError> {
    let expected = "a table `[motion]` with a `kind`";
    let table = field.table(expected)?;
    let named = table.require("kind", expected)?;
    let kind = choose(&named, MOTIONS, &[])?;
    let own: &[&str] = match kind {
        "circle" => &["kind", "centre_m", "radius_m", "speed_mps", "start_rad"],
        "constant-speed" => &["kind", "velocity_mps", "position_sd_m"],
        "acceleration" => &["kind", "velocity_mps", "acceleration_sd_mps2"],
        "bouncing" => &["kind", "area_m", "speed_mps", "walls"],
        "profile" => &["kind", "velocity_mps", "shape", "acceleration_mps2", "from_s", "until_s"],
        _ => &["kind"],
    };
    table.only(&format!("a motion of kind `{kind}`"), own, &[])?;
    if kind == "model" {
        return Ok(None);
    }
    let (axes, has_velocity) = match model {
        ModelSpec::Kinematic(m) => (m.axes, m.order >= 2),
        ModelSpec::GaussMarkov(m) => (m.axes, true),
        ModelSpec::Turn(_) => (2, true),
        ModelSpec::Linear(_) => {
            return Err(named.error(format!(
                "is {kind:?}, expected \"model\": the states of a linear model have no known meaning"
            )));
        }
    };
    if axes < 2 && matches!(kind, "circle" | "bouncing") {
        return Err(named.error(format!("is {kind:?}, which needs a plane, but the model has one axis")));
    }
    let velocity = || {
        let expected = format!("{axes} numbers of metres per second, one per axis");
        match table.get("velocity_mps") {
            Some(field) => per_axis(&field, axes, &expected).map(Some),
            None if has_velocity => Ok(None),
            None => Err(table.missing("velocity_mps", format!("{expected}: the model has no velocity"))),
        }
    };
    let sd = |key: &str, unit: &str| {
        let expected = format!("a standard deviation in {unit}, at least 0");
        table.require(key, &expected)?.number(&expected, |v| v >= 0.0)
    };
    let speed = |expected: &str, fits: fn(f64) -> bool| table.require("speed_mps", expected)?.number(expected, fits);
    Ok(Some(match kind {
        "circle" => {
            let radius = "a positive radius in metres";
            MotionSpec::Circle {
                centre_m: plane(&table, "centre_m", "two coordinates in metres, such as [50, 50]", |_| true)?,
                radius_m: table.require("radius_m", radius)?.number(radius, |v| v > 0.0)?,
                speed_mps: speed("a speed in metres per second, negative for clockwise", |_| true)?,
                start_rad: table.get("start_rad").map_or(Ok(0.0), |f| f.number("an angle in radians", |_| true))?,
            }
        }
        "constant-speed" => {
            MotionSpec::ConstantSpeed { velocity_mps: velocity()?, position_sd_m: sd("position_sd_m", "metres")? }
        }
        "acceleration" => MotionSpec::Acceleration {
            velocity_mps: velocity()?,
            acceleration_sd_mps2: sd("acceleration_sd_mps2", "metres per second squared")?,
        },
        "bouncing" => MotionSpec::Bouncing {
            area_m: room(&table, model)?,
            speed_mps: speed("a speed in metres per second, at least 0", |v| v >= 0.0)?,
            walls: match table.get("walls").map(|field| choose(&field, WALLS, &[])).transpose()? {
                Some("mirror") => Walls::Mirror,
                _ => Walls::Random,
            },
        },
        _ => profile(&table, axes, velocity()?)?,
    }))
}

/// `area_m`, which holds the mean of where targets start.
fn room(table: &Table<'_>, model: &ModelSpec) -> Result<[f64; 2], BuildError> {
    let area = plane(table, "area_m", "two positive lengths in metres, such as [50, 50]", |v| v > 0.0)?;
    let outside = |mean: &[f64]| mean.iter().zip(area).any(|(x, side)| !(0.0..=side).contains(x));
    match model.prior() {
        Some(prior) if outside(&prior.mean) => {
            let (x, y) = (prior.mean[0], prior.mean[1]);
            let what =
                format!("goes from [0, 0] to {area:?}, expected a rectangle with the start, [{x:?}, {y:?}], inside");
            Err(table.error("area_m", what))
        }
        _ => Ok(area),
    }
}

fn profile(table: &Table<'_>, axes: usize, velocity_mps: Option<[f64; 3]>) -> Result<MotionSpec, BuildError> {
    let expected = format!("one of {}", super::names::list(SHAPES.iter().map(|(name, _)| *name)));
    let shape = match choose(&table.require("shape", &expected)?, SHAPES, &[])? {
        "ramp" => Shape::Ramp,
        "triangle" => Shape::Triangle,
        _ => Shape::Step,
    };
    let expected = format!("{axes} numbers of metres per second squared, one per axis");
    let acceleration_mps2 = per_axis(&table.require("acceleration_mps2", &expected)?, axes, &expected)?;
    let from = table.get("from_s").map_or(Ok(0.0), |f| f.number("a number of seconds, at least 0", |v| v >= 0.0))?;
    let expected = format!("a number of seconds after `from_s`, {from}");
    let until = table.require("until_s", &expected)?.number(&expected, |v| v > from)?;
    Ok(MotionSpec::Profile { velocity_mps, shape, acceleration_mps2, span_s: [from, until] })
}

fn per_axis(field: &Field<'_>, axes: usize, expected: &str) -> Result<[f64; 3], BuildError> {
    let elements = match field.elements() {
        Some(elements) => elements,
        None => vec![field.clone()],
    };
    if elements.len() != axes {
        return Err(field.misfit(expected));
    }
    let mut out = [0.0; 3];
    for (o, element) in out.iter_mut().zip(&elements) {
        *o = element.number(expected, |_| true)?;
    }
    Ok(out)
}

fn plane(table: &Table<'_>, key: &str, expected: &str, fits: fn(f64) -> bool) -> Result<[f64; 2], BuildError> {
    let field = table.require(key, expected)?;
    let sides = field.list(expected)?;
    let [x, y] = sides.as_slice() else { return Err(field.misfit(expected)) };
    Ok([x.number(expected, fits)?, y.number(expected, fits)?])
}
