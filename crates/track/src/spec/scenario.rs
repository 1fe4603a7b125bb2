//! A scenario: what moves, what measures, what the channel does to it, and who estimates it.
//!
//! ```toml
//! [scenario]                      # or [recording]: a table of measurements in place of a simulated target
//! runs = 400
//! steps = 300
//!
//! [model]                         # as in a spec; x0 and P0 say where targets start
//!
//! [channel]
//! kind = "bernoulli"
//! loss_rate = [0.1, 0.3]          # a list: one table for each
//!
//! [[contender]]
//! name = "told of losses"
//! estimator = { kind = "kalman" }
//! ```

use super::link;
use super::matrix::{Definite, MAX_STATE, covariance};
use super::names::{CHANNELS, Named, choose};
use super::schedule::{ScheduleSpec, schedule};
use super::value::{Field, Node, Table};
use super::{LinkSpec, MotionSpec, Robust, SensorSpec, Spec, estimator, model, motion, sensor};
use crate::error::BuildError;
use crate::packet::Kind;
use std::collections::BTreeMap;
use std::path::Path;

/// Most runs, steps and sensors of a scenario.
const MOST: usize = 10_000_000;

/// A checked scenario.
#[derive(Clone, Debug, PartialEq)]
pub struct Scenario {
    /// `seed` of all chance.
    pub seed: u64,
    /// What is sent.
    pub world: World,
    /// What becomes of it.
    pub channel: ChannelSpec,
}

/// What is sent through the channel.
#[derive(Clone, Debug, PartialEq)]
pub enum World {
    /// `[scenario]`: measurements of simulated targets.
    Simulated(Box<Simulated>),
    /// `[recording]`: measurements of a table.
    Recorded(Recorded),
}

/// `[scenario]`, `[model]`, `[[sensor]]`, `[field]` and the contenders.
#[derive(Clone, Debug, PartialEq)]
pub struct Simulated {
    /// `runs`.
    pub runs: usize,
    /// `steps`: instants after the start; under a schedule the most that there can be.
    pub steps: usize,
    /// `interval_s` between two instants.
    pub interval_s: f64,
    /// `start`.
    pub start: Start,
    /// `noise = false`: targets move without the noise that the estimators reckon with.
    pub noisy: bool,
    /// How targets move and are measured; the prior is where they start.
    pub truth: Spec,
    /// How targets move where that is not as the model says.
    pub motion: Option<MotionSpec>,
    /// `lost_m`: a target is lost when its estimate ends further off than this.
    pub lost_m: f64,
    /// Where ranges are taken from.
    pub field: Option<FieldSpec>,
    /// Whether sensors are chosen as the target goes, and how where a contender does not say.
    pub schedule: Option<ScheduleSpec>,
    /// Who estimates.
    pub contenders: Vec<Contender>,
}

/// Where a target starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Start {
    /// `drawn`: from N(x0, P0).
    Drawn,
    /// `mean`: at x0.
    Mean,
}

/// `[field]`: sensors placed at random, anew in every run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FieldSpec {
    /// `size_m`: from 0 to here, on x and y.
    pub size_m: [f64; 2],
    /// `sensors`: how many.
    pub sensors: usize,
    /// `nearest`: how many of them, the nearest to the target, measure at an instant.
    pub nearest: usize,
}

/// One way to estimate.
#[derive(Clone, Debug, PartialEq)]
pub struct Contender {
    /// `name`; default: the estimator's.
    pub name: String,
    /// Its estimator and link, with the scenario's model and sensors. An `arrival` that is not given is the channel's own rate.
    pub spec: Spec,
    /// `shows`: what a receiver without time stamps shows to it.
    pub shows: Shows,
    /// `schedule`: how its sensors are chosen.
    pub schedule: Option<ScheduleSpec>,
    /// Whether its smoothed estimates count, which stand at earlier instants and know what came later: those of `rts` and
    /// `fixed-lag-kalman` always, those of `fms` with `smoothed = true`.
    pub smoothed: bool,
}

/// What a receiver without time stamps shows when nothing comes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shows {
    /// `paper`: the value before, after two losses the one before that, come what may.
    Paper,
    /// `last-received`: the last value that came.
    LastReceived,
    /// `model1`: the value before; 0 after two losses.
    Model1,
    /// `zero`: 0.
    Zero,
}

