//! Batches through the real server: streaming both ways, every request answered, nothing buffered.

use std::time::Duration;

use futures_util::{Stream, StreamExt, stream};
use prost::Message;
use stereo_client::Client;
use stereo_proto::v1;
use stereo_proto::v1::batch_reply::Outcome;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::sync::mpsc;

use crate::conversation::{Server, message};

pub(crate) fn client(server: &Server) -> Client {
    Client::new(server.process.url()).expect("an http address")
}

/// A small pair, so that many of them take little time.
pub(crate) fn small(id: u32) -> v1::StereoRequest {
    let image = |shift: u32| v1::Image {
        encoding: v1::ImageEncoding::Mono8.into(),
        width: 64,
        height: 48,
        data: (0..64 * 48_u32)
            .map(|i| ((i % 64 + shift).wrapping_mul(0x9e37_79b9) >> 24).to_le_bytes()[0])
            .collect(),
        ..v1::Image::default()
    };
    v1::StereoRequest {
        request_id: format!("pair-{id}"),
        left: Some(image(0)),
        right: Some(image(4)),
        ..v1::StereoRequest::default()
    }
}

fn outcome(reply: v1::BatchReply) -> (String, Outcome) {
    (reply.request_id, reply.outcome.expect("always one"))
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn ten_thousand_pairs_come_back_in_constant_memory() {
    let server = Server::start(&[
        "--max-batch-bytes-in-flight",
        "1000000",
        "--max-body-bytes",
        "1000000",
    ]);
    let mut replies = client(&server)
        .match_batch(stream::iter((0..10_000).map(small)))
        .await
        .expect("a batch that is taken");
    let mut seen = vec![false; 10_000];
    let mut largest = 0;
    while let Some(reply) = replies.next().await {
        let (id, outcome) = outcome(reply.expect("a whole reply"));
        assert!(matches!(outcome, Outcome::Result(_)), "{id}: {outcome:?}");
        let number: usize = id.trim_start_matches("pair-").parse().expect("its own id");
        assert!(!std::mem::replace(&mut seen[number], true), "{id} twice");
        if number.is_multiple_of(1000) {
            largest = largest.max(server.process.memory_bytes().expect("a running server"));
        }
    }
    assert!(seen.iter().all(|&seen| seen));
    assert!(largest < 400 << 20, "{largest} bytes");
    assert_eq!(
        server
            .metric("stereod_batches_ended_total{outcome=\"complete\"}")
            .await,
        1.0
    );
    assert_eq!(
        server
            .metric("stereod_requests_total{class=\"background\",outcome=\"OK\"}")
            .await,
        10_000.0
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn replies_come_while_requests_are_still_being_sent() {
    let server = Server::start(&[]);
    let (give, requests) = fed();
    let mut replies = client(&server).match_batch(requests).await.expect("a batch");
    for id in 0..3 {
        give.send(small(id)).await.expect("an open batch");
        let (name, _) = outcome(replies.next().await.expect("a reply").expect("whole"));
        assert_eq!(name, format!("pair-{id}"), "answered before the next is sent");
    }
    drop(give);
    assert!(replies.next().await.is_none());
    assert_eq!((replies.sent(), replies.answered()), (3, 3));
}

/// A stream of requests that is fed while it is sent.
pub(crate) fn fed() -> (
    mpsc::Sender<v1::StereoRequest>,
    impl Stream<Item = v1::StereoRequest> + Send + 'static,
) {
    let (sender, receiver) = mpsc::channel(1);
    let requests = stream::unfold(receiver, |mut receiver| async {
        receiver.recv().await.map(|request| (request, receiver))
    });
    (sender, requests)
}

#[tokio::test]
async fn a_bad_request_is_refused_by_name_and_the_others_are_answered() {
    let server = Server::start(&[]);
    let mut lonely = small(1);
    lonely.right = None;
    let mut nameless = small(2);
    nameless.request_id.clear();
    let replies = client(&server)
        .match_batch(stream::iter([small(0), lonely, nameless]))
        .await
        .expect("a batch");
    let mut results = 0;
    let replies: Vec<_> = replies.collect().await;
    for reply in replies {
        match outcome(reply.expect("whole")) {
            (id, Outcome::Status(status)) => {
                assert_eq!((id.as_str(), status.code), ("pair-1", 400));
                assert!(status.message.contains("right"), "{}", status.message);
            }
            (id, Outcome::Result(result)) => {
                assert_eq!(id, result.request_id);
                assert!(id == "pair-0" || id.ends_with("/2"), "{id}");
                results += 1;
            }
        }
    }
    assert_eq!(results, 2);
}

/// Starts a batch by hand.
async fn begin(server: &Server, body: &[u8], is_whole: bool) -> TcpStream {
    let address = server.process.url().trim_start_matches("http://").to_owned();
    let mut stream = TcpStream::connect(address).await.expect("a listening server");
    let head = "POST /v1/stereo/batch HTTP/1.1\r\nHost: x\r\nContent-Type: application/x-protobuf; delimited=true\r\n\
                Transfer-Encoding: chunked\r\nConnection: close\r\n\r\n";
    let mut bytes = head.as_bytes().to_vec();
    bytes.extend_from_slice(format!("{:x}\r\n", body.len()).as_bytes());
    bytes.extend_from_slice(body);
    bytes.extend_from_slice(if is_whole { b"\r\n0\r\n\r\n" } else { b"\r\n" });
    stream.write_all(&bytes).await.expect("a socket with room");
    stream
}

#[tokio::test]
async fn a_batch_that_breaks_off_ends_in_a_status_after_what_was_whole() {
    let server = Server::start(&[]);
    let whole = small(0).encode_length_delimited_to_vec();
    let half = &whole[..whole.len() / 2];
    let mut stream = begin(&server, &[&whole, half].concat(), true).await;
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).await.expect("an answer");
    let text = String::from_utf8_lossy(&answer);
    assert!(
        text.contains("pair-0") && text.contains("broke off"),
        "{}",
        &text[..text.len().min(500)]
    );
    assert_eq!(
        server
            .metric("stereod_batches_ended_total{outcome=\"broken_off\"}")
            .await,
        1.0
    );
    assert_eq!(
        server
            .metric("stereod_requests_total{class=\"unknown\",outcome=\"INVALID\"}")
            .await,
        1.0
    );
}

#[tokio::test]
async fn a_run_of_zeros_is_no_request_each() {
    let server = Server::start(&[]);
    let whole = small(0).encode_length_delimited_to_vec();
    let mut stream = begin(&server, &[&whole[..], &[0; 10_000]].concat(), true).await;
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).await.expect("an answer");
    let text = String::from_utf8_lossy(&answer);
    assert!(text.contains("pair-0") && text.contains("0 bytes"), "{text}");
    assert_eq!(
        server
            .metric("stereod_requests_total{class=\"unknown\",outcome=\"INVALID\"}")
            .await,
        1.0
    );
}

#[tokio::test]
async fn a_client_that_hangs_up_in_the_middle_cancels_its_batch() {
    let server = Server::start(&[]);
    let whole = small(0).encode_length_delimited_to_vec();
    let stream = begin(&server, &whole, false).await;
    server.until("stereod_batch_frames_total", 1.0).await;
    drop(stream);
    server
        .until("stereod_batches_ended_total{outcome=\"hung_up\"}", 1.0)
        .await;
    assert_eq!(server.metric("stereod_batches").await, 0.0);
    assert_eq!(server.metric("stereod_batch_in_flight_bytes").await, 0.0);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn replies_that_are_not_read_end_the_batch_as_slow_reader() {
    let server = Server::start(&["--body-timeout-ms", "200"]);
    let address = server.process.url().trim_start_matches("http://").to_owned();
    let stream = TcpStream::connect(address).await.expect("a listening server");
    let (_unread, mut writing) = stream.into_split();
    let head = "POST /v1/stereo/batch HTTP/1.1\r\nHost: x\r\nContent-Type: application/x-protobuf; delimited=true\r\n\
                Transfer-Encoding: chunked\r\n\r\n";
    writing
        .write_all(head.as_bytes())
        .await
        .expect("a socket with room");
    let large = message().encode_length_delimited_to_vec();
    let chunk = [format!("{:x}\r\n", large.len()).as_bytes(), &large, b"\r\n"].concat();
    // The replies fill the sockets' buffers, then the server stops reading, then it gives up.
    while writing.write_all(&chunk).await.is_ok() {}
    server
        .until("stereod_batches_ended_total{outcome=\"slow_reader\"}", 1.0)
        .await;
    assert_eq!(
        server
            .metric("stereod_requests_total{class=\"unknown\",outcome=\"SLOW_READER\"}")
            .await,
        1.0
    );
    assert_eq!(server.good().await.status, 200);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_frame_with_a_deadline_goes_before_an_endless_batch() {
    let server = Server::start(PATIENT);
    let endless = stream::repeat_with(message_without_budget);
    let mut replies = client(&server).match_batch(endless).await.expect("a batch");
    for _ in 0..3 {
        let report = server
            .post_message("application/x-protobuf", &message())
            .await
            .result()
            .report
            .expect("always");
        assert!(report.deadline_met);
        assert!(replies.next().await.is_some_and(|reply| reply.is_ok()));
    }
    drop(replies);
    server.until(HUNG_UP, 1.0).await;
    server.until_zero("stereod_batches").await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_client_that_stops_reading_and_then_hangs_up_ends_its_batch() {
    let server = Server::start(PATIENT);
    let endless = stream::repeat_with(message_without_budget);
    let replies = client(&server).match_batch(endless).await.expect("a batch");
    // Nobody reads: the replies fill the sockets until nothing moves in either direction. A batch that flows has a frame with a worker
    // or in the queue in almost every look.
    let mut still = 0;
    let mut seen = 0.0;
    while still < 100 {
        let frames = server.metric("stereod_batch_frames_total").await;
        let is_still = frames > 3.0 && frames == seen && server.metric("stereod_workers_busy").await == 0.0;
        still = if is_still { still + 1 } else { 0 };
        seen = frames;
    }
    drop(replies);
    server.until(HUNG_UP, 1.0).await;
    server.until_zero("stereod_batches").await;
    server.until_zero("stereod_batch_in_flight_bytes").await;
}

/// A server that waits for its clients for longer than any test takes.
const PATIENT: &[&str] = &["--body-timeout-ms", "600000"];
/// Batches whose client has gone.
const HUNG_UP: &str = "stereod_batches_ended_total{outcome=\"hung_up\"}";

fn message_without_budget() -> v1::StereoRequest {
    v1::StereoRequest {
        options: None,
        ..message()
    }
}

#[tokio::test]
async fn heads_that_make_no_sense_for_a_batch_are_refused() {
    let server = Server::start(&[]);
    let url = format!("{}/v1/stereo/batch", server.process.url());
    let http = stereo_tests::http::builder()
        .no_proxy()
        .timeout(Duration::from_secs(60))
        .build()
        .expect("a client");
    for (name, value, code) in [
        ("content-type", "image/png", 415),
        ("x-latency-budget-ms", "80", 400),
        ("accept", "image/png", 406),
    ] {
        let mut request = http.post(&url).body("").header(name, value);
        if name != "content-type" {
            request = request.header("content-type", "application/x-protobuf");
        }
        assert_eq!(request.send().await.expect("an answer").status(), code, "{name}");
    }
}
