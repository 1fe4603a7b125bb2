//! The replay of a recorded link.

use super::{Arrivals, Channel, DesignError, checked_delay};
use fixtrail_track::trace::TracePacket;
use rand::Rng;
use std::sync::Arc;

/// Does to each packet what a real link did to the packet of the same number, from the beginning again after the end.
///
/// Nothing is random: the `rng` is left as it is. Further copies arrive together with the first, as a trace tells only how many
/// there were; those beyond [`Arrivals::CAPACITY`] are left out.
#[derive(Clone, Debug, PartialEq)]
pub struct Trace {
    packets: Arc<[TracePacket]>,
    next: usize,
}

impl Trace {
    /// A channel that replays `packets` from number `start` on, counted from 0.
    ///
    /// # Errors
    /// [`DesignError::TraceStart`] when there is no such packet; [`DesignError::TraceDelay`] when a packet arrived before it was
    /// sent or later than 1e12 s; [`DesignError::TraceCopies`] when one arrived in no copy.
    pub fn new(packets: Arc<[TracePacket]>, start: usize) -> Result<Trace, DesignError> {
        if start >= packets.len() {
            return Err(DesignError::TraceStart { value: start, packets: packets.len() });
        }
        for (packet, p) in packets.iter().enumerate().filter(|(_, p)| p.received) {
            if checked_delay(p.delay_s).is_none() {
                return Err(DesignError::TraceDelay { packet, value: p.delay_s });
            }
            if p.copies == 0 {
                return Err(DesignError::TraceCopies { packet });
            }
        }
        Ok(Trace { packets, next: start })
    }

    /// The same trace from the beginning of its `part`-th of `parts` equal parts on.
    pub(super) fn starting_at_part(&self, part: usize, parts: usize) -> Trace {
        let len = self.packets.len();
        Trace { packets: self.packets.clone(), next: part % parts * len / parts % len }
    }
}

impl Channel for Trace {
    fn transmit(&mut self, _: &mut dyn Rng) -> Arrivals {
        let packet = self.packets[self.next];
        self.next = (self.next + 1) % self.packets.len();
        let copies = if packet.received { packet.copies as usize } else { 0 };
        (0..copies.min(Arrivals::CAPACITY)).fold(Arrivals::lost(), |arrivals, _| arrivals.and(packet.delay_s))
    }
}
