//! Workers and clients on virtual time: a discrete-event simulation that drives the scheduler as a server would.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::time::Duration;

use stereo_scheduler::{
    ClientId, Config, DropReason, Dropped, JobSpec, Next, Priority, Reason, Scheduler, Stage, StopReason,
    StreamId, Ticket, Urgency, Verdict, Work,
};

use super::dice::Dice;
use super::traffic::{Costs, PACE_LASTS_MS, Request};

/// What became of a request.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Outcome {
    Served {
        /// When a worker took it.
        begun: Duration,
        at: Duration,
        rungs: u8,
        predicted: Duration,
        actual: Duration,
    },
    Refused(Reason),
    Dropped(DropReason),
}

#[derive(Debug)]
pub(crate) struct World {
    pub(crate) config: Config,
    pub(crate) costs: Costs,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Doing {
    Decode,
    Match,
    Mesh,
    Encode,
}

/// A worker's job, and what it does at the moment.
#[derive(Debug, Clone)]
struct AtWork {
    ticket: Ticket,
    request: usize,
    begun: Duration,
    rungs: u8,
    scale: f64,
    rungs_done: u8,
    /// Left of the present rung.
    left: Duration,
    doing: Doing,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Event {
    Arrival(usize),
    Worker(usize),
    Expiry,
}

const FULL: u32 = 0;
const HALF: u32 = 1;
const UNITS: u32 = 640 * 480;

impl World {
    /// One outcome for each request, in the same order. Panics if a property of the scheduler is violated.
    pub(crate) fn run(&self, dice: &mut Dice, requests: &[Request]) -> Vec<Outcome> {
        let mut scheduler = Scheduler::new(self.config);
        self.prime(&mut scheduler, dice);
        let paces = self.paces(dice, requests);
        let mut run = Run {
            paces,
            world: self,
            scheduler,
            requests,
            outcomes: vec![None; requests.len()],
            workers: vec![None; self.config.workers],
            aside: vec![Vec::new(); self.config.workers],
            events: BinaryHeap::new(),
            wakeup: None,
        };
        // One arrival at a time is in the heap.
        if let Some(first) = requests.first() {
            run.events.push(Reverse((first.at, Event::Arrival(0))));
        }
        while let Some(Reverse((now, event))) = run.events.pop() {
            run.handle(now, event);
            run.dispatch(now);
            run.look(now);
        }
        run.outcomes
            .into_iter()
            .map(|outcome| outcome.expect("every request is answered"))
            .collect()
    }

    /// How many times as long as typical everything takes, in each millisecond.
    fn paces(&self, dice: &Dice, requests: &[Request]) -> Vec<f64> {
        let Some(last) = requests.last().filter(|_| self.costs.pace > 0.0) else {
            return vec![1.0];
        };
        // Not the dice of the costs, which are the same at any pace.
        let mut dice = dice.clone();
        let keep = (-1.0 / PACE_LASTS_MS).exp();
        let mut at = 0.0;
        let count = last.at.as_millis() + 1000;
        (0..count)
            .map(|_| {
                at = keep * at + self.costs.pace * (1.0 - keep * keep).sqrt() * dice.normal();
                at.exp()
            })
            .collect()
    }

    /// What a server learns from its dummy pairs.
    fn prime(&self, scheduler: &mut Scheduler<u32, usize>, dice: &mut Dice) {
        for _ in 0..16 {
            let frame = self.costs.draw(dice);
            for (kind, scale) in [(FULL, 1.0), (HALF, 0.25)] {
                let took = |time: Duration| time.mul_f64(scale);
                scheduler.prime(kind, Stage::Decode, UNITS, took(frame.decode));
                scheduler.prime(kind, Stage::Encode(0), UNITS, took(frame.encode));
                for (index, &mesh) in (0..).zip(&frame.mesh) {
                    scheduler.prime(kind, Stage::Mesh(index), UNITS, took(mesh));
                }
                for (index, &rung) in (0..).zip(&frame.rungs) {
                    scheduler.prime(kind, Stage::Rung(index), UNITS, took(rung));
                }
                scheduler.prime(
                    kind,
                    Stage::Step,
                    UNITS,
                    Duration::from_secs_f64(scale * self.costs.step / 1e3),
                );
            }
        }
    }

