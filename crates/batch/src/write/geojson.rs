//! Trails as GeoJSON: one feature per target, a line that breaks where there is no estimate.

use super::columns::{self, OutCell};
use super::{Job, To, WriteError};
use crate::time::TimeForm;
use fixtrail_track::target::TargetTrail;
use fixtrail_track::trail::Trail;
use serde_json::{Value, json};

/// Writes a FeatureCollection (RFC 7946). The arrays `times`, `sd` and `status` have one entry per position, in order; a
/// lone position between breaks stands twice, for a line needs two.
pub(super) fn write(job: &Job<'_>, to: To<'_>) -> Result<(), WriteError> {
    let failed = |e| job.io(e);
    to.write_all(b"{\"type\":\"FeatureCollection\",\"features\":[").map_err(failed)?;
    for (i, &target) in job.by_target().iter().enumerate() {
        let text = format!("{}{}", if i == 0 { "\n" } else { ",\n" }, feature(job, &job.trails[target])?);
        to.write_all(text.as_bytes()).map_err(failed)?;
    }
    to.write_all(b"\n]}\n").map_err(failed)
}

fn feature(job: &Job<'_>, target: &TargetTrail) -> Result<String, WriteError> {
    let table = job.columns();
    let mut cells: Vec<OutCell<'_>> = Vec::new();
    let mut lines: Vec<Vec<usize>> = vec![Vec::new()];
    for row in 0..target.trail.len() {
        // Refuses what is not finite.
        table.fill(job, target, row, &mut cells)?;
        match (target.trail.mean(row), lines.last_mut()) {
            (Some(_), Some(line)) => line.push(row),
            _ => lines.push(Vec::new()),
        }
    }
    lines.retain(|line| !line.is_empty());
    for line in lines.iter_mut().filter(|line| line.len() == 1) {
        line.push(line[0]);
    }

    let lines_json: Vec<Value> =
        lines.iter().map(|line| line.iter().map(|&row| position(job, &target.trail, row)).collect()).collect();
    let geometry = match lines_json.len() {
        0 => Value::Null,
        1 => json!({"type": "LineString", "coordinates": lines_json[0]}),
        _ => json!({"type": "MultiLineString", "coordinates": lines_json}),
    };
    let rows = || lines.iter().flatten().copied();
    let properties = json!({
        "target": target.target,
        "times": rows().map(|row| time(job, &target.trail, row)).collect::<Value>(),
        "sd": rows().map(|row| sd(job, &target.trail, row)).collect::<Value>(),
        "status": rows().map(|row| Value::from(target.trail.status[row].name())).collect::<Value>(),
    });
    Ok(json!({"type": "Feature", "geometry": geometry, "properties": properties}).to_string())
}

fn position(job: &Job<'_>, trail: &Trail, row: usize) -> Value {
    let geodetic = trail.mean(row).and_then(|mean| columns::geodetic(job, mean));
    match (geodetic, job.layout.axes) {
        (Some([lat, lon, alt]), 3) => json!([lon, lat, alt]),
        (Some([lat, lon, _]), _) => json!([lon, lat]),
        (None, _) => Value::Null,
    }
}

fn time(job: &Job<'_>, trail: &Trail, row: usize) -> Value {
    match (trail.t_s[row], job.meta.time) {
        (None, _) => Value::Null,
        (Some(t_s), TimeForm::Rfc3339 { .. }) => Value::from(job.meta.time.text(t_s)),
        (Some(t_s), _) => Value::from(t_s),
    }
}

/// Standard deviations of the position.
fn sd(job: &Job<'_>, trail: &Trail, row: usize) -> Value {
    (0..job.layout.axes).map(|i| trail.cov_at(row, i, i).map(|var| var.max(0.0).sqrt())).collect()
}
