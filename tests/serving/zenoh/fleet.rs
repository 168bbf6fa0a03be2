//! Many servers that share the cameras.

use std::collections::{BTreeMap, BTreeSet};

use stereo_proto::v1;
use stereo_tests::zenoh::{Router, client};
use zenoh::Session;

use super::network::{Camera, numbered, poll, serve, until_alive};
use super::settings;
use crate::conversation::{Server, message};

const SERVERS: [&str; 3] = ["one", "two", "three"];
const CAMERAS: [&str; 6] = ["a", "b", "c", "d", "e", "f"];

struct Fleet {
    router: Router,
    servers: BTreeMap<&'static str, Server>,
    session: Session,
    cameras: Vec<Camera>,
}

impl Fleet {
    async fn start() -> Self {
        let router = Router::start().await.expect("a router on a free port");
        let servers = SERVERS.map(|name| (name, serve(&router, name, &[])));
        let session = client(router.endpoint())
            .await
            .expect("a connection to the router");
        for server in SERVERS {
            until_alive(&session, &format!("stereo/v1/alive/{server}")).await;
        }
        let mut cameras = Vec::new();
        for camera in CAMERAS {
            cameras.push(Camera::start(&session, camera).await);
        }
        Self {
            router,
            servers: servers.into(),
            session,
            cameras,
        }
    }

    /// Waits until each camera is served by exactly one of `servers`; by which.
    async fn owners(&self, servers: &BTreeSet<&str>) -> BTreeMap<String, String> {
        let mut last = BTreeSet::new();
        let settled = poll(async || {
            last = self.tokens().await;
            let owners: BTreeMap<String, String> = last.iter().cloned().collect();
            let is_settled = last.len() == CAMERAS.len()
                && owners.len() == CAMERAS.len()
                && owners.values().all(|server| servers.contains(server.as_str()));
            is_settled.then_some(owners)
        })
        .await;
        let Some(settled) = settled else {
            panic!(
                "{servers:?} don't share the cameras: {last:?}; {}",
                self.views().await
            );
        };
        settled
    }

    /// The cameras that are served, and by which servers, as the router knows it.
    async fn tokens(&self) -> BTreeSet<(String, String)> {
        let tokens = self
            .session
            .liveliness()
            .get("stereo/v1/owner/*/*")
            .await
            .expect("an open session");
        let mut owners = BTreeSet::new();
        while let Ok(token) = tokens.recv_async().await {
            let token = token.into_result().expect("a token");
            let mut parts = token.key_expr().as_str().rsplit('/');
            let server = parts.next().expect("a name").to_owned();
            let camera = parts.next().expect("a name").to_owned();
            owners.insert((camera, server));
        }
        owners
    }

    /// Which servers each server knows of.
    async fn views(&self) -> String {
        let mut views = String::new();
        for (name, server) in &self.servers {
            let streams = server.get("/v1/streams").await.json();
            views += &format!("{name} knows {}; ", streams["zenoh"]["servers"]);
        }
        views
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn each_camera_is_served_by_one_server_and_by_another_when_that_is_killed() {
    let mut fleet = Fleet::start().await;
    let all: BTreeSet<&str> = SERVERS.into();
    let before = fleet.owners(&all).await;
    let settings = v1::CameraSettings {
        options: Some(v1::Options {
            max_iterations: Some(1),
            ..message().options.expect("test options")
        }),
        ..v1::CameraSettings::default()
    };
    settings::set(&fleet.session, "a", &settings)
        .await
        .expect("good settings");
    for (camera, name) in fleet.cameras.iter().zip(CAMERAS) {
        camera.put(&numbered(1)).await;
        let report = camera.result().await.report.expect("always present");
        assert_eq!(report.instance, before[name]);
    }
    let victim = before["a"].clone();
    fleet.servers.remove(victim.as_str()).expect("a running server");
    let rest: BTreeSet<&str> = all.into_iter().filter(|&server| server != victim).collect();
    let after = fleet.owners(&rest).await;
    for (camera, owner) in &before {
        assert!(
            *owner == victim || after[camera] == *owner,
            "{camera} moved without need"
        );
    }
    for (camera, name) in fleet.cameras.iter().zip(CAMERAS) {
        camera
            .put(&v1::StereoRequest {
                options: if name == "a" { None } else { numbered(2).options },
                ..numbered(2)
            })
            .await;
        let report = camera.result().await.report.expect("always present");
        assert_eq!(report.instance, after[name]);
        if name == "a" {
            assert_eq!(report.iterations_asked, 1, "the settings went with the camera");
        }
    }
    assert!(!fleet.router.endpoint().is_empty());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_frozen_server_loses_its_cameras_and_gets_them_back() {
    let mut fleet = Fleet::start().await;
    let all: BTreeSet<&str> = SERVERS.into();
    let before = fleet.owners(&all).await;
    let frozen = before["a"].clone();
    let server = fleet.servers.get_mut(frozen.as_str()).expect("a running server");
    server.process.signal("STOP").expect("a running server");
    let rest: BTreeSet<&str> = all.iter().copied().filter(|&server| server != frozen).collect();
    let meanwhile = fleet.owners(&rest).await;
    assert_ne!(meanwhile["a"], frozen);
    let server = fleet.servers.get_mut(frozen.as_str()).expect("a running server");
    server.process.signal("CONT").expect("a running server");
    let after = poll(async || (fleet.owners(&all).await == before).then_some(())).await;
    assert!(after.is_some(), "the cameras don't come back to {frozen}");
}

#[tokio::test(flavor = "multi_thread")]
async fn two_servers_of_one_name_do_not_serve_side_by_side() {
    let router = Router::start().await.expect("a router on a free port");
    let _first = serve(&router, "twin", &[]);
    let session = client(router.endpoint())
        .await
        .expect("a connection to the router");
    until_alive(&session, "stereo/v1/alive/twin").await;
    let second = serve(&router, "twin", &["--require-zenoh"]);
    let mut network = serde_json::Value::Null;
    let told = poll(async || {
        network = second.get("/readyz").await.json()["zenoh"].clone();
        let why = network["why"].as_str()?;
        why.contains("--instance").then_some(())
    });
    assert!(told.await.is_some(), "{network}");
}
