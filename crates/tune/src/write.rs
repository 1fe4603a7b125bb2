//! The tuned spec as text: the given one with other numbers, each with where it came from.

use crate::calibrate::{Calibration, Estimated};
use crate::knobs::Place;
use crate::tune::Tuned;
use core::fmt::Write as _;
use fixtrail_track::link::Learnt;
use fixtrail_track::spec::{EstimatorSpec, ModelSpec, Robust, SensorSpec, Span, TurnSpec};
use toml_edit::{Array, DocumentMut, InlineTable, Item, Value};

/// The text of `tuned`, made of the spec `text` that was given; `from` says in a few words what it was tuned on.
///
/// # Errors
/// A sentence when `text` is not TOML; a spec that was parsed is.
pub fn write(text: &str, tuned: &Tuned, from: &str) -> Result<String, String> {
    let mut doc: DocumentMut = text.parse().map_err(|e| format!("is no TOML: {e}"))?;
    for key in ["model", "estimator", "link", "sensor"] {
        if let Some(item) = doc.get_mut(key) {
            spread(item);
        }
    }
    if let Some(model) = doc.get_mut("model").and_then(Item::as_table_like_mut) {
        match &tuned.spec.model {
            ModelSpec::Kinematic(m) => set(model, "noise", numbers(&m.noise), &note(tuned, Place::Noise)),
            ModelSpec::Turn(m) => {
                set(model, "noise", numbers(&m.noise), &note(tuned, Place::Noise));
                set(model, "turn_noise", turn_noise(m), &note(tuned, Place::TurnNoise));
            }
            ModelSpec::GaussMarkov(m) => {
                model.remove("noise");
                if m.prior.is_none() {
                    for key in ["x0", "P0", "S0"] {
                        model.remove(key);
                    }
                }
                set(model, "kind", "gauss-markov".into(), "stationary: the target lives about the centre");
                set(model, "centre_m", list(&m.centre_m), "the middle of anchors and known positions");
                set(model, "spread_m", numbers(&m.spread_m), "as wide as a uniform distribution over them");
                set(model, "speed_mps", numbers(&m.speed_mps), &note(tuned, Place::Speed));
            }
            ModelSpec::Linear(_) => {}
        }
    }
    if let (Some(prior), Some(_)) = (tuned.spec.model.prior(), tuned.honesty)
        && let Some(model) = doc.get_mut("model").and_then(Item::as_table_like_mut)
    {
        let n = prior.cov.cols;
        let rows = prior.cov.data.chunks(n).map(list).collect::<Array>();
        set(
            model,
            "P0",
            Value::Array(rows),
            "as before, times the square of what all standard deviations are scaled by",
        );
    }
    write_modes(&mut doc, tuned);
    for (i, sensor) in tuned.spec.sensors.iter().enumerate() {
        if let Some(table) = sensor_table(&mut doc, i) {
            write_sensor(table, tuned, i, sensor);
        }
    }
    if !tuned.windows.windows.is_empty() {
        write_window(&mut doc, tuned);
    }
    if let Some(arrival) = &tuned.arrival {
        write_arrival(&mut doc, arrival);
    }
    Ok(format!("{}{doc}", header(tuned, from)))
}

fn header(tuned: &Tuned, from: &str) -> String {
    let mut out = format!("# Tuned on {from} ({} runs).\n", tuned.runs);
    let what = if tuned.with_truth {
        "half the mean log density of the true positions, half of it −2 ln RMSE"
    } else {
        "mean log density of the next measurements"
    };
    let _ = writeln!(
        out,
        "# Score, {what}: {:.3} before, {:.3} now; losses below are in its unit.",
        tuned.before.score, tuned.after.score
    );
    if let (Some(before), Some(after)) = (tuned.before.rmse_m, tuned.after.rmse_m) {
        let _ = writeln!(
            out,
            "# Root mean square error: {} m before, {} m now, on the data it was tuned on.",
            short(before),
            short(after)
        );
    }

    if let Some((scale, honesty)) = tuned.honesty {
        let _ = writeln!(
            out,
            "# All standard deviations times {} at the end: {:.1} % of the known positions were inside the 95 % ellipse with the sensors\n\
             # calibrated on the others, in errors of which {:.0} are independent; where it held least it asked for {} times.",
            short(scale),
            100.0 * honesty.coverage,
            honesty.independent,
            short(honesty.worst.max(honesty.scale))
        );
    }
    for tried in &tuned.structures {
        let verdict = if tried.taken { "taken" } else { "not taken" };
        let _ = writeln!(out, "# {}: {}, {verdict}.", tried.change.name(), tried.gain_text());
    }
    out
}

