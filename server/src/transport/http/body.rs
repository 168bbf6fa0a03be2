//! Bodies: requests' bounded in size and time, and requests' and replies' all together. What arrives is counted as it arrives,
//! before it is kept; what is sent is counted until it is sent.

use std::convert::Infallible;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use axum::body::{Body, HttpBody};
use axum::response::{IntoResponse, Response};
use bytes::{Bytes, BytesMut};
use http_body_util::BodyExt;
use hyper::body::{Frame, SizeHint};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::{timeout, timeout_at};

use super::refusal::Refusal;
use crate::clients::Caller;
use crate::config::Config;
use crate::status::ServiceError;

/// Memory reserved for a body at once, whatever length it claims.
const FIRST_RESERVATION: usize = 4 << 20;
/// Size of the pieces that a reply is sent in.
const PIECE: usize = 128 << 10;
/// An unwanted body of more than this ends its connection: what is under way of a smaller one is mostly here already.
const UNREAD_AT_MOST: u64 = 1 << 20;
/// How long a refused request may go on sending. A client that is cut off while it sends would not read why.
const LINGER: Duration = Duration::from_secs(5);
/// How much longer than the limit a body may be for its sender to be waited for.
const LINGER_FACTOR: u64 = 4;

/// The bounds of bodies.
pub(super) struct BodyLimits {
    body_bytes: u64,
    bytes_in_flight: u64,
    read_timeout: Duration,
    in_flight: Arc<Semaphore>,
    /// Requests of batches, from their first byte until their reply is taken.
    batches: Arc<Semaphore>,
    batch_bytes: usize,
}

/// A whole body. Its bytes count as in flight until this is dropped.
pub(super) struct Received {
    pub(super) bytes: Bytes,
    pub(super) share: Share,
}

/// Bytes in flight, counted while this lives: among all, and among the client's if it has a bound of its own.
#[derive(Default)]
pub(super) struct Share {
    of_all: Option<OwnedSemaphorePermit>,
    of_client: Option<OwnedSemaphorePermit>,
}

impl Share {
    fn merge(&mut self, more: Self) {
        for (share, more) in [
            (&mut self.of_all, more.of_all),
            (&mut self.of_client, more.of_client),
        ] {
            match (share.as_mut(), more) {
                (Some(share), Some(more)) => share.merge(more),
                (None, more) => *share = more,
                (Some(_), None) => {}
            }
        }
    }
}

impl BodyLimits {
    pub(super) fn new(config: &Config) -> Self {
        let bytes_in_flight = config.limits.bytes_in_flight;
        let permits = |bytes: u64| {
            usize::try_from(bytes)
                .unwrap_or(usize::MAX)
                .min(Semaphore::MAX_PERMITS)
        };
        let batch_bytes = permits(config.limits.batch_bytes_in_flight);
        Self {
            body_bytes: config.limits.body_bytes,
            bytes_in_flight,
            read_timeout: config.http.body_timeout,
            in_flight: Arc::new(Semaphore::new(permits(bytes_in_flight))),
            batches: Arc::new(Semaphore::new(batch_bytes)),
            batch_bytes,
        }
    }

    /// Bytes held now: bodies of requests and replies, and those of batches.
    pub(super) fn in_flight(&self) -> (i64, i64) {
        let held = |all: u64, semaphore: &Semaphore| {
            let free = u64::try_from(semaphore.available_permits()).unwrap_or(u64::MAX);
            i64::try_from(all.saturating_sub(free)).unwrap_or(i64::MAX)
        };
        (
            held(self.bytes_in_flight, &self.in_flight),
            held(self.batch_bytes as u64, &self.batches),
        )
    }

    /// Largest body of one request.
    pub(super) fn body_bytes(&self) -> u64 {
        self.body_bytes
    }

    /// How long a body may take, and the taking of an answer.
    pub(super) fn timeout(&self) -> Duration {
        self.read_timeout
    }

    /// Room for a request of a batch of `len` bytes, as soon as there is some.
    pub(super) async fn batch_share(&self, caller: &Caller, len: usize) -> Share {
        let count = u32::try_from(len.min(self.batch_bytes)).unwrap_or(u32::MAX);
        let of_client = match caller.client() {
            Some(client) => client.reserve_when_free(len).await,
            None => None,
        };
        Share {
            // The semaphore is never closed.
            of_all: Arc::clone(&self.batches).acquire_many_owned(count).await.ok(),
            of_client,
        }
    }

    /// Reads a whole body. `budget` is what the headers said.
    ///
    /// # Errors
    /// Too large (by the length it claims before anything is read, else when it has grown too large), too slow, past its
    /// deadline, broken off, or no room for it among the others.
    pub(super) async fn read(
        &self,
        caller: &Caller,
        mut body: Body,
        received_at: Instant,
        budget: Option<Duration>,
    ) -> Result<Received, ServiceError> {
        let claimed = body.size_hint().lower();
        if claimed > self.body_bytes {
            linger(body, claimed, self.body_bytes);
            return Err(self.too_large(Some(claimed)));
        }
        let limit = budget.map_or(self.read_timeout, |budget| budget.min(self.read_timeout));
        let outcome = timeout_at(
            (received_at + limit).into(),
            self.collect(caller, &mut body, claimed),
        )
        .await;
        match (outcome, budget) {
            (Ok(Ok(received)), _) => Ok(received),
            (Ok(Err(error)), _) => {
                linger(body, claimed, self.body_bytes);
                Err(error)
            }
            (Err(_), Some(budget)) if budget <= self.read_timeout => Err(ServiceError::Expired {
                budget,
                earliest_feasible: None,
            }),
            (Err(_), _) => Err(ServiceError::ReadTimeout {
                limit: self.read_timeout,
            }),
        }
    }

