//! The background class: no deadline, and never in the way of one.

use std::time::Duration;

use super::{JobSpec, Kind, Level, Scheduler, Variant, Waiting};
use crate::answer::{Reason, Refusal, Refused, Submission};
use crate::spec::Ticket;

/// For how long the tightest job is remembered, at least.
const MEMORY: Duration = Duration::from_millis(500);

/// When to ask again for a background job that could not start.
pub(super) const RETRY: Duration = Duration::from_millis(20);

/// The least time any job could spare lately.
#[derive(Debug, Clone, Copy)]
pub(super) struct Tightest {
    present: Duration,
    before: Duration,
    since: Duration,
}

impl Default for Tightest {
    fn default() -> Self {
        Self {
            present: Duration::MAX,
            before: Duration::MAX,
            since: Duration::ZERO,
        }
    }
}

impl Tightest {
    /// A job came that could spare `laxity`.
    pub(super) fn note(&mut self, now: Duration, laxity: Duration) {
        self.turn(now);
        self.present = self.present.min(laxity);
    }

    pub(super) fn get(&self, now: Duration) -> Duration {
        let mut at = *self;
        at.turn(now);
        at.present.min(at.before)
    }

    fn turn(&mut self, now: Duration) {
        let elapsed = now.saturating_sub(self.since);
        if elapsed >= MEMORY {
            self.before = if elapsed >= 2 * MEMORY {
                Duration::MAX
            } else {
                self.present
            };
            self.present = Duration::MAX;
            self.since = now;
        }
    }
}

impl<K: Kind, J> Scheduler<K, J> {
    pub(super) fn submit_background(&mut self, now: Duration, spec: JobSpec<K>, job: J) -> Submission<J> {
        let mut dropped = Vec::new();
        self.supersede(&spec, &mut dropped);
        if self.background.len() >= self.config.background_capacity {
            let refusal = Refusal {
                reason: Reason::QueueFull,
                earliest_feasible: None,
            };
            let outcome = Err(Refused { job, refusal });
            return Submission { outcome, dropped };
        }
        let has_mesh = spec.work.mesh.is_some();
        let costs = self.stage_costs(now, &spec.work, has_mesh);
        let full = costs.full(spec.work.rungs).charge();
        let order = self
            .shares
            .background_tag(now, spec.client, spec.weight, full, self.background_now);
        let ticket = self.key(order);
        self.arrivals += 1;
        if let Some(stream) = spec.stream {
            self.streams.insert(stream, ticket);
        }
        let variant = Variant {
            work: spec.work,
            is_half: false,
            has_mesh,
            costs,
        };
        let waiting = Waiting {
            spec,
            variant,
            charged_s: 0.0,
            is_probe: false,
            job,
        };
        self.background.insert(ticket, waiting);
        Submission {
            outcome: Ok(ticket),
            dropped,
        }
    }

    /// A background job that can start on `worker` without costing a deadline: while no job with a deadline waits, and only if its
    /// base, which can't be interrupted, is short beside what the tightest job of late could spare, or if other workers are left.
    pub(super) fn next_background(
        &mut self,
        now: Duration,
        worker: usize,
    ) -> Option<(Ticket, Waiting<K, J>)> {
        let (&ticket, waiting) = self.background.first_key_value()?;
        let costs = self.stage_costs(now, &waiting.spec.work, waiting.variant.has_mesh);
        let block = costs.decode.tail + costs.rungs[0].tail;
        let others_free = self.running.len() > 1
            && self.running.iter().enumerate().all(|(index, running)| {
                index == worker || running.as_ref().is_none_or(|running| running.due.is_some())
            });
        let is_calm = self.ladder.level(now) <= Level::FewerRungs;
        if self.is_edf() && !(is_calm && (others_free || block <= self.tightest.get(now) / 2)) {
            return None;
        }
        self.background_now = self.background_now.max(ticket.order);
        let waiting = self.take(ticket, false)?;
        Some((ticket, waiting))
    }
}
