//! What can be refused, and the one table from a refusal to the wire's `Status` and to HTTP.

use std::time::Duration;

use serde::Serialize;
use stereo_proto::v1::{Reason, Status};
use thiserror::Error;
use utoipa::ToSchema;

/// The longest text of a refusal, in bytes: nothing that was sent comes back at length.
pub const LONGEST_TEXT: usize = 1000;
/// What is left of the beginning of a longer one.
const LONGEST_START: usize = 500;
const ELLIPSIS: &str = " [..] ";

/// Why a request got no result. The text is one sentence that says what to do; it goes to the client as it is.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum ServiceError {
    /// Malformed, out of range, contradictory or not built yet.
    #[error("{0}")]
    Invalid(String),
    /// No token and no certificate, or one that is nobody's.
    #[error("{}", unauthenticated(*.is_wrong))]
    Unauthenticated {
        /// Whether there was one.
        is_wrong: bool,
    },
    /// A client that may not use a camera.
    #[error(
        "client {client} may not use camera {camera}: use one of its own, or have clients.{client}.cameras of the server's configuration \
         name this one"
    )]
    Forbidden {
        /// Its name.
        client: String,
        /// The camera's name.
        camera: String,
    },
    /// More requests a second than the client may send.
    #[error("client {client} may send {limit} requests a second: send fewer, or wait for {} ms", ms(*.wait))]
    Rate {
        /// Its name.
        client: String,
        /// Requests a second.
        limit: u32,
        /// How long to wait.
        wait: Duration,
    },
    /// More bytes at one time than the client may have.
    #[error(
        "client {client} may have {limit} bytes of requests and replies under way at one time: wait for its other replies"
    )]
    ClientBytes {
        /// Its name.
        client: String,
        /// How many it may have.
        limit: u64,
    },
    /// The resource does not exist.
    #[error("there is nothing at {path}: the service is at POST /v1/stereo, its description at GET /v1/info")]
    NoSuchResource {
        /// The path that was asked for.
        path: String,
    },
    /// No camera of that name has been seen.
    #[error("there is no stream of a camera called {camera:?} here: GET /v1/streams lists those there are")]
    NoSuchStream {
        /// The name that was asked for.
        camera: String,
    },
    /// A stream stands still.
    #[error(
        "camera {camera} had no result for {waited:?}: GET /v1/streams/{camera} says what comes in and what is dropped"
    )]
    NoFrames {
        /// The camera.
        camera: String,
        /// For how long the server waited.
        waited: Duration,
    },
    /// The resource has other methods.
    #[error("{path} does not take {got}: use {expected}")]
    MethodNotAllowed {
        /// The path that was asked for.
        path: String,
        /// Its methods.
        expected: &'static str,
        /// The method that was used.
        got: String,
    },
    /// No wanted reply type can be made.
    #[error("none of the accepted types `{got}` can be made: accept one of {expected}")]
    NotAcceptable {
        /// The reply types there are.
        expected: &'static str,
        /// The `Accept` header.
        got: String,
    },
    /// The body came too slowly.
    #[error("the request was not complete after {limit:?}: send it faster or in a smaller encoding")]
    ReadTimeout {
        /// How long the server waited.
        limit: Duration,
    },
    /// The body's type is not understood.
    #[error("the content type `{got}` is not understood: send {expected}")]
    UnsupportedMediaType {
        /// The types there are.
        expected: &'static str,
        /// The `Content-Type` header, or `none`.
        got: String,
    },
    /// Valid, but this pair can't be matched so.
    #[error("{0}")]
    Unmatchable(String),
    /// Body or image over a limit.
    #[error("{0}")]
    TooLarge(String),
    /// The queue is full.
    #[error("{limit} requests wait already: try again in a moment or at another server")]
    QueueFull {
        /// How many may wait.
        limit: usize,
        /// When there should be room, if that is known.
        earliest_feasible: Option<Duration>,
    },
    /// The bodies of other requests fill the memory there is for them.
    #[error(
        "the requests under way fill the {limit} bytes there are for them: try again in a moment or at another server"
    )]
    BytesInFlight {
        /// How many bytes all bodies together may have.
        limit: u64,
    },
    /// The client's share is used up and the others need the rest.
    #[error(
        "this client has used up its share of the server, and the others need the rest: {}", feasible(*.earliest_feasible)
    )]
    Quota {
        /// The smallest budget that could be met now, if that is known.
        earliest_feasible: Option<Duration>,
    },
    /// A newer frame of the camera came before this one was begun.
    #[error(
        "a newer frame of this camera has taken the place of this one: send the newest only, or no sequence numbers"
    )]
    Superseded,
    /// A best-effort frame whose place was needed.
    #[error(
        "this best-effort request made room for one of class deadline: try again in a moment or at another server"
    )]
    Displaced,
    /// The replies of a batch pile up.
    #[error(
        "the replies were not read for {limit:?}, so what was left of the batch was dropped: read while writing"
    )]
    SlowReader {
        /// How long the server waited.
        limit: Duration,
    },
    /// There are connections enough.
    #[error("{limit} connections are open already: try again in a moment or at another server")]
    TooManyConnections {
        /// How many may be open.
        limit: u32,
    },
    /// The server is stopping.
    #[error("the server is stopping and takes no new work: try another server")]
    Draining,
    /// Refused before any work.
    #[error("a budget of {} ms can't be met: {}", ms(*.budget), feasible(*.earliest_feasible))]
    DeadlineInfeasible {
        /// The budget that was given.
        budget: Duration,
        /// The smallest one that could be met now, if that is known.
        earliest_feasible: Option<Duration>,
    },
    /// The deadline passed before a result was ready.
    #[error("the budget of {} ms was over before a result was ready: {}", ms(*.budget), feasible(*.earliest_feasible))]
    Expired {
        /// The budget that was given.
        budget: Duration,
        /// The smallest one that could be met now, if that is known.
        earliest_feasible: Option<Duration>,
    },
    /// A fault of the server; the text says what failed, not how.
    #[error("the server failed at this request ({0}): other requests are not affected; please report it")]
    Internal(String),
}

