//! What a server says about its camera streams, and whether it takes frames. What a newer server says besides is left out.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// The answer of `GET /readyz`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Readiness {
    /// `ready` or `not ready`.
    pub status: String,
    /// Why it is not ready.
    pub why: Option<String>,
    /// Requests that wait for a worker.
    pub queue_depth: u64,
    /// How it stands with Zenoh.
    pub zenoh: Network,
}

impl Readiness {
    /// Whether a frame sent now would be taken.
    #[must_use]
    pub fn is_ready(&self) -> bool {
        self.status == "ready"
    }
}

/// The network that frames of cameras come over.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Network {
    /// `off`, `opening` or `open`.
    pub state: String,
    /// Why it does not stand better, and what to do.
    pub why: Option<String>,
    /// Where the server can be reached over Zenoh, such as `tcp/127.0.0.1:7447`.
    #[serde(default)]
    pub locators: Vec<String>,
    /// The live servers of the fleet, this one included.
    #[serde(default)]
    pub servers: Vec<String>,
    /// Others it is connected to: routers, peers and clients.
    pub connections: u64,
}

/// The answer of `GET /v1/streams`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Streams {
    /// Every stream that this server has seen, by its camera's name.
    pub streams: Vec<CameraStream>,
    /// The network they come over.
    pub zenoh: Network,
}

/// One camera's stream, as the server sees it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CameraStream {
    /// The camera's name.
    pub camera: String,
    /// Whether this server serves it now.
    pub served: bool,
    /// Frames a second.
    pub rates: Rates,
    /// What became of its frames.
    pub frames: Frames,
    /// What became of its single images.
    pub images: Images,
    /// Why the last frame that has no result has none.
    pub last_error: Option<String>,
    /// The last result's number and report.
    pub last_result: Option<LastResult>,
}

/// Rates of a stream, over the last seconds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Rates {
    /// Frames that came, a second.
    pub received_hz: f64,
    /// Results that were made, a second.
    pub answered_hz: f64,
}

/// Counts of frames since the server has seen the camera first.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Frames {
    /// Whole frames that came.
    pub received: u64,
    /// Those with a result.
    pub answered: u64,
    /// Those of them whose result was ready after their budget.
    #[serde(default)]
    pub answered_late: u64,
    /// Those without, by reason, such as `SUPERSEDED`.
    pub dropped: BTreeMap<String, u64>,
    /// Those that are neither yet.
    pub under_way: u64,
    /// Frames that never came, by the gaps in the camera's numbers.
    pub lost: u64,
    /// Results that could not be sent.
    pub unsent: u64,
}

impl Frames {
    /// All frames without a result.
    #[must_use]
    pub fn dropped_total(&self) -> u64 {
        self.dropped.values().sum()
    }

    /// Frames with a result within their budget.
    #[must_use]
    pub fn in_budget(&self) -> u64 {
        self.answered.saturating_sub(self.answered_late)
    }
}

/// Counts of single images since the server has seen the camera first.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Images {
    /// Images that came.
    pub received: u64,
    /// Those that became part of a pair.
    pub paired: u64,
    /// Those that did not, by reason.
    pub unpaired: BTreeMap<String, u64>,
    /// Those that wait for their other half.
    pub waiting: u64,
    /// The last of those that are in no pair, the newest at the end.
    #[serde(default)]
    pub last_unpaired: Vec<Unpaired>,
}

/// A single image that became part of no pair.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Unpaired {
    /// `left` or `right`.
    pub side: String,
    /// The image's number.
    pub sequence: Option<u64>,
    /// Why, such as `alone`.
    pub why: String,
    /// Distance in time to the nearest image of the other side, in milliseconds.
    pub nearest_ms: Option<f64>,
}

/// The last result of a stream.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LastResult {
    /// The frame's number.
    pub sequence: Option<u64>,
    /// What was done for it.
    pub report: StreamReport,
}

/// The figures of a report that a stream is judged by.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StreamReport {
    /// The latency budget in ms.
    pub budget_ms: f64,
    /// From the frame's first byte to its result in ms.
    pub total_ms: f64,
    /// Rungs finished.
    pub iterations_run: u32,
    /// Rungs asked for.
    pub iterations_asked: u32,
    /// Whether the deadline was met.
    pub deadline_met: bool,
    /// Share of the pixels asked for that have a disparity, 0 to 1.
    pub density: f32,
    /// Why less was done than asked for; empty if nothing was cut.
    pub degradation: String,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stream_reads_as_the_server_writes_it() {
        let json = r#"{"streams": [{"camera": "front", "served": true, "settings_revision": 0,
            "rates": {"received_hz": 30.0, "answered_hz": 29.5},
            "frames": {"received": 10, "answered": 7, "answered_late": 2, "dropped": {"SUPERSEDED": 2, "EXPIRED": 1}, "under_way": 0, "lost": 3, "unsent": 0},
            "images": {"received": 0, "paired": 0, "unpaired": {}, "waiting": 0, "last_unpaired": [{"side": "left", "sequence": 4, "why": "alone", "nearest_ms": 12.5}]},
            "last_error": null, "last_result": null}],
            "zenoh": {"state": "open", "connections": 1}}"#;
        let streams: Streams = serde_json::from_str(json).unwrap();
        let frames = &streams.streams[0].frames;
        assert_eq!((frames.dropped_total(), frames.in_budget()), (3, 5));
        let unpaired = streams.streams[0].images.last_unpaired.first();
        assert_eq!(unpaired.and_then(|image| image.nearest_ms), Some(12.5));
        assert_eq!(streams.zenoh.locators, Vec::<String>::new());
    }
}
