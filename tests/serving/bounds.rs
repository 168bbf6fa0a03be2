//! Everything that a client could make grow has a bound; the README's table has all of them, and each is gone over, here or where the
//! table's last column says.

use std::collections::BTreeSet;

use prost::Message;
use serde_json::json;
use stereo_proto::v1;
use stereod::config::Config;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::task::JoinSet;

use crate::conversation::{PROTOBUF, Server, message};
use crate::lifecycle::large_message;

const README: &str = include_str!("../../README.md");

async fn connect(server: &Server) -> TcpStream {
    let address = server.process.url().trim_start_matches("http://").to_owned();
    TcpStream::connect(address).await.expect("a listening server")
}

/// Sends bytes and reads the answer's first line.
async fn status_line(server: &Server, bytes: &[u8]) -> String {
    let mut stream = connect(server).await;
    // It may be refused before all of it is sent.
    drop(stream.write_all(bytes).await);
    let mut answer = [0; 12];
    stream.read_exact(&mut answer).await.expect("an answer");
    String::from_utf8_lossy(&answer).into_owned()
}

/// The cells of the table of limits, row by row.
fn rows() -> Vec<Vec<&'static str>> {
    let (_, rest) = README
        .split_once("<!-- limits:begin -->")
        .expect("a table of limits");
    let (table, _) = rest.split_once("<!-- limits:end -->").expect("its end");
    let rows = table.lines().filter(|line| line.starts_with('|')).skip(2);
    rows.map(|row| row.trim_matches('|').split('|').map(str::trim).collect())
        .collect()
}

#[test]
fn the_table_of_limits_has_every_limit_of_the_configuration_and_its_default() {
    let mut config = Config::default();
    // Of the machine.
    config.workers.count = 1;
    let config = serde_json::to_value(config).expect("numbers and strings");
    let mut named = BTreeSet::new();
    for row in rows() {
        let [_, default, key, ..] = row.as_slice() else {
            panic!("too few cells: {row:?}");
        };
        // A client has keys of its own, without a default.
        let Some(key) = key.split('`').nth(1).filter(|key| key.contains('.')) else {
            continue;
        };
        let value = key.split('.').fold(&config, |value, part| &value[part]);
        let value = value
            .as_u64()
            .unwrap_or_else(|| panic!("{key} is no number: {value}"));
        assert_eq!(in_plain_numbers(default), value, "{key}");
        named.insert(key.to_owned());
    }
    for section in ["http", "limits", "workers"] {
        let numbers = config[section].as_object().expect("a section").iter();
        for (key, _) in numbers.filter(|(_, value)| value.is_u64()) {
            let key = format!("{section}.{key}");
            // How much work there is to do, not how much may be asked for.
            if key != "workers.count" {
                assert!(
                    named.contains(&key),
                    "{key} is not in the README's table of limits"
                );
            }
        }
    }
}

/// `64 MiB`, `10 s`, `4096 x 4096`, `1024` in bytes, milliseconds, pixels.
fn in_plain_numbers(text: &str) -> u64 {
    let words = Vec::from_iter(text.split_whitespace());
    let number = |word: &str| {
        word.parse::<u64>()
            .unwrap_or_else(|_| panic!("{text:?} is no number"))
    };
    match words.as_slice() {
        [number_alone] => number(number_alone),
        [count, "MiB"] => number(count) << 20,
        [count, "s"] => number(count) * 1000,
        [width, "x", height, "px"] => number(width) * number(height),
        _ => panic!("what is {text:?}?"),
    }
}

#[test]
fn every_test_that_the_table_of_limits_names_is_there() {
    let sources = [
        include_str!("bounds.rs"),
        include_str!("bad_images.rs"),
        include_str!("batch.rs"),
        include_str!("crowds.rs"),
        include_str!("rough_clients.rs"),
        include_str!("doors.rs"),
        include_str!("doors_tls.rs"),
        include_str!("doors_admin.rs"),
        include_str!("../../server/src/pool/tests.rs"),
        include_str!("../../server/src/streams/tests.rs"),
        include_str!("../../server/src/decode/png.rs"),
        include_str!("../../server/src/decode/jpeg.rs"),
        include_str!("../../server/tests/connections.rs"),
    ];
    for row in rows() {
        let test = row.last().and_then(|cell| cell.split('`').nth(1));
        let test = test.unwrap_or_else(|| panic!("{row:?} names no test"));
        let definition = format!("fn {test}(");
        assert!(
            sources.iter().any(|source| source.contains(&definition)),
            "there is no test {test}"
        );
    }
}

