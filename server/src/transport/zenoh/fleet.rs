//! Who is there, and who serves which camera.
//!
//! Presence is Zenoh's liveliness; from what is heard of it, every server works out for itself which cameras are its (`roster`).

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::{Duration, Instant};

use prost::Message;
use stereo_proto::v1;
use tokio::sync::watch;
use tokio::time::MissedTickBehavior;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{ConsolidationMode, QueryTarget};
use zenoh::sample::{Locality, Sample};

use super::camera::Camera;
use super::roster::{Roster, SILENCE, owner};
use super::{Context, Phase, keys, payload, queries};
use crate::streams::MOST_STREAMS;

/// Time between two tellings of the load.
const HEARTBEAT: Duration = Duration::from_millis(200);
/// How long a server that comes waits for what the others know.
const LEARN_WITHIN: Duration = Duration::from_secs(1);
/// Time between two looks at all cameras that are there, in case word of one was lost.
const AUDIT: Duration = Duration::from_secs(2);

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
    let roster = Arc::new(Roster::new(configured));
    let session = &context.session;
    let follow = |handle: fn(&Roster, &Sample)| {
        let roster = Arc::clone(&roster);
        move |sample: Sample| handle(&roster, &sample)
    };
    let (liveliness, own) = (session.liveliness(), context.instance.clone());
    let camera_subscriber = liveliness
        .declare_subscriber(keys::CAMERAS)
        .history(true)
        .callback(follow(Roster::camera))
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
        () = audit(context, &roster) => {}
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

/// Asks the network now and then which cameras are there; without an answer, what was heard of them stays.
async fn audit(context: &Context, roster: &Roster) {
    let mut missing = BTreeSet::new();
    loop {
        tokio::time::sleep(AUDIT).await;
        let asked = context.session.liveliness().get(keys::CAMERAS).timeout(AUDIT);
        let tokens = match asked.await {
            Ok(tokens) => tokens,
            Err(why) => {
                tracing::warn!(%why, "the network can't be asked which cameras are there");
                continue;
            }
        };
        let mut present = BTreeSet::new();
        let mut is_whole = true;
        while let Ok(token) = tokens.recv_async().await {
            match token.result() {
                Ok(token) => present.extend(keys::name(token.key_expr().as_str()).map(str::to_owned)),
                Err(_) => is_whole = false,
            }
        }
        if is_whole {
            roster.correct(&present, &mut missing);
        }
    }
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
        let own_cameras = roster.with_live(&context.instance, now, |cameras, servers| {
            context.streams.set_network(|network| {
                if !network.servers.iter().eq(servers) {
                    network.servers = servers.iter().map(|&name| name.to_owned()).collect();
                }
            });
            let is_own = |camera: &&String| owner(camera, servers) == Some(&context.instance);
            let own = cameras.iter().filter(is_own).take(MOST_STREAMS);
            own.cloned().collect::<BTreeSet<String>>()
        });
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
