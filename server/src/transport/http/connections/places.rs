//! Places for connections. At the limit, the one that has been there longest without sending a request makes room for a new one; if all
//! have sent one, the new one is told that there is no place. A crowd that only connects keeps nobody out who has something to say.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio::net::TcpStream;
use tokio::sync::{Notify, OwnedSemaphorePermit, Semaphore};
use tokio::time::timeout;

use super::farewell;
use crate::metrics::Metrics;
use crate::status::ServiceError;

/// How long an evicted connection may take to end.
const EVICTION: Duration = Duration::from_millis(100);
/// Connections that are being told that there is no place; more are closed without a word.
const REFUSALS: usize = 64;

pub(super) struct Places {
    free: Arc<Semaphore>,
    limit: u32,
    refusing: Arc<Semaphore>,
    silent: Arc<Mutex<Silent>>,
    metrics: Arc<Metrics>,
}

/// Connections that have not sent a request yet, in order of arrival.
#[derive(Default)]
struct Silent {
    arrivals: u64,
    waiting: BTreeMap<u64, Arc<Notify>>,
}

/// One connection's place.
pub(super) struct Place {
    number: u64,
    evicted: Arc<Notify>,
    silent: Arc<Mutex<Silent>>,
    _permit: OwnedSemaphorePermit,
}

impl Places {
    pub(super) fn new(limit: u32, metrics: Arc<Metrics>) -> Self {
        Self {
            free: Arc::new(Semaphore::new(limit as usize)),
            limit,
            refusing: Arc::new(Semaphore::new(REFUSALS)),
            silent: Arc::default(),
            metrics,
        }
    }

    /// A place for a new connection, if need be that of the one that has been silent longest.
    pub(super) async fn take(&self) -> Option<Place> {
        let permit = match Arc::clone(&self.free).try_acquire_owned() {
            Ok(permit) => permit,
            Err(_) => {
                let (_, oldest) = lock(&self.silent).waiting.pop_first()?;
                oldest.notify_one();
                let freed = timeout(EVICTION, Arc::clone(&self.free).acquire_owned()).await;
                freed.ok()?.ok()?
            }
        };
        let evicted = Arc::new(Notify::new());
        let mut silent = lock(&self.silent);
        let number = silent.arrivals;
        silent.arrivals += 1;
        silent.waiting.insert(number, Arc::clone(&evicted));
        drop(silent);
        Some(Place {
            number,
            evicted,
            silent: Arc::clone(&self.silent),
            _permit: permit,
        })
    }

    /// Tells a client that there is no place for it.
    pub(super) fn refuse(&self, stream: TcpStream) {
        let error = ServiceError::TooManyConnections { limit: self.limit };
        self.metrics.ended(None, error.reason_name());
        let Ok(permit) = Arc::clone(&self.refusing).try_acquire_owned() else {
            return;
        };
        tokio::spawn(async move {
            farewell::say(stream, error).await;
            drop(permit);
        });
    }

    /// Waits until every connection has ended.
    pub(super) async fn all_free(&self) {
        drop(self.free.acquire_many(self.limit).await);
    }
}

impl Place {
    /// The connection has sent a request: it keeps its place.
    pub(super) fn speaks(&self) {
        lock(&self.silent).waiting.remove(&self.number);
    }

    /// Returns when the place is needed for another.
    pub(super) async fn evicted(&self) {
        self.evicted.notified().await;
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.speaks();
    }
}

fn lock(silent: &Mutex<Silent>) -> std::sync::MutexGuard<'_, Silent> {
    silent.lock().unwrap_or_else(PoisonError::into_inner)
}
