//! The Rust client among servers that take a request and go, or refuse it.

use std::time::Duration;

use prost::Message;
use stereo_client::{ClientError, Fleet};
use stereo_proto::v1;
use stereo_tests::zenoh::{Router, client};
use tokio::task::JoinHandle;
use zenoh::Session;
use zenoh::handlers::FifoChannelHandler;
use zenoh::liveliness::LivelinessToken;
use zenoh::query::{Query, Queryable};

use super::clients::instance;
use super::network::{poll, serve, until_alive};
use crate::conversation::message;

/// Looks like a server to others, and answers as the test says.
struct Impostor {
    asked: Queryable<FifoChannelHandler<Query>>,
    token: LivelinessToken,
    telling: JoinHandle<()>,
}

impl Impostor {
    async fn start(session: &Session, name: &str) -> Self {
        let key = |kind| format!("stereo/v1/{kind}/{name}");
        let asked = session
            .declare_queryable(key("compute"))
            .await
            .expect("an open session");
        let load = v1::ServerLoad {
            instance: name.to_owned(),
            workers: 1,
            ..v1::ServerLoad::default()
        };
        let (loads, load_key, load) = (session.clone(), key("load"), load.encode_to_vec());
        let telling = tokio::spawn(async move {
            while loads.put(&load_key, load.as_slice()).await.is_ok() {
                tokio::time::sleep(Duration::from_millis(200)).await;
            }
        });
        let token = session
            .liveliness()
            .declare_token(key("alive"))
            .await
            .expect("an open session");
        Self {
            asked,
            token,
            telling,
        }
    }

    async fn request(&self) -> Query {
        self.asked.recv_async().await.expect("an open session")
    }

    /// Is gone for everybody, but what it was asked is never answered: as one looks whose answer is lost.
    async fn go(self) {
        self.telling.abort();
        self.token.undeclare().await.expect("an open session");
    }
}

/// A router, and a session of those that look like servers.
async fn network() -> (Router, Session) {
    let router = Router::start().await.expect("a router on a free port");
    let session = client(router.endpoint())
        .await
        .expect("a connection to the router");
    (router, session)
}

/// A request on its way to the only server that is there.
async fn ask(router: &Router) -> JoinHandle<Result<v1::StereoResult, ClientError>> {
    // Takes a while the first time.
    let request = message();
    let fleet = Fleet::connect(&[router.endpoint()]).await.expect("a connection");
    let heard = poll(async || (fleet.servers().len() == 1).then_some(())).await;
    assert!(heard.is_some(), "the client knows of {:?}", fleet.servers());
    tokio::spawn(async move { fleet.match_pair(&request).await })
}

#[tokio::test(flavor = "multi_thread")]
async fn another_server_is_asked_when_the_one_that_was_asked_has_gone_without_an_answer() {
    let (router, session) = network().await;
    let lost = Impostor::start(&session, "lost").await;
    let request = ask(&router).await;
    let unanswered = lost.request().await;
    let _two = serve(&router, "two", &[]);
    lost.go().await;
    let result = request.await.expect("a task that ends").expect("a result");
    assert_eq!(instance(&result), "two");
    drop(unanswered);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_third_server_is_asked_when_the_first_has_gone_and_the_second_refuses() {
    let (router, session) = network().await;
    let lost = Impostor::start(&session, "lost").await;
    let request = ask(&router).await;
    let unanswered = lost.request().await;
    let full = Impostor::start(&session, "full").await;
    lost.go().await;
    let refused = full.request().await;
    let _three = serve(&router, "three", &[]);
    until_alive(&session, "stereo/v1/alive/three").await;
    let status = v1::Status {
        reason: v1::Reason::QueueFull.into(),
        ..v1::Status::default()
    };
    refused
        .reply_err(status.encode_to_vec())
        .await
        .expect("an open session");
    drop(refused);
    let result = request.await.expect("a task that ends").expect("a result");
    assert_eq!(instance(&result), "three");
    drop(unanswered);
}