impl ServiceError {
    /// Every HTTP status code of the table.
    pub(crate) const HTTP_CODES: [u16; 15] = [
        400, 401, 403, 404, 405, 406, 408, 409, 413, 415, 422, 429, 500, 503, 504,
    ];

    /// The table: what the client's program sees, and the HTTP status code.
    #[must_use]
    pub fn reason_and_code(&self) -> (Reason, u16) {
        match self {
            Self::Invalid(_) => (Reason::Invalid, 400),
            Self::NoSuchResource { .. } | Self::NoSuchStream { .. } | Self::NoFrames { .. } => {
                (Reason::Invalid, 404)
            }
            Self::Unauthenticated { .. } => (Reason::Unauthenticated, 401),
            Self::Forbidden { .. } => (Reason::Forbidden, 403),
            Self::MethodNotAllowed { .. } => (Reason::Invalid, 405),
            Self::NotAcceptable { .. } => (Reason::Invalid, 406),
            Self::ReadTimeout { .. } => (Reason::Expired, 408),
            Self::UnsupportedMediaType { .. } => (Reason::Invalid, 415),
            Self::Unmatchable(_) => (Reason::Invalid, 422),
            Self::TooLarge(_) => (Reason::TooLarge, 413),
            Self::Superseded => (Reason::Superseded, 409),
            Self::SlowReader { .. } => (Reason::SlowReader, 408),
            Self::Quota { .. } | Self::Rate { .. } | Self::ClientBytes { .. } => (Reason::Quota, 429),
            Self::Internal(_) => (Reason::Internal, 500),
            Self::Displaced | Self::TooManyConnections { .. } => (Reason::QueueFull, 503),
            Self::QueueFull { .. } => (Reason::QueueFull, 503),
            Self::BytesInFlight { .. } => (Reason::QueueFull, 503),
            Self::Draining => (Reason::Draining, 503),
            Self::DeadlineInfeasible { .. } => (Reason::DeadlineInfeasible, 504),
            Self::Expired { .. } => (Reason::Expired, 504),
        }
    }

    /// Why, for programs.
    #[must_use]
    pub fn reason(&self) -> Reason {
        self.reason_and_code().0
    }

