//! Who is there, and who serves which camera.
//!
//! Presence is Zenoh's liveliness. A camera is served by exactly one server: of all live ones, the one with the largest hash of
//! camera and server (rendezvous hashing), which every server works out for itself, and which moves as few cameras as possible when a
//! server comes or goes. A frozen server keeps its liveliness token for a while, so one that has not told its load lately doesn't
//! count either.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use prost::Message;
use stereo_proto::v1;
use tokio::sync::{Notify, watch};
use tokio::time::MissedTickBehavior;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{ConsolidationMode, QueryTarget};
use zenoh::sample::{Locality, Sample, SampleKind};

use super::camera::Camera;
use super::{Context, Phase, keys, payload, queries};
use crate::streams::MOST_STREAMS;

/// Time between two tellings of the load.
const HEARTBEAT: Duration = Duration::from_millis(200);
/// A server that has not told its load for so long is frozen or cut off.
const SILENCE: Duration = Duration::from_secs(2);
/// How long a server that comes waits for what the others know.
const LEARN_WITHIN: Duration = Duration::from_secs(1);
/// Names of cameras and servers that are remembered at one time.
const MOST_NAMES: usize = 4096;

/// Who is there, as callbacks have heard it.
#[derive(Default)]
struct Roster {
    state: Mutex<RosterState>,
    changed: Notify,
}

#[derive(Default)]
struct RosterState {
    cameras: BTreeSet<String>,
    /// When each server was last heard.
    servers: HashMap<String, Instant>,
}

impl Roster {
    fn lock(&self) -> MutexGuard<'_, RosterState> {
        // Nothing that is called while it is held panics.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn camera(&self, sample: &Sample) {
        let Some(name) = keys::name(sample.key_expr().as_str()) else {
            return;
        };
        let mut state = self.lock();
        match sample.kind() {
            SampleKind::Put if state.cameras.len() < MOST_NAMES => state.cameras.insert(name.to_owned()),
            SampleKind::Put => false,
            SampleKind::Delete => state.cameras.remove(name),
        };
        drop(state);
        self.changed.notify_one();
    }

    fn server(&self, sample: &Sample) {
        let Some(name) = keys::name(sample.key_expr().as_str()) else {
            return;
        };
        let mut state = self.lock();
        match sample.kind() {
            SampleKind::Put if state.servers.len() < MOST_NAMES => {
                state.servers.insert(name.to_owned(), Instant::now());
            }
            SampleKind::Put => {}
            SampleKind::Delete => drop(state.servers.remove(name)),
        }
        drop(state);
        self.changed.notify_one();
    }

    /// This server was frozen itself: nobody else could be heard, and nobody is blamed for it.
    fn excuse_all(&self, now: Instant) {
        for last in self.lock().servers.values_mut() {
            *last = now;
        }
    }

    /// A server has told its load.
    fn heard(&self, sample: &Sample) {
        if let Some(name) = keys::name(sample.key_expr().as_str())
            && let Some(last) = self.lock().servers.get_mut(name)
        {
            *last = Instant::now();
        }
    }

    /// Whether `own` is the server of a camera.
    fn is_owner(&self, own: &str, camera: &str) -> bool {
        let state = self.lock();
        let others = state.live(own, Instant::now());
        owner(camera, &others) == Some(own)
    }
}

impl RosterState {
    /// The servers that count: this one, and those heard lately.
    fn live<'a>(&'a self, own: &'a str, now: Instant) -> BTreeSet<&'a str> {
        let heard = self
            .servers
            .iter()
            .filter(|(_, last)| now.saturating_duration_since(**last) < SILENCE)
            .map(|(name, _)| name.as_str());
        heard.chain([own]).collect()
    }
}

/// The server of a camera.
fn owner<'a>(camera: &str, servers: &BTreeSet<&'a str>) -> Option<&'a str> {
    servers
        .iter()
        .copied()
        .max_by_key(|server| (weight(camera, server), *server))
}

