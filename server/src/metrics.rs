//! What the server counts: every metric's name, unit and meaning, in OpenMetrics.
//!
//! The table for people, `server/METRICS.md`, is generated from the registry. All labels have a fixed set of values, so the number of
//! series never grows with clients, cameras or requests.

mod book;
mod ends;
mod table;

use std::time::Duration;

use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::Histogram;
use prometheus_client::registry::Registry;

use self::book::Book;
pub(crate) use self::ends::{BatchEnd, ConnectionEnd};
use crate::job::{Degradation, PriorityClass, Report, RungsCut};

/// Upper ends of the histograms of queue, stages and latency, in seconds.
const LATENCY_BUCKETS: [f64; 14] = [
    0.001, 0.002, 0.005, 0.010, 0.020, 0.033, 0.050, 0.075, 0.100, 0.150, 0.200, 0.300, 0.500, 1.0,
];
/// Upper ends of the histograms of decisions, in seconds.
const DECISION_BUCKETS: [f64; 12] = [
    2e-6, 5e-6, 10e-6, 20e-6, 50e-6, 100e-6, 200e-6, 500e-6, 1e-3, 2e-3, 5e-3, 20e-3,
];
/// Upper ends of the histogram of prediction errors, as shares of the actual cost.
const ERROR_BUCKETS: [f64; 9] = [0.01, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.5, 1.0];

/// Requests by what became of them: `OK`, the reasons of refusals, and that the client has gone.
const OUTCOMES: [&str; 14] = [
    "OK",
    "INVALID",
    "TOO_LARGE",
    "QUOTA",
    "QUEUE_FULL",
    "DRAINING",
    "DEADLINE_INFEASIBLE",
    "EXPIRED",
    "SUPERSEDED",
    "SLOW_READER",
    "INTERNAL",
    "UNAUTHENTICATED",
    "FORBIDDEN",
    CANCELLED,
];
/// Why images of streams are in no pair.
const UNPAIRED: [&str; 5] = ["alone", "late", "duplicate", "unstamped", "refused"];
/// The outcome of a request whose client has gone.
pub(crate) const CANCELLED: &str = "CANCELLED";
/// The class of a request that was refused before its class was known.
const UNKNOWN_CLASS: &str = "unknown";
const CLASSES: [&str; 4] = ["deadline", "best_effort", "background", UNKNOWN_CLASS];
const STAGES: [&str; 5] = ["receive", "decode", "match", "mesh", "encode"];

type Label = [(&'static str, &'static str); 1];
type Labels = [(&'static str, &'static str); 2];

/// Everything that is counted. Cheap to record; nothing here blocks longer than for a map's look-up.
pub(crate) struct Metrics {
    registry: Registry,
    requests: Family<Labels, Counter>,
    dropped: Family<Label, Counter>,
    deadlines: Family<Label, Counter>,
    latency: Family<Label, Histogram, fn() -> Histogram>,
    queue: Histogram,
    stages: Family<Label, Histogram, fn() -> Histogram>,
    refusal: Histogram,
    scheduling: Histogram,
    rungs: Histogram,
    steps: Counter,
    degraded: Family<Label, Counter>,
    prediction_error: Histogram,
    pub(crate) overload_rung: Gauge,
    pub(crate) queue_depth: Gauge,
    pub(crate) bytes_in_flight: Gauge,
    pub(crate) batch_bytes_in_flight: Gauge,
    pub(crate) connections: Gauge,
    connections_ended: Family<Label, Counter>,
    pub(crate) workers_busy: Gauge,
    pub(crate) workers: Gauge,
    pub(crate) tasks: Gauge,
    pub(crate) worker_panics: Counter,
    pub(crate) workers_replaced: Counter,
    pub(crate) batches: Gauge,
    pub(crate) batch_frames: Counter,
    batches_ended: Family<Label, Counter>,
    pub(crate) streams: Gauge,
    stream_frames: Family<Label, Counter>,
    pub(crate) stream_frames_lost: Counter,
    stream_images_unpaired: Family<Label, Counter>,
    pub(crate) stream_results_unsent: Counter,
    zenoh_payloads: Family<Label, Counter>,
    zenoh_results: Family<Label, Counter>,
    pub(crate) draining: Gauge,
}

/// What can be cut of a frame.
const CUTS: [&str; 5] = [
    "rungs_for_budget",
    "rungs_for_load",
    "rungs_for_newer_frame",
    "half_resolution",
    "no_mesh",
];

/// What was cut of a frame, by the names above.
fn cuts(degradation: Degradation) -> impl Iterator<Item = &'static str> {
    let rungs = degradation.rungs.map(|why| match why {
        RungsCut::Budget => CUTS[0],
        RungsCut::Load => CUTS[1],
        RungsCut::Superseded => CUTS[2],
    });
    let half = degradation.is_half.then_some(CUTS[3]);
    let mesh = degradation.has_no_mesh.then_some(CUTS[4]);
    [rungs, half, mesh].into_iter().flatten()
}

