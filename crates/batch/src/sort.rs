//! The packets of a table in one order, whatever the order of its rows.

use crate::options::Counts;
use crate::rows::{Dates, Group, Rows};
use crate::schema::Col;
use crate::time::{self, TimeForm};
use fixtrail_track::error::BuildError;
use fixtrail_track::geo::{self, Origin};
use fixtrail_track::packet::{Content, Kind, Packet};
use fixtrail_track::target::TargetPackets;
use std::cmp::Ordering;

/// What is left of a table when all rows are in.
pub(crate) struct Settled {
    pub targets: Vec<TargetPackets>,
    pub time: TimeForm,
    pub origin: Option<Origin>,
    pub has_target: bool,
    pub counts: Counts,
}

/// Sorts, drops repeated rows, refuses contradictions, and turns dates into seconds and latitudes into metres.
pub(crate) fn settle(mut rows: Rows<'_>) -> Result<Settled, BuildError> {
    let file = rows.schema.file;
    let mut groups = rows.take_groups();
    if groups.is_empty() && rows.counts.skipped_bad > 0 {
        let first = rows.counts.first_bad.unwrap_or_default();
        return Err(BuildError::new(
            file,
            None,
            None,
            format!("has no good row, expected at least one; the first: {first}"),
        ));
    }
    let time = time_form(&rows, &groups);
    if let TimeForm::Rfc3339 { epoch_unix_s, .. } = time {
        groups.iter_mut().for_each(|g| date_packets(g, epoch_unix_s, &rows));
    }
    groups.sort_by(|a, b| a.target.cmp(&b.target));

    let mut targets = Vec::with_capacity(groups.len());
    let mut worst: Option<BuildError> = None;
    for group in groups {
        let mut target = TargetPackets { target: group.target, packets: group.packets };
        let refused = settle_target(&mut target, &mut rows);
        // Of several contradictions the one that stands first in the file is reported.
        if let Err(error) = refused
            && worst.as_ref().is_none_or(|w| error.place.line < w.place.line)
        {
            worst = Some(error);
        }
        if !target.packets.is_empty() {
            targets.push(target);
        }
    }
    if let Some(error) = worst {
        return Err(error);
    }
    let is_geodetic = rows.positions.is_some_and(|p| p.form);
    if let (true, Some(line)) = (is_geodetic, rows.anchored) {
        let what =
            "refers to an anchor in metres while positions are latitudes and longitudes, expected one frame for both";
        return Err(rows.schema.at(line, Col::Anchor, what));
    }
    let origin = if is_geodetic { local_frame(&mut targets) } else { None };
    Ok(Settled { targets, time, origin, has_target: rows.schema.has(Col::Target), counts: rows.counts })
}

fn time_form(rows: &Rows<'_>, groups: &[Group]) -> TimeForm {
    match rows.times {
        Some(seen) if seen.form => {
            let earliest = groups.iter().flat_map(|g| &g.dates).map(|d| d.sensed_ns).min();
            TimeForm::Rfc3339 {
                epoch_unix_s: earliest.map_or(0, time::whole_second),
                offset_s: rows.offset_s.flatten().unwrap_or(0),
            }
        }
        _ if rows.schema.has(Col::T) => TimeForm::Seconds,
        _ => TimeForm::Index,
    }
}

fn date_packets(group: &mut Group, epoch_unix_s: i64, rows: &Rows<'_>) {
    for (packet, Dates { sensed_ns, received_ns }) in group.packets.iter_mut().zip(&group.dates) {
        let latency_s = rows.options.latency_s.get(&packet.content.kind()).copied().unwrap_or(0.0);
        packet.t_s = time::seconds_since(*sensed_ns, epoch_unix_s) - latency_s;
        packet.received_s = received_ns.map(|ns| time::seconds_since(ns, epoch_unix_s));
    }
}

/// Most rows in a row that a `k` column may leave out: beyond, `k` is a clock or an id rather than a row's number, and filling the gap
/// would take for ever.
const LONGEST_GAP: u64 = 10_000_000;

/// Sorts one target's packets, drops repeated ones and refuses contradictions (or skips both sides of them).
fn settle_target(target: &mut TargetPackets, rows: &mut Rows<'_>) -> Result<(), BuildError> {
    let packets = &mut target.packets;
    let by_k = packets.iter().all(|p| p.k.is_some());
    packets.sort_by(|a, b| same_slot(a, b, by_k).then_with(|| within_slot(a, b)));

    let mut keep = vec![true; packets.len()];
    let mut start = 0;
    while start < packets.len() {
        let run = packets[start..].iter().take_while(|p| same_slot(p, &packets[start], by_k).is_eq()).count();
        let slot = &packets[start..start + run];
        if run > 1 {
            let first = slot.iter().min_by_key(|p| p.line).unwrap_or(&slot[0]);
            let other = slot.iter().filter(|p| !says_the_same(p, first)).min_by_key(|p| p.line);
            match other {
                None => {
                    keep[start + 1..start + run].fill(false);
                    rows.counts.duplicates += run as u64 - 1;
                }
                Some(other) => {
                    let error = contradiction(target.target.as_deref(), first, other, rows);
                    if !rows.options.skip_bad_rows {
                        return Err(error);
                    }
                    // Which of them is right cannot be known, and must not depend on their order.
                    keep[start..start + run].fill(false);
                    rows.counts.skipped_bad += run as u64;
                    rows.counts.first_bad.get_or_insert_with(|| error.to_string());
                }
            }
        }
        start += run;
    }
    if keep.contains(&false) {
        let mut kept = keep.iter();
        packets.retain(|_| kept.next().copied().unwrap_or(true));
    }

    if by_k {
        let mut next = 0;
        for packet in packets.iter() {
            let k = packet.k.unwrap_or_default();
            if k - next > LONGEST_GAP {
                let lost = k - next;
                let what = format!("is {k}, which makes {lost} rows before it lost, expected at most {LONGEST_GAP}");
                return Err(rows.schema.at(packet.line, Col::K, what));
            }
            next = k + 1;
        }
    }
    if by_k && rows.schema.has(Col::T) {
        if let Some(pair) = packets.windows(2).find(|p| p[0].t_s >= p[1].t_s) {
            let (before, now) = (&pair[0], &pair[1]);
            let k = now.k.unwrap_or_default();
            let what = format!(
                "does not grow from line {} (k = {}) to k = {k}, expected times in the order of k",
                before.line,
                before.k.unwrap_or_default()
            );
            return Err(rows.schema.at(now.line, Col::T, what));
        }
    } else if !by_k && packets.iter().all(|p| p.content.kind() == Kind::Linear) {
        packets.iter_mut().enumerate().for_each(|(i, p)| p.k = Some(i as u64));
    }
    Ok(())
}

