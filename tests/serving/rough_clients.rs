//! Clients that misbehave: each ends in a counted outcome, and those that behave don't notice.

use std::time::Duration;

use prost::Message;
use stereo_proto::v1;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpSocket, TcpStream};
use tokio::task::JoinHandle;

use crate::batch::small;
use crate::conversation::{PROTOBUF, Server, calibration, message};
use crate::lifecycle::large_message;

async fn connect(server: &Server) -> TcpStream {
    let address = server.process.url().trim_start_matches("http://").to_owned();
    TcpStream::connect(address).await.expect("a listening server")
}

/// A connection of which nothing is taken in that isn't read.
async fn narrow(server: &Server) -> TcpStream {
    let address = server.process.url().trim_start_matches("http://");
    let socket = TcpSocket::new_v4().expect("a socket");
    socket.set_recv_buffer_size(4096).expect("a plain option");
    let stream = socket.connect(address.parse().expect("an address")).await;
    stream.expect("a listening server")
}

fn head(path: &str, more: &str) -> String {
    format!("POST {path} HTTP/1.1\r\nHost: x\r\nContent-Type: {PROTOBUF}\r\n{more}\r\n")
}

/// Two megapixels with everything that can be wanted of them: about 40 MB.
fn large_reply() -> v1::StereoRequest {
    let mut request = large_message();
    let (cx_px, cy_px) = (1024.0, 512.0);
    request.calibration = Some(v1::Calibration {
        cx_px,
        cy_px,
        ..calibration()
    });
    let options = request.options.get_or_insert_default();
    options.set_preset(v1::Preset::Default);
    options.set_density(v1::Density::Dense);
    options.set_disparity_encoding(v1::DisparityEncoding::F32);
    options.max_iterations = Some(1);
    options.outputs = [v1::Output::Disparity, v1::Output::Depth, v1::Output::Points]
        .map(i32::from)
        .to_vec();
    request
}

