//! May another rung start? The only question a running frame asks about time.

use std::time::Duration;

/// What is left of one frame's latency budget.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Budget {
    /// When the answer is due.
    pub deadline: Duration,
    /// What has to happen after the last rung, whatever that is: mesh and encoding.
    pub reserve: Duration,
}

impl Budget {
    /// Whether work that will take `cost` can start at `now` and leave the reserve untouched. Without an estimate (`None`) it can
    /// start as long as any time is left: the first frame of its kind is how an estimate is learned.
    #[must_use]
    pub fn may_start(&self, now: Duration, cost: Option<Duration>) -> bool {
        self.left(now) > cost.unwrap_or(Duration::ZERO)
    }

    /// Whether work that is under way has to stop at `now`, so that the reserve is enough.
    #[must_use]
    pub fn is_spent(&self, now: Duration) -> bool {
        self.left(now).is_zero()
    }

    /// Time from `now` until the reserve has to start; zero if that has passed.
    #[must_use]
    pub fn left(&self, now: Duration) -> Duration {
        self.deadline.saturating_sub(self.reserve).saturating_sub(now)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    #[test]
    fn a_rung_starts_only_if_it_ends_before_the_reserve_begins() {
        let budget = Budget {
            deadline: ms(100),
            reserve: ms(10),
        };
        assert!(budget.may_start(ms(50), Some(ms(39))));
        assert!(!budget.may_start(ms(50), Some(ms(40))));
    }

    #[test]
    fn a_rung_of_unknown_cost_starts_while_any_time_is_left() {
        let budget = Budget {
            deadline: ms(100),
            reserve: ms(10),
        };
        assert!(budget.may_start(ms(89), None));
        assert!(!budget.may_start(ms(90), None));
        assert!(budget.is_spent(ms(90)) && !budget.is_spent(ms(89)));
    }

    #[test]
    fn a_reserve_longer_than_the_budget_leaves_nothing() {
        let budget = Budget {
            deadline: ms(5),
            reserve: ms(10),
        };
        assert_eq!(budget.left(Duration::ZERO), Duration::ZERO);
    }
}
