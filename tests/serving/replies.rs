//! Every kind of answer, from both kinds of body.

use prost::Message;
use serde_json::json;
use stereo_proto::v1;

use crate::conversation::{PAIR, PROTOBUF, Reply, Server, calibration, message};

/// One server, one pair: the answer to a form and to a message.
async fn both(server: &Server, accept: &str) -> [Reply; 2] {
    [
        server
            .post_pair(accept, json!({ "calibration": calibration_json() }))
            .await,
        server
            .post_message(
                accept,
                &v1::StereoRequest {
                    calibration: Some(calibration()),
                    ..message()
                },
            )
            .await,
    ]
}

fn calibration_json() -> serde_json::Value {
    let c = calibration();
    json!({ "focal_px": c.focal_px, "cx_px": c.cx_px, "cy_px": c.cy_px, "baseline_m": c.baseline_m })
}

#[tokio::test]
async fn every_accept_type_is_answered_with_its_own_type_and_all_stage_times() {
    let server = Server::start(&[]);
    for (accept, magic) in [
        (PROTOBUF, &b""[..]),
        ("application/json", b"{"),
        ("image/png", b"\x89PNG"),
        ("model/gltf-binary", b"glTF"),
        ("application/ply", b"ply\n"),
    ] {
        for reply in both(&server, accept).await {
            assert_eq!(
                (reply.status, reply.content_type.as_str()),
                (200, accept),
                "{}",
                reply.text()
            );
            assert!(reply.body.starts_with(magic), "{accept}: {}", reply.text());
            assert_has_stages(&reply.server_timing);
        }
    }
}

/// `queue;dur=0.01, decode;dur=0.52, ..`
fn assert_has_stages(timing: &str) {
    let stages: Vec<(&str, f64)> = timing
        .split(", ")
        .map(|stage| {
            stage
                .split_once(";dur=")
                .unwrap_or_else(|| panic!("a stage without time in {timing}"))
        })
        .map(|(name, ms)| {
            (
                name,
                ms.parse()
                    .unwrap_or_else(|_| panic!("no plain decimal in {timing}")),
            )
        })
        .collect();
    assert_eq!(
        stages.iter().map(|s| s.0).collect::<Vec<_>>(),
        ["queue", "decode", "match", "mesh", "encode"]
    );
    assert!(stages.iter().all(|s| s.1 >= 0.0) && stages[2].1 > 0.0, "{timing}");
}

#[tokio::test]
async fn forms_and_messages_get_the_same_bytes() {
    let server = Server::start(&[]);
    for accept in ["image/png", "model/gltf-binary", "application/ply"] {
        let [form, message] = both(&server, accept).await;
        assert!(
            form.body == message.body,
            "{accept}: {} and {} bytes",
            form.body.len(),
            message.body.len()
        );
    }
}

#[tokio::test]
async fn a_result_has_everything_that_was_said_and_found() {
    let server = Server::start(&["--instance", "test.server-1"]);
    let request = v1::StereoRequest {
        request_id: "pair 7".into(),
        camera_id: "front".into(),
        sequence: Some(41),
        capture_time: Some(prost_types::Timestamp {
            seconds: 1_700_000_000,
            nanos: 5,
        }),
        calibration: Some(calibration()),
        ..message()
    };
    let result = server.post_message(PROTOBUF, &request).await.result();
    assert_eq!(
        (result.request_id.as_str(), result.camera_id.as_str()),
        ("pair 7", "front")
    );
    assert_eq!(
        (result.sequence, result.capture_time),
        (Some(41), request.capture_time)
    );
    let disparity = result.disparity.expect("a default output");
    assert_eq!((disparity.width, disparity.height), (512, 320));
    assert_eq!(disparity.encoding(), v1::DisparityEncoding::U16);
    assert_eq!(disparity.data.len(), 2 * 512 * 320);
    assert_eq!(disparity.confidence.len(), 512 * 320);
    assert_eq!(disparity.calibration, request.calibration);
    assert_eq!((disparity.min_disparity_px, disparity.max_disparity_px), (0, 128));
    let mesh = result.mesh.expect("a default output");
    assert_eq!(mesh.space(), v1::MeshSpace::Metres);
    let vertices = mesh.disparities.len() / 4;
    assert!(vertices > 100 && mesh.positions.len() == 12 * vertices && mesh.uvs.len() == 8 * vertices);
    assert!(mesh.indices.len() % 12 == 0 && mesh.indices.len() > 12 * 100);
    let largest = mesh
        .indices
        .chunks_exact(4)
        .map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
        .max();
    assert!(
        largest < u32::try_from(vertices).ok(),
        "{largest:?} of {vertices}"
    );
    let report = result.report.expect("always there");
    assert_eq!(report.instance, "test.server-1");
    assert!(
        report.deadline_met && report.iterations_run >= 1 && report.degradation.is_empty(),
        "{report:?}"
    );
    assert!(
        report.quality_estimate > 0.5 && report.density > 0.9,
        "{report:?}"
    );
    assert_eq!(report.software_version, env!("CARGO_PKG_VERSION"));
}

