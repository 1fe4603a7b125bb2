//! `[schedule]` of a scenario: which sensor measures next, and when.

use super::names::{ACCURACIES, SCHEDULERS, choose};
use super::value::Field;
use crate::closed_loop::Accuracy;
use crate::error::BuildError;
use fixtrail_core::schedule::{Choice, MOST_AWAKE, MOST_INTERVALS, Policy, Radio};

/// A checked `[schedule]`.
#[derive(Clone, Debug, PartialEq)]
pub struct ScheduleSpec {
    /// `kind`, `enough` and `weight`.
    pub choice: Choice,
    /// `intervals_s`, ascending; one of all kinds but `idgss`.
    pub intervals_s: Vec<f64>,
    /// `group`: sensors awake around the target.
    pub group: usize,
    /// `range_m`: how far a sensor sees; infinite where it is not given.
    pub range_m: f64,
    /// `accuracy`: what of the covariance counts.
    pub accuracy: Accuracy,
    /// `duration_s`.
    pub duration_s: f64,
    /// `residual_mj`: energy at the start, of all sensors or of each; empty where nobody counts.
    pub residual_mj: Vec<f64>,
    /// `[schedule.radio]`.
    pub radio: Radio,
    /// `failures`: the instant before whose decision a sensor dies, from 1, and the sensor, from 0.
    pub failures: Vec<(u64, usize)>,
}

impl ScheduleSpec {
    /// What the scheduler goes by.
    pub fn policy(&self) -> Policy<'_> {
        Policy { choice: self.choice, intervals_s: &self.intervals_s, group: self.group, range_m: self.range_m }
    }

    /// Energy that a sensor starts with, mJ.
    pub fn residual_of(&self, sensor: usize) -> f64 {
        self.residual_mj.get(sensor).or(self.residual_mj.first()).copied().unwrap_or(f64::INFINITY)
    }
}

const KEYS: [&str; 12] = [
    "kind",
    "interval_s",
    "intervals_s",
    "group",
    "range_m",
    "accuracy",
    "enough",
    "weight",
    "duration_s",
    "residual_mj",
    "radio",
    "failures",
];

/// The schedule in `field`, for a field of `sensors`; what it does not say is as in `base`.
pub(super) fn schedule(
    field: &Field<'_>,
    sensors: usize,
    base: Option<&ScheduleSpec>,
) -> Result<ScheduleSpec, BuildError> {
    let table = field.table("a table with the `kind` of a schedule")?;
    let positive = |f: &Field<'_>, what: &str| f.number(what, |v| v > 0.0);
    let kind = match (table.get("kind"), base) {
        (Some(field), _) => Some(choose(&field, SCHEDULERS, &[])?),
        (None, Some(_)) => None,
        (None, None) => {
            return Err(table
                .missing("kind", "the name of a scheduler: `idgss`, `nearest`, `minimum-trace` or `fixed-interval`"));
        }
    };
    let many = kind.map_or_else(|| base.is_some_and(|b| b.intervals_s.len() > 1), |kind| kind == "idgss");
    let costs = match (kind, base) {
        (Some(kind), _) => matches!(kind, "idgss" | "fixed-interval"),
        (None, base) => base.is_some_and(|b| matches!(b.choice, Choice::Cost { .. })),
    };
    let unwanted: &[&str] = match (many, costs) {
        (true, _) => &["interval_s"],
        (false, true) => &["intervals_s"],
        (false, false) => &["intervals_s", "enough", "weight"],
    };
    let keys: Vec<&str> = KEYS.into_iter().filter(|key| !unwanted.contains(key)).collect();
    table.only("a schedule of this kind", &keys, &[])?;

    let (enough, weight) = match base.map(|b| b.choice) {
        Some(Choice::Cost { enough, weight }) => (Some(enough), weight),
        _ => (None, 0.7),
    };
    let choice = match kind {
        Some("nearest") => Choice::Nearest,
        Some("minimum-trace") => Choice::Accuracy,
        _ if !costs => base.map_or(Choice::Nearest, |b| b.choice),
        _ => {
            let expected = "an accuracy that is enough, a positive number of m²";
            let enough = match (table.get("enough"), enough) {
                (Some(field), _) => positive(&field, expected)?,
                (None, Some(enough)) => enough,
                (None, None) => return Err(table.missing("enough", expected)),
            };
            let share = "a number from 0 to 1";
            let weight = table.get("weight").map_or(Ok(weight), |f| f.number(share, |v| (0.0..=1.0).contains(&v)))?;
            Choice::Cost { enough, weight }
        }
    };
    let seconds = "a positive number of seconds";
    let intervals_s = if many {
        let expected = format!("1 to {MOST_INTERVALS} ascending positive numbers of seconds");
        match (table.get("intervals_s"), base) {
            (Some(field), _) => {
                let list = field.list(&expected)?;
                let each = list.iter().map(|f| positive(f, seconds)).collect::<Result<Vec<f64>, _>>()?;
                if each.len() > MOST_INTERVALS || !each.windows(2).all(|pair| pair[0] < pair[1]) {
                    return Err(field.misfit(expected));
                }
                each
            }
            (None, Some(base)) => base.intervals_s.clone(),
            (None, None) => return Err(table.missing("intervals_s", expected)),
        }
    } else {
        match (table.get("interval_s"), base) {
            (Some(field), _) => vec![positive(&field, seconds)?],
            (None, Some(base)) => base.intervals_s[..1].to_vec(),
            (None, None) => return Err(table.missing("interval_s", seconds)),
        }
    };
    let most = sensors.min(MOST_AWAKE);
    let group = match (table.get("group"), base) {
        (Some(field), _) => field.count(1, most)?,
        (None, Some(base)) => base.group,
        // The nearest is one; the most accurate is sought among all.
        (None, None) if choice == Choice::Nearest => 1,
        (None, None) => most.min(5),
    };
    let accuracy = match (table.get("accuracy").map(|f| choose(&f, ACCURACIES, &[])).transpose()?, base) {
        (Some("sum"), _) => Accuracy::Sum,
        (None, Some(base)) => base.accuracy,
        _ => Accuracy::Trace,
    };
    let number = |key: &str, expected: &str, default: Option<f64>| match (table.get(key), default) {
        (Some(field), _) => positive(&field, expected),
        (None, Some(default)) => Ok(default),
        (None, None) => Err(table.missing(key, expected)),
    };
    let or_all = |of: fn(&ScheduleSpec) -> f64| Some(base.map_or(f64::INFINITY, of));
    Ok(ScheduleSpec {
        choice,
        intervals_s,
        group,
        range_m: number("range_m", "a positive number of metres", or_all(|b| b.range_m))?,
        accuracy,
        duration_s: number("duration_s", seconds, base.map(|b| b.duration_s))?,
        residual_mj: match table.get("residual_mj") {
            Some(field) => residuals(&field, sensors)?,
            None => base.map_or_else(Vec::new, |b| b.residual_mj.clone()),
        },
        radio: match table.get("radio") {
            Some(field) => radio(&field, base.map_or_else(Radio::default, |b| b.radio))?,
            None => base.map_or_else(Radio::default, |b| b.radio),
        },
        failures: match table.get("failures") {
            Some(field) => failures(&field, sensors)?,
            None => base.map_or_else(Vec::new, |b| b.failures.clone()),
        },
    })
}

