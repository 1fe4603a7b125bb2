//! The packets of a target in order: repeated ones dropped, contradictions refused.

use crate::gather::Facts;
use crate::names::TargetId;
use crate::options::Counts;
use crate::schema::Col;
use fixtrail_track::error::BuildError;
use fixtrail_track::geo::{self, Origin};
use fixtrail_track::packet::{Content, Kind, Packet};
use std::cmp::Ordering;

/// Most rows in a row that a `k` column may leave out: beyond, `k` is a clock or an id rather than a row's number, and filling the gap
/// would take for ever.
const LONGEST_GAP: u64 = 10_000_000;

/// What became of rows.
#[derive(Debug, Default)]
pub(crate) struct Tally {
    /// Rows dropped because they repeat another.
    pub duplicates: u64,
    /// Rows of contradictions, skipped.
    pub skipped_bad: u64,
    /// What was wrong with the first of them.
    pub first_bad: Option<String>,
    /// The contradiction that stands first in the file, where bad rows are not skipped.
    pub refused: Option<BuildError>,
}

impl Tally {
    /// Adds to what was counted while the rows came in.
    pub fn add_to(&self, counts: &mut Counts) {
        counts.duplicates += self.duplicates;
        counts.skipped_bad += self.skipped_bad;
        if counts.first_bad.is_none() {
            counts.first_bad.clone_from(&self.first_bad);
        }
    }

    /// Adds what became of later rows.
    pub fn add(&mut self, later: Tally) {
        self.duplicates += later.duplicates;
        self.skipped_bad += later.skipped_bad;
        self.first_bad = self.first_bad.take().or(later.first_bad);
        if let Some(error) = later.refused {
            self.refuse(error);
        }
    }

    fn refuse(&mut self, error: BuildError) {
        if self.refused.as_ref().is_none_or(|first| error.place.line < first.place.line) {
            self.refused = Some(error);
        }
    }
}

/// Goes through the packets of one target, piece by piece.
pub(crate) struct Settler {
    target: Option<String>,
    by_k: bool,
    next_k: u64,
    /// Time, `k` and line of the packet before.
    before: Option<(f64, u64, u64)>,
    /// Packets before.
    count: u64,
}

impl Settler {
    pub fn new(facts: &Facts<'_>, target: TargetId) -> Settler {
        Settler { target: facts.name(target), by_k: facts.by_k(target), next_k: 0, before: None, count: 0 }
    }

    /// Settles a piece: packets in order of their records, all those of an instant together. Nothing is left of it where it is refused.
    pub fn settle(&mut self, packets: &mut Vec<Packet>, facts: &Facts<'_>, tally: &mut Tally) {
        // Dates of several latencies may round to another order in seconds than they have in nanoseconds.
        if !packets.is_sorted_by(|a, b| self.order(a, b).is_le()) {
            packets.sort_by(|a, b| self.order(a, b));
        }
        let settled = self.drop_copies(packets, facts, tally).and_then(|()| self.check_order(packets, facts));
        if let Err(error) = settled {
            tally.refuse(error);
            packets.clear();
        }
        if let Some(origin) = &facts.origin {
            for packet in packets.iter_mut() {
                if let Content::Position(p) = &mut packet.content {
                    *p = to_local(origin, *p);
                }
            }
        }
    }

    fn order(&self, a: &Packet, b: &Packet) -> Ordering {
        self.same_slot(a, b).then_with(|| within_slot(a, b))
    }

    /// Orders by instant, kind and anchors: packets that are equal here measure the same thing.
    fn same_slot(&self, a: &Packet, b: &Packet) -> Ordering {
        if self.by_k {
            return a.k.cmp(&b.k);
        }
        a.t_s.total_cmp(&b.t_s).then_with(|| a.source().cmp(&b.source()))
    }