    async fn collect(
        &self,
        caller: &Caller,
        body: &mut Body,
        claimed: u64,
    ) -> Result<Received, ServiceError> {
        let claimed = usize::try_from(claimed).unwrap_or(usize::MAX);
        let mut bytes = BytesMut::with_capacity(claimed.min(FIRST_RESERVATION));
        let mut share = Share::default();
        while let Some(frame) = body.frame().await {
            let frame =
                frame.map_err(|error| ServiceError::Invalid(format!("the body broke off: {error}")))?;
            let Ok(data) = frame.into_data() else { continue };
            if bytes.len() as u64 + data.len() as u64 > self.body_bytes {
                return Err(self.too_large(None));
            }
            share.merge(self.reserve(caller, data.len())?);
            if bytes.capacity() - bytes.len() < data.len() {
                // Whoever has sent so much is believed: a body that grew by and by would take up to twice its length.
                bytes.reserve(claimed.saturating_sub(bytes.len()).max(data.len()));
            }
            bytes.extend_from_slice(&data);
        }
        Ok(Received {
            bytes: bytes.freeze(),
            share,
        })
    }

    /// A reply's body, counted as in flight until the client has taken it or gone. `on_sent` is called with its size when all of it has been
    /// handed to the connection.
    ///
    /// # Errors
    /// No room for it among the others.
    pub(super) fn reply(
        &self,
        caller: &Caller,
        bytes: Bytes,
        on_sent: impl Fn(usize) + Send + Sync + 'static,
    ) -> Result<Body, ServiceError> {
        let share = self.reserve(caller, bytes.len())?;
        Ok(Body::new(Reply {
            bytes: bytes.len(),
            rest: bytes,
            on_sent: Some(Box::new(on_sent)),
            _share: share,
        }))
    }

    fn reserve(&self, caller: &Caller, count: usize) -> Result<Share, ServiceError> {
        let full = ServiceError::BytesInFlight {
            limit: self.bytes_in_flight,
        };
        let Ok(count) = u32::try_from(count) else {
            return Err(full);
        };
        let of_client = match caller.client() {
            Some(client) => client.reserve(count)?,
            None => None,
        };
        let of_all = Arc::clone(&self.in_flight).try_acquire_many_owned(count);
        Ok(Share {
            of_all: Some(of_all.map_err(|_| full)?),
            of_client,
        })
    }

    fn too_large(&self, claimed: Option<u64>) -> ServiceError {
        let got = claimed.map_or_else(
            || "and this one goes on".to_owned(),
            |bytes| format!("got {bytes}"),
        );
        ServiceError::TooLarge(format!(
            "a request's body can have up to {} bytes, {got}: send a smaller image or a tighter encoding",
            self.body_bytes
        ))
    }
}

/// A reply on its way. It is handed over in pieces, so that it lives (and is counted) while the client takes them.
struct Reply {
    rest: Bytes,
    bytes: usize,
    /// Told the size.
    on_sent: Option<Box<dyn Fn(usize) + Send + Sync>>,
    /// Held for its drop.
    _share: Share,
}

impl HttpBody for Reply {
    type Data = Bytes;
    type Error = Infallible;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        _: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Infallible>>> {
        let count = self.rest.len().min(PIECE);
        let piece = self.rest.split_to(count);
        if self.rest.is_empty()
            && let Some(on_sent) = self.on_sent.take()
        {
            on_sent(self.bytes);
        }
        Poll::Ready((count > 0).then_some(Ok(Frame::data(piece))))
    }

    fn is_end_stream(&self) -> bool {
        self.rest.is_empty()
    }

    fn size_hint(&self) -> SizeHint {
        SizeHint::with_exact(self.rest.len() as u64)
    }
}

/// A refusal of a request whose body was not read.
pub(super) fn refuse_unread(body: Body, error: ServiceError) -> Response {
    Refusal::unread(body, error).into_response()
}

/// What happens to a body that nobody wants. True if it is so large that its client had better stop sending it.
pub(super) fn leave_unread(body: Body) -> bool {
    let claimed = body.size_hint().lower();
    let is_large = claimed > UNREAD_AT_MOST && !body.is_end_stream();
    linger(body, claimed, FIRST_RESERVATION as u64);
    is_large
}

/// Lets the client finish sending a body that nobody wants, within reason, so that it gets to read the answer.
fn linger(body: Body, claimed: u64, limit: u64) {
    let most = limit.saturating_mul(LINGER_FACTOR);
    if !body.is_end_stream() && claimed <= most {
        tokio::spawn(async move { drop(timeout(LINGER, discard(body, most)).await) });
    }
}

async fn discard(mut body: Body, most: u64) {
    let mut discarded = 0;
    while let Some(Ok(frame)) = body.frame().await {
        // Those whose bodies are wanted go first.
        tokio::task::yield_now().await;
        discarded += frame.data_ref().map_or(0, |data| data.len() as u64);
        if discarded > most {
            return;
        }
    }
}

#[cfg(test)]
mod tests;
