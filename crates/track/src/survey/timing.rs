//! When a target's packets came: rate, silences, losses, repeats, delays.

use super::loss::{self, Basis, Loss};
use super::series::{Series, Source};
use super::stats::{Quantiles, ascending, median};
use crate::packet::{Content, Packet};
use std::collections::BTreeMap;

/// Times longer without a packet than usual.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Silences {
    /// How many.
    pub count: u64,
    /// Instants that should have been there.
    pub missing: u64,
    /// The longest, seconds.
    pub longest_s: f64,
    /// The instant before the longest.
    pub longest_at_s: f64,
}

/// Rows that came after their time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Late {
    /// Rows older than a row before them in the file.
    pub disordered: u64,
    /// Rows older than a row received before them; 0 without reception times.
    pub overtaken: u64,
    /// The largest age against the newest row before, in the file or by reception, seconds.
    pub worst_s: f64,
    /// Delay from sensing to reception, seconds.
    pub delay_s: Option<Quantiles>,
}

impl Late {
    /// The `late_s` that a live run needs to use every packet, rounded up to a millisecond, seconds.
    pub fn needed_late_s(&self) -> f64 {
        // Times are differences of decimal numbers; the link forgives a nanosecond too.
        ((self.worst_s - 1e-9).max(0.0) * 1000.0).ceil() / 1000.0
    }
}

/// The usual interval between the instants of a target, irregular or not.
pub(super) fn intervals(instants: &[f64]) -> Option<Quantiles> {
    Quantiles::of(instants.windows(2).map(|w| w[1] - w[0]))
}

/// The instants of a target, ascending, each once.
pub(super) fn instants(packets: &[Packet]) -> Vec<f64> {
    let mut t = ascending(packets.iter().map(|p| p.t_s));
    t.dedup();
    t
}

/// Intervals longer than three times the usual 95 % quantile and than 2.5 periods of the slowest source.
pub(super) fn silences(instants: &[f64], usual: &Quantiles, period_s: Option<f64>) -> Silences {
    let limit = match period_s {
        Some(period) => 2.5 * period,
        None => 3.0 * usual.p95,
    };
    let mut found = Silences::default();
    for w in instants.windows(2) {
        let length = w[1] - w[0];
        if length > limit {
            found.count += 1;
            found.missing += ((length / period_s.unwrap_or(usual.p50)).round() as u64).saturating_sub(1);
        }
        if length > found.longest_s {
            found.longest_s = length;
            found.longest_at_s = w[0];
        }
    }
    found
}

/// The losses of a target, from sequence numbers where there are any, else from the rates of its sources.
pub(super) fn losses(packets: &[Packet], sources: &BTreeMap<Source, Series>) -> Option<Loss> {
    if packets.iter().any(|p| matches!(p.content, Content::Linear { .. })) {
        return of_rows(packets);
    }
    if let Some(loss) = by_sequence(packets, sources) {
        return Some(loss);
    }
    let mut total: Option<Loss> = None;
    for series in sources.values() {
        if let Some(period) = loss::period(&series.t_s) {
            total.get_or_insert_with(|| Loss::new(Basis::Rate)).add(&loss::by_rate(&series.t_s, period));
        }
    }
    total
}

fn by_sequence(packets: &[Packet], sources: &BTreeMap<Source, Series>) -> Option<Loss> {
    let mut numbered: Vec<(f64, u64)> = packets.iter().filter_map(|p| p.seq.map(|seq| (p.t_s, seq))).collect();
    if numbered.len() < packets.len() || numbered.len() < 2 {
        return None;
    }
    numbered.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut common: Vec<u64> = numbered.into_iter().map(|(_, seq)| seq).collect();
    common.dedup();
    let per_source: Vec<Vec<u64>> =
        sources.values().map(|s| s.seq.iter().flatten().copied().collect::<Vec<u64>>()).collect();
    // A counter belongs to each source if its numbers follow one another there, else to the target's radio.
    let one_by_one = |numbers: &[u64]| median(numbers.windows(2).map(|w| w[1] as f64 - w[0] as f64)) == Some(1.0);
    let counts_per_source = sources.len() > 1 && per_source.iter().filter(|n| n.len() > 2).all(|n| one_by_one(n));
    if !counts_per_source {
        return Some(loss::by_sequence(&common));
    }
    let mut total = Loss::new(Basis::Sequence);
    for numbers in &per_source {
        total.add(&loss::by_sequence(numbers));
    }
    Some(total)
}

/// Losses of a linear run: rows that are absent, or present without a component.
fn of_rows(packets: &[Packet]) -> Option<Loss> {
    let heard = |p: &&Packet| matches!(&p.content, Content::Linear { z, .. } if z.iter().any(Option::is_some));
    let mut rows: Vec<u64> = packets.iter().filter(heard).filter_map(|p| p.k).collect();
    rows.sort_unstable();
    rows.dedup();
    let (first, last) = (packets.iter().filter_map(|p| p.k).min()?, packets.iter().filter_map(|p| p.k).max()?);
    let mut loss = Loss::new(Basis::Rows);
    loss.came(rows.len() as u64);
    // Losses before the first and after the last packet are known too: a row says that they were due.
    let edges = [first.checked_sub(1), Some(last + 1)];
    let mut next = first;
    for k in rows.iter().copied().chain(edges[1]) {
        loss.burst(k.saturating_sub(next));
        next = k + 1;
    }
    Some(loss)
}

/// Rows that repeat another bit for bit.
pub(super) fn duplicates(packets: &[Packet]) -> u64 {
    let mut order: Vec<&Packet> = packets.iter().filter(|p| !matches!(p.content, Content::Linear { .. })).collect();
    order.sort_by(|a, b| a.t_s.total_cmp(&b.t_s));
    let same = |a: &Packet, b: &Packet| a.content == b.content && a.sd == b.sd && a.seq == b.seq;
    let mut count = 0;
    let mut start = 0;
    while start < order.len() {
        let len = order[start..].iter().take_while(|p| p.t_s == order[start].t_s).count();
        let group = &order[start..start + len];
        count += (1..len).filter(|i| group[..*i].iter().any(|p| same(p, group[*i]))).count() as u64;
        start += len;
    }
    count
}

/// Rows that came late.
pub(super) fn late(packets: &[Packet]) -> Late {
    let mut late = Late::default();
    let mut newest = f64::NEG_INFINITY;
    for p in packets {
        if p.t_s < newest {
            late.disordered += 1;
            late.worst_s = late.worst_s.max(newest - p.t_s);
        }
        newest = newest.max(p.t_s);
    }
    let mut received: Vec<(f64, f64)> = packets.iter().filter_map(|p| p.received_s.map(|r| (r, p.t_s))).collect();
    received.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    newest = f64::NEG_INFINITY;
    for (_, t_s) in &received {
        if *t_s < newest {
            late.overtaken += 1;
            late.worst_s = late.worst_s.max(newest - t_s);
        }
        newest = newest.max(*t_s);
    }
    late.delay_s = Quantiles::of(received.iter().map(|(r, t)| r - t));
    late
}
