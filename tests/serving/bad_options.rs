//! Bad options: each gets the right status and a sentence that says what to do, and the next request is served as if
//! nothing had happened.

use serde_json::json;
use stereo_proto::v1;

use crate::conversation::{PAIR, Server, calibration, message};

#[tokio::test]
async fn zero_or_huge_disparities_are_400_naming_the_range() {
    let server = Server::start(&[]);
    let good = server.good().await;
    for count in [
        json!(0),
        json!(100_000),
        json!(-16),
        json!(100),
        json!(1e300),
        json!(16.5),
    ] {
        let reply = server
            .post_pair("image/png", json!({ "num_disparities": count }))
            .await;
        reply.assert_refused(400, &["num_disparities", "16 to 256"]);
    }
    for min in [json!(-1), json!(5000)] {
        let reply = server
            .post_pair("image/png", json!({ "min_disparity": min }))
            .await;
        reply.assert_refused(400, &["min_disparity"]);
    }
    let reply = server
        .post_pair(
            "image/png",
            json!({ "min_disparity": 64, "num_disparities": 256 }),
        )
        .await;
    reply.assert_refused(422, &["min_disparity", "256"]);
    server.assert_serves(&good).await;
}

#[tokio::test]
async fn unknown_and_malformed_options_are_400_naming_them() {
    let server = Server::start(&[]);
    let good = server.good().await;
    for (options, words) in [
        (json!({ "max_iteration": 3 }), ["max_iteration"]),
        (json!({ "preset": "best" }), ["preset"]),
        (json!({ "density": 3 }), ["density"]),
        (json!({ "max_iterations": 0 }), ["max_iterations"]),
        (json!({ "max_iterations": 256 }), ["max_iterations"]),
        (json!({ "min_confidence": 1.5 }), ["min_confidence"]),
        (json!({ "latency_budget_ms": 0 }), ["latency_budget_ms"]),
        (json!({ "latency_budget_ms": 60_001 }), ["latency_budget"]),
        (json!({ "outputs": ["colour"] }), ["outputs"]),
        (json!({ "outputs": ["depth"] }), ["calibration"]),
        (json!({ "roi": { "x": 0, "y": 0, "width": 10 } }), ["height"]),
        (
            json!({ "calibration": { "focal_px": -1, "cx_px": 0, "cy_px": 0, "baseline_m": 1 } }),
            ["focal_px"],
        ),
        (json!({ "compression": "gzip" }), ["compression"]),
        (json!({ "priority_class": "vip" }), ["priority_class"]),
        (json!({ "allow_downscale": "yes" }), ["allow_downscale"]),
        (json!([1, 2]), ["options"]),
    ] {
        server
            .post_pair("image/png", options)
            .await
            .assert_refused(400, &words);
    }
    let files: [(&str, &[u8]); 2] = [("left", &PAIR.left), ("right", &PAIR.right)];
    for (options, word) in [
        (&b""[..], "empty"),
        (b"   ", "empty"),
        (b"{", "JSON"),
        (b"{\"calibration\": NaN}", "JSON"),
    ] {
        let parts = [files[0], files[1], ("options", options)];
        server
            .post_form("", "image/png", &parts, None)
            .await
            .assert_refused(400, &[word]);
    }
    let parts = [files[0], files[1], ("centre", &PAIR.left)];
    server
        .post_form("", "image/png", &parts, None)
        .await
        .assert_refused(400, &["centre"]);
    server
        .post_form("?zoom=3", "image/png", &files, Some(json!({})))
        .await
        .assert_refused(400, &["zoom"]);
    server.assert_serves(&good).await;
}

#[tokio::test]
async fn a_calibration_that_is_not_a_number_is_400() {
    let server = Server::start(&[]);
    let good = server.good().await;
    for (name, spoil) in [
        (
            "focal_px",
            (|c| c.focal_px = f64::NAN) as fn(&mut v1::Calibration),
        ),
        ("cx_px", |c| c.cx_px = f64::INFINITY),
        ("baseline_m", |c| c.baseline_m = 0.0),
        ("doffs_px", |c| c.doffs_px = f64::NAN),
    ] {
        let mut wrong = calibration();
        spoil(&mut wrong);
        let request = v1::StereoRequest {
            calibration: Some(wrong),
            ..message()
        };
        let reply = server
            .post_message("image/png, application/problem+json", &request)
            .await;
        reply.assert_refused(400, &["calibration", name]);
    }
    server.assert_serves(&good).await;
}

#[tokio::test]
async fn a_region_outside_the_image_is_refused() {
    let server = Server::start(&[]);
    let good = server.good().await;
    for (x, y, width, height) in [
        (0, 0, 0, 10),
        (500, 0, 13, 10),
        (0, 319, 10, 2),
        (u32::MAX, 0, 10, 10),
    ] {
        let roi = json!({ "x": x, "y": y, "width": width, "height": height });
        let reply = server.post_pair("image/png", json!({ "roi": roi })).await;
        assert!(
            [400, 422].contains(&reply.status),
            "{roi}: {} {}",
            reply.status,
            reply.text()
        );
        reply.assert_refused(reply.status, &["roi"]);
        let reply = server.post_pair("image/png", json!({ "focus": [roi] })).await;
        reply.assert_refused(reply.status, &["focus"]);
        assert!([400, 422].contains(&reply.status), "{}", reply.status);
    }
    server.assert_serves(&good).await;
}
