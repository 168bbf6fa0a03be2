//! Who makes way for whom. A frame without an answer goes before one that is being refined, as long as that costs nobody a rung; where
//! there is less time, those that are due first go first.

use std::time::Duration;

use super::{Item, Kind, Running, Scheduler, Ticket, Waiting};
use crate::answer::{Next, Verdict};
use crate::nanos::{duration, nanos};
use crate::timeline::{Load, NEVER};

impl<K: Kind, J> Scheduler<K, J> {
    /// Whether the job of `worker`, which is due at `due` and has `rest` left of its rung, is put aside for another one.
    pub(super) fn makes_way(&self, now: Duration, worker: usize, due: Duration, rest: Duration) -> bool {
        self.is_pressed(now, worker, due, rest)
            || self.running.iter().all(Option::is_some)
                && self.has_place_aside(worker, self.running[worker].as_ref(), 1)
                && self.goes_first(now, worker).is_some()
    }

    /// Whether a job that is due earlier lies aside, or waits and would lose rungs to the one of `worker`, which has time enough behind
    /// everybody who is due before.
    fn is_pressed(&self, now: Duration, worker: usize, due: Duration, rest: Duration) -> bool {
        let Some(running) = self.running[worker].as_ref() else {
            return false;
        };
        let mut first = self.timeline.first();
        let (first_due, wanted) = loop {
            let Some(ticket) = first.filter(|&ticket| ticket < running.ticket) else {
                return false;
            };
            match self.timeline.get(ticket) {
                Some(Item::Waiting(waiting)) if self.has_place_aside(worker, Some(running), 0) => {
                    let wanted = waiting.variant.costs.full(waiting.spec.work.rungs);
                    break (ticket.order, wanted.charge());
                }
                // They change places.
                Some(&Item::Aside(at)) if at == worker => return true,
                _ => first = self.timeline.after(ticket),
            }
        };
        let ending = running.ending_after(running.rungs_done);
        let before = duration(self.timeline.probe(running.ticket).before);
        now + rest + ending.charge() + wanted > first_due && now + before + rest + ending.tail <= due
    }

    /// The job to be begun before all that `worker` has begun, if there is one: no promise is broken by it, and no rung lost.
    pub(super) fn goes_first(&self, now: Duration, worker: usize) -> Option<Ticket> {
        let (ticket, waiting) = self.first_waiting()?;
        let base = waiting.variant.costs.until_base();
        let running = self.running[worker].as_ref();
        let bound = self.bound_share(now, Some(worker)) + base.tail / self.workers();
        // What the timeline will say of it once it lies aside.
        let keeps_its_promise = |job: &Running<K>| {
            let before = duration(self.timeline.probe(job.ticket).before);
            job.due
                .is_none_or(|due| now + bound + before + job.ending().tail <= due)
        };
        let rest = |job: &Running<K>| job.rest(job.stage_took(now));
        let quarters = u32::try_from(self.headroom_for_rungs(now)).unwrap_or(4);
        let tightest = self.tightest.get(now);
        let begun = || {
            let aside = self.preempted[worker]
                .iter()
                .map(|job| (job, job.rest_aside(), job.share(self.workers())));
            aside.chain(running.map(|job| (job, rest(job), Duration::ZERO)))
        };
        // All that is due before a job is done before it: rungs of those that were begun here, and what was promised to others.
        let keeps_its_rungs = |job: &Running<K>| {
            let earlier = begun().filter(|(other, ..)| other.ticket <= job.ticket);
            let (rest, shares) = earlier.fold((Duration::ZERO, Duration::ZERO), |(rest, shares), earlier| {
                (rest + earlier.1, shares + earlier.2)
            });
            let before = duration(self.timeline.probe(job.ticket).before).saturating_sub(shares);
            job.due.is_none_or(|due| {
                let left = due.saturating_sub(now);
                // Who comes meanwhile may be due earlier.
                let shared = left.saturating_sub(tightest);
                base.charge() + before + rest + job.slow_reply <= left - shared * quarters / 4
            })
        };
        let ending = running.map_or(Duration::ZERO, |job| job.share(self.workers()));
        let may = self.can_start(now, waiting)
            && self.least_slack(now, 0, bound + ending) >= 0
            && running.is_none_or(keeps_its_promise)
            && begun().all(|(job, ..)| keeps_its_rungs(job));
        may.then_some(ticket)
    }

    fn first_waiting(&self) -> Option<(Ticket, &Waiting<K, J>)> {
        let mut next = self.timeline.first();
        while let Some(ticket) = next {
            if let Some(Item::Waiting(waiting)) = self.timeline.get(ticket) {
                return Some((ticket, waiting));
            }
            next = self.timeline.after(ticket);
        }
        None
    }

    /// Whether those that lie aside at `worker`, and `another` one, are no more than may, with so many places `kept` free.
    pub(super) fn has_place_aside(&self, worker: usize, another: Option<&Running<K>>, kept: usize) -> bool {
        let aside = || self.preempted[worker].iter().chain(another);
        let units: u64 = aside().map(|job| u64::from(job.work.units)).sum();
        let places = aside().count() + kept;
        places <= 1 || places <= self.config.max_aside && units <= self.config.max_aside_units
    }

    pub(super) fn put_aside(&mut self, now: Duration, worker: usize, due: Duration) -> Verdict {
        let Some(mut running) = self.running[worker].take() else {
            return Verdict::Abandon;
        };
        running.carried = running.stage_took(now);
        let ending = running.ending();
        let load = Load {
            due: nanos(due),
            tail: nanos(ending.tail),
            share: nanos(running.share(self.workers())),
            last_start: NEVER,
            is_begun: true,
        };
        self.timeline.insert(running.ticket, load, Item::Aside(worker));
        self.preempted[worker].push(running);
        Verdict::Yield
    }

    /// Gives `worker` the job back that lies aside there under `ticket`.
    pub(super) fn take_up(&mut self, now: Duration, worker: usize, ticket: Ticket) -> Option<Next<J>> {
        let aside = &mut self.preempted[worker];
        let place = aside.iter().position(|job| job.ticket == ticket)?;
        let job = aside.swap_remove(place);
        self.timeline.remove(ticket);
        Some(self.resume(now, worker, job))
    }
}
