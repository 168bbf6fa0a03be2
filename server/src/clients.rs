//! Who asks: clients, as the configuration names them, with what each may have.
//!
//! A client is known over HTTP by its token or its certificate, or where nobody needs one, by its address. Over Zenoh it is the
//! router that knows its users and what each may do; the server sees the camera, which is a client's if that client's patterns name it.

mod pattern;
mod rate;

use std::net::IpAddr;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use self::pattern::matches;
use self::rate::Rate;
use crate::config::{ClientConfig, Config};
use crate::status::ServiceError;
use crate::token::TokenHash;

/// What a camera's share is called.
const CAMERA: &str = "camera ";
/// What a client's share is called.
const CLIENT: &str = "client ";

/// All clients.
#[derive(Debug, Default)]
pub struct Clients {
    all: Vec<Arc<Client>>,
    has_doors: bool,
}

/// One client, with what it has used.
#[derive(Debug)]
pub struct Client {
    name: String,
    config: ClientConfig,
    rate: Option<Mutex<Rate>>,
    bytes: Option<Bytes>,
}

/// The bytes that a client may have in flight.
#[derive(Debug)]
struct Bytes {
    limit: u64,
    free: Arc<Semaphore>,
}

/// Whoever sends a request, as far as that is known.
#[derive(Debug, Clone)]
pub enum Caller {
    /// A client of the configuration.
    Client(Arc<Client>),
    /// Somebody else: the address the request came from, or empty.
    Stranger(String),
}

impl Clients {
    /// Those of the configuration.
    #[must_use]
    pub fn new(config: &Config) -> Self {
        let all = config.clients.iter();
        Self {
            all: all
                .map(|(name, config)| Arc::new(Client::new(name.clone(), config.clone())))
                .collect(),
            has_doors: config.has_doors(),
        }
    }

    /// Whether a request has to say who it comes from.
    #[must_use]
    pub fn has_doors(&self) -> bool {
        self.has_doors
    }

    /// The client with this token. All are compared, each in constant time.
    #[must_use]
    pub fn by_token(&self, token: &[u8]) -> Option<&Arc<Client>> {
        let shown = TokenHash::of(token);
        let mut found = None;
        for client in &self.all {
            let is_it = client.config.token_sha256.as_ref().map(|hash| hash.is(&shown));
            if is_it.is_some_and(bool::from) {
                found = Some(client);
            }
        }
        found
    }

    /// The client of this name.
    #[must_use]
    pub fn by_name(&self, name: &str) -> Option<&Arc<Client>> {
        self.all.iter().find(|client| client.name == name)
    }

    /// Whoever asks from this address, where nobody has to say who they are.
    #[must_use]
    pub fn by_address(&self, address: IpAddr) -> Caller {
        let address = address.to_canonical();
        let has_it = |client: &&Arc<Client>| {
            let mut own = client.config.addresses.iter();
            own.any(|own| own.to_canonical() == address)
        };
        match self.all.iter().find(has_it) {
            Some(client) => Caller::Client(Arc::clone(client)),
            None => Caller::Stranger(address.to_string()),
        }
    }

    /// The weight of a share by its name: that of the client, or of the first client whose patterns name the camera; else 1.
    #[must_use]
    pub fn weight(&self, share: &str) -> u32 {
        let client = if let Some(name) = share.strip_prefix(CLIENT) {
            self.by_name(name)
        } else if let Some(camera) = share.strip_prefix(CAMERA) {
            let mut named = self.all.iter();
            named.find(|client| !client.config.cameras.is_empty() && client.may_use(camera))
        } else {
            None
        };
        client.map_or(1, |client| client.config.weight)
    }
}

impl Client {
    fn new(name: String, config: ClientConfig) -> Self {
        Self {
            rate: config
                .requests_per_second
                .map(|limit| Mutex::new(Rate::new(limit))),
            bytes: config.bytes_in_flight.map(|limit| Bytes {
                limit,
                free: Arc::new(Semaphore::new(permits(limit))),
            }),
            name,
            config,
        }
    }

    /// Its name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Whether it may send a camera's frames and see its results.
    #[must_use]
    pub fn may_use(&self, camera: &str) -> bool {
        let cameras = &self.config.cameras;
        cameras.is_empty() || cameras.iter().any(|pattern| matches(pattern, camera))
    }

    /// Counts a request.
    ///
    /// # Errors
    /// If it is one too many, with the time until the next.
    pub fn count_request(&self) -> Result<(), ServiceError> {
        self.next_request().map_err(|(limit, wait)| ServiceError::Rate {
            client: self.name.clone(),
            limit,
            wait,
        })
    }

    /// Counts a request as soon as it isn't one too many.
    pub async fn wait_for_request(&self) {
        while let Err((_, wait)) = self.next_request() {
            tokio::time::sleep(wait).await;
        }
    }

    fn next_request(&self) -> Result<(), (u32, Duration)> {
        let (Some(rate), Some(limit)) = (&self.rate, self.config.requests_per_second) else {
            return Ok(());
        };
        // Nothing that is called while it is held panics.
        let mut rate = rate.lock().unwrap_or_else(PoisonError::into_inner);
        rate.take(Instant::now()).map_err(|wait| (limit, wait))
    }

    /// Room for `count` bytes of its requests and replies; `None` if it has no bound of its own.
    ///
    /// # Errors
    /// If there is none.
    pub fn reserve(&self, count: u32) -> Result<Option<OwnedSemaphorePermit>, ServiceError> {
        let Some(Bytes { limit, free }) = &self.bytes else {
            return Ok(None);
        };
        let permit = Arc::clone(free).try_acquire_many_owned(count);
        permit.map(Some).map_err(|_| ServiceError::ClientBytes {
            client: self.name.clone(),
            limit: *limit,
        })
    }

    /// The same as soon as there is some: all there is for more than that.
    pub async fn reserve_when_free(&self, count: usize) -> Option<OwnedSemaphorePermit> {
        let Bytes { limit, free } = self.bytes.as_ref()?;
        let count = u32::try_from(count.min(permits(*limit))).unwrap_or(u32::MAX);
        // The semaphore is never closed.
        Arc::clone(free).acquire_many_owned(count).await.ok()
    }
}

impl Caller {
    /// The client, if it is one.
    #[must_use]
    pub fn client(&self) -> Option<&Arc<Client>> {
        match self {
            Self::Client(client) => Some(client),
            Self::Stranger(_) => None,
        }
    }

    /// Whose share of the server a request counts against: the client's; a stranger's camera's, else its address.
    #[must_use]
    pub fn share(&self, camera: &str) -> String {
        match self {
            Self::Client(client) => format!("{CLIENT}{}", client.name),
            Self::Stranger(address) if camera.is_empty() => address.clone(),
            Self::Stranger(_) => format!("{CAMERA}{camera}"),
        }
    }

    /// Whether a request may be about a camera; one about none always is allowed.
    ///
    /// # Errors
    /// [`ServiceError::Forbidden`].
    pub fn check_camera(&self, camera: &str) -> Result<(), ServiceError> {
        match self {
            Self::Client(client) if !camera.is_empty() && !client.may_use(camera) => {
                Err(ServiceError::Forbidden {
                    client: client.name.clone(),
                    camera: camera.chars().take(64).collect(),
                })
            }
            _ => Ok(()),
        }
    }
}

fn permits(bytes: u64) -> usize {
    usize::try_from(bytes)
        .unwrap_or(usize::MAX)
        .min(Semaphore::MAX_PERMITS)
}

#[cfg(test)]
mod tests;
