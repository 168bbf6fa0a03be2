//! Whoever is on the server's host reads results where the server has put them; everybody else gets bytes.

use prost::Message;
use serde_json::json;
use stereo_proto::v1;
use stereo_tests::zenoh::{Router, client, client_with};
use zenoh::Session;
use zenoh::Wait;
use zenoh::bytes::ZBytes;
use zenoh::sample::Sample;
use zenoh::shm::{PosixShmProviderBackend, ShmProvider, ShmProviderBuilder};

use super::network::{Camera, REQUEST, numbered, poll, serve, until_alive};
use crate::conversation::{Server, message};

const SENT: &str = "stereod_zenoh_results_total";

async fn sent(server: &Server, way: &str) -> f64 {
    server.metric(&format!("{SENT}{{way=\"{way}\"}}")).await
}

/// The same bytes, in memory that the server can read as long as the provider is kept.
fn shared(bytes: &[u8]) -> (ShmProvider<PosixShmProviderBackend>, ZBytes) {
    let provider = ShmProviderBuilder::default_backend(4 << 20)
        .wait()
        .expect("shared memory");
    let mut buffer = provider.alloc(bytes.len()).wait().expect("room for one pair");
    buffer.copy_from_slice(bytes);
    (provider, ZBytes::from(buffer))
}

async fn ask(session: &Session, payload: ZBytes) -> Sample {
    let replies = session
        .get("stereo/v1/compute")
        .payload(payload)
        .encoding(REQUEST)
        .timeout(std::time::Duration::from_secs(120))
        .await
        .expect("an open session");
    let reply = replies.recv_async().await.expect("a reply");
    reply.into_result().expect("a result")
}

#[tokio::test(flavor = "multi_thread")]
async fn a_result_is_read_where_it_lies_by_those_who_can_and_comes_as_bytes_to_others() {
    let router = Router::start().await.expect("a router on a free port");
    let server = serve(&router, "stereod", &[]);
    let near = client(router.endpoint())
        .await
        .expect("a connection to the router");
    let off = json!({ "transport": { "shared_memory": { "enabled": false } } });
    let far = client_with(router.endpoint(), off)
        .await
        .expect("a connection to the router");
    let camera = Camera::start(&near, "front").await;
    let elsewhere = far
        .declare_subscriber("stereo/v1/results/front")
        .await
        .expect("an open session");
    // A frame's result goes to whoever subscribes when the frame comes.
    let mut sequence = 0;
    let both = poll(async || {
        sequence += 1;
        camera.put(&numbered(sequence)).await;
        let near = camera.results.recv_async().await.expect("an open session");
        let far = elsewhere.try_recv().expect("an open session")?;
        Some((near, far))
    });
    let (near, far) = both.await.expect("both get results");
    assert!(near.payload().as_shm().is_some(), "the neighbour got a copy");
    assert!(far.payload().as_shm().is_none());
    let decode = |sample: &Sample| v1::StereoResult::decode(&*sample.payload().to_bytes());
    let (near, far) = (decode(&near).expect("a result"), decode(&far).expect("a result"));
    assert!(near.disparity == far.disparity && near.mesh == far.mesh);
    assert!(sent(&server, "shared_memory").await >= 1.0);
    assert_eq!(sent(&server, "no_room").await, 0.0);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_reply_goes_the_way_the_request_came() {
    let router = Router::start().await.expect("a router on a free port");
    let server = serve(&router, "stereod", &[]);
    let session = client(router.endpoint())
        .await
        .expect("a connection to the router");
    until_alive(&session, "stereo/v1/alive/stereod").await;
    let request = message().encode_to_vec();
    let by_bytes = ask(&session, ZBytes::from(request.clone())).await;
    assert!(by_bytes.payload().as_shm().is_none());
    let (_provider, payload) = shared(&request);
    let by_memory = ask(&session, payload).await;
    assert!(by_memory.payload().as_shm().is_some());
    let disparity = |sample: &Sample| {
        let result = v1::StereoResult::decode(&*sample.payload().to_bytes()).expect("a StereoResult");
        result.disparity.expect("a default output").data
    };
    assert!(disparity(&by_bytes) == disparity(&by_memory));
    assert_eq!(sent(&server, "network").await, 1.0);
    assert_eq!(sent(&server, "shared_memory").await, 1.0);
    let received = "stereod_zenoh_payloads_total{way=\"shared_memory\"}";
    assert_eq!(server.metric(received).await, 1.0);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_without_shared_memory_answers_all_the_same() {
    let router = Router::start().await.expect("a router on a free port");
    let file = std::env::temp_dir().join(format!("stereod-unshared-{}.json5", std::process::id()));
    std::fs::write(&file, "{ transport: { shared_memory: { enabled: false } } }").expect("a writable folder");
    let server = serve(
        &router,
        "stereod",
        &["--zenoh-config", file.to_str().expect("ASCII")],
    );
    let session = client(router.endpoint())
        .await
        .expect("a connection to the router");
    until_alive(&session, "stereo/v1/alive/stereod").await;
    std::fs::remove_file(&file).expect("the test's own file");
    let (_provider, payload) = shared(&message().encode_to_vec());
    let reply = ask(&session, payload).await;
    assert!(reply.payload().as_shm().is_none());
    v1::StereoResult::decode(&*reply.payload().to_bytes()).expect("a StereoResult");
    let camera = Camera::start(&session, "front").await;
    camera.put(&numbered(1)).await;
    assert_eq!(camera.result().await.sequence, Some(1));
    assert_eq!(sent(&server, "network").await, 2.0);
    assert_eq!(sent(&server, "shared_memory").await, 0.0);
}
