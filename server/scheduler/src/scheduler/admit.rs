//! Admission: nothing is promised that can't be kept.

use std::time::Duration;

use super::places::Lifted;
use super::{
    ClientId, JobSpec, Kind, Level, Priority, Scheduler, Ticket, Urgency, Variant, Variants, Waiting,
};
use crate::answer::{DropReason, Dropped, Reason, Refusal, Refused, Submission};
use crate::nanos::nanos;
use crate::spec::{Policy, Stage, Work};
use crate::timeline::{Load, NEVER};

/// At most this many jobs without a promise are dropped for one with a promise.
const DISPLACED: usize = 16;
/// While others are active, a client may hold this part of the queue's places, or its share if that is more.
const PLACES: f64 = 0.25;

/// A job with a deadline that asks to be admitted.
struct Asking {
    due: Duration,
    priority: Priority,
    client: ClientId,
    /// The part of the time until a deadline that this job must leave to others, in quarters.
    headroom: usize,
    is_within_share: bool,
    key: Ticket,
}

impl<K: Kind, J> Scheduler<K, J> {
    /// Lets `job` wait for a worker, or says why not.
    ///
    /// A job of [`Priority::Normal`] or above is admitted only if it and everybody already promised will be in time, by what such
    /// jobs cost nearly always. If it doesn't fit, it is tried at half resolution and without its mesh, as the client allows; then
    /// jobs without a promise are dropped for it.
    pub fn submit(&mut self, now: Duration, mut spec: JobSpec<K>, job: J) -> Submission<J> {
        self.see(now);
        let reply = self.leave_time_to_reply(now, &mut spec);
        let Urgency::Deadline { at, priority } = spec.urgency else {
            return self.submit_background(now, spec, job);
        };
        self.sweep(now);
        let mut dropped = std::mem::take(&mut self.limbo);
        let mut outcome = if self.is_edf() {
            self.admit(now, at, priority, spec, job, &mut dropped)
        } else {
            self.enqueue(at, spec, job, &mut dropped)
        };
        if let Err(refused) = &mut outcome {
            refused.refusal = refused.refusal.after(reply);
        }
        Submission { outcome, dropped }
    }

    /// The reply to a job like `spec` took `took` from its encoding until the transport had handed it over.
    pub fn replied(&mut self, now: Duration, spec: &JobSpec<K>, took: Duration) {
        self.see(now);
        let Work { encode, units, .. } = spec.work;
        self.costs.learn(now, encode, Stage::Reply, units, took);
    }

    /// Brings the deadline forward by what the reply is reckoned with, though by a quarter of the budget at most.
    fn leave_time_to_reply(&self, now: Duration, spec: &mut JobSpec<K>) -> Duration {
        let reply = self.reply(now, &spec.work).charge();
        match &mut spec.urgency {
            Urgency::Deadline { at, .. } if self.is_edf() => {
                let reply = reply.min(at.saturating_sub(now) / 4);
                *at -= reply;
                reply
            }
            Urgency::Deadline { .. } | Urgency::Background => Duration::ZERO,
        }
    }

    /// What [`submit`](Self::submit) would refuse now whatever the client's share: for turning a request away before its body is
    /// read. Nothing changes.
    ///
    /// # Errors
    /// The [`Refusal`].
    pub fn assess(&self, now: Duration, spec: &JobSpec<K>) -> Result<(), Refusal> {
        let mut spec = *spec;
        let reply = self.leave_time_to_reply(now, &mut spec);
        self.would_admit(now, &spec)
            .map_err(|refusal| refusal.after(reply))
    }

    fn would_admit(&self, now: Duration, spec: &JobSpec<K>) -> Result<(), Refusal> {
        let Urgency::Deadline { at, .. } = spec.urgency else {
            return Ok(());
        };
        if !self.is_edf() {
            return Ok(());
        }
        let variants = self.variants(now, spec, Level::Full);
        let key = self.key(at);
        let refuse = |reason| {
            Err(Refusal {
                reason,
                earliest_feasible: self.earliest_feasible(now, at, &variants),
            })
        };
        if at <= now {
            refuse(Reason::Expired)
        } else if variants.iter().any(|way| self.fits(now, at, key, &way.costs, 0))
            || self.is_stale(now, spec)
        {
            Ok(())
        } else if self.waiting() >= self.config.capacity {
            refuse(Reason::QueueFull)
        } else {
            refuse(Reason::DeadlineInfeasible)
        }
    }

