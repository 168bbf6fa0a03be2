//! Bad bodies and addresses: each gets the right status and a sentence that says what to do, and the next request is served as if
//! nothing had happened.

use prost::Message;
use stereo_proto::v1;
use tokio::io::{AsyncReadExt, AsyncWriteExt};

use crate::conversation::{PAIR, PROTOBUF, Server, message};

#[tokio::test]
async fn a_wrong_content_type_is_415_and_an_impossible_accept_406() {
    let server = Server::start(&[]);
    let good = server.good().await;
    let body = || message().encode_to_vec();
    for kind in ["text/plain", "application/json", "image/png"] {
        let reply = server
            .post_bytes(kind, "application/problem+json, image/png", body())
            .await;
        reply.assert_refused(415, &["multipart/form-data", PROTOBUF]);
    }
    let reply = server
        .post_bytes(PROTOBUF, "text/html, application/problem+json", body())
        .await;
    reply.assert_refused(406, &["image/png"]);
    server.assert_serves(&good).await;
}

#[tokio::test]
async fn malformed_protobuf_is_400_as_a_status_message() {
    let server = Server::start(&[]);
    let good = server.good().await;
    let whole = message().encode_to_vec();
    for body in [
        b"\xff\xff\xff\xff".to_vec(),
        whole[..whole.len() / 2].to_vec(),
        b"left".to_vec(),
        Vec::new(),
    ] {
        let reply = server.post_bytes(PROTOBUF, PROTOBUF, body).await;
        assert_eq!((reply.status, reply.content_type.as_str()), (400, PROTOBUF));
        let status = v1::Status::decode(reply.body.as_slice()).expect("a Status");
        assert_eq!((status.code, status.reason()), (400, v1::Reason::Invalid));
        assert!(
            status.message.split_whitespace().count() > 4,
            "{}",
            status.message
        );
    }
    server.assert_serves(&good).await;
}

#[tokio::test]
async fn malformed_forms_are_400() {
    let server = Server::start(&[]);
    let good = server.good().await;
    let kind = "multipart/form-data; boundary=mark";
    for body in [
        "",
        "--mark",
        "no form at all",
        "--mark\r\nContent-Disposition: form-data; name=\"left\"\r\n\r\nx",
    ] {
        server
            .post_bytes(kind, "image/png", body.into())
            .await
            .assert_refused(400, &[]);
    }
    server
        .post_bytes("multipart/form-data", "image/png", b"x".to_vec())
        .await
        .assert_refused(400, &["boundary"]);
    server.assert_serves(&good).await;
}

#[tokio::test]
async fn a_body_over_the_limit_is_413() {
    let server = Server::start(&["--max-body-bytes", "400000", "--max-image-pixels", "200000"]);
    let good = server.good().await;
    let noise: Vec<u8> = vec![7; 500_000];
    server
        .post_form("", "image/png", &[("left", &noise), ("right", &PAIR.right)], None)
        .await
        .assert_refused(413, &["400000"]);
    server.assert_serves(&good).await;
    // A length that is only claimed is refused before a byte of it has been sent.
    let address = server.process.url().trim_start_matches("http://").to_owned();
    let mut socket = tokio::net::TcpStream::connect(address)
        .await
        .expect("a listening server");
    let head = format!(
        "POST /v1/stereo HTTP/1.1\r\nHost: x\r\nContent-Type: {PROTOBUF}\r\nAccept: application/problem+json, \
         image/png\r\nContent-Length: 99999999999\r\n\r\n"
    );
    socket
        .write_all(head.as_bytes())
        .await
        .expect("an open connection");
    let mut answer = [0; 12];
    socket.read_exact(&mut answer).await.expect("an answer");
    assert_eq!(&answer, b"HTTP/1.1 413");
    server.assert_serves(&good).await;
}

#[tokio::test]
async fn what_does_not_exist_is_404_and_a_wrong_method_405() {
    let server = Server::start(&[]);
    server
        .get("/v2/stereo")
        .await
        .assert_refused(404, &["/v1/stereo"]);
    server.get("/v1/stereo").await.assert_refused(405, &["POST"]);
}
