//! The log: a line for each frame, which programs can read.

use std::path::PathBuf;

use serde_json::{Value, json};
use stereo_client::{Client, ClientError};
use stereo_tests::process::{Launch, Stereod};

use crate::conversation::message;

/// What a server logs in JSON while `talk` goes on.
async fn log_of(name: &str, talk: impl AsyncFnOnce(&Client)) -> Vec<Value> {
    let file: PathBuf = std::env::temp_dir().join(format!("stereod-log-{name}-{}", std::process::id()));
    let server = Stereod::launch(&Launch {
        log: Some(&file),
        args: &["--workers", "1", "--log-format", "json"],
        ..Launch::default()
    })
    .expect("a server that starts");
    let client = Client::new(server.url()).expect("an address");
    talk(&client).await;
    let stopped = tokio::task::spawn_blocking(|| server.stop()).await;
    assert!(stopped.expect("no panic").expect("a running server").success());
    let text = std::fs::read_to_string(&file).expect("a log");
    std::fs::remove_file(&file).expect("the test's own file");
    text.lines()
        .map(|line| serde_json::from_str(line).unwrap_or_else(|why| panic!("{why}: {line}")))
        .collect()
}

/// The one line with these members.
fn only<'a>(lines: &'a [Value], members: &Value) -> &'a Value {
    let wanted = members.as_object().expect("members");
    let mut found = lines
        .iter()
        .filter(|line| wanted.iter().all(|(name, value)| &line[name] == value));
    let first = found
        .next()
        .unwrap_or_else(|| panic!("no {members} in {lines:?}"));
    assert!(found.next().is_none(), "two lines with {members}");
    first
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn each_frame_is_a_line_with_its_name_its_camera_and_its_slack() {
    let lines = log_of("frames", async |client| {
        let mut frame = message();
        frame.camera_id = "front".to_owned();
        frame.request_id = "good".to_owned();
        client.match_pair(&frame).await.expect("a result");
        frame.request_id = "late".to_owned();
        let budget = std::time::Duration::from_nanos(1)
            .try_into()
            .expect("a short time");
        frame.options.get_or_insert_default().latency_budget = Some(budget);
        let refused = client.match_pair(&frame).await;
        assert!(matches!(refused, Err(ClientError::Refused(_))), "{refused:?}");
    })
    .await;
    let good = only(
        &lines,
        &json!({ "message": "answered", "request_id": "good", "camera": "front" }),
    );
    assert!(
        good["slack_ms"]
            .as_f64()
            .is_some_and(|ms| (0.0..60_000.0).contains(&ms)),
        "{good}"
    );
    assert_eq!(
        (&good["level"], &good["deadline_met"]),
        (&json!("INFO"), &json!(true))
    );
    assert!(good["matched_ms"].as_f64().is_some_and(|ms| ms > 0.0), "{good}");
    let late = only(
        &lines,
        &json!({ "message": "refused", "request_id": "late", "camera": "front" }),
    );
    assert!(late["slack_ms"].as_f64().is_some_and(|ms| ms < 0.0), "{late}");
    assert!(late["reason"].is_string() && late["error"].is_string(), "{late}");
}
