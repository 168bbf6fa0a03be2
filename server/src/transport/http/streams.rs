//! `GET /v1/streams..`: camera streams as this server sees them, whatever transport they come over.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use axum::extract::{Extension, Path, State};
use axum::http::{HeaderMap, StatusCode, Uri};
use axum::response::sse::{Event as Sse, KeepAlive};
use axum::response::{IntoResponse, Response, Sse as SseResponse};
use futures_util::stream;
use tokio::sync::broadcast::error::RecvError;

use super::about::{json, typed};
use super::description::{Binary, FrameViewName};
use super::frames::view;
use super::refusal::Refusal;
use super::{Http, negotiate};
use crate::clients::Caller;
use crate::encode::Summary;
use crate::status::ServiceError;
use crate::streams::{Event, Stream, StreamView, StreamsView, event_json};

/// The view that has everything in it, a `StreamView`.
const WHOLE_FRAME: &str = "frame";
/// How long the next result of a stream is waited for.
const NEXT_RESULT_WITHIN: Duration = Duration::from_secs(2);
/// Time between two signs of life while nothing happens.
const KEEP_ALIVE: Duration = Duration::from_secs(5);

/// `GET /v1/streams`.
#[utoipa::path(
    get,
    path = "/v1/streams",
    tag = "streams",
    summary = "Every stream of a camera that the client may use, and the network they come over",
    responses((status = 200, description = "All streams", body = StreamsView), Refusal),
)]
pub(super) async fn all(State(http): State<Arc<Http>>, Extension(caller): Extension<Caller>) -> Response {
    let may_see = |camera: &str| caller.check_camera(camera).is_ok();
    json(StatusCode::OK, &StreamsView::of(&http.streams, may_see))
}

/// `GET /v1/streams/{camera}`.
#[utoipa::path(
    get,
    path = "/v1/streams/{camera}",
    tag = "streams",
    summary = "One camera's stream",
    params(("camera" = String, Path, description = "Name of the camera")),
    responses((status = 200, description = "The stream", body = StreamView), Refusal),
)]
pub(super) async fn one(
    State(http): State<Arc<Http>>,
    Extension(caller): Extension<Caller>,
    Path(camera): Path<String>,
) -> Result<Response, Refusal> {
    Ok(json(
        StatusCode::OK,
        &StreamView::of(&*find(&http, &caller, &camera)?),
    ))
}

/// `GET /v1/streams/{camera}/latest`: the next result, in the accepted format; with `?view=frame`, everything there is to see of it.
#[utoipa::path(
    get,
    path = "/v1/streams/{camera}/latest",
    tag = "streams",
    summary = "A camera's next result",
    description = "Waits two seconds at most. `Accept` chooses the format as for a single pair.",
    params(
        ("camera" = String, Path, description = "Name of the camera"),
        ("view" = inline(Option<FrameViewName>), Query, description = "A picture as PNG, or everything there is to see of the frame as `stereo.v1.StreamView`"),
    ),
    responses(
        (status = 200, description = "The result", content(
            (Summary = "application/json"),
            (Binary = "application/x-protobuf"),
            (Binary = "image/png"),
            (Binary = "model/gltf-binary"),
        )),
        Refusal,
    ),
)]
pub(super) async fn latest(
    State(http): State<Arc<Http>>,
    Extension(caller): Extension<Caller>,
    Path(camera): Path<String>,
    uri: Uri,
    headers: HeaderMap,
) -> Result<Response, Refusal> {
    let stream = find(&http, &caller, &camera)?;
    let reply = match view(uri.query().unwrap_or_default())?.as_deref() {
        Some(WHOLE_FRAME) => negotiate::whole_frame(&headers)?,
        view => negotiate::reply(&headers, view)?,
    };
    let Some(_watch) = stream.watch(reply.format) else {
        let got = reply.media_type.to_owned();
        let expected = "application/x-protobuf, application/json, image/png or model/gltf-binary";
        return Err(ServiceError::NotAcceptable { expected, got }.into());
    };
    let mut events = stream.events();
    let next = async {
        loop {
            match events.recv().await {
                Ok(Event::Answered(seen)) => {
                    if let Some(body) = seen.bodies.get(reply.format) {
                        return Some(body.clone());
                    }
                }
                Ok(Event::Dropped { .. }) | Err(RecvError::Lagged(_)) => {}
                Err(RecvError::Closed) => return None,
            }
        }
    };
    match tokio::time::timeout(NEXT_RESULT_WITHIN, next).await {
        Ok(Some(body)) => Ok(typed(StatusCode::OK, reply.media_type, body)),
        Ok(None) | Err(_) => Err(ServiceError::NoFrames {
            camera,
            waited: NEXT_RESULT_WITHIN,
        }
        .into()),
    }
}

/// `GET /v1/streams/{camera}/events`: server-sent events, `result` and `dropped`, as they happen; `missed` says how many a slow reader
/// has missed.
#[utoipa::path(
    get,
    path = "/v1/streams/{camera}/events",
    tag = "streams",
    summary = "What becomes of a camera's frames, as it happens",
    description = "Server-sent events `result`, `dropped` and `missed` with JSON data, until the server stops or the client goes.",
    params(("camera" = String, Path, description = "Name of the camera")),
    responses((status = 200, description = "Events", body = String, content_type = "text/event-stream"), Refusal),
)]
pub(super) async fn events(
    State(http): State<Arc<Http>>,
    Extension(caller): Extension<Caller>,
    Path(camera): Path<String>,
) -> Result<Response, Refusal> {
    let stream = find(&http, &caller, &camera)?;
    let draining = {
        let http = Arc::clone(&http);
        Box::pin(async move { http.service.draining().await })
    };
    let live = stream::unfold((stream.events(), draining), |(mut events, mut draining)| async {
        let (name, data) = tokio::select! {
            () = &mut draining => return None,
            event = events.recv() => match event {
                Ok(event) => event_json(&event),
                Err(RecvError::Lagged(count)) => ("missed", serde_json::json!({ "events": count })),
                Err(RecvError::Closed) => return None,
            },
        };
        let event = Sse::default().event(name).data(data.to_string());
        Some((Ok::<_, Infallible>(event), (events, draining)))
    });
    let keep_alive = KeepAlive::new().interval(KEEP_ALIVE);
    Ok(SseResponse::new(live).keep_alive(keep_alive).into_response())
}

fn find(http: &Http, caller: &Caller, camera: &str) -> Result<Arc<Stream>, ServiceError> {
    caller.check_camera(camera)?;
    http.streams
        .get(camera)
        .ok_or_else(|| ServiceError::NoSuchStream {
            camera: camera.chars().take(64).collect(),
        })
}