    pub(crate) fn spec(&self, request: &Request) -> JobSpec<u32> {
        let work = |kind| Work {
            units: UNITS,
            decode: kind,
            matching: kind,
            mesh: (!self.costs.mesh.is_empty()).then_some(kind),
            encode: kind,
            rungs: self.costs.rungs(),
        };
        JobSpec {
            client: ClientId(request.client),
            weight: 1,
            stream: request.stream.map(StreamId),
            urgency: match request.deadline {
                Some(at) => Urgency::Deadline {
                    at,
                    priority: request.priority,
                },
                None => Urgency::Background,
            },
            work: work(FULL),
            half: request.may_halve.then(|| work(HALF)),
            is_mesh_optional: false,
        }
    }
}

struct Run<'a> {
    world: &'a World,
    paces: Vec<f64>,
    scheduler: Scheduler<u32, usize>,
    requests: &'a [Request],
    outcomes: Vec<Option<Outcome>>,
    workers: Vec<Option<AtWork>>,
    aside: Vec<Vec<AtWork>>,
    events: BinaryHeap<Reverse<(Duration, Event)>>,
    wakeup: Option<Duration>,
}

impl Run<'_> {
    fn handle(&mut self, now: Duration, event: Event) {
        match event {
            Event::Arrival(index) => {
                if let Some(next) = self.requests.get(index + 1) {
                    self.events.push(Reverse((next.at, Event::Arrival(index + 1))));
                }
                let spec = self.world.spec(&self.requests[index]);
                let submission = self.scheduler.submit(now, spec, index);
                if let Err(refused) = submission.outcome {
                    let refusal = refused.refusal;
                    let budget = self.requests[index].deadline.map(|at| at - now);
                    if refusal.reason == Reason::DeadlineInfeasible {
                        assert!(
                            refusal.earliest_feasible > budget,
                            "refused {budget:?}, {refusal:?}"
                        );
                    }
                    self.end(refused.job, Outcome::Refused(refusal.reason));
                }
                self.drop_all(submission.dropped);
            }
            Event::Worker(worker) => self.work(now, worker),
            Event::Expiry => {
                self.wakeup = None;
                let dropped = self.scheduler.expire(now);
                self.drop_all(dropped);
            }
        }
    }

    fn drop_all(&mut self, dropped: Vec<Dropped<usize>>) {
        for gone in dropped {
            self.end(gone.job, Outcome::Dropped(gone.reason));
        }
    }

    fn end(&mut self, request: usize, outcome: Outcome) {
        let before = self.outcomes[request].replace(outcome);
        assert_eq!(before, None, "answered twice");
    }

    /// Gives idle workers something to do.
    fn dispatch(&mut self, now: Duration) {
        for worker in 0..self.workers.len() {
            if self.workers[worker].is_some() {
                continue;
            }
            match self.scheduler.next(now, worker) {
                None => {}
                Some(Next::Resume { ticket, verdict }) => {
                    let aside = &mut self.aside[worker];
                    let place = aside.iter().position(|at_work| at_work.ticket == ticket);
                    self.workers[worker] = Some(aside.swap_remove(place.expect("it lies aside")));
                    self.follow(now, worker, verdict);
                }
                Some(Next::Start(dispatch)) => {
                    let request = &self.requests[dispatch.job];
                    let scale = if dispatch.plan.is_half { 0.25 } else { 1.0 };
                    self.never_starts_what_it_cannot_finish(now, request, dispatch.plan.is_half);
                    self.workers[worker] = Some(AtWork {
                        ticket: dispatch.ticket,
                        request: dispatch.job,
                        begun: now,
                        rungs: dispatch.plan.rungs,
                        scale,
                        rungs_done: 0,
                        left: request.frame.rungs[0].mul_f64(scale),
                        doing: Doing::Decode,
                    });
                    let decode = request.frame.decode.mul_f64(scale);
                    self.take(now, worker, decode);
                }
            }
        }
        let wakeup = self.scheduler.next_wakeup().map(|at| at.max(now));
        if let Some(at) = wakeup
            && self.wakeup.is_none_or(|planned| at < planned)
        {
            self.wakeup = Some(at);
            self.events.push(Reverse((at, Event::Expiry)));
        }
    }

