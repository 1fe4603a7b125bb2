//! Instants become steps: numbered, without gaps, and with what is new in them.

use super::repeats::Repeats;
use super::sequence::Sequence;
use super::{Learnt, LinkReport, Slot};
use crate::packet::Packet;
use crate::spec::{ArrivalSpec, Duplicates, Hold, LinkSpec, Receiver};
use crate::tracker::Step;
use fixtrail_core::arrival::{Counted, Repeated};

/// Two sequence numbers this far apart have not lost what lies between: the counter began anew.
const RESTART: u64 = 1000;

/// What tells how often something arrives.
#[derive(Clone, Debug)]
enum Rate {
    /// The spec does.
    Given,
    /// Losses that are seen.
    Counted(Counted),
    /// Values that repeat.
    Repeated(Box<Repeated>),
}

/// How instants are read.
#[derive(Clone, Debug)]
pub struct Reader {
    spec: LinkSpec,
    has_prior: bool,
    next_k: u64,
    repeats: Repeats,
    /// Packets of an instant that are new, where not all are.
    new: Vec<Packet>,
    /// Sequence numbers of a link without time stamps.
    sequence: Option<Sequence>,
    /// Newest sequence number of a link with time stamps, and the instants since that are known to be lost.
    newest: Option<u64>,
    gap: u64,
    /// The last probability that a column gave.
    column: f64,
    rate: Rate,
    repeated: u64,
    stale: u64,
}

impl Reader {
    pub(super) fn new(spec: &LinkSpec, has_prior: bool) -> Reader {
        let rate = match (&spec.arrival, spec.receiver) {
            (None, Receiver::Stamped { .. }) => Rate::Given,
            (None | Some(ArrivalSpec::Estimate), Receiver::Unstamped { hold }) => {
                Rate::Repeated(Box::new(Repeated::start(hold)))
            }
            (Some(ArrivalSpec::Estimate), Receiver::Stamped { .. }) => Rate::Counted(Counted::default()),
            (Some(_), _) => Rate::Given,
        };
        Reader {
            spec: spec.clone(),
            has_prior,
            next_k: 0,
            repeats: Repeats::default(),
            new: Vec::new(),
            sequence: None,
            newest: None,
            gap: 0,
            column: 1.0,
            rate,
            repeated: 0,
            stale: 0,
        }
    }

    /// Number of the next instant.
    pub fn next_k(&self) -> u64 {
        self.next_k
    }

