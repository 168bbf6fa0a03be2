//! A request and its answer, one at a time: what of that is not matching.

use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow};
use bytes::Bytes;
use prost::Message;
use stereo_client::v1;
use zenoh::Session;
use zenoh::Wait;
use zenoh::bytes::ZBytes;
use zenoh::query::ConsolidationMode;
use zenoh::shm::{BlockOn, GarbageCollect, PosixShmProviderBackend, ShmProvider, ShmProviderBuilder};

use super::{percentile_ms, session, zenoh_error};
use crate::args::{Codec, Size};
use crate::frames::Frames;

/// Round trips of each way before any counts.
const WARM_UP: usize = 30;
/// Rounds, of which the quietest is the one whose medians count: a machine that is busy with something else is slow for seconds.
const ROUNDS: usize = 5;
/// Round trips of each way in a round.
const COUNT: usize = 300;
/// Shared memory for requests: several of them.
const SHARED_BYTES: usize = 16 << 20;
const ENCODING: &str = "application/protobuf;stereo.v1.StereoRequest";

/// Ways to the server.
const WAYS: [&str; 3] = ["Zenoh, shared memory", "Zenoh, TCP", "HTTP, protobuf"];

/// A table of the round trips of VGA pairs, the three ways taking turns.
pub(super) async fn measure(url: &str, endpoint: &str) -> Result<String> {
    let request = request()?;
    let (shared, plain) = (session(endpoint, true).await?, session(endpoint, false).await?);
    let provider = ShmProviderBuilder::default_backend(SHARED_BYTES)
        .wait()
        .map_err(|why| anyhow!("no shared memory: {why}"))?;
    let http = stereo_tests::http::builder().no_proxy().build()?;
    let mut others: [Vec<Duration>; WAYS.len()] = Default::default();
    let mut totals: [Vec<Duration>; WAYS.len()] = Default::default();
    for turn in 0..WARM_UP + ROUNDS * COUNT {
        for way in 0..WAYS.len() {
            let (took, result) = match way {
                0 => {
                    // A camera's driver writes its pixels there, so that is not part of the trip.
                    let payload = in_shared_memory(&provider, &request).await?;
                    query(&shared, payload).await?
                }
                1 => query(&plain, ZBytes::from(request.clone())).await?,
                _ => post(&http, url, request.clone()).await?,
            };
            let matched = result
                .report
                .and_then(|report| report.matched)
                .and_then(|matched| Duration::try_from(matched).ok())
                .context("a report says how long matching took")?;
            if turn >= WARM_UP {
                others[way].push(took.saturating_sub(matched));
                totals[way].push(took);
            }
        }
    }
    let medians = |trips: &[Vec<Duration>; WAYS.len()], round: usize| {
        let round = round * COUNT..(round + 1) * COUNT;
        [0, 1, 2].map(|way: usize| percentile_ms(&mut trips[way][round.clone()].to_vec(), 50))
    };
    let sum = |&round: &usize| medians(&totals, round).iter().sum::<f64>();
    let quietest = (0..ROUNDS)
        .min_by(|a, b| sum(a).total_cmp(&sum(b)))
        .unwrap_or_default();
    let (other, total) = (medians(&others, quietest), medians(&totals, quietest));
    let mut table = format!(
        "| round trip of a VGA pair | without the match, p50 of the quietest of {ROUNDS} rounds | p99 of all rounds | with it, p50 |\n|---|---|---|---|"
    );
    for (way, name) in WAYS.into_iter().enumerate() {
        let (p50, p99, total) = (other[way], percentile_ms(&mut others[way], 99), total[way]);
        table += &format!("\n| {name} | {p50:.2} ms | {p99:.2} ms | {total:.2} ms |");
    }
    Ok(table)
}

/// Raw 8-bit gray VGA, one mesh iteration, the disparity alone.
fn request() -> Result<Bytes> {
    let pair = Frames::render(Size::VGA).pair(Size::VGA, Codec::Raw)?;
    let head = v1::StereoRequest {
        options: Some(v1::Options {
            preset: v1::Preset::Fast.into(),
            max_iterations: Some(1),
            latency_budget: Duration::from_secs(1).try_into().ok(),
            outputs: vec![v1::Output::Disparity.into()],
            ..v1::Options::default()
        }),
        ..v1::StereoRequest::default()
    };
    Ok([head.encode_to_vec().as_slice(), &pair].concat().into())
}

async fn in_shared_memory(provider: &ShmProvider<PosixShmProviderBackend>, bytes: &[u8]) -> Result<ZBytes> {
    let mut buffer = provider
        .alloc(bytes.len())
        .with_policy::<BlockOn<GarbageCollect>>()
        .await
        .map_err(|why| anyhow!("no room in shared memory: {why:?}"))?;
    buffer.copy_from_slice(bytes);
    Ok(ZBytes::from(buffer))
}

async fn query(session: &Session, payload: ZBytes) -> Result<(Duration, v1::StereoResult)> {
    let started = Instant::now();
    let replies = session
        .get("stereo/v1/compute")
        .payload(payload)
        .encoding(ENCODING)
        .express(true)
        .consolidation(ConsolidationMode::None)
        .await
        .map_err(zenoh_error)?;
    let reply = replies.recv_async().await.map_err(zenoh_error)?;
    let sample = reply.into_result().map_err(|why| anyhow!("refused: {why:?}"))?;
    let result = v1::StereoResult::decode(&*sample.payload().to_bytes())?;
    Ok((started.elapsed(), result))
}

async fn post(http: &reqwest::Client, url: &str, body: Bytes) -> Result<(Duration, v1::StereoResult)> {
    let started = Instant::now();
    let answer = http
        .post(format!("{url}/v1/stereo"))
        .header("content-type", "application/x-protobuf")
        .body(body)
        .send()
        .await?
        .error_for_status()?;
    let result = v1::StereoResult::decode(answer.bytes().await?)?;
    Ok((started.elapsed(), result))
}
