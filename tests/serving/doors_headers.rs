//! What browsers are told about answers: what they may do with them.

use stereo_tests::process::Stereod;

use crate::doors::GUARDED;

#[tokio::test]
async fn every_answer_may_be_framed_by_nobody_and_is_what_it_says_it_is() {
    let server = Stereod::start(&["--workers", "1", "--no-zenoh"]).expect("a server that starts");
    let client = stereo_tests::http::builder()
        .no_proxy()
        .build()
        .expect("a client");
    let pages = ["/", "/docs/", "/docs/index.html", "/docs/swagger-ui-bundle.js"];
    let others = [
        "/livez",
        "/readyz",
        "/openapi.json",
        "/v1/schema.binpb",
        "/nothing",
    ];
    let paths = GUARDED.iter().map(|&(_, path)| path).chain(pages).chain(others);
    for path in paths {
        let answer = client
            .get(format!("{}{path}", server.url()))
            .send()
            .await
            .expect("an answer");
        let header = |name: &str| {
            let value = answer.headers().get(name);
            value
                .map_or("", |value| value.to_str().expect("ASCII"))
                .to_owned()
        };
        let policy = header("content-security-policy");
        assert!(policy.starts_with("default-src 'none'"), "{path}: {policy}");
        assert!(policy.contains("frame-ancestors 'none'"), "{path}: {policy}");
        assert!(
            !policy.contains('*') && !policy.contains("unsafe-eval"),
            "{path}: {policy}"
        );
        assert_eq!(header("x-content-type-options"), "nosniff", "{path}");
        if pages.contains(&path) {
            assert_eq!(header("referrer-policy"), "no-referrer", "{path}");
            assert!(
                policy.contains("base-uri 'none'") && policy.contains("form-action 'none'"),
                "{path}"
            );
        }
        if path == "/" {
            assert!(!policy.contains("unsafe"), "{policy}");
        }
    }
}
