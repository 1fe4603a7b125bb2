//! A packet as words of 64 bits, as many as the columns of its table need: what is sorted and spilled.
//!
//! ```text
//! head    target << 40 | line
//! t       seconds (bits of an f64, latency taken off) or a date (nanoseconds since 1970)
//! k       time index
//! source  kind << 56 | (anchor + 1) << 28 | (anchor2 + 1)
//! value…  measured numbers, then inputs
//! sd, seq, received, arrival
//! ```
//!
//! A word is there only where a column for it is; an empty cell is [`ABSENT`].

use crate::names::TargetId;
use crate::time::{self, Stamp};
use fixtrail_track::packet::{AnchorId, Content, Kind, Packet};
use std::cmp::Ordering;

/// What stands for an empty cell: as an f64 a NaN, which no table may hold.
pub(crate) const ABSENT: u64 = i64::MAX as u64;

/// Bits of the line in the head.
const LINE_BITS: u32 = 40;
/// Most lines of a table.
pub(crate) const MOST_LINES: u64 = 1 << LINE_BITS;
/// Most anchors of a table.
pub(crate) const MOST_ANCHORS: usize = (1 << 28) - 1;

/// Where the words of a record stand; 0, the place of the head, where there is none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Shape {
    /// Words of a record.
    pub width: usize,
    pub t: usize,
    pub k: usize,
    source: usize,
    values: usize,
    n_values: usize,
    n_inputs: usize,
    sd: usize,
    seq: usize,
    received: usize,
    arrival: usize,
    /// Kind of the rows where none is kept.
    kind: Option<Kind>,
}

/// What a table may hold besides target and line.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Parts {
    pub t: bool,
    pub k: bool,
    /// The one kind of all rows, where there is one and it needs no anchors.
    pub kind: Option<Kind>,
    pub n_values: usize,
    pub n_inputs: usize,
    pub sd: bool,
    pub seq: bool,
    pub received: bool,
    pub arrival: bool,
}

impl Shape {
    pub fn new(parts: &Parts) -> Shape {
        let mut width = 1;
        let mut place = |words: usize| {
            let at = if words == 0 { 0 } else { width };
            width += words;
            at
        };
        let mut shape = Shape {
            t: place(usize::from(parts.t)),
            k: place(usize::from(parts.k)),
            source: place(usize::from(parts.kind.is_none())),
            values: place(parts.n_values + parts.n_inputs),
            n_values: parts.n_values,
            n_inputs: parts.n_inputs,
            sd: place(usize::from(parts.sd)),
            seq: place(usize::from(parts.seq)),
            received: place(usize::from(parts.received)),
            arrival: place(usize::from(parts.arrival)),
            kind: parts.kind,
            width: 0,
        };
        shape.width = width;
        shape
    }

    /// The shape with room for what either has.
    pub fn union(&self, other: &Shape) -> Shape {
        let has = |place: fn(&Shape) -> usize| place(self) > 0 || place(other) > 0;
        Shape::new(&Parts {
            t: has(|s| s.t),
            k: has(|s| s.k),
            kind: self.kind.filter(|_| self.kind == other.kind),
            n_values: self.n_values.max(other.n_values),
            n_inputs: self.n_inputs.max(other.n_inputs),
            sd: has(|s| s.sd),
            seq: has(|s| s.seq),
            received: has(|s| s.received),
            arrival: has(|s| s.arrival),
        })
    }

    /// Appends a record of this shape as one of another that has room for it.
    pub fn widen(&self, record: &[u64], to: &Shape, out: &mut Vec<u64>) {
        let from = out.len();
        out.resize(from + to.width, ABSENT);
        let words = &mut out[from..];
        words[0] = record[0];
        for (here, there) in [
            (self.t, to.t),
            (self.k, to.k),
            (self.sd, to.sd),
            (self.seq, to.seq),
            (self.received, to.received),
            (self.arrival, to.arrival),
        ] {
            if here > 0 {
                words[there] = record[here];
            }
        }
        if to.source > 0 {
            words[to.source] = self.source(record);
        }
        if self.values > 0 {
            let (n, m) = (self.n_values, self.n_inputs);
            words[to.values..to.values + n].copy_from_slice(&record[self.values..self.values + n]);
            let (inputs, there) = (self.values + n, to.values + to.n_values);
            words[there..there + m].copy_from_slice(&record[inputs..inputs + m]);
        }
    }

