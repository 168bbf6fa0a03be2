//! Clients of different weight.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use stereo_proto::v1;

use tokio::task::JoinSet;

use crate::conversation::{PROTOBUF, Server, message};

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

/// A server with a camera of three times the weight of any other, ready.
async fn with_a_heavy_camera(test: &str) -> Server {
    let file = std::env::temp_dir().join(format!("stereod-{test}-{}.toml", std::process::id()));
    std::fs::write(&file, "[clients.robot]\nweight = 3\ncameras = [\"heavy\"]\n").expect("a file");
    let server = Server::start(&["--config", file.to_str().expect("a plain path")]);
    std::fs::remove_file(file).expect("the test's own file");
    server.until_ready().await;
    server
}

#[tokio::test]
async fn a_client_of_three_times_the_weight_is_served_three_times_as_often() {
    let server = with_a_heavy_camera("background").await;
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

/// Two megapixels that are due within half a second.
fn urgent(camera: &str) -> v1::StereoRequest {
    let mut request = v1::StereoRequest {
        camera_id: camera.to_owned(),
        ..crate::lifecycle::large_message()
    };
    let options = request.options.get_or_insert_default();
    options.set_preset(v1::Preset::Default);
    options.latency_budget = Some(prost_types::Duration {
        seconds: 0,
        nanos: 500_000_000,
    });
    request
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn of_two_clients_that_want_more_than_there_is_the_one_of_three_times_the_weight_gets_most() {
    let server = Arc::new(with_a_heavy_camera("deadline").await);
    let left = Arc::new(AtomicU32::new(120));
    let mut clients = JoinSet::new();
    for camera in ["light", "heavy"].repeat(16) {
        let (server, left) = (Arc::clone(&server), Arc::clone(&left));
        let body = prost::Message::encode_to_vec(&urgent(camera));
        clients.spawn(async move {
            let mut served = 0_u32;
            while left.load(Ordering::Relaxed) > 0 {
                let answer = server.post_bytes(PROTOBUF, PROTOBUF, body.clone()).await;
                assert!(
                    matches!(answer.status, 200 | 429 | 503 | 504),
                    "{}",
                    answer.text()
                );
                if answer.status == 200 {
                    served += 1;
                    let _ = left.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |n| n.checked_sub(1));
                }
            }
            (camera, served)
        });
    }
    let (mut light, mut heavy) = (0, 0);
    while let Some(client) = clients.join_next().await {
        match client.expect("no panic") {
            ("light", served) => light += served,
            (_, served) => heavy += served,
        }
    }
    assert!(heavy > light && light > 0, "heavy {heavy}, light {light}");
}
