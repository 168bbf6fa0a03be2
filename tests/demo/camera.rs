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
use stereo_tests::registry_pair::calibration;
use stereo_tests::zenoh::client;
use tokio::time::{Interval, MissedTickBehavior};
use zenoh::Session;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Publisher;

const NAME: &str = "demo";
const RATE_HZ: u32 = 30;
const FRAMES: u32 = 150;
const BUDGET: Duration = Duration::from_millis(100);
/// How long the last result is waited for.
const GRACE: Duration = Duration::from_secs(2);

/// A camera that is connected to a server.
pub(crate) struct Camera<'a> {
    http: reqwest::Client,
    url: &'a str,
    session: Session,
    request: v1::StereoRequest,
}

impl<'a> Camera<'a> {
    /// One that sends the scene's pair to the server at `url`.
    pub(crate) async fn connect(url: &'a str, scene: &LoadedScene) -> Result<Self> {
        // A proxy of the environment would look for the server on its own machine.
        let http = reqwest::Client::builder().no_proxy().build()?;
        let endpoint = loop {
            let readiness = get(&http, url, "/readyz").await?;
            if let Some(locator) = readiness["zenoh"]["locators"][0].as_str() {
                break locator.to_owned();
            }
            tokio::time::sleep(Duration::from_millis(20)).await;
        };
        Ok(Self {
            http,
            url,
            session: client(&endpoint).await?,
            request: request(scene),
        })
    }

    /// Sends a number of frames on time; what there is to say about it.
    pub(crate) async fn measure(&self) -> Result<String> {
        let latencies = self.send_and_receive().await.map_err(|why| anyhow!(why))?;
        describe(
            latencies,
            &get(&self.http, self.url, &format!("/v1/streams/{NAME}")).await?,
        )
    }

    /// Sends frames for ever.
    pub(crate) async fn play(&self) -> Result<()> {
        let (_token, frames) = self.announce().await.map_err(|why| anyhow!(why))?;
        let mut ticks = ticks();
        // Later than those of the measurement.
        for sequence in u64::from(FRAMES).. {
            ticks.tick().await;
            let frame = self.frame(sequence);
            frames.put(frame).await.map_err(|why| anyhow!(why))?;
        }
        Ok(())
    }

    pub(crate) async fn close(self) -> Result<()> {
        self.session.close().await.map_err(|why| anyhow!(why))
    }

    /// The camera is there and served until the token is dropped.
    async fn announce(&self) -> zenoh::Result<(LivelinessToken, Publisher<'_>)> {
        let liveliness = self.session.liveliness();
        let owners = liveliness
            .declare_subscriber(format!("stereo/v1/owner/{NAME}/*"))
            .history(true)
            .await?;
        let token = liveliness
            .declare_token(format!("stereo/v1/camera/{NAME}"))
            .await?;
        owners.recv_async().await?;
        let frames = self
            .session
            .declare_publisher(format!("stereo/v1/frames/{NAME}"))
            .encoding("application/protobuf;stereo.v1.StereoRequest")
            .await?;
        Ok((token, frames))
    }

    fn frame(&self, sequence: u64) -> Vec<u8> {
        let numbered = v1::StereoRequest {
            sequence: Some(sequence),
            ..self.request.clone()
        };
        numbered.encode_to_vec()
    }

    /// Sends all frames on time, and takes the results as they come: how long each took.
    async fn send_and_receive(&self) -> zenoh::Result<Vec<Duration>> {
        let results = self
            .session
            .declare_subscriber(format!("stereo/v1/results/{NAME}"))
            .await?;
        let (_token, frames) = self.announce().await?;
        let mut ticks = ticks();
        let mut sent = HashMap::new();
        let mut latencies = Vec::new();
        let mut last_sent = Instant::now();
        while last_sent.elapsed() < GRACE && latencies.len() < FRAMES as usize {
            tokio::select! {
                _ = ticks.tick(), if sent.len() < FRAMES as usize => {
                    let sequence = sent.len() as u64;
                    last_sent = Instant::now();
                    sent.insert(sequence, last_sent);
                    frames.put(self.frame(sequence)).await?;
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
}

async fn get(http: &reqwest::Client, url: &str, path: &str) -> Result<Value> {
    let body = http.get(format!("{url}{path}")).send().await?.bytes().await?;
    Ok(serde_json::from_slice(&body)?)
}

fn ticks() -> Interval {
    let mut ticks = tokio::time::interval(Duration::from_secs(1) / RATE_HZ);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Burst);
    ticks
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
        calibration: Some(v1::Calibration {
            focal_px: calibration::FOCAL_PX,
            cx_px: calibration::CX_PX,
            cy_px: calibration::CY_PX,
            baseline_m: calibration::BASELINE_M,
            doffs_px: calibration::DOFFS_PX,
        }),
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
