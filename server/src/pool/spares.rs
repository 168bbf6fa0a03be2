//! Rigs for the frames that are worked on while others lie aside, kept for the next time.

use std::time::{Duration, Instant};

use super::rig::Rig;

/// Pixels that the spare rigs of a worker are made for, all together; one is kept however large it is.
pub(super) const SPARE_PX: usize = 4_000_000;
/// A rig that nobody has needed for so long is given up: a busy moment may have taken many.
const KEPT_FOR: Duration = Duration::from_secs(10);

/// The spare rigs of a worker, the one that was used last at the end.
#[derive(Default)]
pub(super) struct Spares(Vec<(Rig, Instant)>);

impl Spares {
    /// The one that was used last, so that those that nobody needs grow old; a new one if there is none.
    pub(super) fn take(&mut self) -> Rig {
        self.0.pop().map(|(rig, _)| rig).unwrap_or_default()
    }

    /// Keeps a rig that was used until `now`, if it isn't too much.
    pub(super) fn keep(&mut self, rig: Rig, now: Instant) {
        self.0
            .retain(|(_, used)| now.saturating_duration_since(*used) < KEPT_FOR);
        let kept: usize = self.0.iter().map(|(rig, _)| rig.largest_px()).sum();
        if self.0.is_empty() || kept + rig.largest_px() <= SPARE_PX {
            self.0.push((rig, now));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rigs_that_nobody_has_needed_for_long_are_given_up() {
        let mut spares = Spares::default();
        let start = Instant::now();
        for _ in 0..5 {
            spares.keep(Rig::default(), start);
        }
        assert_eq!(spares.0.len(), 5);
        // One is used all the time.
        for second in 1..=10 {
            let rig = spares.take();
            spares.keep(rig, start + Duration::from_secs(second));
        }
        assert_eq!(spares.0.len(), 1);
    }
}
