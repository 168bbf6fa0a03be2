//! Frames in, results out.

use prost::Message;
use serde_json::json;
use stereo_proto::v1;

use super::network::{IMAGE, Network, assert_is_of_the_pair, numbered, stamp};
use crate::conversation::{PAIR, message};

#[tokio::test(flavor = "multi_thread")]
async fn a_pair_in_one_message_comes_back_as_a_result() {
    let network = Network::start(&[]).await;
    let camera = network.camera("front").await;
    camera.put(&numbered(7)).await;
    let result = camera.result().await;
    assert_eq!((result.sequence, result.camera_id.as_str()), (Some(7), "front"));
    assert_eq!(
        result.report.as_ref().map(|report| report.instance.as_str()),
        Some("stereod")
    );
    assert_is_of_the_pair(&result, &network.server.good().await);
    let stream = network.stream("front").await;
    assert_eq!(stream["frames"]["received"], 1);
    assert_eq!(stream["frames"]["answered"], 1);
    assert_eq!(stream["last_result"]["sequence"], 7);
}

#[tokio::test(flavor = "multi_thread")]
async fn left_and_right_images_are_paired_by_their_numbers() {
    let network = Network::start(&["--require-zenoh"]).await;
    // Everything by the camera's settings: single images have no options of their own.
    let settings = v1::CameraSettings {
        options: message().options,
        pairing: Some(v1::Pairing {
            patience: Some(prost_types::Duration {
                seconds: 10,
                nanos: 0,
            }),
            ..v1::Pairing::default()
        }),
        ..v1::CameraSettings::default()
    };
    super::settings::set(&network.session, "front", &settings)
        .await
        .expect("good settings");
    let camera = network.camera("front").await;
    camera
        .put_raw("/left", "image/png", PAIR.left.clone(), stamp(1))
        .await;
    camera
        .put_raw("/right", "image/png", PAIR.right.clone(), stamp(2))
        .await;
    camera
        .put_raw("/left", "image/png", PAIR.left.clone(), stamp(2))
        .await;
    let result = camera.result().await;
    assert_eq!(result.sequence, Some(2));
    assert_is_of_the_pair(&result, &network.server.good().await);
    let stream = network.stream("front").await;
    assert_eq!(stream["images"]["received"], 3);
    assert_eq!(stream["images"]["paired"], 2);
    assert_eq!(stream["images"]["unpaired"], json!({ "alone": 1 }));
    assert_eq!(stream["images"]["last_unpaired"][0]["sequence"], 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn images_without_numbers_are_paired_by_time_within_the_tolerance() {
    let network = Network::start(&[]).await;
    let settings = v1::CameraSettings {
        options: message().options,
        pairing: Some(v1::Pairing {
            patience: Some(prost_types::Duration {
                seconds: 10,
                nanos: 0,
            }),
            ..v1::Pairing::default()
        }),
        ..v1::CameraSettings::default()
    };
    super::settings::set(&network.session, "front", &settings)
        .await
        .expect("good settings");
    let camera = network.camera("front").await;
    let image = |image: Option<v1::Image>, ms: i32| {
        let timestamp = Some(prost_types::Timestamp {
            seconds: 1,
            nanos: ms * 1_000_000,
        });
        v1::Image {
            timestamp,
            ..image.expect("a test image")
        }
        .encode_to_vec()
    };
    camera
        .put_raw("/left", IMAGE, image(message().left, 0), None)
        .await;
    camera
        .put_raw("/right", IMAGE, image(message().right, 30), None)
        .await;
    camera
        .put_raw("/left", IMAGE, image(message().left, 25), None)
        .await;
    let result = camera.result().await;
    assert_eq!(result.capture_time.map(|time| time.nanos), Some(25_000_000));
    let stream = network.stream("front").await;
    assert_eq!(stream["images"]["unpaired"], json!({ "alone": 1 }));
    assert_eq!(stream["images"]["last_unpaired"][0]["nearest_ms"], 30.0);
}

#[tokio::test(flavor = "multi_thread")]
async fn of_frames_that_come_too_fast_the_newest_is_answered_and_all_are_counted() {
    const FRAMES: u64 = 60;
    let network = Network::start(&[]).await;
    let camera = network.camera("front").await;
    for sequence in 1..=FRAMES {
        camera.put(&numbered(sequence)).await;
    }
    let mut answered = Vec::new();
    while answered.last() != Some(&FRAMES) {
        answered.push(camera.result().await.sequence.expect("the number that was sent"));
    }
    assert!(answered.is_sorted(), "results came out of order: {answered:?}");
    let stream = network.stream("front").await;
    let frames = &stream["frames"];
    let superseded = frames["dropped"]["SUPERSEDED"].as_u64().unwrap_or_default();
    assert_eq!(frames["received"], FRAMES);
    assert_eq!(frames["under_way"], 0);
    assert_eq!(
        frames["answered"].as_u64().map(|answered| answered + superseded),
        Some(FRAMES)
    );
    assert_eq!(
        frames["answered"].as_u64(),
        frames["unsent"]
            .as_u64()
            .map(|unsent| unsent + answered.len() as u64)
    );
    let counted = network
        .server
        .metric("stereod_stream_frames_total{outcome=\"SUPERSEDED\"}")
        .await;
    assert_eq!(counted, superseded as f64);
    let as_requests = network
        .server
        .metric("stereod_requests_total{class=\"deadline\",outcome=\"OK\"}")
        .await;
    assert_eq!(Some(as_requests), frames["answered"].as_f64());
}

#[tokio::test(flavor = "multi_thread")]
async fn numbers_left_out_are_lost_frames() {
    let network = Network::start(&[]).await;
    let camera = network.camera("front").await;
    for sequence in [3, 4, 9] {
        camera.put(&numbered(sequence)).await;
        assert_eq!(camera.result().await.sequence, Some(sequence));
    }
    camera.put(&numbered(8)).await;
    let stream = network
        .stream_when("front", |stream| stream["frames"]["dropped"]["SUPERSEDED"] == 1)
        .await;
    assert_eq!(stream["frames"]["lost"], 4);
}

#[tokio::test(flavor = "multi_thread")]
async fn parts_are_encoded_only_while_somebody_subscribes_to_them() {
    let network = Network::start(&[]).await;
    let camera = network.camera("front").await;
    camera.put(&numbered(1)).await;
    camera.result().await;
    let bodies = |stream: &serde_json::Value| stream["last_result"]["bodies"].clone();
    assert_eq!(bodies(&network.stream("front").await), json!(["result"]));

    let parts = ["disparity", "mesh", "report"].map(|part| format!("stereo/v1/results/front/{part}"));
    let mut subscribers = Vec::new();
    for part in &parts {
        subscribers.push(
            network
                .session
                .declare_subscriber(part)
                .await
                .expect("an open session"),
        );
    }
    let mut sequence = 1;
    let all = json!(["result", "disparity", "mesh", "report"]);
    while bodies(&network.stream("front").await) != all {
        sequence += 1;
        camera.put(&numbered(sequence)).await;
        camera.result().await;
    }
    let part = async |index: usize| {
        let mut last = subscribers[index].recv_async().await.expect("a part");
        while let Ok(Some(newer)) = subscribers[index].try_recv() {
            last = newer;
        }
        (
            last.encoding().to_string(),
            last.payload().to_bytes().into_owned(),
        )
    };
    let whole = {
        sequence += 1;
        camera.put(&numbered(sequence)).await;
        camera.result().await
    };
    let (encoding, disparity) = part(0).await;
    assert_eq!(encoding, "application/protobuf;stereo.v1.Disparity");
    let disparity = v1::Disparity::decode(disparity.as_slice()).expect("a Disparity");
    assert!(
        Some(disparity) == whole.disparity,
        "the part differs from the whole"
    );
    let mesh = v1::Mesh::decode(part(1).await.1.as_slice()).expect("a Mesh");
    assert!(Some(mesh) == whole.mesh, "the part differs from the whole");
    let report = v1::ExecutionReport::decode(part(2).await.1.as_slice()).expect("an ExecutionReport");
    assert_eq!(report.instance, "stereod");

    drop(subscribers);
    while bodies(&network.stream("front").await) != json!(["result"]) {
        sequence += 1;
        camera.put(&numbered(sequence)).await;
        camera.result().await;
    }
}
