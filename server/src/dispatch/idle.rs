//! Workers that have nothing to do, and what they are lent for meanwhile.

use std::sync::atomic::{AtomicUsize, Ordering};

/// Counts them.
#[derive(Debug, Default)]
pub(crate) struct Idle {
    waiting: AtomicUsize,
    lent: AtomicUsize,
}

/// Some of them, lent until this is dropped.
pub(crate) struct Lent<'a> {
    idle: &'a Idle,
    pub(crate) count: usize,
}

/// A worker that has nothing to do while this lives.
pub(crate) struct Waits<'a>(&'a Idle);

impl Idle {
    /// A worker has nothing to do.
    pub(crate) fn begin(&self) -> Waits<'_> {
        self.waiting.fetch_add(1, Ordering::Relaxed);
        Waits(self)
    }

    /// Those that are not lent.
    pub(crate) fn spare(&self) -> usize {
        let lent = self.lent.load(Ordering::Relaxed);
        self.waiting.load(Ordering::Relaxed).saturating_sub(lent)
    }

    /// Whether more are lent than have nothing to do: some were given work since.
    pub(crate) fn is_overdrawn(&self) -> bool {
        self.lent.load(Ordering::Relaxed) > self.waiting.load(Ordering::Relaxed)
    }

    /// Lends up to `most`.
    pub(crate) fn lend(&self, most: usize) -> Lent<'_> {
        let mut lent = self.lent.load(Ordering::Relaxed);
        loop {
            let count = self
                .waiting
                .load(Ordering::Relaxed)
                .saturating_sub(lent)
                .min(most);
            match self
                .lent
                .compare_exchange_weak(lent, lent + count, Ordering::Relaxed, Ordering::Relaxed)
            {
                Ok(_) => return Lent { idle: self, count },
                Err(now) => lent = now,
            }
        }
    }
}

impl Drop for Lent<'_> {
    fn drop(&mut self) {
        self.idle.lent.fetch_sub(self.count, Ordering::Relaxed);
    }
}

impl Drop for Waits<'_> {
    fn drop(&mut self) {
        self.0.waiting.fetch_sub(1, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_more_are_lent_than_have_nothing_to_do() {
        let idle = Idle::default();
        let (first, second) = (idle.begin(), idle.begin());
        let one = idle.lend(1);
        let rest = idle.lend(5);
        assert_eq!((one.count, rest.count, idle.spare()), (1, 1, 0));
        assert_eq!(idle.lend(1).count, 0);
        drop(one);
        assert_eq!(idle.spare(), 1);
        assert!(!idle.is_overdrawn());
        drop((first, second));
        assert!(idle.is_overdrawn(), "they have work now, and one is still lent");
        drop(rest);
        assert!(!idle.is_overdrawn());
    }
}