#[tokio::test]
async fn a_deadline_that_is_over_is_a_counted_504() {
    let server = Server::start(&[]);
    let mut stream = connect(&server).await;
    let body = message().encode_to_vec();
    let more = format!(
        "X-Latency-Budget-Ms: 0.000001\r\nContent-Length: {}\r\nConnection: close\r\n",
        body.len()
    );
    stream
        .write_all(head("/v1/stereo", &more).as_bytes())
        .await
        .expect("room");
    // It may be refused before this is sent.
    let _ = stream.write_all(&body).await;
    let mut start = [0; 12];
    stream.read_exact(&mut start).await.expect("an answer");
    assert_eq!(&start, b"HTTP/1.1 504");
    let unread = "stereod_requests_total{class=\"unknown\",outcome=\"EXPIRED\"}";
    assert_eq!(server.metric(unread).await, 1.0);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn replies_that_are_never_read_take_a_bounded_part_of_the_memory_and_are_given_up() {
    let server = Server::start(&[
        "--max-bytes-in-flight",
        "100000000",
        "--max-body-bytes",
        "10000000",
        "--body-timeout-ms",
        "2000",
    ]);
    server.until_ready().await;
    let good = server.good().await;
    let body = large_reply().encode_to_vec();
    let more = format!("Content-Length: {}\r\n", body.len());
    let whole = [head("/v1/stereo", &more).as_bytes(), &body].concat();
    let mut unread = Vec::new();
    for count in [1.0, 2.0] {
        let mut stream = narrow(&server).await;
        stream.write_all(&whole).await.expect("room");
        unread.push(stream);
        let answered = "stereod_requests_total{class=\"deadline\",outcome=\"OK\"}";
        server.until(answered, 1.0 + count).await;
    }
    // Whoever behaves goes on.
    let still_held = server.metric("stereod_in_flight_bytes").await;
    assert!((1e6..=1e8).contains(&still_held), "{still_held} bytes");
    server.assert_serves(&good).await;
    let slow = "stereod_connections_ended_total{why=\"slow_reader\"}";
    server.until(slow, 2.0).await;
    server.until_zero("stereod_in_flight_bytes").await;
    server.assert_serves(&good).await;
    drop(unread);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_result_for_which_there_is_no_memory_is_refused_and_counted() {
    let server = Server::start(&[
        "--max-bytes-in-flight",
        "10000000",
        "--max-body-bytes",
        "10000000",
    ]);
    let mut request = large_reply();
    request.request_id = "too-much".to_owned();
    let refused = server.post_message("application/x-protobuf", &request).await;
    assert_eq!(refused.status, 503, "{}", refused.text());
    let status = v1::Status::decode(refused.body.as_slice()).expect("a status");
    assert_eq!(status.reason(), v1::Reason::QueueFull);
    assert_eq!(status.request_id, "too-much");
    let dropped = "stereod_dropped_frames_total{reason=\"QUEUE_FULL\"}";
    assert_eq!(server.metric(dropped).await, 1.0);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn frames_with_a_deadline_do_not_notice_clients_that_misbehave() {
    let server = Server::start(&[
        "--body-timeout-ms",
        "1500",
        "--header-timeout-ms",
        "1500",
        "--max-connections",
        "200",
    ]);
    server.until_ready().await;
    let silent_body = head("/v1/stereo", "Content-Length: 600000\r\nConnection: close\r\n");
    let mut crowd: Vec<TcpStream> = Vec::new();
    let mut at_work: Vec<JoinHandle<()>> = Vec::new();
    for _ in 0..20 {
        // Nothing at all; half a head; a head and then nothing.
        for start in ["", "POST /v1/stereo HT", silent_body.as_str()] {
            let mut stream = connect(&server).await;
            stream.write_all(start.as_bytes()).await.expect("room");
            crowd.push(stream);
        }
        // A byte now and then.
        let mut stream = connect(&server).await;
        stream.write_all(silent_body.as_bytes()).await.expect("room");
        at_work.push(tokio::spawn(async move {
            while stream.write_all(b"x").await.is_ok() {
                tokio::time::sleep(Duration::from_millis(20)).await;
            }
        }));
    }
    // A batch whose replies nobody reads, and one that breaks off.
    let batch = head("/v1/stereo/batch", "Transfer-Encoding: chunked\r\n");
    let large = v1::StereoRequest {
        options: None,
        ..message()
    };
    let large = large.encode_length_delimited_to_vec();
    let mut unread = narrow(&server).await;
    unread.write_all(batch.as_bytes()).await.expect("room");
    at_work.push(tokio::spawn(async move {
        let chunk = [format!("{:x}\r\n", large.len()).as_bytes(), &large, b"\r\n"].concat();
        while unread.write_all(&chunk).await.is_ok() {}
    }));
    let whole = small(0).encode_length_delimited_to_vec();
    let half = &whole[..whole.len() / 2];
    let mut broken = connect(&server).await;
    broken.write_all(batch.as_bytes()).await.expect("room");
    let chunk = format!("{:x}\r\n", half.len());
    let bytes = [chunk.as_bytes(), half, b"\r\n0\r\n\r\n"].concat();
    broken.write_all(&bytes).await.expect("room");

    for _ in 0..30 {
        let answer = server.post_message(PROTOBUF, &message()).await;
        assert!(answer.result().report.expect("always").deadline_met);
    }
    for (series, count) in [
        (
            "stereod_requests_total{class=\"unknown\",outcome=\"EXPIRED\"}",
            40.0,
        ),
        ("stereod_connections_ended_total{why=\"silent\"}", 40.0),
        ("stereod_batches_ended_total{outcome=\"slow_reader\"}", 1.0),
        ("stereod_batches_ended_total{outcome=\"broken_off\"}", 1.0),
    ] {
        server.until(series, count).await;
    }
    assert_eq!(
        server.metric("stereod_deadlines_total{outcome=\"missed\"}").await,
        0.0
    );
    for task in at_work {
        task.abort();
    }
}
