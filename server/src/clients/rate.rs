//! So many requests a second, with bursts of up to a second's worth: the generic cell rate algorithm, a leaky bucket that keeps nothing
//! but a moment.

use std::time::{Duration, Instant};

/// A second's worth may come at once.
const BURST: Duration = Duration::from_secs(1);

/// One client's requests.
#[derive(Debug)]
pub(super) struct Rate {
    /// Time from one request to the next.
    interval: Duration,
    /// When a client that keeps to its rate would send the next request.
    due: Option<Instant>,
}

impl Rate {
    /// `per_second` is at least 1.
    pub(super) fn new(per_second: u32) -> Self {
        Self {
            interval: BURST / per_second.max(1),
            due: None,
        }
    }

    /// Takes a request that comes `now`.
    ///
    /// # Errors
    /// How long to wait, if it comes too soon.
    pub(super) fn take(&mut self, now: Instant) -> Result<(), Duration> {
        let due = self.due.map_or(now, |due| due.max(now));
        let ahead = due.saturating_duration_since(now) + self.interval;
        match ahead.checked_sub(BURST) {
            Some(wait) if !wait.is_zero() => Err(wait),
            _ => {
                self.due = Some(due + self.interval);
                Ok(())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// How many of `count` requests that come together are taken.
    fn taken(rate: &mut Rate, count: usize, now: Instant) -> usize {
        (0..count).filter(|_| rate.take(now).is_ok()).count()
    }

    #[test]
    fn a_seconds_worth_may_come_at_once_and_then_as_many_a_second() {
        let (mut rate, start) = (Rate::new(10), Instant::now());
        assert_eq!(taken(&mut rate, 100, start), 10);
        assert_eq!(rate.take(start), Err(Duration::from_millis(100)));
        let half_later = start + Duration::from_millis(500);
        assert_eq!(taken(&mut rate, 100, half_later), 5);
        assert_eq!(taken(&mut rate, 100, half_later + Duration::from_secs(3600)), 10);
    }

    #[test]
    fn who_waits_as_long_as_told_is_let_in() {
        let (mut rate, start) = (Rate::new(3), Instant::now());
        assert_eq!(taken(&mut rate, 9, start), 3);
        let wait = rate.take(start).unwrap_err();
        assert!(rate.take(start + wait).is_ok());
        assert!(rate.take(start + wait).is_err());
    }

    #[test]
    fn one_a_second_is_one_a_second() {
        let (mut rate, start) = (Rate::new(1), Instant::now());
        assert_eq!(taken(&mut rate, 5, start), 1);
        assert_eq!(taken(&mut rate, 5, start + Duration::from_millis(999)), 0);
        assert_eq!(taken(&mut rate, 5, start + Duration::from_secs(1)), 1);
    }
}
