//! HTTP/2 without TLS, by prior knowledge.

use futures_util::{StreamExt, stream};
use prost::Message;
use reqwest::Version;
use stereo_proto::v1;
use stereo_proto::v1::batch_reply::Outcome;

use crate::batch::small;
use crate::conversation::{PROTOBUF, Server, message};

/// A request by HTTP/2 and nothing else.
fn post(server: &Server, path: &str, body: reqwest::Body) -> reqwest::RequestBuilder {
    let client = stereo_tests::http::builder()
        .no_proxy()
        .http2_prior_knowledge()
        .build()
        .expect("a client");
    client
        .post(format!("{}{path}", server.process.url()))
        .header("content-type", PROTOBUF)
        .body(body)
}

#[tokio::test]
async fn a_pair_is_answered_as_over_http_1() {
    let server = Server::start(&[]);
    let expected = server.post_message(PROTOBUF, &message()).await.result();
    let request = post(&server, "/v1/stereo", message().encode_to_vec().into());
    let answer = request.send().await.expect("an answer");
    assert_eq!(
        (answer.status().as_u16(), answer.version()),
        (200, Version::HTTP_2)
    );
    let body = answer.bytes().await.expect("a whole body");
    let result = v1::StereoResult::decode(body).expect("a result");
    assert!(result.disparity == expected.disparity);
    assert!(result.mesh == expected.mesh);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_batch_streams_both_ways() {
    let server = Server::start(&[]);
    let pairs = (0..500).map(|id| Ok::<_, std::io::Error>(small(id).encode_length_delimited_to_vec()));
    let body = reqwest::Body::wrap_stream(stream::iter(pairs));
    let answer = post(&server, "/v1/stereo/batch", body)
        .send()
        .await
        .expect("an answer");
    assert_eq!(answer.version(), Version::HTTP_2);
    let mut replies = answer.bytes().await.expect("all replies");
    let mut seen = vec![false; 500];
    while !replies.is_empty() {
        let reply = v1::BatchReply::decode_length_delimited(&mut replies).expect("a whole reply");
        assert!(matches!(reply.outcome, Some(Outcome::Result(_))), "{reply:?}");
        let number: usize = reply
            .request_id
            .trim_start_matches("pair-")
            .parse()
            .expect("its own id");
        assert!(!std::mem::replace(&mut seen[number], true), "{number} twice");
    }
    assert!(seen.iter().all(|&seen| seen));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_batch_whose_connection_is_lost_is_hung_up() {
    let server = Server::start(&["--body-timeout-ms", "600000"]);
    let endless = stream::repeat_with(|| Ok::<_, std::io::Error>(message().encode_length_delimited_to_vec()));
    let request = post(&server, "/v1/stereo/batch", reqwest::Body::wrap_stream(endless));
    // A runtime of its own ends with everything in it, the connection too.
    let lost = tokio::task::spawn_blocking(move || {
        let runtime = tokio::runtime::Runtime::new().expect("a runtime");
        runtime.block_on(async {
            let mut replies = request.send().await.expect("an answer").bytes_stream();
            assert!(replies.next().await.is_some_and(|piece| piece.is_ok()));
        });
    });
    lost.await.expect("no panic");
    server
        .until("stereod_batches_ended_total{outcome=\"hung_up\"}", 1.0)
        .await;
    server.until_zero("stereod_batch_in_flight_bytes").await;
}
