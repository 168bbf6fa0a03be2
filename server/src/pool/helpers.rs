//! One frame on several cores, while there are workers that have nothing to do.
//!
//! The matcher cuts its steps into pieces that borrow its buffers. A thread of the pool can't take such a piece from another in safe Rust,
//! so there are stand-ins: one thread for each worker but one, asleep unless a frame is split, and in use only for as many workers as
//! wait for something to do. The scope of `rayon` is what makes the borrowing safe: it ends when every piece has. A worker that is given
//! work starts on it at once; its stand-in ends the piece that it is at (far below a millisecond) and takes no other.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use rayon_core::{ThreadPool, ThreadPoolBuilder};
use stereo::ForkJoin;

use crate::dispatch::{Dispatch, Idle};

/// The stand-ins.
pub(crate) struct Helpers {
    threads: ThreadPool,
    idle: Arc<Idle>,
    is_retired: AtomicBool,
}

impl Helpers {
    /// Those for `workers` workers; `None` if there are no others that could help.
    pub(crate) fn start(workers: usize, dispatch: &Dispatch) -> io::Result<Option<Self>> {
        let others = workers.saturating_sub(1);
        if others == 0 {
            return Ok(None);
        }
        let threads = ThreadPoolBuilder::new()
            .num_threads(others)
            .thread_name(|index| format!("stereo-helper-{index}"))
            .build()
            .map_err(io::Error::other)?;
        Ok(Some(Self {
            threads,
            idle: Arc::clone(dispatch.idle()),
            is_retired: AtomicBool::new(false),
        }))
    }

    /// Splits nothing any more.
    pub(crate) fn retire(&self) {
        self.is_retired.store(true, Ordering::Relaxed);
    }
}

impl ForkJoin for Helpers {
    /// As many as there are workers, whoever has time at the moment: the matcher's pieces and buffers are the same for the whole frame.
    fn threads(&self) -> usize {
        1 + self.threads.current_num_threads()
    }

    /// A panic in a piece is the caller's, once all have ended.
    fn run(&self, n: usize, piece: &(dyn Fn(usize) + Sync)) {
        let most = match self.is_retired.load(Ordering::Relaxed) {
            true => 0,
            false => n.saturating_sub(1),
        };
        let lent = self.idle.lend(most);
        if lent.count == 0 {
            return (0..n).for_each(piece);
        }
        let next = AtomicUsize::new(0);
        let take_one = || {
            let index = next.fetch_add(1, Ordering::Relaxed);
            if index < n {
                piece(index);
            }
            index < n
        };
        self.threads.in_place_scope(|scope| {
            for _ in 0..lent.count {
                scope.spawn(|_| while !self.idle.is_overdrawn() && take_one() {});
            }
            while take_one() {}
        });
    }
}

#[cfg(test)]
mod tests;
