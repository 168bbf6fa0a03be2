use axum::body::Body;
use axum::http::{HeaderMap, Request, StatusCode};
use bytes::Bytes;
use http_body_util::BodyExt;
use prost::Message;
use stereo_proto::v1;
use tower::ServiceExt;

use super::*;

/// A router with a service of one worker behind it.
fn server() -> (Router, Arc<Service>) {
    let mut config = Config::default();
    config.workers.count = 1;
    config.limits.body_bytes = 1 << 20;
    let service = Arc::new(Service::start(&config).unwrap());
    let streams = Arc::new(Streams::new(service.metrics()));
    (
        routers(&config, "scalar", Arc::clone(&service), streams).public,
        service,
    )
}

struct Answer {
    status: StatusCode,
    headers: HeaderMap,
    body: Bytes,
}

impl Answer {
    fn header(&self, name: &str) -> &str {
        self.headers.get(name).map_or("", |value| value.to_str().unwrap())
    }

    fn json(&self) -> serde_json::Value {
        serde_json::from_slice(&self.body).unwrap()
    }
}

async fn ask(router: &Router, request: Request<Body>) -> Answer {
    let (parts, body) = router.clone().oneshot(request).await.unwrap().into_parts();
    Answer {
        status: parts.status,
        headers: parts.headers,
        body: body.collect().await.unwrap().to_bytes(),
    }
}

fn post(headers: &[(&str, &str)], body: impl Into<Body>) -> Request<Body> {
    post_to("/v1/stereo", headers, body)
}

fn post_to(path: &str, headers: &[(&str, &str)], body: impl Into<Body>) -> Request<Body> {
    let request = Request::post(path);
    headers
        .iter()
        .fold(request, |request, &(name, value)| request.header(name, value))
        .body(body.into())
        .unwrap()
}

fn message() -> v1::StereoRequest {
    let image = |shift: u32| v1::Image {
        encoding: v1::ImageEncoding::Mono8.into(),
        width: 96,
        height: 64,
        step: 96,
        data: (0..96 * 64_u32)
            .map(|i| ((i % 96 + shift).wrapping_mul(0x9e37_79b9) >> 24).to_le_bytes()[0])
            .collect(),
        ..v1::Image::default()
    };
    let options = v1::Options {
        latency_budget: Some(prost_types::Duration {
            seconds: 60,
            nanos: 0,
        }),
        ..v1::Options::default()
    };
    v1::StereoRequest {
        left: Some(image(0)),
        right: Some(image(8)),
        options: Some(options),
        ..v1::StereoRequest::default()
    }
}

fn protobuf(headers: &[(&str, &str)]) -> Request<Body> {
    let all: Vec<_> = [("content-type", "application/x-protobuf")]
        .into_iter()
        .chain(headers.iter().copied())
        .collect();
    post(&all, message().encode_to_vec())
}

#[tokio::test]
async fn a_pair_is_answered_in_every_type_that_can_be_accepted() {
    let (router, _service) = server();
    for (path, accept, magic) in [
        ("/v1/stereo", "image/png", b"\x89PNG".as_slice()),
        ("/v1/stereo?view=color", "image/*", b"\x89PNG"),
        ("/v1/stereo", "model/gltf-binary", b"glTF"),
        ("/v1/stereo", "application/ply", b"ply\n"),
        ("/v1/stereo", "application/json", b"{"),
    ] {
        let headers = [("content-type", "application/x-protobuf"), ("accept", accept)];
        let answer = ask(&router, post_to(path, &headers, message().encode_to_vec())).await;
        assert_eq!(answer.status, StatusCode::OK, "{accept}: {:?}", answer.body);
        assert!(answer.body.starts_with(magic), "{accept}");
        assert!(
            answer.header("server-timing").starts_with("queue;dur="),
            "{accept}"
        );
    }
    let answer = ask(&router, protobuf(&[])).await;
    assert_eq!(answer.header("content-type"), "application/x-protobuf");
    assert!(v1::StereoResult::decode(answer.body).unwrap().report.is_some());
}

#[tokio::test]
async fn the_requests_name_is_echoed_or_made_up() {
    let (router, _service) = server();
    let named = ask(&router, protobuf(&[("x-request-id", "frame-7")])).await;
    assert_eq!(named.header("x-request-id"), "frame-7");
    assert_eq!(
        v1::StereoResult::decode(named.body).unwrap().request_id,
        "frame-7"
    );
    let nameless = ask(&router, Request::get("/livez").body(Body::empty()).unwrap()).await;
    assert!(nameless.header("x-request-id").starts_with("stereod-"));
    let unnameable = ask(&router, protobuf(&[("x-request-id", "")])).await;
    assert_eq!(unnameable.status, StatusCode::BAD_REQUEST);
}

