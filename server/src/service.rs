//! The waist: every transport hands its frames in here, and every frame that comes in here is answered, and counted once.

mod health;
mod leaving;

use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use stereo_scheduler::JobSpec;
use tokio::sync::watch;
use tokio::time::timeout_at;
use tracing::Instrument;

pub use self::health::Health;
use self::leaving::Leaving;
use crate::StartError;
use crate::clients::Clients;
use crate::config::Config;
use crate::dispatch::{Admission, Dispatch, Kind, Setting};
pub use crate::dispatch::{Delivery, OnPartial, OnRung};
use crate::job::{FrameReply, FrameRequest, PriorityClass};
use crate::metrics::{CANCELLED, Metrics};
use crate::pool::{Helpers, Patience, Pool, Priming, Shared};
use crate::status::ServiceError;
use crate::traces;

/// The queue and the workers behind it.
pub struct Service {
    shared: Arc<Shared>,
    clients: Arc<Clients>,
    workers: usize,
    /// Taken by whoever stops the service.
    pool: Mutex<Option<Pool>>,
    draining: watch::Sender<bool>,
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
        let count = workers.count as usize;
        let metrics = Arc::new(Metrics::new());
        let clients = Arc::new(Clients::new(config));
        metrics.workers.set(workers.count.into());
        let setting = Setting {
            workers: count,
            // Lossless: the capacity is at most 65536.
            capacity: workers.queue_capacity as usize,
            policy: workers.policy.0,
            clients: Arc::clone(&clients),
            is_splitting: workers.split_frames,
        };
        let no_threads = |source| StartError::Threads {
            count: workers.count,
            source,
        };
        let dispatch = Arc::new(Dispatch::new(setting, Arc::clone(&metrics)));
        let helpers = match workers.split_frames {
            true => Helpers::start(count, &dispatch).map_err(no_threads)?,
            false => None,
        };
        let shared = Arc::new(Shared {
            dispatch,
            helpers,
            metrics,
            instance: config.instance.clone(),
            priming: watch::Sender::new(Priming::default()),
            is_crippled: AtomicBool::new(false),
        });
        let patience = Patience {
            stuck_after: workers.stuck_after,
            replacements: workers.replacements,
        };
        let pool = Pool::start(workers.count, level, patience, &shared, workers.fault).map_err(no_threads)?;
        Ok(Self {
            shared,
            clients,
            workers: count,
            pool: Mutex::new(Some(pool)),
            draining: watch::Sender::new(false),
        })
    }

    /// Carries one frame to its reply. Dropping the future abandons the frame: it leaves the queue at once, or its worker stops
    /// at the next step.
    ///
    /// # Errors
    /// [`ServiceError`]: refused before work (it can't be met, queue full, share used up, draining), expired while waiting (at the
    /// deadline, whether or not a worker is free), superseded, or failed. A result with fewer rungs than asked for, or one that came
    /// late because its first rung took too long, is a success whose report says so.
    pub async fn submit(&self, request: FrameRequest) -> Result<FrameReply, ServiceError> {
        self.submit_with(request, Delivery::default()).await
    }

    /// As [`submit`](Self::submit), with more than the reply at its end: see [`Delivery`], whose functions are called on the
    /// worker's thread, `on_partial` with the first of the wanted bodies.
    ///
    /// # Errors
    /// As [`submit`](Self::submit).
    pub async fn submit_with(
        &self,
        request: FrameRequest,
        delivery: Delivery,
    ) -> Result<FrameReply, ServiceError> {
        let class = request.options.priority;
        let (received_at, deadline) = (request.received_at, request.deadline());
        let span = tracing::info_span!(
            "frame",
            request_id = request.ids.request_id,
            camera = request.ids.camera_id,
            slack_ms = tracing::field::Empty,
        );
        let named = Named {
            request_id: request.ids.request_id.clone(),
            camera: request.ids.camera_id.clone(),
        };
        let outcome = self.admit(request, delivery).instrument(span.clone()).await;
        let slack_ms = deadline.map(slack_ms);
        span.record("slack_ms", slack_ms);
        match &outcome {
            Ok(FrameReply { report, costs, .. }) => {
                self.shared.metrics.ended(Some(class), "OK");
                self.shared.metrics.answered(class, report, *costs);
                traces::stages(&span, report, received_at);
                tracing::info!(
                    request_id = named.request_id,
                    camera = named.camera,
                    slack_ms,
                    queued_ms = ms(report.queued),
                    decoded_ms = ms(report.decoded),
                    matched_ms = ms(report.matched),
                    meshed_ms = ms(report.meshed),
                    encoded_ms = ms(report.encoded),
                    iterations = report.iterations_run,
                    deadline_met = report.deadline_met,
                    "answered"
                );
            }
            Err(error) => self.count_refusal(Some(class), error, received_at, &named, slack_ms),
        }
        outcome
    }

    /// Counts a request that a transport refuses before it has become a frame, and hands the refusal back.
    pub fn refuse(&self, error: ServiceError, received_at: Instant, request_id: &str) -> ServiceError {
        let named = Named {
            request_id: request_id.to_owned(),
            camera: String::new(),
        };
        self.count_refusal(None, &error, received_at, &named, None);
        error
    }

    /// Counts a request whose client has gone before it had become a frame.
    pub fn count_cancelled(&self) {
        self.shared.metrics.ended(None, CANCELLED);
    }

    /// Counts a frame whose result can't be sent, for want of memory to hold it until the client has taken it.
    pub fn count_unsent(&self, error: &ServiceError) {
        self.shared.metrics.dropped(error.reason_name());
    }

    /// Whether a request of this kind could be admitted now, before its body is read.
    ///
    /// # Errors
    /// What [`submit`](Self::submit) would refuse it with.
    pub(crate) fn assess(
        &self,
        spec: &JobSpec<Kind>,
        budget: Duration,
        received_at: Instant,
    ) -> Result<(), ServiceError> {
        self.shared.dispatch.assess(spec, budget, received_at)
    }

    /// A moment as the scheduler has it.
    pub(crate) fn scheduler_time(&self, instant: Instant) -> Duration {
        self.shared.dispatch.scheduler_time(instant)
    }

    /// A request as the scheduler has it.
    pub(crate) fn spec(&self, request: &FrameRequest) -> JobSpec<Kind> {
        self.shared.dispatch.spec(request)
    }

    /// The reply to a request like `spec` was handed over `took` after it was encoded.
    pub(crate) fn replied(&self, spec: &JobSpec<Kind>, took: Duration) {
        self.shared.dispatch.replied(spec, took);
    }

    /// Waits until new work is refused.
    pub async fn draining(&self) {
        // The sender lives in `self`, so waiting can't fail.
        drop(self.draining.subscribe().wait_for(|&draining| draining).await);
    }

    fn count_refusal(
        &self,
        class: Option<PriorityClass>,
        error: &ServiceError,
        received_at: Instant,
        Named { request_id, camera }: &Named,
        slack_ms: Option<f64>,
    ) {
        let metrics = &self.shared.metrics;
        metrics.ended(class, error.reason_name());
        metrics.refused(received_at.elapsed());
        tracing::info!(
            request_id,
            camera,
            slack_ms,
            reason = error.reason_name(),
            error = error.text(),
            "refused"
        );
    }

    async fn admit(&self, request: FrameRequest, delivery: Delivery) -> Result<FrameReply, ServiceError> {
        let deadline = request.deadline();
        let class = request.options.priority;
        let dispatch = &self.shared.dispatch;
        let mut leaving = Leaving {
            shared: &self.shared,
            class,
            ticket: None,
        };
        let Admission { ticket, mut outcome } = match dispatch.submit(request, delivery) {
            Ok(admission) => admission,
            Err(error) => {
                leaving.stay();
                return Err(error);
            }
        };
        leaving.ticket = Some(ticket);
        let in_time = match deadline {
            None => None,
            Some(deadline) => timeout_at(deadline.into(), &mut outcome).await.ok(),
        };
        let received = match in_time {
            Some(received) => received,
            None => {
                if deadline.is_some() {
                    // Answers it if it still waits. If a worker has it, that stops after the step it is at.
                    dispatch.expire();
                }
                outcome.await
            }
        };
        leaving.stay();
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
            is_crippled: self.shared.is_crippled(),
            queue_depth: self.shared.dispatch.depth(),
            is_draining: self.is_draining(),
        }
    }

    /// Whether new work is refused because the server is stopping.
    #[must_use]
    pub fn is_draining(&self) -> bool {
        self.shared.dispatch.is_draining()
    }

    /// Worker threads in all.
    #[must_use]
    pub fn workers(&self) -> usize {
        self.workers
    }

    /// How busy the workers are.
    pub(crate) fn load(&self) -> stereo_scheduler::Snapshot {
        self.shared.dispatch.snapshot()
    }

    /// Who may ask for what.
    pub(crate) fn clients(&self) -> &Arc<Clients> {
        &self.clients
    }

    pub(crate) fn metrics(&self) -> &Arc<Metrics> {
        &self.shared.metrics
    }

    /// Everything that is counted, as OpenMetrics text.
    #[must_use]
    pub fn metrics_text(&self) -> String {
        let snapshot = self.shared.dispatch.snapshot();
        let metrics = &self.shared.metrics;
        let whole = |count: usize| i64::try_from(count).unwrap_or(i64::MAX);
        metrics
            .queue_depth
            .set(whole(snapshot.waiting + snapshot.background_waiting));
        metrics.workers_busy.set(whole(snapshot.busy_workers));
        metrics.overload_rung.set(snapshot.level as i64);
        metrics.draining.set(self.is_draining().into());
        metrics.text()
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

    /// Refuses new work from now on: the first part of [`drain`](Self::drain).
    pub fn stop_admitting(&self) {
        self.shared.dispatch.drain();
        self.draining.send_replace(true);
    }

    /// Refuses new work from now on, waits until everything admitted is finished or expired, and ends the workers.
    pub async fn drain(&self) {
        self.stop_admitting();
        self.shared.dispatch.drained().await;
        self.shared.dispatch.close();
        let pool = self.pool.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(pool) = pool {
            // Fails only if the runtime is being torn down, and then nothing is left to wait for.
            drop(tokio::task::spawn_blocking(|| pool.join()).await);
        }
    }
}

/// What a frame is called in the log; empty where it isn't known.
struct Named {
    request_id: String,
    camera: String,
}

/// The time that is left until `deadline` in ms, less than 0 once it is over.
fn slack_ms(deadline: Instant) -> f64 {
    let now = Instant::now();
    ms(deadline.saturating_duration_since(now)) - ms(now.saturating_duration_since(deadline))
}

fn ms(duration: Duration) -> f64 {
    1e3 * duration.as_secs_f64()
}

impl Drop for Service {
    fn drop(&mut self) {
        self.shared.dispatch.close();
    }
}

#[cfg(test)]
mod tests;
