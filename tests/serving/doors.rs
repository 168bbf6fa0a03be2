//! Who may ask: tokens, cameras, quotas.

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};

use prost::Message;
use reqwest::{Client, Method, RequestBuilder};
use stereo_proto::v1;
use stereo_tests::process::{Stereod, binary, run};

use crate::conversation::{PROTOBUF, Reply, message};

/// Everything that works on frames, shows streams or tells about the server.
pub(crate) const GUARDED: [(&str, &str); 8] = [
    ("POST", "/v1/stereo"),
    ("POST", "/v1/stereo/batch"),
    ("GET", "/v1/streams"),
    ("GET", "/v1/streams/front"),
    ("GET", "/v1/streams/front/latest"),
    ("GET", "/v1/streams/front/events"),
    ("GET", "/v1/info"),
    ("GET", "/metrics"),
];

/// A new token, and the section of the configuration that it comes with.
pub(crate) fn token(name: &str) -> (String, String) {
    let printed = run(&["token", name]).expect("the binary");
    assert!(printed.status.success());
    let text = String::from_utf8(printed.stdout).expect("text");
    let token = text.lines().find(|line| line.starts_with("stereod_"));
    let section = text
        .find(&format!("[clients.{name}]"))
        .map(|at| text[at..].to_owned());
    (
        token.expect("a token").to_owned(),
        section.expect("a section of the file"),
    )
}

/// A configuration file that is gone when this is dropped.
pub(crate) struct ConfigFile(PathBuf);

impl ConfigFile {
    pub(crate) fn new(test: &str, text: &str) -> Self {
        let path = std::env::temp_dir().join(format!("stereod-{test}-{}.toml", std::process::id()));
        std::fs::write(&path, text).expect("a file");
        Self(path)
    }

    pub(crate) fn path(&self) -> &str {
        self.0.to_str().expect("a plain path")
    }
}

