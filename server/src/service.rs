//! The waist: every transport hands its frames in here, and every frame that comes in here is answered.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use stereo_scheduler::Ticket;
use tokio::sync::watch;
use tokio::time::timeout_at;

use crate::StartError;
use crate::config::Config;
pub use crate::dispatch::OnRung;
use crate::dispatch::{Admission, Dispatch};
use crate::job::{FrameReply, FrameRequest};
use crate::pool::{CostBook, Pool, Priming, Shared};
use crate::status::ServiceError;

/// The queue and the workers behind it.
pub struct Service {
    shared: Arc<Shared>,
    workers: usize,
    /// Taken by whoever stops the service.
    pool: Mutex<Option<Pool>>,
}

/// What is going on inside, for `/readyz` and logs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Health {
    /// Worker threads in all.
    pub workers: usize,
    /// Those that have matched their dummy pair.
    pub workers_primed: usize,
    /// Those that could not match it.
    pub workers_failed: usize,
    /// Requests that wait for a worker.
    pub queue_depth: usize,
    /// Whether new work is refused because the server is stopping.
    pub is_draining: bool,
    /// Frames that failed because a worker panicked, since the start.
    pub panics: u64,
}

impl Service {
    /// Starts the workers, which prime themselves in the background.
    ///
    /// # Errors
    /// [`StartError`].
    pub fn start(config: &Config) -> Result<Self, StartError> {
        config.validate()?;
        let workers = &config.workers;
        let level = workers.level()?;
        // Lossless: the capacity is at most 65536.
        let dispatch = Arc::new(Dispatch::new(workers.queue_capacity as usize));
        let shared = Arc::new(Shared {
            dispatch,
            costs: CostBook::default(),
            instance: config.instance.clone(),
            priming: watch::Sender::new(Priming::default()),
            panics: AtomicU64::new(0),
        });
        let pool = Pool::start(workers.count, level, &shared).map_err(|source| StartError::Threads {
            count: workers.count,
            source,
        })?;
        Ok(Self {
            shared,
            workers: workers.count as usize,
            pool: Mutex::new(Some(pool)),
        })
    }

    /// Carries one frame to its reply. Dropping the future abandons the frame: it leaves the queue at once, or its worker stops
    /// at the next step.
    ///
    /// # Errors
    /// [`ServiceError`]: refused before work (queue full, draining), expired while waiting (at the deadline, whether or not a
    /// worker is free), or failed. A result with fewer rungs than asked for, or one that came late because its first rung took
    /// too long, is a success whose report says so.
    pub async fn submit(&self, request: FrameRequest) -> Result<FrameReply, ServiceError> {
        self.submit_watched(request, None).await
    }

    /// As [`submit`](Self::submit), with `on_rung` called on the worker's thread after each finished rung.
    ///
    /// # Errors
    /// As [`submit`](Self::submit).
    pub async fn submit_watched(
        &self,
        request: FrameRequest,
        on_rung: Option<OnRung>,
    ) -> Result<FrameReply, ServiceError> {
        let request_id = request.ids.request_id.clone();
        let outcome = self.admit(request, on_rung).await;
        match &outcome {
            Ok(FrameReply { report, .. }) => tracing::debug!(
                request_id,
                queued = ?report.queued,
                decoded = ?report.decoded,
                matched = ?report.matched,
                meshed = ?report.meshed,
                encoded = ?report.encoded,
                iterations = report.iterations_run,
                deadline_met = report.deadline_met,
                "answered"
            ),
            Err(error) => tracing::debug!(request_id, reason = error.reason_name(), %error, "refused"),
        }
        outcome
    }

    async fn admit(
        &self,
        request: FrameRequest,
        on_rung: Option<OnRung>,
    ) -> Result<FrameReply, ServiceError> {
        let deadline = request.deadline();
        let budget = request.options.latency_budget;
        let dispatch = &self.shared.dispatch;
        let Admission { ticket, mut outcome } = dispatch.push(request, on_rung)?;
        let _waiting = LeaveOnDrop { dispatch, ticket };
        let received = match timeout_at(deadline.into(), &mut outcome).await {
            Ok(received) => received,
            Err(_) if dispatch.take_back(ticket).is_some() => {
                return Err(ServiceError::Expired {
                    budget,
                    earliest_feasible: None,
                });
            }
            // A worker has it: it stops after the rung it is at.
            Err(_) => outcome.await,
        };
        received.unwrap_or_else(|_| Err(ServiceError::Internal("the worker went away".to_owned())))
    }

    /// What is going on inside.
    #[must_use]
    pub fn health(&self) -> Health {
        let Priming { succeeded, failed } = *self.shared.priming.borrow();
        Health {
            workers: self.workers,
            workers_primed: succeeded,
            workers_failed: failed,
            queue_depth: self.shared.dispatch.depth(),
            is_draining: self.shared.dispatch.is_draining(),
            panics: self.shared.panics.load(Ordering::Relaxed),
        }
    }

    /// Waits until every worker is done with its dummy pair, and says whether all could match it.
    pub async fn primed(&self) -> bool {
        let mut priming = self.shared.priming.subscribe();
        let done = priming
            .wait_for(|priming| priming.succeeded + priming.failed >= self.workers)
            .await;
        // The sender lives in `self`, so waiting can't fail.
        done.is_ok_and(|priming| priming.failed == 0)
    }

    /// Refuses new work from now on, waits until everything admitted is finished or expired, and ends the workers.
    pub async fn drain(&self) {
        self.shared.dispatch.drain();
        self.shared.dispatch.drained().await;
        self.shared.dispatch.close();
        let pool = self.pool.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(pool) = pool {
            // Fails only if the runtime is being torn down, and then nothing is left to wait for.
            drop(tokio::task::spawn_blocking(|| pool.join()).await);
        }
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        self.shared.dispatch.close();
    }
}

/// Takes the job out of the queue when the caller stops waiting for it.
struct LeaveOnDrop<'a> {
    dispatch: &'a Dispatch,
    ticket: Ticket,
}

impl Drop for LeaveOnDrop<'_> {
    fn drop(&mut self) {
        drop(self.dispatch.take_back(self.ticket));
    }
}

#[cfg(test)]
mod tests;