    /// Lets a job wait under a policy that promises nothing.
    fn enqueue(
        &mut self,
        due: Duration,
        spec: JobSpec<K>,
        job: J,
        dropped: &mut Vec<Dropped<J>>,
    ) -> Result<Ticket, Refused<J>> {
        self.supersede(&spec, dropped);
        if self.waiting() >= self.config.capacity {
            let refusal = Refusal {
                reason: Reason::QueueFull,
                earliest_feasible: None,
            };
            return Err(Refused { job, refusal });
        }
        let key = self.key(Duration::ZERO);
        let costs = self.stage_costs(self.now, &spec.work, spec.work.mesh.is_some());
        let variant = Variant {
            work: spec.work,
            is_half: false,
            has_mesh: spec.work.mesh.is_some(),
            costs,
        };
        let last_start = match self.config.policy {
            Policy::Fifo => NEVER,
            _ => nanos(due),
        };
        let load = Load {
            last_start,
            ..self.load(Duration::ZERO, due, &costs)
        };
        self.shares.admit(spec.client, 0.0);
        self.insert(
            key,
            load,
            Waiting {
                spec,
                variant,
                charged_s: 0.0,
                is_probe: false,
                job,
            },
        );
        Ok(key)
    }

    fn admit(
        &mut self,
        now: Duration,
        due: Duration,
        priority: Priority,
        spec: JobSpec<K>,
        job: J,
        dropped: &mut Vec<Dropped<J>>,
    ) -> Result<Ticket, Refused<J>> {
        self.offer(now, &spec, priority);
        let level = self.ladder.level(now);
        let variants = self.variants(now, &spec, level);
        if due <= now {
            return Err(self.refused(now, due.max(now), job, Reason::Expired, &variants, 0.0));
        }
        let full = self.variants(now, &spec, Level::Full);
        let cost_s = full.ways[0].map_or(Duration::ZERO, |way| way.costs.mandatory().charge());
        self.tightest
            .note(now, due.saturating_sub(now).saturating_sub(cost_s));
        let allowance = self
            .shares
            .ask(now, spec.client, spec.weight, cost_s.as_secs_f64());
        let places = self.places(allowance.share);
        if self.shares.waiting(spec.client) >= places && self.shares.active(now) > 1 {
            return Err(self.refused(
                now,
                due.max(now),
                job,
                Reason::Quota,
                &variants,
                allowance.within_s,
            ));
        }
        if priority == Priority::BestEffort && level >= Level::DropBestEffort {
            return Err(self.refused(now, due, job, Reason::Quota, &variants, allowance.within_s));
        }
        let asking = Asking {
            due,
            priority,
            client: spec.client,
            headroom: self.headroom(now, allowance.is_within, priority),
            is_within_share: allowance.is_within,
            key: self.key(due),
        };
        // The older frame of the stream makes room for this one, and gets its place back if this one is refused.
        let older = spec.stream.and_then(|stream| self.streams.get(&stream).copied());
        let older = older.and_then(|ticket| self.lift(ticket));
        let Some(variant) = self.find_way(now, &asking, &variants, dropped) else {
            let is_probe = self.is_idle() && self.is_stale(now, &spec);
            if let Some(variant) = full.ways[0].filter(|_| is_probe) {
                self.doubt(&spec);
                return Ok(self.accept(now, &asking, spec, variant, true, job));
            }
            if let Some((key, load, waiting)) = older {
                self.insert(key, load, waiting);
            }
            let only_share = asking.headroom > 0
                && variants
                    .iter()
                    .any(|way| self.fits(now, due, asking.key, &way.costs, 0));
            let (reason, within_s) = if self.waiting() >= self.config.capacity {
                (Reason::QueueFull, 0.0)
            } else if only_share {
                (Reason::Quota, allowance.within_s)
            } else {
                (Reason::DeadlineInfeasible, 0.0)
            };
            return Err(self.refused(now, due.max(now), job, reason, &variants, within_s));
        };
        if let Some((ticket, _, waiting)) = older {
            self.shares.leave(waiting.spec.client, waiting.charged_s);
            dropped.push(Dropped {
                ticket,
                job: waiting.job,
                reason: DropReason::Superseded,
            });
        }
        self.stop_older(&spec);
        Ok(self.accept(now, &asking, spec, variant, false, job))
    }

    /// Puts an admitted job in the queue.
    fn accept(
        &mut self,
        now: Duration,
        asking: &Asking,
        spec: JobSpec<K>,
        variant: Variant<K>,
        is_probe: bool,
        job: J,
    ) -> Ticket {
        let charge_s = variant.costs.mandatory().charge().as_secs_f64();
        let by_worker = charge_s / f64::from(self.workers());
        let charged_s = if asking.is_within_share { charge_s } else { 0.0 };
        if asking.is_within_share {
            self.within_share.add(now, by_worker);
        }
        if asking.priority == Priority::High {
            self.high.add(now, by_worker);
        }
        self.shares.admit(asking.client, charged_s);
        let mut load = self.load(now, asking.due, &variant.costs);
        let cheapest = self.variants(now, &spec, Level::NoMesh);
        if is_probe {
            load.last_start = nanos(asking.due);
        } else {
            let typical = cheapest.iter().map(|way| way.costs.mandatory().typical).min();
            load.last_start = nanos(asking.due) - nanos(typical.unwrap_or_default());
        }
        self.insert(
            asking.key,
            load,
            Waiting {
                spec,
                variant,
                charged_s,
                is_probe,
                job,
            },
        );
        asking.key
    }

