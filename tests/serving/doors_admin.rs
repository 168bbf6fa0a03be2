//! The second address, for whoever runs the server.

use stereo_tests::process::Stereod;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

use crate::doors::{ConfigFile, Logging, token};

async fn status(url: &str, method: reqwest::Method) -> u16 {
    let client = stereo_tests::http::builder()
        .no_proxy()
        .build()
        .expect("a client");
    let answer = client.request(method, url).send().await;
    answer.expect("an answer").status().as_u16()
}

/// The beginning of the answer on a new connection, and that. By hand: whoever finds no place is told before it has asked.
async fn answer(address: &str) -> (String, TcpStream) {
    let mut stream = TcpStream::connect(address).await.expect("a listening server");
    stream
        .write_all(b"GET /livez HTTP/1.1\r\nHost: x\r\n\r\n")
        .await
        .expect("room");
    let mut start = [0; 12];
    stream.read_exact(&mut start).await.expect("an answer");
    (String::from_utf8_lossy(&start).into_owned(), stream)
}

#[tokio::test]
async fn metrics_are_at_the_second_address_alone_and_nothing_else_is() {
    let (_, section) = token("lab");
    let config = ConfigFile::new("admin", &section);
    let server = Stereod::start(&[
        "--workers",
        "1",
        "--no-zenoh",
        "--admin",
        "127.0.0.1:0",
        "--config",
        config.path(),
    ])
    .expect("a server that starts");
    let admin = server.admin_url().expect("it has one");
    for (path, at_first, at_second) in [
        ("/metrics", 404, 200),
        ("/livez", 200, 200),
        ("/v1/info", 401, 404),
        ("/v1/streams", 401, 404),
        ("/", 200, 404),
        ("/docs/", 200, 404),
    ] {
        let get = reqwest::Method::GET;
        assert_eq!(
            status(&format!("{}{path}", server.url()), get.clone()).await,
            at_first,
            "{path}"
        );
        assert_eq!(status(&format!("{admin}{path}"), get).await, at_second, "{path}");
    }
    for path in ["/v1/stereo", "/v1/stereo/batch"] {
        assert_eq!(
            status(&format!("{admin}{path}"), reqwest::Method::POST).await,
            404,
            "{path}"
        );
    }
    assert!(matches!(
        status(&format!("{admin}/readyz"), reqwest::Method::GET).await,
        200 | 503
    ));
    assert!(server.stop().expect("a signal").success());
}

#[tokio::test]
async fn a_server_without_free_places_still_tells_its_metrics() {
    let server = Stereod::start(&[
        "--workers",
        "1",
        "--no-zenoh",
        "--admin",
        "127.0.0.1:0",
        "--max-connections",
        "1",
    ])
    .expect("a server that starts");
    let first = server.url().trim_start_matches("http://");
    let (start, only) = answer(first).await;
    assert_eq!(start, "HTTP/1.1 200");
    assert_eq!(answer(first).await.0, "HTTP/1.1 503");
    let admin = server.admin_url().expect("it has one");
    assert_eq!(
        status(&format!("{admin}/metrics"), reqwest::Method::GET).await,
        200
    );
    drop(only);
}

#[tokio::test]
async fn a_second_address_has_64_places() {
    let server = Stereod::start(&["--workers", "1", "--no-zenoh", "--admin", "127.0.0.1:0"]);
    let server = server.expect("a server that starts");
    let admin = server
        .admin_url()
        .expect("it has one")
        .trim_start_matches("http://");
    let mut open = Vec::new();
    for _ in 0..64 {
        let (start, stream) = answer(admin).await;
        assert_eq!(start, "HTTP/1.1 200");
        open.push(stream);
    }
    assert_eq!(answer(admin).await.0, "HTTP/1.1 503");
    let get = reqwest::Method::GET;
    // The first address has its own.
    assert_eq!(status(&format!("{}/livez", server.url()), get).await, 200);
    drop(open);
}

#[test]
fn whatever_is_open_to_more_than_this_machine_says_so() {
    let (_, section) = token("lab");
    let config = ConfigFile::new("warnings", &section);
    let log = |test: &str, args: &[&str]| Logging::start(test, &[&["--log", "warn"], args].concat()).log();
    let own = log("admin-own", &["--http", "127.0.0.1:0", "--admin", "127.0.0.1:0"]);
    assert!(!own.contains("anybody") && !own.contains("in the clear"), "{own}");
    let admin = log("admin-open", &["--http", "127.0.0.1:0", "--admin", "0.0.0.0:0"]);
    assert!(
        admin.contains("anybody who reaches this address can read the server's metrics"),
        "{admin}"
    );
    let clear = log("clear", &["--http", "0.0.0.0:0", "--config", config.path()]);
    assert!(
        clear.contains("in the clear") && clear.contains("--tls-cert"),
        "{clear}"
    );
}
