//! Results of one camera on their way out: whole and in parts, each encoded only while somebody subscribes, the newest one first.

use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::Notify;
use tokio::task::spawn_blocking;
use zenoh::Wait;
use zenoh::pubsub::Publisher;
use zenoh::qos::CongestionControl;

use super::{Context, keys, outgoing, payload};
use crate::job::ReplyFormat;
use crate::streams::{Answer, Stream};

/// Publishers of one camera's results.
pub(super) struct Results {
    parts: Vec<Part>,
}

struct Part {
    format: ReplyFormat,
    publisher: Publisher<'static>,
}

impl Part {
    /// Whether somebody subscribes, by what the session knows: nothing is sent to find out. A matching listener says the same later, on a
    /// busy machine too late for the first frame after a subscription.
    fn is_wanted(&self) -> bool {
        let status = self.publisher.matching_status().wait();
        // Only a closed session knows nothing.
        status.is_ok_and(|status| status.matching())
    }
}

impl Results {
    /// Declares the publishers.
    pub(super) async fn declare(context: &Context, camera: &str) -> zenoh::Result<Self> {
        let mut parts = Vec::new();
        for (format, key, message) in [
            (ReplyFormat::Protobuf, keys::results(camera), "StereoResult"),
            (
                ReplyFormat::DisparityPart,
                keys::part(camera, "disparity"),
                "Disparity",
            ),
            (ReplyFormat::MeshPart, keys::part(camera, "mesh"), "Mesh"),
            (
                ReplyFormat::ReportPart,
                keys::part(camera, "report"),
                "ExecutionReport",
            ),
        ] {
            let publisher = context
                .session
                .declare_publisher(key)
                .encoding(payload::encoding(message))
                // A slow subscriber must not hold up the others: what it can't take is dropped, and it sees the gap in the numbers.
                .congestion_control(CongestionControl::Drop)
                .express(true)
                .await?;
            parts.push(Part { format, publisher });
        }
        Ok(Self { parts })
    }

    /// The bodies that somebody wants now: subscribers, and viewers over HTTP.
    pub(super) fn wanted(&self, stream: &Stream) -> Vec<ReplyFormat> {
        let subscribed = self.parts.iter().filter(|part| part.is_wanted());
        let mut formats: Vec<ReplyFormat> = subscribed.map(|part| part.format).collect();
        for format in stream.watched() {
            if !formats.contains(&format) {
                formats.push(format);
            }
        }
        formats
    }

    /// Sends what comes into `outbox` until that is closed.
    pub(super) async fn send(self: Arc<Self>, context: Arc<Context>, outbox: Arc<Outbox>) {
        while let Some(answer) = outbox.next().await {
            let (results, context) = (Arc::clone(&self), Arc::clone(&context));
            // A link that is full makes this wait, as long as the session is told to at most.
            let sent = spawn_blocking(move || {
                for part in &results.parts {
                    let Some(body) = answer.get(part.format) else {
                        continue;
                    };
                    let (payload, way) = outgoing::payload(body);
                    match part.publisher.put(payload).wait() {
                        Ok(()) => context.service.metrics().zenoh_result(way.name()),
                        Err(why) => {
                            tracing::warn!(key = %part.publisher.key_expr(), %why, "a result can't be sent");
                        }
                    }
                }
            });
            // An error means that the runtime is being torn down.
            drop(sent.await);
        }
    }
}

/// The newest result that has not been sent yet.
#[derive(Default)]
pub(super) struct Outbox {
    slot: Mutex<Slot>,
    ready: Notify,
}

#[derive(Default)]
struct Slot {
    answer: Option<Arc<Answer>>,
    is_closed: bool,
}

impl Outbox {
    /// Puts a result in; true if it took the place of one that had not been sent.
    pub(super) fn push(&self, answer: Arc<Answer>) -> bool {
        let mut slot = self.slot.lock().unwrap_or_else(PoisonError::into_inner);
        let displaced = slot.answer.replace(answer);
        drop(slot);
        self.ready.notify_one();
        displaced.is_some()
    }

    /// Nothing more will come.
    pub(super) fn close(&self) {
        self.slot.lock().unwrap_or_else(PoisonError::into_inner).is_closed = true;
        self.ready.notify_one();
    }

    async fn next(&self) -> Option<Arc<Answer>> {
        loop {
            {
                let mut slot = self.slot.lock().unwrap_or_else(PoisonError::into_inner);
                if let Some(answer) = slot.answer.take() {
                    return Some(answer);
                }
                if slot.is_closed {
                    return None;
                }
            }
            self.ready.notified().await;
        }
    }
}
