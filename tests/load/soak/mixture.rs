//! The mixed load: single pairs over HTTP and Zenoh, some of them all at once, batches, bodies that are none, cameras that come and go.
//! About half of what one worker can do, so that whatever is lost is not lost to overload.

use std::future::Future;
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result};
use bytes::Bytes;
use futures_util::future::join_all;
use futures_util::{StreamExt, stream};
use prost::Message;
use stereo_client::{Client, Fleet, v1};
use tokio::io::AsyncWriteExt;
use tokio::net::TcpStream;
use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio::time::{Instant, MissedTickBehavior, interval};

use super::tally::Tally;
use crate::args::{Codec, Size};
use crate::frames::Frames;
use crate::zenoh::{session, zenoh_error};

/// Time between two pairs over HTTP, two over Zenoh, and two bodies that are none.
const HTTP_EVERY: Duration = Duration::from_millis(60);
const ZENOH_EVERY: Duration = Duration::from_millis(170);
const BAD_EVERY: Duration = Duration::from_millis(230);
/// Time between two batches, and the pairs of each.
const BATCH_EVERY: Duration = Duration::from_secs(7);
const BATCH_PAIRS: u64 = 20;
/// Time between two bursts, the pairs of each, and their budget: time enough for all. They take every place that a worker has for frames
/// under way, so that its memory is early what it would be one day by chance, and what grows after that grows without a bound.
const BURST_EVERY: Duration = Duration::from_secs(20);
const BURST_PAIRS: usize = 16;
const BURST_BUDGET: Duration = Duration::from_secs(2);
/// Cameras at one time, the time between two of their frames, and how long each stays.
const CAMERAS: u64 = 2;
const FRAME_EVERY: Duration = Duration::from_millis(67);
const CAMERA_STAYS: Duration = Duration::from_secs(20);
/// Names that cameras take turns with.
const NAMES: u64 = 3;
/// Budget of a single pair.
const BUDGET: Duration = Duration::from_millis(250);
/// Requests under way at one time, at most; beyond that, one that is due is not in budget.
const MOST_UNDER_WAY: usize = 64;
/// How long the last answers may take.
const LAST: Duration = Duration::from_secs(10);

/// The pairs that are sent: sizes and codecs in turn, so that buffers change theirs.
struct Pairs(Vec<v1::StereoRequest>);

impl Pairs {
    fn render() -> Result<Self> {
        // The largest comes first.
        let sizes = [(640, 480), (320, 240), (480, 360), (400, 640)];
        let frames = Frames::render(Size::VGA);
        let requests = sizes.into_iter().flat_map(|(width_px, height_px)| {
            [Codec::Raw, Codec::Png, Codec::Raw, Codec::Jpeg]
                .map(|codec| (Size { width_px, height_px }, codec))
        });
        let requests = requests.map(|(size, codec)| {
            let mut request = v1::StereoRequest::decode(frames.pair(size, codec)?)?;
            request.options = Some(v1::Options {
                latency_budget: BUDGET.try_into().ok(),
                ..v1::Options::default()
            });
            anyhow::Ok(request)
        });
        Ok(Self(requests.collect::<Result<_>>()?))
    }

    fn largest(&self) -> v1::StereoRequest {
        self.get(0)
    }

    fn get(&self, turn: u64) -> v1::StereoRequest {
        // Lossless: the remainder is less than the number of pairs.
        self.0[usize::try_from(turn % self.0.len() as u64).unwrap_or_default()].clone()
    }
}

/// A load that goes on until it is stopped.
pub(super) struct Mixture {
    stop: watch::Sender<bool>,
    tasks: JoinSet<Result<()>>,
}

impl Mixture {
    /// Starts all of it on the server at `url`, whose Zenoh session listens on `endpoint`.
    pub(super) fn start(url: &str, endpoint: &str, tally: &Arc<Tally>) -> Result<Self> {
        let stop = watch::Sender::new(false);
        let pairs = Arc::new(Pairs::render()?);
        let mut tasks = JoinSet::new();
        let client = Client::new(url)?;
        tasks.spawn(singles(
            client.clone(),
            Arc::clone(&pairs),
            Arc::clone(tally),
            stop.subscribe(),
        ));
        tasks.spawn(bursts(
            client.clone(),
            Arc::clone(&pairs),
            Arc::clone(tally),
            stop.subscribe(),
        ));
        tasks.spawn(queries(
            endpoint.to_owned(),
            Arc::clone(&pairs),
            Arc::clone(tally),
            stop.subscribe(),
        ));
        tasks.spawn(batches(
            client,
            Arc::clone(&pairs),
            Arc::clone(tally),
            stop.subscribe(),
        ));
        tasks.spawn(nonsense(
            url.to_owned(),
            Arc::clone(&pairs),
            Arc::clone(tally),
            stop.subscribe(),
        ));
        for camera in 0..CAMERAS {
            let (endpoint, pairs, tally) = (endpoint.to_owned(), Arc::clone(&pairs), Arc::clone(tally));
            tasks.spawn(cameras(endpoint, camera, pairs, tally, stop.subscribe()));
        }
        Ok(Self { stop, tasks })
    }

