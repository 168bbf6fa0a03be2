//! Refusals on their way out. Routes only say what went wrong; the envelope writes it in the form the client reads.

use std::collections::BTreeMap;

use axum::body::Body;
use axum::http::header::{ALLOW, CONNECTION, CONTENT_TYPE, RETRY_AFTER, WWW_AUTHENTICATE};
use axum::http::{HeaderValue, StatusCode, Version};
use axum::response::{IntoResponse, Response};
use prost::Message;
use utoipa::IntoResponses;
use utoipa::openapi::{self, Content, Ref, RefOr, ResponseBuilder};

use super::body::leave_unread;
use super::negotiate::{PROBLEM_JSON, PROTOBUF, RefusalForm};
use crate::status::{ServiceError, title};

/// A refusal that has not been written yet: a response that carries it as an extension.
#[derive(Debug, Clone)]
pub(super) struct Refusal {
    error: ServiceError,
    /// The name that the body gives the request; `None` = the one its head has.
    request_id: Option<String>,
    /// A large body was not read: the client is told that the connection ends, so that it stops sending.
    closes: bool,
}

impl Refusal {
    /// Of a request that is called `request_id`.
    pub(super) fn of(error: ServiceError, request_id: String) -> Self {
        Self {
            error,
            request_id: Some(request_id),
            closes: false,
        }
    }

    /// Of a request whose body nobody reads.
    pub(super) fn unread(body: Body, error: ServiceError) -> Self {
        Self {
            closes: leave_unread(body),
            ..Self::from(error)
        }
    }
}

impl From<ServiceError> for Refusal {
    fn from(error: ServiceError) -> Self {
        Self {
            error,
            request_id: None,
            closes: false,
        }
    }
}

impl IntoResponse for Refusal {
    fn into_response(self) -> Response {
        let mut response = status(&self.error).into_response();
        response.extensions_mut().insert(self);
        response
    }
}

impl IntoResponses for Refusal {
    /// Every code of the table, in both forms.
    fn responses() -> BTreeMap<String, RefOr<openapi::Response>> {
        let described = |code: u16| {
            ResponseBuilder::new()
                .description(title(code))
                .content(PROBLEM_JSON, Content::new(Some(Ref::from_schema_name("Problem"))))
                .content(PROTOBUF, Content::new(Some(Ref::from_schema_name("Binary"))))
                .into()
        };
        let codes = ServiceError::HTTP_CODES.into_iter();
        codes.map(|code| (code.to_string(), described(code))).collect()
    }
}

/// Writes the body of a response that is an unwritten refusal; leaves every other as it is.
pub(super) fn written(
    mut response: Response,
    (form, version): (RefusalForm, Version),
    request_id: &str,
) -> Response {
    match response.extensions_mut().remove::<Refusal>() {
        Some(Refusal {
            error,
            request_id: own,
            closes,
        }) => {
            let mut response = write(&error, form, own.as_deref().unwrap_or(request_id));
            if closes && version < Version::HTTP_2 {
                let close = HeaderValue::from_static("close");
                response.headers_mut().insert(CONNECTION, close);
            }
            response
        }
        None => response,
    }
}

/// A refusal as a response.
pub(super) fn write(error: &ServiceError, form: RefusalForm, request_id: &str) -> Response {
    let (media_type, body) = match form {
        RefusalForm::Problem => (PROBLEM_JSON, error.to_problem_json(request_id)),
        RefusalForm::Status => (PROTOBUF, error.to_status(request_id).encode_to_vec()),
    };
    let mut response = Response::new(Body::from(body));
    *response.status_mut() = status(error);
    let headers = response.headers_mut();
    headers.insert(CONTENT_TYPE, HeaderValue::from_static(media_type));
    if let Some(seconds) = error.retry_after_s() {
        headers.insert(RETRY_AFTER, HeaderValue::from(seconds));
    }
    if let ServiceError::MethodNotAllowed { expected, .. } = error {
        headers.insert(ALLOW, HeaderValue::from_static(expected));
    }
    if let ServiceError::Unauthenticated { is_wrong } = error {
        let challenge = match is_wrong {
            true => "Bearer realm=\"stereod\", error=\"invalid_token\"",
            false => "Bearer realm=\"stereod\"",
        };
        headers.insert(WWW_AUTHENTICATE, HeaderValue::from_static(challenge));
    }
    response
}

fn status(error: &ServiceError) -> StatusCode {
    // The table has no code outside 100..1000.
    StatusCode::from_u16(error.http_code()).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR)
}
