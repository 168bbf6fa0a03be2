//! Zenoh: camera streams, requests, and many servers that share the cameras.
//!
//! | room | what |
//! | --- | --- |
//! | `session` | configured, opened as long as it takes, closed in bounded time |
//! | `keys`, `payload`, `outgoing` | what is where, in what form, and by which way |
//! | `fleet` | who is there, who serves which camera, how busy this server is |
//! | `camera`, `inbox`, `pairing`, `results` | one camera: frames in, latest wins, results out |
//! | `queries`, `settings` | requests with an answer |
//!
//! Callbacks run on Zenoh's receive threads: they stamp, bound and hand over, and never compute or wait.

mod camera;
mod fleet;
mod inbox;
mod keys;
mod outgoing;
mod pairing;
mod payload;
mod queries;
mod results;
mod roster;
mod session;
mod settings;

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio::runtime::Handle;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};
use tokio::task::{JoinHandle, JoinSet};
use zenoh::Session;
use zenoh::bytes::ZBytes;

use self::outgoing::Outgoing;
use self::settings::SettingsBook;
use crate::config::{Config, ConfigError};
use crate::service::Service;
use crate::status::ServiceError;
use crate::streams::{NetworkState, Streams};

/// How long it may take to let everybody know that this server goes.
const WITHDRAW_WITHIN: Duration = Duration::from_secs(1);
/// How long sending the last results and closing the session may take.
const CLOSE_WITHIN: Duration = Duration::from_secs(3);

/// The transport, ready to start.
pub struct Prepared {
    zenoh: zenoh::Config,
    settings: SettingsBook,
    config: Config,
}

/// The transport while it runs.
pub struct Zenoh {
    phase: watch::Receiver<Phase>,
    stop: watch::Sender<bool>,
    task: JoinHandle<()>,
}

/// How far the transport has got.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd)]
enum Phase {
    /// It serves, or is on the way to it.
    Serving,
    /// Nobody finds this server any more, and nothing new comes in.
    Withdrawn,
}

/// What everything here shares.
struct Context {
    session: Session,
    service: Arc<Service>,
    streams: Arc<Streams>,
    settings: SettingsBook,
    outgoing: Arc<Outgoing>,
    instance: String,
    max_image_px: u64,
    body_bytes: u64,
    bytes_in_flight: u64,
    /// Bytes of payloads that may be held at one time.
    in_flight: Arc<Semaphore>,
    /// Where work that callbacks start is done.
    runtime: Handle,
    /// Requests under way.
    requests: Mutex<JoinSet<()>>,
}

impl Prepared {
    /// Checks everything that can be checked without a network; `None` if Zenoh is switched off.
    ///
    /// # Errors
    /// [`ConfigError`] if Zenoh's file can't be read or says something that Zenoh doesn't understand, or a camera's settings are not
    /// acceptable.
    pub fn new(config: &Config) -> Result<Option<Self>, ConfigError> {
        if !config.zenoh.enabled {
            return Ok(None);
        }
        Ok(Some(Self {
            zenoh: session::configure(config)?,
            settings: SettingsBook::new(config.zenoh.camera_settings()?),
            config: config.clone(),
        }))
    }

