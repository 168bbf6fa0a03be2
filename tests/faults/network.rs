//! Clients that vanish or don't read, and a Zenoh router that comes and goes.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use anyhow::Result;
use prost::Message;
use serde_json::json;
use stereo_client::{Camera, Client, Fleet, Results, v1};
use stereo_tests::network::{Lab, ROUTER};
use stereo_tests::process::{Launch, Stereod};
use stereo_tests::zenoh::{RouterProcess, client_with};
use tokio::io::AsyncWriteExt;
use tokio::net::{TcpSocket, TcpStream};

use crate::clients::{Clients, Pace, Target};
use crate::links::url_on;
use crate::pair;
use crate::scene::{ready, stop, until, with};
use crate::table::{Recovery, Row};

const BUDGET: Duration = Duration::from_secs(1);
/// Budget of what is tried again until there is a router.
const RETRIED: Duration = Duration::from_secs(20);
/// Connections that are left without an end, half of them with half a request.
const HALF_OPEN: usize = 40;
/// Clients that don't read, and what they get.
const SLOW: usize = 8;
/// How often the router is killed, how long it is gone, and the time between two frames of a camera.
const FLAPS: usize = 5;
const GONE: Duration = Duration::from_millis(500);
const FRAME_EVERY: Duration = Duration::from_millis(50);

/// A host with many connections is gone without a word.
pub(crate) async fn half_open() -> Result<Row> {
    let mut lab = Lab::new()?;
    for link in ["gone", "desk"] {
        lab.link(link, None)?;
    }
    let server = Stereod::launch(&Launch {
        host: Some(ROUTER),
        http: Some("0.0.0.0:0"),
        args: &[
            "--workers",
            "1",
            "--no-zenoh",
            "--header-timeout-ms",
            "1500",
            "--body-timeout-ms",
            "1500",
        ],
        ..Launch::default()
    })?;
    let client = Client::new(&url_on(&lab, &server, "desk")?)?;
    client.ready(Duration::from_secs(60)).await?;
    let clients = Clients::start(&Target::Http(client), &pair::small(BUDGET)?, Pace::Closed(1));
    clients.have(20).await?;
    let address = url_on(&lab, &server, "gone")?;
    let address = address.trim_start_matches("http://");
    let mut left = Vec::new();
    for count in 0..HALF_OPEN {
        let mut stream = TcpStream::connect(address).await?;
        if count % 2 == 0 {
            let half = head(600_000);
            stream.write_all(&[half.as_bytes(), &[0; 1000]].concat()).await?;
        }
        left.push(stream);
    }
    let gone = left
        .iter()
        .map(TcpStream::local_addr)
        .collect::<Result<Vec<_>, _>>()?;
    until("all connections", || Ok(server.connected(&gone)? == HALF_OPEN)).await?;
    lab.cut("gone")?;
    let since = Instant::now();
    until("the end of connections to nobody", || {
        Ok(server.connected(&gone)? == 0)
    })
    .await?;
    let recovery = since.elapsed();
    clients.served_again(Instant::now()).await?;
    let tally = clients.stop().await?;
    stop(server).await?;
    let fault = format!("a host with {HALF_OPEN} connections is cut off (server waits 1.5 s)");
    Ok(Row {
        saw: format!("others: {tally}; all {HALF_OPEN} were closed"),
        ..tally.row(&fault, Recovery::Took(recovery))
    })
}

/// Clients ask for much and read nothing of it.
pub(crate) async fn slow_readers() -> Result<Row> {
    let (server, target) = with(&["--body-timeout-ms", "2000"]).await?;
    let clients = Clients::start(&target, &pair::small(BUDGET)?, Pace::Closed(1));
    clients.have(20).await?;
    let body = pair::large(Duration::from_secs(30))?.encode_to_vec();
    let address: SocketAddr = server.url().trim_start_matches("http://").parse()?;
    let mut unread = Vec::new();
    for _ in 0..SLOW {
        let socket = TcpSocket::new_v4()?;
        socket.set_recv_buffer_size(4096)?;
        let mut stream = socket.connect(address).await?;
        stream
            .write_all(&[head(body.len()).as_bytes(), &body].concat())
            .await?;
        unread.push(stream);
    }
    let silent = unread
        .iter()
        .map(TcpStream::local_addr)
        .collect::<Result<Vec<_>, _>>()?;
    until("all connections", || Ok(server.connected(&silent)? == SLOW)).await?;
    until("the end of those who don't read", || {
        Ok(server.connected(&silent)? == 0)
    })
    .await?;
    clients.served_again(Instant::now()).await?;
    drop(unread);
    let tally = clients.stop().await?;
    stop(server).await?;
    let fault = format!("{SLOW} clients read nothing of their replies of 8 MB (server waits 2 s)");
    Ok(Row {
        saw: format!("others: {tally}; those were given up"),
        ..tally.row(&fault, Recovery::NotNeeded)
    })
}

