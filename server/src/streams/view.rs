//! Streams as JSON.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use serde::Serialize;
use serde_json::{Value, json};
use utoipa::ToSchema;

use super::network::Network;
use super::{Event, Seen, Stream, Streams, lock};
use crate::encode::{ReportFields, report_fields};

/// Everything about all streams.
#[derive(Serialize, ToSchema)]
#[schema(as = Streams)]
pub(crate) struct StreamsView {
    streams: Vec<StreamView>,
    zenoh: Network,
}

/// A camera's stream. Every frame is answered, dropped or under way; every single image paired, unpaired or waiting.
#[derive(Serialize, ToSchema)]
#[schema(as = Stream)]
pub(crate) struct StreamView {
    camera: String,
    /// Whether this server serves it.
    served: bool,
    /// How often its settings have changed.
    settings_revision: u64,
    rates: Rates,
    frames: Frames,
    images: Images,
    /// Why the last frame that was dropped was.
    last_error: Option<String>,
    last_result: Option<ResultView>,
}

/// Over the last two seconds.
#[derive(Serialize, ToSchema)]
struct Rates {
    received_hz: f64,
    answered_hz: f64,
}

/// Pairs since the stream began.
#[derive(Serialize, ToSchema)]
struct Frames {
    received: u64,
    answered: u64,
    /// Of those answered: after their budget.
    answered_late: u64,
    /// By reason.
    dropped: BTreeMap<&'static str, u64>,
    under_way: u64,
    /// Those that never came, by their numbers.
    lost: u64,
    /// Results that were not sent because the one before was still on its way.
    unsent: u64,
}

/// Single images since the stream began.
#[derive(Serialize, ToSchema)]
struct Images {
    received: u64,
    paired: u64,
    /// By reason.
    unpaired: BTreeMap<&'static str, u64>,
    waiting: u64,
    last_unpaired: Vec<UnpairedView>,
}

/// A single image that was in no frame.
#[derive(Serialize, ToSchema)]
#[schema(as = Unpaired)]
struct UnpairedView {
    side: String,
    sequence: Option<u64>,
    why: &'static str,
    /// Distance in time to the nearest image of the other side, in milliseconds.
    nearest_ms: Option<f64>,
}

/// A result as it was sent.
#[derive(Serialize, ToSchema)]
#[schema(as = StreamResult)]
struct ResultView {
    sequence: Option<u64>,
    /// What was sent.
    bodies: Vec<&'static str>,
    #[schema(value_type = ReportFields<'static>)]
    report: Value,
}

impl StreamsView {
    /// Those of the cameras that `may_see` lets through.
    pub(crate) fn of(streams: &Streams, may_see: impl Fn(&str) -> bool) -> Self {
        Self {
            streams: streams
                .all()
                .iter()
                .filter(|stream| may_see(&stream.camera))
                .map(|stream| StreamView::of(stream))
                .collect(),
            zenoh: streams.network(),
        }
    }
}

impl StreamView {
    pub(crate) fn of(stream: &Stream) -> Self {
        let now = Instant::now();
        let state = lock(&stream.state);
        let counts = &state.counts;
        let dropped: u64 = counts.dropped.values().sum();
        let unpaired: u64 = counts.unpaired.values().sum();
        Self {
            camera: stream.camera.clone(),
            served: state.is_served,
            settings_revision: state.settings_revision,
            rates: Rates {
                received_hz: state.received.hz(now),
                answered_hz: state.answered.hz(now),
            },
            frames: Frames {
                received: counts.frames,
                answered: counts.answered,
                answered_late: counts.answered_late,
                dropped: counts.dropped.clone(),
                under_way: counts.frames.saturating_sub(counts.answered + dropped),
                lost: counts.lost,
                unsent: counts.unsent,
            },
            images: Images {
                received: counts.images,
                paired: counts.paired,
                unpaired: counts.unpaired.clone(),
                waiting: counts.images.saturating_sub(counts.paired + unpaired),
                last_unpaired: counts.last_unpaired.iter().map(UnpairedView::of).collect(),
            },
            last_error: state.last_error.clone(),
            last_result: state.last.as_ref().map(|seen| ResultView::of(seen)),
        }
    }
}

impl UnpairedView {
    fn of(unpaired: &super::Unpaired) -> Self {
        let ms = |duration: Duration| duration.as_secs_f64() * 1e3;
        Self {
            side: unpaired.side.to_string(),
            sequence: unpaired.sequence,
            why: unpaired.why,
            nearest_ms: unpaired.nearest.map(ms),
        }
    }
}

impl ResultView {
    fn of(seen: &Seen) -> Self {
        Self {
            sequence: seen.sequence,
            bodies: seen.formats.iter().map(|format| format.name()).collect(),
            report: json!(report_fields(&seen.report)),
        }
    }
}

/// The name of an event and its data.
pub(crate) fn event_json(event: &Event) -> (&'static str, Value) {
    match event {
        Event::Answered(seen) => ("result", json!(ResultView::of(seen))),
        Event::Dropped { sequence, error } => (
            "dropped",
            json!({ "sequence": sequence, "reason": error.reason_name(), "detail": error.text() }),
        ),
    }
}