    fn never_starts_what_it_cannot_finish(&self, now: Duration, request: &Request, is_half: bool) {
        if self.world.config.policy != stereo_scheduler::Policy::Edf {
            return;
        }
        let kind = if is_half { HALF } else { FULL };
        let cost = |stage| self.scheduler.costs().cost(now, kind, stage, UNITS).typical;
        let mesh = if self.world.costs.mesh.is_empty() {
            Duration::ZERO
        } else {
            cost(Stage::Mesh(0))
        };
        let typical = cost(Stage::Decode) + cost(Stage::Rung(0)) + mesh + cost(Stage::Encode(0));
        assert!(
            request.deadline.is_none_or(|due| now + typical <= due),
            "started at {now:?} what takes {typical:?} and is due at {:?}",
            request.deadline
        );
    }

    /// `worker` has finished what it was doing.
    fn work(&mut self, now: Duration, worker: usize) {
        let at_work = self.workers[worker]
            .as_mut()
            .expect("an event of a worker that works");
        let frame = &self.requests[at_work.request].frame;
        match at_work.doing {
            Doing::Decode => {
                self.scheduler.decoded(now, worker);
                at_work.doing = Doing::Match;
                let base = std::mem::take(&mut at_work.left);
                self.take(now, worker, base);
            }
            Doing::Match => {
                let verdict = if at_work.left.is_zero() {
                    at_work.rungs_done += 1;
                    let more = frame.rungs.get(usize::from(at_work.rungs_done));
                    at_work.left = more.map_or(Duration::ZERO, |rung| rung.mul_f64(at_work.scale));
                    let has_more = at_work.rungs_done < at_work.rungs;
                    self.scheduler.rung_done(now, worker, has_more)
                } else {
                    self.scheduler.step_done(now, worker)
                };
                self.follow(now, worker, verdict);
            }
            Doing::Mesh => {
                self.scheduler.meshed(now, worker);
                self.encode(now, worker);
            }
            Doing::Encode => {
                let finished = self.scheduler.finished(now, worker).expect("it had a job");
                let at_work = self.workers[worker].take().expect("it works");
                let request = &self.requests[at_work.request];
                let reply = request.frame.reply;
                if reply > Duration::ZERO {
                    let spec = self.world.spec(request);
                    self.scheduler.replied(now, &spec, reply);
                }
                self.end(
                    at_work.request,
                    Outcome::Served {
                        begun: at_work.begun,
                        at: now + reply + Duration::from_secs_f64(self.world.costs.way / 1e3),
                        rungs: at_work.rungs_done,
                        predicted: finished.predicted,
                        actual: finished.actual,
                    },
                );
            }
        }
    }

    fn follow(&mut self, now: Duration, worker: usize, verdict: Verdict) {
        let at_work = self.workers[worker].as_mut().expect("it works");
        match verdict {
            Verdict::Continue => self.start_step(now, worker),
            Verdict::Yield => {
                let at_work = self.workers[worker].take().expect("it works");
                self.aside[worker].push(at_work);
                // One is about to change places, and one is of the background class.
                assert!(self.aside[worker].len() <= self.world.config.max_aside + 2);
            }
            Verdict::Finish { because, .. } => {
                assert!(because != StopReason::Complete || at_work.rungs_done == at_work.rungs);
                let mesh = &self.requests[at_work.request].frame.mesh;
                match mesh.get(usize::from(at_work.rungs_done) - 1) {
                    Some(mesh) => {
                        at_work.doing = Doing::Mesh;
                        let mesh = mesh.mul_f64(at_work.scale);
                        self.take(now, worker, mesh);
                    }
                    None => self.encode(now, worker),
                }
            }
            Verdict::Abandon => unreachable!("nobody cancels here"),
        }
    }

