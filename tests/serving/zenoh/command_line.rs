//! What `stereo` does with cameras and servers over Zenoh.

use std::time::Duration;

use prost::Message;
use serde_json::Value;
use stereo_proto::v1;
use stereo_tests::zenoh::{Router, client};

use super::network::{IMAGE, Network, serve, until_alive};
use crate::command_line::{Folder, stereo};
use crate::conversation::{PAIR, message};

/// The checks of `doctor`, by their names.
fn check<'a>(lines: &'a [Value], name: &str) -> &'a Value {
    let found = lines.iter().find(|line| line["check"] == name);
    found.unwrap_or_else(|| panic!("no check {name:?} in {lines:?}"))
}

#[tokio::test(flavor = "multi_thread")]
async fn a_pair_is_matched_by_whoever_is_on_the_network() {
    let router = Router::start().await.expect("a router on a free port");
    let folder = Folder::new("zenoh-match");
    let left = folder.write("left.png", &PAIR.left);
    let right = folder.write("right.png", &PAIR.right);
    let args = ["match", &left, &right, "--budget", "60s", "--json"];
    stereo(router.endpoint(), &args[..5]).assert(3, &["no server is on the network"]);
    let server = serve(&router, "north", &[]);
    server.until_ready().await;
    let session = client(router.endpoint())
        .await
        .expect("a connection to the router");
    until_alive(&session, "stereo/v1/alive/north").await;
    let said = stereo(router.endpoint(), &args);
    said.assert(0, &[]);
    assert_eq!(said.json()[0]["report"]["instance"], "north");
    stereo(router.endpoint(), &["info"]).assert(0, &["north", "backlog ms"]);
    let zenoh = router.endpoint().replace("tcp/", "zenoh://");
    let said = stereo(&zenoh, &["watch", "--once", "--json"]);
    said.assert(0, &[]);
    assert_eq!(said.json()[0]["servers"][0]["instance"], "north");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_folder_plays_as_a_camera_and_watch_shows_it() {
    let network = Network::start(&[]).await;
    let folder = Folder::new("stream");
    folder.pairs(2);
    let url = network.server.process.url();
    let args = [
        "stream",
        &folder.path(""),
        "--camera",
        "front",
        "--rate",
        "2",
        "--budget",
        "5s",
    ];
    let said = stereo(url, &[&args[..], &["--repeat", "2", "--json"]].concat());
    said.assert(0, &[]);
    let lines = said.json();
    let (summary, results) = lines.split_last().expect("a summary");
    assert_eq!(
        (&summary["camera"], &summary["sent"]),
        (&"front".into(), &4.into()),
        "{summary}"
    );
    assert_eq!(summary["results"], results.len(), "{summary}");
    assert_eq!(summary["without_result"], 4 - results.len(), "{summary}");
    assert!(
        results
            .iter()
            .all(|line| line["latency_ms"].as_f64().is_some_and(|ms| ms > 0.0)),
        "{lines:?}"
    );
    let said = stereo(url, &["watch", "--once", "--json"]);
    said.assert(0, &[]);
    let [sight] = said.json().try_into().expect("one line");
    assert_eq!(sight["streams"][0]["camera"], "front");
    let frames = &sight["streams"][0]["frames"];
    assert_eq!(
        (&frames["received"], &frames["answered_late"]),
        (&4.into(), &0.into()),
        "{sight}"
    );
    stereo(url, &["watch", "--once"]).assert(0, &["front", "in budget %", "late", "stereod"]);
}

#[tokio::test(flavor = "multi_thread")]
async fn doctor_finds_that_a_camera_is_missing_silent_or_well() {
    let network = Network::start(&[]).await;
    network.server.until_ready().await;
    let url = network.server.process.url();
    let args = [
        "doctor", "--json", "--camera", "front", "--size", "64x64", "--rate", "0.1", "--budget", "60s",
    ];
    let said = stereo(url, &args);
    said.assert(1, &[]);
    let lines = said.json();
    for name in [
        "server reachable",
        "server ready",
        "a pair in budget",
        "link fast enough",
        "servers alive",
    ] {
        assert_eq!(check(&lines, name)["ok"], true, "{lines:?}");
    }
    assert_eq!(check(&lines, "camera announced")["ok"], false);

    let camera = network.camera("front").await;
    let said = stereo(url, &[&args[..], &["--watch", "1ms"]].concat());
    said.assert(1, &[]);
    let lines = said.json();
    assert_eq!(check(&lines, "camera served")["ok"], true);
    let silent = check(&lines, "frames of front arrive");
    assert_eq!(silent["ok"], false, "{lines:?}");
    assert!(
        silent["found"]
            .as_str()
            .is_some_and(|text| text.contains("stereo/v1/frames/front")),
        "{silent}"
    );

    let url = url.to_owned();
    let asked = tokio::task::spawn_blocking(move || stereo(&url, &[&args[..], &["--watch", "2s"]].concat()));
    while !asked.is_finished() {
        camera.put(&message()).await;
        // Each frame is answered before the next is sent, so that none takes another's place.
        camera.result().await;
    }
    let said = asked.await.expect("a program that ends");
    said.assert(0, &[]);
    let lines = said.json();
    assert_eq!(check(&lines, "frames of front arrive")["ok"], true, "{lines:?}");
    assert_eq!(
        check(&lines, "frames of front in budget")["ok"],
        true,
        "{lines:?}"
    );
    assert_eq!(lines.last().expect("a summary")["failed"], 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn doctor_finds_that_images_are_too_far_apart_to_be_pairs() {
    let network = Network::start(&[]).await;
    network.server.until_ready().await;
    let camera = network.camera("front").await;
    let url = network.server.process.url().to_owned();
    let asked = tokio::task::spawn_blocking(move || {
        let args = [
            "doctor", "--json", "--camera", "front", "--size", "64x64", "--rate", "0.1", "--budget", "60s",
        ];
        stereo(&url, &[&args[..], &["--watch", "2s"]].concat())
    });
    let image = |image: Option<v1::Image>, ms: u32| {
        let timestamp = Some(prost_types::Timestamp {
            seconds: i64::from(ms / 1000),
            nanos: i32::try_from(ms % 1000 * 1_000_000).expect("under a second"),
        });
        v1::Image {
            timestamp,
            ..image.expect("a test image")
        }
        .encode_to_vec()
    };
    // The right camera is 40 ms behind the left one.
    for frame in 1.. {
        if asked.is_finished() {
            break;
        }
        let taken_ms = 100 * frame;
        camera
            .put_raw("/left", IMAGE, image(message().left, taken_ms), None)
            .await;
        camera
            .put_raw("/right", IMAGE, image(message().right, taken_ms + 40), None)
            .await;
        // A camera's pace.
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    let said = asked.await.expect("a program that ends");
    said.assert(1, &[]);
    let lines = said.json();
    assert_eq!(check(&lines, "frames of front arrive")["ok"], true, "{lines:?}");
    let unpaired = check(&lines, "images of front paired");
    assert_eq!(unpaired["ok"], false, "{lines:?}");
    let found = unpaired["found"].as_str().expect("a sentence");
    for words in ["alone", "40.0 ms away", "closer than the camera's tolerance"] {
        assert!(found.contains(words), "{found}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn doctor_finds_a_router_that_is_down_one_without_servers_and_a_link_that_is_too_slow() {
    let network = Network::start(&[]).await;
    network.server.until_ready().await;
    let url = network.server.process.url();
    let lonely = Router::start().await.expect("a router on a free port");
    // No link carries 2 MB ten thousand times a second.
    let args = [
        "doctor",
        "--json",
        "--size",
        "1024x1024",
        "--rate",
        "10000",
        "--budget",
        "60s",
    ];
    for (router, failed, words) in [
        ("tcp/127.0.0.1:1", "router reachable", "correct the address"),
        (
            lonely.endpoint(),
            "servers alive",
            "start one with --zenoh-connect",
        ),
    ] {
        let said = stereo(url, &[&args[..], &["--router", router]].concat());
        said.assert(3, &[]);
        let lines = said.json();
        for (name, words) in [
            (failed, words),
            ("link fast enough", "send JPEG or smaller images"),
        ] {
            let check = check(&lines, name);
            assert_eq!(check["ok"], false, "{lines:?}");
            assert!(
                check["found"].as_str().is_some_and(|text| text.contains(words)),
                "{check}"
            );
        }
    }
    let said = stereo(
        url,
        &["doctor", "--json", "--size", "1024x1024", "--budget", "1ms"],
    );
    let lines = said.json();
    let late = check(&lines, "a pair in budget");
    assert_eq!(late["ok"], false, "{lines:?}");
    assert!(
        late["found"]
            .as_str()
            .is_some_and(|text| text.contains("larger budget")),
        "{late}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn doctor_says_that_zenoh_is_off() {
    let server = crate::conversation::Server::start(&["--no-zenoh"]);
    server.until_ready().await;
    let said = stereo(
        server.process.url(),
        &["doctor", "--budget", "60s", "--rate", "0.1"],
    );
    said.assert(1, &["1 of the checks failed"]);
    assert!(
        said.stdout().contains("FAIL  server's Zenoh: it is switched off"),
        "{}",
        said.stdout()
    );
}