    /// Appends a packet.
    pub fn push(
        &self,
        target: TargetId,
        time: Option<Stamp>,
        received: Option<Stamp>,
        packet: &Packet,
        out: &mut Vec<u64>,
    ) {
        let from = out.len();
        out.resize(from + self.width, ABSENT);
        let words = &mut out[from..];
        words[0] = head(target, packet.line);
        if let (true, Some(time)) = (self.t > 0, time) {
            words[self.t] = match time {
                Stamp::Seconds(_) => packet.t_s.to_bits(),
                Stamp::Utc { ns, .. } => ns as u64,
            };
        }
        if let (true, Some(k)) = (self.k > 0, packet.k) {
            words[self.k] = k;
        }
        if self.source > 0 {
            words[self.source] = source_word(&packet.content);
        }
        let values = &mut words[self.values..];
        let put = |word: &mut u64, value: Option<f64>| *word = value.map_or(ABSENT, f64::to_bits);
        match &packet.content {
            Content::Position(xyz) => {
                values.iter_mut().zip(xyz).take(self.n_values).for_each(|(word, x)| put(word, *x));
            }
            Content::Linear { z, u } => {
                values.iter_mut().zip(z).take(self.n_values).for_each(|(word, z)| put(word, *z));
                values[self.n_values..].iter_mut().zip(u).take(self.n_inputs).for_each(|(word, u)| put(word, Some(*u)));
            }
            Content::Range { value_m: value, .. }
            | Content::Rssi { value_dbm: value, .. }
            | Content::Tdoa { value_m: value, .. }
            | Content::Bearing { value_rad: value, .. } => put(&mut values[0], Some(*value)),
        }
        if let (true, Some(sd)) = (self.sd > 0, packet.sd) {
            words[self.sd] = sd.to_bits();
        }
        if let (true, Some(seq)) = (self.seq > 0, packet.seq) {
            words[self.seq] = seq;
        }
        if let (true, Some(received)) = (self.received > 0, received) {
            words[self.received] = match received {
                Stamp::Seconds(t_s) => t_s.to_bits(),
                Stamp::Utc { ns, .. } => ns as u64,
            };
        }
        if let (true, Some(arrival)) = (self.arrival > 0, packet.arrival) {
            words[self.arrival] = arrival.to_bits();
        }
    }

    /// Appends a record of a target, a time in seconds and one number or more.
    #[inline]
    pub fn push_plain(&self, target: TargetId, line: u64, t_s: f64, values: &[f64], out: &mut Vec<u64>) {
        debug_assert!(self.is_plain() && values.len() == self.n_values);
        let (head, t) = (head(target, line), t_s.to_bits());
        match values {
            [x] => out.extend_from_slice(&[head, t, x.to_bits()]),
            [x, y] => out.extend_from_slice(&[head, t, x.to_bits(), y.to_bits()]),
            _ => {
                out.extend_from_slice(&[head, t]);
                out.extend(values.iter().map(|x| x.to_bits()));
            }
        }
    }

    /// Whether a record is its head, its time and its values.
    pub fn is_plain(&self) -> bool {
        self.t == 1 && self.width == 2 + self.n_values
    }

    /// Numbers of a plain record.
    pub fn n_values(&self) -> usize {
        self.n_values
    }

    /// The kind of all rows, where there is but one that needs no anchors.
    pub fn kind(&self) -> Option<Kind> {
        self.kind
    }

    /// The source of a record: kind and anchors in their order.
    pub fn source(&self, record: &[u64]) -> u64 {
        match self.source {
            0 => source(self.kind.unwrap_or(Kind::Position), [None; 2]),
            at => record[at],
        }
    }

    /// The kind of a record.
    pub fn kind_of(&self, record: &[u64]) -> Kind {
        let number = (self.source(record) >> 56) as usize;
        KINDS.get(number).copied().unwrap_or(Kind::Position)
    }

    /// The position that a record holds.
    pub fn position(&self, record: &[u64]) -> Option<[Option<f64>; 3]> {
        let value = |i: usize| Some(record[self.values + i]).filter(|bits| *bits != ABSENT).map(f64::from_bits);
        (self.kind_of(record) == Kind::Position)
            .then(|| core::array::from_fn(|i| if i < self.n_values { value(i) } else { None }))
    }

    /// The packet of a record.
    pub fn packet(&self, record: &[u64], clock: &Clock) -> Packet {
        let kind = self.kind_of(record);
        let word = |at: usize| if at == 0 || record[at] == ABSENT { None } else { Some(record[at]) };
        let value = |i: usize| word(self.values + i).map(f64::from_bits);
        let source = self.source(record);
        let anchor = ((source >> 28) & 0xFFF_FFFF).saturating_sub(1) as AnchorId;
        let only = || value(0).unwrap_or(0.0);
        let content = match kind {
            Kind::Position => Content::Position(self.position(record).unwrap_or_default()),
            Kind::Range => Content::Range { anchor, value_m: only() },
            Kind::Rssi => Content::Rssi { anchor, value_dbm: only() },
            Kind::Bearing => Content::Bearing { anchor, value_rad: only() },
            Kind::Tdoa => {
                let reference = (source & 0xFFF_FFFF).saturating_sub(1) as AnchorId;
                Content::Tdoa { anchor, reference, value_m: only() }
            }
            Kind::Linear => Content::Linear {
                z: (0..self.n_values).map(value).collect(),
                u: (self.n_values..self.n_values + self.n_inputs).map(|i| value(i).unwrap_or(0.0)).collect(),
            },
        };
        let k = word(self.k);
        Packet {
            t_s: match word(self.t) {
                Some(bits) => clock.t_s(bits, kind),
                None => k.map_or(0.0, |k| k as f64),
            },
            k,
            content,
            sd: word(self.sd).map(f64::from_bits),
            seq: word(self.seq),
            received_s: word(self.received).map(|bits| clock.received_s(bits)),
            arrival: word(self.arrival).map(f64::from_bits),
            line: line(record),
        }
    }