fn contradiction(target: Option<&str>, first: &Packet, other: &Packet, rows: &Rows<'_>) -> BuildError {
    let mut of = target.map_or_else(String::new, |t| format!(" for target `{t}`"));
    let anchors = rows.anchors.anchors;
    for id in other.content.anchors().into_iter().flatten() {
        of.push_str(&format!(", anchor `{}`", anchors.name(id)));
    }
    let when = match other.k.filter(|_| rows.schema.has(Col::K)) {
        Some(k) => format!("k = {k}"),
        None => "the same instant".to_owned(),
    };
    let (a, b) = (describe(first), describe(other));
    let what = format!("says {b}{of} at {when} where line {} says {a}, expected one value", first.line);
    BuildError::new(rows.schema.file, Some(other.line), None, what)
}

/// A packet's measurement for a message.
fn describe(packet: &Packet) -> String {
    let list = |v: &[Option<f64>]| {
        v.iter().map(|x| x.map_or("-".to_owned(), |x| format!("{x:?}"))).collect::<Vec<_>>().join(", ")
    };
    let value = match &packet.content {
        Content::Position(p) => list(p),
        Content::Range { value_m, .. } | Content::Tdoa { value_m, .. } => format!("{value_m:?}"),
        Content::Rssi { value_dbm, .. } => format!("{value_dbm:?}"),
        Content::Bearing { value_rad, .. } => format!("{value_rad:?}"),
        Content::Linear { z, u } if u.is_empty() => list(z),
        Content::Linear { z, u } => format!("{}; u = {u:?}", list(z)),
    };
    match packet.sd {
        Some(sd) => format!("{} `{value}` (sd {sd:?})", packet.content.kind().name()),
        None => format!("{} `{value}`", packet.content.kind().name()),
    }
}

fn says_the_same(a: &Packet, b: &Packet) -> bool {
    a.content == b.content && a.sd == b.sd && a.t_s == b.t_s
}

/// Orders by instant, kind and anchors: packets that are equal here measure the same thing.
fn same_slot(a: &Packet, b: &Packet, by_k: bool) -> Ordering {
    if by_k {
        return a.k.cmp(&b.k);
    }
    a.t_s.total_cmp(&b.t_s).then_with(|| a.source().cmp(&b.source()))
}

/// Orders packets that measure the same thing, so that of several equal ones the same is kept always.
fn within_slot(a: &Packet, b: &Packet) -> Ordering {
    let received = |p: &Packet| p.received_s.unwrap_or(f64::INFINITY);
    received(a).total_cmp(&received(b)).then_with(|| a.seq.cmp(&b.seq)).then_with(|| a.line.cmp(&b.line))
}

/// Turns latitudes and longitudes into metres about the earliest position.
fn local_frame(targets: &mut [TargetPackets]) -> Option<Origin> {
    let mut earliest: Option<(f64, Origin)> = None;
    for packet in targets.iter().flat_map(|t| &t.packets) {
        if let Content::Position([Some(lat_deg), Some(lon_deg), alt]) = packet.content
            && earliest.is_none_or(|(t_s, _)| packet.t_s < t_s)
        {
            earliest = Some((packet.t_s, Origin { lat_deg, lon_deg, alt_m: alt.unwrap_or(0.0) }));
        }
    }
    let (_, origin) = earliest?;
    for packet in targets.iter_mut().flat_map(|t| &mut t.packets) {
        if let Content::Position(p) = &mut packet.content {
            *p = to_local(&origin, *p);
        }
    }
    Some(origin)
}

/// Local metres of degrees, degrees and metres. A position without height is taken at the origin's, and has no z.
pub(crate) fn to_local(origin: &Origin, [lat, lon, alt]: [Option<f64>; 3]) -> [Option<f64>; 3] {
    let (Some(lat), Some(lon)) = (lat, lon) else { return [None; 3] };
    let [x, y, z] = geo::enu_from_wgs84(origin, lat, lon, alt.unwrap_or(origin.alt_m));
    [Some(x), Some(y), alt.map(|_| z)]
}