#[tokio::test]
async fn a_body_over_the_limit_is_413_whether_it_says_so_or_not() {
    let server = Server::start(&["--max-body-bytes", "100000"]);
    let head = format!("POST /v1/stereo HTTP/1.1\r\nHost: x\r\nContent-Type: {PROTOBUF}\r\n");
    let claimed = format!("{head}Content-Length: 100001\r\n\r\n");
    assert_eq!(status_line(&server, claimed.as_bytes()).await, "HTTP/1.1 413");
    let chunk = [format!("{:x}\r\n", 60_000).as_bytes(), &[0; 60_000], b"\r\n"].concat();
    let grown = [
        format!("{head}Transfer-Encoding: chunked\r\n\r\n").as_bytes(),
        &chunk,
        &chunk,
    ]
    .concat();
    assert_eq!(status_line(&server, &grown).await, "HTTP/1.1 413");
    server.until_zero("stereod_in_flight_bytes").await;
}

#[tokio::test]
async fn a_head_that_is_too_long_or_has_too_many_lines_is_431() {
    let server = Server::start(&[]);
    // Not a byte more than it takes: what is not read would take the answer back.
    let start = "GET /livez HTTP/1.1\r\nHost: x\r\nX: ";
    let long = format!("{start}{}", "x".repeat(16_384 - start.len()));
    assert_eq!(status_line(&server, long.as_bytes()).await, "HTTP/1.1 431");
    let many = format!("GET /livez HTTP/1.1\r\nHost: x\r\n{}\r\n", "X: x\r\n".repeat(101));
    assert_eq!(status_line(&server, many.as_bytes()).await, "HTTP/1.1 431");
    let client = stereo_tests::http::builder()
        .no_proxy()
        .http2_prior_knowledge()
        .build()
        .expect("a client");
    let url = format!("{}/livez", server.process.url());
    let over = client.get(&url).header("x", "x".repeat(20_000)).send().await;
    assert!(over.is_ok_and(|answer| answer.status() == 431));
    let under = client.get(&url).header("x", "x".repeat(10_000)).send().await;
    assert!(under.is_ok_and(|answer| answer.status() == 200));
}

