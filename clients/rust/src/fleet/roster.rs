//! Which servers there are, and how busy each one is.

use std::collections::HashMap;
use std::hash::{BuildHasher, RandomState};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use prost::Message;
use stereo_proto::v1::ServerLoad;
use zenoh::Session;
use zenoh::pubsub::Subscriber;
use zenoh::sample::{Sample, SampleKind};

use crate::ClientError;

/// A server that has not told its load for so long is frozen or cut off.
const SILENCE: Duration = Duration::from_millis(1000);

/// Servers that are remembered at one time.
const MOST_SERVERS: usize = 4096;

/// All servers, as they announce themselves.
#[derive(Debug, Default)]
pub(super) struct Roster(Mutex<HashMap<String, Server>>);

#[derive(Debug, Clone)]
struct Server {
    /// It has been here since then, as far as is known.
    since: Instant,
    heard_at: Instant,
    load: ServerLoad,
}

impl Server {
    /// One that has told nothing yet.
    fn new(now: Instant) -> Self {
        Self {
            since: now,
            heard_at: now,
            load: ServerLoad::default(),
        }
    }
}

impl Roster {
    /// Follows who comes and goes.
    pub(super) async fn follow(session: &Session) -> Result<(Arc<Self>, [Subscriber<()>; 2]), ClientError> {
        let failed = |why: zenoh::Error| ClientError::Network(why.to_string());
        let roster = Arc::new(Self::default());
        let (loads, servers) = (Arc::clone(&roster), Arc::clone(&roster));
        let loads = session
            .declare_subscriber("stereo/v1/load/*")
            .callback(move |sample| loads.told(&sample))
            .await
            .map_err(failed)?;
        let alive = session
            .liveliness()
            .declare_subscriber("stereo/v1/alive/*")
            .history(true)
            .callback(move |sample| servers.changed(&sample))
            .await
            .map_err(failed)?;
        Ok((roster, [loads, alive]))
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<String, Server>> {
        // Nothing that is called while it is held panics.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn told(&self, sample: &Sample) {
        let Ok(load) = ServerLoad::decode(&*sample.payload().to_bytes()) else {
            return;
        };
        if name(sample) != Some(&load.instance) {
            return;
        }
        // One that tells its load is there, whatever was heard of its token: the token's end and its next beginning may come by
        // two ways, and in the wrong order.
        let mut servers = self.lock();
        if servers.len() >= MOST_SERVERS {
            servers.retain(|_, server| server.heard_at.elapsed() < SILENCE);
        }
        if servers.len() < MOST_SERVERS || servers.contains_key(&load.instance) {
            let now = Instant::now();
            let server = servers
                .entry(load.instance.clone())
                .or_insert_with(|| Server::new(now));
            (server.heard_at, server.load) = (now, load);
        }
    }

    fn changed(&self, sample: &Sample) {
        let Some(name) = name(sample) else { return };
        match sample.kind() {
            SampleKind::Put => {
                let load = ServerLoad {
                    instance: name.to_owned(),
                    ..ServerLoad::default()
                };
                let now = Instant::now();
                self.lock().insert(
                    name.to_owned(),
                    Server {
                        load,
                        ..Server::new(now)
                    },
                );
            }
            SampleKind::Delete => drop(self.lock().remove(name)),
        }
    }

    pub(super) fn servers(&self) -> Vec<ServerLoad> {
        let mut servers: Vec<ServerLoad> = self.lock().values().map(|server| server.load.clone()).collect();
        servers.sort_by(|a, b| a.instance.cmp(&b.instance));
        servers
    }

    /// Whether what the server was asked at `asked_at` may be lost: it is gone or silent, or has come anew since then.
    pub(super) fn may_have_lost(&self, server: &str, asked_at: Instant) -> bool {
        let servers = self.lock();
        let is_same = |server: &Server| server.since <= asked_at && server.heard_at.elapsed() < SILENCE;
        !servers.get(server).is_some_and(is_same)
    }

    /// Whether there is a server that has not been tried.
    pub(super) fn has_other(&self, tried: &[String]) -> bool {
        !self.candidates(tried).is_empty()
    }

    /// The better of two random servers that have not been tried, for a request that has `left` to live.
    pub(super) fn choose(&self, tried: &[String], left: Duration) -> Option<String> {
        let mut candidates = self.candidates(tried);
        let first = pick(&mut candidates)?;
        let second = pick(&mut candidates);
        let better = match second {
            Some(second) if cost(&second, left) < cost(&first, left) => second,
            _ => first,
        };
        Some(better.instance)
    }

    fn candidates(&self, tried: &[String]) -> Vec<ServerLoad> {
        let is_there = |server: &&Server| {
            server.heard_at.elapsed() < SILENCE
                && !server.load.draining
                && !tried.contains(&server.load.instance)
        };
        let servers = self.lock();
        servers
            .values()
            .filter(is_there)
            .map(|server| server.load.clone())
            .collect()
    }
}

/// Servers that can't be in time come last; of the others the one with least to do.
fn cost(load: &ServerLoad, left: Duration) -> (bool, Duration, u32) {
    let backlog = load.backlog.and_then(|backlog| backlog.try_into().ok());
    let backlog: Duration = backlog.unwrap_or_default();
    (backlog >= left, backlog, load.waiting + load.busy_workers)
}

fn pick(candidates: &mut Vec<ServerLoad>) -> Option<ServerLoad> {
    let count = candidates.len() as u64;
    let random = RandomState::new().hash_one(count);
    let index = usize::try_from(random.checked_rem(count)?).ok()?;
    Some(candidates.swap_remove(index))
}

fn name(sample: &Sample) -> Option<&str> {
    sample.key_expr().as_str().rsplit('/').next()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn server(instance: &str, backlog_ms: u64, draining: bool) -> (String, Server) {
        let load = ServerLoad {
            instance: instance.to_owned(),
            backlog: Duration::from_millis(backlog_ms).try_into().ok(),
            draining,
            ..ServerLoad::default()
        };
        (
            instance.to_owned(),
            Server {
                load,
                ..Server::new(Instant::now())
            },
        )
    }

    fn roster(servers: impl IntoIterator<Item = (String, Server)>) -> Roster {
        Roster(Mutex::new(servers.into_iter().collect()))
    }

    const LEFT: Duration = Duration::from_millis(100);

    #[test]
    fn of_two_servers_the_one_with_less_to_do_is_chosen() {
        let roster = roster([server("busy", 50, false), server("free", 0, false)]);
        for _ in 0..100 {
            assert_eq!(roster.choose(&[], LEFT).as_deref(), Some("free"));
        }
        assert_eq!(roster.choose(&["free".to_owned()], LEFT).as_deref(), Some("busy"));
        assert_eq!(roster.choose(&["free".to_owned(), "busy".to_owned()], LEFT), None);
    }

    #[test]
    fn of_many_servers_the_busiest_is_never_chosen_and_the_others_share() {
        let roster = roster((0..4).map(|i| server(&i.to_string(), 10 * i, false)));
        let mut chosen = HashMap::new();
        for _ in 0..1000 {
            *chosen
                .entry(roster.choose(&[], LEFT).unwrap_or_default())
                .or_insert(0) += 1;
        }
        assert!(!chosen.contains_key("3"), "{chosen:?}");
        assert!(
            chosen["0"] > chosen["1"] && chosen["1"] > chosen["2"],
            "{chosen:?}"
        );
    }

    #[test]
    fn servers_that_stop_or_are_silent_are_not_chosen() {
        let (name, mut silent) = server("silent", 0, false);
        silent.heard_at = Instant::now()
            .checked_sub(SILENCE)
            .expect("the machine has run for a second");
        let roster = roster([server("stopping", 0, true), (name, silent)]);
        assert_eq!(roster.choose(&[], LEFT), None);
    }

    #[test]
    fn what_a_server_was_asked_may_be_lost_if_it_is_gone_silent_or_here_anew() {
        let before = Instant::now();
        let roster = roster([server("anew", 0, false)]);
        assert!(roster.may_have_lost("anew", before));
        assert!(!roster.may_have_lost("anew", Instant::now()));
        assert!(roster.may_have_lost("gone", Instant::now()));
        let long_ago = Instant::now().checked_sub(SILENCE);
        roster.lock().get_mut("anew").expect("it is there").heard_at =
            long_ago.expect("the machine has run for a second");
        assert!(roster.may_have_lost("anew", Instant::now()));
    }
}
