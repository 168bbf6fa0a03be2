//! Where requests wait for a worker: the bounded queue between the async side, which puts jobs in and may take them back, and
//! the worker threads, which block until there is one.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use stereo_scheduler::{DeadlineQueue, Ticket};
use tokio::sync::{oneshot, watch};

use crate::job::{FrameReply, FrameRequest};
use crate::status::ServiceError;

/// What a job ends with.
pub(crate) type Outcome = Result<FrameReply, ServiceError>;

/// Called on the worker after each finished rung.
pub type OnRung = Box<dyn Fn(stereo::Quality) + Send>;

/// One admitted request on its way through a worker.
pub(crate) struct Job {
    pub(crate) request: FrameRequest,
    pub(crate) enqueued_at: Instant,
    on_rung: Option<OnRung>,
    reply: oneshot::Sender<Outcome>,
    /// Held for its drop: while it lives, the job counts as admitted.
    _admitted: Option<Admitted>,
}

impl Job {
    /// A job outside any queue, and the end its outcome arrives at.
    pub(crate) fn detached(request: FrameRequest) -> (Self, oneshot::Receiver<Outcome>) {
        let (reply, outcome) = oneshot::channel();
        (
            Self {
                request,
                enqueued_at: Instant::now(),
                on_rung: None,
                reply,
                _admitted: None,
            },
            outcome,
        )
    }

    /// Whether nobody waits for the outcome any more.
    pub(crate) fn is_abandoned(&self) -> bool {
        self.reply.is_closed()
    }

    /// Tells whoever watches that a rung is finished.
    pub(crate) fn report_rung(&self, quality: stereo::Quality) {
        if let Some(on_rung) = &self.on_rung {
            on_rung(quality);
        }
    }

    /// Ends the job. The requests of this job and its place among the admitted ones are given up first, so that whoever gets the
    /// outcome finds them free.
    pub(crate) fn answer(self, outcome: Outcome) {
        let Self {
            request,
            reply,
            _admitted,
            ..
        } = self;
        drop((request, _admitted));
        // An error means that the client has gone: its outcome interests nobody.
        drop(reply.send(outcome));
    }

    /// Ends a job whose deadline has passed before a worker took it.
    pub(crate) fn expire(self) {
        let budget = self.request.options.latency_budget;
        self.answer(Err(ServiceError::Expired {
            budget,
            earliest_feasible: None,
        }));
    }
}

/// One of the admitted jobs, counted while this lives.
struct Admitted(watch::Sender<usize>);

impl Admitted {
    fn new(count: &watch::Sender<usize>) -> Self {
        count.send_modify(|n| *n += 1);
        Self(count.clone())
    }
}

impl Drop for Admitted {
    fn drop(&mut self) {
        self.0.send_modify(|n| *n -= 1);
    }
}

/// The caller's end of an admitted job.
pub(crate) struct Admission {
    pub(crate) ticket: Ticket,
    pub(crate) outcome: oneshot::Receiver<Outcome>,
}

/// Jobs that wait, and the state of the service that decides whether more may.
pub(crate) struct Dispatch {
    waiting: Mutex<Waiting>,
    wake: Condvar,
    epoch: Instant,
    admitted: watch::Sender<usize>,
}

struct Waiting {
    queue: DeadlineQueue<Job>,
    phase: Phase,
}

#[derive(Clone, Copy, PartialEq, Eq, PartialOrd)]
enum Phase {
    Open,
    Draining,
    Closed,
}

impl Dispatch {
    pub(crate) fn new(capacity: usize) -> Self {
        Self {
            waiting: Mutex::new(Waiting {
                queue: DeadlineQueue::new(capacity),
                phase: Phase::Open,
            }),
            wake: Condvar::new(),
            epoch: Instant::now(),
            admitted: watch::Sender::new(0),
        }
    }

    /// The moment `instant` in the scheduler's time.
    pub(crate) fn scheduler_time(&self, instant: Instant) -> Duration {
        instant.saturating_duration_since(self.epoch)
    }

    /// Puts a request in the queue and wakes a worker.
    pub(crate) fn push(
        &self,
        request: FrameRequest,
        on_rung: Option<OnRung>,
    ) -> Result<Admission, ServiceError> {
        let mut waiting = self.lock();
        if waiting.phase != Phase::Open {
            return Err(ServiceError::Draining);
        }
        let enqueued_at = Instant::now();
        let now = self.scheduler_time(enqueued_at);
        let budget = request.options.latency_budget;
        let deadline = self.scheduler_time(request.deadline());
        if deadline <= now {
            return Err(ServiceError::Expired {
                budget,
                earliest_feasible: None,
            });
        }
        let expired = waiting.queue.take_expired(now);
        let (reply, outcome) = oneshot::channel();
        let admitted = Some(Admitted::new(&self.admitted));
        let job = Job {
            request,
            enqueued_at,
            on_rung,
            reply,
            _admitted: admitted,
        };
        let pushed = waiting.queue.push(deadline, job);
        drop(waiting);
        expired.into_iter().for_each(Job::expire);
        match pushed {
            Ok(ticket) => {
                self.wake.notify_one();
                Ok(Admission { ticket, outcome })
            }
            Err(full) => Err(ServiceError::QueueFull {
                limit: full.capacity,
                earliest_feasible: None,
            }),
        }
    }

    /// Takes a job back that no worker has taken yet.
    pub(crate) fn take_back(&self, ticket: Ticket) -> Option<Job> {
        self.lock().queue.remove(ticket)
    }

    /// Blocks until there is a live job, and says how many wait behind it; `None` once the queue is closed. Expired and abandoned
    /// jobs on the way are answered or dropped unread.
    pub(crate) fn take(&self) -> Option<(Job, usize)> {
        let mut waiting = self.lock();
        loop {
            let expired = waiting.queue.take_expired(self.scheduler_time(Instant::now()));
            if !expired.is_empty() {
                drop(waiting);
                expired.into_iter().for_each(Job::expire);
                waiting = self.lock();
                continue;
            }
            match waiting.queue.pop() {
                Some(job) if job.is_abandoned() => drop(job),
                Some(job) => return Some((job, waiting.queue.len())),
                None if waiting.phase == Phase::Closed => return None,
                None => waiting = self.wake.wait(waiting).unwrap_or_else(PoisonError::into_inner),
            }
        }
    }

    /// How many jobs wait.
    pub(crate) fn depth(&self) -> usize {
        self.lock().queue.len()
    }

    /// Whether new work is refused.
    pub(crate) fn is_draining(&self) -> bool {
        self.lock().phase != Phase::Open
    }

    /// Refuses new work from now on.
    pub(crate) fn drain(&self) {
        let mut waiting = self.lock();
        if waiting.phase == Phase::Open {
            waiting.phase = Phase::Draining;
        }
    }

    /// Waits until every admitted job has ended.
    pub(crate) async fn drained(&self) {
        // The sender lives in `self`, so waiting can't fail.
        drop(self.admitted.subscribe().wait_for(|&n| n == 0).await);
    }

    /// Ends the workers as soon as the queue is empty.
    pub(crate) fn close(&self) {
        self.lock().phase = Phase::Closed;
        self.wake.notify_all();
    }

    fn lock(&self) -> MutexGuard<'_, Waiting> {
        // Nothing in this file panics while it holds the lock; if it did, the queue would still be whole.
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
