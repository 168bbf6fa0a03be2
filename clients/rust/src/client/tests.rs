use std::io::{Read, Write};
use std::net::TcpListener;

use stereo_proto::v1::Reason;

use super::*;

/// A server for one exchange: reads a head and a body, answers with `answer`, and gives back what it read.
fn serve_once(answer: Vec<u8>) -> (Client, std::thread::JoinHandle<Vec<u8>>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let client = Client::new(&format!("http://{}", listener.local_addr().unwrap())).unwrap();
    let thread = std::thread::Builder::new().name("server".into());
    let server = thread.spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        let mut request = Vec::new();
        let mut buffer = [0; 4096];
        while !is_whole(&request) {
            let got = stream.read(&mut buffer).unwrap();
            assert!(got > 0, "the request ended early");
            request.extend_from_slice(&buffer[..got]);
        }
        stream.write_all(&answer).unwrap();
        request
    });
    (client, server.unwrap())
}

/// Whether the head and as many bytes as it announces (or the last chunk) are there.
fn is_whole(request: &[u8]) -> bool {
    let text = String::from_utf8_lossy(request).to_ascii_lowercase();
    let Some((head, _)) = text.split_once("\r\n\r\n") else {
        return false;
    };
    let announced = head
        .lines()
        .find_map(|line| line.strip_prefix("content-length: "));
    let body = request.len() - head.len() - 4;
    match announced {
        Some(length) => body >= length.parse::<usize>().unwrap(),
        None => !head.contains("transfer-encoding: chunked") || request.ends_with(b"0\r\n\r\n"),
    }
}

fn answer(head: &str, body: &[u8]) -> Vec<u8> {
    let mut answer = format!("HTTP/1.1 {head}\r\ncontent-length: {}\r\n\r\n", body.len()).into_bytes();
    answer.extend_from_slice(body);
    answer
}

#[tokio::test]
async fn pair_goes_out_and_its_result_comes_back_as_messages() {
    let result = StereoResult {
        request_id: "r".into(),
        ..StereoResult::default()
    };
    let head = "200 OK\r\ncontent-type: application/x-protobuf";
    let (client, server) = serve_once(answer(head, &result.encode_to_vec()));
    let request = StereoRequest {
        request_id: "r".into(),
        ..StereoRequest::default()
    };
    assert_eq!(client.match_pair(&request).await.unwrap(), result);
    let sent = server.join().unwrap();
    assert!(sent.starts_with(b"POST /v1/stereo HTTP/1.1\r\n"));
    assert!(sent.ends_with(&request.encode_to_vec()));
}

#[tokio::test]
async fn files_go_out_as_a_form_and_the_reply_has_its_stage_times() {
    let head = "200 OK\r\ncontent-type: image/png\r\nserver-timing: match;dur=1.5";
    let (client, server) = serve_once(answer(head, b"PNG"));
    let files = PairFiles {
        left: Bytes::from_static(b"LEFT"),
        right: Bytes::from_static(b"RIGHT"),
        options_json: Some("{\"preset\": \"paper\"}".into()),
    };
    let reply = client.match_files(files, Accept::ColorPng).await.unwrap();
    assert_eq!(
        (&reply.body[..], reply.content_type.as_str()),
        (b"PNG".as_slice(), "image/png")
    );
    assert_eq!(reply.stages.get("match"), Some(Duration::from_micros(1500)));
    let sent = String::from_utf8_lossy(&server.join().unwrap()).into_owned();
    assert!(
        sent.starts_with("POST /v1/stereo?view=color HTTP/1.1\r\n"),
        "{sent}"
    );
    for part in [
        "name=\"left\"",
        "LEFT",
        "name=\"right\"",
        "RIGHT",
        "name=\"options\"",
        "{\"preset\": \"paper\"}",
    ] {
        assert!(sent.contains(part), "{part} is missing in {sent}");
    }
}

#[tokio::test]
async fn refusals_are_typed_in_both_their_forms() {
    let status = Status {
        code: 422,
        reason: Reason::Invalid.into(),
        message: "why".into(),
        ..Status::default()
    };
    let forms = [
        ("application/x-protobuf", status.encode_to_vec()),
        (
            "application/problem+json",
            br#"{"status": 422, "reason": "INVALID", "detail": "why"}"#.to_vec(),
        ),
    ];
    for (content_type, body) in forms {
        let head = format!("422 Unprocessable Content\r\ncontent-type: {content_type}");
        let (client, server) = serve_once(answer(&head, &body));
        let error = client.match_pair(&StereoRequest::default()).await.unwrap_err();
        assert_eq!(error.status(), Some(&status));
        server.join().unwrap();
    }
}