    /// The best way that keeps everybody in time; jobs without a promise are dropped for it if that helps.
    fn find_way(
        &mut self,
        now: Duration,
        asking: &Asking,
        variants: &Variants<K>,
        dropped: &mut Vec<Dropped<J>>,
    ) -> Option<Variant<K>> {
        let mut lifted: Vec<Lifted<K, J>> = Vec::new();
        loop {
            let has_place = self.waiting() < self.config.capacity;
            let found = variants
                .iter()
                .find(|way| has_place && self.fits(now, asking.due, asking.key, &way.costs, asking.headroom));
            if let Some(&way) = found {
                for (ticket, _, waiting) in lifted {
                    self.shares.leave(waiting.spec.client, waiting.charged_s);
                    dropped.push(Dropped {
                        ticket,
                        job: waiting.job,
                        reason: DropReason::Displaced,
                    });
                }
                return Some(way);
            }
            let may_displace = asking.priority > Priority::BestEffort && lifted.len() < DISPLACED;
            // The one that is due last has waited for the least.
            let victim = self.best_effort.last_key_value().map(|(&ticket, ())| ticket);
            let Some(victim) = victim
                .filter(|_| may_displace)
                .and_then(|ticket| self.lift(ticket))
            else {
                for (key, load, waiting) in lifted {
                    self.insert(key, load, waiting);
                }
                return None;
            };
            lifted.push(victim);
        }
    }

    /// Tells the ladder what was asked for.
    fn offer(&mut self, now: Duration, spec: &JobSpec<K>, priority: Priority) {
        let by_worker = |cost: crate::cost::Cost| cost.typical.as_secs_f64() / f64::from(self.workers());
        let full = self.stage_costs(now, &spec.work, spec.work.mesh.is_some());
        let everything = by_worker(full.full(spec.work.rungs));
        let mandatory = by_worker(full.mandatory());
        let half = spec
            .half
            .as_ref()
            .map_or(full, |work| self.stage_costs(now, work, work.mesh.is_some()));
        let mesh_off = if spec.is_mesh_optional {
            by_worker(half.mesh(0))
        } else {
            0.0
        };
        let half = by_worker(half.mandatory());
        let cheapest = half - mesh_off;
        let promised = if priority == Priority::BestEffort {
            0.0
        } else {
            cheapest
        };
        self.ladder
            .offer(now, [everything, mandatory, half, cheapest, promised]);
    }

    fn refused(
        &self,
        now: Duration,
        due: Duration,
        job: J,
        reason: Reason,
        variants: &Variants<K>,
        within_s: f64,
    ) -> Refused<J> {
        let within = Duration::try_from_secs_f64(within_s).unwrap_or_default();
        let earliest_feasible = self
            .earliest_feasible(now, due, variants)
            .map(|earliest| earliest.max(within));
        let refusal = Refusal {
            reason,
            earliest_feasible,
        };
        Refused { job, refusal }
    }

    fn places(&self, share: f64) -> usize {
        #[expect(
            clippy::cast_precision_loss,
            reason = "the capacity of a queue is far below 2^52"
        )]
        let places = self.config.capacity as f64 * share.max(PLACES);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "between 0 and the capacity"
        )]
        let places = places as usize;
        places.max(1)
    }

    pub(super) fn is_idle(&self) -> bool {
        self.timeline.len() == 0 && self.running.iter().any(Option::is_none)
    }

    fn is_stale(&self, now: Duration, spec: &JobSpec<K>) -> bool {
        self.costs.is_stale(now, spec.work.matching, Stage::Rung(0))
    }

    /// Doubts the costs that made a job look infeasible and were not measured lately.
    fn doubt(&mut self, spec: &JobSpec<K>) {
        let work = &spec.work;
        self.costs.doubt(work.matching, Stage::Rung(0));
        self.costs.doubt(work.decode, Stage::Decode);
        for rung in 0..work.rungs.max(1) {
            self.costs.doubt(work.encode, Stage::Encode(rung));
            if let Some(mesh) = work.mesh {
                self.costs.doubt(mesh, Stage::Mesh(rung));
            }
        }
    }
}