fn radio(field: &Field<'_>, base: Radio) -> Result<Radio, BuildError> {
    let table = field.table("a table of what the radio's energy is made of")?;
    let mut radio = base;
    let mut parts = [
        ("sense_mj_per_bit", &mut radio.sense_mj_per_bit),
        ("receive_mj_per_bit", &mut radio.receive_mj_per_bit),
        ("send_mj_per_bit", &mut radio.send_mj_per_bit),
        ("amplify_mj_per_bit", &mut radio.amplify_mj_per_bit),
        ("path_exponent", &mut radio.path_exponent),
        ("sensed_bits", &mut radio.sensed_bits),
        ("sent_bits", &mut radio.sent_bits),
    ];
    let keys: Vec<&str> = parts.iter().map(|(key, _)| *key).chain(["free_self"]).collect();
    table.only("the radio of a schedule", &keys, &[])?;
    for (key, part) in &mut parts {
        if let Some(field) = table.get(key) {
            **part = field.number("a finite number, at least 0", |v| v >= 0.0)?;
        }
    }
    if let Some(field) = table.get("free_self") {
        radio.free_self = field.flag()?;
    }
    Ok(radio)
}

fn residuals(field: &Field<'_>, sensors: usize) -> Result<Vec<f64>, BuildError> {
    let expected = format!("a positive energy in mJ, or a list of {sensors}, one for each sensor");
    let positive = |f: &Field<'_>| f.number("a positive energy in mJ", |v| v > 0.0);
    match field.elements() {
        None => Ok(vec![field.number(&expected, |v| v > 0.0)?]),
        Some(each) if each.len() == sensors => each.iter().map(positive).collect(),
        Some(_) => Err(field.misfit(expected)),
    }
}

fn failures(field: &Field<'_>, sensors: usize) -> Result<Vec<(u64, usize)>, BuildError> {
    let expected = "a list of pairs: the instant before which a sensor fails, from 1, and the sensor, from 0";
    let pairs = field.elements().ok_or_else(|| field.misfit(expected))?;
    pairs
        .iter()
        .map(|pair| match pair.list(expected)?.as_slice() {
            [k, sensor] => Ok((k.count(1, 1_000_000)? as u64, sensor.count(0, sensors.saturating_sub(1))?)),
            _ => Err(pair.misfit(expected)),
        })
        .collect()
}
