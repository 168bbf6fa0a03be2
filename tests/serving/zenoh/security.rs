//! The example for a fleet, `docker/zenoh-router.json5`, does what it says.

use std::path::Path;

use prost::Message;
use rcgen::{BasicConstraints, CertificateParams, CertifiedIssuer, IsCa, KeyPair};
use serde_json::{Value, json};
use stereo_tests::zenoh::{Router, client, client_with};
use zenoh::Session;
use zenoh::sample::Locality;

use super::network::{Camera, numbered};
use crate::conversation::{PROTOBUF, Server, message};
use crate::doors::{ConfigFile, token};

const EXAMPLE: &str = include_str!("../../../docker/zenoh-router.json5");

/// The example's router with a user file and certificates of the test's, a server and robots.
struct Fleet {
    router: Router,
    server: Server,
    folder: std::path::PathBuf,
}

impl Fleet {
    async fn start(name: &str) -> Self {
        Self::start_with(name, &[]).await
    }

    /// With more arguments of the server.
    async fn start_with(name: &str, more: &[&str]) -> Self {
        let folder = std::env::temp_dir().join(format!("stereod-fleet-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("a writable folder");
        let users = folder.join("users.txt");
        std::fs::write(&users, "router:r\nstereod:s\nrobot-1:one\nrobot-2:two\n").expect("a writable folder");
        let mut example: Value = json5::from_str(EXAMPLE).expect("JSON5");
        let tls = &mut example["transport"]["link"]["tls"];
        for (part, file) in [
            ("listen_certificate", "router.pem"),
            ("listen_private_key", "router-key.pem"),
        ] {
            assert_eq!(tls[part], file, "the example has another {part}");
            tls[part] = json!(folder.join(file));
        }
        certify(&folder);
        example["transport"]["auth"]["usrpwd"] = json!({
            "user": "router",
            "password": "r",
            "dictionary_file": users,
        });
        let listens = example["listen"]["endpoints"][0].as_str().expect("an endpoint");
        assert!(
            listens.starts_with("tls/"),
            "passwords would be sent in the clear"
        );
        example.as_object_mut().expect("an object").remove("listen");
        let router = Router::start_with("tls/127.0.0.1:0", example)
            .await
            .expect("an example that works");
        let file = folder.join("server.json5");
        let own = json!({
            "mode": "client",
            "transport": {
                "link": { "tls": { "root_ca_certificate": folder.join("authority.pem") } },
                "auth": { "usrpwd": { "user": "stereod", "password": "s" } },
            },
        });
        std::fs::write(&file, own.to_string()).expect("a writable folder");
        let own = [
            "--zenoh-config",
            file.to_str().expect("ASCII"),
            "--zenoh-connect",
            router.endpoint(),
            "--require-zenoh",
        ];
        let server = Server::start(&[&own, more].concat());
        server.until_ready().await;
        Self {
            router,
            server,
            folder,
        }
    }

    async fn user(&self, user: &str, password: &str) -> anyhow::Result<Session> {
        self.user_who_trusts("authority.pem", user, password).await
    }

    async fn user_who_trusts(&self, authority: &str, user: &str, password: &str) -> anyhow::Result<Session> {
        let transport = json!({
            "link": { "tls": { "root_ca_certificate": self.folder.join(authority) } },
            "auth": { "usrpwd": { "user": user, "password": password } },
        });
        client_with(self.router.endpoint(), json!({ "transport": transport })).await
    }
}

/// An authority, a certificate of the router by it, and another authority that has nothing to do with them.
fn certify(folder: &Path) {
    let authority = || {
        let mut params = CertificateParams::new([]).expect("no names");
        params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        let key = KeyPair::generate().expect("a key");
        CertifiedIssuer::self_signed(params, key).expect("a certificate")
    };
    let (trusted, stranger) = (authority(), authority());
    let key = KeyPair::generate().expect("a key");
    let router = CertificateParams::new(["127.0.0.1".to_owned()])
        .and_then(|params| params.signed_by(&key, &trusted))
        .expect("a certificate");
    for (name, text) in [
        ("authority.pem", trusted.pem()),
        ("stranger.pem", stranger.pem()),
        ("router.pem", router.pem()),
        ("router-key.pem", key.serialize_pem()),
    ] {
        std::fs::write(folder.join(name), text).expect("a writable folder");
    }
}

impl Drop for Fleet {
    fn drop(&mut self) {
        drop(std::fs::remove_dir_all(&self.folder));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_sends_and_reads_its_own_and_nothing_else() {
    let fleet = Fleet::start("own").await;
    let robot = fleet.user("robot-1", "one").await.expect("a known user");
    let spy = fleet.user("robot-2", "two").await.expect("a known user");
    let overheard = spy
        .declare_subscriber("stereo/v1/**")
        .await
        .expect("an open session");
    // A robot for which the example has no rules: it may do nothing.
    spy.put("stereo/v1/frames/robot-1", vec![0; 10])
        .allowed_destination(Locality::Remote)
        .await
        .expect("an open session");
    let camera = Camera::start(&robot, "robot-1").await;
    robot
        .put("stereo/v1/frames/robot-2", vec![0; 10])
        .await
        .expect("an open session");
    for sequence in 1..=3 {
        camera.put(&numbered(sequence)).await;
        assert_eq!(camera.result().await.sequence, Some(sequence));
    }
    let streams = fleet.server.get("/v1/streams").await.json();
    assert_eq!(streams["streams"].as_array().map(Vec::len), Some(1));
    assert_eq!(streams["streams"][0]["frames"]["received"], 3);
    assert!(overheard.try_recv().is_ok_and(|sample| sample.is_none()));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_has_the_same_name_and_the_same_camera_over_http() {
    let (one, section) = token("robot-1");
    let (two, other) = token("robot-2");
    let config = ConfigFile::new(
        "names",
        &format!("{section}cameras = [\"robot-1\"]\n{other}cameras = [\"robot-2\"]\n"),
    );
    let fleet = Fleet::start_with("names", &["--config", config.path()]).await;
    let robot = fleet.user("robot-1", "one").await.expect("a known user");
    let camera = Camera::start(&robot, "robot-1").await;
    for sequence in 1..=3 {
        camera.put(&numbered(sequence)).await;
        assert_eq!(camera.result().await.sequence, Some(sequence));
    }
    let http = stereo_tests::http::builder()
        .no_proxy()
        .build()
        .expect("a client");
    let url = format!("{}/v1/streams/robot-1", fleet.server.process.url());
    for (token, status) in [(&one, 200), (&two, 403)] {
        let answer = http.get(&url).bearer_auth(token).send().await.expect("an answer");
        assert_eq!(answer.status(), status);
    }
    let url = format!("{}/v1/stereo", fleet.server.process.url());
    for (camera, status) in [("robot-1", 200), ("robot-2", 403)] {
        let request = stereo_proto::v1::StereoRequest {
            camera_id: camera.to_owned(),
            ..message()
        };
        let post = http
            .post(&url)
            .bearer_auth(&one)
            .header("content-type", PROTOBUF)
            .body(request.encode_to_vec());
        assert_eq!(post.send().await.expect("an answer").status(), status, "{camera}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_wrong_password_is_no_way_in() {
    let fleet = Fleet::start("password").await;
    assert!(fleet.user("robot-1", "two").await.is_err());
    assert!(fleet.user("nobody", "one").await.is_err());
    fleet.user("robot-1", "one").await.expect("the right password");
}

#[tokio::test(flavor = "multi_thread")]
async fn nobody_tells_a_password_to_a_router_whose_certificate_is_not_to_be_trusted() {
    let fleet = Fleet::start("certificate").await;
    let cheated = fleet.user_who_trusts("stranger.pem", "robot-1", "one").await;
    assert!(cheated.is_err());
    let plain = fleet.router.endpoint().replacen("tls/", "tcp/", 1);
    assert!(
        client(&plain).await.is_err(),
        "the router talks without encryption"
    );
}