/// `[recording]`.
#[derive(Clone, Debug, PartialEq)]
pub struct Recorded {
    /// `measurements`, relative to the scenario's folder.
    pub measurements: String,
    /// `per`: what shares a packet.
    pub per: Per,
}

/// What of a recording travels in one packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Per {
    /// `instant`: all that was measured of a target at one instant.
    Instant,
    /// `row`: each row by itself; every source of a target has a channel of its own.
    Row,
}

/// `[channel]`.
#[derive(Clone, Debug, PartialEq)]
pub struct ChannelSpec {
    /// `kind` and what belongs to it.
    pub loss: LossSpec,
    /// `delays`: probability of arriving 0, 1, 2 … intervals late.
    pub delays: Vec<f64>,
    /// `delay_s = [least, most]`: uniform, seconds.
    pub delay_s: Option<[f64; 2]>,
    /// `duplication`: probability that a packet arrives a second time.
    pub duplication: f64,
    /// `duplication_lag_s`: how much later at most.
    pub duplication_lag_s: f64,
    /// `shows`: what receivers without time stamps show, where a contender does not say.
    pub shows: Shows,
}

/// How packets are lost.
#[derive(Clone, Debug, PartialEq)]
pub enum LossSpec {
    /// `bernoulli`.
    Bernoulli {
        /// `loss_rate`: one or more.
        loss_rates: Vec<f64>,
    },
    /// `gilbert-elliott`.
    GilbertElliott {
        /// `loss_rate`: one or more.
        loss_rates: Vec<f64>,
        /// `mean_burst`, packets.
        mean_burst: f64,
    },
    /// `trace`.
    Trace {
        /// `file`, relative to the scenario's folder.
        file: String,
        /// `link`: the trace's link; default: all, one after the other.
        link: Option<String>,
    },
}

const STARTS: &[Named] = &[("drawn", "from N(x0, P0)"), ("mean", "at x0")];
const PER: &[Named] = &[("instant", "all of a target and an instant"), ("row", "each row")];
const SHOWS: &[Named] = &[
    ("paper", "the value before, after two losses the one before that"),
    ("last-received", "the last value that came"),
    ("model1", "the value before, 0 after two losses"),
    ("zero", "0"),
];

/// The checked scenario in `text`, the content of `file`; `read` fetches the steps of a time-varying model.
///
/// # Errors
/// [`BuildError`] with file, line and dotted key for the first thing that is wrong.
pub fn parse_scenario(
    text: &str,
    file: &Path,
    read: &mut dyn FnMut(&Path) -> std::io::Result<Vec<u8>>,
) -> Result<Scenario, BuildError> {
    let node = Node::of_toml(text, file)?;
    let root = node.field(file, "").table("a scenario")?;
    root.only(
        "a scenario",
        &["version", "scenario", "recording", "model", "motion", "sensor", "field", "channel", "schedule", "contender"],
        &[],
    )?;
    if let Some(field) = root.get("version") {
        field.number("1, the only version there is", |v| v == 1.0)?;
    }
    let expected = "a table `[channel]` with a `kind`";
    let channel = channel(&root.require("channel", expected)?.table(expected)?)?;
    let (seed, world) = match (root.get("scenario"), root.get("recording")) {
        (Some(_), Some(field)) => return Err(field.misfit("either `[scenario]` or `[recording]`")),
        (None, Some(field)) => recorded(&root, &field)?,
        (Some(field), None) => simulated(&root, &field, &channel, read)?,
        (None, None) => return Err(root.missing("scenario", "a table `[scenario]`, or `[recording]` in its place")),
    };
    Ok(Scenario { seed, world, channel })
}

fn seed(table: &Table<'_>) -> Result<u64, BuildError> {
    table.get("seed").map_or(Ok(1), |field| Ok(field.count(0, MOST)? as u64))
}

fn recorded(root: &Table<'_>, field: &Field<'_>) -> Result<(u64, World), BuildError> {
    for key in ["model", "motion", "sensor", "field", "schedule", "contender"] {
        if let Some(field) = root.get(key) {
            return Err(
                field.misfit("nothing of the kind beside `[recording]`: `fixtrail track` estimates what is written")
            );
        }
    }
    let table = field.table("a table `[recording]`")?;
    table.only("a recording", &["measurements", "per", "seed"], &[])?;
    let expected = "the name of a table of measurements";
    let measurements = table.require("measurements", expected)?.text(expected)?.to_owned();
    let per = match table.get("per").map(|field| choose(&field, PER, &[])).transpose()? {
        Some("row") => Per::Row,
        _ => Per::Instant,
    };
    Ok((seed(&table)?, World::Recorded(Recorded { measurements, per })))
}

