//! What a worker does next, and whether another step may start.

use std::time::Duration;

use super::{Item, Kind, Policy, Running, Scheduler, Stage, Ticket, Urgency, Variant, Waiting};
use crate::answer::{Dispatch, DropReason, Dropped, Finished, Next, Plan, StopReason, Verdict};
use crate::ladder::Level;
use crate::running::Phase;

impl<K: Kind, J> Scheduler<K, J> {
    /// What `worker`, which is idle, does next: the job that is due first, one that has not been begun before those that have if that
    /// costs no rungs, or a background job if nobody else waits. Jobs that can't be in time any more are passed over;
    /// [`expire`](Self::expire) hands them out.
    pub fn next(&mut self, now: Duration, worker: usize) -> Option<Next<J>> {
        self.see(now);
        self.sweep(now);
        if worker >= self.running.len() {
            return None;
        }
        self.running[worker] = None;
        let mut next = self.timeline.first();
        let has_place = self.has_place_aside(worker, None, 0);
        while let Some(mut ticket) = next {
            match self.timeline.get(ticket) {
                Some(&Item::Aside(at)) if at == worker => {
                    let may_more = self.has_place_aside(worker, None, 1);
                    match self.goes_first(now, worker).filter(|_| may_more) {
                        Some(first) => ticket = first,
                        None => return self.take_up(now, worker, ticket),
                    }
                }
                Some(Item::Waiting(_)) if has_place => {}
                _ => {
                    next = self.timeline.after(ticket);
                    continue;
                }
            }
            let waiting = self.take(ticket, false)?;
            if self.can_start(now, &waiting) {
                return Some(Next::Start(self.start(now, worker, ticket, waiting)));
            }
            self.shares.refund(waiting.spec.client, waiting.charged_s);
            self.limbo.push(Dropped {
                ticket,
                job: waiting.job,
                reason: DropReason::Expired,
            });
            next = self.timeline.after(ticket);
        }
        if let Some(parked) = self.parked[worker].take() {
            return Some(self.resume(now, worker, parked));
        }
        let (ticket, waiting) = self.next_background(now, worker)?;
        Some(Next::Start(self.start(now, worker, ticket, waiting)))
    }

    /// Gives `worker` a job back that lay aside.
    pub(super) fn resume(&mut self, now: Duration, worker: usize, mut job: Running<K>) -> Next<J> {
        let ticket = job.ticket;
        let is_boundary = job.carried.is_zero();
        job.stage_started = now;
        job.step_started = now;
        self.running[worker] = Some(job);
        let verdict = self.go_on(now, worker, is_boundary);
        Next::Resume { ticket, verdict }
    }

    /// `worker` has decoded its images.
    pub fn decoded(&mut self, now: Duration, worker: usize) {
        self.see(now);
        let Some(running) = self.running.get_mut(worker).and_then(Option::as_mut) else {
            return;
        };
        let took = running.end_stage(now, running.costs.decode, Phase::Base);
        let Running { work, .. } = *running;
        self.costs
            .learn(now, work.decode, Stage::Decode, work.units, took);
    }

    /// `worker` has finished a rung, base being the first; `has_more` if the matcher could go on.
    pub fn rung_done(&mut self, now: Duration, worker: usize, has_more: bool) -> Verdict {
        self.see(now);
        self.learn_step(now, worker);
        let Some(running) = self.running.get_mut(worker).and_then(Option::as_mut) else {
            return Verdict::Abandon;
        };
        let index = running.rungs_done;
        let took = running.end_stage(now, running.costs.rung(index), Phase::Refine);
        running.rungs_done = index.saturating_add(1);
        let is_last = !has_more || running.rungs_done >= running.work.rungs;
        let Running { work, .. } = *running;
        self.costs
            .learn(now, work.matching, Stage::Rung(index), work.units, took);
        if is_last {
            return self.finish(now, worker, StopReason::Complete);
        }
        self.go_on(now, worker, true)
    }

    /// `worker` has finished a step that did not finish a rung.
    pub fn step_done(&mut self, now: Duration, worker: usize) -> Verdict {
        self.see(now);
        self.learn_step(now, worker);
        if let Some(running) = self.running.get_mut(worker).and_then(Option::as_mut) {
            running.step_started = now;
        }
        self.go_on(now, worker, false)
    }

    /// `worker` has sent what it has at a rung, and could go on: whether it still should. What that took is nobody's measure.
    pub fn shared(&mut self, now: Duration, worker: usize) -> Verdict {
        self.see(now);
        if let Some(running) = self.running.get_mut(worker).and_then(Option::as_mut) {
            running.stage_started = now;
            running.step_started = now;
        }
        self.go_on(now, worker, true)
    }

