//! What the system has no more of, or changes under the server.

use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use stereo_client::{Client, Fleet};
use stereo_tests::clock::SteppedClock;
use stereo_tests::process::Launch;
use stereo_tests::zenoh::Router;
use tokio::net::TcpStream;

use crate::clients::{Clients, Pace, Target};
use crate::pair;
use crate::scene::{Folder, lines, ready, stop, until};
use crate::table::{Recovery, Row};

const BUDGET: Duration = Duration::from_secs(1);
/// Size of a disk that is full soon.
const DISK: usize = 64 << 10;
/// Descriptors that the server may have.
const DESCRIPTORS: u64 = 64;
/// Makes everything read-only for the program that follows, which is seen to by trying.
const READ_ONLY: &str = "mount -o remount,bind,ro / && mount -t tmpfs -o ro none /dev/shm \
    && ! touch /tmp/stereod 2>/dev/null && ! touch /dev/shm/stereod 2>/dev/null && exec \"$0\" \"$@\"";

/// The disk that the log is on is full.
pub(crate) async fn disk_full() -> Result<Row> {
    let folder = Folder::new()?;
    let disk = Disk::mount(folder.path())?;
    let log = folder.file("log");
    let (server, target) = ready(&Launch {
        log: Some(&log),
        args: &["--workers", "1", "--no-zenoh"],
        ..Launch::default()
    })
    .await?;
    let clients = Clients::start(&target, &pair::small(BUDGET)?, Pace::Closed(2));
    until("a full disk", || {
        Ok(std::fs::write(folder.file("more"), [0; 4096]).is_err())
    })
    .await?;
    let since = Instant::now();
    clients.served_again(since).await?;
    clients.have(500).await?;
    let tally = clients.stop().await?;
    stop(server).await?;
    drop(disk);
    Ok(tally.row("the disk of the log is full", Recovery::NotNeeded))
}

/// A disk in memory.
struct Disk<'a>(&'a Path);

impl<'a> Disk<'a> {
    fn mount(folder: &'a Path) -> Result<Self> {
        let size = format!("size={DISK}");
        let mounted = Command::new("mount")
            .args(["-t", "tmpfs", "-o", &size, "none"])
            .arg(folder)
            .status()?;
        ensure!(mounted.success(), "can't mount a disk: {mounted}");
        Ok(Self(folder))
    }
}

impl Drop for Disk<'_> {
    fn drop(&mut self) {
        // It goes with the namespace otherwise.
        drop(Command::new("umount").arg("--lazy").arg(self.0).status());
    }
}

/// Nothing can be written to any disk, not even to /tmp, and there is no shared memory.
pub(crate) async fn read_only() -> Result<Row> {
    let router = Router::start().await?;
    let args = ["--workers", "1", "--zenoh-connect", router.endpoint()];
    let (server, target) = ready(&Launch {
        via: &["unshare", "--mount", "sh", "-c", READ_ONLY],
        args: &args,
        ..Launch::default()
    })
    .await?;
    let fleet = Fleet::connect(&[router.endpoint()]).await?;
    until("the server on the Zenoh network", || {
        Ok(fleet.servers().len() == 1)
    })
    .await?;
    let pair = pair::small(BUDGET)?;
    let over_http = Clients::start(&target, &pair, Pace::Closed(1));
    let over_zenoh = Clients::start(&Target::Zenoh(fleet), &pair, Pace::Closed(1));
    over_http.have(100).await?;
    over_zenoh.have(100).await?;
    let (http, zenoh) = (over_http.stop().await?, over_zenoh.stop().await?);
    stop(server).await?;
    router.stop().await?;
    let fault = "the file system is read-only, /tmp and /dev/shm too";
    Ok(Row {
        saw: format!("HTTP: {http}; Zenoh: {zenoh}"),
        lost: http.cut + http.not_taken + zenoh.cut,
        why_lost: [http.why_cut(), zenoh.why_cut()].join(" "),
        ..http.row(fault, Recovery::NotNeeded)
    })
}

/// Silent connections take all descriptors; they are closed after 1.5 s.
pub(crate) async fn descriptors() -> Result<Row> {
    let limit = format!("--nofile={DESCRIPTORS}");
    let (server, target) = ready(&Launch {
        via: &["prlimit", &limit],
        args: &["--workers", "1", "--no-zenoh", "--header-timeout-ms", "1500"],
        ..Launch::default()
    })
    .await?;
    let pair = pair::small(BUDGET)?;
    let clients = Clients::start(&target, &pair, Pace::Closed(1));
    clients.have(20).await?;
    let address = server.url().trim_start_matches("http://").to_owned();
    let mut crowd = Vec::new();
    // More than it can take: the rest waits to be accepted.
    for _ in 0..2 * DESCRIPTORS {
        crowd.push(TcpStream::connect(&address).await?);
    }
    until("the last descriptor", || Ok(server.descriptors()? >= DESCRIPTORS)).await?;
    let since = Instant::now();
    let newcomer = Client::new(server.url())?.match_pair(&pair).await;
    let recovery = since.elapsed();
    newcomer.context("a newcomer")?;
    clients.served_again(Instant::now()).await?;
    drop(crowd);
    let tally = clients.stop().await?;
    stop(server).await?;
    let fault = format!("all of {DESCRIPTORS} descriptors taken by silent connections (closed after 1.5 s)");
    Ok(Row {
        saw: format!("who was connected: {tally}; a newcomer waited"),
        ..tally.row(&fault, Recovery::Took(recovery))
    })
}

/// The clock steps.
pub(crate) async fn clock(offset: &str, fault: &str) -> Result<Row> {
    let folder = Folder::new()?;
    let clock = SteppedClock::new(&folder.file("clock"))?;
    let log = folder.file("log");
    let (server, target) = ready(&Launch {
        via: &clock.via(),
        log: Some(&log),
        args: &["--workers", "1", "--log-format", "json"],
        ..Launch::default()
    })
    .await?;
    let clients = Clients::start(&target, &pair::small(BUDGET)?, Pace::Closed(2));
    clients.have(100).await?;
    clock.step_to(offset)?;
    let since = Instant::now();
    clients.served_again(since).await?;
    clients.have(300).await?;
    let tally = clients.stop().await?;
    stop(server).await?;
    let times: Vec<jiff::Timestamp> = lines(&log)?
        .iter()
        .filter_map(|line| line["timestamp"].as_str()?.parse().ok())
        .collect();
    let (first, last) = (times.first().context("a log")?, times.last().context("a log")?);
    let step = first.duration_until(*last).as_secs().abs();
    ensure!(step > 3000, "the clock did not step: {first} to {last}");
    ensure!(
        tally.late == 0 && tally.all_refused() == 0,
        "the step was noticed: {tally}"
    );
    Ok(tally.row(fault, Recovery::NotNeeded))
}
