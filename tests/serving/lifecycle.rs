//! Start and stop.

use std::net::TcpListener;

use futures_util::StreamExt;
use prost::Message;
use stereo_proto::v1;
use stereo_proto::v1::batch_reply::Outcome;
use stereo_tests::process::run;

use crate::batch::{client, fed, small};
use crate::conversation::{Server, message};

#[tokio::test]
async fn sigterm_ends_the_server_with_exit_code_0() {
    let server = Server::start(&[]);
    assert_eq!(server.good().await.status, 200);
    let address = server.process.url().trim_start_matches("http://").to_owned();
    let status = server.process.stop().expect("a running server");
    assert_eq!(status.code(), Some(0), "{status}");
    assert!(
        std::net::TcpStream::connect(address).is_err(),
        "something still listens"
    );
}

/// 2 megapixels of noise: work for long enough to stop the server in the middle of it.
pub(crate) fn large_message() -> v1::StereoRequest {
    let mut request = message();
    let mut state = 1_u32;
    for image in [&mut request.left, &mut request.right].into_iter().flatten() {
        (image.width, image.height) = (2048, 1024);
        let mut byte = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            state.to_be_bytes()[0]
        };
        image.data = (0..2048 * 1024).map(|_| byte()).collect::<Vec<u8>>().into();
    }
    if let Some(options) = &mut request.options {
        options.set_preset(v1::Preset::Paper);
    }
    request
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_was_admitted_is_answered_when_the_server_is_told_to_stop() {
    let server = Server::start(&[]);
    let request = large_message();
    let answers = [(); 4].map(|()| server.start_posting(&request));
    // One is worked on and the others wait, unless this machine is so fast that one is done already.
    while server.get("/readyz").await.json()["queue_depth"] != 3 {
        if answers.iter().any(tokio::task::JoinHandle::is_finished) {
            break;
        }
    }
    let status = tokio::task::spawn_blocking(|| server.process.stop())
        .await
        .expect("no panic");
    assert_eq!(status.expect("a running server").code(), Some(0));
    let mut served = 0;
    for answer in answers {
        let answer = answer.await.expect("an answer, not silence");
        served += u32::from(answer.status == 200);
        // What was still on its way then is refused and says so.
        let refused =
            || v1::Status::decode(answer.body.as_slice()).is_ok_and(|s| s.reason() == v1::Reason::Draining);
        assert!(
            answer.status == 200 || refused(),
            "{} {}",
            answer.status,
            answer.text()
        );
    }
    assert!(served > 0, "nothing that was admitted was answered");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_batch_under_way_is_answered_as_far_as_it_was_read_when_the_server_is_told_to_stop() {
    let server = Server::start(&[]);
    let (give, requests) = fed();
    let mut replies = client(&server).match_batch(requests).await.expect("a batch");
    for id in 0..3 {
        give.send(small(id)).await.expect("an open batch");
    }
    server.until("stereod_batch_frames_total", 3.0).await;
    let stopped = tokio::task::spawn_blocking(|| server.process.stop());
    let is_draining = |status: &v1::Status| status.reason() == v1::Reason::Draining;
    let mut answered = Vec::new();
    let mut last_words = None;
    while let Some(reply) = replies.next().await {
        let v1::BatchReply { request_id, outcome } = reply.expect("a whole reply");
        assert!(last_words.is_none(), "{request_id} after the last words");
        match outcome.expect("always one") {
            Outcome::Status(status) if request_id.is_empty() => last_words = Some(status),
            // Read, but not admitted any more.
            Outcome::Status(status) => {
                assert!(is_draining(&status), "{status:?}");
                answered.push(request_id);
            }
            Outcome::Result(_) => answered.push(request_id),
        }
    }
    answered.sort();
    assert_eq!(answered, ["pair-0", "pair-1", "pair-2"]);
    assert!(last_words.is_some_and(|status| is_draining(&status)));
    let status = stopped.await.expect("no panic").expect("a running server");
    assert_eq!(status.code(), Some(0));
    drop(give);
}

#[test]
fn bad_configuration_exits_64_before_any_socket_is_bound() {
    // The port is taken, so a server that tried to bind it would end with another code.
    let taken = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let http = taken.local_addr().expect("it is bound").to_string();
    let file = std::env::temp_dir().join(format!("stereod-bad-{}.toml", std::process::id()));
    std::fs::write(&file, "[workers]\ncuont = 3\n").expect("a file");
    let path = file.to_str().expect("a plain path");
    for (args, word) in [
        (["--workers", "0"], "workers"),
        (["--simd", "abacus"], "abacus"),
        (["--instance", "two words"], "instance"),
        (["--max-body-bytes", "1"], "body_bytes"),
        (["--queue-capacity", "many"], "many"),
        (["--config", "no/such/file.toml"], "no/such/file.toml"),
        (["--config", path], "cuont"),
        (["--split-frames", "perhaps"], "perhaps"),
        (["--policy", "lifo"], "fifo-timeout"),
        (["--log", "a=b=c"], "--log"),
        (["--wrokers", "2"], "--workers"),
    ] {
        let output =
            run(&[&["serve", "--http", &http], args.as_slice()].concat()).expect("a program that runs");
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(64), "{args:?}: {message}");
        assert!(message.contains(word), "{args:?}: {message}");
        assert!(output.stdout.is_empty(), "{args:?}");
    }
    std::fs::remove_file(file).expect("the test's own file");
    // The same command with good settings gets as far as the socket.
    let output = run(&["serve", "--http", &http]).expect("a program that runs");
    assert_eq!(
        output.status.code(),
        Some(71),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(
        message.contains(&http) && message.contains("choose another"),
        "{message}"
    );
}

#[test]
fn help_and_version_are_no_errors() {
    for args in [
        &["--help"][..],
        &["--version"],
        &["serve", "--help"],
        &["match", "--help"],
    ] {
        let output = run(args).expect("a program that runs");
        assert_eq!(output.status.code(), Some(0), "{args:?}");
        assert!(!output.stdout.is_empty(), "{args:?}");
    }
    for (args, word) in [
        (&["frobnicate"][..], "frobnicate"),
        (&["serve", "--http", "localhost:8080"], "127.0.0.1:8080"),
    ] {
        let output = run(args).expect("a program that runs");
        assert_eq!(output.status.code(), Some(64), "{args:?}");
        let message = String::from_utf8_lossy(&output.stderr);
        assert!(message.contains(word), "{message}");
    }
}