fn latency_histogram() -> Histogram {
    Histogram::new(LATENCY_BUCKETS)
}

impl Metrics {
    /// Everything at zero, and every series there.
    #[expect(clippy::too_many_lines, reason = "a table: one entry a metric")]
    pub(crate) fn new() -> Self {
        let mut book = Book::new("stereod");
        Self {
            requests: book.by_class_and_outcome(),
            dropped: book.counters(
                "dropped_frames",
                "Frames that were admitted but got no result, by reason; part of stereod_requests",
                OUTCOMES[1..].iter().map(|&outcome| [("reason", outcome)]),
            ),
            deadlines: book.counters(
                "deadlines",
                "Answered frames with a deadline, by whether it was kept; attainment is kept / (kept + missed)",
                ["kept", "missed"].map(|outcome| [("outcome", outcome)]),
            ),
            latency: book.latencies(
                "latency",
                "From the first byte of a request to its encoded result, by priority class",
                CLASSES[..3].iter().map(|&class| [("class", class)]),
            ),
            queue: book.seconds(
                "queue",
                "Waiting for a worker, of answered frames",
                latency_histogram(),
            ),
            stages: book.latencies(
                "stage",
                "Each stage of answered frames alone: receive, decode, match (gray views to disparity), mesh, encode",
                STAGES.map(|stage| [("stage", stage)]),
            ),
            refusal: book.seconds(
                "refusal",
                "From the first byte of a request to the decision to refuse it",
                Histogram::new(DECISION_BUCKETS),
            ),
            scheduling: book.seconds(
                "scheduling",
                "The scheduler's own work for one admission",
                Histogram::new(DECISION_BUCKETS),
            ),
            rungs: book.plain(
                "rungs",
                "Rungs finished for an answered frame",
                Histogram::new((1..=8).map(f64::from)),
            ),
            steps: book.plain("steps", "Steps of matching, the first of a frame included", Counter::default()),
            degraded: book.counters(
                "degraded_frames",
                "Answered frames for which less was done than asked for, by what was cut",
                CUTS.map(|cut| [("cut", cut)]),
            ),
            prediction_error: book.ratio(
                "prediction_error",
                "Distance of a frame's predicted from its actual cost, as a share of the actual one",
                Histogram::new(ERROR_BUCKETS),
            ),
            overload_rung: book.plain(
                "overload_rung",
                "Level of the overload ladder: 0 nothing is cut, 1 fewer rungs, 2 half resolution where allowed, 3 no optional mesh, 4 best effort dropped, 5 refusing",
                Gauge::default(),
            ),
            queue_depth: book.plain("queued_frames", "Frames that wait for a worker now", Gauge::default()),
            bytes_in_flight: book.bytes("in_flight", "Bodies of requests and replies held now, batches aside"),
            batch_bytes_in_flight: book.bytes("batch_in_flight", "Requests and replies of batches held now"),
            connections: book.plain("connections", "Connections open now", Gauge::default()),
            connections_ended: book.counters(
                "connections_ended",
                "Connections that ended, by why",
                ConnectionEnd::ALL.map(ConnectionEnd::label),
            ),
            workers_busy: book.plain("workers_busy", "Workers that are at a frame now", Gauge::default()),
            workers: book.plain("workers", "Workers that take frames", Gauge::default()),
            tasks: book.plain("tasks", "Tasks of the server's transports that are not over, Zenoh's own aside", Gauge::default()),
            worker_panics: book.plain("worker_panics", "Frames that failed because a worker panicked", Counter::default()),
            workers_replaced: book.plain(
                "workers_replaced",
                "Workers that were given up because a frame made no progress",
                Counter::default(),
            ),
            batches: book.plain("batches", "Batches under way now", Gauge::default()),
            batch_frames: book.plain("batch_frames", "Requests read from batches", Counter::default()),
            batches_ended: book.counters("batches_ended", "Batches that ended, by how", BatchEnd::ALL.map(BatchEnd::label)),
            streams: book.plain("streams", "Camera streams that this server serves now", Gauge::default()),
            stream_frames: book.counters(
                "stream_frames",
                "Frames of camera streams by outcome: OK, or the reason of the refusal; part of stereod_requests",
                OUTCOMES[..OUTCOMES.len() - 1].iter().map(|&outcome| [("outcome", outcome)]),
            ),
            stream_frames_lost: book.plain(
                "stream_frames_lost",
                "Frames of camera streams whose numbers were left out: they were lost before they came here",
                Counter::default(),
            ),
            stream_images_unpaired: book.counters(
                "stream_images_unpaired",
                "Single images that were in no pair: alone (the other half did not come), late (newer ones were a pair already), duplicate, unstamped (neither number nor time), refused (no image)",
                UNPAIRED.map(|why| [("why", why)]),
            ),
            stream_results_unsent: book.plain(
                "stream_results_unsent",
                "Results of camera streams that were not sent because the one before was still on its way",
                Counter::default(),
            ),
            zenoh_payloads: book.counters(
                "zenoh_payloads",
                "Frames, images and requests received over Zenoh, by the way they came",
                ["shared_memory", "network"].map(|way| [("way", way)]),
            ),
            zenoh_results: book.counters(
                "zenoh_results",
                "Results and replies sent over Zenoh, by the way they left: shared_memory (who is on another host gets a copy), network, no_room (network, because shared memory was full or missing)",
                ["shared_memory", "network", "no_room"].map(|way| [("way", way)]),
            ),
            draining: book.plain("draining", "1 while the server is stopping and takes no new work", Gauge::default()),
            registry: book.close(),
        }
    }

