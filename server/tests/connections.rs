//! The server on real sockets: what connections may do, and how the server ends.
#![expect(clippy::unwrap_used, reason = "a panic is how a test fails")]

use std::time::{Duration, Instant};

use stereod::config::Config;
use stereod::{Running, Server, StartError};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

fn config() -> Config {
    let mut config = Config::default();
    config.http.listen = "127.0.0.1:0".parse().unwrap();
    config.workers.count = 1;
    config.zenoh.enabled = false;
    config
}

async fn start(config: Config) -> Running {
    Server::start(config).await.unwrap()
}

async fn send(server: &Running, text: &str) -> TcpStream {
    let mut stream = TcpStream::connect(server.http_addr).await.unwrap();
    stream.write_all(text.as_bytes()).await.unwrap();
    stream
}

/// Everything the server sends until it closes the connection.
async fn rest(stream: &mut TcpStream) -> String {
    let mut bytes = Vec::new();
    stream.read_to_end(&mut bytes).await.unwrap();
    String::from_utf8_lossy(&bytes).into_owned()
}

#[tokio::test(flavor = "multi_thread")]
async fn an_address_in_use_is_an_error_that_names_it() {
    let first = start(config()).await;
    let mut second = config();
    second.http.listen = first.http_addr;
    let error = Server::start(second).await.err().unwrap();
    assert!(matches!(error, StartError::Listen { .. }));
    assert!(error.to_string().contains(&first.http_addr.to_string()));
    first.shutdown().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_bad_configuration_binds_nothing() {
    let mut bad = config();
    bad.workers.count = 0;
    assert!(matches!(Server::start(bad).await, Err(StartError::Config(_))));
}

#[tokio::test(flavor = "multi_thread")]
async fn silent_and_half_said_requests_are_closed_after_the_header_timeout() {
    let mut config = config();
    config.http.header_timeout = Duration::from_millis(50);
    config.http.body_timeout = Duration::from_millis(50);
    let server = start(config).await;
    for start in ["", "GET /livez HTTP/1.1\r\nHost:", "PRI * HTTP/2.0\r\n"] {
        let mut stream = send(&server, start).await;
        assert!(
            !rest(&mut stream).await.contains("200"),
            "{start:?} is no request"
        );
    }
    let mut kept = send(&server, "GET /livez HTTP/1.1\r\nHost: x\r\n\r\n").await;
    assert!(
        rest(&mut kept).await.starts_with("HTTP/1.1 200"),
        "answered, then closed for resting too long"
    );
    server.shutdown().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_body_that_stops_coming_is_answered_with_a_timeout() {
    let mut config = config();
    config.http.body_timeout = Duration::from_millis(50);
    let server = start(config).await;
    let head = "POST /v1/stereo HTTP/1.1\r\nHost: x\r\nContent-Type: application/x-protobuf\r\nContent-Length: 100\r\n";
    let mut slow = send(&server, &format!("{head}\r\nabc")).await;
    assert!(rest(&mut slow).await.starts_with("HTTP/1.1 408"));
    let mut late = send(&server, &format!("{head}X-Latency-Budget-Ms: 5\r\n\r\nabc")).await;
    assert!(rest(&mut late).await.starts_with("HTTP/1.1 504"));
    server.shutdown().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_that_sends_too_much_gets_to_read_why() {
    let mut config = config();
    config.limits.body_bytes = 1 << 20;
    let server = start(config).await;
    let length = 3 << 20;
    let head = format!(
        "POST /v1/stereo HTTP/1.1\r\nHost: x\r\nContent-Type: application/x-protobuf\r\nContent-Length: {length}\r\n\
         Accept: application/json\r\nConnection: close\r\n\r\n"
    );
    let mut stream = send(&server, &head).await;
    stream.write_all(&vec![0; length]).await.unwrap();
    let answer = rest(&mut stream).await;
    assert!(
        answer.starts_with("HTTP/1.1 413") && answer.contains("TOO_LARGE"),
        "{answer}"
    );
    server.shutdown().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn at_the_limit_a_silent_connection_makes_room_and_one_that_speaks_keeps_its_place() {
    let mut config = config();
    config.http.connections = 1;
    let server = start(config).await;
    let mut silent = send(&server, "").await;
    let mut second = send(&server, "GET /livez HTTP/1.1\r\nHost: x\r\n\r\n").await;
    let mut status = [0; 12];
    second.read_exact(&mut status).await.unwrap();
    assert_eq!(&status, b"HTTP/1.1 200");
    assert_eq!(rest(&mut silent).await, "", "closed");
    let mut third = send(&server, "").await;
    let refused = rest(&mut third).await;
    assert!(
        refused.starts_with("HTTP/1.1 503") && refused.contains("1 connections are open already"),
        "{refused}"
    );
    server.shutdown().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn shutdown_closes_resting_connections_and_does_not_wait_for_silent_ones() {
    let server = start(config()).await;
    assert!(server.ready().await);
    let addr = server.http_addr;
    let mut resting = send(&server, "GET /readyz HTTP/1.1\r\nHost: x\r\n\r\n").await;
    let mut status = [0; 12];
    resting.read_exact(&mut status).await.unwrap();
    assert_eq!(&status, b"HTTP/1.1 200");
    let _silent = send(&server, "POST /v1/stereo HTTP/1.1\r\n").await;
    let started = Instant::now();
    server.shutdown().await;
    assert!(
        started.elapsed() < Duration::from_secs(10),
        "bounded by the 2 s that closing may take"
    );
    rest(&mut resting).await;
    assert!(
        TcpStream::connect(addr).await.is_err(),
        "nothing listens any more"
    );
}
