//! Packets, anchors and truth as the tables that `fixtrail track` reads. Numbers read back to the same bits.

use fixtrail_track::anchors::Anchors;
use fixtrail_track::packet::{Content, Packet};
use fixtrail_track::target::TargetPackets;
use fixtrail_track::truth::TargetTruth;
use std::fmt::Write as _;

/// A cell of a row; empty where the row has nothing to say.
type Cell = Box<dyn Fn(&Row<'_>) -> String>;

struct Row<'a> {
    target: Option<&'a str>,
    packet: &'a Packet,
    anchors: &'a Anchors,
}

fn number(value: Option<f64>) -> String {
    value.map_or(String::new(), |v| v.to_string())
}

/// A measurement table with the columns that some row fills. Rows stand as they come; where they carry times of reception, by those.
pub fn measurements(targets: &[TargetPackets], anchors: &Anchors) -> String {
    let mut rows: Vec<Row<'_>> = targets
        .iter()
        .flat_map(|t| t.packets.iter().map(|packet| Row { target: t.target.as_deref(), packet, anchors }))
        .collect();
    let came = |row: &Row<'_>| row.packet.received_s.unwrap_or(f64::NEG_INFINITY);
    rows.sort_by(|a, b| came(a).total_cmp(&came(b)));
    let is_linear = rows.iter().all(|r| matches!(r.packet.content, Content::Linear { .. }));
    let mut columns: Vec<(String, Cell)> = Vec::new();
    if is_linear {
        columns.push(("k".to_owned(), Box::new(|r| r.packet.k.map_or(String::new(), |k| k.to_string()))));
        let sizes = rows.first().map_or((0, 0), |r| match &r.packet.content {
            Content::Linear { z, u } => (z.len(), u.len()),
            _ => (0, 0),
        });
        for i in 0..sizes.0 {
            columns.push((
                format!("z{}", i + 1),
                Box::new(move |r| number(linear(r, |z, _| z.get(i).copied().flatten()))),
            ));
        }
        for i in 0..sizes.1 {
            columns.push((format!("u{}", i + 1), Box::new(move |r| number(linear(r, |_, u| u.get(i).copied())))));
        }
    } else {
        columns.push(("t".to_owned(), Box::new(|r| r.packet.t_s.to_string())));
    }
    let at = if is_linear { 1 } else { columns.len() };
    columns.insert(at, ("target".to_owned(), Box::new(|r| r.target.unwrap_or_default().to_owned())));
    if !is_linear {
        let radio: [(&str, Cell); 7] = [
            ("kind", Box::new(|r| r.packet.content.kind().name().to_owned())),
            ("anchor", Box::new(|r| anchor(r, 0))),
            ("anchor2", Box::new(|r| anchor(r, 1))),
            ("value", Box::new(|r| number(value(&r.packet.content)))),
            ("x", Box::new(|r| number(coordinate(r, 0)))),
            ("y", Box::new(|r| number(coordinate(r, 1)))),
            ("z", Box::new(|r| number(coordinate(r, 2)))),
        ];
        columns.extend(radio.map(|(name, cell)| (name.to_owned(), cell)));
    }
    columns.push(("sd".to_owned(), Box::new(|r| number(r.packet.sd))));
    columns.push(("seq".to_owned(), Box::new(|r| r.packet.seq.map_or(String::new(), |n| n.to_string()))));
    columns.push(("received".to_owned(), Box::new(|r| number(r.packet.received_s))));
    // A column that every row leaves empty is left out; a linear row may be all lost.
    let keep =
        |(name, cell): &(String, Cell)| name.starts_with('z') && is_linear || rows.iter().any(|r| !cell(r).is_empty());
    columns.retain(keep);

    let names: Vec<&str> = columns.iter().map(|(name, _)| name.as_str()).collect();
    let mut out = names.join(",") + "\n";
    for row in &rows {
        let cells: Vec<String> = columns.iter().map(|(_, cell)| cell(row)).collect();
        out += &cells.join(",");
        out.push('\n');
    }
    out
}

fn linear(row: &Row<'_>, get: impl Fn(&[Option<f64>], &[f64]) -> Option<f64>) -> Option<f64> {
    match &row.packet.content {
        Content::Linear { z, u } => get(z, u),
        _ => None,
    }
}

fn anchor(row: &Row<'_>, which: usize) -> String {
    row.packet.content.anchors()[which].map_or(String::new(), |id| row.anchors.name(id).to_owned())
}

fn coordinate(row: &Row<'_>, axis: usize) -> Option<f64> {
    match &row.packet.content {
        Content::Position(p) => p[axis],
        _ => None,
    }
}

fn value(content: &Content) -> Option<f64> {
    match content {
        Content::Range { value_m: v, .. }
        | Content::Rssi { value_dbm: v, .. }
        | Content::Tdoa { value_m: v, .. }
        | Content::Bearing { value_rad: v, .. } => Some(*v),
        Content::Position(_) | Content::Linear { .. } => None,
    }
}

/// `anchors.csv`.
pub fn anchors(anchors: &Anchors) -> String {
    let mut out = String::from("anchor,x,y,z\n");
    for (id, name) in anchors.names().iter().enumerate() {
        let [x, y, z] = anchors.position_m(id as u32);
        // Writing to a string cannot fail.
        let _ = writeln!(out, "{name},{x},{y},{z}");
    }
    out
}

/// `truth.csv`.
pub fn truth(targets: &[TargetTruth]) -> String {
    let mut out = String::from("t,target,x,y,z\n");
    for target in targets {
        let name = target.target.as_deref().unwrap_or_default();
        for point in &target.points {
            let [x, y, z] = point.position_m.map(number);
            let _ = writeln!(out, "{},{name},{x},{y},{z}", point.t_s);
        }
    }
    out
}

/// The truth of a linear model: `k,x1 … xn`.
pub fn states(states: &[Vec<f64>]) -> String {
    let n = states.first().map_or(0, Vec::len);
    let mut out = String::from("k");
    (1..=n).for_each(|i| out += &format!(",x{i}"));
    out.push('\n');
    for (k, x) in states.iter().enumerate() {
        out += &k.to_string();
        x.iter().for_each(|v| out += &format!(",{v}"));
        out.push('\n');
    }
    out
}