fn simulated(
    root: &Table<'_>,
    field: &Field<'_>,
    channel: &ChannelSpec,
    read: &mut dyn FnMut(&Path) -> std::io::Result<Vec<u8>>,
) -> Result<(u64, World), BuildError> {
    let table = field.table("a table `[scenario]`")?;
    table.only("a scenario", &["runs", "steps", "seed", "interval_s", "start", "noise", "lost_m"], &[])?;
    let count = |key: &str| table.get(key).map_or(Ok(1), |field| field.count(1, MOST));
    let runs = count("runs")?;
    // Under a schedule there are as many instants as it wants.
    let steps = match (table.get("steps"), root.get("schedule")) {
        (Some(field), Some(_)) => {
            return Err(field.misfit("no `steps` beside `[schedule]`, whose `duration_s` says when to stop"));
        }
        (None, Some(_)) => 1,
        _ => table.require("steps", "a number of instants")?.count(1, MOST)?,
    };
    let interval_s =
        table.get("interval_s").map_or(Ok(1.0), |f| f.number("a positive number of seconds", |v| v > 0.0))?;
    let start = match table.get("start").map(|field| choose(&field, STARTS, &[])).transpose()? {
        Some("mean") => Start::Mean,
        _ => Start::Drawn,
    };
    let noisy = table.get("noise").map_or(Ok(true), |field| field.flag())?;
    let lost_m = table.get("lost_m").map_or(Ok(10.0), |f| f.number("a positive distance in metres", |v| v > 0.0))?;

    let expected = "a table `[model]` with a `kind`";
    let model_table = root.require("model", expected)?.table(expected)?;
    let model = model::model(&model_table, read)?;
    let side_m = model::side(&model_table, &model)?;
    if model.prior().is_none() {
        return Err(model_table.missing("x0", "the mean of where targets start, and `P0` beside it"));
    }
    let motion = root.get("motion").map_or(Ok(None), |field| motion::motion(&field, &model))?;
    if let (Some(_), false, Some(field)) = (&motion, noisy, table.get("noise")) {
        return Err(field.misfit("no `noise` beside a `[motion]`, which has its own"));
    }
    let sensors = sensor::sensors(root, &model)?;
    if let Some(other) = sensors.iter().find(|s| !matches!(s.kind, Kind::Position | Kind::Range | Kind::Linear)) {
        let what = format!(
            "has a sensor of kind {:?}, expected \"position\" or \"range\" in a simulated scenario",
            other.kind.name()
        );
        return Err(root.error("sensor", what));
    }
    let field = root.get("field").map(|f| field_of(&f, &sensors)).transpose()?;
    let plane = match &model {
        super::ModelSpec::Kinematic(m) => m.axes == 2,
        super::ModelSpec::GaussMarkov(m) => m.axes == 2,
        super::ModelSpec::Turn(_) => true,
        super::ModelSpec::Linear(_) => false,
    };
    if field.is_none() && sensors.iter().any(|s| s.kind == Kind::Range) {
        return Err(root.missing("field", "a table `[field]` with the sensors that ranges are taken from"));
    }
    let scheduled = root.get("schedule").map(|at| match &field {
        _ if motion.is_some() => {
            Err(at.misfit("no `[schedule]` beside a `[motion]`: scheduled targets move as the model says"))
        }
        Some(f) if plane => schedule(&at, f.sensors, None),
        _ => Err(at.misfit("no `[schedule]` without a `[field]` of range sensors and a model in the plane")),
    });
    let scheduled = scheduled.transpose()?;
    let truth = Spec {
        estimator: estimator::default(&model, &sensors),
        link: LinkSpec::default(),
        model,
        sensors,
        columns: BTreeMap::new(),
        anchors: None,
        side_m,
    };
    let contenders = match root.get("contender") {
        None => Vec::new(),
        Some(tables) => {
            let expected = "tables `[[contender]]`";
            tables
                .list(expected)?
                .iter()
                .map(|f| contender(&f.table(expected)?, &truth, channel, scheduled.as_ref().zip(field.as_ref())))
                .collect::<Result<_, _>>()?
        }
    };
    let most_steps = |s: &ScheduleSpec| (s.duration_s / s.intervals_s[0]).ceil() as usize;
    let of_contenders = contenders.iter().filter_map(|c| c.schedule.as_ref());
    let steps = scheduled.iter().chain(of_contenders).map(most_steps).max().unwrap_or(steps);
    if steps > MOST {
        return Err(root.error("schedule.duration_s", format!("makes up to {steps} instants, expected at most {MOST}")));
    }
    let world = Simulated {
        runs,
        steps,
        interval_s,
        start,
        noisy,
        truth,
        motion,
        lost_m,
        field,
        schedule: scheduled,
        contenders,
    };
    Ok((seed(&table)?, World::Simulated(Box::new(world))))
}

