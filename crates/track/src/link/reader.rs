//! Instants become steps: numbered, without gaps, and with what is new in them.

use super::repeats::Repeats;
use super::{LinkReport, Slot};
use crate::packet::{Content, Packet};
use crate::spec::{ArrivalSpec, Duplicates, LinkSpec, Receiver};
use crate::tracker::Step;
use fixtrail_core::arrival::{Counted, Repeated};

/// A sequence number this far behind the newest belongs to a counter that began anew.
const RESTART: i128 = 1000;

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
    /// Newest sequence number, less the number of the instant where there are no time stamps.
    sequence: Option<i128>,
    arrival: f64,
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
            arrival: 1.0,
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
            }
            let arrival = self.given(&[]);
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
            self.new.clear();
            for packet in packets {
                match self.repeats.again(Some(packet.source()), std::slice::from_ref(packet)) {
                    true => self.repeated += 1,
                    false => self.new.push(packet.clone()),
                }
            }
            step.packets = &self.new;
        }
        hand_on(&step)?;
        self.next_k += 1;
        Ok(())
    }

    /// Learns the arrival rate from sequence numbers, or from the rows of a linear run.
    fn count_stamped(&mut self, packets: &[Packet]) {
        let Rate::Counted(counted) = &mut self.rate else { return };
        let heard = packets.iter().any(has_value);
        let number = packets.iter().filter_map(|p| p.seq).max().map(i128::from);
        let missing = match (number, self.sequence) {
            (Some(now), Some(before)) if (1..RESTART).contains(&(now - before)) => now - before - 1,
            _ => 0,
        };
        self.sequence = number.or(self.sequence);
        counted.count(u64::from(heard), missing as u64 + u64::from(!heard));
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
        let mut arrival = self.given(packets);
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
            if again && self.spec.duplicates == Duplicates::Detect {
                self.repeated += 1;
                is_new = false;
            }
        }
        self.arrival = arrival;
        let packets_new = if is_new { packets } else { &[] };
        hand_on(&Step { k, t_s: Some(t_s), packets: packets_new, held: packets, arrival })?;
        self.next_k += 1;
        Ok(())
    }

    /// Whether the value at instant `k` was sensed there, where sequence numbers tell: the newest value is as far ahead of k as any before.
    fn by_sequence(&mut self, k: u64, packets: &[Packet]) -> Option<bool> {
        let number = packets.iter().filter_map(|p| p.seq).max()?;
        let ahead = i128::from(number) - i128::from(k);
        let newest = self.sequence.unwrap_or(ahead);
        let fresh = ahead >= newest || ahead < newest - RESTART;
        self.sequence = Some(if fresh { ahead } else { newest });
        if let Rate::Repeated(_) = self.rate {
            self.rate = Rate::Counted(Counted::default());
        }
        if let (Rate::Counted(counted), true) = (&mut self.rate, k > 0) {
            counted.count(u64::from(fresh), u64::from(!fresh));
        }
        Some(fresh)
    }

    /// p_k by the spec, or as far as it is learnt before this instant.
    fn given(&self, packets: &[Packet]) -> f64 {
        if self.next_k == 0 {
            return 1.0;
        }
        match (&self.spec.arrival, &self.rate) {
            (Some(ArrivalSpec::Constant(p)), _) => *p,
            (Some(ArrivalSpec::List(list)), _) => {
                let last = list.len() - 1;
                list[usize::try_from(self.next_k).map_or(last, |k| k.min(last))]
            }
            (Some(ArrivalSpec::Column(_)), _) => packets.iter().find_map(|p| p.arrival).unwrap_or(self.arrival),
            (_, Rate::Counted(counted)) => counted.mean(),
            (_, Rate::Repeated(repeated)) => repeated.mean(),
            (_, Rate::Given) => 1.0,
        }
    }

    pub(super) fn report(&self) -> LinkReport {
        let arrival = match &self.rate {
            Rate::Given => None,
            Rate::Counted(counted) => Some(counted.mean()),
            Rate::Repeated(repeated) => Some(repeated.mean()),
        };
        LinkReport { repeats: self.repeated, stale: self.stale, arrival, ..LinkReport::default() }
    }
}

fn has_value(packet: &Packet) -> bool {
    match &packet.content {
        Content::Linear { z, .. } => z.iter().any(Option::is_some),
        _ => true,
    }
}