#[tokio::test]
async fn a_connection_of_http_2_has_64_requests_under_way_at_most() {
    let server = Server::start(&[]);
    let mut stream = connect(&server).await;
    // The preface, settings of no change; what comes back begins with the server's own settings.
    stream
        .write_all(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\0\x04\0\0\0\0\0")
        .await
        .expect("room");
    let mut head = [0; 9];
    stream.read_exact(&mut head).await.expect("a frame");
    assert_eq!(head[3], 4, "settings come first");
    let mut settings = vec![0; usize::from(head[2])];
    stream.read_exact(&mut settings).await.expect("its content");
    let most = settings.chunks(6).find(|setting| setting[..2] == [0, 3]);
    assert_eq!(most.map(|setting| &setting[2..]), Some(&64_u32.to_be_bytes()[..]));

    // POST /v1/stereo, bodies to come, 65 times: the last one is refused (RST_STREAM, REFUSED_STREAM).
    let request = b"\x83\x86\x44\x0a/v1/stereo\x41\x01x\x5f\x16application/x-protobuf";
    for number in 0..65_u32 {
        let id = (2 * number + 1).to_be_bytes();
        let length = u8::try_from(request.len()).expect("short");
        let frame = [&[0, 0, length, 1, 4][..], &id, request].concat();
        stream.write_all(&frame).await.expect("room");
    }
    let refused = async {
        loop {
            stream.read_exact(&mut head).await.expect("a frame");
            let length = u32::from_be_bytes([0, head[0], head[1], head[2]]);
            let mut content = vec![0; length as usize];
            stream.read_exact(&mut content).await.expect("its content");
            let id = u32::from_be_bytes([head[5], head[6], head[7], head[8]]);
            if head[3] == 3 && content == 7_u32.to_be_bytes() {
                return id;
            }
        }
    };
    assert_eq!(refused.await, 129);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn more_requests_than_may_wait_are_503_and_the_others_are_answered() {
    let server = Server::start(&["--queue-capacity", "2", "--policy", "fifo"]);
    server.until_ready().await;
    let posts = JoinSet::from_iter((0..40).map(|_| server.start_posting(&message())));
    let replies = posts.join_all().await;
    let codes = Vec::from_iter(replies.into_iter().map(|reply| reply.expect("no panic").status));
    assert!(codes.iter().all(|code| matches!(code, 200 | 503)), "{codes:?}");
    assert!(codes.contains(&200) && codes.contains(&503), "{codes:?}");
    let full = "stereod_requests_total{class=\"deadline\",outcome=\"QUEUE_FULL\"}";
    let refused = codes.iter().filter(|&&code| code == 503).count();
    assert_eq!(server.metric(full).await, refused as f64);
}

/// The names and labels of everything in the metrics.
async fn series(server: &Server) -> BTreeSet<String> {
    let text = String::from_utf8(server.get("/metrics").await.body).expect("text");
    let lines = text.lines().filter(|line| !line.starts_with('#'));
    lines
        .filter_map(|line| Some(line.rsplit_once(' ')?.0.to_owned()))
        .collect()
}

#[tokio::test]
async fn nothing_that_is_asked_for_adds_a_series_to_the_metrics() {
    let server = Server::start(&[]);
    let good = server.good().await;
    let before = series(&server).await;
    for number in 0..300 {
        let request = v1::StereoRequest {
            request_id: format!("request-{number}"),
            camera_id: format!("camera-{number}"),
            left: None,
            ..message()
        };
        assert_eq!(server.post_message(PROTOBUF, &request).await.status, 400);
        server
            .get(&format!("/nothing/{number}"))
            .await
            .assert_refused(404, &[]);
        server
            .get(&format!("/v1/streams/camera-{number}"))
            .await
            .assert_refused(404, &[]);
        let accept = format!("image/x-{number}");
        assert_eq!(
            server
                .post_bytes(&format!("text/x-{number}"), &accept, Vec::new())
                .await
                .status
                / 100,
            4
        );
    }
    server.assert_serves(&good).await;
    assert_eq!(series(&server).await, before);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_flood_of_bodies_takes_no_more_memory_than_the_bound_and_a_tenth() {
    const BOUND: u64 = 200 << 20;
    let server = Server::start(&[
        "--max-bytes-in-flight",
        &BOUND.to_string(),
        "--max-body-bytes",
        "16777216",
        "--body-timeout-ms",
        "600000",
    ]);
    server.until_ready().await;
    // From now on the worker has the memory that such pairs take.
    let large = large_message();
    assert_eq!(server.post_message(PROTOBUF, &large).await.status, 200);
    let body = large.encode_to_vec();
    let good = server.good().await;
    let before = server.process.memory_bytes().expect("it runs");

    // Five times the bound: bodies that come whole but for their last byte, and so are held.
    let count = 5 * usize::try_from(BOUND).expect("small") / body.len();
    let head = format!(
        "POST /v1/stereo HTTP/1.1\r\nHost: x\r\nContent-Type: {PROTOBUF}\r\nX-Latency-Budget-Ms: 60000\r\nContent-Length: {}\r\n\r\n",
        body.len()
    );
    let mut held = Vec::new();
    for _ in 0..count {
        let mut stream = connect(&server).await;
        let sent = async {
            stream.write_all(head.as_bytes()).await?;
            stream.write_all(&body[..body.len() - 1]).await
        };
        // Those over the bound are refused while they send.
        drop(sent.await);
        held.push(stream);
    }
    let refused = "stereod_requests_total{class=\"unknown\",outcome=\"QUEUE_FULL\"}";
    server.until(refused, 1.0).await;
    let in_flight = server.metric("stereod_in_flight_bytes").await;
    assert!(
        in_flight <= BOUND as f64 && in_flight > 0.8 * BOUND as f64,
        "{in_flight}"
    );
    let peak = server.process.memory_peak_bytes().expect("Linux");
    let most = before + BOUND / 10 * 11;
    assert!(
        peak <= most,
        "{peak} bytes at most, {before} before, and {BOUND} allowed"
    );
    drop(held);
    server.until_zero("stereod_in_flight_bytes").await;
    server.assert_serves(&good).await;
}

/// A PNG whose metadata unpacks to 100 MB.
fn bomb() -> Vec<u8> {
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, 64, 48);
    encoder.set_color(png::ColorType::Grayscale);
    encoder
        .add_ztxt_chunk("Comment".to_owned(), "a".repeat(100_000_000))
        .expect("a chunk");
    let mut writer = encoder.write_header().expect("a header");
    writer.write_image_data(&[7; 64 * 48]).expect("an image");
    writer.finish().expect("a file");
    file
}

#[tokio::test]
async fn metadata_that_unpacks_to_100_mb_is_not_unpacked() {
    let server = Server::start(&[]);
    let good = server.good().await;
    let file = bomb();
    assert!(file.len() < 2_000_000, "{}", file.len());
    let before = server.process.memory_peak_bytes().expect("Linux");
    for _ in 0..4 {
        let reply = server
            .post_form(
                "",
                "image/png",
                &[("left", &file), ("right", &file)],
                Some(json!({})),
            )
            .await;
        assert!(matches!(reply.status, 200 | 400), "{}", reply.text());
    }
    let grown = server.process.memory_peak_bytes().expect("Linux") - before;
    assert!(grown < 40 << 20, "{grown} bytes");
    server.assert_serves(&good).await;
}
