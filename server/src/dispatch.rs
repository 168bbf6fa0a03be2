//! Where requests wait for a worker: the scheduler between the async side, which puts jobs in and may take them back, and the worker
//! threads, which block until there is one and ask after every step whether to go on.

mod answers;
mod idle;
mod job;
mod kind;
mod seat;

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use stereo_scheduler::{
    Cancelled, Config as Limits, JobSpec, Policy, Scheduler, Snapshot, Stage, Submission, Ticket,
};
use tokio::sync::{oneshot, watch};

use self::answers::priority;
pub(crate) use self::idle::Idle;
use self::job::Admitted;
pub use self::job::{Delivery, OnPartial, OnRung};
pub(crate) use self::job::{Job, Outcome};
pub(crate) use self::kind::{Kind, encode_kind, least_work, work};
pub(crate) use self::seat::{Replaced, Seat, Task};
use crate::clients::Clients;
use crate::job::FrameRequest;
use crate::metrics::Metrics;
use crate::status::ServiceError;

/// Background jobs that may wait: those of a few batches, which hold back what the workers have no time for.
pub(crate) const BACKGROUND_CAPACITY: usize = 256;

/// The caller's end of an admitted job.
pub(crate) struct Admission {
    pub(crate) ticket: Ticket,
    pub(crate) outcome: oneshot::Receiver<Outcome>,
}

/// What the queue is told at its start.
#[derive(Debug, Clone, Default)]
pub(crate) struct Setting {
    pub(crate) workers: usize,
    /// Jobs with a deadline that may wait.
    pub(crate) capacity: usize,
    pub(crate) policy: Policy,
    /// Who has which weight.
    pub(crate) clients: Arc<Clients>,
    /// Whether workers that have nothing to do help others.
    pub(crate) is_splitting: bool,
}

/// Jobs that wait or run, and the state of the service that decides whether more may.
pub(crate) struct Dispatch {
    state: Mutex<State>,
    wake: Condvar,
    epoch: Instant,
    setting: Setting,
    idle: Arc<Idle>,
    admitted: watch::Sender<usize>,
    metrics: Arc<Metrics>,
}

struct State {
    scheduler: Scheduler<Kind, Arc<Job>>,
    phase: Phase,
    slots: Vec<Slot>,
}

/// What is known about the worker of one index.
struct Slot {
    /// Counts the threads that have had this index; only the last one may speak for it.
    generation: u64,
    job: Option<(Ticket, Arc<Job>)>,
    /// Jobs that lie aside, each with its matcher: one of the background class at most, and one with a deadline.
    aside: Vec<(Ticket, Arc<Job>)>,
    /// When the worker last said that it got on.
    beat: Instant,
}

#[derive(Clone, Copy, PartialEq, Eq, PartialOrd)]
enum Phase {
    Open,
    Draining,
    Closed,
}

impl Dispatch {
    pub(crate) fn new(setting: Setting, metrics: Arc<Metrics>) -> Self {
        let epoch = Instant::now();
        let slot = || Slot {
            generation: 0,
            job: None,
            aside: Vec::new(),
            beat: epoch,
        };
        Self {
            state: Mutex::new(State {
                scheduler: Scheduler::new(Limits {
                    policy: setting.policy,
                    workers: setting.workers,
                    capacity: setting.capacity,
                    background_capacity: BACKGROUND_CAPACITY,
                    ..Limits::default()
                }),
                phase: Phase::Open,
                slots: (0..setting.workers).map(|_| slot()).collect(),
            }),
            wake: Condvar::new(),
            epoch,
            setting,
            idle: Arc::default(),
            admitted: watch::Sender::new(0),
            metrics,
        }
    }

    /// The workers that have nothing to do.
    pub(crate) fn idle(&self) -> &Arc<Idle> {
        &self.idle
    }

    /// The moment `instant` in the scheduler's time.
    pub(crate) fn scheduler_time(&self, instant: Instant) -> Duration {
        instant.saturating_duration_since(self.epoch)
    }

    /// A request as the scheduler knows it.
    pub(crate) fn spec(&self, request: &FrameRequest) -> JobSpec<Kind> {
        let weight = self.setting.clients.weight(&request.client);
        kind::spec(request, weight, |instant| self.scheduler_time(instant))
    }

