//! Sequence numbers where packets carry no time: whether a value was sensed at the instant at which it is shown.

/// Packets overtake one another by no more than this many numbers and instants. What is lower by more, or for longer, was numbered by a
/// counter that began anew.
const MISORDER: u64 = 100;

/// The numbers shown so far.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sequence {
    highest: u64,
    /// How far the numbers of new values are ahead of the instants: the most so far.
    ahead: i128,
    /// Since when, while nothing was new, numbers may be those of a counter that began anew, and how far they are ahead.
    anew: Option<(u64, i128)>,
}

impl Sequence {
    /// The first number, which is taken for that of a new value.
    pub(super) fn start(k: u64, number: u64) -> Sequence {
        Sequence { highest: number, ahead: i128::from(number) - i128::from(k), anew: None }
    }

    /// Whether the value with this number, shown at instant `k`, is new: the number is as far ahead of k as any before of its counter.
    pub(super) fn is_new(&mut self, k: u64, number: u64) -> bool {
        let first = Sequence::start(k, number);
        let behind = self.highest.saturating_sub(number);
        if first.ahead >= self.ahead || behind > MISORDER {
            *self = first;
            return true;
        }
        if let Some((since, ahead)) = &mut self.anew {
            *ahead = first.ahead.max(*ahead);
            if k - *since > MISORDER {
                let ahead = *ahead;
                *self = Sequence { ahead, ..first };
                return first.ahead == ahead;
            }
        } else if behind > 0 {
            self.anew = Some((k, first.ahead));
        }
        self.highest = self.highest.max(number);
        false
    }
}
