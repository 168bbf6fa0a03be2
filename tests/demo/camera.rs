//! The pair as a camera of 30 frames a second over Zenoh, straight to the server, and what becomes of its frames.

use std::collections::HashMap;
use std::fmt::Write as _;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow};
use prost::Message;
use serde_json::Value;
use stereo_client::v1;
use stereo_tests::dataset::LoadedScene;
use stereo_tests::gray::GrayImage;
use stereo_tests::zenoh::client;
use tokio::time::MissedTickBehavior;
use zenoh::Session;

const NAME: &str = "demo";
const RATE_HZ: u32 = 30;
const FRAMES: u32 = 150;
const BUDGET: Duration = Duration::from_millis(100);
/// How long the last result is waited for.
const GRACE: Duration = Duration::from_secs(2);

/// Streams the pair to the server at `url`; what there is to say about it.
pub(crate) async fn stream(url: &str, scene: &LoadedScene) -> Result<String> {
    // A proxy of the environment would look for the server on its own machine.
    let http = reqwest::Client::builder().no_proxy().build()?;
    let get = async |path: &str| -> Result<Value> {
        let body = http.get(format!("{url}{path}")).send().await?.bytes().await?;
        Ok(serde_json::from_slice(&body)?)
    };
    let endpoint = loop {
        let readiness = get("/readyz").await?;
        if let Some(locator) = readiness["zenoh"]["locators"][0].as_str() {
            break locator.to_owned();
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    };
    let session = client(&endpoint).await?;
    let latencies = send_and_receive(&session, scene)
        .await
        .map_err(|why| anyhow!(why))?;
    let stream = get(&format!("/v1/streams/{NAME}")).await?;
    session.close().await.map_err(|why| anyhow!(why))?;
    describe(latencies, &stream)
}

/// Sends all frames on time, and takes the results as they come: how long each took.
async fn send_and_receive(session: &Session, scene: &LoadedScene) -> zenoh::Result<Vec<Duration>> {
    let results = session
        .declare_subscriber(format!("stereo/v1/results/{NAME}"))
        .await?;
    let owners = session
        .liveliness()
        .declare_subscriber(format!("stereo/v1/owner/{NAME}/*"))
        .history(true)
        .await?;
    let _token = session
        .liveliness()
        .declare_token(format!("stereo/v1/camera/{NAME}"))
        .await?;
    owners.recv_async().await?;
    let frames = session
        .declare_publisher(format!("stereo/v1/frames/{NAME}"))
        .encoding("application/protobuf;stereo.v1.StereoRequest")
        .await?;
    let mut ticks = tokio::time::interval(Duration::from_secs(1) / RATE_HZ);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Burst);
    let mut request = request(scene);
    let mut sent = HashMap::new();
    let mut latencies = Vec::new();
    let mut last_sent = Instant::now();
    while last_sent.elapsed() < GRACE && latencies.len() < FRAMES as usize {
        tokio::select! {
            _ = ticks.tick(), if sent.len() < FRAMES as usize => {
                let sequence = sent.len() as u64;
                request.sequence = Some(sequence);
                last_sent = Instant::now();
                sent.insert(sequence, last_sent);
                frames.put(request.encode_to_vec()).await?;
            }
            sample = results.recv_async() => {
                let result = v1::StereoResult::decode(&*sample?.payload().to_bytes())?;
                let sent_at = result.sequence.and_then(|sequence| sent.get(&sequence));
                latencies.extend(sent_at.map(Instant::elapsed));
            }
            () = tokio::time::sleep(GRACE) => {}
        }
    }
    Ok(latencies)
}

fn request(scene: &LoadedScene) -> v1::StereoRequest {
    let image = |image: &GrayImage| v1::Image {
        width: u32::try_from(image.width_px()).unwrap_or_default(),
        height: u32::try_from(image.height_px()).unwrap_or_default(),
        encoding: v1::ImageEncoding::Mono8.into(),
        data: image.pixels().to_vec().into(),
        ..v1::Image::default()
    };
    v1::StereoRequest {
        left: Some(image(&scene.left)),
        right: Some(image(&scene.right)),
        options: Some(v1::Options {
            latency_budget: BUDGET.try_into().ok(),
            outputs: vec![v1::Output::Disparity.into()],
            ..v1::Options::default()
        }),
        ..v1::StereoRequest::default()
    }
}

fn describe(mut latencies: Vec<Duration>, stream: &Value) -> Result<String> {
    latencies.sort();
    let at =
        |share: usize| latencies.get((latencies.len() * share / 100).min(latencies.len().saturating_sub(1)));
    let ms = |latency: Option<&Duration>| latency.map_or(f64::NAN, |latency| latency.as_secs_f64() * 1e3);
    let frames = &stream["frames"];
    let dropped = frames["dropped"]
        .as_object()
        .context("the stream has another form")?;
    let dropped: Vec<String> = dropped
        .iter()
        .map(|(reason, count)| format!("{count} {reason}"))
        .collect();
    let mut text = format!(
        "\nA camera of {RATE_HZ} Hz over Zenoh, {FRAMES} frames, budget {} ms\n",
        BUDGET.as_millis()
    );
    let none = "none".to_owned();
    for (name, value) in [
        (
            "rate of results",
            format!(
                "{:.1} Hz",
                stream["rates"]["answered_hz"].as_f64().unwrap_or(f64::NAN)
            ),
        ),
        (
            "frame sent to result received",
            format!("p50 {:.1} ms, p99 {:.1} ms", ms(at(50)), ms(at(99))),
        ),
        ("received by the server", frames["received"].to_string()),
        ("results received", latencies.len().to_string()),
        (
            "dropped by the server",
            if dropped.is_empty() {
                none
            } else {
                dropped.join(", ")
            },
        ),
        ("lost before it", frames["lost"].to_string()),
    ] {
        writeln!(text, "  {name:33} {value}")?;
    }
    Ok(text)
}
