//! Which estimators are compared.

use super::entries::Measure;
use crate::data::SpecText;
use crate::failure::Failure;
use fixtrail_batch::Table;
use fixtrail_track::registry;
use fixtrail_track::spec::{Receiver, Spec, split_estimators};
use fixtrail_track::trackers::LaggedMode;

/// Where estimators come from, in messages.
const GIVEN: &str = "--estimators";

/// One spec per estimator, ready to build: those of `list`, or those that suit.
///
/// # Errors
/// [`Failure::Bad`] for a list with an estimator that is unknown, does not suit or stands there twice.
pub fn contenders(
    list: Option<&str>,
    own: &SpecText,
    table: &Table,
    measure: Measure<'_>,
) -> Result<Vec<SpecText>, Failure> {
    let specs = match list {
        Some(list) => named(list, &own.spec)?,
        None => suitable(&own.spec, table, measure),
    };
    let specs: Vec<SpecText> = specs
        .into_iter()
        .map(|spec| SpecText { path: own.path.clone(), text: own.text.clone(), reasons: Vec::new(), spec })
        .collect();
    specs.iter().try_for_each(|spec| spec.try_build(&table.anchors, LaggedMode::Own))?;
    Ok(specs)
}

fn named(list: &str, own: &Spec) -> Result<Vec<Spec>, Failure> {
    let mut specs: Vec<Spec> = Vec::new();
    for text in split_estimators(list) {
        let spec = own.with_estimator(&text, GIVEN)?;
        if specs.contains(&spec) {
            return Err(Failure::Bad(format!(
                "{GIVEN} {list}: has `{}` twice, expected different estimators",
                spec.estimator.compact()
            )));
        }
        specs.push(spec);
    }
    Ok(specs)
}

/// The spec's own estimator, and one of each other kind that suits model, sensors and link.
fn suitable(own: &Spec, table: &Table, measure: Measure<'_>) -> Vec<Spec> {
    let window = window(own, table);
    let lag = window / 4;
    let others = match (own.link.receiver, measure) {
        (Receiver::Unstamped { .. }, _) => {
            vec!["kalman".to_owned(), "ekf".into(), "lmvf".into(), "lmmse".into(), "emvf".into(), "gpb1".into()]
        }
        // Without truth a smoother has nothing to show but its filter, which is among the others.
        (_, Measure::Prediction) => {
            vec![
                "kalman".into(),
                "ekf".into(),
                "imm".into(),
                format!("fms:window={window}"),
                format!("ufir:window={window}"),
            ]
        }
        _ => vec![
            "kalman".into(),
            "ekf".into(),
            "imm".into(),
            format!("fms:window={window},lag={lag}"),
            format!("ufir:window={window}"),
            format!("fixed-lag-kalman:lag={lag}"),
            "rts".into(),
        ],
    };
    let mut specs = vec![own.clone()];
    for text in others {
        // Where both suit they are one and the same.
        let kind = |name: &str| if name == "kalman" { "ekf".to_owned() } else { name.to_owned() };
        let Ok(spec) = own.with_estimator(&text, GIVEN) else { continue };
        let fits = registry::build(&spec, &table.anchors, &registry::BuildOptions::default()).is_ok();
        if fits && specs.iter().all(|s| kind(s.estimator.name()) != kind(spec.estimator.name())) {
            specs.push(spec);
        }
    }
    specs
}

/// A window of ten values for each component of the state, from 10 to 200 instants.
fn window(spec: &Spec, table: &Table) -> usize {
    let (mut values, mut instants) = (0, 0);
    for target in &table.targets {
        let mut last_s = f64::NAN;
        for packet in target.packets.iter().filter(|p| spec.uses(p.content.kind())) {
            instants += usize::from(packet.t_s != last_s);
            last_s = packet.t_s;
            values += packet.content.values().flatten().count();
        }
    }
    let needed = 10 * registry::layout(spec).n();
    (needed * instants).checked_div(values).unwrap_or(needed).clamp(10, 200)
}
