//! Instants in the order of time while late packets can still join them.

use super::LinkReport;
use crate::packet::{Content, Packet};
use std::collections::VecDeque;

/// Times are differences of decimal numbers: a packet counts as late by more than a nanosecond only.
const SLACK_S: f64 = 1e-9;

/// One instant and what arrived of it, in canonical order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Slot {
    /// The instant, seconds.
    pub t_s: f64,
    /// Its time index in a linear run.
    pub k: Option<u64>,
    /// Packets in the order of [`Packet::source`]: the order in which they came never reaches the filter.
    pub packets: Vec<Packet>,
}

/// The instants that a packet at most `late_s` late can still change. Memory: as many instants as fit into `late_s`.
#[derive(Clone, Debug)]
pub struct Order {
    late_s: f64,
    newest_s: f64,
    slots: VecDeque<Slot>,
    spare: Vec<Vec<Packet>>,
    too_late: u64,
    first_too_late: Option<u64>,
    copies: u64,
}

impl Order {
    /// Before the first packet.
    pub(super) fn new(late_s: f64) -> Order {
        Order {
            late_s,
            newest_s: f64::NEG_INFINITY,
            slots: VecDeque::new(),
            spare: Vec::new(),
            too_late: 0,
            first_too_late: None,
            copies: 0,
        }
    }

    fn is_settled(&self, t_s: f64) -> bool {
        self.newest_s - t_s > self.late_s + SLACK_S
    }

    /// Puts a packet into its instant, or drops and counts it.
    pub(super) fn insert(&mut self, packet: Packet) {
        if self.is_settled(packet.t_s) {
            self.too_late += 1;
            self.first_too_late.get_or_insert(packet.line);
            return;
        }
        self.newest_s = self.newest_s.max(packet.t_s);
        let after = self.slots.iter().rposition(|slot| slot.t_s <= packet.t_s);
        let at = after.filter(|i| joins(&self.slots[*i], &packet));
        let Some(at) = at else {
            let mut packets = self.spare.pop().unwrap_or_default();
            let (t_s, k) = (packet.t_s, packet.k);
            packets.push(packet);
            self.slots.insert(after.map_or(0, |i| i + 1), Slot { t_s, k, packets });
            return;
        };
        let packets = &mut self.slots[at].packets;
        match packets.binary_search_by(|p| p.source().cmp(&packet.source())) {
            Ok(_) => self.copies += 1,
            Err(place) => packets.insert(place, packet),
        }
    }

    /// The oldest instant, if nothing can change it any more.
    pub(super) fn settled(&mut self) -> Option<Slot> {
        self.slots.front().is_some_and(|slot| self.is_settled(slot.t_s)).then(|| self.slots.pop_front())?
    }

    /// The oldest instant.
    pub(super) fn oldest(&mut self) -> Option<Slot> {
        self.slots.pop_front()
    }

    /// Takes the room of an instant back.
    pub(super) fn recycle(&mut self, slot: Slot) {
        let mut packets = slot.packets;
        packets.clear();
        self.spare.push(packets);
    }

    pub(super) fn waiting(&self) -> impl ExactSizeIterator<Item = &Slot> {
        self.slots.iter()
    }

    pub(super) fn report_to(&self, report: &mut LinkReport) {
        report.too_late = self.too_late;
        report.first_too_late = self.first_too_late;
        report.copies = self.copies;
    }
}

fn joins(slot: &Slot, packet: &Packet) -> bool {
    slot.t_s == packet.t_s && (!matches!(packet.content, Content::Linear { .. }) || slot.k == packet.k)
}
