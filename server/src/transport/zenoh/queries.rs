//! Requests with an answer: `compute` for whichever server is nearest and for this one, `settings` for the cameras this one serves.
//!
//! A refusal is a `reply_err` with a protobuf `Status`. Something that is answered by nobody gets zero replies, at once.

use std::sync::Arc;
use std::time::Instant;

use prost::Message;
use tokio::sync::{OwnedSemaphorePermit, mpsc};
use tokio::task::block_in_place;
use zenoh::Wait;
use zenoh::bytes::ZBytes;
use zenoh::query::{Query, Queryable};

use super::payload::Way;
use super::settings::Revision;
use super::{Context, keys, outgoing, payload};
use crate::clients::Caller;
use crate::encode::memory::Encoded;
use crate::job::{FrameRequest, PriorityClass, ReplyFormat};
use crate::service::{Delivery, OnPartial};
use crate::status::ServiceError;
use crate::wire::{Intake, decode_request, frame_request, selector_parameters};

/// Better results of one request that may wait to be sent.
const PARTIAL_WAITING: usize = 1;

/// Takes requests from now on.
pub(super) async fn declare_compute(context: &Arc<Context>) -> zenoh::Result<Vec<Queryable<()>>> {
    let mut queryables = Vec::new();
    for key in [keys::COMPUTE.to_owned(), keys::compute(&context.instance)] {
        let weak = Arc::downgrade(context);
        let queryable = context
            .session
            .declare_queryable(key)
            // One answers, the nearest: otherwise every server would compute every request.
            .complete(true)
            .callback(move |query| {
                let received_at = Instant::now();
                if let Some(context) = weak.upgrade() {
                    let admitted = match query.payload() {
                        Some(payload) => context.admit(payload),
                        None => context.admit(&ZBytes::new()),
                    };
                    context.spawn(compute(Arc::clone(&context), query, received_at, admitted));
                }
            })
            .await?;
        queryables.push(queryable);
    }
    Ok(queryables)
}

/// One request, from its payload to its last reply.
async fn compute(
    context: Arc<Context>,
    query: Query,
    received_at: Instant,
    admitted: Result<OwnedSemaphorePermit, ServiceError>,
) {
    let request = admitted.and_then(|share| Ok((share, request(&context, &query, received_at)?)));
    let (share, (frame, is_partial)) = match request {
        Ok(request) => request,
        Err(error) => {
            let error = context.service.refuse(error, received_at, "");
            return refuse(&query, &error, "");
        }
    };
    let way = query.payload().map_or(Way::Network, payload::way);
    let request_id = frame.ids.request_id.clone();
    let (partial, mut partials) = mpsc::channel(PARTIAL_WAITING);
    let sink = is_partial.then(|| {
        let sink: OnPartial = Box::new(move |body| {
            // What can't be sent before the next one is ready isn't worth sending.
            drop(partial.try_send(body));
        });
        sink
    });
    let delivery = Delivery {
        on_partial: sink,
        memory: context.outgoing.memory(way),
        on_rung: None,
    };
    let work = context.service.submit_with(frame, delivery);
    tokio::pin!(work);
    let outcome = loop {
        tokio::select! {
            biased;
            outcome = &mut work => break outcome,
            Some(body) = partials.recv() => answer(&context, &query, &body),
        }
    };
    drop(share);
    // The first result always comes first, however soon the last one was ready.
    while let Ok(body) = partials.try_recv() {
        answer(&context, &query, &body);
    }
    match outcome {
        Ok(reply) => {
            let body = reply.bodies.into_iter().next().unwrap_or_default();
            answer(&context, &query, &body);
        }
        Err(error) => refuse(&query, &error, &request_id),
    }
}

/// What a query asks for, and whether it wants what there is before everything is done.
fn request(
    context: &Context,
    query: &Query,
    received_at: Instant,
) -> Result<(FrameRequest, bool), ServiceError> {
    let (latency_budget, is_partial) = selector_parameters(query.parameters().as_str())?;
    let missing = || {
        ServiceError::Invalid("the query has no payload: send a stereo.v1.StereoRequest with it".to_owned())
    };
    let payload = query.payload().ok_or_else(missing)?;
    payload::expect_message(query.encoding().ok_or_else(missing)?, "StereoRequest")?;
    let message = decode_request(payload::bytes(payload))?;
    let sender = query.source_info().map(|info| info.source_id().zid().to_string());
    let intake = Intake {
        received_at,
        latency_budget,
        request_id: String::new(),
        formats: vec![ReplyFormat::Protobuf],
        max_image_px: context.max_image_px,
        caller: Caller::Stranger(format!("zenoh {}", sender.unwrap_or_default())),
        priority: PriorityClass::default(),
    };
    Ok((frame_request(message, intake)?, is_partial))
}

