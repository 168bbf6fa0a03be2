//! A Zenoh router as a process of its own, which can be frozen and killed: `router ENDPOINT`. Ends with its standard input.
#![forbid(unsafe_code)]

use std::io::Read;

use anyhow::{Context, Result};
use stereo_tests::zenoh::Router;

#[expect(clippy::print_stdout, reason = "whoever started it reads where it listens")]
#[tokio::main]
async fn main() -> Result<()> {
    let endpoint = std::env::args().nth(1).context("usage: router ENDPOINT")?;
    let router = Router::start_with(&endpoint, serde_json::json!({})).await?;
    println!("{}", router.endpoint());
    // Read on a thread that may wait.
    tokio::task::spawn_blocking(|| std::io::stdin().read_to_end(&mut Vec::new())).await??;
    router.stop().await
}
