//! The Rust client against the real server.

use std::time::Duration;

use bytes::Bytes;
use stereo_client::{Accept, Client, ClientError, PairFiles, disparity_px};
use stereo_proto::v1;

use crate::conversation::{PAIR, Server, message};

fn client(server: &Server) -> Client {
    Client::new(server.process.url()).expect("an http address")
}

fn files() -> PairFiles {
    PairFiles {
        left: Bytes::from_static(&PAIR.left),
        right: Bytes::from_static(&PAIR.right),
        options_json: Some(r#"{"latency_budget_ms": 60000}"#.to_owned()),
    }
}

#[tokio::test]
async fn a_pair_comes_back_as_the_disparity_that_raw_http_gets() {
    let server = Server::start(&[]);
    let client = client(&server);
    client
        .ready(Duration::from_secs(60))
        .await
        .expect("a server that gets ready");
    let expected = server.good().await;
    let result = client.match_pair(&message()).await.expect("a result");
    let px = disparity_px(&result.disparity.expect("a default output")).expect("a whole map");
    for (px, fixed) in px.iter().zip(expected.png16()) {
        assert!(if fixed == 0 {
            px.is_nan()
        } else {
            *px == f32::from(fixed) / 256.0
        });
    }
    let reply = client
        .match_files(files(), Accept::DisparityPng)
        .await
        .expect("a file");
    assert!(reply.body == expected.body);
    assert!(
        reply
            .stages
            .get("match")
            .is_some_and(|took| took > Duration::ZERO)
    );
    assert_eq!(client.info().await.expect("a description").workers, 1);
}

#[tokio::test]
async fn a_refusal_arrives_as_the_servers_status() {
    let server = Server::start(&[]);
    let lonely = v1::StereoRequest {
        right: None,
        ..message()
    };
    let error = client(&server)
        .match_pair(&lonely)
        .await
        .expect_err("half a pair");
    let status = error.status().expect("a refusal");
    assert_eq!((status.code, status.reason()), (400, v1::Reason::Invalid));
    assert!(status.message.contains("right image"), "{}", status.message);
    let unknown = PairFiles {
        options_json: Some(r#"{"colour": 1}"#.to_owned()),
        ..files()
    };
    let error = client(&server)
        .match_files(unknown, Accept::Glb)
        .await
        .expect_err("an unknown option");
    assert!(
        error
            .status()
            .is_some_and(|s| s.code == 400 && s.message.contains("colour")),
        "{error}"
    );
}

#[tokio::test]
async fn a_server_that_is_gone_is_unreachable() {
    let server = Server::start(&[]);
    let client = client(&server);
    server.process.stop().expect("a running server");
    let error = client.match_pair(&message()).await.expect_err("nobody answers");
    assert!(matches!(error, ClientError::Unreachable { .. }), "{error}");
}
