//! Clients of different weight.

use stereo_proto::v1;

use crate::conversation::{Server, message};

fn background(camera: &str) -> v1::StereoRequest {
    let mut request = v1::StereoRequest {
        camera_id: camera.to_owned(),
        ..message()
    };
    request
        .options
        .get_or_insert_default()
        .set_priority_class(v1::PriorityClass::Background);
    request
}

#[tokio::test]
async fn a_client_of_three_times_the_weight_is_served_three_times_as_often() {
    let file = std::env::temp_dir().join(format!("stereod-weights-{}.toml", std::process::id()));
    std::fs::write(&file, "[weights.cameras]\nheavy = 3\n").expect("a file");
    let server = Server::start(&["--config", file.to_str().expect("a plain path")]);
    std::fs::remove_file(file).expect("the test's own file");
    server.until_ready().await;
    // What such frames cost is known from here on.
    let other = server
        .post_message("application/x-protobuf", &background("other"))
        .await;
    assert_eq!(other.status, 200, "{}", other.text());
    // Something long, so that all the others have to wait.
    let long = server.start_posting(&crate::lifecycle::large_message());
    server.until("stereod_workers_busy", 1.0).await;
    let mut waiting = Vec::new();
    for camera in ["light", "heavy"].repeat(4) {
        waiting.push((camera, server.start_posting(&background(camera))));
        while server.get("/readyz").await.json()["queue_depth"] != waiting.len() {
            assert!(!long.is_finished(), "too fast a machine for this test");
        }
    }
    let mut served = Vec::new();
    for (camera, answer) in waiting {
        let report = answer.await.expect("an answer").result().report.expect("always");
        served.push((report.queue_depth, camera));
    }
    // The first to be served leaves the most behind.
    served.sort_unstable();
    served.reverse();
    let order: Vec<_> = served.iter().map(|&(_, camera)| camera).collect();
    let heavy = order[..4].iter().filter(|&&camera| camera == "heavy").count();
    assert_eq!(heavy, 3, "{order:?}");
    assert_eq!(long.await.expect("an answer").status, 200);
}