#[tokio::test]
async fn answer_of_something_else_says_to_check_the_address() {
    let (client, server) = serve_once(answer("502 Bad Gateway\r\ncontent-type: text/html", b"<html>"));
    let error = client.info().await.unwrap_err();
    assert!(
        error.to_string().contains("HTTP 502") && error.to_string().contains("check the address"),
        "{error}"
    );
    server.join().unwrap();
}

#[tokio::test]
async fn nobody_there_says_to_start_the_server() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let client = Client::new(&format!("http://{}", listener.local_addr().unwrap())).unwrap();
    drop(listener);
    let error = client.info().await.unwrap_err();
    assert!(matches!(error, ClientError::Unreachable { .. }), "{error}");
    let text = error.to_string();
    assert!(
        text.contains("(Connection refused") && text.contains("start the server"),
        "{text}"
    );
    let error = client.ready(Duration::from_millis(50)).await.unwrap_err();
    assert!(matches!(error, ClientError::NotReady { .. }), "{error}");
}

#[tokio::test]
async fn what_is_no_web_server_and_who_sends_elsewhere_are_told() {
    let (client, server) = serve_once(b"SSH-2.0-OpenSSH_9.2\r\n\r\n".to_vec());
    let error = client.info().await.unwrap_err();
    assert!(matches!(error, ClientError::NotHttp { .. }), "{error}");
    server.join().unwrap();
    let (client, server) = serve_once(answer("301 Moved\r\nlocation: http://127.0.0.1:1/", b""));
    let error = client.info().await.unwrap_err();
    assert!(
        matches!(error, ClientError::Unexpected { code: 301, .. }),
        "{error}"
    );
    server.join().unwrap();
}

#[tokio::test]
async fn a_token_goes_with_every_request() {
    let (plain, server) = serve_once(answer("200 OK", b"{}"));
    let access = Access {
        token: Some("stereod_abc".into()),
        ..Access::default()
    };
    let client = Client::with_access(plain.base.as_str(), &access).unwrap();
    client.ready(Duration::from_secs(10)).await.unwrap();
    let sent = String::from_utf8_lossy(&server.join().unwrap()).into_owned();
    assert!(sent.contains("authorization: Bearer stereod_abc\r\n"), "{sent}");
    assert!(!format!("{client:?}").contains("abc"));
}

#[tokio::test]
async fn answer_that_is_cut_off_is_an_error() {
    let whole = answer("200 OK\r\ncontent-type: application/x-protobuf", &[0; 100]);
    let (client, server) = serve_once(whole[..whole.len() - 50].to_vec());
    let error = client.match_pair(&StereoRequest::default()).await.unwrap_err();
    assert!(matches!(error, ClientError::Interrupted { .. }), "{error}");
    server.join().unwrap();
}

#[tokio::test]
async fn ready_server_is_waited_for_and_info_is_read() {
    let (client, server) = serve_once(answer("200 OK", b"{}"));
    client.ready(Duration::from_secs(10)).await.unwrap();
    server.join().unwrap();
    let json = br#"{"name": "stereod", "version": "0.1.0", "instance": "i", "simd": "scalar", "workers": 1, "new": 1,
        "limits": {"body_bytes": 1, "image_pixels": 2, "min_side_px": 32, "max_side_px": 4096},
        "presets": [{"name": "default", "rungs": ["a", "b"]}]}"#;
    let (client, server) = serve_once(answer("200 OK\r\ncontent-type: application/json", json));
    assert_eq!(client.info().await.unwrap().presets[0].rungs, ["a", "b"]);
    server.join().unwrap();
}

#[test]
fn addresses_that_are_none_are_refused_with_an_example() {
    for url in ["", "127.0.0.1:8080", "ftp://host/", "https://", "http://"] {
        let error = Client::new(url).unwrap_err();
        assert!(
            error.to_string().contains("http://127.0.0.1:8080"),
            "{url}: {error}"
        );
    }
}

#[test]
fn proxies_are_not_asked_for_this_machine() {
    let is_this_machine = |url: &str| super::is_this_machine(&Url::parse(url).unwrap());
    assert!(
        [
            "http://127.0.0.1:1",
            "http://localhost",
            "http://[::1]:80",
            "http://127.9.9.9"
        ]
        .map(is_this_machine)
            == [true; 4]
    );
    assert!(
        ["http://10.0.0.1:1", "http://stereo.example", "http://[fe80::1]"].map(is_this_machine) == [false; 3]
    );
}
