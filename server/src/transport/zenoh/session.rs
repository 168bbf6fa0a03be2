//! The session: how it is configured, opened for as long as that takes, and closed in bounded time.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use serde_json::{Value, json};
use tokio::runtime::Handle;
use zenoh::Session;
use zenoh::config::ZenohId;
use zenoh::sample::SampleKind;

use super::outgoing::Outgoing;
use crate::config::{Config, ConfigError, zenoh_file};
use crate::streams::{NetworkState, Streams};

/// Time between two attempts to open a session.
const REOPEN_AFTER: Duration = Duration::from_secs(1);
/// How long closing may take: it waits for peers that may be out of reach.
const CLOSE_WITHIN: Duration = Duration::from_secs(2);
/// Time without a word from the other side after which a connection is given up.
const LEASE_MS: u32 = 1500;
/// Longest time between two attempts to connect.
const RETRY_MS: u32 = 1000;
/// Receiving buffer of a link: large frames in fewer reads.
const RECEIVE_BUFFER_BYTES: u32 = 4 << 20;
/// How long a result waits for room on a link before it is dropped. Zenoh's own 1 ms, or 50 ms for messages in several fragments, drops
/// results wherever a machine is busy for that long; whatever waits here is on a thread of its own, and the newest comes next.
const DROP_AFTER_US: u32 = 200_000;
/// Pieces of large messages, 64 KiB each, that may wait for a link: with Zenoh's own 2, the sender and the link take turns.
const SEND_QUEUE: u32 = 16;
/// Whether a session uses shared memory, in Zenoh's configuration.
const SHARED_MEMORY: &str = "transport/shared_memory/enabled";
/// A message is this much longer than its payload at most.
const ENVELOPE_BYTES: u64 = 64 << 10;

/// Zenoh's configuration: our defaults, under what the file says, under what the flags say.
pub(super) fn configure(config: &Config) -> Result<zenoh::Config, ConfigError> {
    let zenoh = &config.zenoh;
    let mut merged = defaults(config);
    let mut sources = Vec::new();
    let mut said = json!({});
    if let Some(path) = &zenoh.file {
        sources.push(path.display().to_string());
        let name = path.display().to_string();
        let text = std::fs::read_to_string(path).map_err(|why| ConfigError::Zenoh {
            reason: format!("{name}: {why}"),
        })?;
        let given = zenoh_file(&text, &name)?;
        said = given.clone();
        merge(&mut merged, given);
    }
    for (section, endpoints) in [("connect", &zenoh.connect), ("listen", &zenoh.listen)] {
        if !endpoints.is_empty() {
            sources.push(format!("--zenoh-{section}"));
            merged[section]["endpoints"] = json!(endpoints);
            said[section]["endpoints"] = json!(endpoints);
        }
    }
    // Peers of one router have to reach each other, which they can't at a loopback address, and a router passes nothing on between
    // them. Whoever is told where the router is, and not where to listen, is its client.
    if said["mode"].is_null() && said["listen"].is_null() && !said["connect"].is_null() {
        merged["mode"] = json!("client");
    }
    zenoh::Config::from_json5(&merged.to_string()).map_err(|why| ConfigError::Zenoh {
        reason: format!("{}: {why}", sources.join(" and ")),
    })
}

/// What a server for robots wants to be otherwise than Zenoh's own defaults.
fn defaults(config: &Config) -> Value {
    json!({
        "mode": "peer",
        "metadata": { "name": config.instance },
        "listen": { "endpoints": { "peer": ["tcp/127.0.0.1:0"], "router": ["tcp/127.0.0.1:0"] } },
        // An absent router is tried again for ever, and is no reason not to start.
        "connect": {
            "timeout_ms": -1,
            "exit_on_failure": false,
            "retry": { "period_init_ms": 100, "period_max_ms": RETRY_MS, "period_increase_factor": 2 },
        },
        "scouting": { "multicast": { "enabled": false } },
        "transport": {
            "link": {
                "tx": {
                    "lease": LEASE_MS,
                    "queue": {
                        "size": { "data": SEND_QUEUE },
                        "congestion_control": { "drop": {
                            "wait_before_drop": DROP_AFTER_US,
                            "max_wait_before_drop_fragments": DROP_AFTER_US,
                        } },
                    },
                },
                "rx": {
                    "buffer_size": RECEIVE_BUFFER_BYTES,
                    "max_message_size": config.limits.body_bytes + ENVELOPE_BYTES,
                },
            },
            // What goes through shared memory is put there by us: see `outgoing`.
            "shared_memory": { "transport_optimization": { "messages": [] } },
        },
    })
}

/// Lays `over` over `under`, object by object.
fn merge(under: &mut Value, over: Value) {
    match (under, over) {
        (Value::Object(under), Value::Object(over)) => {
            for (key, value) in over {
                merge(under.entry(key).or_insert(Value::Null), value);
            }
        }
        (under, over) => *under = over,
    }
}

/// Opens a session, trying again until it succeeds.
pub(super) async fn open(
    config: &zenoh::Config,
    streams: &Arc<Streams>,
    outgoing: &Arc<Outgoing>,
) -> Session {
    loop {
        match open_somehow(config).await {
            Ok(session) => {
                watch(&session, &reachable_at(&session, config).await, streams, outgoing).await;
                return session;
            }
            Err(why) => {
                tracing::error!(%why, "the Zenoh session can't be opened, trying again");
                streams.set_network(|network| network.why = Some(why.to_string()));
            }
        }
        tokio::time::sleep(REOPEN_AFTER).await;
    }
}