impl Drop for ConfigFile {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

fn start(test: &str, config: &str) -> Stereod {
    let file = ConfigFile::new(test, config);
    Stereod::start(&["--workers", "1", "--no-zenoh", "--config", file.path()]).expect("a server that starts")
}

fn http() -> Client {
    stereo_tests::http::builder()
        .no_proxy()
        .build()
        .expect("a client without any setting")
}

fn ask(server: &Stereod, method: &str, path: &str, token: Option<&str>) -> RequestBuilder {
    let method = Method::from_bytes(method.as_bytes()).expect("a method");
    let request = http().request(method, format!("{}{path}", server.url()));
    match token {
        Some(token) => request.bearer_auth(token),
        None => request,
    }
}

fn post(server: &Stereod, path: &str, token: &str, body: Vec<u8>) -> RequestBuilder {
    ask(server, "POST", path, Some(token))
        .header("content-type", PROTOBUF)
        .header("accept", "application/x-protobuf, application/problem+json;q=0.9")
        .body(body)
}

fn of_camera(camera: &str) -> v1::StereoRequest {
    v1::StereoRequest {
        camera_id: camera.to_owned(),
        ..message()
    }
}

#[tokio::test]
async fn only_who_shows_a_token_gets_at_frames_streams_and_numbers() {
    let (lab, section) = token("lab");
    let (other, _) = token("lab");
    let server = start("tokens", &section);
    for (method, path) in GUARDED {
        for (shown, challenge) in [
            (None, "Bearer realm=\"stereod\""),
            (
                Some(other.as_str()),
                "Bearer realm=\"stereod\", error=\"invalid_token\"",
            ),
        ] {
            let answer = ask(&server, method, path, shown).send().await.expect("an answer");
            assert_eq!(answer.status(), 401, "{method} {path}");
            assert_eq!(answer.headers()["www-authenticate"], challenge, "{method} {path}");
            let reply = Reply::of_response(answer).await;
            reply.assert_refused(401, &["stereod token"]);
            assert_eq!(reply.json()["reason"], "UNAUTHENTICATED");
        }
        let known = ask(&server, method, path, Some(&lab))
            .send()
            .await
            .expect("an answer");
        assert!(
            !matches!(known.status().as_u16(), 401 | 403),
            "{method} {path}: {}",
            known.status()
        );
    }
    for path in ["/livez", "/", "/openapi.json", "/docs/", "/v1/schema.binpb"] {
        let answer = ask(&server, "GET", path, None).send().await.expect("an answer");
        assert_eq!(answer.status(), 200, "{path}");
    }
    let readiness = ask(&server, "GET", "/readyz", None)
        .send()
        .await
        .expect("an answer");
    assert!(matches!(readiness.status().as_u16(), 200 | 503));
    let matched = Reply::of(post(&server, "/v1/stereo", &lab, message().encode_to_vec())).await;
    assert!(matched.result().disparity.is_some());
    let counted = Reply::of(ask(&server, "GET", "/metrics", Some(&lab))).await;
    let refused = "stereod_requests_total{class=\"unknown\",outcome=\"UNAUTHENTICATED\"} 16";
    let text = String::from_utf8(counted.body).expect("text");
    assert!(text.contains(refused), "{text}");
}

#[tokio::test]
async fn a_client_uses_its_own_cameras_alone() {
    let (robot, section) = token("robot");
    let server = start("cameras", &format!("{section}cameras = [\"front\", \"arm-*\"]\n"));
    for camera in ["front", "arm-left", ""] {
        let reply = Reply::of(post(
            &server,
            "/v1/stereo",
            &robot,
            of_camera(camera).encode_to_vec(),
        ))
        .await;
        assert_eq!(reply.status, 200, "{camera}: {}", reply.text());
    }
    let refused = post(&server, "/v1/stereo", &robot, of_camera("back").encode_to_vec());
    let status = v1::Status::decode(Reply::of(refused).await.body.as_slice()).expect("a status");
    assert_eq!((status.code, status.reason()), (403, v1::Reason::Forbidden));
    assert!(status.message.contains("robot") && status.message.contains("back"));
    for path in ["", "/latest", "/events"] {
        let path = format!("/v1/streams/back{path}");
        let reply = Reply::of(ask(&server, "GET", &path, Some(&robot))).await;
        reply.assert_refused(403, &["robot", "back"]);
        // Of one that it may use it learns that there is none.
        let own = path.replace("back", "front");
        assert_eq!(
            Reply::of(ask(&server, "GET", &own, Some(&robot))).await.status,
            404
        );
    }
    let mut batch = of_camera("back").encode_length_delimited_to_vec();
    batch.extend(of_camera("front").encode_length_delimited_to_vec());
    let replies = Reply::of(post(&server, "/v1/stereo/batch", &robot, batch)).await;
    let mut rest = replies.body.as_slice();
    let mut codes = Vec::new();
    while !rest.is_empty() {
        let reply = v1::BatchReply::decode_length_delimited(&mut rest).expect("a reply");
        codes.push(match reply.outcome.expect("always") {
            v1::batch_reply::Outcome::Status(status) => status.code,
            v1::batch_reply::Outcome::Result(_) => 200,
        });
    }
    codes.sort_unstable();
    assert_eq!(codes, [200, 403]);
}

#[tokio::test]
async fn a_client_over_its_rate_is_told_when_to_come_back_and_others_are_not() {
    let (slow, slow_section) = token("slow");
    let (free, free_section) = token("free");
    let config = format!("{slow_section}requests_per_second = 1\n{free_section}");
    let server = start("rate", &config);
    let mut refused = None;
    for _ in 0..100 {
        let answer = ask(&server, "GET", "/v1/info", Some(&slow))
            .send()
            .await
            .expect("an answer");
        if answer.status() == 429 {
            refused = Some(answer);
            break;
        }
        assert_eq!(answer.status(), 200);
    }
    let refused = refused.expect("a hundred requests take less than a hundred seconds");
    assert_eq!(refused.headers()["retry-after"], "1");
    let refused = Reply::of_response(refused).await;
    refused.assert_refused(429, &["slow", "1 requests a second"]);
    assert_eq!(refused.json()["reason"], "QUOTA");
    for _ in 0..20 {
        let answer = ask(&server, "GET", "/v1/info", Some(&free))
            .send()
            .await
            .expect("an answer");
        assert_eq!(answer.status(), 200);
    }
    // The requests of a batch wait for their turn instead.
    let batch = message().encode_length_delimited_to_vec().repeat(2);
    let answer = async {
        loop {
            let reply = Reply::of(post(&server, "/v1/stereo/batch", &slow, batch.clone())).await;
            if reply.status != 429 {
                return reply;
            }
        }
    };
    let reply = answer.await;
    assert_eq!(reply.status, 200, "{}", reply.text());
}

#[tokio::test]
async fn a_client_over_its_bytes_leaves_the_others_theirs() {
    let (small, small_section) = token("small");
    let (free, free_section) = token("free");
    let config = format!("{small_section}bytes_in_flight = 65536\n{free_section}");
    let server = start("bytes", &config);
    // Two images of 164 kB.
    let body = message().encode_to_vec();
    let refused =
        post(&server, "/v1/stereo", &small, body.clone()).header("accept", "application/problem+json");
    let refused = refused.send().await.expect("an answer");
    assert_eq!(
        (refused.status().as_u16(), &refused.headers()["retry-after"]),
        (429, &"1".parse().expect("text"))
    );
    let reply = Reply::of(post(&server, "/v1/stereo", &free, body)).await;
    assert_eq!(reply.status, 200, "{}", reply.text());
}

/// A server with its own say over where it listens and what it logs.
pub(crate) struct Logging {
    child: Child,
    pub(crate) url: String,
    log: PathBuf,
}

impl Logging {
    pub(crate) fn start(test: &str, args: &[&str]) -> Self {
        let log = std::env::temp_dir().join(format!("stereod-{test}-{}.log", std::process::id()));
        let mut child = Command::new(binary().expect("the binary"))
            .args(["serve", "--workers", "1", "--no-zenoh"])
            .args(args)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(File::create(&log).expect("a file"))
            .spawn()
            .expect("the binary");
        let mut line = String::new();
        let stdout = child.stdout.take().expect("it is piped");
        let mut stdout = BufReader::new(stdout);
        while !line.contains("listening on ") {
            line.clear();
            assert_ne!(
                stdout.read_line(&mut line).expect("a line"),
                0,
                "it ended before it listened"
            );
        }
        let url = line
            .split_once("listening on ")
            .expect("an address")
            .1
            .trim()
            .to_owned();
        Self { child, url, log }
    }

