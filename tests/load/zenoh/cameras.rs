//! Eight cameras of 30 Hz, and what becomes of every frame.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use anyhow::Result;
use bytes::Bytes;
use prost::Message;
use serde_json::Value;
use stereo_client::v1;
use tokio::time::{Instant, MissedTickBehavior};
use zenoh::Session;

use super::{get, percentile_ms, session, zenoh_error};
use crate::args::{Codec, Size};
use crate::frames::Frames;

const CAMERAS: u32 = 8;
const PERIOD: Duration = Duration::from_nanos(1_000_000_000 / 30);
/// A budget of a few times what the first rung takes.
const SHORT: Duration = Duration::from_millis(8);
/// The time between two looks at what is under way.
const LOOK_EVERY: Duration = Duration::from_millis(500);
/// How long the last frames may take.
const GRACE: Duration = Duration::from_secs(2);

pub(super) const HEADER: &str = "| 8 cameras x 30 Hz, raw VGA, `fast`, TCP | sent | answered | superseded | otherwise dropped | lost on the way | not accounted for | most under way at a time | receive to dispatch, p50 | p99 |\n|---|---|---|---|---|---|---|---|---|---|";

/// When the cameras take their pictures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phases {
    /// One after the other.
    Spread,
    /// All at once.
    Together,
}

impl Phases {
    fn name(self) -> &'static str {
        match self {
            Self::Spread => "phases spread",
            Self::Together => "in phase",
        }
    }

    fn of(self, camera: u32) -> Duration {
        match self {
            Self::Spread => PERIOD * camera / CAMERAS,
            Self::Together => Duration::ZERO,
        }
    }
}

/// What eight cameras do.
#[derive(Debug, Clone, Copy)]
pub(super) struct Plan {
    phases: Phases,
    budget: Duration,
}

/// All that is measured. Whatever a budget leaves is spent on rungs, of the frame that has a worker, while others wait: with the time to
/// the next frame as their budget, frames may wait for nearly as long. Cameras that want to be served at once say so by a short budget.
pub(super) const PLANS: [Plan; 3] = [
    Plan {
        phases: Phases::Spread,
        budget: PERIOD,
    },
    Plan {
        phases: Phases::Spread,
        budget: SHORT,
    },
    Plan {
        phases: Phases::Together,
        budget: PERIOD,
    },
];

impl Plan {
    pub(super) fn name(self) -> String {
        format!("{}, budget {} ms", self.phases.name(), self.budget.as_millis())
    }
}

/// Streams for `seconds`; a row of the table.
pub(super) async fn stream(url: &str, endpoint: &str, plan: Plan, seconds: f64) -> Result<String> {
    let pair = Frames::render(Size::VGA).pair(Size::VGA, Codec::Raw)?;
    let session = session(endpoint, false).await?;
    let waits = Arc::new(Mutex::new(Vec::new()));
    let start = Instant::now() + Duration::from_secs(1);
    let end = start + Duration::try_from_secs_f64(seconds)?;
    let mut cameras = Vec::new();
    for camera in 0..CAMERAS {
        let name = format!("{}-{camera}", plan.name().replace(", ", "-").replace(' ', "-"));
        let (session, waits, pair) = (session.clone(), Arc::clone(&waits), pair.clone());
        let from = start + plan.phases.of(camera);
        cameras.push((
            name.clone(),
            tokio::spawn(async move { film(&session, &name, &pair, plan.budget, (from, end), &waits).await }),
        ));
    }
    let mut most_under_way = 0;
    while Instant::now() < end {
        tokio::time::sleep(LOOK_EVERY).await;
        let all = get(url, "/v1/streams").await?;
        let under_way = |stream: &Value| stream["frames"]["under_way"].as_u64();
        let sum = all["streams"]
            .as_array()
            .into_iter()
            .flatten()
            .filter_map(under_way)
            .sum();
        most_under_way = most_under_way.max(sum);
    }
    let (mut sent, mut counts) = (0, Counts::default());
    for (name, filming) in cameras {
        sent += filming.await??;
        counts.add(&settled(url, &name).await?);
    }
    session.close().await.map_err(zenoh_error)?;
    let mut waits = std::mem::take(&mut *waits.lock().unwrap_or_else(PoisonError::into_inner));
    let Counts {
        answered,
        superseded,
        dropped,
        received,
    } = counts;
    Ok(format!(
        "| {}, {seconds:.0} s | {sent} | {answered} | {superseded} | {} | {} | {} | {most_under_way} | {:.2} ms | {:.2} ms |",
        plan.name(),
        dropped - superseded,
        sent - received,
        received - answered - dropped,
        percentile_ms(&mut waits, 50),
        percentile_ms(&mut waits, 99),
    ))
}

