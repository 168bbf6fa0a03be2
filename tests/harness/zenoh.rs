//! Zenoh networks of a test's own: routers, and sessions that are connected to nothing else.

mod separate;

use anyhow::{Result, anyhow};
use serde_json::{Value, json};
use zenoh::Session;

pub use self::separate::RouterProcess;

/// How long a message waits for room on a link.
const WAIT_US: u32 = 10_000_000;

/// A router. Dropped, it is gone as if it had been killed.
#[derive(Debug)]
pub struct Router {
    session: Session,
    endpoint: String,
}

impl Router {
    /// Starts one on a free port of 127.0.0.1.
    ///
    /// # Errors
    /// If it can't listen.
    pub async fn start() -> Result<Self> {
        Self::start_with("tcp/127.0.0.1:0", json!({})).await
    }

    /// Starts one that listens on `endpoint`; `config` is laid over its configuration, top level key by key.
    ///
    /// # Errors
    /// If it can't listen there.
    pub async fn start_with(endpoint: &str, config: Value) -> Result<Self> {
        let mut all = base("router");
        all["listen"] = json!({ "endpoints": [endpoint] });
        lay_over(&mut all, config);
        Self::open(parsed(&all)?).await
    }

    /// Starts one by a configuration of its own.
    ///
    /// # Errors
    /// If it can't listen where that says.
    pub async fn open(config: zenoh::Config) -> Result<Self> {
        let session = zenoh::open(config).await.map_err(|why| anyhow!(why))?;
        let locators = session.info().locators().await;
        let mut locators_here: Vec<String> = locators.iter().map(ToString::to_string).collect();
        locators_here.sort_by_key(|locator| !locator.contains("127.0.0.1"));
        let endpoint = locators_here
            .into_iter()
            .next()
            .ok_or_else(|| anyhow!("the router listens nowhere: {locators:?}"))?;
        Ok(Self { session, endpoint })
    }

    /// Where it listens: `tcp/127.0.0.1:PORT`.
    #[must_use]
    pub fn endpoint(&self) -> &str {
        &self.endpoint
    }

    /// Ends it.
    ///
    /// # Errors
    /// If Zenoh can't close it.
    pub async fn stop(self) -> Result<()> {
        self.session.close().await.map_err(|why| anyhow!(why))
    }
}

/// A client of a router.
///
/// # Errors
/// If it can't connect.
pub async fn client(endpoint: &str) -> Result<Session> {
    client_with(endpoint, json!({})).await
}

/// The same with `config` laid over its configuration, top level key by key.
///
/// # Errors
/// If it can't connect.
pub async fn client_with(endpoint: &str, config: Value) -> Result<Session> {
    let mut all = base("client");
    all["connect"] = json!({ "endpoints": [endpoint] });
    lay_over(&mut all, config);
    open(&all).await
}

fn base(mode: &str) -> Value {
    json!({
        "mode": mode,
        // Servers are peers: they learn of each other through the router, which doesn't pass things on between peers.
        "scouting": { "multicast": { "enabled": false }, "gossip": { "enabled": true } },
        "transport": {
            // On a busy machine, too, a test's messages wait and are not dropped.
            "link": { "tx": { "lease": 1500, "queue": { "congestion_control": { "drop": {
                "wait_before_drop": WAIT_US,
                "max_wait_before_drop_fragments": WAIT_US,
            } } } } },
            "shared_memory": { "transport_optimization": { "messages": ["put"] } },
        },
    })
}

fn lay_over(all: &mut Value, config: Value) {
    if let Value::Object(config) = config {
        for (key, value) in config {
            all[key.as_str()] = value;
        }
    }
}

async fn open(config: &Value) -> Result<Session> {
    zenoh::open(parsed(config)?).await.map_err(|why| anyhow!(why))
}

fn parsed(config: &Value) -> Result<zenoh::Config> {
    zenoh::Config::from_json5(&config.to_string()).map_err(|why| anyhow!(why))
}
