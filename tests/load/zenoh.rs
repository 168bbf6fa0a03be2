//! What Zenoh costs: round trips of a request beside HTTP's, and cameras that stream.

mod cameras;
mod round_trip;
mod takeover;

use std::time::Duration;

use anyhow::{Context, Result, anyhow};
use serde_json::Value;
use stereo_tests::process::{Launch, Stereod};
use stereo_tests::{machine, readme};
use zenoh::Session;

use crate::args::Args;
use crate::{STARTED_WITHIN, progress_bar, wait_until_ready};

/// Time between two looks whether the server's session is open.
const LOOK_AGAIN: Duration = Duration::from_millis(20);

/// Round trips of each way.
pub(crate) fn round_trips(args: &Args) -> Result<()> {
    let server = start(args)?;
    let table = runtime()?.block_on(async {
        let endpoint = endpoint(server.url()).await?;
        round_trip::measure(server.url(), &endpoint).await
    })?;
    server.stop()?;
    publish(args, "round-trips", &table)
}

/// Cameras for `--seconds` each.
pub(crate) fn cameras(args: &Args) -> Result<()> {
    let server = start(args)?;
    let rows = runtime()?.block_on(async {
        let endpoint = endpoint(server.url()).await?;
        let bar = progress_bar(cameras::PLANS.len() as u64, "{bar:30} {elapsed}  {msg}")?;
        bar.enable_steady_tick(Duration::from_millis(500));
        let mut rows = Vec::new();
        for plan in cameras::PLANS {
            bar.set_message(plan.name());
            rows.push(cameras::stream(server.url(), &endpoint, plan, args.seconds.max(1.0)).await?);
            bar.inc(1);
        }
        bar.finish_and_clear();
        anyhow::Ok(rows)
    })?;
    server.stop()?;
    publish(
        args,
        "cameras",
        &format!("{}\n{}", cameras::HEADER, rows.join("\n")),
    )
}

/// Failures of servers and routers.
pub(crate) fn takeovers(args: &Args) -> Result<()> {
    let table = runtime()?.block_on(takeover::measure(args.stereod.as_deref()))?;
    publish(args, "takeovers", &table)
}

/// Not kept apart by cores: the server, its network threads and the cameras share them all, as on a robot.
fn start(args: &Args) -> Result<Stereod> {
    let server = Stereod::launch(&Launch {
        program: args.stereod.as_deref(),
        args: &["--workers", &args.workers.to_string()],
        ..Launch::default()
    })?;
    wait_until_ready(server.url(), STARTED_WITHIN)?;
    Ok(server)
}

fn runtime() -> Result<tokio::runtime::Runtime> {
    Ok(tokio::runtime::Builder::new_multi_thread().enable_all().build()?)
}

/// Prints a table, and writes it between the markers of this name if there is a file to write to.
#[expect(clippy::print_stdout, reason = "the tables are what this program is for")]
fn publish(args: &Args, name: &str, table: &str) -> Result<()> {
    let workers = match args.workers {
        1 => String::new(),
        several => format!(", {several} workers"),
    };
    let text = format!("{table}\n\n{}{workers}.", machine::describe());
    println!("{text}");
    match &args.write {
        Some(path) => readme::write_table(path, name, &text),
        None => Ok(()),
    }
}

/// What the server at `url` says at `path`.
async fn get(url: &str, path: &str) -> Result<Value> {
    // A proxy of the environment would look for the server on its own machine.
    let http = stereo_tests::http::builder().no_proxy().build()?;
    let body = http.get(format!("{url}{path}")).send().await?.bytes().await?;
    serde_json::from_slice(&body).with_context(|| format!("{url}{path} answered no JSON"))
}

/// Where the server's session can be reached.
pub(crate) async fn endpoint(url: &str) -> Result<String> {
    loop {
        if let Some(locator) = get(url, "/readyz").await?["zenoh"]["locators"][0].as_str() {
            return Ok(locator.to_owned());
        }
        tokio::time::sleep(LOOK_AGAIN).await;
    }
}

/// A client of the server, with or without shared memory.
pub(crate) async fn session(endpoint: &str, shared_memory: bool) -> Result<Session> {
    let config = serde_json::json!({ "transport": {
        // As the Rust client has it.
        "link": { "tx": { "queue": { "size": { "data": 16 } } } },
        "shared_memory": { "enabled": shared_memory, "transport_optimization": { "messages": ["put"] } },
    } });
    stereo_tests::zenoh::client_with(endpoint, config).await
}

/// Zenoh's errors are none that `anyhow` takes.
pub(crate) fn zenoh_error(why: zenoh::Error) -> anyhow::Error {
    anyhow!(why)
}

/// The value below which `percent` of all are, in ms.
fn percentile_ms(values: &mut [Duration], percent: usize) -> f64 {
    values.sort_unstable();
    let index = values.len().saturating_sub(1) * percent / 100;
    values
        .get(index)
        .map_or(f64::NAN, |value| value.as_secs_f64() * 1e3)
}
