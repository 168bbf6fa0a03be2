//! Streams as JSON.

use std::time::{Duration, Instant};

use serde::Serialize;
use serde_json::{Value, json};

use super::{Answer, Event, Stream, Streams, lock};
use crate::encode::report_fields;

/// Everything about all streams.
pub(crate) fn streams_json(streams: &Streams) -> Value {
    let all: Vec<Value> = streams.all().iter().map(|stream| stream_json(stream)).collect();
    json!({ "streams": all, "zenoh": streams.network() })
}

/// Everything about one stream.
pub(crate) fn stream_json(stream: &Stream) -> Value {
    let now = Instant::now();
    let state = lock(&stream.state);
    let counts = &state.counts;
    let dropped: u64 = counts.dropped.values().sum();
    let unpaired: u64 = counts.unpaired.values().sum();
    json!({
        "camera": stream.camera,
        "served": state.is_served,
        "settings_revision": state.settings_revision,
        "rates": {
            "received_hz": state.received.hz(now),
            "answered_hz": state.answered.hz(now),
        },
        "frames": {
            "received": counts.frames,
            "answered": counts.answered,
            "dropped": counts.dropped,
            "under_way": counts.frames.saturating_sub(counts.answered + dropped),
            "lost": counts.lost,
            "unsent": counts.unsent,
        },
        "images": {
            "received": counts.images,
            "paired": counts.paired,
            "unpaired": counts.unpaired,
            "waiting": counts.images.saturating_sub(counts.paired + unpaired),
            "last_unpaired": counts.last_unpaired.iter().map(UnpairedFields::new).collect::<Vec<_>>(),
        },
        "last_error": state.last_error,
        "last_result": state.last.as_ref().map(|answer| answer_json(answer)),
    })
}

#[derive(Serialize)]
struct UnpairedFields {
    side: String,
    sequence: Option<u64>,
    why: &'static str,
    nearest_ms: Option<f64>,
}

impl UnpairedFields {
    fn new(unpaired: &super::Unpaired) -> Self {
        let ms = |duration: Duration| duration.as_secs_f64() * 1e3;
        Self {
            side: unpaired.side.to_string(),
            sequence: unpaired.sequence,
            why: unpaired.why,
            nearest_ms: unpaired.nearest.map(ms),
        }
    }
}

fn answer_json(answer: &Answer) -> Value {
    let bodies: Vec<&str> = answer.bodies.iter().map(|(format, _)| format.name()).collect();
    json!({ "sequence": answer.sequence, "bodies": bodies, "report": report_fields(&answer.report) })
}

/// The name of an event and its data.
pub(crate) fn event_json(event: &Event) -> (&'static str, Value) {
    match event {
        Event::Answered(answer) => ("result", answer_json(answer)),
        Event::Dropped { sequence, error } => (
            "dropped",
            json!({ "sequence": sequence, "reason": error.reason_name(), "detail": error.to_string() }),
        ),
    }
}