    /// Kills it; what it has logged until then.
    pub(crate) fn log(&mut self) -> String {
        self.child.kill().expect("it runs");
        self.child.wait().expect("it has ended");
        std::fs::read_to_string(&self.log).expect("its log")
    }
}

impl Drop for Logging {
    fn drop(&mut self) {
        drop(self.child.kill());
        drop(self.child.wait());
        drop(std::fs::remove_file(&self.log));
    }
}

#[tokio::test]
async fn tokens_are_in_no_log_and_names_are_in_the_access_records() {
    let (lab, section) = token("lab");
    let (unknown, _) = token("unknown");
    let file = ConfigFile::new("log", &section);
    let mut server = Logging::start(
        "log",
        &["--http", "127.0.0.1:0", "--log", "trace", "--config", file.path()],
    );
    let http1 = http();
    let http2 = stereo_tests::http::builder()
        .no_proxy()
        .http2_prior_knowledge()
        .build()
        .expect("a client");
    for client in [http1, http2] {
        for (token, status) in [(&lab, 200), (&unknown, 401)] {
            let request = client.get(format!("{}/v1/info", server.url)).bearer_auth(token);
            assert_eq!(request.send().await.expect("an answer").status(), status);
        }
        let request = client.get(format!("{}/v1/info", server.url));
        let twice = request
            .header("authorization", &lab)
            .header("authorization", &unknown);
        assert_eq!(twice.send().await.expect("an answer").status(), 401);
    }
    let log = server.log();
    assert!(log.contains("client=\"lab\""), "no access record:\n{log}");
    let hash = section.split('"').nth(1).expect("a hash");
    for secret in [lab.as_str(), &unknown, hash] {
        let secret = secret.trim_start_matches("stereod_");
        for part in [secret, &secret[..16]] {
            assert!(!log.contains(part), "a secret is in the log");
        }
    }
}

#[test]
fn a_server_that_is_open_to_all_says_so_loudly() {
    let (_, section) = token("lab");
    let file = ConfigFile::new("open", &section);
    let open = Logging::start("open", &["--http", "0.0.0.0:0", "--log", "warn"]).log();
    assert!(
        open.contains("anybody who reaches this address") && open.contains("stereod token"),
        "{open}"
    );
    let closed = Logging::start(
        "closed",
        &["--http", "0.0.0.0:0", "--log", "warn", "--config", file.path()],
    )
    .log();
    assert!(!closed.contains("anybody who reaches"), "{closed}");
    let own = Logging::start("own", &["--http", "127.0.0.1:0", "--log", "warn"]).log();
    assert!(!own.contains("anybody who reaches"), "{own}");
}

#[tokio::test]
async fn pages_of_other_origins_are_not_let_in() {
    let server = Stereod::start(&["--workers", "1", "--no-zenoh"]).expect("a server that starts");
    for (method, path) in GUARDED.into_iter().chain([("GET", "/"), ("GET", "/livez")]) {
        for method in [method, "OPTIONS"] {
            let request = ask(&server, method, path, None)
                .header("origin", "https://elsewhere.example")
                .header("access-control-request-method", "POST")
                .header("access-control-request-headers", "authorization,content-type");
            let answer = request.send().await.expect("an answer");
            let allowed: Vec<_> = answer
                .headers()
                .keys()
                .filter(|name| name.as_str().starts_with("access-control"))
                .collect();
            assert!(allowed.is_empty(), "{method} {path} allows {allowed:?}");
        }
    }
}