    /// `worker` has made the mesh.
    pub fn meshed(&mut self, now: Duration, worker: usize) {
        self.see(now);
        let Some(running) = self.running.get_mut(worker).and_then(Option::as_mut) else {
            return;
        };
        let rung = running.reached();
        let took = running.end_stage(now, running.costs.mesh(rung), Phase::Encode);
        let Running { work, .. } = *running;
        if let Some(kind) = work.mesh {
            self.costs.learn(now, kind, Stage::Mesh(rung), work.units, took);
        }
    }

    /// What the stages of the job of `worker` were expected to take up to the end of an encoding that is under way: of the result, or of
    /// what there is at a rung. `None` if it has no job.
    #[must_use]
    pub fn expected(&self, worker: usize) -> Option<Duration> {
        let running = self.running.get(worker)?.as_ref()?;
        let rung = running.reached();
        let is_meshed_since = running.has_mesh && running.phase != Phase::Encode;
        let mesh = is_meshed_since.then(|| running.costs.mesh(rung).typical);
        Some(running.predicted + mesh.unwrap_or_default() + running.costs.encode(rung).typical)
    }

    /// `worker` has encoded its result and is idle. `None` if it had no job.
    pub fn finished(&mut self, now: Duration, worker: usize) -> Option<Finished> {
        self.see(now);
        let mut running = self.running.get_mut(worker)?.take()?;
        let (work, rung) = (running.work, running.reached());
        let took = running.end_stage(now, running.costs.encode(rung), Phase::Encode);
        self.costs
            .learn(now, work.encode, Stage::Encode(rung), work.units, took);
        Some(Finished {
            predicted: running.predicted,
            actual: running.actual,
        })
    }

    /// `worker` has failed at its job or dropped it: it is idle, and nothing is learned.
    pub fn failed(&mut self, now: Duration, worker: usize) {
        self.see(now);
        if let Some(running) = self.running.get_mut(worker) {
            *running = None;
        }
    }

    /// `worker` was replaced: its job and the one it had put aside are gone.
    pub fn replaced(&mut self, now: Duration, worker: usize) {
        self.failed(now, worker);
        if worker < self.running.len() {
            self.parked[worker] = None;
            for aside in std::mem::take(&mut self.preempted[worker]) {
                self.timeline.remove(aside.ticket);
            }
        }
    }

    /// Whether it makes sense to start a job: at its cheapest it will be in time as often as not, by what is known now.
    pub(super) fn can_start(&self, now: Duration, waiting: &Waiting<K, J>) -> bool {
        let Urgency::Deadline { at, .. } = waiting.spec.urgency else {
            return true;
        };
        if !self.is_edf() || waiting.is_probe {
            return true;
        }
        let cheapest = self.variants(now, &waiting.spec, Level::NoMesh);
        cheapest
            .iter()
            .any(|way| now + way.costs.mandatory().typical <= at)
    }

    fn start(&mut self, now: Duration, worker: usize, ticket: Ticket, waiting: Waiting<K, J>) -> Dispatch<J> {
        let spec = waiting.spec;
        let level = self.ladder.level(now);
        let due = match spec.urgency {
            Urgency::Deadline { at, .. } => Some(at),
            Urgency::Background => None,
        };
        let mut variant = match due {
            Some(due) if self.is_edf() => self.way_at_dispatch(now, due, &waiting, level),
            _ => waiting.variant,
        };
        variant.work.rungs = match self.config.policy {
            Policy::Fixed(rungs) => variant.work.rungs.min(rungs),
            _ => variant.work.rungs,
        }
        .max(1);
        let mandatory = variant.costs.mandatory();
        let reply = self.reply(now, &spec.work);
        let budget = due.map_or(Duration::ZERO, |due| due.saturating_sub(now));
        self.running[worker] = Some(Running {
            ticket,
            stream: spec.stream,
            due,
            // The deadline leaves time for an ordinary reply.
            slow_reply: reply.tail.saturating_sub(reply.charge()).min(budget / 4),
            work: variant.work,
            costs: variant.costs,
            has_mesh: variant.has_mesh,
            is_mesh_optional: spec.is_mesh_optional,
            phase: Phase::Decode,
            rungs_done: 0,
            stage_started: now,
            step_started: now,
            carried: Duration::ZERO,
            predicted: Duration::ZERO,
            actual: Duration::ZERO,
            is_cancelled: false,
            is_superseded: false,
        });
        Dispatch {
            ticket,
            job: waiting.job,
            plan: Plan {
                is_half: variant.is_half,
                has_mesh: variant.has_mesh,
                rungs: variant.work.rungs,
                mandatory_tail: mandatory.tail,
                level,
            },
            waiting: self.waiting() + self.background.len(),
        }
    }