    /// Orders records of one target: by `k` or by time, then by what measured, then so that of several equal ones the same comes first always.
    pub fn compare(&self, a: &[u64], b: &[u64], by_k: bool, rule: &Rule) -> Ordering {
        let slot = match by_k {
            true => a[self.k].cmp(&b[self.k]),
            false if self.t == 0 => Ordering::Equal,
            false => rule.instant(a[self.t], || self.kind_of(a)).cmp(&rule.instant(b[self.t], || self.kind_of(b))),
        };
        slot.then_with(|| if by_k { Ordering::Equal } else { self.source(a).cmp(&self.source(b)) })
            .then_with(|| rule.date(a, self.received).cmp(&rule.date(b, self.received)))
            .then_with(|| number(a, self.seq).cmp(&number(b, self.seq)))
            .then_with(|| line(a).cmp(&line(b)))
    }
}

/// `seq` of a record, none before any.
fn number(record: &[u64], at: usize) -> Option<u64> {
    if at == 0 || record[at] == ABSENT { None } else { Some(record[at]) }
}

fn head(target: TargetId, line: u64) -> u64 {
    u64::from(target) << LINE_BITS | line
}

/// The target of a record.
#[inline]
pub(crate) fn target(record: &[u64]) -> TargetId {
    (record[0] >> LINE_BITS) as TargetId
}

/// The line of a record.
#[inline]
pub(crate) fn line(record: &[u64]) -> u64 {
    record[0] & (MOST_LINES - 1)
}

/// Kinds by number.
const KINDS: [Kind; 6] = [Kind::Position, Kind::Range, Kind::Rssi, Kind::Tdoa, Kind::Bearing, Kind::Linear];

fn source(kind: Kind, anchors: [Option<AnchorId>; 2]) -> u64 {
    let number = kind as u64;
    let [a, b] = anchors.map(|a| a.map_or(0, |a| u64::from(a) + 1));
    number << 56 | a << 28 | b
}

fn source_word(content: &Content) -> u64 {
    source(content.kind(), content.anchors())
}

/// Bits of an f64 in an order that whole numbers have.
#[inline]
fn in_order(bits: u64) -> u64 {
    bits ^ (((bits as i64 >> 63) as u64) | 1 << 63)
}

/// How the times of records are ordered.
#[derive(Clone, Debug, Default)]
pub(crate) struct Rule {
    /// Whether times are dates.
    pub dates: bool,
    /// How late the dates of each kind are, nanoseconds.
    pub latency_ns: [i64; KINDS.len()],
}

impl Rule {
    /// A time as a number in its order.
    #[inline]
    pub fn instant(&self, bits: u64, kind: impl Fn() -> Kind) -> u64 {
        if !self.dates {
            return in_order(bits);
        }
        (bits as i64).saturating_sub(self.latency_ns[kind() as usize]) as u64 ^ 1 << 63
    }

    fn date(&self, record: &[u64], at: usize) -> u64 {
        match number(record, at) {
            None => u64::MAX,
            Some(bits) if self.dates => bits ^ 1 << 63,
            Some(bits) => in_order(bits),
        }
    }
}

/// How late times of each kind are, in the order of [`Rule::latency_ns`].
pub(crate) fn latencies_ns(of: impl Fn(Kind) -> f64) -> [i64; KINDS.len()] {
    KINDS.map(|kind| (of(kind) * 1e9).round() as i64)
}

/// Turns the times of records into seconds.
#[derive(Clone, Debug, Default)]
pub(crate) struct Clock {
    /// Second 0 of dates, since 1970; `None` where times are seconds.
    pub epoch_unix_s: Option<i64>,
    /// How late the dates of each kind are, seconds.
    pub latency_s: [f64; KINDS.len()],
}

impl Clock {
    #[inline]
    fn t_s(&self, bits: u64, kind: Kind) -> f64 {
        match self.epoch_unix_s {
            None => f64::from_bits(bits),
            Some(epoch) => time::seconds_since(bits as i64, epoch) - self.latency_s[kind as usize],
        }
    }

    fn received_s(&self, bits: u64) -> f64 {
        match self.epoch_unix_s {
            None => f64::from_bits(bits),
            Some(epoch) => time::seconds_since(bits as i64, epoch),
        }
    }

    /// How late the dates of each kind are.
    pub fn latencies(of: impl Fn(Kind) -> f64) -> [f64; KINDS.len()] {
        KINDS.map(of)
    }
}