    fn encode(&mut self, now: Duration, worker: usize) {
        let at_work = self.workers[worker].as_mut().expect("it works");
        at_work.doing = Doing::Encode;
        let encode = self.requests[at_work.request].frame.encode.mul_f64(at_work.scale);
        self.take(now, worker, encode);
    }

    /// `worker` does something that takes `usual` at the usual pace.
    fn take(&mut self, now: Duration, worker: usize, usual: Duration) {
        let millisecond = usize::try_from(now.as_millis()).expect("a short run");
        let pace = self.paces[millisecond.min(self.paces.len() - 1)];
        self.events
            .push(Reverse((now + usual.mul_f64(pace), Event::Worker(worker))));
    }

    fn start_step(&mut self, now: Duration, worker: usize) {
        let at_work = self.workers[worker].as_mut().expect("it works");
        // A rung is steps of about this length; a hiccup makes the last one long.
        let step = Duration::from_secs_f64(self.world.costs.step * at_work.scale / 1e3);
        let step = if at_work.left < step.mul_f64(1.5) {
            at_work.left
        } else {
            step
        };
        at_work.left -= step;
        self.take(now, worker, step);
    }

    /// Looks at the properties that hold at every moment.
    fn look(&mut self, now: Duration) {
        let state = self.scheduler.snapshot(now);
        assert!(
            state.waiting <= self.world.config.capacity,
            "the queue is bounded"
        );
        assert!(state.background_waiting <= self.world.config.background_capacity + self.workers.len());
        let idle = self.workers.iter().filter(|at_work| at_work.is_none()).count();
        assert!(
            idle == 0 || state.waiting == 0,
            "{idle} idle while {} wait",
            state.waiting
        );
    }
}

/// Sums over the requests of one or more runs.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Tally {
    pub(crate) offered: f64,
    pub(crate) in_budget: f64,
    pub(crate) refused: f64,
    pub(crate) admitted: f64,
    /// Promised and not kept.
    pub(crate) missed: f64,
    pub(crate) rungs: f64,
    pub(crate) seconds: f64,
}

impl Tally {
    /// Counts the requests that came in `[from, until)` seconds.
    pub(crate) fn count(&mut self, requests: &[Request], outcomes: &[Outcome], from: f64, until: f64) {
        self.seconds += until - from;
        let span = Duration::from_secs_f64(from)..Duration::from_secs_f64(until);
        for (request, outcome) in requests
            .iter()
            .zip(outcomes)
            .filter(|(request, _)| span.contains(&request.at))
        {
            self.add(request, *outcome);
        }
    }

    pub(crate) fn add(&mut self, request: &Request, outcome: Outcome) {
        self.offered += 1.0;
        let promised = f64::from(u8::from(request.priority > Priority::BestEffort));
        match outcome {
            Outcome::Served { at, rungs, .. } => {
                self.admitted += 1.0;
                if request.deadline.is_none_or(|due| at <= due) {
                    self.in_budget += 1.0;
                    self.rungs += f64::from(rungs);
                } else {
                    self.missed += promised;
                }
            }
            Outcome::Refused(_) => self.refused += 1.0,
            Outcome::Dropped(DropReason::Expired) => {
                self.admitted += 1.0;
                self.missed += promised;
            }
            Outcome::Dropped(_) => self.admitted += 1.0,
        }
    }

    pub(crate) fn attained(&self) -> f64 {
        self.in_budget / self.offered.max(1.0)
    }

    pub(crate) fn refused(&self) -> f64 {
        self.refused / self.offered.max(1.0)
    }

    /// Of the admitted ones.
    pub(crate) fn missed(&self) -> f64 {
        self.missed / self.admitted.max(1.0)
    }

    pub(crate) fn mean_rungs(&self) -> f64 {
        self.rungs / self.in_budget.max(1.0)
    }

    /// Answers in budget by the second.
    pub(crate) fn goodput(&self) -> f64 {
        self.in_budget / self.seconds
    }
}
