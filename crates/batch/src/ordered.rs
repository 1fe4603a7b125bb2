//! Work on a stream of pieces side by side, its results in the order of the pieces.

use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;

/// Pieces that a thread may have waiting.
const AHEAD: usize = 2;

/// Calls `take` with what `work` makes of every piece that `next` hands out, in their order. `worker` makes what a thread keeps from one piece
/// to the next.
///
/// `next` and `take` run on this thread, `work` on `threads` others (on this one where there is but one). Never more than
/// `AHEAD` pieces a thread are under way: memory does not grow with the number of pieces. Results do not depend on `threads` where `work` does
/// not look at what it keeps.
///
/// # Errors
/// The first error of `next` or `take`; what is under way then is dropped.
pub(crate) fn ordered<W, I, O, E>(
    threads: usize,
    worker: impl Fn() -> W,
    mut next: impl FnMut() -> Result<Option<I>, E>,
    work: impl Fn(&mut W, I) -> O + Sync,
    mut take: impl FnMut(O) -> Result<(), E>,
) -> Result<(), E>
where
    W: Send,
    I: Send,
    O: Send,
{
    if threads <= 1 {
        let mut kept = worker();
        while let Some(piece) = next()? {
            take(work(&mut kept, piece))?;
        }
        return Ok(());
    }
    thread::scope(|scope| {
        let work = &work;
        let lanes: Vec<(SyncSender<I>, Receiver<O>)> = (0..threads)
            .map(|_| {
                let (give, pieces) = sync_channel::<I>(AHEAD);
                let (hand_back, results) = sync_channel::<O>(AHEAD);
                let mut kept = worker();
                scope.spawn(move || {
                    for piece in pieces {
                        if hand_back.send(work(&mut kept, piece)).is_err() {
                            break;
                        }
                    }
                });
                (give, results)
            })
            .collect();
        let (mut sent, mut taken, mut is_over) = (0, 0, false);
        loop {
            while !is_over && sent - taken < AHEAD * threads {
                let Some(piece) = next()? else {
                    is_over = true;
                    break;
                };
                // A thread that is gone has panicked; the scope passes that on.
                is_over = lanes[sent % threads].0.send(piece).is_err();
                sent += usize::from(!is_over);
            }
            if taken == sent {
                return Ok(());
            }
            let Ok(result) = lanes[taken % threads].1.recv() else { return Ok(()) };
            taken += 1;
            take(result)?;
        }
    })
}

#[cfg(test)]
mod tests {
    use super::ordered;

    fn squares(threads: usize, stop: Option<u64>) -> Result<Vec<u64>, String> {
        let (mut n, mut out) = (0_u64, Vec::new());
        let next = || {
            n += 1;
            Ok((n <= 1000).then_some(n))
        };
        let work = |seen: &mut u64, n: u64| {
            *seen += 1;
            // Some pieces take longer than those that follow.
            (0..(n % 7) * 500).fold(n * n, |a, b| std::hint::black_box(a ^ b ^ b))
        };
        let take = |square| match stop {
            Some(at) if square == at * at => Err(format!("stopped at {at}")),
            _ => {
                out.push(square);
                Ok(())
            }
        };
        ordered(threads, || 0, next, work, take)?;
        Ok(out)
    }

    #[test]
    fn results_come_in_the_order_of_the_pieces() {
        let expected: Vec<u64> = (1..=1000).map(|n| n * n).collect();
        for threads in [1, 2, 3, 8] {
            assert_eq!(squares(threads, None).unwrap(), expected);
        }
    }

    #[test]
    fn the_first_error_ends_the_work() {
        for threads in [1, 2, 3] {
            assert_eq!(squares(threads, Some(500)).unwrap_err(), "stopped at 500");
        }
    }
}