/// What the server has counted.
#[derive(Default)]
struct Counts {
    received: u64,
    answered: u64,
    superseded: u64,
    dropped: u64,
}

impl Counts {
    fn add(&mut self, stream: &Value) {
        let frames = &stream["frames"];
        let count = |value: &Value| value.as_u64().unwrap_or_default();
        self.received += count(&frames["received"]);
        self.answered += count(&frames["answered"]);
        self.superseded += count(&frames["dropped"]["SUPERSEDED"]);
        let reasons = frames["dropped"].as_object();
        self.dropped += reasons
            .into_iter()
            .flat_map(|reasons| reasons.values())
            .map(count)
            .sum::<u64>();
    }
}

/// A camera's stream, once nothing of it is under way.
async fn settled(url: &str, name: &str) -> Result<Value> {
    let until = Instant::now() + GRACE;
    loop {
        let stream = get(url, &format!("/v1/streams/{name}")).await?;
        if stream["frames"]["under_way"] == 0 || Instant::now() > until {
            return Ok(stream);
        }
        tokio::time::sleep(LOOK_EVERY).await;
    }
}

/// One camera: how many frames it has sent. How long each waited for a worker goes to `waits`.
async fn film(
    session: &Session,
    name: &str,
    pair: &Bytes,
    budget: Duration,
    (from, end): (Instant, Instant),
    waits: &Arc<Mutex<Vec<Duration>>>,
) -> Result<u64> {
    let waits = Arc::clone(waits);
    let _reports = session
        .declare_subscriber(format!("stereo/v1/results/{name}/report"))
        .callback(move |sample| {
            let report = v1::ExecutionReport::decode(&*sample.payload().to_bytes()).ok();
            let part =
                |time: Option<_>| time.and_then(|time: prost_types::Duration| Duration::try_from(time).ok());
            let wait = report.and_then(|report| Some(part(report.received)? + part(report.queued)?));
            waits.lock().unwrap_or_else(PoisonError::into_inner).extend(wait);
        })
        .await
        .map_err(zenoh_error)?;
    let owners = session
        .liveliness()
        .declare_subscriber(format!("stereo/v1/owner/{name}/*"))
        .history(true)
        .await
        .map_err(zenoh_error)?;
    let _token = session
        .liveliness()
        .declare_token(format!("stereo/v1/camera/{name}"))
        .await
        .map_err(zenoh_error)?;
    owners.recv_async().await.map_err(zenoh_error)?;
    let frames = session
        .declare_publisher(format!("stereo/v1/frames/{name}"))
        .encoding("application/protobuf;stereo.v1.StereoRequest")
        .await
        .map_err(zenoh_error)?;
    let mut ticks = tokio::time::interval_at(from, PERIOD);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Burst);
    let mut sent = 0;
    while ticks.tick().await < end {
        let head = v1::StereoRequest {
            sequence: Some(sent),
            options: Some(v1::Options {
                preset: v1::Preset::Fast.into(),
                latency_budget: budget.try_into().ok(),
                outputs: vec![v1::Output::Disparity.into()],
                ..v1::Options::default()
            }),
            ..v1::StereoRequest::default()
        };
        let frame = [head.encode_to_vec().as_slice(), pair].concat();
        frames.put(frame).await.map_err(zenoh_error)?;
        sent += 1;
    }
    // The token is kept until the last report is there.
    tokio::time::sleep(GRACE).await;
    Ok(sent)
}