fn field_of(field: &Field<'_>, sensors: &[SensorSpec]) -> Result<FieldSpec, BuildError> {
    if !sensors.iter().any(|s| s.kind == Kind::Range) {
        return Err(field.misfit("no `[field]` without a sensor of kind \"range\""));
    }
    let table = field.table("a table `[field]`")?;
    table.only("a field", &["size_m", "sensors", "nearest"], &[])?;
    let expected = "two positive lengths in metres, such as [100, 100]";
    let size = table.require("size_m", expected)?;
    let sides = size.list(expected)?;
    let [x, y] = sides.as_slice() else { return Err(size.misfit(expected)) };
    let length = |f: &Field<'_>| f.number("a positive length in metres", |v| v > 0.0);
    let count = table.require("sensors", "how many sensors there are")?.count(1, 10_000)?;
    let nearest = table.get("nearest").map_or(Ok(count), |f| f.count(1, count))?;
    Ok(FieldSpec { size_m: [length(x)?, length(y)?], sensors: count, nearest })
}

fn contender(
    table: &Table<'_>,
    truth: &Spec,
    channel: &ChannelSpec,
    scheduled: Option<(&ScheduleSpec, &FieldSpec)>,
) -> Result<Contender, BuildError> {
    table.only("a contender", &["name", "estimator", "link", "shows", "smoothed", "gate", "S0", "schedule"], &[])?;
    let estimator = match table.get("estimator") {
        None => truth.estimator,
        Some(field) => estimator::estimator(&field.table("a table with a `kind`")?, &truth.model, &truth.sensors)?,
    };
    let link = table.get("link").map_or(Ok(LinkSpec::default()), |field| link::link(&field))?;
    link::suits(table, &link, &estimator, &truth.model)?;
    let mut spec = Spec { estimator, link, ..truth.clone() };
    if let Some(field) = table.get("gate") {
        let gate = field.number("a positive squared innovation over its variance", |v| v > 0.0)?;
        if spec.sensors.is_empty() {
            return Err(field.misfit("no `gate` with a linear model, whose measurements have none"));
        }
        spec.sensors.iter_mut().for_each(|s| s.robust = Robust::Gate(gate));
    }
    if let Some(field) = table.get("S0") {
        let moment = covariance(&field, MAX_STATE, Definite::Semi)?;
        let prior = spec.model.prior_mut().filter(|p| p.mean.len() == moment.rows);
        prior.ok_or_else(|| field.misfit("a matrix of the size of the state"))?.second_moment = Some(moment);
    }
    let name = match table.get("name") {
        None => estimator.name().to_owned(),
        Some(field) => field.text("a name")?.to_owned(),
    };
    let shows = table.get("shows").map(|field| shows(&field)).transpose()?.unwrap_or(channel.shows);
    let schedule = match (table.get("schedule"), scheduled) {
        (Some(field), Some((base, sensors))) => Some(schedule(&field, sensors.sensors, Some(base))?),
        (Some(field), None) => return Err(field.misfit("no `schedule` without a `[schedule]` of the scenario")),
        (None, base) => base.map(|(base, _)| base.clone()),
    };
    let smoothed = match table.get("smoothed") {
        None => estimator.is_smoother(),
        Some(field) => match (field.flag()?, estimator.has_smoother(), estimator.is_smoother()) {
            (true, false, _) => {
                let what = format!("no `smoothed = true` of `{}`, which has no smoother", estimator.name());
                return Err(field.misfit(what));
            }
            (false, _, true) => {
                let what = format!("no `smoothed = false` of `{}`: its filter is `kalman` or `ekf`", estimator.name());
                return Err(field.misfit(what));
            }
            (smoothed, ..) => smoothed,
        },
    };
    Ok(Contender { name, spec, shows, schedule, smoothed })
}