    /// Lets a request wait for a worker, and wakes one.
    pub(crate) fn submit(
        &self,
        request: FrameRequest,
        delivery: Delivery,
    ) -> Result<Admission, ServiceError> {
        let mut spec = self.spec(&request);
        let budget = request.options.latency_budget;
        let received_at = request.received_at;
        let (mut job, outcome) = Job::new(request, delivery, Admitted::new(&self.admitted));
        let mut state = self.lock();
        if state.phase != Phase::Open {
            return Err(ServiceError::Draining);
        }
        let now = Instant::now();
        if self.setting.is_splitting {
            let waiting = state.scheduler.snapshot(self.scheduler_time(now)).waiting;
            // Those that wait get a worker each, and so does this one; what is left may help it.
            job.is_split = self.idle.spare() > waiting + 1;
            if job.is_split {
                kind::split(&mut spec);
            }
        }
        let submission = state
            .scheduler
            .submit(self.scheduler_time(now), spec, Arc::new(job));
        self.metrics.scheduled(now.elapsed());
        drop(state);
        let Submission {
            outcome: admitted,
            dropped,
        } = submission;
        self.answer_dropped(dropped);
        match admitted {
            Ok(ticket) => {
                self.wake.notify_one();
                Ok(Admission { ticket, outcome })
            }
            Err(refused) => Err(self.refused(refused.refusal, budget, received_at)),
        }
    }

    /// The reply to a request like `spec` was handed over `took` after it was encoded.
    pub(crate) fn replied(&self, spec: &JobSpec<Kind>, took: Duration) {
        let now = self.scheduler_time(Instant::now());
        self.lock().scheduler.replied(now, spec, took);
    }

    /// What [`submit`](Self::submit) would refuse now, for a request whose body has not been read.
    pub(crate) fn assess(
        &self,
        spec: &JobSpec<Kind>,
        budget: Duration,
        received_at: Instant,
    ) -> Result<(), ServiceError> {
        let state = self.lock();
        let now = self.scheduler_time(Instant::now());
        let assessed = state.scheduler.assess(now, spec);
        drop(state);
        assessed.map_err(|refusal| self.refused(refusal, budget, received_at))
    }

    /// Takes a job back whose client has gone; a worker that has it stops after its present step. True if that ended the job.
    pub(crate) fn cancel(&self, ticket: Ticket) -> bool {
        let mut state = self.lock();
        let now = self.scheduler_time(Instant::now());
        let cancelled = state.scheduler.cancel(now, ticket);
        drop(state);
        match cancelled {
            Cancelled::Waiting(_) | Cancelled::Running => true,
            Cancelled::Gone => false,
        }
    }

    /// Answers the jobs that can't be met any more, whether or not a worker is free.
    pub(crate) fn expire(&self) {
        let mut state = self.lock();
        let now = self.scheduler_time(Instant::now());
        let dropped = state.scheduler.expire(now);
        drop(state);
        self.answer_dropped(dropped);
    }

    /// A stage of a dummy pair took `took`.
    pub(crate) fn prime(&self, kind: Kind, stage: Stage, units: u32, took: Duration) {
        self.lock().scheduler.prime(kind, stage, units, took);
    }

    /// Gives up every worker that has not said for `limit` that it gets on: its job is answered with `error`. The seats of those that
    /// take their places.
    pub(crate) fn replace_stuck(self: &Arc<Self>, limit: Duration, error: &ServiceError) -> Vec<Seat> {
        let mut lost = Vec::new();
        let mut seats = Vec::new();
        let mut state = self.lock();
        let now = Instant::now();
        let at = self.scheduler_time(now);
        for index in 0..state.slots.len() {
            let slot = &mut state.slots[index];
            if slot.job.is_none() || now.saturating_duration_since(slot.beat) < limit {
                continue;
            }
            lost.extend(slot.job.take());
            lost.append(&mut slot.aside);
            slot.generation += 1;
            seats.push(Seat::new(self, index, slot.generation));
            state.scheduler.replaced(at, index);
        }
        drop(state);
        for (_, job) in lost {
            job.answer(Err(error.clone()));
        }
        seats
    }

    /// The seat of a worker's first thread.
    pub(crate) fn seat(self: &Arc<Self>, index: usize) -> Seat {
        Seat::new(self, index, 0)
    }

    /// The scheduler's state.
    pub(crate) fn snapshot(&self) -> Snapshot {
        let now = self.scheduler_time(Instant::now());
        self.lock().scheduler.snapshot(now)
    }

    /// How many jobs wait.
    pub(crate) fn depth(&self) -> usize {
        let snapshot = self.snapshot();
        snapshot.waiting + snapshot.background_waiting
    }

    /// Whether new work is refused.
    pub(crate) fn is_draining(&self) -> bool {
        self.lock().phase != Phase::Open
    }

    /// Refuses new work from now on.
    pub(crate) fn drain(&self) {
        let mut state = self.lock();
        if state.phase == Phase::Open {
            state.phase = Phase::Draining;
        }
    }

    /// Waits until every admitted job has ended.
    pub(crate) async fn drained(&self) {
        // The sender lives in `self`, so waiting can't fail.
        drop(self.admitted.subscribe().wait_for(|&n| n == 0).await);
    }

    /// Ends the workers as soon as nothing waits.
    pub(crate) fn close(&self) {
        self.lock().phase = Phase::Closed;
        self.wake.notify_all();
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        // Nothing that is called while it is held panics; if it did, the queue would still be whole.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
