//! What a stream counts.

use std::collections::{BTreeMap, VecDeque};
use std::time::{Duration, Instant};

use crate::decode::Side;

/// A frame this many numbers back is no late one: its camera counts from the start again.
pub(super) const FRAMES_BACK_AT_RESTART: u64 = 64;
/// Most frames that one gap in the numbers is taken for; after a larger one, the camera counts otherwise than before.
pub(super) const LARGEST_GAP: u64 = 1000;
/// Over how long a rate is taken.
const RATE_WINDOW: Duration = Duration::from_secs(2);
/// Most moments that a rate remembers.
const RATE_MOMENTS: usize = 512;
/// Unpaired images that are remembered with their time differences.
const UNPAIRED_KEPT: usize = 8;

/// Everything that came, by what became of it: `frames = answered + dropped + under way`, and
/// `images = paired + unpaired + waiting`.
#[derive(Debug, Default)]
pub(super) struct Counts {
    /// Frames: pairs in one message, and those made of two images.
    pub(super) frames: u64,
    pub(super) answered: u64,
    /// Those of them that were done after their budget.
    pub(super) answered_late: u64,
    /// By reason.
    pub(super) dropped: BTreeMap<&'static str, u64>,
    /// Frames whose numbers were left out: they never came.
    pub(super) lost: u64,
    /// Results that were not sent because the one before was still on its way.
    pub(super) unsent: u64,
    /// Single images.
    pub(super) images: u64,
    pub(super) paired: u64,
    /// By reason.
    pub(super) unpaired: BTreeMap<&'static str, u64>,
    /// The last few, oldest first.
    pub(super) last_unpaired: VecDeque<Unpaired>,
}

/// An image that was in no frame.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Unpaired {
    pub(crate) side: Side,
    pub(crate) sequence: Option<u64>,
    pub(crate) why: &'static str,
    /// Distance in time to the nearest image of the other side.
    pub(crate) nearest: Option<Duration>,
}

impl Counts {
    pub(super) fn add_unpaired(&mut self, unpaired: &Unpaired) {
        *self.unpaired.entry(unpaired.why).or_default() += 1;
        if self.last_unpaired.len() == UNPAIRED_KEPT {
            self.last_unpaired.pop_front();
        }
        self.last_unpaired.push_back(*unpaired);
    }
}

/// How often something happens.
#[derive(Debug, Default)]
pub(super) struct Rate(VecDeque<Instant>);

impl Rate {
    pub(super) fn tick(&mut self, now: Instant) {
        if self.0.len() == RATE_MOMENTS {
            self.0.pop_front();
        }
        self.0.push_back(now);
    }

    /// How often a second, over the last two.
    pub(super) fn hz(&self, now: Instant) -> f64 {
        let is_recent = |moment: &&Instant| now.saturating_duration_since(**moment) <= RATE_WINDOW;
        let recent: Vec<&Instant> = self.0.iter().filter(is_recent).collect();
        match (recent.first(), recent.last()) {
            (Some(&first), Some(&last)) if recent.len() > 1 && last > first => {
                (recent.len() - 1) as f64 / (*last - *first).as_secs_f64()
            }
            _ => 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rate_is_that_of_the_last_two_seconds() {
        let start = Instant::now();
        let mut rate = Rate::default();
        for i in 0..100 {
            rate.tick(start + i * Duration::from_millis(50));
        }
        let last = start + 99 * Duration::from_millis(50);
        assert!((rate.hz(last) - 20.0).abs() < 1e-6, "{}", rate.hz(last));
        assert!(rate.hz(last + Duration::from_secs(3)).abs() < f64::EPSILON);
    }
}
