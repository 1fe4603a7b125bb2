//! Values that are the same, bit for bit, as the ones before: what a receiver shows again.

use crate::packet::{Content, Packet, Source};

/// The values last seen: of each source where packets carry their time, of the receiver as a whole where they do not.
#[derive(Clone, Debug, Default)]
pub(super) struct Repeats {
    last: Vec<(Option<Source>, Vec<u64>)>,
    scratch: Vec<u64>,
}

impl Repeats {
    /// Whether `packets` say what was last said by `source`, and remembers what they say. Packets without a value are no news.
    pub(super) fn again(&mut self, source: Option<Source>, packets: &[Packet]) -> bool {
        self.scratch.clear();
        packets.iter().for_each(|p| bits(&p.content, &mut self.scratch));
        if self.scratch.is_empty() {
            return false;
        }
        match self.last.iter_mut().find(|(of, _)| *of == source) {
            Some((_, last)) if *last == self.scratch => true,
            Some((_, last)) => {
                last.clone_from(&self.scratch);
                false
            }
            None => {
                self.last.push((source, self.scratch.clone()));
                false
            }
        }
    }
}

fn bits(content: &Content, out: &mut Vec<u64>) {
    if content.values().any(|value| value.is_some()) {
        out.extend(content.values().map(|value| value.unwrap_or(f64::NAN).to_bits()));
    }
}