    /// The error of a part that has ended, which none does by itself.
    pub(super) fn ended(&mut self) -> Option<anyhow::Error> {
        let ended = self.tasks.try_join_next()?;
        Some(match ended {
            Ok(Ok(())) => anyhow::anyhow!("a part of the load ended by itself"),
            Ok(Err(why)) => why,
            Err(why) => why.into(),
        })
    }

    /// Sends nothing more, and waits for what is under way.
    pub(super) async fn stop(mut self) -> Result<()> {
        self.stop.send_replace(true);
        while let Some(ended) = self.tasks.join_next().await {
            ended??;
        }
        Ok(())
    }
}

/// Calls `send` with 0, 1, 2 ... each `period`, whatever became of the earlier ones, until `stop`; then waits for them.
async fn paced<F>(
    period: Duration,
    tally: &Tally,
    mut stop: watch::Receiver<bool>,
    mut send: impl FnMut(u64) -> F,
) -> Result<()>
where
    F: Future<Output = ()> + Send + 'static,
{
    let mut under_way = JoinSet::new();
    let mut ticks = interval(period);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
    let mut turn = 0;
    loop {
        tokio::select! {
            () = stopped(&mut stop) => break,
            _ = ticks.tick() => {}
        }
        while let Some(ended) = under_way.try_join_next() {
            ended?;
        }
        if under_way.len() < MOST_UNDER_WAY {
            under_way.spawn(send(turn));
        } else {
            tally.not_sent();
        }
        turn += 1;
    }
    let rest = async {
        while let Some(ended) = under_way.join_next().await {
            ended?;
        }
        anyhow::Ok(())
    };
    tokio::time::timeout(LAST, rest)
        .await
        .context("the last requests were not answered")?
}

/// Single pairs over HTTP.
async fn singles(
    client: Client,
    pairs: Arc<Pairs>,
    tally: Arc<Tally>,
    stop: watch::Receiver<bool>,
) -> Result<()> {
    let send = |turn| {
        let (client, tally, request) = (client.clone(), Arc::clone(&tally), pairs.get(turn));
        async move { tally.single(client.match_pair(&request).await) }
    };
    paced(HTTP_EVERY, &tally, stop, send).await
}

/// Pairs of the largest size over HTTP, all at once.
async fn bursts(
    client: Client,
    pairs: Arc<Pairs>,
    tally: Arc<Tally>,
    stop: watch::Receiver<bool>,
) -> Result<()> {
    let mut request = pairs.largest();
    request.options.get_or_insert_default().latency_budget = BURST_BUDGET.try_into().ok();
    let request = Arc::new(request);
    let send = |_| {
        let (client, tally, request) = (client.clone(), Arc::clone(&tally), Arc::clone(&request));
        async move {
            let burst = (0..BURST_PAIRS).map(|_| client.match_pair(&request));
            join_all(burst)
                .await
                .into_iter()
                .for_each(|answer| tally.single(answer));
        }
    };
    paced(BURST_EVERY, &tally, stop, send).await
}

/// Single pairs over Zenoh.
async fn queries(
    endpoint: String,
    pairs: Arc<Pairs>,
    tally: Arc<Tally>,
    stop: watch::Receiver<bool>,
) -> Result<()> {
    let fleet = Fleet::connect(&[&endpoint]).await?;
    fleet.look(LAST).await;
    let send = |turn| {
        let (fleet, tally, request) = (fleet.clone(), Arc::clone(&tally), pairs.get(turn));
        async move { tally.single(fleet.match_pair(&request).await) }
    };
    paced(ZENOH_EVERY, &tally, stop, send).await
}

/// Batches, each read to its end.
async fn batches(
    client: Client,
    pairs: Arc<Pairs>,
    tally: Arc<Tally>,
    mut stop: watch::Receiver<bool>,
) -> Result<()> {
    let mut ticks = interval(BATCH_EVERY);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        tokio::select! {
            () = stopped(&mut stop) => return Ok(()),
            _ = ticks.tick() => {}
        }
        let pairs = Arc::clone(&pairs);
        let requests = (0..BATCH_PAIRS).map(move |turn| v1::StereoRequest {
            request_id: turn.to_string(),
            options: None,
            ..pairs.get(turn)
        });
        match client.match_batch(stream::iter(requests)).await {
            Ok(mut replies) => {
                while let Some(reply) = replies.next().await {
                    tally.batched(reply);
                }
            }
            Err(why) => tally.broke(&why),
        }
    }
}