    /// Opens the session in the background and serves from then on.
    pub fn start(self, service: Arc<Service>, streams: Arc<Streams>) -> Zenoh {
        streams.set_network(|network| {
            network.state = NetworkState::Opening;
            network.is_required = self.config.zenoh.required;
            network.has_endpoints = !self.config.zenoh.connect.is_empty()
                || self
                    .zenoh
                    .get_json("connect/endpoints")
                    .is_ok_and(|endpoints| endpoints.contains('/'));
        });
        let (stop, mut stopped) = watch::channel(false);
        let (phase, seen) = watch::channel(Phase::Serving);
        let task = tokio::spawn(async move {
            let until_stopped = |stopped: &mut watch::Receiver<bool>| {
                let mut stopped = stopped.clone();
                async move { drop(stopped.wait_for(|&stop| stop).await) }
            };
            let outgoing = Arc::new(Outgoing::default());
            let session = tokio::select! {
                () = until_stopped(&mut stopped) => None,
                session = session::open(&self.zenoh, &streams, &outgoing) => Some(session),
            };
            let Some(session) = session else {
                phase.send_replace(Phase::Withdrawn);
                return;
            };
            let limits = &self.config.limits;
            let permits = usize::try_from(limits.bytes_in_flight).unwrap_or(usize::MAX);
            let context = Arc::new(Context {
                session: session.clone(),
                service,
                streams,
                settings: self.settings,
                outgoing,
                instance: self.config.instance.clone(),
                max_image_px: limits.image_pixels,
                body_bytes: limits.body_bytes,
                bytes_in_flight: limits.bytes_in_flight,
                in_flight: Arc::new(Semaphore::new(permits.min(Semaphore::MAX_PERMITS))),
                runtime: Handle::current(),
                requests: Mutex::default(),
            });
            let configured = self.config.zenoh.cameras.into_keys();
            if let Err(why) = fleet::serve(&context, configured.collect(), &mut stopped, &phase).await {
                tracing::error!(%why, "Zenoh ended early: only HTTP is served");
                context.streams.set_network(|network| {
                    network.state = NetworkState::Opening;
                    network.why = Some(why.to_string());
                });
                until_stopped(&mut stopped).await;
            }
            phase.send_replace(Phase::Withdrawn);
            let requests =
                std::mem::take(&mut *context.requests.lock().unwrap_or_else(PoisonError::into_inner));
            requests.join_all().await;
            session::close(session).await;
        });
        Zenoh {
            phase: seen,
            stop,
            task,
        }
    }
}

impl Zenoh {
    /// Lets nobody find this server any more and takes nothing new; other servers take over the cameras.
    pub async fn withdraw(&mut self) {
        self.stop.send_replace(true);
        let withdrawn = self.phase.wait_for(|&phase| phase >= Phase::Withdrawn);
        if tokio::time::timeout(WITHDRAW_WITHIN, withdrawn).await.is_err() {
            tracing::warn!("withdrawing from Zenoh takes long: going on without");
        }
    }

    /// Waits until what was admitted has been answered, and closes the session, in bounded time.
    pub async fn close(self) {
        self.stop.send_replace(true);
        match tokio::time::timeout(CLOSE_WITHIN, self.task).await {
            Ok(Ok(())) => {}
            Ok(Err(why)) => tracing::error!(%why, "the Zenoh transport failed"),
            Err(_) => tracing::warn!("closing Zenoh took too long, leaving it"),
        }
    }
}

impl Context {
    /// Bounds what has come in: a place for its bytes, counted until that is dropped.
    fn admit(&self, payload: &ZBytes) -> Result<OwnedSemaphorePermit, ServiceError> {
        let way = payload::way(payload).name();
        self.service.metrics().zenoh_payload(way);
        let bytes = payload.len() as u64;
        if bytes > self.body_bytes {
            return Err(ServiceError::TooLarge(format!(
                "the payload has {bytes} bytes but this server takes at most {}: send smaller images, or PNG or JPEG",
                self.body_bytes
            )));
        }
        let count = u32::try_from(bytes).unwrap_or(u32::MAX);
        Arc::clone(&self.in_flight)
            .try_acquire_many_owned(count)
            .map_err(|_| ServiceError::BytesInFlight {
                limit: self.bytes_in_flight,
            })
    }

    /// Does something that a callback can't wait for.
    fn spawn(&self, work: impl Future<Output = ()> + Send + 'static) {
        let mut requests = self.requests.lock().unwrap_or_else(PoisonError::into_inner);
        while requests.try_join_next().is_some() {}
        requests.spawn_on(work, &self.runtime);
    }
}
