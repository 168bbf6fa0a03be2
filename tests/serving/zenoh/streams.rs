//! Camera streams over HTTP.

use std::cell::Cell;

use futures_util::StreamExt;
use prost::Message;
use serde_json::Value;
use stereo_proto::v1::StreamView;

use super::network::{Camera, Network, numbered};
use crate::conversation::png16;

/// Sends frames, numbered on from `sequence`, until something has happened; the last one's result is out, too, then: the next
/// frame would end it early.
async fn while_streaming<T>(camera: &Camera, sequence: &mut u64, something: impl Future<Output = T>) -> T {
    let happened = Cell::new(false);
    let streaming = async {
        while !happened.get() {
            *sequence += 1;
            camera.put(&numbered(*sequence)).await;
            camera.result().await;
        }
    };
    let something = async {
        let done = something.await;
        happened.set(true);
        done
    };
    tokio::join!(streaming, something).1
}

#[tokio::test(flavor = "multi_thread")]
async fn the_latest_result_comes_in_the_accepted_format() {
    let network = Network::start(&[]).await;
    let camera = network.camera("front").await;
    let expected = network.server.good().await;
    let latest = async |query: &str| {
        network
            .server
            .get(&format!("/v1/streams/front/latest{query}"))
            .await
    };
    let mut sequence = 0;
    let result = while_streaming(&camera, &mut sequence, latest("")).await.result();
    assert_eq!(result.camera_id, "front");
    let disparity = while_streaming(&camera, &mut sequence, latest("?view=disparity")).await;
    assert_eq!(disparity.content_type, "image/png", "{}", disparity.text());
    assert!(png16(&disparity.body) == expected.png16());
    let color = while_streaming(&camera, &mut sequence, latest("?view=color")).await;
    assert_eq!((color.status, color.content_type.as_str()), (200, "image/png"));
    let seen = while_streaming(&camera, &mut sequence, latest("?view=frame")).await;
    let seen = StreamView::decode(&*seen.body).unwrap();
    let (seen, left) = (seen.result.unwrap(), seen.left.unwrap());
    assert_eq!(seen.disparity, result.disparity);
    assert!(seen.mesh.is_some_and(|mesh| !mesh.indices.is_empty()) && seen.report.is_some());
    assert_eq!(Some(left.data), numbered(0).left.map(|sent| sent.data));
    latest("?view=smell").await.assert_refused(400, &["smell"]);
    // The camera has stopped.
    let is_idle =
        |stream: &Value| stream["frames"]["received"] == sequence && stream["frames"]["under_way"] == 0;
    network.stream_when("front", is_idle).await;
    latest("").await.assert_refused(404, &["front", "2s"]);
}

#[tokio::test(flavor = "multi_thread")]
async fn streams_are_listed_and_a_camera_that_is_not_there_is_said_so() {
    let network = Network::start(&[]).await;
    let none = network.server.get("/v1/streams").await.json();
    assert_eq!(none["streams"].as_array().map(Vec::len), Some(0));
    assert_eq!(none["zenoh"]["state"], "open");
    for path in [
        "/v1/streams/front",
        "/v1/streams/front/latest",
        "/v1/streams/front/events",
    ] {
        network.server.get(path).await.assert_refused(404, &["front"]);
    }
    let camera = network.camera("front").await;
    let list = network.server.get("/v1/streams").await.json();
    assert_eq!(list["streams"][0]["camera"], "front");
    assert_eq!(list["streams"][0]["served"], true);
    drop(camera);
    network
        .stream_when("front", |stream| stream["served"] == false)
        .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn events_tell_of_every_result_as_it_happens() {
    let network = Network::start(&[]).await;
    let camera = network.camera("front").await;
    let url = format!("{}/v1/streams/front/events", network.server.process.url());
    let http = stereo_tests::http::builder()
        .no_proxy()
        .build()
        .expect("a client");
    let answer = http.get(url).send().await.expect("an answer");
    assert_eq!(
        answer.headers()["content-type"].to_str().expect("ASCII"),
        "text/event-stream"
    );
    let mut body = answer.bytes_stream();
    camera.put(&numbered(41)).await;
    // Sent before that, the next one would take its place.
    camera.result().await;
    camera.put_raw("", "text/plain", Vec::new(), None).await;
    let mut text = String::new();
    while !(text.contains("event: result") && text.contains("event: dropped") && text.ends_with("\n\n")) {
        let piece = body
            .next()
            .await
            .expect("an endless body")
            .expect("a whole piece");
        text.push_str(&String::from_utf8_lossy(&piece));
    }
    let data = |event: &str| -> Value {
        let start = text.find(&format!("event: {event}\ndata: ")).expect("just seen");
        let line = text[start..].lines().nth(1).expect("its data");
        serde_json::from_str(&line["data: ".len()..]).expect("JSON")
    };
    assert_eq!(data("result")["sequence"], 41);
    assert_eq!(data("result")["report"]["instance"], "stereod");
    assert_eq!(data("dropped")["reason"], "INVALID");
}