/// Answers questions about, and changes of, the settings of the cameras for which `is_owner` says so.
pub(super) async fn declare_settings(
    context: &Arc<Context>,
    is_owner: impl Fn(&str) -> bool + Send + Sync + 'static,
) -> zenoh::Result<Queryable<()>> {
    let weak = Arc::downgrade(context);
    let is_owner = Arc::new(is_owner);
    context
        .session
        .declare_queryable(keys::SETTINGS)
        .callback(move |query| {
            let Some(context) = weak.upgrade() else { return };
            if query.key_expr().as_str() == keys::SETTINGS {
                let asked = Arc::clone(&context);
                context.spawn(async move { all_settings(&asked, &query) });
                return;
            }
            // Every server is asked; one answers.
            let camera = keys::name(query.key_expr().as_str()).map(ToOwned::to_owned);
            if let Some(camera) = camera.filter(|camera| is_owner(camera)) {
                let work = settings(Arc::clone(&context), query, camera);
                context.spawn(work);
            }
        })
        .await
}

/// What this server knows about all cameras, for a server that has just come.
fn all_settings(context: &Context, query: &Query) {
    for (camera, revision) in context.settings.all() {
        sent(|| {
            query
                .reply(keys::settings(&camera), revision.encoded())
                .encoding(payload::encoding("CameraSettings"))
                .wait()
        });
    }
}

async fn settings(context: Arc<Context>, query: Query, camera: String) {
    let given = query.payload().filter(|payload| !payload.is_empty());
    let revision = match given {
        None => Ok(context.settings.read(&camera)),
        Some(payload) => change(&context, &query, &camera, payload),
    };
    match revision {
        Err(error) => refuse(&query, &error, ""),
        Ok(revision) => {
            if given.is_some() {
                announce(&context, &camera, &revision).await;
            }
            sent(|| {
                query
                    .reply(query.key_expr(), revision.encoded())
                    .encoding(payload::encoding("CameraSettings"))
                    .wait()
            });
        }
    }
}

fn change(
    context: &Context,
    query: &Query,
    camera: &str,
    given: &ZBytes,
) -> Result<Arc<Revision>, ServiceError> {
    let encoding = query.encoding().cloned().unwrap_or_default();
    payload::expect_message(&encoding, "CameraSettings")?;
    if given.len() as u64 > context.body_bytes {
        return Err(ServiceError::TooLarge("these settings are too large".to_owned()));
    }
    let revision = context.settings.set(camera, payload::bytes(given))?;
    tracing::info!(
        camera,
        revision = revision.number,
        "the settings of a camera have changed"
    );
    Ok(revision)
}

/// Lets the other servers know, so that whoever takes the camera over goes on with the same settings.
async fn announce(context: &Context, camera: &str, revision: &Revision) {
    let put = context
        .session
        .put(keys::settings(camera), revision.encoded())
        .encoding(payload::encoding("CameraSettings"));
    if let Err(why) = put.await {
        tracing::warn!(camera, %why, "new settings can't be announced to other servers");
    }
}

/// Sends a result.
fn answer(context: &Context, query: &Query, body: &Encoded) {
    let (payload, way) = outgoing::payload(body);
    sent(|| {
        query
            .reply(query.key_expr(), payload)
            .encoding(payload::encoding("StereoResult"))
            // Not held back to be sent together with others.
            .express(true)
            .wait()?;
        context.service.metrics().zenoh_result(way.name());
        Ok(())
    });
}

fn refuse(query: &Query, error: &ServiceError, request_id: &str) {
    let status = error.to_status(request_id).encode_to_vec();
    sent(|| {
        query
            .reply_err(status)
            .encoding(payload::encoding("Status"))
            .wait()
    });
}

/// Sends something, and lets another thread do this one's other tasks meanwhile: a link that is full makes it wait.
fn sent(reply: impl FnOnce() -> zenoh::Result<()>) {
    if let Err(why) = block_in_place(reply) {
        // Whoever asked has gone, or waits no longer.
        tracing::debug!(%why, "a reply can't be sent");
    }
}