#[tokio::test]
async fn refusals_of_protobuf_requests_are_a_status_unless_json_is_accepted() {
    let (router, _service) = server();
    let headers = [
        ("content-type", "application/x-protobuf"),
        ("x-request-id", "bad-1"),
    ];
    let answer = ask(&router, post(&headers, "this is no message")).await;
    assert_eq!(answer.status, StatusCode::BAD_REQUEST);
    assert_eq!(answer.header("content-type"), "application/x-protobuf");
    let status = v1::Status::decode(answer.body).unwrap();
    assert_eq!(
        (status.code, status.reason(), status.request_id.as_str()),
        (400, v1::Reason::Invalid, "bad-1")
    );
    let headers = [
        ("content-type", "application/x-protobuf"),
        ("accept", "application/json"),
    ];
    let answer = ask(&router, post(&headers, "this is no message")).await;
    assert_eq!(answer.header("content-type"), "application/problem+json");
    assert_eq!(answer.json()["reason"], "INVALID");
}

#[tokio::test]
async fn a_refusal_has_the_name_that_the_body_gives_the_request() {
    let (router, _service) = server();
    let headers = [
        ("content-type", "application/x-protobuf"),
        ("x-request-id", "head"),
    ];
    let lonely = |request_id: &str| v1::StereoRequest {
        request_id: request_id.to_owned(),
        right: None,
        ..message()
    };
    for (in_body, expected) in [("body", "body"), ("", "head"), ("not\nprintable", "head")] {
        let answer = ask(&router, post(&headers, lonely(in_body).encode_to_vec())).await;
        let status = v1::Status::decode(answer.body).unwrap();
        assert_eq!(
            (status.code, status.request_id.as_str()),
            (400, expected),
            "{in_body:?}"
        );
    }
}

#[tokio::test]
async fn every_wrong_head_has_its_status_and_a_sentence() {
    let (router, _service) = server();
    let get = |path: &str| Request::get(path).body(Body::empty()).unwrap();
    for (request, code, word) in [
        (get("/v2/stereo"), 404, "/v2/stereo"),
        (get("/v1/stereo"), 405, "POST"),
        (post_to("/v1/info", &[], ""), 405, "GET"),
        (post(&[("content-type", "text/plain")], "x"), 415, "text/plain"),
        (post(&[], "x"), 415, "multipart/form-data"),
        (
            protobuf(&[("accept", "text/html, application/problem+json")]),
            406,
            "model/gltf-binary",
        ),
        (
            protobuf(&[("x-latency-budget-ms", "0"), ("accept", "application/json")]),
            400,
            "X-Latency-Budget-Ms",
        ),
        (
            protobuf(&[("grpc-timeout", "soon"), ("accept", "application/json")]),
            400,
            "grpc-timeout",
        ),
        (
            post(
                &[("content-type", "multipart/form-data; boundary=x")],
                vec![0; 2 << 20],
            ),
            413,
            "1048576",
        ),
        (
            post(&[("content-type", "multipart/form-data; boundary=x")], "x"),
            400,
            "multipart",
        ),
        (
            post_to(
                "/v1/stereo?preset=paper",
                &[
                    ("content-type", "application/x-protobuf"),
                    ("accept", "application/json"),
                ],
                "x",
            ),
            400,
            "`preset`",
        ),
    ] {
        let what = format!("{} {}", request.method(), request.uri());
        let answer = ask(&router, request).await;
        assert_eq!(answer.status.as_u16(), code, "{what}: {:?}", answer.body);
        assert_eq!(
            answer.header("content-type"),
            "application/problem+json",
            "{what}"
        );
        let problem = answer.json();
        assert_eq!(problem["status"], code);
        assert!(
            problem["detail"].as_str().unwrap().contains(word),
            "{what}: {problem}"
        );
    }
    let allowed = ask(&router, get("/v1/stereo")).await;
    assert_eq!(allowed.header("allow"), "POST");
}

#[tokio::test]
async fn the_budget_of_a_header_counts_when_it_is_the_smallest() {
    let (router, _service) = server();
    let answer = ask(
        &router,
        protobuf(&[("x-latency-budget-ms", "30000"), ("grpc-timeout", "40S")]),
    )
    .await;
    let report = v1::StereoResult::decode(answer.body).unwrap().report.unwrap();
    assert_eq!(
        report.budget,
        Some(prost_types::Duration {
            seconds: 30,
            nanos: 0
        })
    );
    let late = ask(&router, protobuf(&[("x-latency-budget-ms", "0.001")])).await;
    assert_eq!(late.status, StatusCode::GATEWAY_TIMEOUT);
    assert_eq!(
        v1::Status::decode(late.body).unwrap().reason(),
        v1::Reason::Expired
    );
}

