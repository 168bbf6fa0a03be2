//! Parallelism as an argument: the core never makes a thread.

use std::sync::Mutex;

/// Runs independent pieces of one frame's work.
pub trait ForkJoin {
    /// Threads there are, the caller's included; work is cut into about that many pieces.
    fn threads(&self) -> usize;

    /// Calls `piece(0)` to `piece(n - 1)`, in any order and on any thread, and returns when all are done.
    fn run(&self, n: usize, piece: &(dyn Fn(usize) + Sync));
}

/// Everything on the calling thread.
#[derive(Debug, Clone, Copy, Default)]
pub struct Serial;

impl ForkJoin for Serial {
    fn threads(&self) -> usize {
        1
    }

    fn run(&self, n: usize, piece: &(dyn Fn(usize) + Sync)) {
        (0..n).for_each(piece);
    }
}

/// Most pieces that work is cut into.
const MOST_PIECES: usize = 16;

/// Steps of one thread that several do as one. Not more with more threads: it may be that none of the others has time.
const STEPS_SHARED: usize = 4;

/// How many pieces work is cut into.
pub(crate) fn pieces(join: &dyn ForkJoin) -> usize {
    join.threads().clamp(1, MOST_PIECES)
}

/// Calls `work` with the number of each part and the part; parts beyond [`pieces`]' largest number are left out.
pub(crate) fn for_each<T: Send>(
    join: &dyn ForkJoin,
    parts: impl Iterator<Item = T>,
    work: impl Fn(usize, T) + Sync,
) {
    let slots: [Mutex<Option<T>>; MOST_PIECES] = std::array::from_fn(|_| Mutex::new(None));
    let mut count = 0;
    for (slot, part) in slots.iter().zip(parts) {
        if let Ok(mut slot) = slot.lock() {
            *slot = Some(part);
        }
        count += 1;
    }
    join.run(count, &|piece| {
        let part = slots[piece].lock().ok().and_then(|mut slot| slot.take());
        if let Some(part) = part {
            work(piece, part);
        }
    });
}

/// One scratch for each piece.
pub(crate) fn scratch<'a, S: Default>(join: &dyn ForkJoin, kept: &'a mut Vec<S>) -> &'a mut [S] {
    let pieces = pieces(join);
    if kept.len() < pieces {
        kept.resize_with(pieces, S::default);
    }
    &mut kept[..pieces]
}

/// How much work is in a step, if it is `one` with one thread. Threads share larger steps, so that they seldom wait for each
/// other.
pub(crate) fn in_a_step(join: &dyn ForkJoin, one: usize) -> usize {
    if pieces(join) > 1 { one * STEPS_SHARED } else { one }
}
