//! Latency budgets over HTTP: bad ones, tight ones, and what is cut to keep them.

use std::time::{Duration, Instant};

use prost::Message;
use stereo_client::Client;
use stereo_proto::v1;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

use crate::conversation::{PROTOBUF, Server, message};

async fn connect(server: &Server) -> TcpStream {
    let address = server.process.url().trim_start_matches("http://").to_owned();
    TcpStream::connect(address).await.expect("a listening server")
}

async fn rest(stream: &mut TcpStream) -> String {
    let mut bytes = Vec::new();
    // A connection that is reset has said what it had to say.
    let _ = stream.read_to_end(&mut bytes).await;
    String::from_utf8_lossy(&bytes).into_owned()
}

#[tokio::test]
async fn budgets_of_zero_negative_a_year_and_nan_are_400_and_counted() {
    let server = Server::start(&[]);
    let bad = ["0", "-5", "31536000000", "NaN", "inf", "soon"];
    for budget in bad {
        let mut stream = connect(&server).await;
        let head = format!(
            "POST /v1/stereo HTTP/1.1\r\nHost: x\r\nContent-Type: {PROTOBUF}\r\nX-Latency-Budget-Ms: {budget}\r\n\
             Content-Length: 0\r\nConnection: close\r\n\r\n"
        );
        stream.write_all(head.as_bytes()).await.expect("room");
        let answer = rest(&mut stream).await;
        assert!(answer.starts_with("HTTP/1.1 400"), "{budget}: {answer}");
    }
    for (seconds, nanos) in [(0, 0), (-1, 0), (31_536_000, 0), (i64::MAX, i32::MIN)] {
        let mut request = message();
        request.options.get_or_insert_default().latency_budget =
            Some(prost_types::Duration { seconds, nanos });
        server
            .post_message("application/json", &request)
            .await
            .assert_refused(400, &["latency_budget"]);
    }
    let counted = "stereod_requests_total{class=\"unknown\",outcome=\"INVALID\"}";
    assert_eq!(server.metric(counted).await, 10.0);
}

#[tokio::test]
async fn a_budget_that_can_not_be_met_is_refused_before_the_body_is_sent() {
    let server = Server::start(&[]);
    assert_eq!(server.good().await.status, 200);
    let mut stream = connect(&server).await;
    // Four megapixels each, of which nothing is ever sent.
    let head = format!(
        "POST /v1/stereo HTTP/1.1\r\nHost: x\r\nContent-Type: {PROTOBUF}\r\nX-Latency-Budget-Ms: 0.5\r\n\
         Accept: application/json\r\nContent-Length: 8388608\r\nConnection: close\r\n\r\n"
    );
    let sent = Instant::now();
    stream.write_all(head.as_bytes()).await.expect("room");
    let mut answer = vec![0; 2048];
    let count = stream.read(&mut answer).await.expect("an answer");
    let answer = String::from_utf8_lossy(&answer[..count]);
    assert!(answer.starts_with("HTTP/1.1 504"), "{answer}");
    assert!(sent.elapsed() < Duration::from_secs(5), "not after a timeout");
    let says_when = answer.contains("DEADLINE_INFEASIBLE") && answer.contains("earliest_feasible_ms");
    assert!(says_when || answer.contains("EXPIRED"), "{answer}");
}

#[tokio::test]
async fn a_client_whose_large_body_nobody_wants_is_told_that_the_connection_ends() {
    let server = Server::start(&[]);
    for (length, closes) in [(8_388_608, true), (600_000, false)] {
        let mut stream = connect(&server).await;
        let head = format!(
            "POST /v1/stereo HTTP/1.1\r\nHost: x\r\nContent-Type: text/plain\r\nContent-Length: {length}\r\n\r\n"
        );
        stream.write_all(head.as_bytes()).await.expect("room");
        let mut answer = String::new();
        while !answer.contains("\r\n\r\n") {
            let mut piece = [0; 2048];
            let count = stream.read(&mut piece).await.expect("an answer");
            assert!(count > 0, "{answer}");
            answer += &String::from_utf8_lossy(&piece[..count]);
        }
        assert!(answer.starts_with("HTTP/1.1 415"), "{answer}");
        assert_eq!(answer.contains("connection: close"), closes, "{answer}");
    }
}

