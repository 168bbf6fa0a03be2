//! The worker threads. Each owns its matchers and buffers, takes the job that the scheduler gives it, and carries it from image files to
//! encoded bodies, asking after every step whether to go on. The only place where pixels and deadlines meet.

mod climb;
mod fault;
mod half;
mod helpers;
mod prime;
mod rig;
mod spares;
mod watch;
mod worker;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use stereo::Level;
use tokio::sync::watch as signal;

pub(crate) use self::climb::Stopped;
pub(crate) use self::helpers::Helpers;
#[cfg(test)]
pub(crate) use self::prime::dummy_request;
use self::worker::{Ended, Run, Worker};
use crate::config::Fault;
use crate::dispatch::{Dispatch, Seat, Task};
use crate::metrics::Metrics;
use crate::status::ServiceError;

/// What a worker does with a frame that it has taken or goes on with. An argument of the pool, so that a test can give one that panics
/// or hangs.
pub(crate) type Process = dyn Fn(&mut Worker, &mut Run, &Seat) -> Result<Ended, Stopped> + Send + Sync;

/// What all workers share.
pub(crate) struct Shared {
    pub(crate) dispatch: Arc<Dispatch>,
    /// Threads that stand in for workers that have nothing to do; `None` = every frame is matched by one worker alone.
    pub(crate) helpers: Option<Helpers>,
    pub(crate) metrics: Arc<Metrics>,
    /// Name of this server in reports.
    pub(crate) instance: String,
    /// How the workers' dummy pairs went.
    pub(crate) priming: signal::Sender<Priming>,
    /// Set when no more workers can be replaced.
    pub(crate) is_crippled: AtomicBool,
}

/// Workers that are done with their dummy pair.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Priming {
    /// It was matched.
    pub(crate) succeeded: usize,
    /// It was not, which is a fault of the server.
    pub(crate) failed: usize,
}

/// When a worker counts as stuck, and how often that may happen.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Patience {
    /// Longest time without a finished step.
    pub(crate) stuck_after: Duration,
    /// Threads that may be given up in the life of the process. Each keeps its memory, for a thread can't be ended from outside.
    pub(crate) replacements: u32,
}

/// The threads; they end once the queue is closed and empty.
pub(crate) struct Pool {
    shared: Arc<Shared>,
    threads: Arc<Threads>,
    watch: Option<JoinHandle<()>>,
}

/// The threads of the workers by their numbers; those that were given up are let go.
struct Threads {
    workers: Mutex<Vec<Option<JoinHandle<()>>>>,
    level: Level,
    process: Arc<Process>,
    is_closing: watch::Closing,
}

impl Pool {
    /// Starts `count` workers, which prime themselves at once, and the thread that watches over them.
    pub(crate) fn start(
        count: u32,
        level: Level,
        patience: Patience,
        shared: &Arc<Shared>,
        fault: Option<Fault>,
    ) -> std::io::Result<Self> {
        Self::start_with(count, level, patience, shared, fault::process(fault))
    }

    fn start_with(
        count: u32,
        level: Level,
        patience: Patience,
        shared: &Arc<Shared>,
        process: Arc<Process>,
    ) -> std::io::Result<Self> {
        let mut pool = Self {
            shared: Arc::clone(shared),
            threads: Arc::new(Threads {
                workers: Mutex::new((0..count).map(|_| None).collect()),
                level,
                process,
                is_closing: watch::Closing::default(),
            }),
            watch: None,
        };
        let started = (0..count as usize)
            .try_for_each(|index| pool.threads.spawn(shared, shared.dispatch.seat(index)))
            .and_then(|()| watch::start(Arc::clone(shared), Arc::clone(&pool.threads), patience));
        match started {
            Ok(watch) => {
                pool.watch = Some(watch);
                Ok(pool)
            }
            Err(error) => {
                shared.dispatch.close();
                Err(error)
            }
        }
    }