/// A hash that is the same in every build: FNV-1a, and a mixer so that short names spread.
fn weight(camera: &str, server: &str) -> u64 {
    let mut hash: u64 = 0xcbf2_9ce4_8422_2325;
    for byte in camera.bytes().chain([0]).chain(server.bytes()) {
        hash = (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
    }
    hash ^= hash >> 30;
    hash = hash.wrapping_mul(0xbf58_476d_1ce4_e5b9);
    hash ^= hash >> 27;
    hash = hash.wrapping_mul(0x94d0_49bb_1331_11eb);
    hash ^ (hash >> 31)
}

/// Takes part in the fleet until stopped: `configured` cameras are served whether or not they announce themselves.
pub(super) async fn serve(
    context: &Arc<Context>,
    configured: BTreeSet<String>,
    stopped: &mut watch::Receiver<bool>,
    phase: &watch::Sender<Phase>,
) -> zenoh::Result<()> {
    let mut until_stopped = stopped.clone();
    tokio::select! {
        ready = ready(context) => ready?,
        _ = until_stopped.wait_for(|&stop| stop) => return Ok(()),
    }
    let roster = Arc::new(Roster::default());
    roster.lock().cameras = configured.clone();
    let session = &context.session;
    let follow = |handle: fn(&Roster, &Sample)| {
        let roster = Arc::clone(&roster);
        move |sample: Sample| handle(&roster, &sample)
    };
    let (liveliness, own) = (session.liveliness(), context.instance.clone());
    let keep = configured.clone();
    let cameras = Arc::clone(&roster);
    let camera_subscriber = liveliness
        .declare_subscriber(keys::CAMERAS)
        .history(true)
        .callback(move |sample| {
            let is_configured =
                keys::name(sample.key_expr().as_str()).is_some_and(|name| keep.contains(name));
            if !is_configured {
                cameras.camera(&sample);
            }
        })
        .await?;
    let server_subscriber = liveliness
        .declare_subscriber(keys::SERVERS)
        .history(true)
        .callback(follow(Roster::server))
        .await?;
    let load_subscriber = session
        .declare_subscriber(keys::LOADS)
        .callback(follow(Roster::heard))
        .await?;
    let settings_subscriber = learn_settings(context).await?;
    let settings_queryable = {
        let (roster, own) = (Arc::clone(&roster), own.clone());
        queries::declare_settings(context, move |camera| roster.is_owner(&own, camera)).await?
    };
    let compute = queries::declare_compute(context).await?;
    // Last, so that whoever sees it gets answers.
    let token = liveliness.declare_token(keys::alive(&own)).await?;
    tracing::info!(instance = own, "serving over Zenoh");

    let mut served = BTreeMap::new();
    tokio::select! {
        ended = run(context, &roster, &mut served) => ended?,
        _ = stopped.wait_for(|&stop| stop) => {}
    }

    token.undeclare().await?;
    for queryable in compute {
        queryable.undeclare().await?;
    }
    settings_queryable.undeclare().await?;
    for subscriber in [
        load_subscriber,
        settings_subscriber,
        camera_subscriber,
        server_subscriber,
    ] {
        subscriber.undeclare().await?;
    }
    let stopping: Vec<_> = served.into_values().map(Camera::stop).collect();
    phase.send_replace(Phase::Withdrawn);
    futures_util::future::join_all(stopping).await;
    Ok(())
}

/// Waits until frames can be served and nobody else has this server's name.
async fn ready(context: &Arc<Context>) -> zenoh::Result<()> {
    context.service.primed().await;
    let key = keys::alive(&context.instance);
    loop {
        let others = context.session.liveliness().get(&key).await?;
        if others.recv_async().await.is_err() {
            break;
        }
        let why = format!(
            "another server is called {}: give one of them another name with --instance",
            context.instance
        );
        tracing::warn!(why, "waiting");
        context.streams.set_network(|network| network.why = Some(why));
        tokio::time::sleep(HEARTBEAT).await;
    }
    context.streams.set_network(|network| network.why = None);
    Ok(())
}

/// Knows what the other servers know about the settings of cameras.
async fn learn_settings(context: &Arc<Context>) -> zenoh::Result<zenoh::pubsub::Subscriber<()>> {
    let weak = Arc::downgrade(context);
    let learn = move |sample: &Sample| {
        if let (Some(context), Some(camera)) = (weak.upgrade(), keys::name(sample.key_expr().as_str()))
            && let Err(why) = context.settings.learn(camera, payload::bytes(sample.payload()))
        {
            tracing::warn!(camera, %why, "settings that another server announced can't be used");
        }
    };
    let announced = learn.clone();
    let subscriber = context
        .session
        .declare_subscriber(keys::SETTINGS)
        .callback(move |sample| announced(&sample))
        .await?;
    let known = context
        .session
        .get(keys::SETTINGS)
        .target(QueryTarget::All)
        .consolidation(ConsolidationMode::None)
        .allowed_destination(Locality::Remote)
        .timeout(LEARN_WITHIN);
    let replies = known.await?;
    while let Ok(reply) = replies.recv_async().await {
        if let Ok(sample) = reply.result() {
            learn(sample);
        }
    }
    Ok(subscriber)
}

/// Tells this server's load, and serves the cameras that are its.
async fn run(
    context: &Arc<Context>,
    roster: &Roster,
    served: &mut BTreeMap<String, Camera>,
) -> zenoh::Result<()> {
    let load = context
        .session
        .declare_publisher(keys::load(&context.instance))
        .encoding(payload::encoding("ServerLoad"))
        .congestion_control(CongestionControl::Drop)
        .priority(Priority::RealTime)
        .express(true)
        .await?;
    let mut heartbeat = tokio::time::interval(HEARTBEAT);
    heartbeat.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut awake_at = Instant::now();
    loop {
        tokio::select! {
            _ = heartbeat.tick() => load.put(own_load(context, served.len()).encode_to_vec()).await?,
            () = roster.changed.notified() => {}
        }
        let now = Instant::now();
        if now.saturating_duration_since(awake_at) > SILENCE / 2 {
            roster.excuse_all(now);
        }
        awake_at = now;
        let own_cameras: BTreeSet<String> = {
            let state = roster.lock();
            let servers = state.live(&context.instance, Instant::now());
            context.streams.set_network(|network| {
                if !network.servers.iter().eq(&servers) {
                    network.servers = servers.iter().map(|&name| name.to_owned()).collect();
                }
            });
            let is_own = |camera: &&String| owner(camera, &servers) == Some(&context.instance);
            state
                .cameras
                .iter()
                .filter(is_own)
                .take(MOST_STREAMS)
                .cloned()
                .collect()
        };
        served.retain(|_, camera| !camera.has_ended());
        for name in &own_cameras {
            if !served.contains_key(name)
                && let Some(camera) = Camera::start(context, name)
            {
                served.insert(name.clone(), camera);
            }
        }
        let gone: Vec<String> = served
            .keys()
            .filter(|name| !own_cameras.contains(*name))
            .cloned()
            .collect();
        for name in gone {
            if let Some(camera) = served.remove(&name) {
                context.spawn(camera.stop());
            }
        }
    }
}

fn own_load(context: &Context, cameras: usize) -> v1::ServerLoad {
    let snapshot = context.service.load();
    let small = |count: usize| u32::try_from(count).unwrap_or(u32::MAX);
    v1::ServerLoad {
        instance: context.instance.clone(),
        workers: small(context.service.workers()),
        busy_workers: small(snapshot.busy_workers),
        waiting: small(snapshot.waiting),
        backlog: snapshot.backlog.try_into().ok(),
        mandatory_load: snapshot.mandatory_load,
        full_load: snapshot.full_load,
        overload_rung: snapshot.level as u32,
        draining: context.service.is_draining(),
        cameras: small(cameras),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SERVERS: [&str; 4] = ["a", "b", "stereod-3", "robot_base.local"];

    #[test]
    fn cameras_spread_over_the_servers() {
        let servers: BTreeSet<&str> = SERVERS.into_iter().collect();
        let mut counts = BTreeMap::new();
        for camera in 0..4000 {
            *counts
                .entry(owner(&format!("cam{camera}"), &servers).unwrap())
                .or_insert(0) += 1;
        }
        assert!(
            counts.values().all(|count| (850..1150).contains(count)),
            "{counts:?}"
        );
    }

    #[test]
    fn only_the_cameras_of_a_server_that_goes_move() {
        let all: BTreeSet<&str> = SERVERS.into_iter().collect();
        let mut fewer = all.clone();
        fewer.remove("b");
        for camera in 0..1000 {
            let camera = format!("cam{camera}");
            let before = owner(&camera, &all).unwrap();
            let after = owner(&camera, &fewer).unwrap();
            assert!(
                before == after || before == "b",
                "{camera} moved from {before} to {after}"
            );
        }
    }

    #[test]
    fn the_hash_is_the_same_in_every_build() {
        assert_eq!(weight("front", "stereod"), 0xb0f3_82ac_00af_6b41);
        assert_ne!(weight("ab", "c"), weight("a", "bc"));
    }

    #[test]
    fn a_silent_server_does_not_count_and_this_one_always_does() {
        let now = Instant::now();
        let mut state = RosterState::default();
        state.servers.insert("fresh".to_owned(), now);
        state.servers.insert("frozen".to_owned(), now);
        let later = now + SILENCE;
        assert_eq!(state.live("own", now).len(), 3);
        state.servers.insert("fresh".to_owned(), later);
        assert_eq!(
            state.live("own", later).into_iter().collect::<Vec<_>>(),
            ["fresh", "own"]
        );
        assert_eq!(owner("any", &BTreeSet::new()), None);
    }
}
