//! What several test programs need.

use stereo::ForkJoin;

/// Runs pieces backwards on scoped threads.
pub(crate) struct ThreeThreads;

impl ForkJoin for ThreeThreads {
    fn threads(&self) -> usize {
        3
    }

    fn run(&self, n: usize, piece: &(dyn Fn(usize) + Sync)) {
        std::thread::scope(|scope| {
            for k in (0..n).rev() {
                scope.spawn(move || piece(k));
            }
        });
    }
}
