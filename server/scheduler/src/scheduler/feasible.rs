//! The question of all admission: would everybody be in time?

use std::time::Duration;

use super::{Kind, Level, Priority, Scheduler, StageCosts, Ticket, Variants};
use crate::nanos::{duration, nanos};
use crate::rate::Rate;
use crate::timeline::{Load, at_headroom};

/// Load by the mandatory part of everything up to which there is time for everybody.
const CALM: f64 = 0.6;
/// Steps of the search for the earliest deadline that can be promised.
const SEARCH: usize = 16;

impl<K: Kind, J> Scheduler<K, J> {
    /// Whether a job of these costs, due at `due`, and everybody after it would be in time, with `headroom` left to others.
    pub(super) fn fits(
        &self,
        now: Duration,
        due: Duration,
        key: Ticket,
        costs: &StageCosts,
        headroom: usize,
    ) -> bool {
        let load = self.load(now, due, costs);
        let found = self.timeline.probe(key);
        let start = at_headroom(nanos(now), headroom) + nanos(self.bound_share(now, None));
        let own = at_headroom(load.due, headroom) - load.tail - found.before;
        own >= start && found.after[headroom].saturating_sub(load.share) >= start
    }

    /// What a job needs that is promised at `now`: what it takes nearly always; while there is time for everybody, or a worker that
    /// nobody else wants, what it is reckoned with. A refusal is certain then to cost its client the answer, and nobody else would have
    /// the use of it.
    pub(super) fn load(&self, now: Duration, due: Duration, costs: &StageCosts) -> Load {
        let mandatory = costs.mandatory();
        let is_calm = self.is_idle() || self.ladder.load(now, Level::FewerRungs) < CALM;
        Load {
            due: nanos(due),
            tail: nanos(if is_calm {
                mandatory.charge()
            } else {
                mandatory.tail
            }),
            share: nanos(mandatory.charge() / self.workers()),
            last_start: nanos(due) - nanos(mandatory.typical),
            is_begun: false,
        }
    }

    /// What the job has to leave to others.
    pub(super) fn headroom(&self, now: Duration, is_within: bool, priority: Priority) -> usize {
        // The smallest headroom that is more than `rate` takes of the workers.
        let for_rate = |rate: &Rate| match rate.get(now) {
            rate if rate < 0.02 => 0,
            rate if rate < 0.2 => 1,
            rate if rate < 0.45 => 2,
            _ => 3,
        };
        let for_shares = if is_within {
            0
        } else {
            for_rate(&self.within_share).max(1)
        };
        let for_class = match priority {
            Priority::High => 0,
            Priority::Normal => for_rate(&self.high),
            Priority::BestEffort => for_rate(&self.within_share).max(1),
        };
        for_shares.max(for_class)
    }

    /// The shortest time from now to a deadline, not before the one `asked` for, that could be promised at the cheapest setting.
    pub(super) fn earliest_feasible(
        &self,
        now: Duration,
        asked: Duration,
        variants: &Variants<K>,
    ) -> Option<Duration> {
        let cheapest = variants
            .iter()
            .map(|way| way.costs)
            .min_by_key(|costs| costs.mandatory().charge())?;
        let load = self.load(now, now, &cheapest);
        let start = nanos(now) + nanos(self.bound_share(now, None));
        // Behind everybody who could not spare the time.
        let behind = self.timeline.last_with_less_room_than(start + load.share);
        let mut due = behind.map_or(asked, |ticket| ticket.order.max(asked));
        for _ in 0..SEARCH {
            let before = self.timeline.probe(self.key(due)).before;
            let done = duration(start + before + load.tail);
            if done <= due {
                return Some(due - now);
            }
            due = done;
        }
        Some(duration(start + self.timeline.total() + load.tail).saturating_sub(now))
    }
}
