//! How long a camera is without results when a server or the router fails.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use bytes::Bytes;
use prost::Message;
use serde_json::json;
use stereo_client::{Fleet, v1};
use stereo_tests::process::{Launch, Stereod};
use stereo_tests::zenoh::{RouterProcess, client_with};
use zenoh::Session;

use super::{percentile_ms, zenoh_error};
use crate::args::{Codec, Size};
use crate::frames::Frames;

const SERVERS: [&str; 3] = ["one", "two", "three"];
/// Times that each failure is tried.
const TIMES: usize = 5;
/// Time between two frames, which is how exactly the times are known.
const PERIOD: Duration = Duration::from_millis(20);
/// Longer than the lease, so that everybody gives the router up.
const ROUTER_FROZEN: Duration = Duration::from_secs(3);
/// Budget of the requests that go on meanwhile.
const BUDGET: Duration = Duration::from_secs(5);
/// After so long, something is broken.
const PATIENCE: Duration = Duration::from_secs(30);
const SIZE: Size = Size {
    width_px: 160,
    height_px: 120,
};

/// What fails.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Failure {
    ServerKilled,
    ServerFrozen,
    RouterRestarted,
    RouterFrozen,
}

impl Failure {
    const ALL: [Self; 4] = [
        Self::ServerKilled,
        Self::ServerFrozen,
        Self::RouterRestarted,
        Self::RouterFrozen,
    ];

    fn name(self) -> &'static str {
        match self {
            Self::ServerKilled => "its server killed, of three",
            Self::ServerFrozen => "its server frozen, of three",
            Self::RouterRestarted => "router killed and started again at once",
            Self::RouterFrozen => "router frozen for 3 s, counted from its end",
        }
    }

    /// Whether requests can be answered meanwhile.
    fn leaves_a_way(self) -> bool {
        matches!(self, Self::ServerKilled | Self::ServerFrozen)
    }
}

/// A table of the times, and of the requests that failed meanwhile.
pub(super) async fn measure(program: Option<&Path>) -> Result<String> {
    let mut table = format!(
        "| a 50 Hz camera without results (each {TIMES} times) | median | longest | requests of a retrying client meanwhile | of those failed |\n|---|---|---|---|---|"
    );
    let mut scene = Scene::start(program).await?;
    for failure in Failure::ALL {
        let mut times = Vec::new();
        let (mut asked, mut failed) = (0, 0);
        for _ in 0..TIMES {
            scene.settle().await?;
            let requests = failure.leaves_a_way().then(|| scene.keep_asking());
            times.push(scene.suffer(failure).await.with_context(|| failure.name())?);
            if let Some(requests) = requests {
                let (more, lost) = requests.stop().await?;
                asked += more;
                failed += lost;
            }
        }
        let requests = match failure.leaves_a_way() {
            true => format!("{asked} | {failed}"),
            false => "- | -".to_owned(),
        };
        let median = percentile_ms(&mut times, 50) / 1e3;
        let longest = percentile_ms(&mut times, 100) / 1e3;
        table += &format!(
            "\n| {} | {median:.2} s | {longest:.2} s | {requests} |",
            failure.name()
        );
    }
    Ok(table)
}

/// A router, three servers, a camera and whoever reads its results.
struct Scene<'a> {
    program: Option<&'a Path>,
    /// By it, servers are clients of the router, as in the example for a fleet.
    config: PathBuf,
    router: Option<RouterProcess>,
    endpoint: String,
    servers: Vec<(&'static str, Stereod)>,
    pair: Bytes,
    seen: Arc<Seen>,
    fleet: Fleet,
    // Kept as long as the scene lasts.
    _camera: tokio::task::JoinHandle<Result<()>>,
}

/// The last result.
#[derive(Default)]
struct Seen(Mutex<Option<(String, Instant)>>);

