//! The demo's data as the tables that `fixtrail track` reads. Numbers read back to the same bits.

use fixtrail_sim::scenario::Demo;
use fixtrail_track::packet::Content;
use std::fmt::Write as _;

/// `measurements.csv`.
pub fn measurements(walk: &Demo) -> String {
    let mut out = String::from("t,target,kind,anchor,value,seq\n");
    for target in &walk.packets {
        for packet in &target.packets {
            if let Content::Range { anchor, value_m } = &packet.content {
                let (name, anchor) = (target.target.as_deref().unwrap_or_default(), walk.anchors.name(*anchor));
                let seq = packet.seq.map_or(String::new(), |n| n.to_string());
                // Writing to a string cannot fail.
                let _ = writeln!(out, "{},{name},range,{anchor},{value_m},{seq}", packet.t_s);
            }
        }
    }
    out
}

/// `anchors.csv`.
pub fn anchors(walk: &Demo) -> String {
    let mut out = String::from("anchor,x,y,z\n");
    for (id, name) in walk.anchors.names().iter().enumerate() {
        let [x, y, z] = walk.anchors.position_m(id as u32);
        let _ = writeln!(out, "{name},{x},{y},{z}");
    }
    out
}

/// `truth.csv`.
pub fn truth(walk: &Demo) -> String {
    let mut out = String::from("t,target,x,y,z\n");
    for target in &walk.truth {
        let name = target.target.as_deref().unwrap_or_default();
        for point in &target.points {
            let [x, y, z] = point.position_m.map(|v| v.map_or(String::new(), |v| v.to_string()));
            let _ = writeln!(out, "{},{name},{x},{y},{z}", point.t_s);
        }
    }
    out
}
