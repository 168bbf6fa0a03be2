//! What comes in and is no frame: counted under a reason, with a sentence that says what is wrong, and never an end.

use prost::Message;

use super::network::{IMAGE, Network, REQUEST, assert_is_of_the_pair, numbered, stamp};
use crate::conversation::{PAIR, message};

#[tokio::test(flavor = "multi_thread")]
async fn messages_that_are_no_frames_are_counted_under_their_reason() {
    let network = Network::start(&["--max-body-bytes", "500000"]).await;
    let camera = network.camera("front").await;
    let other_camera = stereo_proto::v1::StereoRequest {
        camera_id: "rear".to_owned(),
        ..numbered(1)
    };
    let bad: [(&str, Vec<u8>, &str, &str); 6] = [
        (REQUEST, vec![0xff; 1000], "INVALID", "StereoRequest"),
        (REQUEST, Vec::new(), "INVALID", "image is missing"),
        ("text/plain", message().encode_to_vec(), "INVALID", "text/plain"),
        (IMAGE, message().encode_to_vec(), "INVALID", "stereo.v1.Image"),
        (REQUEST, other_camera.encode_to_vec(), "INVALID", "rear"),
        (REQUEST, vec![0; 500_001], "TOO_LARGE", "500000"),
    ];
    for (count, (encoding, payload, reason, word)) in (1..).zip(bad) {
        camera.put_raw("", encoding, payload, None).await;
        let stream = network
            .stream_when("front", |stream| {
                stream["frames"]["received"] == count && stream["frames"]["under_way"] == 0
            })
            .await;
        let why = stream["last_error"].as_str().unwrap_or_default();
        assert!(why.contains(word), "{word}: {why}");
        assert!(stream["frames"]["dropped"][reason].as_u64() > Some(0), "{stream}");
    }
    camera.put(&numbered(2)).await;
    assert_is_of_the_pair(&camera.result().await, &network.server.good().await);
}

#[tokio::test(flavor = "multi_thread")]
async fn images_that_cannot_be_paired_are_counted_and_say_what_is_missing() {
    let network = Network::start(&[]).await;
    let camera = network.camera("front").await;
    let garbage_stamp = async || {
        network
            .session
            .put("stereo/v1/frames/front/left", PAIR.left.clone())
            .encoding(zenoh::bytes::Encoding::IMAGE_PNG)
            .attachment(vec![0xff; 5])
            .await
            .expect("an open session");
    };
    camera
        .put_raw("/left", "image/png", PAIR.left.clone(), None)
        .await;
    let counted = |why: &'static str, count: u64| {
        move |stream: &serde_json::Value| stream["images"]["unpaired"][why] == count
    };
    let stream = network.stream_when("front", counted("unstamped", 1)).await;
    let why = stream["last_error"].as_str().unwrap_or_default();
    assert!(why.contains("ImageStamp"), "{why}");
    garbage_stamp().await;
    let stream = network.stream_when("front", counted("refused", 1)).await;
    let why = stream["last_error"].as_str().unwrap_or_default();
    assert!(why.contains("attachment"), "{why}");
    camera
        .put_raw("/right", "text/plain", b"x".to_vec(), stamp(1))
        .await;
    camera.put_raw("/right", IMAGE, vec![0xff; 50], stamp(2)).await;
    network.stream_when("front", counted("refused", 3)).await;
    let metric = "stereod_stream_images_unpaired_total{why=\"refused\"}";
    assert_eq!(network.server.metric(metric).await, 3.0);
}