fn head(length: usize) -> String {
    format!(
        "POST /v1/stereo HTTP/1.1\r\nHost: x\r\nContent-Type: application/x-protobuf\r\nContent-Length: {length}\r\n\r\n"
    )
}

/// The router between clients and server is killed and started again, several times.
pub(crate) async fn flapping() -> Result<Row> {
    let mut router = RouterProcess::start("tcp/127.0.0.1:0", None)?;
    let endpoint = router.endpoint().to_owned();
    let args = ["--workers", "1", "--zenoh-connect", &endpoint];
    let launch = Launch {
        args: &args,
        ..Launch::default()
    };
    let (server, _) = ready(&launch).await?;
    let config = json!({ "connect": {
        "endpoints": [endpoint],
        "timeout_ms": -1,
        "exit_on_failure": false,
        "retry": { "period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 2 },
    } });
    let fleet = Fleet::over(client_with(&endpoint, config).await?).await?;
    until("the server on the Zenoh network", || {
        Ok(fleet.servers().len() == 1)
    })
    .await?;
    let camera = Film::start(&fleet).await?;
    let clients = Clients::start(&Target::Zenoh(fleet), &pair::small(RETRIED)?, Pace::Closed(2));
    clients.have(50).await?;
    let mut longest = Duration::ZERO;
    for _ in 0..FLAPS {
        drop(router);
        tokio::time::sleep(GONE).await;
        router = RouterProcess::start(&endpoint, None)?;
        let (since, results) = (Instant::now(), camera.results());
        let requests = clients.served_again(since).await?;
        until("results of the camera", || Ok(camera.results() > results + 2)).await?;
        longest = longest.max(requests).max(since.elapsed());
    }
    let tally = clients.stop().await?;
    let (sent, results) = (camera.sent(), camera.results());
    stop(server).await?;
    let fault = format!(
        "the Zenoh router is killed {FLAPS} times, for {} ms each",
        GONE.as_millis()
    );
    Ok(Row {
        saw: format!("requests: {tally}; a 20 Hz camera: {results} results of {sent} frames"),
        ..tally.row(&fault, Recovery::Took(longest))
    })
}

/// A camera and whoever reads its results.
struct Film {
    sent: Arc<AtomicU64>,
    results: Arc<AtomicU64>,
    tasks: [tokio::task::JoinHandle<Result<()>>; 2],
}

impl Film {
    async fn start(fleet: &Fleet) -> Result<Self> {
        let (sent, results) = (Arc::new(AtomicU64::new(0)), Arc::new(AtomicU64::new(0)));
        let camera = fleet.camera("flapping").await?;
        let read = fleet.results("flapping").await?;
        let reading = tokio::spawn(count(read, Arc::clone(&results)));
        let filming = tokio::spawn(film(camera, pair::small(BUDGET)?, Arc::clone(&sent)));
        Ok(Self {
            sent,
            results,
            tasks: [reading, filming],
        })
    }

    fn sent(&self) -> u64 {
        self.sent.load(Ordering::Relaxed)
    }

    fn results(&self) -> u64 {
        self.results.load(Ordering::Relaxed)
    }
}

impl Drop for Film {
    fn drop(&mut self) {
        for task in &self.tasks {
            task.abort();
        }
    }
}

/// Counts results.
async fn count(read: Results, results: Arc<AtomicU64>) -> Result<()> {
    loop {
        read.next().await?;
        results.fetch_add(1, Ordering::Relaxed);
    }
}

/// Sends frames, whatever becomes of them.
async fn film(camera: Camera, pair: v1::StereoRequest, sent: Arc<AtomicU64>) -> Result<()> {
    loop {
        let frame = v1::StereoRequest {
            sequence: Some(1 + sent.fetch_add(1, Ordering::Relaxed)),
            ..pair.clone()
        };
        camera.send(&frame).await?;
        tokio::time::sleep(FRAME_EVERY).await;
    }
}
