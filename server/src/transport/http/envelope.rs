//! The outermost layer: stamps the moment a request arrived, names it, and sees to it that every answer is whole - a refusal in
//! the form the client reads, a panic as `INTERNAL`, the request's name on all of them.

use std::fmt::Write as _;
use std::panic::AssertUnwindSafe;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Instant, SystemTime, UNIX_EPOCH};

use axum::extract::{Request, State};
use axum::http::header::{CONTENT_SECURITY_POLICY, X_CONTENT_TYPE_OPTIONS};
use axum::http::{HeaderMap, HeaderName, HeaderValue};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use futures_util::FutureExt;
use tracing::Instrument;

use super::negotiate::refusal_form;
use super::refusal::{Refusal, written};
use crate::status::ServiceError;
use crate::traces;

const REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");
const TRACE_PARENT: &str = "traceparent";
/// Longest accepted `X-Request-Id`.
const MAX_ID_CHARACTERS: usize = 128;

/// Of what is no page: a browser is to show it as what it says it is, load nothing for it, and show it in no other page.
const POLICY: HeaderValue = HeaderValue::from_static("default-src 'none'; frame-ancestors 'none'");
const NO_SNIFFING: HeaderValue = HeaderValue::from_static("nosniff");

/// When a request's head was there and its body unread.
#[derive(Clone, Copy)]
pub(super) struct ReceivedAt(pub(super) Instant);

/// The request's name: the client's, or one that the server made up.
#[derive(Clone)]
pub(super) struct RequestId(pub(super) String);

/// Makes up names: the start of the process and a count.
pub(super) struct RequestNames {
    prefix: String,
    count: AtomicU64,
}

impl RequestNames {
    pub(super) fn new(instance: &str) -> Self {
        let started = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Self {
            prefix: format!("{instance}-{:x}", started.as_millis()),
            count: AtomicU64::new(0),
        }
    }

    fn next(&self) -> String {
        let mut name = self.prefix.clone();
        // Writing to a string can't fail.
        let _ = write!(name, "-{}", self.count.fetch_add(1, Ordering::Relaxed));
        name
    }

    /// The request's own name if it has an acceptable one.
    fn of(&self, headers: &HeaderMap) -> (RequestId, Result<(), ServiceError>) {
        let Some(given) = headers.get(REQUEST_ID) else {
            return (RequestId(self.next()), Ok(()));
        };
        match given.to_str() {
            Ok(text) if (1..=MAX_ID_CHARACTERS).contains(&text.len()) => (RequestId(text.to_owned()), Ok(())),
            _ => {
                let refusal =
                    format!("X-Request-Id must be 1 to {MAX_ID_CHARACTERS} printable ASCII characters");
                (RequestId(self.next()), Err(ServiceError::Invalid(refusal)))
            }
        }
    }
}

/// The layer.
pub(super) async fn wrap(
    State(names): State<std::sync::Arc<RequestNames>>,
    mut request: Request,
    next: Next,
) -> Response {
    let received_at = Instant::now();
    let form = (refusal_form(request.headers()), request.version());
    let (id, accepted) = names.of(request.headers());
    let span = span(&request, &id);
    let extensions = request.extensions_mut();
    extensions.insert(ReceivedAt(received_at));
    extensions.insert(id.clone());
    let answered = async {
        let answer = match accepted {
            Ok(()) => AssertUnwindSafe(next.run(request))
                .catch_unwind()
                .await
                .unwrap_or_else(|_| {
                    Refusal::from(ServiceError::Internal("a fault while answering".to_owned()))
                        .into_response()
                }),
            Err(error) => super::body::refuse_unread(request.into_body(), error),
        };
        let answer = written(answer, form, &id.0);
        // Frames have a line of their own (service.rs), over either transport.
        tracing::debug!(status = answer.status().as_u16(), took = ?received_at.elapsed(), "request");
        answer
    };
    let mut answer = answered.instrument(span).await;
    let headers = answer.headers_mut();
    headers.entry(CONTENT_SECURITY_POLICY).or_insert(POLICY);
    headers.insert(X_CONTENT_TYPE_OPTIONS, NO_SNIFFING);
    // Printable ASCII, so always a valid header value.
    if let Ok(value) = HeaderValue::from_str(&id.0) {
        headers.insert(REQUEST_ID, value);
    }
    answer
}

/// Everything logged while the request is served carries its name, the client's once it is known, and the client's trace.
fn span(request: &Request, id: &RequestId) -> tracing::Span {
    let trace_parent = request
        .headers()
        .get(TRACE_PARENT)
        .and_then(|value| value.to_str().ok());
    let span = tracing::info_span!(
        "http",
        method = %request.method(),
        path = request.uri().path(),
        request_id = id.0,
        client = tracing::field::Empty,
        traceparent = trace_parent,
    );
    traces::adopt(&span, request.headers());
    span
}

#[cfg(test)]
mod tests {
    use super::*;

    fn id_of(value: Option<&[u8]>) -> (RequestId, Result<(), ServiceError>) {
        let mut headers = HeaderMap::new();
        if let Some(value) = value {
            headers.insert(REQUEST_ID, HeaderValue::from_bytes(value).unwrap());
        }
        RequestNames::new("here").of(&headers)
    }

    #[test]
    fn a_client_keeps_its_own_name() {
        let (id, accepted) = id_of(Some(b"frame 7"));
        assert!(id.0 == "frame 7" && accepted.is_ok());
    }

    #[test]
    fn a_request_without_a_name_gets_one() {
        let (id, accepted) = id_of(None);
        assert!(id.0.starts_with("here-") && accepted.is_ok());
    }

    #[test]
    fn unprintable_empty_and_long_names_are_refused() {
        for value in [b"\xff".as_slice(), b"", &[b'a'; 129]] {
            let (id, accepted) = id_of(Some(value));
            assert!(accepted.is_err() && id.0.starts_with("here-"));
        }
    }
}