/// Opens a session, without shared memory where the system has none to give.
async fn open_somehow(config: &zenoh::Config) -> zenoh::Result<Session> {
    let why = match zenoh::open(config.clone()).await {
        Err(why) if shares_memory(config) => why,
        done => return done,
    };
    let mut without = config.clone();
    without.insert_json5(SHARED_MEMORY, "false")?;
    match zenoh::open(without).await {
        Ok(session) => {
            tracing::warn!(%why, "shared memory can't be used: frames and results of this host go through the network too");
            Ok(session)
        }
        // Then it was something else.
        Err(_) => Err(why),
    }
}

fn shares_memory(config: &zenoh::Config) -> bool {
    config
        .get_json(SHARED_MEMORY)
        .is_ok_and(|enabled| enabled == "true")
}

/// Where the session listens, or if it doesn't, where the router is that it is a client of.
async fn reachable_at(session: &Session, config: &zenoh::Config) -> Vec<String> {
    let own = session.info().locators().await;
    if !own.is_empty() {
        return own.iter().map(ToString::to_string).collect();
    }
    let endpoints = config.get_json("connect/endpoints").unwrap_or_default();
    serde_json::from_str(&endpoints).unwrap_or_default()
}

/// Keeps what is known about the network up to date.
async fn watch(session: &Session, locators: &[String], streams: &Arc<Streams>, outgoing: &Arc<Outgoing>) {
    tracing::info!(zid = %session.zid(), ?locators, "the Zenoh session is open");
    streams.set_network(|network| {
        network.state = NetworkState::Open;
        network.why = None;
        network.locators = locators.to_vec();
    });
    let connected = Mutex::new(HashMap::<ZenohId, bool>::new());
    let (streams, outgoing) = (Arc::clone(streams), Arc::clone(outgoing));
    let runtime = Handle::current();
    let listening = session
        .info()
        .transport_events_listener()
        .history(true)
        .callback(move |event| {
            let mut connected = connected.lock().unwrap_or_else(PoisonError::into_inner);
            let other = *event.transport().zid();
            match event.kind() {
                SampleKind::Put => connected.insert(other, event.transport().is_shm()),
                SampleKind::Delete => connected.remove(&other),
            };
            let neighbours = connected.values().filter(|&&shares| shares).count();
            outgoing.set_neighbours(neighbours);
            if neighbours > 0 {
                let outgoing = Arc::clone(&outgoing);
                // Zenoh's own thread has no time for it.
                runtime.spawn_blocking(move || outgoing.prepare());
            }
            let connections = connected.len();
            tracing::info!(%other, kind = %event.kind(), connections, "a Zenoh connection has changed");
            streams.set_network(|network| network.connections = connections);
        })
        .background()
        .await;
    if let Err(why) = listening {
        tracing::warn!(%why, "connections can't be watched");
    }
}

/// Closes a session, by leaving it behind if need be.
pub(super) async fn close(session: Session) {
    match tokio::time::timeout(CLOSE_WITHIN, session.close()).await {
        Ok(Ok(())) => {}
        Ok(Err(why)) => tracing::warn!(%why, "the Zenoh session did not close in order"),
        Err(_) => tracing::warn!("closing the Zenoh session took too long, leaving it"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_file_says_wins_over_the_defaults_and_flags_win_over_the_file() {
        let path = std::env::temp_dir().join(format!("stereod-zenoh-{}.json5", std::process::id()));
        let text = "{ mode: 'client', // a comment\n connect: { endpoints: ['tcp/a:1'] }, transport: { link: { tx: { lease: 900 } } } }";
        std::fs::write(&path, text).unwrap();
        let mut config = Config::default();
        config.zenoh.file = Some(path.clone());
        let effective = configure(&config).unwrap();
        let get = |key: &str| effective.get_json(key).unwrap();
        assert_eq!(get("mode"), "\"client\"");
        assert_eq!(get("transport/link/tx/lease"), "900");
        assert_eq!(get("scouting/multicast/enabled"), "false");
        assert!(get("connect/endpoints").contains("tcp/a:1"));
        config.zenoh.connect = vec!["tcp/127.0.0.1:7".to_owned()];
        assert!(
            configure(&config)
                .unwrap()
                .get_json("connect/endpoints")
                .unwrap()
                .contains("127.0.0.1:7")
        );
        std::fs::write(&path, "{ mode: 'pear' }").unwrap();
        let error = configure(&config).unwrap_err().to_string();
        assert!(error.contains("stereod-zenoh-"), "{error}");
        std::fs::remove_file(&path).unwrap();
        assert!(
            configure(&config)
                .unwrap_err()
                .to_string()
                .contains("stereod-zenoh-")
        );
    }

    #[test]
    fn whoever_is_told_where_the_router_is_and_not_where_to_listen_is_its_client() {
        let mode = |connect: &[&str], listen: &[&str]| {
            let mut config = Config::default();
            config.zenoh.connect = connect.iter().map(ToString::to_string).collect();
            config.zenoh.listen = listen.iter().map(ToString::to_string).collect();
            configure(&config).unwrap().get_json("mode").unwrap()
        };
        assert_eq!(mode(&[], &[]), "\"peer\"");
        assert_eq!(mode(&[], &["tcp/127.0.0.1:7447"]), "\"peer\"");
        assert_eq!(mode(&["tcp/10.0.0.1:7447"], &["tcp/10.0.0.2:7447"]), "\"peer\"");
        assert_eq!(mode(&["tcp/10.0.0.1:7447"], &[]), "\"client\"");
    }

    #[test]
    fn an_endpoint_that_is_none_is_refused() {
        let mut config = Config::default();
        config.zenoh.connect = vec!["router".to_owned()];
        let error = configure(&config).unwrap_err();
        assert!(matches!(error, ConfigError::Zenoh { .. }), "{error}");
    }
}