#[tokio::test]
async fn the_server_describes_itself() {
    let (router, service) = server();
    let get = async |path: &str| ask(&router, Request::get(path).body(Body::empty()).unwrap()).await;
    let info = get("/v1/info").await.json();
    assert_eq!(
        (info["version"].as_str(), info["workers"].as_u64()),
        (Some(env!("CARGO_PKG_VERSION")), Some(1))
    );
    assert_eq!(info["limits"]["body_bytes"], 1 << 20);
    let presets = info["presets"].as_array().unwrap();
    assert_eq!(presets[0]["name"], "default");
    let paper = presets.iter().find(|preset| preset["name"] == "paper").unwrap();
    assert_eq!(
        paper["rungs"].as_array().unwrap().len(),
        stereo::rung_names(stereo::Preset::Paper).len()
    );
    assert_eq!(get("/v1/schema.binpb").await.body, stereo_proto::DESCRIPTOR_SET);
    assert_eq!(get("/livez").await.status, StatusCode::OK);
    service.primed().await;
    assert_eq!(get("/readyz").await.json()["status"], "ready");
}

#[tokio::test]
async fn a_stopping_server_says_so_everywhere() {
    let (router, service) = server();
    service.drain().await;
    let ready = ask(&router, Request::get("/readyz").body(Body::empty()).unwrap()).await;
    assert_eq!(ready.status, StatusCode::SERVICE_UNAVAILABLE);
    assert!(ready.json()["why"].as_str().unwrap().contains("stopping"));
    let refused = ask(&router, protobuf(&[])).await;
    assert_eq!(refused.status, StatusCode::SERVICE_UNAVAILABLE);
    assert_eq!(refused.header("retry-after"), "1");
    assert_eq!(
        v1::Status::decode(refused.body).unwrap().reason(),
        v1::Reason::Draining
    );
    assert_eq!(
        ask(&router, Request::get("/livez").body(Body::empty()).unwrap())
            .await
            .status,
        StatusCode::OK
    );
}

/// A batch whose body is `pieces`, and how it ended by the metrics.
async fn end_of_batch(pieces: Vec<std::io::Result<Bytes>>) -> (Bytes, String) {
    let (router, service) = server();
    let body = Body::from_stream(futures_util::stream::iter(pieces));
    let headers = [("content-type", "application/x-protobuf; delimited=true")];
    let answer = ask(&router, post_to("/v1/stereo/batch", &headers, body)).await;
    assert_eq!(answer.status, StatusCode::OK);
    // The replies end with the task that makes them, which counts itself last.
    let ended = |text: &str| {
        let lines = text
            .lines()
            .filter_map(|line| line.strip_prefix("stereod_batches_ended_total"));
        let mut ended = lines.filter_map(|line| line.strip_suffix(" 1"));
        ended.next().map(str::to_owned)
    };
    loop {
        if let Some(ended) = ended(&service.metrics_text()) {
            return (answer.body, ended);
        }
        tokio::task::yield_now().await;
    }
}

#[tokio::test]
async fn a_batch_whose_connection_is_lost_counts_as_hung_up_even_while_its_replies_are_still_open() {
    let whole = Bytes::from(message().encode_length_delimited_to_vec());
    let reset = std::io::Error::from(std::io::ErrorKind::ConnectionReset);
    let (replies, ended) = end_of_batch(vec![Ok(whole), Err(reset)]).await;
    assert_eq!(ended, "{outcome=\"hung_up\"}");
    // What was whole is answered, and who can still read finds why there is no more.
    let mut rest = replies;
    let first = v1::BatchReply::decode_length_delimited(&mut rest).unwrap();
    assert!(matches!(first.outcome, Some(v1::batch_reply::Outcome::Result(_))));
    let last = v1::BatchReply::decode_length_delimited(&mut rest).unwrap();
    assert!(matches!(last.outcome, Some(v1::batch_reply::Outcome::Status(status)) if status.code == 400));
}

#[tokio::test]
async fn a_batch_with_something_broken_in_it_counts_as_broken_off() {
    let whole = Bytes::from(message().encode_length_delimited_to_vec());
    let half = whole.slice(..whole.len() / 2);
    let broken_chunk = || Err(std::io::Error::from(std::io::ErrorKind::InvalidInput));
    for pieces in [vec![Ok(half)], vec![Ok(whole), broken_chunk()]] {
        let (_, ended) = end_of_batch(pieces).await;
        assert_eq!(ended, "{outcome=\"broken_off\"}");
    }
}
