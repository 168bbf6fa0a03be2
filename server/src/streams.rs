//! The camera streams that this server serves, as people and programs see them: what comes in, what goes out, and what became of the
//! rest. A transport tells, HTTP shows; neither knows the other.

mod counts;
mod network;
mod view;

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use bytes::Bytes;
use tokio::sync::broadcast;

pub(crate) use self::counts::Unpaired;
use self::counts::{Counts, Rate};
pub(crate) use self::network::Network;
#[cfg(feature = "zenoh")]
pub(crate) use self::network::NetworkState;
pub(crate) use self::view::{StreamView, StreamsView, event_json};
use crate::encode::memory::Encoded;
use crate::job::{FrameReply, ReplyFormat, Report};
use crate::metrics::Metrics;
use crate::status::ServiceError;

/// Streams remembered at one time, those of cameras that have gone included.
pub(crate) const MOST_STREAMS: usize = 256;
/// Events that a slow reader may be behind.
const EVENTS_KEPT: usize = 32;

/// All streams, and the network they come over.
pub struct Streams {
    by_camera: Mutex<BTreeMap<String, Arc<Stream>>>,
    network: Mutex<Network>,
    metrics: Arc<Metrics>,
}

/// One camera's stream.
pub(crate) struct Stream {
    camera: String,
    state: Mutex<State>,
    events: broadcast::Sender<Event>,
    /// How many wait for a picture of a kind, by [`picture_index`].
    watchers: [AtomicU32; PICTURES.len()],
    metrics: Arc<Metrics>,
}

/// Bodies that viewers can ask for.
const PICTURES: [ReplyFormat; 6] = [
    ReplyFormat::Protobuf,
    ReplyFormat::Json,
    ReplyFormat::DisparityPng,
    ReplyFormat::ColorPng,
    ReplyFormat::Glb,
    ReplyFormat::StreamView,
];

fn picture_index(format: ReplyFormat) -> Option<usize> {
    PICTURES.iter().position(|&picture| picture == format)
}

#[derive(Default)]
struct State {
    is_served: bool,
    counts: Counts,
    received: Rate,
    answered: Rate,
    /// Number of the newest frame that came.
    newest: Option<u64>,
    last: Option<Arc<Seen>>,
    last_error: Option<String>,
    settings_revision: u64,
}

/// Something that happened to a frame.
#[derive(Debug, Clone)]
pub(crate) enum Event {
    /// It was answered.
    Answered(Arc<Seen>),
    /// It was dropped.
    Dropped {
        sequence: Option<u64>,
        error: ServiceError,
    },
}

/// The bodies of a finished frame, for who subscribes.
pub(crate) type Answer = Bodies<Encoded>;

/// A finished frame for who looks on: without bodies in the memory of a transport, which those who look slowly would keep from others.
#[derive(Debug)]
pub(crate) struct Seen {
    pub(crate) sequence: Option<u64>,
    pub(crate) report: Report,
    /// Of all bodies.
    pub(crate) formats: Vec<ReplyFormat>,
    pub(crate) bodies: Bodies<Bytes>,
}

/// Bodies by their format.
#[derive(Debug)]
pub(crate) struct Bodies<B>(Vec<(ReplyFormat, B)>);

impl<B> Bodies<B> {
    /// The body of a format, if somebody had asked for it.
    pub(crate) fn get(&self, format: ReplyFormat) -> Option<&B> {
        let found = self.0.iter().find(|(found, _)| *found == format);
        found.map(|(_, body)| body)
    }
}

impl Streams {
    /// None yet.
    pub(crate) fn new(metrics: &Arc<Metrics>) -> Self {
        Self {
            by_camera: Mutex::default(),
            network: Mutex::default(),
            metrics: Arc::clone(metrics),
        }
    }

    /// The stream of a camera that is served from now on; `None` if there are too many.
    pub(crate) fn open(&self, camera: &str) -> Option<Arc<Stream>> {
        let mut by_camera = lock(&self.by_camera);
        if !by_camera.contains_key(camera) && by_camera.len() >= MOST_STREAMS {
            let gone = by_camera
                .iter()
                .find(|(_, stream)| !lock(&stream.state).is_served)
                .map(|(camera, _)| camera.clone())?;
            by_camera.remove(&gone);
        }
        let stream = by_camera.entry(camera.to_owned()).or_insert_with(|| {
            Arc::new(Stream {
                camera: camera.to_owned(),
                state: Mutex::default(),
                events: broadcast::Sender::new(EVENTS_KEPT),
                watchers: Default::default(),
                metrics: Arc::clone(&self.metrics),
            })
        });
        lock(&stream.state).is_served = true;
        let stream = Arc::clone(stream);
        self.count(&by_camera);
        Some(stream)
    }

    /// The camera has gone, or another server serves it.
    pub(crate) fn close(&self, camera: &str) {
        let by_camera = lock(&self.by_camera);
        if let Some(stream) = by_camera.get(camera) {
            lock(&stream.state).is_served = false;
        }
        self.count(&by_camera);
    }

    fn count(&self, by_camera: &BTreeMap<String, Arc<Stream>>) {
        let served = by_camera
            .values()
            .filter(|stream| lock(&stream.state).is_served)
            .count();
        self.metrics
            .streams
            .set(i64::try_from(served).unwrap_or(i64::MAX));
    }

    /// A stream by its camera's name.
    pub(crate) fn get(&self, camera: &str) -> Option<Arc<Stream>> {
        lock(&self.by_camera).get(camera).map(Arc::clone)
    }

    /// All streams in the order of their names.
    pub(crate) fn all(&self) -> Vec<Arc<Stream>> {
        lock(&self.by_camera).values().map(Arc::clone).collect()
    }

