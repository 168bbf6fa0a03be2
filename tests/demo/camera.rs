//! Frames as a camera over Zenoh, straight to the server, and what becomes of them.

use std::collections::HashMap;
use std::fmt::Write as _;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow};
use prost::Message;
use serde_json::Value;
use stereo_client::v1;
use stereo_tests::zenoh::client;
use tokio::time::{Interval, MissedTickBehavior};
use zenoh::Session;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Publisher;

use crate::film::{BUDGET, Film};

/// Frames that are measured.
const FRAMES: u32 = 150;
/// How long the last result is waited for.
const GRACE: Duration = Duration::from_secs(2);

/// A camera that is connected to a server.
pub(crate) struct Camera<'a> {
    http: reqwest::Client,
    url: &'a str,
    session: Session,
    film: Film,
}

impl<'a> Camera<'a> {
    /// One that sends a film to the server at `url`.
    pub(crate) async fn connect(url: &'a str, film: Film) -> Result<Self> {
        // A proxy of the environment would look for the server on its own machine.
        let http = stereo_tests::http::builder().no_proxy().build()?;
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
            film,
        })
    }

    /// Sends a number of frames on time; what there is to say about it.
    pub(crate) async fn measure(&self) -> Result<String> {
        let latencies = self.send_and_receive().await.map_err(|why| anyhow!(why))?;
        let path = format!("/v1/streams/{}", self.film.name);
        self.describe(latencies, &get(&self.http, self.url, &path).await?)
    }

    /// Sends frames for ever.
    pub(crate) async fn play(&self) -> Result<()> {
        let (_token, frames) = self.announce().await.map_err(|why| anyhow!(why))?;
        let mut ticks = self.ticks();
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
            .declare_subscriber(format!("stereo/v1/owner/{}/*", self.film.name))
            .history(true)
            .await?;
        let token = liveliness
            .declare_token(format!("stereo/v1/camera/{}", self.film.name))
            .await?;
        owners.recv_async().await?;
        let frames = self
            .session
            .declare_publisher(format!("stereo/v1/frames/{}", self.film.name))
            .encoding("application/protobuf;stereo.v1.StereoRequest")
            .await?;
        Ok((token, frames))
    }

    fn frame(&self, sequence: u64) -> Vec<u8> {
        let frames = &self.film.frames;
        let index = usize::try_from(sequence % frames.len() as u64).unwrap_or_default();
        let numbered = v1::StereoRequest {
            sequence: Some(sequence),
            ..frames[index].clone()
        };
        numbered.encode_to_vec()
    }

    fn ticks(&self) -> Interval {
        let mut ticks = tokio::time::interval(Duration::from_secs(1) / self.film.rate_hz);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Burst);
        ticks
    }

    /// Sends all frames on time, and takes the results as they come: how long each took.
    async fn send_and_receive(&self) -> zenoh::Result<Vec<Duration>> {
        let results = self
            .session
            .declare_subscriber(format!("stereo/v1/results/{}", self.film.name))
            .await?;
        let (_token, frames) = self.announce().await?;
        let mut ticks = self.ticks();
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

    fn describe(&self, mut latencies: Vec<Duration>, stream: &Value) -> Result<String> {
        latencies.sort();
        let at = |share: usize| {
            latencies.get((latencies.len() * share / 100).min(latencies.len().saturating_sub(1)))
        };
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
            "\nA camera of {} Hz over Zenoh, {FRAMES} frames, budget {} ms\n",
            self.film.rate_hz,
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
}

async fn get(http: &reqwest::Client, url: &str, path: &str) -> Result<Value> {
    let body = http.get(format!("{url}{path}")).send().await?.bytes().await?;
    Ok(serde_json::from_slice(&body)?)
}
