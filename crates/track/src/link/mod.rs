//! The link: what arrived becomes what a filter may believe, one step per instant.
//!
//! [`Order`] puts late packets into their place while their instant can still change, [`Reader`] numbers the instants, fills the gaps of a
//! linear run with lost steps and decides what is new: by sequence numbers, by repeated values, or by a probability.

mod order;
mod reader;
mod repeats;
mod sequence;

pub use order::{Order, Slot};
pub use reader::Reader;

use crate::packet::Packet;
use crate::spec::{LinkSpec, Receiver};
use crate::tracker::Step;

/// What a link did with its packets.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LinkReport {
    /// Packets that came so late that their instant was settled; they were not used.
    pub too_late: u64,
    /// Row of the first of them.
    pub first_too_late: Option<u64>,
    /// Further copies of a packet that had come already.
    pub copies: u64,
    /// Values that repeat the one before and counted as lost.
    pub repeats: u64,
    /// Values that are old by their sequence numbers and counted as lost.
    pub stale: u64,
    /// The arrival rate learnt on line, where the spec asks for it.
    pub arrival: Option<f64>,
}

/// An arrival rate that was learnt.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Learnt {
    /// The mean of its posterior.
    pub rate: f64,
    /// The standard deviation of its posterior.
    pub sd: f64,
    /// Values that it was learnt from.
    pub values: f64,
    /// Whether by values that repeat; by losses that are seen otherwise.
    pub by_repeats: bool,
}

/// One target's link.
#[derive(Clone, Debug)]
pub struct Link {
    order: Order,
    reader: Reader,
}

impl Link {
    /// A link before its first packet. `has_prior`: whether a link without time stamps starts from x̂_{0|0}, whose value is used already.
    pub fn new(spec: &LinkSpec, has_prior: bool) -> Link {
        let late_s = match spec.receiver {
            Receiver::Stamped { late_s } => late_s.unwrap_or(0.0),
            Receiver::Unstamped { .. } => 0.0,
        };
        Link { order: Order::new(late_s), reader: Reader::new(spec, has_prior) }
    }

    /// Takes one packet; hands on the steps that nothing can change any more.
    ///
    /// # Errors
    /// Whatever `hand_on` returns.
    pub fn push<E>(&mut self, packet: Packet, mut hand_on: impl FnMut(&Step<'_>) -> Result<(), E>) -> Result<(), E> {
        self.order.insert(packet);
        while let Some(slot) = self.order.settled() {
            let read = self.reader.read(&slot, &mut hand_on);
            self.order.recycle(slot);
            read?;
        }
        Ok(())
    }

    /// Hands on everything that still waits.
    ///
    /// # Errors
    /// Whatever `hand_on` returns.
    pub fn flush<E>(&mut self, mut hand_on: impl FnMut(&Step<'_>) -> Result<(), E>) -> Result<(), E> {
        while let Some(slot) = self.order.oldest() {
            let read = self.reader.read(&slot, &mut hand_on);
            self.order.recycle(slot);
            read?;
        }
        Ok(())
    }

    /// Instants that a late packet can still change, oldest first.
    pub fn waiting(&self) -> impl ExactSizeIterator<Item = &Slot> {
        self.order.waiting()
    }

    /// How the instants that wait will be read.
    pub fn reader(&self) -> &Reader {
        &self.reader
    }

    /// The arrival rate as far as it is learnt; `None` where the spec gives it, or nothing asks for it.
    pub fn learnt(&self) -> Option<Learnt> {
        self.reader.learnt()
    }

    /// What the link did so far.
    pub fn report(&self) -> LinkReport {
        let mut report = self.reader.report();
        self.order.report_to(&mut report);
        report
    }
}