    /// What is known about the network.
    pub(crate) fn network(&self) -> Network {
        lock(&self.network).clone()
    }

    /// The network has changed.
    pub(crate) fn set_network(&self, change: impl FnOnce(&mut Network)) {
        change(&mut lock(&self.network));
    }
}

impl Stream {
    pub(crate) fn camera(&self) -> &str {
        &self.camera
    }

    /// A message came in: a whole frame or a single image.
    pub(crate) fn received(&self, is_image: bool) {
        let mut state = lock(&self.state);
        match is_image {
            true => state.counts.images += 1,
            false => state.frame_came(),
        }
    }

    /// Two images have become a frame.
    pub(crate) fn paired(&self) {
        let mut state = lock(&self.state);
        state.counts.paired += 2;
        state.frame_came();
    }

    /// A single image will be in no frame.
    pub(crate) fn unpaired(&self, unpaired: &Unpaired) {
        self.metrics.image_unpaired(unpaired.why);
        lock(&self.state).counts.add_unpaired(unpaired);
    }

    /// An image could not be used.
    pub(crate) fn failed(&self, error: &ServiceError) {
        lock(&self.state).last_error = Some(error.text());
    }

    /// The number of a frame that came: those left out were lost on the way. False if a newer one came before, and this one is late.
    pub(crate) fn numbered(&self, sequence: u64) -> bool {
        let mut state = lock(&self.state);
        let newest = state.newest;
        if let Some(newest) = newest
            && sequence <= newest
            && newest - sequence <= counts::FRAMES_BACK_AT_RESTART
        {
            return false;
        }
        state.newest = Some(sequence);
        let lost = newest
            .and_then(|newest| sequence.checked_sub(newest + 1))
            .filter(|&gap| gap <= counts::LARGEST_GAP)
            .unwrap_or_default();
        state.counts.lost += lost;
        drop(state);
        self.metrics.stream_frames_lost.inc_by(lost);
        true
    }

    /// A frame got no result.
    pub(crate) fn dropped(&self, sequence: Option<u64>, error: &ServiceError) {
        self.metrics.stream_frame(error.reason_name());
        let mut state = lock(&self.state);
        *state.counts.dropped.entry(error.reason_name()).or_default() += 1;
        state.last_error = Some(error.text());
        drop(state);
        self.tell(|| Event::Dropped {
            sequence,
            error: error.clone(),
        });
    }

    /// A frame got its result.
    pub(crate) fn answered(
        &self,
        sequence: Option<u64>,
        formats: &[ReplyFormat],
        reply: FrameReply,
    ) -> Arc<Answer> {
        self.metrics.stream_frame("OK");
        let mut state = lock(&self.state);
        state.counts.answered += 1;
        state.counts.answered_late += u64::from(!reply.report.deadline_met);
        state.answered.tick(Instant::now());
        drop(state);
        let answer = Bodies(formats.iter().copied().zip(reply.bodies).collect());
        let seen = Arc::new(Seen {
            sequence,
            report: reply.report,
            formats: formats.to_vec(),
            bodies: self.seen(&answer),
        });
        lock(&self.state).last = Some(Arc::clone(&seen));
        self.tell(|| Event::Answered(seen));
        Arc::new(answer)
    }

    /// The bodies for who looks on.
    fn seen(&self, answer: &Answer) -> Bodies<Bytes> {
        let bodies = answer.0.iter().filter_map(|(format, body)| {
            let is_watched = || self.watched().any(|watched| watched == *format);
            match body.is_own() {
                true => Some((*format, Bytes::clone(body))),
                false => is_watched().then(|| (*format, Bytes::copy_from_slice(body))),
            }
        });
        Bodies(bodies.collect())
    }

    /// A result was ready, but the one before it was still being sent.
    pub(crate) fn unsent(&self) {
        self.metrics.stream_results_unsent.inc();
        lock(&self.state).counts.unsent += 1;
    }

    /// The settings have changed.
    pub(crate) fn set_revision(&self, revision: u64) {
        lock(&self.state).settings_revision = revision;
    }

    /// What viewers wait for, besides what others get.
    pub(crate) fn watched(&self) -> impl Iterator<Item = ReplyFormat> + '_ {
        let is_watched = |index: usize| self.watchers[index].load(Ordering::Relaxed) > 0;
        (0..PICTURES.len())
            .filter(move |&index| is_watched(index))
            .map(|index| PICTURES[index])
    }

    /// From now on, frames have a body of `format`, until the guard is dropped; `None` for formats that can't be watched.
    pub(crate) fn watch(self: &Arc<Self>, format: ReplyFormat) -> Option<Watch> {
        let index = picture_index(format)?;
        self.watchers[index].fetch_add(1, Ordering::Relaxed);
        Some(Watch {
            stream: Arc::clone(self),
            index,
        })
    }

    /// What happens from now on.
    pub(crate) fn events(&self) -> broadcast::Receiver<Event> {
        self.events.subscribe()
    }

    fn tell(&self, event: impl FnOnce() -> Event) {
        if self.events.receiver_count() > 0 {
            // Fails only if the last receiver has just gone.
            drop(self.events.send(event()));
        }
    }
}

/// Somebody waits for a body of a format.
pub(crate) struct Watch {
    stream: Arc<Stream>,
    index: usize,
}

impl Drop for Watch {
    fn drop(&mut self) {
        self.stream.watchers[self.index].fetch_sub(1, Ordering::Relaxed);
    }
}

impl State {
    fn frame_came(&mut self) {
        self.counts.frames += 1;
        self.received.tick(Instant::now());
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // Nothing that is called while it is held panics; if it did, counts would still be whole.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests;
