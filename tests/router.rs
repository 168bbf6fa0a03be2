//! A Zenoh router as a process of its own, which can be frozen and killed: `router ENDPOINT`. Ends with its standard input.
#![forbid(unsafe_code)]

use std::io::Read;

use anyhow::{Context, Result, anyhow};
use serde_json::json;
use stereo_tests::zenoh::Router;

/// As users run theirs. The routers inside a test let everything wait for room on a link for long; one that does so at a link that is
/// cut receives nothing meanwhile, from nobody, and loses all its connections.
const CONFIG: &str = include_str!("../docker/zenoh-open.json5");

#[expect(clippy::print_stdout, reason = "whoever started it reads where it listens")]
#[tokio::main]
async fn main() -> Result<()> {
    let endpoint = std::env::args().nth(1).context("usage: router ENDPOINT")?;
    let mut config = zenoh::Config::from_json5(CONFIG).map_err(|why| anyhow!(why))?;
    config
        .insert_json5("listen/endpoints", &json!([endpoint]).to_string())
        .map_err(|why| anyhow!(why))?;
    let router = Router::open(config).await?;
    println!("{}", router.endpoint());
    // Read on a thread that may wait.
    tokio::task::spawn_blocking(|| std::io::stdin().read_to_end(&mut Vec::new())).await??;
    router.stop().await
}
