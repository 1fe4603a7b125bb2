//! The stamped link: packets that carry their time become steps, one per instant.

use crate::packet::{Content, Packet};
use crate::tracker::Step;

/// Groups the packets of one target into steps and fills the gaps of a linear run with lost ones.
///
/// Packets come in order of time (a table is sorted before); those of one instant in canonical order, so that the order of a file's
/// rows never reaches the filter.
#[derive(Debug, Default)]
pub struct Link {
    next_k: u64,
    waiting: Vec<Packet>,
}

impl Link {
    /// Takes one packet; hands on the steps that it completes.
    ///
    /// # Errors
    /// Whatever `hand_on` returns.
    pub fn push<E>(&mut self, packet: Packet, mut hand_on: impl FnMut(&Step<'_>) -> Result<(), E>) -> Result<(), E> {
        let same = self.waiting.first().is_some_and(|w| same_instant(w, &packet));
        if !same {
            self.flush(&mut hand_on)?;
            if let Some(k) = packet.k {
                while self.next_k < k {
                    hand_on(&Step { k: self.next_k, t_s: None, packets: &[] })?;
                    self.next_k += 1;
                }
            }
        }
        self.waiting.push(packet);
        Ok(())
    }

    /// Hands on the step that is still waiting.
    ///
    /// # Errors
    /// Whatever `hand_on` returns.
    pub fn flush<E>(&mut self, mut hand_on: impl FnMut(&Step<'_>) -> Result<(), E>) -> Result<(), E> {
        let Some(first) = self.waiting.first() else { return Ok(()) };
        let step = Step { k: self.next_k, t_s: Some(first.t_s), packets: &self.waiting };
        hand_on(&step)?;
        self.next_k += 1;
        self.waiting.clear();
        Ok(())
    }
}

fn same_instant(a: &Packet, b: &Packet) -> bool {
    match (&a.content, &b.content) {
        (Content::Linear { .. }, Content::Linear { .. }) => a.k == b.k && a.t_s == b.t_s,
        _ => a.t_s == b.t_s,
    }
}
