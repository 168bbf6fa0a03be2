//! More pairs than memory.

use std::process::Command;
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use prost::Message;
use stereo_tests::process::{Launch, Stereod};

use crate::clients::{Clients, Pace};
use crate::pair;
use crate::scene::{ready, stop};
use crate::table::{Recovery, Row};

/// What the bodies and replies under way may take by the server's configuration.
const BOUND: u64 = 100_000_000;
/// What all of them may take at most, and the connections of those who were refused and still send: some hundreds of them, 16 KiB and more
/// each. It is 6 to 8 % as a rule.
const ALLOWED: u64 = BOUND / 100 * 115;
/// How much more it may reserve: buffers that grow reserve up to twice what is in them.
const RESERVED: u64 = 3 * BOUND;
/// Pairs at a time that are well within the bound: the worker has begun all that it begins beside each other, so that its buffers have their size.
const AT_FIRST: usize = 3;
/// Clients that send 4-megapixel pairs of 8 MB: twice as many as fit.
const CLIENTS: usize = 25;
const BUDGET: Duration = Duration::from_secs(5);

/// The system lets the process reserve three times its bound, and twice the bound is sent again and again.
pub(crate) async fn limited() -> Result<Row> {
    let bound = BOUND.to_string();
    let bounds = ["--max-bytes-in-flight", &bound, "--max-body-bytes", "20000000"];
    let args = [&["--workers", "1", "--no-zenoh"], bounds.as_slice()].concat();
    let (server, target) = ready(&Launch {
        args: &args,
        ..Launch::default()
    })
    .await?;
    let pair = pair::large(BUDGET)?;
    let few = Clients::start(&target, &pair, Pace::Closed(AT_FIRST));
    few.have(4 * AT_FIRST).await?;
    let before = few.stop().await?;
    let at_first = peak(&server)?;
    limit(&server, server.data_bytes()? + RESERVED)?;
    let clients = Clients::start(&target, &pair, Pace::Closed(CLIENTS));
    clients.have(50).await?;
    let tally = clients.stop().await?;
    let bytes = pair.encoded_len() as u64;
    let took = peak(&server)?.saturating_sub(at_first) + AT_FIRST as u64 * bytes;
    ensure!(took <= ALLOWED, "they took {took} bytes, {ALLOWED} are allowed");
    stop(server).await?;
    let megabytes = |bytes: u64| bytes / 1_000_000;
    let fault = format!(
        "memory limited, and {} MB sent at a time where {} MB are allowed",
        8 * CLIENTS,
        megabytes(BOUND)
    );
    Ok(Row {
        saw: format!("{tally}; bodies and replies took {} MB", megabytes(took)),
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
