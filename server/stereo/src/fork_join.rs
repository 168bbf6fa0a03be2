//! Parallelism as an argument: the core never makes a thread.

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