/// Bodies that are none: each is refused as such, or broken off by the client.
async fn nonsense(
    url: String,
    pairs: Arc<Pairs>,
    tally: Arc<Tally>,
    stop: watch::Receiver<bool>,
) -> Result<()> {
    let http = stereo_tests::http::builder().no_proxy().build()?;
    let send = |turn| {
        let (http, url, tally) = (http.clone(), url.clone(), Arc::clone(&tally));
        let good = pairs.get(turn);
        async move {
            let outcome = match turn % 5 {
                0 => post(&http, &url, vec![0xff; 4096]).await,
                1 => post(&http, &url, good.encode_to_vec().split_off(1000)).await,
                2 => post(&http, &url, too_small(good).encode_to_vec()).await,
                3 => post(&http, &url, cut_off(good).encode_to_vec()).await,
                _ => break_off(&url, &good.encode_to_vec()).await,
            };
            match outcome {
                Ok(()) => tally.refused_as_bad(),
                Err(why) => tally.broke(&why),
            }
        }
    };
    paced(BAD_EVERY, &tally, stop, send).await
}

/// Sends a body that has to be refused as a mistake of the client's.
async fn post(http: &reqwest::Client, url: &str, body: Vec<u8>) -> Result<()> {
    let request = http
        .post(format!("{url}/v1/stereo"))
        .header("content-type", "application/x-protobuf");
    let answer = request.body(body).send().await?;
    let code = answer.status();
    answer.bytes().await?;
    anyhow::ensure!(
        code.is_client_error(),
        "a body that is none was answered with HTTP {code}"
    );
    Ok(())
}

/// An image that says it has more pixels than it has bytes.
fn too_small(mut request: v1::StereoRequest) -> v1::StereoRequest {
    if let Some(image) = &mut request.left {
        image.set_encoding(v1::ImageEncoding::Mono8);
        image.data = Bytes::from_static(&[7; 100]);
    }
    request
}

/// A file without its second half.
fn cut_off(mut request: v1::StereoRequest) -> v1::StereoRequest {
    if let Some(image) = &mut request.right {
        image.data.truncate(image.data.len() / 2);
    }
    request
}

/// Goes away in the middle of a body.
async fn break_off(url: &str, body: &[u8]) -> Result<()> {
    let mut stream = TcpStream::connect(url.trim_start_matches("http://")).await?;
    let head = format!(
        "POST /v1/stereo HTTP/1.1\r\nHost: x\r\nContent-Type: application/x-protobuf\r\nContent-Length: {}\r\n\r\n",
        body.len()
    );
    stream.write_all(head.as_bytes()).await?;
    stream.write_all(&body[..body.len() / 2]).await?;
    Ok(())
}

/// Cameras one after the other. Odd ones are on other hosts: each has a session of its own, which ends with it, and no shared memory. Even
/// ones share a session that lasts, as the drivers of a robot do, and shared memory.
async fn cameras(
    endpoint: String,
    number: u64,
    pairs: Arc<Pairs>,
    tally: Arc<Tally>,
    mut stop: watch::Receiver<bool>,
) -> Result<()> {
    let is_on_another_host = number % 2 == 1;
    let lasting = match is_on_another_host {
        true => None,
        false => Some(session(&endpoint, true).await?),
    };
    for life in 0.. {
        let own = match &lasting {
            Some(_) => None,
            None => Some(session(&endpoint, false).await?),
        };
        let Some(at) = lasting.as_ref().or(own.as_ref()) else {
            break;
        };
        let fleet = Fleet::over(at.clone()).await?;
        let is_over = film(
            &fleet,
            &format!("soak-{number}-{}", life % NAMES),
            pairs.get(life),
            &tally,
            &mut stop,
        )
        .await?;
        drop(fleet);
        if let Some(own) = own {
            own.close().await.map_err(zenoh_error)?;
        }
        if is_over {
            break;
        }
    }
    Ok(())
}

/// One camera for a while; whether to send nothing more.
async fn film(
    fleet: &Fleet,
    name: &str,
    mut frame: v1::StereoRequest,
    tally: &Tally,
    stop: &mut watch::Receiver<bool>,
) -> Result<bool> {
    let camera = fleet.camera(name).await?;
    let results = fleet.results(name).await?;
    let until = Instant::now() + CAMERA_STAYS;
    let mut ticks = interval(FRAME_EVERY);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
    let mut sequence = 0;
    while Instant::now() < until {
        tokio::select! {
            () = stopped(stop) => return Ok(true),
            result = results.next() => drop(result?),
            _ = ticks.tick() => {
                sequence += 1;
                if camera.is_served().await? {
                    frame.sequence = Some(sequence);
                    camera.send(&frame).await?;
                    tally.filmed();
                }
            }
        }
    }
    Ok(false)
}

/// Returns once `stop` says so, or nobody can any more.
async fn stopped(stop: &mut watch::Receiver<bool>) {
    drop(stop.wait_for(|&stop| stop).await);
}
