//! What can go wrong on the way to a result.

use std::time::Duration;

use serde::Deserialize;
use stereo_proto::v1::{Reason, Status};
use thiserror::Error;

/// Why there is no result; the text says what to do.
#[derive(Debug, Error)]
pub enum ClientError {
    /// The address can't be used.
    #[error(
        "`{url}` is no address of a server ({why}): give one such as http://127.0.0.1:8080, or tcp/127.0.0.1:7447 over Zenoh"
    )]
    BadUrl {
        /// What was given.
        url: String,
        /// What is wrong with it.
        why: String,
    },
    /// A token or a certificate can't be used.
    #[error("the {what} can't be used: {why}")]
    BadAccess {
        /// Which of them.
        what: &'static str,
        /// What is wrong with it, and what to do.
        why: String,
    },
    /// Nobody answers there.
    #[error("no answer from {url} ({why}): start the server or correct the address")]
    Unreachable {
        /// Where it was tried.
        url: String,
        /// What the system said.
        why: String,
    },
    /// TLS does not trust who answers, or they don't trust this client.
    #[error("no secure connection to {url}: {why}")]
    Insecure {
        /// Where it was tried.
        url: String,
        /// What is wrong, and what to do.
        why: String,
    },
    /// Something else than a web server answers.
    #[error("what answers at {url} does not speak HTTP: check host and port, or use https:// if it has TLS")]
    NotHttp {
        /// Who answered.
        url: String,
    },
    /// The answer did not come whole or not in time.
    #[error("the answer of {url} was cut off ({why}): try again")]
    Interrupted {
        /// Who was answering.
        url: String,
        /// What the system said.
        why: String,
    },
    /// The server said why it refuses.
    #[error("refused with {} (HTTP {}): {}", .0.reason().as_str_name().trim_start_matches("REASON_"), .0.code, .0.message)]
    Refused(Status),
    /// An answer in no form that a stereod has.
    #[error("{url} answered HTTP {code} and not as a stereod does: check the address and what lies between")]
    Unexpected {
        /// Who answered.
        url: String,
        /// The HTTP status code.
        code: u16,
    },
    /// A message or payload that can't be read.
    #[error("the answer can't be read ({0}): use a client of the server's version")]
    Malformed(String),
    /// The Zenoh session can't be used.
    #[error("the Zenoh session can't be used ({0}): open another one")]
    Network(String),
    /// No server answered in time.
    #[error(
        "no server answered within {waited:?} ({why}): start one, or give more time; GET /readyz of a server says whom it reaches"
    )]
    Unavailable {
        /// For how long.
        waited: Duration,
        /// The last thing that happened.
        why: String,
    },
    /// No server takes the frames of a camera.
    #[error(
        "no server serves camera {camera} after {waited:?}: start one on this network, or ask `stereo doctor`"
    )]
    NotServed {
        /// Whose frames.
        camera: String,
        /// For how long it was waited.
        waited: Duration,
    },
    /// A camera gives no results.
    #[error("no result of camera {camera} within {waited:?}: {why}")]
    NoResults {
        /// Whose results.
        camera: String,
        /// For how long they were waited for.
        waited: Duration,
        /// What is missing, and what to do.
        why: String,
    },
    /// The server did not become ready.
    #[error("{url} was not ready after {waited:?} ({why}): wait longer or look into the server's log")]
    NotReady {
        /// Who was asked.
        url: String,
        /// For how long.
        waited: Duration,
        /// The last answer.
        why: String,
    },
}

impl ClientError {
    /// The refusal, if that is what it is.
    #[must_use]
    pub fn status(&self) -> Option<&Status> {
        match self {
            Self::Refused(status) => Some(status),
            _ => None,
        }
    }
}

/// The members of a refusal as `application/problem+json` that a [`Status`] has too.
#[derive(Deserialize)]
struct Problem {
    status: u32,
    detail: String,
    reason: String,
    #[serde(default)]
    earliest_feasible_ms: Option<f64>,
    #[serde(default)]
    request_id: String,
}

/// A refusal from RFC 9457 JSON, as the message it also comes as.
pub(crate) fn status_from_problem_json(json: &[u8]) -> Option<Status> {
    let problem: Problem = serde_json::from_slice(json).ok()?;
    let earliest = problem
        .earliest_feasible_ms
        .and_then(|ms| Duration::try_from_secs_f64(ms / 1e3).ok());
    Some(Status {
        code: problem.status,
        reason: Reason::from_str_name(&format!("REASON_{}", problem.reason))
            .unwrap_or_default()
            .into(),
        message: problem.detail,
        earliest_feasible: earliest.and_then(|wait| wait.try_into().ok()),
        request_id: problem.request_id,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn problem_details_become_the_status_they_describe() {
        let json =
            br#"{"type": "about:blank", "title": "Gateway Timeout", "status": 504, "detail": "too late",
            "reason": "DEADLINE_INFEASIBLE", "earliest_feasible_ms": 12.5, "request_id": "r"}"#;
        let status = status_from_problem_json(json).unwrap();
        assert_eq!((status.code, status.reason()), (504, Reason::DeadlineInfeasible));
        assert_eq!(status.earliest_feasible.unwrap().nanos, 12_500_000);
        let text = ClientError::Refused(status).to_string();
        assert_eq!(text, "refused with DEADLINE_INFEASIBLE (HTTP 504): too late");
        assert!(status_from_problem_json(b"<html>").is_none());
    }
}
