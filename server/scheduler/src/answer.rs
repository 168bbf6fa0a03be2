//! What the scheduler answers.

use std::time::Duration;

use crate::ladder::Level;
use crate::spec::Ticket;

/// What became of a submission, and of the jobs that had to make room for it.
#[derive(Debug)]
pub struct Submission<J> {
    /// Whether the job waits now.
    pub outcome: Result<Ticket, Refused<J>>,
    /// Jobs that left the queue because of this one; each wants an answer.
    pub dropped: Vec<Dropped<J>>,
}

/// A job that was not admitted, handed back.
#[derive(Debug)]
pub struct Refused<J> {
    /// The job.
    pub job: J,
    /// Why, and when it would have been admitted.
    pub refusal: Refusal,
}

/// Why a job is not admitted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Refusal {
    /// Why.
    pub reason: Reason,
    /// The shortest time from now to a deadline that could have been promised; `None` if that isn't known (background jobs).
    pub earliest_feasible: Option<Duration>,
}

impl Refusal {
    /// The same with `more` time needed.
    pub(crate) fn after(self, more: Duration) -> Self {
        Self {
            earliest_feasible: self.earliest_feasible.map(|earliest| earliest + more),
            ..self
        }
    }
}

/// Reasons of a [`Refusal`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Reason {
    /// The deadline has passed.
    Expired,
    /// It would not be met at the cheapest setting, given everything promised already.
    DeadlineInfeasible,
    /// The client has used up its share, and the rest is not free.
    Quota,
    /// As many jobs wait as may.
    QueueFull,
}

/// A job that left the queue without being served.
#[derive(Debug)]
pub struct Dropped<J> {
    /// Its name.
    pub ticket: Ticket,
    /// The job.
    pub job: J,
    /// Why.
    pub reason: DropReason,
}

/// Why a waiting job left the queue without being served.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum DropReason {
    /// Its deadline has passed, or can't be met any more.
    Expired,
    /// A newer frame of its stream has come.
    Superseded,
    /// It was admitted without a promise, and a promised job needed its place.
    Displaced,
}

/// What an idle worker does next.
#[derive(Debug)]
pub enum Next<J> {
    /// A job from its start.
    Start(Dispatch<J>),
    /// Take up a job again that this worker was told to [`Yield`](Verdict::Yield).
    Resume {
        /// Its name.
        ticket: Ticket,
        /// What to do with it, as after a step.
        verdict: Verdict,
    },
}

/// A job on its way to a worker.
#[derive(Debug)]
pub struct Dispatch<J> {
    /// Its name.
    pub ticket: Ticket,
    /// The job.
    pub job: J,
    /// How much of it to do.
    pub plan: Plan,
    /// Jobs that wait behind it, background ones included.
    pub waiting: usize,
}

/// How much of a job is going to be done, as decided at dispatch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Plan {
    /// Match at half resolution.
    pub is_half: bool,
    /// Make the mesh.
    pub has_mesh: bool,
    /// Rungs to run at most, the first included.
    pub rungs: u8,
    /// What the mandatory part (decode, base, mesh, encode) will take nearly always.
    pub mandatory_tail: Duration,
    /// The overload ladder's state when this was decided.
    pub level: Level,
}

/// What a worker does after a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// Run the next step.
    Continue,
    /// Publish what there is.
    Finish {
        /// Make the mesh first. False if none was planned, or if it was optional and there is no time left for it.
        has_mesh: bool,
        /// Why it ends here.
        because: StopReason,
    },
    /// Put the job aside with its matcher and ask for the [`next`](crate::Scheduler::next) one. It comes back as [`Next::Resume`]. A
    /// worker has at most one background job aside, and one with a deadline.
    Yield,
    /// Nobody waits for the result any more: drop the job. The worker is free.
    Abandon,
}

/// Why no further step is run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum StopReason {
    /// All rungs asked for are done, or nothing is left worth doing.
    Complete,
    /// The next rung would not be done before the deadline.
    Budget,
    /// Others that are promised an answer need the worker.
    Load,
    /// A newer frame of the same stream has come.
    Superseded,
}

/// What [`cancel`](crate::Scheduler::cancel) found.
#[derive(Debug)]
pub enum Cancelled<J> {
    /// The job was waiting; here it is.
    Waiting(J),
    /// A worker has it and will be told [`Verdict::Abandon`] after its present step.
    Running,
    /// It has ended already.
    Gone,
}

/// The costs of a finished job.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Finished {
    /// What the stages that were run were expected to take, as known at dispatch; zero if nothing was known.
    pub predicted: Duration,
    /// What they took, without the time it lay aside.
    pub actual: Duration,
}

/// The state of a scheduler, for metrics.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Snapshot {
    /// Jobs with a deadline that wait.
    pub waiting: usize,
    /// Background jobs that wait or lie aside.
    pub background_waiting: usize,
    /// Workers with a job.
    pub busy_workers: usize,
    /// State of the overload ladder.
    pub level: Level,
    /// Mandatory work offered lately, as a share of what the workers can do (1 = all of it); 1/5 s moving average.
    pub mandatory_load: f64,
    /// The same with every rung that was asked for.
    pub full_load: f64,
    /// Time until the workers are through with all mandatory work promised, on the average.
    pub backlog: Duration,
    /// Clients that were active within the last second.
    pub active_clients: usize,
}