impl Seen {
    fn last(&self) -> Option<(String, Instant)> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

impl<'a> Scene<'a> {
    async fn start(program: Option<&'a Path>) -> Result<Self> {
        let router = RouterProcess::start("tcp/127.0.0.1:0", None)?;
        let endpoint = router.endpoint().to_owned();
        let config = std::env::temp_dir().join(format!("stereod-takeovers-{}.json5", std::process::id()));
        std::fs::write(&config, "{ mode: 'client' }").context("can't write a server's configuration")?;
        let servers = SERVERS
            .into_iter()
            .map(|name| Ok((name, serve(program, &config, &endpoint, name)?)))
            .collect::<Result<Vec<_>>>()?;
        let pair = Frames::render(SIZE).pair(SIZE, Codec::Raw)?;
        let seen = Arc::new(Seen::default());
        let camera = tokio::spawn(film(session(&endpoint).await?, pair.clone(), Arc::clone(&seen)));
        let fleet = Fleet::over(session(&endpoint).await?).await?;
        Ok(Self {
            program,
            config,
            router: Some(router),
            endpoint,
            servers,
            pair,
            seen,
            fleet,
            _camera: camera,
        })
    }

    /// Waits until everybody is there and the camera has been served by the same server for a second.
    async fn settle(&self) -> Result<()> {
        let until = Instant::now() + PATIENCE;
        let mut owner: Option<(String, Instant)> = None;
        loop {
            ensure!(
                Instant::now() < until,
                "the camera is not served steadily: {:?} of {:?}",
                self.seen.last(),
                self.fleet.servers()
            );
            tokio::time::sleep(PERIOD).await;
            let fresh = self.seen.last().filter(|(_, at)| at.elapsed() < 10 * PERIOD);
            let all_there = self.fleet.servers().len() == SERVERS.len();
            owner = match (fresh, owner) {
                (Some((name, _)), Some((last, since))) if name == last && all_there => {
                    if since.elapsed() > Duration::from_secs(1) {
                        return Ok(());
                    }
                    Some((last, since))
                }
                (Some((name, _)), _) => Some((name, Instant::now())),
                (None, _) => None,
            };
        }
    }

    /// Lets something fail, and heals it. How long it took until the first result after that.
    async fn suffer(&mut self, failure: Failure) -> Result<Duration> {
        let (owner, _) = self.seen.last().context("a camera that is served")?;
        let place = self.servers.iter().position(|(name, _)| *name == owner);
        let place = place.context("a server of this scene")?;
        match failure {
            Failure::ServerKilled => {
                let since = Instant::now();
                let (name, victim) = self.servers.swap_remove(place);
                drop(victim);
                let took = self.result_after(since, Some(&owner)).await?;
                self.servers
                    .push((name, serve(self.program, &self.config, &self.endpoint, name)?));
                Ok(took)
            }
            Failure::ServerFrozen => {
                let since = Instant::now();
                self.servers[place].1.signal("STOP")?;
                let took = self.result_after(since, Some(&owner)).await;
                self.servers[place].1.signal("CONT")?;
                took
            }
            Failure::RouterRestarted => {
                let since = Instant::now();
                drop(self.router.take());
                let router = RouterProcess::start(&self.endpoint, None)?;
                self.router = Some(router);
                self.result_after(since, None).await
            }
            Failure::RouterFrozen => {
                let router = self.router.as_ref().context("a router that runs")?;
                router.signal("STOP")?;
                tokio::time::sleep(ROUTER_FROZEN).await;
                let since = Instant::now();
                router.signal("CONT")?;
                self.result_after(since, None).await
            }
        }
    }

