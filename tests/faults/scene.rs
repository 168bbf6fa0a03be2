//! A server for a fault, and where its log goes.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use serde_json::Value;
use stereo_client::Client;
use stereo_tests::process::{Launch, Stereod};

use crate::clients::Target;

/// How long a server may take until it is ready.
const READY_WITHIN: Duration = Duration::from_secs(60);
/// How long something that happens by itself may take.
const PATIENCE: Duration = Duration::from_secs(60);

/// A server that takes frames, and the way to it.
pub(crate) async fn ready(launch: &Launch<'_>) -> Result<(Stereod, Target)> {
    let server = Stereod::launch(launch)?;
    let target = Target::http(server.url())?;
    Client::new(server.url())?.ready(READY_WITHIN).await?;
    Ok((server, target))
}

/// The same with one worker, without Zenoh.
pub(crate) async fn with(args: &[&str]) -> Result<(Stereod, Target)> {
    let args = [&["--workers", "1", "--no-zenoh"], args].concat();
    ready(&Launch {
        args: &args,
        ..Launch::default()
    })
    .await
}

/// Tells a server to stop, and waits until it has: how it ended, and after which time.
pub(crate) async fn stop(server: Stereod) -> Result<Duration> {
    let since = Instant::now();
    let status = tokio::task::spawn_blocking(|| server.stop()).await??;
    ensure!(status.success(), "the server ended with {status}");
    Ok(since.elapsed())
}

/// Waits until `done`.
pub(crate) async fn until(what: &str, mut done: impl FnMut() -> Result<bool>) -> Result<()> {
    let patience = Instant::now() + PATIENCE;
    while !done()? {
        ensure!(Instant::now() < patience, "{what} did not come");
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    Ok(())
}

/// A folder that goes with this.
pub(crate) struct Folder(PathBuf);

impl Folder {
    pub(crate) fn new() -> Result<Self> {
        static COUNT: AtomicU64 = AtomicU64::new(0);
        let count = COUNT.fetch_add(1, Ordering::Relaxed);
        let name = format!("stereod-faults-{}-{count}", std::process::id());
        let path = std::env::temp_dir().join(name);
        std::fs::create_dir(&path).with_context(|| format!("can't make {}", path.display()))?;
        Ok(Self(path))
    }

    pub(crate) fn path(&self) -> &Path {
        &self.0
    }

    pub(crate) fn file(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        // A few bytes in the folder for temporary files.
        drop(std::fs::remove_dir_all(&self.0));
    }
}

/// The lines of a log in JSON.
pub(crate) fn lines(log: &Path) -> Result<Vec<Value>> {
    let text = std::fs::read_to_string(log).with_context(|| format!("can't read {}", log.display()))?;
    let lines = text
        .lines()
        .map(|line| serde_json::from_str(line).with_context(|| format!("no JSON: {line}")));
    lines.collect()
}
