//! Traces for those who collect them (OpenTelemetry, OTLP over HTTP): a span for each request and each frame, and one for each stage of it.
//!
//! ```text
//! http                    a part of the client's trace, if it sends `traceparent`
//!   frame                 request_id, camera, slack_ms; of a camera over Zenoh without `http` around it
//!     receive  queue  decode  match  mesh  encode
//! ```
//!
//! Without the feature `otel` nothing is collected.

#[cfg(not(feature = "otel"))]
#[path = "traces/off.rs"]
mod otlp;
#[cfg(feature = "otel")]
mod otlp;

use std::time::{Duration, Instant};

use axum::http::HeaderMap;
use tracing::Span;

pub use self::otlp::Traces;
use crate::job::Report;

/// Makes a request's span a part of the trace that its headers name (W3C Trace Context), if they do.
pub(crate) fn adopt(span: &Span, headers: &HeaderMap) {
    otlp::adopt(span, headers);
}

/// Adds the stages of an answered frame to its span.
pub(crate) fn stages(span: &Span, report: &Report, received_at: Instant) {
    otlp::stages(span, &in_turn(report), received_at);
}

/// A stage: its name, when it began after the frame's first byte, and how long it took.
type Stage = (&'static str, Duration, Duration);

/// The stages, one after the other.
fn in_turn(report: &Report) -> [Stage; 6] {
    let mut begun = Duration::ZERO;
    [
        ("receive", report.received),
        ("queue", report.queued),
        ("decode", report.decoded),
        ("match", report.matched),
        ("mesh", report.meshed),
        ("encode", report.encoded),
    ]
    .map(|(name, took)| {
        let stage = (name, begun, took);
        begun += took;
        stage
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_stage_begins_where_the_one_before_has_ended() {
        let report = Report {
            received: Duration::from_millis(2),
            queued: Duration::from_millis(3),
            encoded: Duration::from_millis(4),
            ..Report::default()
        };
        let stages = in_turn(&report);
        assert_eq!(
            stages[1],
            ("queue", Duration::from_millis(2), Duration::from_millis(3))
        );
        assert_eq!(
            stages[5],
            ("encode", Duration::from_millis(5), Duration::from_millis(4))
        );
    }
}