    /// Why, as metrics and problem details write it: `QUEUE_FULL`.
    #[must_use]
    pub fn reason_name(&self) -> &'static str {
        reason_name(self.reason())
    }

    /// The HTTP status code.
    #[must_use]
    pub fn http_code(&self) -> u16 {
        self.reason_and_code().1
    }

    /// The smallest budget that could be met now, or how long to wait before trying again.
    #[must_use]
    pub fn earliest_feasible(&self) -> Option<Duration> {
        match self {
            Self::QueueFull {
                earliest_feasible, ..
            }
            | Self::Quota { earliest_feasible }
            | Self::DeadlineInfeasible {
                earliest_feasible, ..
            }
            | Self::Expired {
                earliest_feasible, ..
            } => *earliest_feasible,
            Self::Rate { wait, .. } => Some(*wait),
            _ => None,
        }
    }

    /// The value of HTTP's `Retry-After` in seconds, rounded up and at least 1; `None` if trying again is no help.
    #[must_use]
    pub fn retry_after_s(&self) -> Option<u64> {
        let wait = match self {
            Self::QueueFull { .. }
            | Self::BytesInFlight { .. }
            | Self::Draining
            | Self::Displaced
            | Self::Quota { .. }
            | Self::ClientBytes { .. }
            | Self::TooManyConnections { .. } => self.earliest_feasible().unwrap_or(Duration::from_secs(1)),
            _ => self.earliest_feasible()?,
        };
        Some((wait.as_secs() + u64::from(wait.subsec_nanos() > 0)).max(1))
    }

    /// The sentence as clients and logs get it, of at most [`LONGEST_TEXT`] bytes. Some name what was sent, which may be long: then the
    /// beginning is left, which says what it is about, and the end, which says what to do.
    #[must_use]
    pub fn text(&self) -> String {
        let whole = self.to_string();
        if whole.len() <= LONGEST_TEXT {
            return whole;
        }
        let end = whole.ceil_char_boundary(whole.len() - (LONGEST_TEXT - LONGEST_START - ELLIPSIS.len()));
        let start = whole.floor_char_boundary(LONGEST_START);
        [&whole[..start], ELLIPSIS, &whole[end..]].concat()
    }

    /// The wire's refusal; `request_id` is empty if it could not be read.
    #[must_use]
    pub fn to_status(&self, request_id: &str) -> Status {
        let (reason, code) = self.reason_and_code();
        Status {
            code: u32::from(code),
            reason: reason.into(),
            message: self.text(),
            earliest_feasible: self.earliest_feasible().and_then(|wait| wait.try_into().ok()),
            request_id: request_id.to_owned(),
        }
    }

    /// The body of type `application/problem+json` (RFC 9457); `request_id` is left out if empty.
    #[must_use]
    pub fn to_problem_json(&self, request_id: &str) -> Vec<u8> {
        let (reason, code) = self.reason_and_code();
        let problem = Problem {
            kind: "about:blank",
            title: title(code),
            status: code,
            detail: self.text(),
            reason: reason_name(reason),
            earliest_feasible_ms: self.earliest_feasible().map(|wait| wait.as_secs_f64() * 1e3),
            request_id,
        };
        // Strings and finite numbers always serialise; an empty body would still carry the status code.
        serde_json::to_vec(&problem).unwrap_or_default()
    }
}

/// A refusal: RFC 9457's members and ours.
#[derive(Serialize, ToSchema)]
pub(crate) struct Problem<'a> {
    #[serde(rename = "type")]
    kind: &'static str,
    title: &'static str,
    /// The HTTP status code.
    status: u16,
    /// What is wrong and what to do.
    detail: String,
    /// Why, for programs: `stereo.v1.Reason` without its prefix.
    reason: &'static str,
    /// The smallest budget that could be met now, or how long to wait before trying again.
    #[serde(skip_serializing_if = "Option::is_none")]
    earliest_feasible_ms: Option<f64>,
    #[serde(skip_serializing_if = "str::is_empty")]
    request_id: &'a str,
}

/// A reason without the enum's prefix.
fn reason_name(reason: Reason) -> &'static str {
    let name = reason.as_str_name();
    name.strip_prefix("REASON_").unwrap_or(name)
}

/// HTTP's own phrase, as RFC 9457 wants for `about:blank`.
pub(crate) fn title(code: u16) -> &'static str {
    match code {
        400 => "Bad Request",
        401 => "Unauthorized",
        403 => "Forbidden",
        404 => "Not Found",
        405 => "Method Not Allowed",
        406 => "Not Acceptable",
        408 => "Request Timeout",
        409 => "Conflict",
        413 => "Content Too Large",
        415 => "Unsupported Media Type",
        422 => "Unprocessable Content",
        429 => "Too Many Requests",
        503 => "Service Unavailable",
        504 => "Gateway Timeout",
        _ => "Internal Server Error",
    }
}

/// What to do to be let in.
fn unauthenticated(is_wrong: bool) -> &'static str {
    match is_wrong {
        true => {
            "nobody has this token or this certificate's name here: correct it, or have a new token made (stereod token NAME)"
        }
        false => {
            "this server wants to know who asks: send `Authorization: Bearer TOKEN`, as stereod token NAME makes one, or show a client's certificate"
        }
    }
}

/// A duration in ms as people write it.
fn ms(duration: Duration) -> f64 {
    (duration.as_secs_f64() * 1e6).round() / 1e3
}

/// What to do about a budget that is too short.
fn feasible(earliest: Option<Duration>) -> String {
    match earliest {
        Some(budget) => format!("now it would take at least {} ms", ms(budget)),
        None => "give a larger one, ask for fewer outputs, or send smaller images".to_owned(),
    }
}

#[cfg(test)]
mod tests;