    /// The time until a result that came `since` then, from another server than `victim`.
    async fn result_after(&self, since: Instant, victim: Option<&str>) -> Result<Duration> {
        // What was on its way to us when the router failed is none of its results after that.
        let since_visible = since + 2 * PERIOD;
        loop {
            ensure!(since.elapsed() < PATIENCE, "no result comes any more");
            if let Some((server, at)) = self.seen.last()
                && at > since_visible
                && victim.is_none_or(|victim| server != victim)
            {
                return Ok(at - since);
            }
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    }

    /// Sends requests, one after the other, until it is stopped.
    fn keep_asking(&self) -> Requests {
        let (fleet, pair) = (self.fleet.clone(), self.pair.clone());
        let is_over = Arc::new(AtomicBool::new(false));
        let stop = Arc::clone(&is_over);
        let task = tokio::spawn(async move {
            let mut request = v1::StereoRequest::decode(pair)?;
            request.options = options(BUDGET);
            let (mut asked, mut failed) = (0, 0);
            while !stop.load(Ordering::Relaxed) {
                asked += 1;
                failed += u64::from(fleet.match_pair(&request).await.is_err());
                tokio::time::sleep(PERIOD).await;
            }
            anyhow::Ok((asked, failed))
        });
        Requests { is_over, task }
    }
}

/// Requests under way.
struct Requests {
    is_over: Arc<AtomicBool>,
    task: tokio::task::JoinHandle<Result<(u64, u64)>>,
}

impl Requests {
    /// How many there were, and how many of them failed.
    async fn stop(self) -> Result<(u64, u64)> {
        self.is_over.store(true, Ordering::Relaxed);
        self.task.await?
    }
}

impl Drop for Scene<'_> {
    fn drop(&mut self) {
        // It is a few bytes in the folder for temporary files.
        drop(std::fs::remove_file(&self.config));
    }
}

fn serve(program: Option<&Path>, config: &Path, endpoint: &str, name: &str) -> Result<Stereod> {
    let config = config.to_str().context("a path in Unicode")?;
    let args = [
        ["--workers", "1"],
        ["--zenoh-connect", endpoint],
        ["--zenoh-config", config],
        ["--instance", name],
    ];
    Stereod::launch(&Launch {
        program,
        args: &args.concat(),
        ..Launch::default()
    })
}

/// A client that looks for its router again as soon as it is lost.
async fn session(endpoint: &str) -> Result<Session> {
    let config = json!({ "connect": {
        "endpoints": [endpoint],
        "timeout_ms": -1,
        "exit_on_failure": false,
        "retry": { "period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 2 },
    } });
    client_with(endpoint, config).await
}

fn options(budget: Duration) -> Option<v1::Options> {
    Some(v1::Options {
        preset: v1::Preset::Fast.into(),
        max_iterations: Some(1),
        latency_budget: budget.try_into().ok(),
        outputs: vec![v1::Output::Disparity.into()],
        ..v1::Options::default()
    })
}

/// The camera: frames go out whatever comes back.
async fn film(session: Session, pair: Bytes, seen: Arc<Seen>) -> Result<()> {
    let _results = session
        .declare_subscriber("stereo/v1/results/takeover")
        .callback(move |sample| {
            let result = v1::StereoResult::decode(&*sample.payload().to_bytes());
            let report = result.ok().and_then(|result| result.report);
            if let Some(report) = report {
                let mut last = seen.0.lock().unwrap_or_else(PoisonError::into_inner);
                *last = Some((report.instance, Instant::now()));
            }
        })
        .await
        .map_err(zenoh_error)?;
    let _token = session
        .liveliness()
        .declare_token("stereo/v1/camera/takeover")
        .await
        .map_err(zenoh_error)?;
    let mut sequence = 0;
    loop {
        sequence += 1;
        let head = v1::StereoRequest {
            sequence: Some(sequence),
            options: options(Duration::from_secs(1)),
            ..v1::StereoRequest::default()
        };
        let frame = [head.encode_to_vec().as_slice(), &pair].concat();
        session
            .put("stereo/v1/frames/takeover", frame)
            .encoding("application/protobuf;stereo.v1.StereoRequest")
            .await
            .map_err(zenoh_error)?;
        tokio::time::sleep(PERIOD).await;
    }
}
