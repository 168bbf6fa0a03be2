//! Traces of the real binary, as a collector of OpenTelemetry gets them.
#![expect(
    clippy::panic,
    reason = "a panic is how a test fails, in its helper functions too"
)]

#[path = "traces/collector.rs"]
mod collector;

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Output, Stdio};

use prost::Message;
use stereo_proto::v1;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

use self::collector::{Collector, Span, Value};

const TRACE: &str = "4bf92f3577b34da6a3ce929d0e0e4736";
const PARENT: &str = "00f067aa0ba902b7";

/// A server that sends its traces.
struct Server {
    child: Child,
    address: String,
}

impl Server {
    fn start(collector: &str) -> Self {
        let mut child = stereod(&["--otlp", collector])
            .stdout(Stdio::piped())
            .spawn()
            .expect("a program that starts");
        let mut line = String::new();
        let stdout = child.stdout.take().expect("it is piped");
        BufReader::new(stdout).read_line(&mut line).expect("a line");
        let (_, address) = line.trim().split_once("http://").expect("its address");
        Self {
            child,
            address: address.to_owned(),
        }
    }

    /// Sends a frame as part of a client's trace; the first line of the answer.
    async fn frame(&self) -> String {
        let body = frame().encode_to_vec();
        let head = format!(
            "POST /v1/stereo HTTP/1.1\r\nHost: x\r\nConnection: close\r\nContent-Type: application/x-protobuf\r\n\
             traceparent: 00-{TRACE}-{PARENT}-01\r\nContent-Length: {}\r\n\r\n",
            body.len()
        );
        let mut stream = TcpStream::connect(&self.address).await.expect("a server");
        stream
            .write_all(&[head.as_bytes(), &body].concat())
            .await
            .expect("room");
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).await.expect("an answer");
        let line = answer.split(|&byte| byte == b'\r').next().unwrap_or_default();
        String::from_utf8_lossy(line).into_owned()
    }

    /// SIGTERM: the last traces are delivered before it ends.
    async fn stop(mut self) {
        let id = self.child.id().to_string();
        let sent = Command::new("sh").args(["-c", "kill -TERM \"$0\"", &id]).status();
        assert!(sent.expect("a shell").success());
        let status = tokio::task::spawn_blocking(move || self.child.wait()).await;
        assert_eq!(status.expect("no panic").expect("a child").code(), Some(0));
    }
}

fn stereod(args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_stereod"));
    command
        .args([
            "serve",
            "--http",
            "127.0.0.1:0",
            "--workers",
            "1",
            "--no-zenoh",
            "--log",
            "error",
        ])
        .args(args)
        .stdin(Stdio::null());
    command
}

/// A pair with something to see in it.
fn frame() -> v1::StereoRequest {
    let (width, height) = (128_u32, 96_u32);
    let image = |shift: u32| v1::Image {
        width,
        height,
        encoding: v1::ImageEncoding::Mono8.into(),
        data: (0..width * height)
            .map(|at| {
                let (x, y) = (at % width + shift, at / width);
                (x * 37 + x * y * 11 + y * 53).to_le_bytes()[0]
            })
            .collect::<Vec<u8>>()
            .into(),
        ..v1::Image::default()
    };
    v1::StereoRequest {
        request_id: "frame-7".to_owned(),
        camera_id: "front".to_owned(),
        left: Some(image(0)),
        right: Some(image(5)),
        options: Some(v1::Options {
            latency_budget: Some(prost_types::Duration {
                seconds: 60,
                nanos: 0,
            }),
            ..v1::Options::default()
        }),
        ..v1::StereoRequest::default()
    }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_frame_is_a_span_of_its_clients_trace_with_its_stages_in_it() {
    let mut collector = Collector::start().await;
    let server = Server::start(collector.url());
    assert_eq!(server.frame().await, "HTTP/1.1 200 OK");
    server.stop().await;

    let (program, spans) = collector.sent();
    let of_trace: Vec<&Span> = spans.iter().filter(|span| hex(&span.trace_id) == TRACE).collect();
    let named = |name: &str| {
        let mut found = of_trace.iter().filter(|span| span.name == name);
        let first = found
            .next()
            .unwrap_or_else(|| panic!("no span {name} in {of_trace:?}"));
        assert!(found.next().is_none(), "two spans {name}");
        *first
    };
    let (http, frame) = (named("http"), named("frame"));
    assert_eq!(hex(&http.parent_span_id), PARENT);
    assert_eq!(frame.parent_span_id, http.span_id);
    let text = |value: &str| Some(Value::String(value.to_owned()));
    assert_eq!(frame.attribute("request_id"), text("frame-7"));
    assert_eq!(frame.attribute("camera"), text("front"));
    let slack = frame.attribute("slack_ms");
    assert!(
        matches!(slack, Some(Value::Double(ms)) if (0.0..60_000.0).contains(&ms)),
        "{slack:?}"
    );
    let mut end = frame.start_time_unix_nano;
    for name in ["queue", "match", "mesh", "encode"] {
        let stage = named(name);
        assert_eq!(stage.parent_span_id, frame.span_id, "{name}");
        assert!(stage.start_time_unix_nano <= stage.end_time_unix_nano, "{name}");
        assert!(
            end <= stage.end_time_unix_nano,
            "{name} ends before the stage before it"
        );
        end = stage.end_time_unix_nano;
    }
    assert_eq!(program, Some("stereod".to_owned()));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_collector_that_is_not_there_costs_no_frame_and_no_stop() {
    // Taken and given back: nobody listens there.
    let free = std::net::TcpListener::bind("127.0.0.1:0").expect("a free port");
    let absent = format!("http://{}", free.local_addr().expect("it is bound"));
    drop(free);
    let server = Server::start(&absent);
    for _ in 0..20 {
        assert_eq!(server.frame().await, "HTTP/1.1 200 OK");
    }
    server.stop().await;
}

#[test]
fn a_collector_that_can_not_be_one_is_refused() {
    for bad in ["localhost:4317", "https://collector:4318", "grpc://x:1"] {
        let Output { status, stderr, .. } = stereod(&["--otlp", bad]).output().expect("a program");
        let why = String::from_utf8_lossy(&stderr);
        assert_eq!(status.code(), Some(64), "{why}");
        assert!(why.contains("--otlp") && why.contains(bad), "{why}");
    }
}
