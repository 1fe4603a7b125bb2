//! Work on a stream of pieces side by side, its results in the order of the pieces.

use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Mutex, PoisonError};
use std::thread;

/// Pieces under way for each thread.
const AHEAD: usize = 2;

/// Calls `take` with what `work` makes of every piece that `next` hands out, in their order. `worker` makes what a thread keeps from one piece
/// to the next.
///
/// `next` and `take` run on this thread, `work` on `threads` others (on this one where there is but one); a thread that is free takes the next
/// piece. Never more than `AHEAD` pieces a thread are under way: memory does not grow with the number of pieces. Results do not depend on
/// `threads` where `work` does not look at what it keeps.
///
/// # Errors
/// The first error of `next` or `take`; what is under way then is dropped.
///
/// # Panics
/// Where `work` does.
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
    let (give, pieces) = channel::<(usize, I)>();
    let (hand_back, results) = channel::<(usize, thread::Result<O>)>();
    let pieces = Mutex::new(pieces);
    thread::scope(|scope| {
        let (work, pieces) = (&work, &pieces);
        for _ in 0..threads {
            let (hand_back, mut kept) = (hand_back.clone(), worker());
            scope.spawn(move || {
                while let Some((place, piece)) = wait(pieces) {
                    let result = catch_unwind(AssertUnwindSafe(|| work(&mut kept, piece)));
                    let has_panicked = result.is_err();
                    if hand_back.send((place, result)).is_err() || has_panicked {
                        break;
                    }
                }
            });
        }
        // Dropped at the end, which ends the threads.
        let give = give;
        let (mut sent, mut taken, mut is_over) = (0, 0, false);
        // Results that came before their turn: the first is that of piece `taken`.
        let mut early: VecDeque<Option<O>> = VecDeque::new();
        loop {
            while !is_over && sent - taken < AHEAD * threads {
                match next()? {
                    // The threads last as long as their results are waited for.
                    Some(piece) => is_over = give.send((sent, piece)).is_err(),
                    None => is_over = true,
                }
                if !is_over {
                    sent += 1;
                    early.push_back(None);
                }
            }
            if taken == sent {
                return Ok(());
            }
            while early.front().is_some_and(Option::is_none) {
                let Ok((place, result)) = results.recv() else { return Ok(()) };
                early[place - taken] = Some(result.unwrap_or_else(|panic| resume_unwind(panic)));
            }
            if let Some(result) = early.pop_front().flatten() {
                taken += 1;
                take(result)?;
            }
        }
    })
}

/// The next piece, once there is one; `None` when there will be no more.
fn wait<I>(pieces: &Mutex<Receiver<(usize, I)>>) -> Option<(usize, I)> {
    pieces.lock().unwrap_or_else(PoisonError::into_inner).recv().ok()
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
    fn a_panic_in_the_work_is_passed_on() {
        let mut n = 0;
        let next = || {
            n += 1;
            Ok::<_, String>((n < 100).then_some(n))
        };
        let work = |(): &mut (), n: u64| assert_ne!(n, 50, "piece 50");
        let caught = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            super::ordered(2, || (), next, work, |()| Ok(()))
        }));
        assert!(caught.unwrap_err().downcast_ref::<String>().is_some_and(|text| text.contains("piece 50")));
    }

    #[test]
    fn the_first_error_ends_the_work() {
        for threads in [1, 2, 3] {
            assert_eq!(squares(threads, Some(500)).unwrap_err(), "stopped at 500");
        }
    }
}
