//! Routers and servers that come, go and come again.

use stereo_tests::zenoh::{Router, RouterProcess, client};
use zenoh::sample::SampleKind;

use super::network::{Camera, Network, numbered, poll, serve, until_alive};
use super::queries::compute;
use crate::conversation::{Server, message};

/// An endpoint at which nobody listens, and nobody else will.
async fn free_endpoint() -> String {
    let router = Router::start().await.expect("a router on a free port");
    let endpoint = router.endpoint().to_owned();
    router.stop().await.expect("a router that stops");
    endpoint
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_starts_without_its_router_and_finds_it_when_it_comes() {
    let endpoint = free_endpoint().await;
    let connect = ["--zenoh-connect", endpoint.as_str()];
    let server = Server::start(&connect);
    let strict = Server::start(&[&connect[..], &["--require-zenoh", "--instance", "strict"]].concat());
    server.until_ready().await;
    assert_eq!(server.good().await.status, 200, "HTTP needs no router");
    let mut why = String::new();
    let told = poll(async || {
        let reply = strict.get("/readyz").await;
        why = reply.json()["why"].as_str().unwrap_or_default().to_owned();
        assert_eq!(reply.status, 503, "{why}");
        why.contains("router").then_some(())
    });
    assert!(told.await.is_some(), "{why}");
    let router = Router::start_with(&endpoint, serde_json::json!({}))
        .await
        .expect("a router on the free port");
    let session = client(router.endpoint())
        .await
        .expect("a connection to the router");
    until_alive(&session, "stereo/v1/alive/stereod").await;
    compute(&session, "stereo/v1/compute/stereod", &message())
        .await
        .expect("a result");
    strict.until_ready().await;
    assert_eq!(strict.get("/readyz").await.json()["zenoh"]["state"], "open");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stream_goes_on_by_itself_after_the_router_was_restarted() {
    let router = Router::start().await.expect("a router on a free port");
    let endpoint = router.endpoint().to_owned();
    let _server = serve(&router, "stereod", &[]);
    let session = client(&endpoint).await.expect("a connection to the router");
    let camera = Camera::start(&session, "front").await;
    camera.put(&numbered(1)).await;
    camera.result().await;
    router.stop().await.expect("a router that stops");
    let _router = Router::start_with(&endpoint, serde_json::json!({}))
        .await
        .expect("the same port");
    let mut sequence = 1;
    let again = loop {
        sequence += 1;
        camera.put(&numbered(sequence)).await;
        match tokio::time::timeout(std::time::Duration::from_millis(100), camera.result()).await {
            Ok(result) => break result,
            Err(_) => continue,
        }
    };
    assert!(again.sequence > Some(1));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stream_goes_on_by_itself_after_the_router_was_frozen() {
    let router = RouterProcess::start("tcp/127.0.0.1:0", None).expect("a router on a free port");
    let server = Server::start(&["--zenoh-connect", router.endpoint()]);
    let session = client(router.endpoint())
        .await
        .expect("a connection to the router");
    let camera = Camera::start(&session, "front").await;
    camera.put(&numbered(1)).await;
    camera.result().await;
    router.signal("STOP").expect("a running router");
    // The server has given it up, after a lease.
    let connections = async || server.get("/readyz").await.json()["zenoh"]["connections"].as_u64();
    let alone = poll(async || (connections().await == Some(0)).then_some(())).await;
    assert!(alone.is_some(), "the server doesn't notice");
    router.signal("CONT").expect("a frozen router");
    let mut sequence = 1;
    let again = poll(async || {
        sequence += 1;
        camera.put(&numbered(sequence)).await;
        let result = tokio::time::timeout(std::time::Duration::from_millis(100), camera.result());
        result.await.ok()
    });
    let again = again.await.expect("the stream goes on");
    assert!(again.sequence > Some(1));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_that_stops_withdraws_answers_what_it_has_and_exits_with_success() {
    let network = Network::start(&[]).await;
    let camera = network.camera("front").await;
    let tokens = network
        .session
        .liveliness()
        .declare_subscriber("stereo/v1/**")
        .history(true)
        .await
        .expect("an open session");
    camera.put(&numbered(1)).await;
    camera.result().await;
    let status = network.server.process.stop().expect("a running server");
    assert!(status.success(), "{status}");
    let mut gone = Vec::new();
    while gone.len() < 2 {
        let token = tokens.recv_async().await.expect("an open session");
        if token.kind() == SampleKind::Delete {
            gone.push(token.key_expr().to_string());
        }
    }
    gone.sort();
    assert_eq!(gone, ["stereo/v1/alive/stereod", "stereo/v1/owner/front/stereod"]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_without_zenoh_says_so_and_serves_http() {
    let server = Server::start(&["--no-zenoh"]);
    server.until_ready().await;
    assert_eq!(server.get("/readyz").await.json()["zenoh"]["state"], "off");
    assert_eq!(server.good().await.status, 200);
}

#[test]
fn a_bad_zenoh_configuration_ends_with_exit_code_64_and_says_where() {
    let file = std::env::temp_dir().join(format!("stereod-bad-{}.json5", std::process::id()));
    std::fs::write(&file, "{ transport: { link: { tx: { lease: 'long' } } } }").expect("a writable folder");
    let path = file.to_str().expect("ASCII");
    let bad: [(&[&str], &str); 3] = [
        (&["--zenoh-config", path], "stereod-bad"),
        (&["--zenoh-config", "no/such.json5"], "no/such.json5"),
        (&["--zenoh-connect", "nonsense"], "zenoh"),
    ];
    for (args, word) in bad {
        let all = [&["serve", "--http", "127.0.0.1:0"], args].concat();
        let output = stereo_tests::process::run(&all).expect("a program that runs");
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(64), "{args:?}: {message}");
        assert!(message.contains(word), "{args:?}: {message}");
    }
    std::fs::remove_file(&file).expect("the test's own file");
}