/// Gives a table on one line lines of its own, which comments need.
fn spread(item: &mut Item) {
    let taken = std::mem::take(item);
    *item = match taken {
        Item::Value(Value::InlineTable(table)) => Item::Table(table.into_table()),
        Item::Value(value) => match Item::Value(value).into_array_of_tables() {
            Ok(tables) => Item::ArrayOfTables(tables),
            Err(item) => item,
        },
        item => item,
    };
}

/// The table of the sensor at `index`.
fn sensor_table(doc: &mut DocumentMut, index: usize) -> Option<&mut dyn toml_edit::TableLike> {
    match doc.get_mut("sensor")? {
        Item::ArrayOfTables(tables) => tables.get_mut(index).map(|t| t as &mut dyn toml_edit::TableLike),
        item if index == 0 => item.as_table_like_mut(),
        _ => None,
    }
}

fn write_sensor(table: &mut dyn toml_edit::TableLike, tuned: &Tuned, i: usize, sensor: &SensorSpec) {
    let calibration = tuned.calibrations.get(i).and_then(Option::as_ref);
    set(table, "sd", number(sensor.sd), &note(tuned, Place::Sd(i)));
    if let Some(drift) = sensor.drift {
        let mut inline = InlineTable::new();
        let mut why = Vec::new();
        for (lasting, keys, places) in [
            (drift.each, ["sd", "time_s"], [Place::DriftSd(i), Place::DriftTime(i)]),
            (drift.shared, ["shared_sd", "shared_time_s"], [Place::SharedSd(i), Place::SharedTime(i)]),
        ] {
            let Some(lasting) = lasting else { continue };
            for ((key, value), place) in keys.into_iter().zip([lasting.sd, lasting.time_s]).zip(places) {
                inline.insert(key, number(value));
                why.push(format!("{key}: {}", note(tuned, place)));
            }
        }
        set(table, "drift", Value::InlineTable(inline), &why.join("; "));
    }
    let (name, threshold) = match sensor.robust {
        Robust::None => ("none", None),
        Robust::Gate(gate) => ("gate", Some(("gate", gate))),
        Robust::Huber(c) => ("huber", Some(("threshold", c))),
        Robust::Redescending(c) => ("redescending", Some(("threshold", c))),
    };
    if name != "none" || table.contains_key("robust") {
        set(table, "robust", name.into(), "");
    }
    for key in ["gate", "threshold"] {
        match threshold {
            Some((own, value)) if own == key => set(table, key, number(value), &note(tuned, Place::Threshold(i))),
            _ => {
                table.remove(key);
            }
        }
    }
    if sensor.latency_s != 0.0 || table.contains_key("latency_s") {
        set(table, "latency_s", number(sensor.latency_s), &latency_note(tuned, i));
    }
    if let Some(height_m) = sensor.height_m {
        let why = if calibration.is_some() { "the median of the known heights" } else { "" };
        set(table, "height_m", number(height_m), why);
    }
    if let (Some(law), Some([exponent, level])) = (sensor.path_loss, calibration.and_then(|c| c.path_loss)) {
        let mut inline = InlineTable::new();
        inline.insert("exponent", number(law.exponent));
        inline.insert("at_1m_dbm", number(law.at_1m_dbm));
        let why = format!("exponent {}, level {}, least squares at known positions", error(exponent), error(level));
        set(table, "path_loss", Value::InlineTable(inline), &why);
    }
    if !sensor.bias.is_empty() {
        let mut inline = InlineTable::new();
        for (anchor, value) in &sensor.bias {
            inline.insert(anchor, number(*value));
        }
        set(table, "bias", Value::InlineTable(inline), &bias_note(calibration));
    }
}

fn latency_note(tuned: &Tuned, i: usize) -> String {
    let Some([less, at, more]) = tuned.latencies.get(i).copied().flatten() else { return String::new() };
    format!("smoothed trail: {} m RMSE, {} at 0.1 s less, {} at 0.1 s more", short(at), short(less), short(more))
}

fn bias_note(calibration: Option<&Calibration>) -> String {
    let Some(calibration) = calibration else { return "what the smoothed trail leaves".to_owned() };
    let errors: Vec<String> = calibration.bias.iter().map(|(anchor, b)| format!("{anchor} {}", error(*b))).collect();
    format!("{} residuals at known positions: {}", calibration.residuals, errors.join(", "))
}