#[tokio::test]
async fn headers_then_nothing_and_a_byte_at_a_time_end_in_a_counted_408() {
    let server = Server::start(&["--body-timeout-ms", "300"]);
    let head = format!(
        "POST /v1/stereo HTTP/1.1\r\nHost: x\r\nContent-Type: {PROTOBUF}\r\nContent-Length: 600000\r\n\
         Connection: close\r\n\r\n"
    );
    let mut silent = connect(&server).await;
    silent.write_all(head.as_bytes()).await.expect("room");
    let mut slow = connect(&server).await;
    slow.write_all(head.as_bytes()).await.expect("room");
    let (mut reading, mut writing) = slow.into_split();
    let trickle = tokio::spawn(async move {
        while writing.write_all(b"x").await.is_ok() {
            tokio::task::yield_now().await;
        }
    });
    assert!(rest(&mut silent).await.starts_with("HTTP/1.1 408"));
    let mut start = [0; 12];
    reading.read_exact(&mut start).await.expect("an answer");
    assert_eq!(&start, b"HTTP/1.1 408");
    trickle.abort();
    let counted = "stereod_requests_total{class=\"unknown\",outcome=\"EXPIRED\"}";
    assert_eq!(server.metric(counted).await, 2.0);
    assert_eq!(server.good().await.status, 200);
}

#[tokio::test]
async fn an_older_frame_of_a_camera_makes_way_for_a_newer_one() {
    let server = Server::start(&[]);
    server.until_ready().await;
    // Something long, so that both frames of the camera have to wait.
    let mut long = crate::lifecycle::large_message();
    long.request_id = "long".into();
    let long = server.start_posting(&long);
    server.until("stereod_workers_busy", 1.0).await;
    let frame = |number| v1::StereoRequest {
        camera_id: "front".into(),
        sequence: Some(number),
        ..message()
    };
    let older = server.start_posting(&frame(1));
    while server.get("/readyz").await.json()["queue_depth"] != 1 {
        assert!(!long.is_finished(), "too fast a machine for this test");
    }
    let newer = server.start_posting(&frame(2));
    let older = older.await.expect("an answer");
    assert_eq!(older.status, 409, "{}", older.text());
    let status = v1::Status::decode(older.body.as_slice()).expect("a status");
    assert_eq!(status.reason(), v1::Reason::Superseded);
    assert_eq!(newer.await.expect("an answer").status, 200);
    assert_eq!(long.await.expect("an answer").status, 200);
    assert_eq!(
        server
            .metric("stereod_dropped_frames_total{reason=\"SUPERSEDED\"}")
            .await,
        1.0
    );
}

#[tokio::test]
async fn compressed_results_are_the_same_and_smaller() {
    let server = Server::start(&[]);
    let client = Client::new(server.process.url()).expect("an address");
    let plain = client.match_pair(&message()).await.expect("a result");
    for compression in [v1::Compression::Zstd, v1::Compression::Lz4] {
        let mut request = message();
        request
            .options
            .get_or_insert_default()
            .set_compression(compression);
        let raw = server.post_message(PROTOBUF, &request).await.result();
        let part = raw.disparity.expect("a default output");
        assert_eq!(part.compression(), compression);
        let original = plain.disparity.as_ref().expect("a default output");
        assert!(part.data.len() < original.data.len());
        let restored = client.match_pair(&request).await.expect("a result");
        assert_eq!(restored.disparity.expect("as asked").data, original.data);
        assert_eq!(
            restored.mesh.expect("a default output").positions,
            plain.mesh.as_ref().expect("a default output").positions
        );
    }
}

#[tokio::test]
async fn metrics_are_open_metrics_and_count_what_happened() {
    let server = Server::start(&[]);
    assert_eq!(server.good().await.status, 200);
    let reply = server.get("/metrics").await;
    assert!(reply.content_type.starts_with("application/openmetrics-text"));
    let text = String::from_utf8(reply.body).expect("text");
    assert!(text.ends_with("# EOF\n"));
    for line in [
        "stereod_requests_total{class=\"deadline\",outcome=\"OK\"} 1",
        "stereod_deadlines_total{outcome=\"kept\"} 1",
        "stereod_queue_seconds_count 1",
        "stereod_workers 1",
    ] {
        assert!(text.lines().any(|found| found == line), "{line} isn't there");
    }
}
