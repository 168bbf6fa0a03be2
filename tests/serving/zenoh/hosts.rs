//! Several hosts: a router, two servers, three cameras and a viewer, each behind a link of its own that can be cut, slowed down and healed.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::time::Duration;

use prost::Message;
use serde_json::json;
use stereo_proto::v1;
use stereo_tests::network::{self, Lab, ROUTER, Relay};
use stereo_tests::process::{Launch, Stereod};
use stereo_tests::zenoh::{RouterProcess, client_with};
use zenoh::Session;
use zenoh::handlers::FifoChannelHandler;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;
use zenoh::sample::Sample;

use super::network::{REQUEST, numbered, poll};

const CAMERAS: [&str; 3] = ["cam-a", "cam-b", "cam-c"];
const SERVERS: [&str; 2] = ["one", "two"];
/// How far away a host is at its farthest.
const FAR: Duration = Duration::from_millis(100);
/// Time between two frames of a camera.
const PERIOD: Duration = Duration::from_millis(50);

/// What a narrow link carries, a fraction of the results.
const NARROW: &str = "4mbit";
/// Frames of each camera while a link is narrow.
const FRAMES: usize = 60;

#[test]
fn cameras_on_other_hosts_are_served_again_after_links_were_cut_slow_and_healed() {
    if let Err(why) = network::is_possible() {
        println!(
            "skipped: no network namespaces can be made here ({why}): this takes root, or user namespaces, and iproute2"
        );
        return;
    }
    let program = std::env::current_exe().expect("a test program");
    let status = network::inside(program)
        .args(["--ignored", "--exact", "zenoh::hosts::inside", "--nocapture"])
        .status()
        .expect("unshare, which has just worked");
    assert!(status.success(), "{status}");
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "runs in namespaces that the test above makes"]
async fn inside() {
    if network::is_elsewhere() {
        println!("skipped: this is the inner half of a test, which starts it by itself");
        return;
    }
    let mut fleet = Fleet::start().await;
    fleet.all_are_served(&SERVERS, "at the start").await;

    fleet.lab.cut("one").expect("a link");
    fleet.all_are_served(&["two"], "with one server cut off").await;
    fleet.lab.heal("one").expect("a link");
    fleet.lab.cut("two").expect("a link");
    fleet.all_are_served(&["one"], "with the other one cut off").await;
    fleet.lab.heal("two").expect("a link");

    fleet.lab.cut("cam-a").expect("a link");
    fleet.lab.cut("viewer").expect("a link");
    fleet.lost("cam-a").await;
    fleet.lab.heal("cam-a").expect("a link");
    fleet.lab.heal("viewer").expect("a link");
    fleet
        .all_are_served(&SERVERS, "after a camera and the viewer were cut off")
        .await;

    fleet.relay.set_delay(FAR);
    fleet.all_are_served(&SERVERS, "with a camera far away").await;
    fleet.relay.set_delay(Duration::ZERO);

    fleet.lab.narrow("viewer", NARROW).expect("a link");
    fleet.nobody_waits_for_the_viewer().await;
    fleet.lab.widen("viewer").expect("a link");
    fleet.all_are_served(&SERVERS, "after a narrow link").await;

    for host in CAMERAS.iter().chain(&SERVERS).chain(&["viewer"]) {
        fleet.lab.cut(host).expect("a link");
    }
    fleet.lost("cam-b").await;
    for host in CAMERAS.iter().chain(&SERVERS).chain(&["viewer"]) {
        fleet.lab.heal(host).expect("a link");
    }
    fleet
        .all_are_served(&SERVERS, "after everybody was cut off")
        .await;
}

/// Everything, and who is where.
struct Fleet {
    lab: Lab,
    relay: Relay,
    _router: RouterProcess,
    _servers: Vec<Stereod>,
    cameras: Vec<Camera>,
    viewer: Viewer,
    /// Another viewer, whose link is always good.
    desk: Viewer,
}

struct Viewer {
    results: Subscriber<FifoChannelHandler<Sample>>,
    _session: Session,
}

struct Camera {
    name: &'static str,
    session: Session,
    _token: LivelinessToken,
    sequence: u64,
}

impl Fleet {
    async fn start() -> Self {
        let mut lab = Lab::new().expect("namespaces");
        for host in CAMERAS.into_iter().chain(["viewer", "desk"]) {
            lab.link(host, None).expect("a host");
        }
        for host in SERVERS {
            lab.link(host, Some(host)).expect("a host");
        }
        let router = RouterProcess::start("tcp/0.0.0.0:7447", Some(ROUTER)).expect("a router on its host");
        let file = std::env::temp_dir().join(format!("stereod-hosts-{}.json5", std::process::id()));
        std::fs::write(&file, config().to_string()).expect("a writable folder");
        let servers = SERVERS.map(|host| {
            let endpoint = format!("tcp/{}:7447", lab.router_of(host).expect("a link"));
            let file = file.to_str().expect("ASCII");
            let args = [
                ["--workers", "1"],
                ["--instance", host],
                ["--zenoh-config", file],
                ["--zenoh-connect", &endpoint],
            ]
            .concat();
            Stereod::launch(&Launch {
                host: Some(host),
                args: &args,
                ..Launch::default()
            })
            .expect("a server on its host")
        });
        std::fs::remove_file(&file).expect("the test's own file");
        let relay = Relay::start(address(&lab.router_of("cam-b").expect("a link")))
            .await
            .expect("a free port");
        let mut cameras = Vec::new();
        for name in CAMERAS {
            let endpoint = match name {
                "cam-b" => relay.address().to_string(),
                _ => format!("{}:7447", lab.router_of(name).expect("a link")),
            };
            cameras.push(Camera::start(name, &endpoint).await);
        }
        let viewer = Viewer::start(&lab, "viewer").await;
        let desk = Viewer::start(&lab, "desk").await;
        Self {
            lab,
            relay,
            _router: router,
            _servers: servers.into(),
            cameras,
            viewer,
            desk,
        }
    }

