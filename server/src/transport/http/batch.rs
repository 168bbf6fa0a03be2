//! `POST /v1/stereo/batch`: any number of pairs in, their replies out as they finish, both streaming at the same time.
//!
//! ```text
//! body ──pieces──> Reader ──messages──> a few frames under way ──replies──> channel of one ──> Replies ──> client
//!                    ^                            |                              |
//!                    +── reads on only when one of them is done ─────────────────+── waits while the client does not read
//! ```
//! Nothing is buffered beyond the frames under way: a client that doesn't read its replies is not read from either, and memory does not
//! grow with the length of the batch. All frames are of class background.

mod reader;
mod replies;

use std::sync::Arc;
use std::time::Instant;

use axum::body::Body;
use axum::extract::{Extension, Request, State};
use axum::http::header::{ACCEPT, CONTENT_TYPE};
use axum::http::{HeaderMap, HeaderValue};
use axum::response::Response;
use bytes::Bytes;
use futures_util::FutureExt;
use futures_util::future::BoxFuture;
use futures_util::stream::{FuturesUnordered, StreamExt};
use stereo_proto::v1;
use tokio::sync::OwnedSemaphorePermit;

use self::reader::{Broken, Message, Reader, broken_off};
use self::replies::{Outlet, Piece, channel};
use super::connections::Busy;
use super::description::Binary;
use super::envelope::{ReceivedAt, RequestId};
use super::refusal::Refusal;
use super::{Http, negotiate};
use crate::clients::Caller;
use crate::encode::memory::Encoded;
use crate::job::{PriorityClass, ReplyFormat};
use crate::metrics::BatchEnd;
use crate::status::ServiceError;
use crate::wire::{Intake, decode_request, delimited, delimited_result_head, frame_request};

const DELIMITED: &str = "application/x-protobuf; delimited=true";
/// Characters of the batch's id that go into those of its requests.
const ID_CHARACTERS: usize = 100;

/// The route.
#[utoipa::path(
    post,
    path = "/v1/stereo/batch",
    tag = "pairs",
    summary = "Match any number of pairs, streaming, whenever nothing with a deadline has to run",
    description = "Length-delimited `stereo.v1.StereoRequest`s in, length-delimited `stereo.v1.BatchReply`s out as they finish.",
    request_body(description = "The requests, one after another", content((Binary = "application/x-protobuf"))),
    responses(
        (status = 200, description = "The replies", body = Binary, content_type = "application/x-protobuf"),
        Refusal,
    ),
)]
pub(super) async fn post(
    State(http): State<Arc<Http>>,
    Extension(ReceivedAt(received_at)): Extension<ReceivedAt>,
    Extension(RequestId(request_id)): Extension<RequestId>,
    Extension(caller): Extension<Caller>,
    busy: Option<Extension<Arc<Busy>>>,
    request: Request,
) -> Result<Response, Refusal> {
    let (parts, body) = request.into_parts();
    if let Err(error) = check_head(&http, &parts.headers) {
        let error = http.service.refuse(error, received_at, &request_id);
        return Err(Refusal::unread(body, error));
    }
    let (outlet, replies) = channel(http.bodies.timeout());
    let batch = Batch {
        id: request_id.chars().take(ID_CHARACTERS).collect(),
        caller,
        http,
    };
    tokio::spawn(async move {
        batch.run(body, outlet).await;
        // Until here the connection is not at rest, however long nothing is sent.
        drop(busy);
    });
    let mut response = Response::new(Body::new(replies));
    response
        .headers_mut()
        .insert(CONTENT_TYPE, HeaderValue::from_static(DELIMITED));
    Ok(response)
}

fn check_head(http: &Http, headers: &HeaderMap) -> Result<(), ServiceError> {
    if http.service.is_draining() {
        return Err(ServiceError::Draining);
    }
    let given = headers.get(CONTENT_TYPE).map_or_else(
        || "none".into(),
        |value| String::from_utf8_lossy(value.as_bytes()),
    );
    if !negotiate::is_protobuf(&negotiate::essence(&given)) {
        return Err(ServiceError::UnsupportedMediaType {
            expected: DELIMITED,
            got: given.into_owned(),
        });
    }
    for name in ["x-latency-budget-ms", "grpc-timeout"] {
        if headers.contains_key(name) {
            return Err(ServiceError::Invalid(format!(
                "{name} can't be had with a batch, whose requests have no deadline: give latency_budget in their options, \
                 which counts from the moment a worker takes one"
            )));
        }
    }
    let is_protobuf =
        negotiate::reply(headers, None).is_ok_and(|reply| reply.format == ReplyFormat::Protobuf);
    if headers.contains_key(ACCEPT) && !is_protobuf {
        return Err(ServiceError::NotAcceptable {
            expected: DELIMITED,
            got: String::from_utf8_lossy(headers.get(ACCEPT).map_or(b"", HeaderValue::as_bytes)).into_owned(),
        });
    }
    Ok(())
}

/// What all requests of a batch share.
struct Batch {
    id: String,
    caller: Caller,
    http: Arc<Http>,
}

/// A request under way, to its reply.
type Underway = BoxFuture<'static, Piece>;