    fn drop_copies(&self, packets: &mut Vec<Packet>, facts: &Facts<'_>, tally: &mut Tally) -> Result<(), BuildError> {
        if packets.windows(2).all(|pair| self.same_slot(&pair[0], &pair[1]).is_ne()) {
            return Ok(());
        }
        let mut keep = vec![true; packets.len()];
        let mut start = 0;
        while start < packets.len() {
            let run = packets[start..].iter().take_while(|p| self.same_slot(p, &packets[start]).is_eq()).count();
            let slot = &packets[start..start + run];
            if run > 1 {
                let first = slot.iter().min_by_key(|p| p.line).unwrap_or(&slot[0]);
                let other = slot.iter().filter(|p| !says_the_same(p, first)).min_by_key(|p| p.line);
                match other {
                    None => {
                        keep[start + 1..start + run].fill(false);
                        tally.duplicates += run as u64 - 1;
                    }
                    Some(other) => {
                        let error = contradiction(self.target.as_deref(), first, other, facts);
                        if !facts.skip_bad_rows {
                            return Err(error);
                        }
                        // Which of them is right cannot be known, and must not depend on their order.
                        keep[start..start + run].fill(false);
                        tally.skipped_bad += run as u64;
                        tally.first_bad.get_or_insert_with(|| error.to_string());
                    }
                }
            }
            start += run;
        }
        let mut kept = keep.iter();
        packets.retain(|_| kept.next().copied().unwrap_or(true));
        Ok(())
    }

    /// Refuses gaps of `k` that cannot be meant and times against the order of `k`, and numbers the rows of a linear run that has times alone.
    fn check_order(&mut self, packets: &mut [Packet], facts: &Facts<'_>) -> Result<(), BuildError> {
        if self.by_k {
            for packet in packets.iter() {
                let k = packet.k.unwrap_or_default();
                if k - self.next_k > LONGEST_GAP {
                    let lost = k - self.next_k;
                    let what =
                        format!("is {k}, which makes {lost} rows before it lost, expected at most {LONGEST_GAP}");
                    return Err(facts.schema.at(packet.line, Col::K, what));
                }
                self.next_k = k + 1;
                if let (true, Some((t_s, before_k, line))) = (facts.schema.has(Col::T), self.before)
                    && t_s >= packet.t_s
                {
                    let what = format!(
                        "does not grow from line {line} (k = {before_k}) to k = {k}, expected times in the order of k"
                    );
                    return Err(facts.schema.at(packet.line, Col::T, what));
                }
                self.before = Some((packet.t_s, k, packet.line));
            }
        } else if packets.iter().all(|p| p.content.kind() == Kind::Linear) {
            for packet in packets.iter_mut() {
                packet.k = Some(self.count);
                self.count += 1;
            }
        }
        Ok(())
    }
}

fn contradiction(target: Option<&str>, first: &Packet, other: &Packet, facts: &Facts<'_>) -> BuildError {
    let mut of = target.map_or_else(String::new, |t| format!(" for target `{t}`"));
    for id in other.content.anchors().into_iter().flatten() {
        of.push_str(&format!(", anchor `{}`", facts.anchors.name(id)));
    }
    let when = match other.k.filter(|_| facts.schema.has(Col::K)) {
        Some(k) => format!("k = {k}"),
        None => "the same instant".to_owned(),
    };
    let (a, b) = (describe(first), describe(other));
    let what = format!("says {b}{of} at {when} where line {} says {a}, expected one value", first.line);
    BuildError::new(facts.schema.file, Some(other.line), None, what)
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

/// Orders packets that measure the same thing, so that of several equal ones the same is kept always.
fn within_slot(a: &Packet, b: &Packet) -> Ordering {
    let received = |p: &Packet| p.received_s.unwrap_or(f64::INFINITY);
    received(a).total_cmp(&received(b)).then_with(|| a.seq.cmp(&b.seq)).then_with(|| a.line.cmp(&b.line))
}

/// Local metres of degrees, degrees and metres. A position without height is taken at the origin's, and has no z.
pub(crate) fn to_local(origin: &Origin, [lat, lon, alt]: [Option<f64>; 3]) -> [Option<f64>; 3] {
    let (Some(lat), Some(lon)) = (lat, lon) else { return [None; 3] };
    let [x, y, z] = geo::enu_from_wgs84(origin, lat, lon, alt.unwrap_or(origin.alt_m));
    [Some(x), Some(y), alt.map(|_| z)]
}