    /// Waits until the viewer has seen a new frame of every camera, matched by one of `servers`.
    async fn all_are_served(&mut self, servers: &[&str], when: &str) {
        let from: BTreeMap<&str, u64> = self
            .cameras
            .iter()
            .map(|camera| (camera.name, camera.sequence))
            .collect();
        let mut seen = BTreeMap::new();
        let served = poll(async || {
            for camera in &mut self.cameras {
                camera.put().await;
            }
            tokio::time::sleep(PERIOD).await;
            while let Some(result) = self.viewer.result() {
                let instance = result.report.expect("always present").instance;
                let is_new = result.sequence > from.get(result.camera_id.as_str()).copied();
                if is_new && servers.contains(&instance.as_str()) {
                    seen.insert(result.camera_id, instance);
                }
            }
            (seen.len() == CAMERAS.len()).then_some(())
        });
        assert!(
            served.await.is_some(),
            "{when}: only {seen:?} of {servers:?} are served"
        );
    }

    /// Waits until the desk has the last of many frames, while the viewer gets fewer results, whole ones and none twice.
    async fn nobody_waits_for_the_viewer(&mut self) {
        while self.viewer.result().is_some() || self.desk.result().is_some() {}
        let (mut at_viewer, mut at_desk) = (Vec::new(), Vec::new());
        for _ in 0..FRAMES {
            for camera in &mut self.cameras {
                camera.put().await;
            }
            tokio::time::sleep(PERIOD).await;
        }
        let served = poll(async || {
            // The last frame may be one that is lost: another follows.
            for camera in &mut self.cameras {
                camera.put().await;
            }
            tokio::time::sleep(PERIOD).await;
            at_desk.extend(std::iter::from_fn(|| self.desk.result()));
            at_viewer.extend(std::iter::from_fn(|| self.viewer.result()));
            let has_new = |camera: &&Camera| {
                let new = camera.sequence.saturating_sub(5);
                at_desk
                    .iter()
                    .any(|result| result.camera_id == camera.name && result.sequence >= Some(new))
            };
            (self.cameras.iter().filter(has_new).count() == CAMERAS.len() && !at_viewer.is_empty())
                .then_some(())
        });
        assert!(
            served.await.is_some(),
            "beside a narrow link {} results come",
            at_desk.len()
        );
        assert!(
            at_viewer.len() < at_desk.len(),
            "{} of {} results fit through a narrow link",
            at_viewer.len(),
            at_desk.len()
        );
        for name in CAMERAS {
            let of_camera = at_viewer.iter().filter(|result| result.camera_id == name);
            let sequences: Vec<_> = of_camera.map(|result| result.sequence).collect();
            assert!(
                sequences.is_sorted_by(|before, after| before < after),
                "{sequences:?}"
            );
        }
    }

    /// Waits until a camera's own session knows that nobody takes its frames any more.
    async fn lost(&mut self, name: &str) {
        let camera = self.cameras.iter().find(|camera| camera.name == name);
        let session = &camera.expect("a camera of this test").session;
        let alone = poll(async || session.info().routers_zid().await.next().is_none().then_some(()));
        assert!(alone.await.is_some(), "{name} doesn't notice that it is cut off");
    }
}

impl Viewer {
    async fn start(lab: &Lab, name: &str) -> Self {
        let session = session(&format!("{}:7447", lab.router_of(name).expect("a link"))).await;
        let results = session
            .declare_subscriber("stereo/v1/results/*")
            .await
            .expect("an open session");
        Self {
            results,
            _session: session,
        }
    }

    /// The next result, if there is one now.
    fn result(&self) -> Option<v1::StereoResult> {
        let sample = self.results.try_recv().ok()??;
        Some(v1::StereoResult::decode(&*sample.payload().to_bytes()).expect("a result"))
    }
}

impl Camera {
    async fn start(name: &'static str, endpoint: &str) -> Self {
        let session = session(endpoint).await;
        let token = session
            .liveliness()
            .declare_token(format!("stereo/v1/camera/{name}"))
            .await
            .expect("an open session");
        Self {
            name,
            session,
            _token: token,
            sequence: 0,
        }
    }

    /// Sends a frame, which is lost if it can't be sent now.
    async fn put(&mut self) {
        self.sequence += 1;
        self.session
            .put(
                format!("stereo/v1/frames/{}", self.name),
                numbered(self.sequence).encode_to_vec(),
            )
            .encoding(REQUEST)
            .await
            .expect("an open session");
    }
}

/// Where the router listens, seen from a host.
fn address(host: &str) -> SocketAddr {
    format!("{host}:7447").parse().expect("an address")
}

/// What all of them are: clients of a router that is tried again and again. Hosts share no memory, though these would.
fn config() -> serde_json::Value {
    json!({
        "mode": "client",
        "connect": {
            "timeout_ms": -1,
            "exit_on_failure": false,
            "retry": { "period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 2 },
        },
        "transport": {
            "link": { "tx": { "lease": 1500 } },
            "shared_memory": { "enabled": false },
        },
    })
}

async fn session(endpoint: &str) -> Session {
    let mut config = config();
    config["connect"]["endpoints"] = json!([format!("tcp/{endpoint}")]);
    client_with(endpoint, config).await.expect("a session")
}
