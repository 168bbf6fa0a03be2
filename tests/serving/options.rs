//! Options are honoured.

use serde_json::json;
use stereo_tests::score::score;

use crate::conversation::{PAIR, Server};

fn valid(map: &[u16]) -> usize {
    map.iter().filter(|&&d| d > 0).count()
}

#[tokio::test]
async fn max_iterations_counts_rungs_and_more_than_the_ladder_is_the_whole_ladder() {
    let server = Server::start(&[]);
    let info = server.get("/v1/info").await.json();
    for preset in info["presets"].as_array().expect("a list") {
        let rungs = preset["rungs"].as_array().expect("a list");
        assert!((1..=8).contains(&rungs.len()), "{preset}");
        for asked in [1, 2, rungs.len(), 255] {
            let options = json!({ "max_iterations": asked, "preset": preset["name"] });
            let report = server.post_pair("application/json", options).await.json()["report"].clone();
            let run = report["iterations_run"].as_u64().expect("a number");
            assert!(
                run >= 1 && run <= asked.min(rungs.len()) as u64,
                "{asked} asked: {report}"
            );
            assert_eq!(report["deadline_met"], true);
            let last = usize::try_from(run).expect("small") - 1;
            assert_eq!(report["rung"], rungs[last], "{report}");
        }
    }
    let whole = server.post_pair("application/json", json!({})).await.json()["report"].clone();
    assert!(whole["iterations_run"].as_u64() > Some(1), "{whole}");
}

#[tokio::test]
async fn accuracy_over_http_is_the_cores() {
    let server = Server::start(&[]);
    let truth = &PAIR.rendered.truth.disparity_px;
    let all_3_px = async |options| {
        let map = server.post_pair("image/png", options).await.png16();
        let px: Vec<f32> = map.iter().map(|&d| f32::from(d) / 256.0).collect();
        score(&px, &PAIR.rendered.left, truth)
    };
    let first = all_3_px(json!({ "max_iterations": 1 })).await.edges;
    let whole = all_3_px(json!({})).await.edges;
    assert!(
        first.all[1] >= 90.0 && whole.all[1] >= 97.5,
        "{} -> {}",
        first.all[1],
        whole.all[1]
    );
    let dense = all_3_px(json!({ "density": "dense" })).await.dense;
    assert_eq!(dense.density, 100.0);
    assert!(dense.d1 <= 2.0, "{}", dense.d1);
    let paper = all_3_px(json!({ "preset": "paper" })).await.edges;
    assert!(paper.all[1] >= 94.5, "{}", paper.all[1]);
}

#[tokio::test]
async fn min_confidence_0_drops_nothing_and_1_everything() {
    let server = Server::start(&[]);
    let map = async |m: f64| {
        server
            .post_pair("image/png", json!({ "min_confidence": m }))
            .await
            .png16()
    };
    let whole = server.good().await.png16();
    assert_eq!(map(0.0).await, whole);
    let half = map(0.5).await;
    assert!(
        valid(&half) < valid(&whole) && valid(&half) > 1000,
        "{} of {}",
        valid(&half),
        valid(&whole)
    );
    // What is kept is kept as it was.
    assert!(half.iter().zip(&whole).all(|(h, w)| *h == 0 || h == w));
    assert_eq!(valid(&map(1.0).await), 0);
}

#[tokio::test]
async fn a_region_of_interest_keeps_the_full_size_and_is_empty_outside() {
    let server = Server::start(&[]);
    let roi = json!({ "x": 160, "y": 60, "width": 200, "height": 180 });
    for density in ["semi_dense", "dense"] {
        let options = json!({ "roi": roi, "density": density });
        let map = server.post_pair("image/png", options.clone()).await.png16();
        let (width, height) = (PAIR.rendered.left.width_px(), PAIR.rendered.left.height_px());
        assert_eq!(map.len(), width * height);
        let inside = |i: usize| (160..360).contains(&(i % width)) && (60..240).contains(&(i / width));
        assert!(map.iter().enumerate().all(|(i, &d)| d == 0 || inside(i)));
        let share = valid(&map) as f64 / (200.0 * 180.0);
        assert!(
            if density == "dense" {
                share == 1.0
            } else {
                share > 0.4
            },
            "{density}: {share}"
        );
        let body = server.post_pair("application/json", options).await.json();
        assert_eq!(body["disparity"]["valid_window"], roi);
    }
}

#[tokio::test]
async fn a_ladder_cut_after_its_focus_is_ahead_there_and_the_whole_one_ends_alike() {
    let server = Server::start(&[]);
    let region = json!({ "x": 160, "y": 60, "width": 200, "height": 180, "weight": 2 });
    let map = async |options: serde_json::Value| {
        let mut all = json!({ "density": "dense", "latency_budget_ms": 60_000 });
        all.as_object_mut()
            .unwrap()
            .extend(options.as_object().unwrap().clone());
        server.post_pair("image/png", all).await.png16()
    };
    let [base, whole] = [map(json!({ "max_iterations": 1 })).await, map(json!({})).await];
    let alone = map(json!({ "roi": { "x": 160, "y": 60, "width": 200, "height": 180 } })).await;
    let cut = map(json!({ "max_iterations": 2, "focus": [region] })).await;
    let width = PAIR.rendered.left.width_px();
    for (i, found) in cut.iter().enumerate() {
        let inside = (160..360).contains(&(i % width)) && (60..240).contains(&(i / width));
        assert_eq!(*found, if inside { alone[i] } else { base[i] }, "at {i}");
    }
    assert_eq!(map(json!({ "focus": [region] })).await, whole);
    let options = json!({ "max_iterations": 2, "focus": [region], "latency_budget_ms": 60_000 });
    let body = server.post_pair("application/json", options.clone()).await.json();
    assert_eq!(body["report"]["rung"], "focus");
    let options = json!({ "focus": [region], "latency_budget_ms": 60_000 });
    let body = server.post_pair("application/json", options).await.json();
    assert_eq!(
        (&body["report"]["iterations_run"], &body["report"]["rung"]),
        (&json!(4), &json!("full"))
    );
}

#[tokio::test]
async fn a_smaller_range_of_disparities_bounds_the_result() {
    let server = Server::start(&[]);
    let options = json!({ "min_disparity": 16, "num_disparities": 16 });
    let map = server.post_pair("image/png", options).await.png16();
    assert!(valid(&map) > 10_000);
    assert!(map.iter().all(|&d| d == 0 || (16 * 256..=32 * 256).contains(&d)));
}

#[tokio::test]
async fn a_budget_that_is_too_short_is_504_or_fewer_rungs_and_never_silence() {
    let server = Server::start(&[]);
    let good = server.good().await;
    for ms in [0.001, 1.0, 8.0] {
        let reply = server
            .post_pair(
                "application/json",
                json!({ "latency_budget_ms": ms, "preset": "paper" }),
            )
            .await;
        if reply.status == 200 {
            assert!(reply.json()["report"]["iterations_run"].as_u64() >= Some(1));
        } else {
            reply.assert_refused(504, &["budget"]);
        }
    }
    server.assert_serves(&good).await;
}
