//! Trails as GeoJSON: one feature per target, a line that breaks where there is no estimate.

use super::columns::{self, OutCell};
use super::{Encoder, Piece, WriteError};
use crate::time::TimeForm;
use fixtrail_track::target::TargetTrail;
use fixtrail_track::trail::Trail;
use serde_json::{Value, json};

/// What stands before the features of a FeatureCollection (RFC 7946).
pub(super) const HEAD: &[u8] = b"{\"type\":\"FeatureCollection\",\"features\":[";
/// What stands after them.
pub(super) const FOOT: &[u8] = b"\n]}\n";

/// One feature per target, a comma before each. The arrays `times`, `sd` and `status` have one entry per position, in order; a lone position
/// between breaks stands twice, for a line needs two.
pub(super) fn append(encoder: &Encoder<'_>, piece: &Piece<'_>, out: &mut Vec<u8>) -> Result<(), WriteError> {
    out.extend_from_slice(b",\n");
    out.extend_from_slice(feature(encoder, piece.target)?.as_bytes());
    Ok(())
}

fn feature(encoder: &Encoder<'_>, target: &TargetTrail) -> Result<String, WriteError> {
    let mut cells: Vec<OutCell<'_>> = Vec::new();
    let mut lines: Vec<Vec<usize>> = vec![Vec::new()];
    for row in 0..target.trail.len() {
        // Refuses what is not finite.
        encoder.columns.fill(encoder.file, target, row, &mut cells)?;
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
        lines.iter().map(|line| line.iter().map(|&row| position(encoder, &target.trail, row)).collect()).collect();
    let geometry = match lines_json.len() {
        0 => Value::Null,
        1 => json!({"type": "LineString", "coordinates": lines_json[0]}),
        _ => json!({"type": "MultiLineString", "coordinates": lines_json}),
    };
    let rows = || lines.iter().flatten().copied();
    let properties = json!({
        "target": target.target,
        "times": rows().map(|row| time(encoder, &target.trail, row)).collect::<Value>(),
        "sd": rows().map(|row| sd(encoder, &target.trail, row)).collect::<Value>(),
        "status": rows().map(|row| Value::from(target.trail.status[row].name())).collect::<Value>(),
    });
    Ok(json!({"type": "Feature", "geometry": geometry, "properties": properties}).to_string())
}

fn position(encoder: &Encoder<'_>, trail: &Trail, row: usize) -> Value {
    let geodetic = trail.mean(row).and_then(|mean| columns::geodetic(encoder.meta.origin.as_ref(), encoder.axes, mean));
    match (geodetic, encoder.axes) {
        (Some([lat, lon, alt]), 3) => json!([lon, lat, alt]),
        (Some([lat, lon, _]), _) => json!([lon, lat]),
        (None, _) => Value::Null,
    }
}

fn time(encoder: &Encoder<'_>, trail: &Trail, row: usize) -> Value {
    match (trail.t_s[row], encoder.meta.time) {
        (None, _) => Value::Null,
        (Some(t_s), TimeForm::Rfc3339 { .. }) => Value::from(encoder.meta.time.text(t_s)),
        (Some(t_s), _) => Value::from(t_s),
    }
}

/// Standard deviations of the position.
fn sd(encoder: &Encoder<'_>, trail: &Trail, row: usize) -> Value {
    (0..encoder.axes).map(|i| trail.cov_at(row, i, i).map(|var| var.max(0.0).sqrt())).collect()
}
