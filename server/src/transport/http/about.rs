//! Routes that describe the server: what it is, how to talk to it, whether it lives, whether it is ready.

use std::sync::Arc;

use axum::body::Body;
use axum::extract::State;
use axum::http::header::CONTENT_TYPE;
use axum::http::{HeaderValue, StatusCode};
use axum::response::Response;
use bytes::Bytes;
use serde::Serialize;
use tokio::runtime::Handle;
use utoipa::ToSchema;

use super::Http;
use super::description::Binary;
use super::refusal::Refusal;
use crate::info::Info;
use crate::service::Health;
use crate::status::ServiceError;
use crate::streams::Network;

/// Media type of OpenMetrics text.
const OPEN_METRICS: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// `GET /v1/info`.
#[utoipa::path(
    get,
    path = "/v1/info",
    tag = "server",
    summary = "What the server is: version, limits, presets and their ladders",
    responses((status = 200, description = "The server", body = Info), Refusal),
)]
pub(super) async fn info(State(http): State<Arc<Http>>) -> Response {
    json(StatusCode::OK, &http.info)
}

/// `GET /v1/schema.binpb`: the wire's messages as a `google.protobuf.FileDescriptorSet`.
#[utoipa::path(
    get,
    path = "/v1/schema.binpb",
    tag = "server",
    security(()),
    summary = "The protobuf messages, as a google.protobuf.FileDescriptorSet",
    responses((status = 200, description = "The schema", body = Binary, content_type = "application/x-protobuf"), Refusal),
)]
pub(super) async fn schema() -> Response {
    typed(
        StatusCode::OK,
        super::negotiate::PROTOBUF,
        Bytes::from_static(stereo_proto::DESCRIPTOR_SET),
    )
}

/// `GET /livez`: the process answers.
#[utoipa::path(
    get,
    path = "/livez",
    tag = "server",
    security(()),
    summary = "Whether the process answers",
    responses((status = 200, description = "It does", body = Liveness), Refusal),
)]
pub(super) async fn live() -> Response {
    json(StatusCode::OK, &Liveness { status: "live" })
}

/// `GET /readyz`: 200 if a frame sent now would be taken, else 503 and why not.
#[utoipa::path(
    get,
    path = "/readyz",
    tag = "server",
    security(()),
    summary = "Whether a frame sent now would be taken",
    responses(
        Refusal,
        (status = 200, description = "It would", body = Readiness),
        (status = 503, description = "It would not, and why", body = Readiness),
    ),
)]
pub(super) async fn ready(State(http): State<Arc<Http>>) -> Response {
    let (code, readiness) = readiness(http.service.health(), http.streams.network());
    json(code, &readiness)
}

/// `GET /metrics`: OpenMetrics text.
#[utoipa::path(
    get,
    path = "/metrics",
    tag = "server",
    summary = "Everything that is counted, as OpenMetrics text",
    description = "At the address of `--admin` alone, without a token, where there is one.",
    responses(
        (status = 200, description = "The metrics", body = String, content_type = "application/openmetrics-text"),
        Refusal,
    ),
)]
pub(super) async fn metrics(State(http): State<Arc<Http>>) -> Response {
    let metrics = http.service.metrics();
    let (bodies, batches) = http.bodies.in_flight();
    metrics.bytes_in_flight.set(bodies);
    metrics.batch_bytes_in_flight.set(batches);
    let tasks = Handle::current().metrics().num_alive_tasks();
    // Lossless: no machine has room for more.
    metrics.tasks.set(i64::try_from(tasks).unwrap_or(i64::MAX));
    typed(StatusCode::OK, OPEN_METRICS, http.service.metrics_text().into())
}

/// The process answers.
#[derive(Serialize, ToSchema)]
pub(super) struct Liveness {
    status: &'static str,
}

/// Whether a frame sent now would be taken.
#[derive(Debug, PartialEq, Eq, Serialize, ToSchema)]
pub(super) struct Readiness {
    status: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    why: Option<String>,
    queue_depth: usize,
    zenoh: Network,
}

fn readiness(health: Health, zenoh: Network) -> (StatusCode, Readiness) {
    let Health {
        workers,
        workers_primed,
        workers_failed,
        is_crippled,
        queue_depth,
        is_draining,
    } = health;
    let why = if is_draining {
        Some("the server is stopping".to_owned())
    } else if is_crippled {
        Some("a worker got stuck and can't be replaced any more: restart the server".to_owned())
    } else if workers_failed > 0 {
        Some(format!(
            "{workers_failed} of {workers} workers could not match their dummy pair: please report it"
        ))
    } else if workers_primed < workers {
        Some(format!(
            "{workers_primed} of {workers} workers have matched their dummy pair"
        ))
    } else {
        zenoh.obstacle()
    };
    match why {
        None => (
            StatusCode::OK,
            Readiness {
                status: "ready",
                why,
                queue_depth,
                zenoh,
            },
        ),
        Some(_) => (
            StatusCode::SERVICE_UNAVAILABLE,
            Readiness {
                status: "not ready",
                why,
                queue_depth,
                zenoh,
            },
        ),
    }
}

pub(super) fn json(code: StatusCode, value: &impl Serialize) -> Response {
    match serde_json::to_vec(value) {
        Ok(body) => typed(code, "application/json", body.into()),
        Err(error) => axum::response::IntoResponse::into_response(Refusal::from(ServiceError::Internal(
            format!("the answer can't be written as JSON: {error}"),
        ))),
    }
}

pub(super) fn typed(code: StatusCode, media_type: &'static str, body: Bytes) -> Response {
    let mut response = Response::new(Body::from(body));
    *response.status_mut() = code;
    response
        .headers_mut()
        .insert(CONTENT_TYPE, HeaderValue::from_static(media_type));
    response
}

#[cfg(test)]
mod tests {
    use super::*;

    const READY: Health = Health {
        workers: 2,
        workers_primed: 2,
        workers_failed: 0,
        queue_depth: 3,
        is_draining: false,
        is_crippled: false,
    };

    #[test]
    fn a_server_is_ready_when_all_workers_are_primed_and_it_is_not_stopping() {
        let ready = Readiness {
            status: "ready",
            why: None,
            queue_depth: 3,
            zenoh: Network::default(),
        };
        assert_eq!(readiness(READY, Network::default()), (StatusCode::OK, ready));
    }

    #[test]
    fn a_server_that_is_not_ready_says_why() {
        let (code, cold) = readiness(
            Health {
                workers_primed: 1,
                ..READY
            },
            Network::default(),
        );
        assert_eq!(code, StatusCode::SERVICE_UNAVAILABLE);
        assert_eq!(
            cold.why.as_deref(),
            Some("1 of 2 workers have matched their dummy pair")
        );
        let (code, broken) = readiness(
            Health {
                workers_primed: 1,
                workers_failed: 1,
                ..READY
            },
            Network::default(),
        );
        assert_eq!(code, StatusCode::SERVICE_UNAVAILABLE);
        assert!(
            broken
                .why
                .is_some_and(|why| why.starts_with("1 of 2 workers could not"))
        );
        let (code, stopping) = readiness(
            Health {
                is_draining: true,
                ..READY
            },
            Network::default(),
        );
        assert_eq!(code, StatusCode::SERVICE_UNAVAILABLE);
        assert_eq!(stopping.why.as_deref(), Some("the server is stopping"));
    }
}