impl Batch {
    async fn run(self, body: Body, outlet: Outlet) {
        let metrics = Arc::clone(self.http.service.metrics());
        metrics.batches.inc();
        let end = self.answer_all(body, outlet).await;
        metrics.batches.dec();
        metrics.batch_ended(end);
        tracing::debug!(batch = self.id, ?end, "batch ended");
    }

    async fn answer_all(&self, body: Body, mut outlet: Outlet) -> BatchEnd {
        // One more than can be worked on, so that a worker never waits for the network.
        let most = self.http.service.workers() + 1;
        let mut reader = Reader::new(Arc::clone(&self.http), self.caller.clone(), body);
        let mut underway = FuturesUnordered::<Underway>::new();
        let mut is_reading = true;
        let mut is_lost = false;
        let mut last_words: Option<ServiceError> = None;
        while is_reading || !underway.is_empty() {
            let may_read = is_reading && underway.len() < most;
            let is_idle = underway.is_empty();
            tokio::select! {
                () = outlet.closed() => return BatchEnd::HungUp,
                Some(reply) = underway.next(), if !is_idle => {
                    if let Err(error) = outlet.send(reply).await {
                        return self.gave_up(&mut outlet, error);
                    }
                    reader.wait_anew();
                }
                () = self.http.service.draining(), if is_reading => {
                    is_reading = false;
                    last_words = Some(ServiceError::Draining);
                }
                next = reader.next(is_idle), if may_read => match next {
                    Ok(Some(message)) => underway.push(self.begin(message)),
                    Ok(None) => is_reading = false,
                    Err(broken) => {
                        is_reading = false;
                        last_words = Some(match broken {
                            Broken::Off(error) => error,
                            Broken::Lost(why) => {
                                is_lost = true;
                                broken_off(&why)
                            }
                        });
                    }
                },
            }
        }
        let Some(error) = last_words else {
            return BatchEnd::Complete;
        };
        if is_lost {
            // Whoever can still read, if anybody, finds why. That the connection is gone is often known here before its reader is.
            outlet.leave_word(status_reply("", &error));
            return BatchEnd::HungUp;
        }
        let end = match error {
            ServiceError::Draining => BatchEnd::Stopping,
            _ => BatchEnd::BrokenOff,
        };
        let error = self.http.service.refuse(error, Instant::now(), &self.id);
        let status = Piece::from(status_reply("", &error));
        match outlet.send(status).await {
            Ok(()) => end,
            Err(error) => self.gave_up(&mut outlet, error),
        }
    }

    /// The client has gone, or doesn't read: it finds why where the next reply would be, if it ever gets there.
    fn gave_up(&self, outlet: &mut Outlet, error: Option<ServiceError>) -> BatchEnd {
        let Some(error) = error else {
            return BatchEnd::HungUp;
        };
        let error = self.http.service.refuse(error, Instant::now(), &self.id);
        outlet.leave_word(status_reply("", &error));
        BatchEnd::SlowReader
    }

    /// Starts on a request of the batch.
    fn begin(&self, Message { bytes, index, share }: Message) -> Underway {
        let http = Arc::clone(&self.http);
        http.service.metrics().batch_frames.inc();
        let received_at = Instant::now();
        let own_id = format!("{}/{index}", self.id);
        let intake = Intake {
            received_at,
            latency_budget: None,
            request_id: own_id.clone(),
            formats: vec![ReplyFormat::Protobuf],
            max_image_px: http.max_image_px,
            caller: self.caller.clone(),
            priority: PriorityClass::Background,
        };
        async move {
            let (id, outcome) = answer(&http, bytes, intake, own_id).await;
            match outcome {
                Ok(result) => Piece::result(delimited_result_head(&id, &result), result, share),
                Err(error) => Piece::from(status_reply(&id, &error)),
            }
        }
        .boxed()
    }
}

/// The request's id, and the bytes of its `StereoResult`.
async fn answer(
    http: &Http,
    bytes: Bytes,
    intake: Intake,
    own_id: String,
) -> (String, Result<Bytes, ServiceError>) {
    let received_at = intake.received_at;
    // One alone would be refused; a batch waits instead.
    if let Some(client) = intake.caller.client() {
        client.wait_for_request().await;
    }
    let refuse = |error, id: &str| http.service.refuse(error, received_at, id);
    let message = match decode_request(bytes) {
        Ok(message) => message,
        Err(error) => return (own_id.clone(), Err(refuse(error, &own_id))),
    };
    let id = match message.request_id.as_str() {
        "" => own_id,
        given => given.chars().take(128).collect(),
    };
    let frame = match frame_request(message, intake) {
        Ok(frame) => frame,
        Err(error) => {
            let error = refuse(error, &id);
            return (id, Err(error));
        }
    };
    // The same for a place.
    let _place: Option<OwnedSemaphorePermit> = Arc::clone(&http.batch_places).acquire_owned().await.ok();
    let outcome = http.service.submit(frame).await.and_then(|reply| {
        let body = reply.bodies.into_iter().next();
        body.map(Encoded::into_bytes)
            .ok_or_else(|| ServiceError::Internal("a reply without a body".to_owned()))
    });
    (id, outcome)
}

/// A refusal as a reply.
fn status_reply(request_id: &str, error: &ServiceError) -> Bytes {
    delimited(&v1::BatchReply {
        request_id: request_id.to_owned(),
        outcome: Some(v1::batch_reply::Outcome::Status(error.to_status(request_id))),
    })
}