    /// Hands on the step of an instant, after the lost steps of the gap before it.
    ///
    /// # Errors
    /// Whatever `hand_on` returns.
    pub fn read<E>(&mut self, slot: &Slot, mut hand_on: impl FnMut(&Step<'_>) -> Result<(), E>) -> Result<(), E> {
        self.skip_to(slot.k.unwrap_or(self.next_k), &mut hand_on)?;
        let packets = slot.packets.as_slice();
        match self.spec.receiver {
            Receiver::Stamped { .. } => self.read_stamped(slot.t_s, packets, hand_on),
            Receiver::Unstamped { .. } => self.read_held(slot.t_s, packets, hand_on),
        }
    }

    /// Hands on lost steps up to, but not including, instant `k`.
    ///
    /// # Errors
    /// Whatever `hand_on` returns.
    pub fn skip_to<E>(&mut self, k: u64, mut hand_on: impl FnMut(&Step<'_>) -> Result<(), E>) -> Result<(), E> {
        while self.next_k < k {
            if let Rate::Counted(counted) = &mut self.rate {
                counted.count(0, 1);
                self.gap += 1;
            }
            let arrival = self.given();
            hand_on(&Step { k: self.next_k, t_s: None, packets: &[], held: &[], arrival })?;
            self.next_k += 1;
        }
        Ok(())
    }

    fn read_stamped<E>(
        &mut self,
        t_s: f64,
        packets: &[Packet],
        mut hand_on: impl FnMut(&Step<'_>) -> Result<(), E>,
    ) -> Result<(), E> {
        self.count_stamped(packets);
        let mut step = Step { k: self.next_k, t_s: Some(t_s), packets, held: packets, arrival: 1.0 };
        if self.spec.duplicates == Duplicates::Detect {
            let mut all_new = true;
            self.new.clear();
            for (i, packet) in packets.iter().enumerate() {
                match self.repeats.again(Some(packet.source()), std::slice::from_ref(packet)) {
                    true if all_new => {
                        self.repeated += 1;
                        self.new.extend_from_slice(&packets[..i]);
                        all_new = false;
                    }
                    true => self.repeated += 1,
                    false if all_new => {}
                    false => self.new.push(packet.clone()),
                }
            }
            step.packets = if all_new { packets } else { &self.new };
        }
        hand_on(&step)?;
        self.next_k += 1;
        Ok(())
    }

    /// Learns the arrival rate from sequence numbers, or from the rows of a linear run.
    fn count_stamped(&mut self, packets: &[Packet]) {
        let Rate::Counted(counted) = &mut self.rate else { return };
        let heard = packets.iter().any(has_value);
        let missing = match (newest_number(packets), self.newest) {
            (Some(now), Some(before)) if now > before && now - before < RESTART => now - before - 1,
            _ => 0,
        };
        // Rows that are missing from a run are counted already.
        counted.count(u64::from(heard), missing.saturating_sub(self.gap) + u64::from(!heard));
        match newest_number(packets) {
            None if !heard => self.gap += 1,
            number => (self.newest, self.gap) = (number.or(self.newest), 0),
        }
    }

    fn read_held<E>(
        &mut self,
        t_s: f64,
        packets: &[Packet],
        mut hand_on: impl FnMut(&Step<'_>) -> Result<(), E>,
    ) -> Result<(), E> {
        let k = self.next_k;
        let is_start = k == 0 && self.has_prior;
        let heard = packets.iter().any(has_value);
        self.column = packets.iter().find_map(|p| p.arrival).unwrap_or(self.column);
        let mut arrival = self.given();
        let mut is_new = heard && !is_start;
        let again = self.repeats.again(None, packets);
        if let Some(fresh) = self.by_sequence(k, packets) {
            self.stale += u64::from(!fresh);
            is_new &= fresh;
            if fresh {
                arrival = 1.0;
            }
        } else {
            if let (Rate::Repeated(repeated), true) = (&mut self.rate, heard && k > 0) {
                repeated.observe(again);
            }
            match (self.spec.duplicates, self.spec.receiver) {
                (Duplicates::Detect, _) if again => {
                    self.repeated += 1;
                    is_new = false;
                }
                // What is shown for ever until something comes changes only when something comes.
                (Duplicates::Detect, Receiver::Unstamped { hold: Hold::LastReceived }) if heard => arrival = 1.0,
                _ => {}
            }
        }
        let packets_new = if is_new { packets } else { &[] };
        hand_on(&Step { k, t_s: Some(t_s), packets: packets_new, held: packets, arrival })?;
        self.next_k += 1;
        Ok(())
    }

    /// Whether the value at instant `k` was sensed there, where sequence numbers tell.
    fn by_sequence(&mut self, k: u64, packets: &[Packet]) -> Option<bool> {
        let number = newest_number(packets)?;
        let fresh = self.sequence.get_or_insert(Sequence::start(k, number)).is_new(k, number);
        if let Rate::Repeated(_) = self.rate {
            self.rate = Rate::Counted(Counted::default());
        }
        if let (Rate::Counted(counted), true) = (&mut self.rate, k > 0) {
            counted.count(u64::from(fresh), u64::from(!fresh));
        }
        Some(fresh)
    }

    /// p_k by the spec, or as far as it is learnt before this instant.
    fn given(&self) -> f64 {
        if self.next_k == 0 {
            return 1.0;
        }
        match (&self.spec.arrival, &self.rate) {
            (Some(ArrivalSpec::Constant(p)), _) => *p,
            (Some(ArrivalSpec::List(list)), _) => {
                let last = list.len() - 1;
                list[usize::try_from(self.next_k).map_or(last, |k| k.min(last))]
            }
            (Some(ArrivalSpec::Column(_)), _) => self.column,
            (_, Rate::Counted(counted)) => counted.mean(),
            (_, Rate::Repeated(repeated)) => repeated.mean(),
            (_, Rate::Given) => 1.0,
        }
    }

    pub(super) fn learnt(&self) -> Option<Learnt> {
        Some(match &self.rate {
            Rate::Given => return None,
            Rate::Counted(c) => Learnt { rate: c.mean(), sd: c.sd(), values: c.total(), by_repeats: false },
            Rate::Repeated(r) => Learnt { rate: r.mean(), sd: r.sd(), values: r.total(), by_repeats: true },
        })
    }

    pub(super) fn report(&self) -> LinkReport {
        let arrival = self.learnt().map(|l| l.rate);
        LinkReport { repeats: self.repeated, stale: self.stale, arrival, ..LinkReport::default() }
    }
}

fn has_value(packet: &Packet) -> bool {
    packet.content.values().any(|value| value.is_some())
}

fn newest_number(packets: &[Packet]) -> Option<u64> {
    packets.iter().filter_map(|p| p.seq).max()
}
