//! More pairs than memory.

use std::process::Command;
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use stereo_tests::process::{Launch, Stereod};

use crate::clients::{Clients, Pace};
use crate::pair;
use crate::scene::{ready, stop};
use crate::table::{Recovery, Row};

/// What the bodies and replies under way may take by the server's configuration.
const BOUND: u64 = 100_000_000;
/// How much more the process may have resident than for one pair at a time: that, and half as much for what the allocator keeps and for the
/// buffers of a second pair that a worker has begun.
const ALLOWED: u64 = BOUND + BOUND / 2;
/// How much more it may reserve: buffers that grow reserve up to twice what is in them.
const RESERVED: u64 = 3 * BOUND;
/// As in the container image: glibc would keep what large bodies took otherwise, in each of its arenas.
const ALLOCATOR: [&str; 2] = ["env", "MALLOC_MMAP_THRESHOLD_=1048576"];
/// Clients that send 4-megapixel pairs of 8 MB: twice as many as fit.
const CLIENTS: usize = 25;
const BUDGET: Duration = Duration::from_secs(5);

/// The system lets the process reserve three times its bound, and twice the bound is sent again and again.
pub(crate) async fn limited() -> Result<Row> {
    let bound = BOUND.to_string();
    let bounds = ["--max-bytes-in-flight", &bound, "--max-body-bytes", "20000000"];
    let args = [&["--workers", "1", "--no-zenoh"], bounds.as_slice()].concat();
    let (server, target) = ready(&Launch {
        via: &ALLOCATOR,
        args: &args,
        ..Launch::default()
    })
    .await?;
    let pair = pair::large(BUDGET)?;
    // Its buffers have their size after this.
    let alone = Clients::start(&target, &pair, Pace::Closed(1));
    alone.have(3).await?;
    let before = alone.stop().await?;
    let at_first = peak(&server)?;
    limit(&server, server.data_bytes()? + RESERVED)?;
    let clients = Clients::start(&target, &pair, Pace::Closed(CLIENTS));
    clients.have(50).await?;
    let tally = clients.stop().await?;
    let grown = peak(&server)?.saturating_sub(at_first);
    ensure!(
        grown <= ALLOWED,
        "it took {grown} bytes more than for one pair, {ALLOWED} are allowed"
    );
    stop(server).await?;
    let megabytes = |bytes: u64| bytes / 1_000_000;
    let fault = format!(
        "memory limited, and {} MB sent at a time where {} MB are allowed",
        8 * CLIENTS,
        megabytes(BOUND)
    );
    Ok(Row {
        saw: format!(
            "{tally}; the server took {} MB more than for one pair",
            megabytes(grown)
        ),
        lost: before.cut + tally.cut + tally.not_taken,
        ..tally.row(&fault, Recovery::NotNeeded)
    })
}

fn peak(server: &Stereod) -> Result<u64> {
    let peak = server.memory_peak_bytes();
    peak.context("the system doesn't say how much memory the server took")
}

/// Lets a process have so much memory that it can write to.
fn limit(server: &Stereod, bytes: u64) -> Result<()> {
    let set = Command::new("prlimit")
        .arg(format!("--pid={}", server.id()))
        .arg(format!("--data={bytes}"))
        .status()
        .context("can't run prlimit")?;
    ensure!(set.success(), "prlimit ended with {set}");
    Ok(())
}