    /// The best way to do a job that is in time and takes nothing from those who wait that wasn't its own; else the cheapest.
    fn way_at_dispatch(
        &self,
        now: Duration,
        due: Duration,
        waiting: &Waiting<K, J>,
        level: Level,
    ) -> Variant<K> {
        let admitted = waiting.variant.costs.mandatory().charge();
        let variants = self.variants(now, &waiting.spec, level);
        let is_good = |way: &&Variant<K>| {
            let mandatory = way.costs.mandatory();
            let bound = self.bound_share(now, None) + mandatory.charge() / self.workers();
            now + mandatory.tail <= due
                && (mandatory.charge() <= admitted || self.least_slack(now, 0, bound) >= 0)
        };
        let cheapest = || variants.iter().min_by_key(|way| way.costs.mandatory().charge());
        let found = variants.iter().find(is_good).or_else(cheapest);
        found.copied().unwrap_or(waiting.variant)
    }

    /// Whether `worker` starts another step; `is_boundary` if it would be the first of a rung.
    fn go_on(&mut self, now: Duration, worker: usize, is_boundary: bool) -> Verdict {
        let Some(running) = self.running.get(worker).and_then(Option::as_ref) else {
            return Verdict::Abandon;
        };
        if running.is_cancelled {
            self.running[worker] = None;
            return Verdict::Abandon;
        }
        if running.is_superseded {
            return self.finish(now, worker, StopReason::Superseded);
        }
        if !self.is_edf() {
            return Verdict::Continue;
        }
        let Some(due) = running.due else {
            return self.yield_or_continue(now, worker);
        };
        let rung = running.costs.rung(running.rungs_done);
        // What has to follow if this rung is finished, too.
        let ending = running.ending_after(running.rungs_done);
        let step = running.costs.step.tail;
        let (rest, needed) = if is_boundary {
            (rung.tail, (rung + ending).tail)
        } else {
            let rest = rung.typical.saturating_sub(running.stage_took(now)).max(step);
            (rest, rest + ending.tail)
        };
        if now + needed + running.slow_reply > due {
            return self.finish(now, worker, StopReason::Budget);
        }
        if self.timeline.len() > 0 {
            if self.makes_way(now, worker, due, rest) {
                return self.put_aside(now, worker, due);
            }
            // To start a rung, those who wait and those who come must be able to spare all of it. To go on with one, so that what
            // was done is not wasted, and for a rung that takes no longer than a step, those who were promised an answer must be able
            // to spare the next step.
            let (headroom, work) = if is_boundary && rung.charge() > step {
                (self.headroom_for_rungs(now), rung.charge())
            } else {
                (0, step)
            };
            let bound = self.bound_share(now, Some(worker)) + (work + ending.charge()) / self.workers();
            if self.least_slack(now, headroom, bound) < 0 {
                return self.finish(now, worker, StopReason::Load);
            }
        }
        Verdict::Continue
    }

    fn yield_or_continue(&mut self, now: Duration, worker: usize) -> Verdict {
        if self.waiting() == 0 {
            return Verdict::Continue;
        }
        if let Some(mut running) = self.running[worker].take() {
            running.carried = running.stage_took(now);
            self.parked[worker] = Some(running);
        }
        Verdict::Yield
    }

    /// Ends the refinement.
    fn finish(&mut self, now: Duration, worker: usize, because: StopReason) -> Verdict {
        let is_edf = self.is_edf();
        let Some(running) = self.running.get_mut(worker).and_then(Option::as_mut) else {
            return Verdict::Abandon;
        };
        if running.is_cancelled {
            self.running[worker] = None;
            return Verdict::Abandon;
        }
        let rung = running.reached();
        let with_mesh = now + running.costs.mesh(rung).tail + running.costs.encode(rung).tail;
        let is_late = is_edf && running.due.is_some_and(|due| with_mesh > due);
        let has_mesh = running.has_mesh && !(running.is_mesh_optional && is_late);
        // What was begun of a rung counts as work of this job, though not as a measure of the rung.
        if running.stage_took(now) > Duration::ZERO {
            let took = running.stage_took(now);
            running.predicted += took;
            running.actual += took;
        }
        running.has_mesh = has_mesh;
        running.phase = if has_mesh { Phase::Mesh } else { Phase::Encode };
        running.stage_started = now;
        running.step_started = now;
        running.carried = Duration::ZERO;
        Verdict::Finish { has_mesh, because }
    }

    /// The headroom that leaves those who will come as much of the workers as those who came lately wanted for the mandatory part.
    pub(super) fn headroom_for_rungs(&self, now: Duration) -> usize {
        match self.ladder.load(now, Level::FewerRungs) {
            load if load < 0.36 => 1,
            load if load < 0.6 => 2,
            _ => 3,
        }
    }

    fn learn_step(&mut self, now: Duration, worker: usize) {
        let Some(running) = self.running.get(worker).and_then(Option::as_ref) else {
            return;
        };
        if running.phase == Phase::Refine {
            let Running { work, .. } = *running;
            let took = now.saturating_sub(running.step_started);
            self.costs
                .learn(now, work.matching, Stage::Step, work.units, took);
        }
    }
}
