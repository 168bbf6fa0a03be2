//! The Rust client over Zenoh: a server for each request, another when that one fails, and a camera with its results.

use std::collections::BTreeMap;
use std::time::Duration;

use futures_util::future::join_all;
use stereo_client::{ClientError, Fleet};
use stereo_proto::v1;
use stereo_tests::zenoh::{Router, client};

use super::network::{Network, assert_is_of_the_pair, numbered, poll, serve, stamp, until_alive};
use crate::conversation::{Server, message};

const SERVERS: [&str; 3] = ["one", "two", "three"];

/// Servers behind a router that all tell their load.
async fn servers(router: &Router, names: &[&'static str]) -> (BTreeMap<&'static str, Server>, Fleet) {
    let servers = names
        .iter()
        .map(|&name| (name, serve(router, name, &[])))
        .collect();
    let session = client(router.endpoint())
        .await
        .expect("a connection to the router");
    let fleet = Fleet::over(session.clone()).await.expect("an open session");
    for name in names {
        until_alive(&session, &format!("stereo/v1/alive/{name}")).await;
    }
    // The client hears of them in its own time.
    let heard = poll(async || (fleet.servers().len() == names.len()).then_some(())).await;
    assert!(heard.is_some(), "the client knows of {:?}", fleet.servers());
    (servers, fleet)
}

pub(super) fn instance(result: &v1::StereoResult) -> &str {
    &result.report.as_ref().expect("always present").instance
}

#[tokio::test(flavor = "multi_thread")]
async fn no_request_is_lost_when_a_server_is_killed() {
    let router = Router::start().await.expect("a router on a free port");
    let (mut running, fleet) = servers(&router, &SERVERS).await;
    let first = fleet.match_pair(&message()).await.expect("a result");
    let victim = instance(&first).to_owned();
    // Some of them are at the victim when it goes, waiting or under way.
    let requests: Vec<_> = (0..24)
        .map(|sequence| {
            let fleet = fleet.clone();
            tokio::spawn(async move { fleet.match_pair(&numbered(sequence)).await })
        })
        .collect();
    running.remove(victim.as_str()).expect("a running server");
    for (sequence, answer) in (0..).zip(join_all(requests).await) {
        let result = answer.expect("a task that ends").expect("a result");
        assert_eq!(result.sequence, Some(sequence));
    }
    for sequence in 0..6 {
        let result = fleet.match_pair(&numbered(sequence)).await.expect("a result");
        assert_ne!(instance(&result), victim);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_second_server_answers_when_the_first_is_frozen() {
    let router = Router::start().await.expect("a router on a free port");
    let (mut running, fleet) = servers(&router, &SERVERS[..2]).await;
    let frozen = running.get_mut("one").expect("just started");
    frozen.process.signal("STOP").expect("a running server");
    // After 0.6 s of 60.
    let hedging = fleet.with_hedging(0.01);
    for sequence in 0..8 {
        let result = hedging.match_pair(&numbered(sequence)).await.expect("a result");
        assert_eq!(instance(&result), "two");
    }
    frozen.process.signal("CONT").expect("a frozen server");
}

#[tokio::test(flavor = "multi_thread")]
async fn what_no_server_can_do_is_said_at_once() {
    let network = Network::start(&[]).await;
    let fleet = Fleet::over(network.session.clone())
        .await
        .expect("an open session");
    let error = fleet
        .match_pair(&v1::StereoRequest {
            right: None,
            ..message()
        })
        .await
        .expect_err("half a pair");
    let ClientError::Refused(status) = error else {
        panic!("{error}")
    };
    assert_eq!(status.reason(), v1::Reason::Invalid);
    assert!(status.message.contains("right"), "{}", status.message);
}

#[tokio::test(flavor = "multi_thread")]
async fn without_a_server_the_client_says_so_when_the_budget_is_over() {
    let router = Router::start().await.expect("a router on a free port");
    let fleet = Fleet::connect(&[router.endpoint()]).await.expect("a connection");
    let options = v1::Options {
        latency_budget: Duration::from_millis(30).try_into().ok(),
        ..v1::Options::default()
    };
    let error = fleet
        .match_pair(&v1::StereoRequest {
            options: Some(options),
            ..message()
        })
        .await
        .expect_err("nobody is there");
    assert!(error.to_string().contains("no server is there"), "{error}");
    let error = Fleet::connect(&["nonsense"]).await.expect_err("no endpoint");
    assert!(matches!(error, ClientError::BadUrl { .. }), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_camera_sends_pairs_and_single_images_and_reads_its_results() {
    let network = Network::start(&[]).await;
    let fleet = Fleet::over(network.session.clone())
        .await
        .expect("an open session");
    let results = fleet.results("front").await.expect("an open session");
    let camera = fleet.camera("front").await.expect("an open session");
    let served = poll(async || camera.is_served().await.expect("an open session").then_some(())).await;
    assert!(served.is_some(), "no server takes the camera");
    let expected = network.server.good().await;
    camera.send(&numbered(1)).await.expect("an open session");
    let result = results.next().await.expect("a result");
    assert_eq!(result.sequence, Some(1));
    assert_is_of_the_pair(&result, &expected);

    let settings = v1::CameraSettings {
        options: message().options,
        pairing: Some(v1::Pairing {
            patience: Duration::from_secs(10).try_into().ok(),
            ..v1::Pairing::default()
        }),
        ..v1::CameraSettings::default()
    };
    super::settings::set(&network.session, "front", &settings)
        .await
        .expect("good settings");
    let mark: v1::ImageStamp = stamp(2).expect("always there");
    let pair = message();
    let left = pair.left.expect("a test image");
    let right = pair.right.expect("a test image");
    camera.send_left(&left, &mark).await.expect("an open session");
    camera.send_right(&right, &mark).await.expect("an open session");
    let result = results.next().await.expect("a result");
    assert_eq!(result.sequence, Some(2));
    assert_is_of_the_pair(&result, &expected);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_a_camera_misses_is_told_instead_of_waited_for() {
    let router = Router::start().await.expect("a router on a free port");
    let fleet = Fleet::connect(&[router.endpoint()]).await.expect("a connection");
    let results = fleet.results("front").await.expect("an open session");
    let none = async |words: &str| {
        let error = results
            .next_within(Duration::from_millis(10))
            .await
            .expect_err("no frame");
        assert!(matches!(error, ClientError::NoResults { .. }), "{error}");
        assert!(error.to_string().contains(words), "{error}");
    };
    none("it is not there: start it").await;
    let camera = fleet.camera("front").await.expect("an open session");
    let error = camera
        .until_served(Duration::from_millis(10))
        .await
        .expect_err("no server");
    assert!(
        error.to_string().contains("no server serves camera front"),
        "{error}"
    );
    none("no server serves it: start one").await;
    let server = serve(&router, "north", &[]);
    camera
        .until_served(Duration::from_mins(2))
        .await
        .expect("a server");
    none("north serves it but has answered no frame: `stereo doctor --camera front`").await;
    server.until_ready().await;
    camera.send(&numbered(1)).await.expect("an open session");
    let result = results
        .next_within(Duration::from_mins(2))
        .await
        .expect("a result");
    assert_eq!(result.sequence, Some(1));
}