fn error(estimated: Estimated) -> String {
    match estimated.error {
        Some(error) => format!("±{}", short(error)),
        None => "of too few to tell".to_owned(),
    }
}

/// The noise of modes that have one of their own.
fn write_modes(doc: &mut DocumentMut, tuned: &Tuned) {
    let EstimatorSpec::Imm { modes } = &tuned.spec.estimator else { return };
    let Some(tables) = doc.get_mut("estimator").and_then(|e| e.get_mut("mode")) else { return };
    let axes = fixtrail_track::registry::layout(&tuned.spec).axes;
    let Item::ArrayOfTables(tables) = tables else { return };
    for (table, mode) in tables.iter_mut().zip(modes.iter().flatten()) {
        if table.contains_key("noise") {
            set(table, "noise", numbers(&mode.noise[..axes]), "by the same factor as the model's");
        }
    }
}

fn write_window(doc: &mut DocumentMut, tuned: &Tuned) {
    let Some(table) = doc.get_mut("estimator").and_then(Item::as_table_like_mut) else { return };
    let count = |n: usize| Value::from(i64::try_from(n).unwrap_or(i64::MAX));
    let (window, lag) = match tuned.spec.estimator {
        EstimatorSpec::Fms { window: Span::Instants(window), lag: Span::Instants(lag), .. } => (window, Some(lag)),
        EstimatorSpec::Ufir { window: Span::Instants(window) } => (window, None),
        _ => return,
    };
    let all = |of: &[(usize, f64)]| -> String {
        let finite = of.iter().filter(|(_, error)| error.is_finite());
        finite.map(|(n, error)| format!("{n}: {}", short(*error))).collect::<Vec<_>>().join(", ")
    };
    table.remove("window_s");
    let found = &tuned.windows;
    set(table, "window", count(window), &format!("mean squared prediction error by window {}", all(&found.windows)));
    if let Some(lag) = lag {
        table.remove("lag_s");
        let by =
            if found.by_truth { "RMSE of smoothed positions" } else { "without truth the standard deviation claimed" };
        set(table, "lag", count(lag), &format!("{by} by lag {}; the smallest within 2 %", all(&found.lags)));
    }
}

fn write_arrival(doc: &mut DocumentMut, arrival: &Learnt) {
    let Some(table) = doc.get_mut("link").and_then(Item::as_table_like_mut) else { return };
    let by =
        if arrival.by_repeats { "values shown, by those that repeat" } else { "values, by their sequence numbers" };
    let why = format!("±{}, of {} {by}", short(arrival.sd), arrival.values);
    set(table, "arrival", number(arrival.rate), &why);
}

/// What neighbours of a number lose.
fn note(tuned: &Tuned, place: Place) -> String {
    let Some(profile) = tuned.profiles.iter().find(|p| p.place == place) else { return String::new() };
    let loss = |loss: Option<f64>| match loss {
        None => "is out of bounds".to_owned(),
        Some(loss) if loss.is_finite() => format!("loses {loss:.3}"),
        Some(_) => "cannot be run".to_owned(),
    };
    let [less, more] = profile.loss;
    format!("half {}, twice {}", loss(less), loss(more))
}

/// Sets `key`, with a comment behind it where the table has lines of its own.
fn set(table: &mut dyn toml_edit::TableLike, key: &str, mut value: Value, comment: &str) {
    if !comment.is_empty() {
        value.decor_mut().set_suffix(format!("  # {comment}"));
        value.decor_mut().set_prefix(" ");
    }
    table.insert(key, Item::Value(value));
}

/// A density, or a table where noise comes by steps.
fn turn_noise(model: &TurnSpec) -> Value {
    let Some(power) = model.per_step else { return number(model.turn_noise) };
    let mut table = InlineTable::new();
    table.insert("per_step", number(model.turn_noise));
    table.insert("power", i64::from(power).into());
    Value::InlineTable(table)
}

fn number(v: f64) -> Value {
    // Four digits are more than the data can tell, and read well.
    format!("{v:.3e}").parse::<f64>().unwrap_or(v).into()
}

fn list(of: &[f64]) -> Value {
    Value::Array(of.iter().map(|v| number(*v)).collect::<Array>())
}

/// One number when all are equal.
fn numbers(of: &[f64]) -> Value {
    match of {
        [first, rest @ ..] if rest.iter().all(|v| v == first) => number(*first),
        _ => list(of),
    }
}

fn short(v: f64) -> String {
    format!("{}", format!("{v:.2e}").parse::<f64>().unwrap_or(v))
}