fn shows(field: &Field<'_>) -> Result<Shows, BuildError> {
    Ok(match choose(field, SHOWS, &[])? {
        "last-received" => Shows::LastReceived,
        "model1" => Shows::Model1,
        "zero" => Shows::Zero,
        _ => Shows::Paper,
    })
}

fn channel(table: &Table<'_>) -> Result<ChannelSpec, BuildError> {
    const COMMON: [&str; 6] = ["kind", "delays", "delay_s", "duplication", "duplication_lag_s", "shows"];
    let expected = "`bernoulli`, `gilbert-elliott` or `trace`";
    let field = table.require("kind", expected)?;
    let kind = choose(&field, CHANNELS, &[])?;
    let own: &[&str] = match kind {
        "bernoulli" => &["loss_rate"],
        "gilbert-elliott" => &["loss_rate", "mean_burst"],
        "trace" => &["file", "link"],
        _ => {
            let what = format!("is {kind:?}, expected {expected}, with `delays`, `delay_s` or `duplication` beside it");
            return Err(field.error(what));
        }
    };
    let keys: Vec<&str> = COMMON.iter().chain(own).copied().collect();
    table.only(&format!("a channel of kind `{kind}`"), &keys, &[])?;
    let text = |key: &str, expected: &str| table.get(key).map(|f| f.text(expected).map(str::to_owned)).transpose();
    let loss = match kind {
        "bernoulli" => LossSpec::Bernoulli { loss_rates: loss_rates(table)? },
        "gilbert-elliott" => {
            let expected = "a number of packets, at least 1";
            let mean_burst = table.require("mean_burst", expected)?.number(expected, |v| v >= 1.0)?;
            LossSpec::GilbertElliott { loss_rates: loss_rates(table)?, mean_burst }
        }
        _ => {
            let expected = "the name of a packet trace";
            let file = text("file", expected)?.ok_or_else(|| table.missing("file", expected))?;
            LossSpec::Trace { file, link: text("link", "the name of a link of the trace")? }
        }
    };
    let probability = |f: &Field<'_>| f.number("a probability, a number from 0 to 1", |v| (0.0..=1.0).contains(&v));
    let seconds = |f: &Field<'_>| f.number("a number of seconds, at least 0", |v| v >= 0.0);
    let delays = match table.get("delays") {
        None => Vec::new(),
        Some(f) => f.list("a list of probabilities")?.iter().map(probability).collect::<Result<Vec<f64>, _>>()?,
    };
    let delay_s = match table.get("delay_s") {
        None => None,
        Some(f) => {
            let expected = "two numbers of seconds, the least and the largest delay";
            let bounds = f.list(expected)?.iter().map(seconds).collect::<Result<Vec<f64>, _>>()?;
            match bounds.as_slice() {
                [least, most] if least <= most => Some([*least, *most]),
                _ => return Err(f.misfit(expected)),
            }
        }
    };
    if let (false, Some(field)) = (delays.is_empty(), table.get("delay_s")) {
        return Err(field.misfit("only one of `delays` and `delay_s`"));
    }
    Ok(ChannelSpec {
        loss,
        delays,
        delay_s,
        duplication: table.get("duplication").map_or(Ok(0.0), |f| probability(&f))?,
        duplication_lag_s: table.get("duplication_lag_s").map_or(Ok(0.0), |f| seconds(&f))?,
        shows: table.get("shows").map_or(Ok(Shows::Paper), |f| shows(&f))?,
    })
}

fn loss_rates(table: &Table<'_>) -> Result<Vec<f64>, BuildError> {
    let expected = "a number from 0 up to, but not including, 1, or a list of them";
    let field = table.require("loss_rate", expected)?;
    let rate = |f: &Field<'_>| f.number(expected, |v| (0.0..1.0).contains(&v));
    match field.elements() {
        None => Ok(vec![rate(&field)?]),
        Some(_) => field.list(expected)?.iter().map(rate).collect(),
    }
}
