//! How much of something there was lately.

use std::time::Duration;

/// Time constant of the average.
const MEMORY_S: f64 = 0.2;

/// A moving average, by the second, of amounts that come at moments.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Rate {
    by_second: f64,
    at: Duration,
}

impl Rate {
    pub(crate) fn add(&mut self, now: Duration, amount: f64) {
        self.by_second = self.get(now) + amount / MEMORY_S;
        self.at = self.at.max(now);
    }

    pub(crate) fn get(&self, now: Duration) -> f64 {
        self.by_second * (-now.saturating_sub(self.at).as_secs_f64() / MEMORY_S).exp()
    }
}