    /// Waits until every worker has ended. Blocks.
    pub(crate) fn join(self) {
        self.shared.dispatch.close();
        self.threads.is_closing.close();
        if let Some(watch) = self.watch {
            // It catches nothing that could panic; should it all the same, the workers still count.
            drop(watch.join());
        }
        let workers = std::mem::take(&mut *self.threads.lock());
        for thread in workers.into_iter().flatten() {
            // A worker's loop catches the panics of its jobs; should it end by one all the same, the others still count.
            drop(thread.join());
        }
    }
}

impl Drop for Threads {
    fn drop(&mut self) {
        self.is_closing.close();
    }
}

impl Threads {
    /// Starts the thread of a seat; the one that had the place before is let go.
    fn spawn(&self, shared: &Arc<Shared>, seat: Seat) -> std::io::Result<()> {
        let (index, generation) = (seat.index(), seat.generation());
        let name = match generation {
            0 => format!("stereo-worker-{index}"),
            again => format!("stereo-worker-{index}.{again}"),
        };
        let worker = Worker::new(index, self.level, Arc::clone(shared));
        let process = Arc::clone(&self.process);
        let thread = std::thread::Builder::new()
            .name(name)
            .spawn(move || run(worker, &seat, &*process))?;
        if let Some(place) = self.lock().get_mut(index) {
            *place = Some(thread);
        }
        Ok(())
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Vec<Option<JoinHandle<()>>>> {
        self.workers.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The loop of one worker.
fn run(mut worker: Worker, seat: &Seat, process: &Process) {
    // Those that take the place of another only have to make their buffers: the costs are known by then.
    if seat.generation() == 0 {
        let primed = guarded(&mut worker, prime::prime);
        worker.shared().priming.send_modify(|priming| match &primed {
            Ok(()) => priming.succeeded += 1,
            Err(_) => priming.failed += 1,
        });
        if let Err(stopped) = primed {
            tracing::error!(
                worker = seat.index(),
                ?stopped,
                "the dummy pair could not be matched"
            );
        }
    }
    while let Some(task) = seat.take() {
        let taken = match task {
            Task::Start(taken) => Some(Run::new(taken)),
            Task::Resume(ticket, verdict) => worker.pick_up(ticket, verdict),
        };
        // What was put aside by a thread that is gone has been answered.
        let Some(mut run) = taken else {
            let _ = seat.failed();
            continue;
        };
        let ended = guarded(&mut worker, |worker| process(worker, &mut run, seat));
        settle(&mut worker, run, seat, ended);
    }
}

/// Tells the scheduler and the client how a frame went.
fn settle(worker: &mut Worker, run: Run, seat: &Seat, ended: Result<Ended, Stopped>) {
    let outcome = match ended {
        Ok(Ended::Aside) => return worker.put_aside(run),
        Ok(Ended::Reply(mut reply)) => match seat.finished() {
            Ok(costs) => {
                reply.costs = costs.map(|costs| (costs.predicted, costs.actual));
                Ok(*reply)
            }
            // It has been answered for this worker.
            Err(_) => return,
        },
        Err(Stopped::Failed(error)) => {
            let _ = seat.failed();
            Err(error)
        }
        // The scheduler has said so itself.
        Err(Stopped::Abandoned | Stopped::Replaced) => return,
    };
    run.job.answer(outcome);
}

/// Runs `work`; a panic in it is counted, fails only this piece of work, and costs the worker its matcher and buffers.
fn guarded<T>(
    worker: &mut Worker,
    work: impl FnOnce(&mut Worker) -> Result<T, Stopped>,
) -> Result<T, Stopped> {
    match catch_unwind(AssertUnwindSafe(|| work(worker))) {
        Ok(result) => result,
        Err(_) => {
            worker.rebuild();
            worker.shared().metrics.worker_panics.inc();
            tracing::error!(
                worker = worker.index(),
                "a frame made the worker panic; its matcher is rebuilt"
            );
            Err(Stopped::Failed(ServiceError::Internal(
                "a fault while matching".to_owned(),
            )))
        }
    }
}

impl Shared {
    /// Whether workers that get stuck can still be replaced.
    pub(crate) fn is_crippled(&self) -> bool {
        self.is_crippled.load(Ordering::Relaxed)
    }
}

#[cfg(test)]
mod tests;