#[tokio::test]
async fn only_the_outputs_that_were_asked_for_are_sent() {
    let server = Server::start(&[]);
    let mut request = message();
    request.options.as_mut().expect("it has them").outputs = vec![v1::Output::Mesh.into()];
    let result = server.post_message(PROTOBUF, &request).await.result();
    assert!(
        result.mesh.is_some()
            && result.disparity.is_none()
            && result.depth.is_none()
            && result.points.is_none()
    );
    assert_eq!(result.mesh.map(|m| m.space()), Some(v1::MeshSpace::Pixels));
}

#[tokio::test]
async fn the_coloured_view_is_an_rgb_picture_of_the_same_size() {
    let server = Server::start(&[]);
    let files: [(&str, &[u8]); 2] = [("left", &PAIR.left), ("right", &PAIR.right)];
    let reply = server
        .post_form(
            "?view=color",
            "image/png",
            &files,
            Some(json!({ "density": "dense" })),
        )
        .await;
    let picture = image::load_from_memory(&reply.body).expect("a PNG");
    assert_eq!(
        (picture.width(), picture.height(), picture.color()),
        (512, 320, image::ColorType::Rgb8)
    );
    let reply = server
        .post_form("?view=disparity", "*/*", &files, Some(json!({})))
        .await;
    assert!(reply.body == server.good().await.body);
}

#[tokio::test]
async fn json_reports_have_the_protos_field_names() {
    let server = Server::start(&[]);
    let body = server
        .post_pair("application/json", json!({ "max_iterations": 2 }))
        .await
        .json();
    let report = body["report"].as_object().expect("an object");
    for name in [
        "budget_ms",
        "received_ms",
        "queued_ms",
        "decoded_ms",
        "matched_ms",
        "meshed_ms",
        "encoded_ms",
        "total_ms",
        "predicted_cost_ms",
        "actual_cost_ms",
        "iterations_run",
        "iterations_asked",
        "quality_estimate",
        "density",
        "worker",
        "queue_depth",
    ] {
        assert!(
            report.get(name).is_some_and(serde_json::Value::is_number),
            "{name} in {report:?}"
        );
    }
    for name in ["rung", "degradation", "instance", "software_version"] {
        assert!(
            report.get(name).is_some_and(serde_json::Value::is_string),
            "{name} in {report:?}"
        );
    }
    assert_eq!(report["deadline_met"], true);
    assert_eq!(report["has_converged"], false, "two rungs of three");
    assert_eq!(report["budget_ms"], 60_000.0);
    assert!(body["mesh"]["triangles"].as_u64() > Some(100), "{body}");
}

#[tokio::test]
async fn a_ladder_that_ends_early_because_nothing_would_change_is_no_degradation() {
    let server = Server::start(&[]);
    let same: [(&str, &[u8]); 2] = [("left", &PAIR.left), ("right", &PAIR.left)];
    for (preset, asked) in [("default", 3), ("fast", 4), ("paper", 5)] {
        let options = Some(json!({ "preset": preset, "latency_budget_ms": 60_000 }));
        let reply = server.post_form("", "application/json", &same, options).await;
        let report = &reply.json()["report"];
        assert_eq!(report["has_converged"], true, "{report}");
        assert_eq!(report["degradation"], "", "{report}");
        assert_eq!(report["iterations_asked"], asked, "{report}");
        assert!(report["iterations_run"].as_u64() < Some(asked), "{report}");
    }
    let whole = server
        .post_pair("application/json", json!({ "latency_budget_ms": 60_000 }))
        .await
        .json();
    assert_eq!(whole["report"]["has_converged"], true, "the ladder's end");
    assert_eq!(whole["report"]["iterations_run"], 3);
}

#[tokio::test]
async fn the_server_describes_itself() {
    let server = Server::start(&["--instance", "alpha"]);
    let info = server.get("/v1/info").await.json();
    assert_eq!(
        (&info["name"], &info["instance"], &info["workers"]),
        (&json!("stereod"), &json!("alpha"), &json!(1))
    );
    let names: Vec<_> = info["presets"]
        .as_array()
        .expect("a list")
        .iter()
        .map(|p| &p["name"])
        .collect();
    assert_eq!(names, ["default", "fast", "paper"]);
    let schema = server.get("/v1/schema.binpb").await;
    assert_eq!(schema.status, 200);
    let set = prost_types::FileDescriptorSet::decode(schema.body.as_slice()).expect("a descriptor set");
    let messages = set
        .file
        .iter()
        .flat_map(|f| &f.message_type)
        .filter_map(|m| m.name.as_deref());
    let known: Vec<&str> = messages.collect();
    for name in ["StereoRequest", "StereoResult", "ExecutionReport", "Status"] {
        assert!(known.contains(&name), "{name} in {known:?}");
    }
    assert_eq!(server.get("/livez").await.status, 200);
    server.good().await;
    // A frame has been served, so its worker is primed.
    assert_eq!(server.get("/readyz").await.status, 200);
}
