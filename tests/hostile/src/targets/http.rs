//! A whole request to the routes of HTTP, written as HTTP/1.1 would be: a line, headers, an empty line, the body.

use std::sync::OnceLock;

use axum::Router;
use axum::body::Body;
use axum::http::{Request, StatusCode};
use http_body_util::BodyExt;
use stereod::Server;
use stereod::config::Config;
use stereod::status::LONGEST_TEXT;
use tokio::runtime::Runtime;
use tower::ServiceExt;

/// A problem has a few names around its sentence, in which JSON writes a character with six at most.
const LONGEST_PROBLEM: usize = 7 * LONGEST_TEXT;

pub(crate) fn http(bytes: &[u8]) -> bool {
    static SERVER: OnceLock<(Runtime, Router)> = OnceLock::new();
    let Some(request) = request(bytes) else {
        return false;
    };
    let (runtime, router) = SERVER.get_or_init(start);
    let name = format!("{} {}", request.method(), request.uri());
    runtime.block_on(async {
        let Ok(answer) = router.clone().oneshot(request).await;
        let status = answer.status();
        assert_ne!(status, StatusCode::INTERNAL_SERVER_ERROR, "{name}");
        let Ok(body) = answer.into_body().collect().await else {
            // A batch that breaks off says so by breaking off.
            return false;
        };
        let bytes = body.to_bytes().len();
        assert!(
            status.is_success() || bytes <= LONGEST_PROBLEM,
            "{name}: {status} in {bytes} bytes"
        );
        // Busy, or late, is no word about the bytes.
        !status.is_client_error()
    })
}

#[expect(clippy::expect_used, reason = "without a server nothing can be tried")]
fn start() -> (Runtime, Router) {
    let mut config = Config::default();
    config.workers.count = 1;
    config.zenoh.enabled = false;
    config.limits.body_bytes = 1 << 16;
    config.limits.image_pixels = 1 << 13;
    let runtime = Runtime::new().expect("a runtime");
    let entered = runtime.enter();
    let routes = Server::routes(&config).expect("a server");
    drop(entered);
    let ready = || Request::get("/readyz").body(Body::empty()).expect("a request");
    while !runtime
        .block_on(routes.clone().oneshot(ready()))
        .is_ok_and(|answer| answer.status().is_success())
    {
        std::thread::yield_now();
    }
    (runtime, routes)
}

/// What a client that writes this would have sent, if HTTP allows it.
fn request(bytes: &[u8]) -> Option<Request<Body>> {
    let end = bytes.windows(2).position(|two| two == b"\n\n")?;
    let (head, body) = (&bytes[..end], &bytes[end + 2..]);
    let mut lines = head.split(|&byte| byte == b'\n');
    let mut first = lines.next()?.splitn(2, |&byte| byte == b' ');
    let mut request = Request::builder().method(first.next()?).uri(first.next()?);
    for line in lines {
        let mut parts = line.splitn(2, |&byte| byte == b':');
        request = request.header(parts.next()?, parts.next()?.trim_ascii());
    }
    request.body(Body::from(body.to_vec())).ok()
}