    /// A request has ended; `class` is `None` if it was refused before that was known.
    pub(crate) fn ended(&self, class: Option<PriorityClass>, outcome: &'static str) {
        let class = class.map_or(UNKNOWN_CLASS, PriorityClass::name);
        self.requests
            .get_or_create(&[("class", class), ("outcome", outcome)])
            .inc();
    }

    /// A request was refused `after` its first byte.
    pub(crate) fn refused(&self, after: Duration) {
        self.refusal.observe(after.as_secs_f64());
    }

    /// An admitted frame got no result.
    pub(crate) fn dropped(&self, reason: &'static str) {
        self.dropped.get_or_create(&[("reason", reason)]).inc();
    }

    /// A frame was answered; `costs` are what its stages were expected to take and what they took.
    pub(crate) fn answered(
        &self,
        class: PriorityClass,
        report: &Report,
        costs: Option<(Duration, Duration)>,
    ) {
        let seconds = |duration: Duration| duration.as_secs_f64();
        self.latency
            .get_or_create(&[("class", class.name())])
            .observe(seconds(report.total));
        self.queue.observe(seconds(report.queued));
        let stages = [
            report.received,
            report.decoded,
            report.matched,
            report.meshed,
            report.encoded,
        ];
        for (stage, took) in STAGES.into_iter().zip(stages) {
            self.stages
                .get_or_create(&[("stage", stage)])
                .observe(seconds(took));
        }
        self.rungs.observe(f64::from(report.iterations_run));
        self.steps.inc_by(report.steps);
        if class != PriorityClass::Background {
            let kept = if report.deadline_met { "kept" } else { "missed" };
            self.deadlines.get_or_create(&[("outcome", kept)]).inc();
        }
        if let Some((predicted, actual)) = costs
            && !predicted.is_zero()
            && !actual.is_zero()
        {
            let (predicted, actual) = (seconds(predicted), seconds(actual));
            self.prediction_error.observe((predicted - actual).abs() / actual);
        }
        for cut in cuts(report.degradation) {
            self.degraded.get_or_create(&[("cut", cut)]).inc();
        }
    }

    /// A frame of a stream ended.
    pub(crate) fn stream_frame(&self, outcome: &'static str) {
        self.stream_frames.get_or_create(&[("outcome", outcome)]).inc();
    }

    /// A single image was in no pair.
    pub(crate) fn image_unpaired(&self, why: &'static str) {
        self.stream_images_unpaired.get_or_create(&[("why", why)]).inc();
    }

    /// Something came over Zenoh.
    pub(crate) fn zenoh_payload(&self, way: &'static str) {
        self.zenoh_payloads.get_or_create(&[("way", way)]).inc();
    }

    /// A result or a reply left over Zenoh.
    pub(crate) fn zenoh_result(&self, way: &'static str) {
        self.zenoh_results.get_or_create(&[("way", way)]).inc();
    }

    /// The scheduler took this long to admit a frame or to refuse it.
    pub(crate) fn scheduled(&self, took: Duration) {
        self.scheduling.observe(took.as_secs_f64());
    }

    /// A connection ended.
    pub(crate) fn connection_ended(&self, end: ConnectionEnd) {
        self.connections_ended.get_or_create(&end.label()).inc();
    }

    /// A batch ended.
    pub(crate) fn batch_ended(&self, end: BatchEnd) {
        self.batches_ended.get_or_create(&end.label()).inc();
    }

    /// Frames that got a result since the start, and frames that were admitted and got none.
    pub(crate) fn totals(&self) -> (u64, u64) {
        let answered = CLASSES.into_iter().map(|class| {
            let labels = [("class", class), ("outcome", "OK")];
            self.requests.get_or_create(&labels).get()
        });
        let reasons = OUTCOMES[1..].iter();
        let dropped = reasons.map(|reason| self.dropped.get_or_create(&[("reason", *reason)]).get());
        (answered.sum(), dropped.sum())
    }

    /// The OpenMetrics text.
    pub(crate) fn text(&self) -> String {
        let mut text = String::new();
        // Writing to a string can't fail.
        let _ = prometheus_client::encoding::text::encode(&mut text, &self.registry);
        text
    }
}

#[cfg(test)]
mod tests;
