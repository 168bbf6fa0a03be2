//! A router, a server and a session of the test's, and what is said over them.

use std::time::{Duration, Instant};

use prost::Message;
use stereo_proto::v1;
use stereo_tests::zenoh::{Router, client};
use zenoh::Session;
use zenoh::bytes::Encoding;
use zenoh::handlers::FifoChannelHandler;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;
use zenoh::sample::{Sample, SampleKind};

use crate::conversation::{PAIR, Reply, Server};

pub(super) const REQUEST: &str = "application/protobuf;stereo.v1.StereoRequest";
pub(super) const IMAGE: &str = "application/protobuf;stereo.v1.Image";

/// A server behind a router.
pub(super) struct Network {
    _router: Router,
    pub(super) server: Server,
    pub(super) session: Session,
}

impl Network {
    /// With a server called `stereod`, which is there when this returns.
    pub(super) async fn start(args: &[&str]) -> Self {
        let router = Router::start().await.expect("a router on a free port");
        let server = serve(&router, "stereod", args);
        let session = client(router.endpoint())
            .await
            .expect("a connection to the router");
        until_alive(&session, "stereo/v1/alive/stereod").await;
        Self {
            _router: router,
            server,
            session,
        }
    }

    /// A camera that the server serves when this returns.
    pub(super) async fn camera(&self, name: &str) -> Camera {
        Camera::start(&self.session, name).await
    }

    /// What the server says about a camera's stream.
    pub(super) async fn stream(&self, camera: &str) -> serde_json::Value {
        let reply = self.server.get(&format!("/v1/streams/{camera}")).await;
        assert_eq!(reply.status, 200, "{}", reply.text());
        reply.json()
    }

    /// The stream as soon as it is as wanted.
    pub(super) async fn stream_when(
        &self,
        camera: &str,
        is_wanted: impl Fn(&serde_json::Value) -> bool,
    ) -> serde_json::Value {
        let mut last = serde_json::Value::Null;
        let wanted = poll(async || {
            last = self.stream(camera).await;
            is_wanted(&last).then(|| last.clone())
        });
        match wanted.await {
            Some(stream) => stream,
            None => panic!("the stream doesn't become what it should: {last}"),
        }
    }
}

/// Asks again and again until there is an answer; none if there is none in two minutes, where other tests would wait for ever.
pub(super) async fn poll<T>(mut ask: impl AsyncFnMut() -> Option<T>) -> Option<T> {
    let until = Instant::now() + Duration::from_mins(2);
    while Instant::now() < until {
        if let Some(answer) = ask().await {
            return Some(answer);
        }
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    None
}

/// A server that connects to a router.
pub(super) fn serve(router: &Router, instance: &str, args: &[&str]) -> Server {
    let own = ["--zenoh-connect", router.endpoint(), "--instance", instance];
    Server::start(&[&own, args].concat())
}

/// Waits for a liveliness token, whose key comes back.
pub(super) async fn until_alive(session: &Session, key: &str) -> String {
    let tokens = session
        .liveliness()
        .declare_subscriber(key)
        .history(true)
        .await
        .expect("an open session");
    loop {
        let token = tokens.recv_async().await.expect("an open session");
        if token.kind() == SampleKind::Put {
            return token.key_expr().to_string();
        }
    }
}

/// A camera as the server sees one.
pub(super) struct Camera {
    session: Session,
    name: String,
    _token: LivelinessToken,
    pub(super) results: Subscriber<FifoChannelHandler<Sample>>,
}

impl Camera {
    /// A camera that some server serves when this returns.
    pub(super) async fn start(session: &Session, name: &str) -> Self {
        let results = session
            .declare_subscriber(format!("stereo/v1/results/{name}"))
            .await
            .expect("an open session");
        let token = session
            .liveliness()
            .declare_token(format!("stereo/v1/camera/{name}"))
            .await
            .expect("an open session");
        until_alive(session, &format!("stereo/v1/owner/{name}/*")).await;
        Self {
            session: session.clone(),
            name: name.to_owned(),
            _token: token,
            results,
        }
    }

    /// Sends a pair in one message.
    pub(super) async fn put(&self, request: &v1::StereoRequest) {
        self.put_raw("", REQUEST, request.encode_to_vec(), None).await;
    }

    /// Sends anything under the camera's key.
    pub(super) async fn put_raw(
        &self,
        below: &str,
        encoding: &str,
        payload: Vec<u8>,
        stamp: Option<v1::ImageStamp>,
    ) {
        self.session
            .put(format!("stereo/v1/frames/{}{below}", self.name), payload)
            .encoding(Encoding::from(encoding))
            .attachment(stamp.map(|stamp| stamp.encode_to_vec()))
            .congestion_control(zenoh::qos::CongestionControl::Block)
            .await
            .expect("an open session");
    }

    /// The next result.
    pub(super) async fn result(&self) -> v1::StereoResult {
        let sample = self.results.recv_async().await.expect("an open session");
        assert_eq!(
            sample.encoding().to_string(),
            "application/protobuf;stereo.v1.StereoResult"
        );
        v1::StereoResult::decode(&*sample.payload().to_bytes()).expect("a StereoResult")
    }
}

/// The test pair with a number, and as much time as there is.
pub(super) fn numbered(sequence: u64) -> v1::StereoRequest {
    v1::StereoRequest {
        sequence: Some(sequence),
        ..crate::conversation::message()
    }
}

/// The stamp of a number alone.
pub(super) fn stamp(sequence: u64) -> Option<v1::ImageStamp> {
    Some(v1::ImageStamp {
        sequence: Some(sequence),
        timestamp: None,
    })
}

/// Asserts that a result is what the test pair gets over HTTP.
pub(super) fn assert_is_of_the_pair(result: &v1::StereoResult, expected: &Reply) {
    let map = result.disparity.as_ref().expect("a default output");
    let values: Vec<u16> = map
        .data
        .as_chunks::<2>()
        .0
        .iter()
        .map(|&bytes| u16::from_le_bytes(bytes))
        .collect();
    assert_eq!(values.len(), PAIR.rendered.left.pixels().len());
    assert!(values == expected.png16(), "another disparity than over HTTP");
}
