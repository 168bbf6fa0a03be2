//! The worker threads. Each owns one matcher and its buffers, takes the job that is due first, and carries it from image files
//! to encoded bodies. The only place where pixels and deadlines meet.

mod costs;
mod plan;
mod prime;
mod worker;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread::JoinHandle;

use stereo::Level;
use tokio::sync::watch;

pub(crate) use self::costs::CostBook;
pub(crate) use self::worker::{Stopped, Worker};
use crate::dispatch::{Dispatch, Job};
use crate::job::FrameReply;
use crate::status::ServiceError;

/// What a worker does with a job. An argument of the pool, so that a test can give one that panics.
pub(crate) type Process = dyn Fn(&mut Worker, &Job, usize) -> Result<FrameReply, Stopped> + Send + Sync;

/// What all workers share.
pub(crate) struct Shared {
    pub(crate) dispatch: Arc<Dispatch>,
    pub(crate) costs: CostBook,
    /// Name of this server in reports.
    pub(crate) instance: String,
    /// How the workers' dummy pairs went.
    pub(crate) priming: watch::Sender<Priming>,
    /// Frames that failed because a worker panicked.
    pub(crate) panics: AtomicU64,
}

/// Workers that are done with their dummy pair.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Priming {
    /// It was matched.
    pub(crate) succeeded: usize,
    /// It was not, which is a fault of the server.
    pub(crate) failed: usize,
}

/// The threads; they end once the queue is closed and empty.
pub(crate) struct Pool {
    threads: Vec<JoinHandle<()>>,
}

impl Pool {
    /// Starts `count` workers, which prime themselves at once.
    pub(crate) fn start(count: u32, level: Level, shared: &Arc<Shared>) -> std::io::Result<Self> {
        Self::start_with(count, level, shared, &(Arc::new(Worker::process) as Arc<Process>))
    }

    fn start_with(
        count: u32,
        level: Level,
        shared: &Arc<Shared>,
        process: &Arc<Process>,
    ) -> std::io::Result<Self> {
        let spawn = |index: u32| {
            let (shared, process) = (Arc::clone(shared), Arc::clone(process));
            std::thread::Builder::new()
                .name(format!("stereo-worker-{index}"))
                .spawn(move || run(Worker::new(index, level, shared), &*process))
        };
        let threads = (0..count).map(spawn).collect::<std::io::Result<Vec<_>>>();
        if threads.is_err() {
            shared.dispatch.close();
        }
        threads.map(|threads| Self { threads })
    }

    /// Waits until every worker has ended. Blocks.
    pub(crate) fn join(self) {
        for thread in self.threads {
            // A worker's loop catches the panics of its jobs; should it end by one all the same, the others still count.
            drop(thread.join());
        }
    }
}

/// The loop of one worker.
fn run(mut worker: Worker, process: &Process) {
    match guarded(&mut worker, prime::prime) {
        Ok(()) => worker
            .shared()
            .priming
            .send_modify(|priming| priming.succeeded += 1),
        Err(stopped) => {
            tracing::error!(
                worker = worker.index(),
                ?stopped,
                "the dummy pair could not be matched"
            );
            worker.shared().priming.send_modify(|priming| priming.failed += 1);
        }
    }
    let shared = worker.shared();
    while let Some((job, depth)) = shared.dispatch.take() {
        match guarded(&mut worker, |worker| process(worker, &job, depth)) {
            Ok(reply) => job.answer(Ok(reply)),
            Err(Stopped::Failed(error)) => job.answer(Err(error)),
            Err(Stopped::Abandoned) => drop(job),
        }
    }
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
            worker.shared().panics.fetch_add(1, Ordering::Relaxed);
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

#[cfg(test)]
mod tests;
