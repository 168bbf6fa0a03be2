use std::cell::Cell;

use serde_json::Value;

use super::encode;
use crate::encode::sample::{CAMERA, HEIGHT, Sample, WIDTH, report};

fn body(sample: &Sample) -> Value {
    serde_json::from_slice(&encode(&sample.frame(), &report).unwrap()).unwrap()
}

#[test]
fn the_report_has_the_wires_names_and_durations_in_milliseconds() {
    let body = body(&Sample::colour(Some(CAMERA)));
    assert_eq!(
        (&body["request_id"], &body["sequence"]),
        (&Value::from("r-1"), &Value::from(7))
    );
    let report = &body["report"];
    assert_eq!(report["iterations_run"], 3);
    assert_eq!(report["iterations_asked"], 4);
    assert_eq!(report["deadline_met"], true);
    assert_eq!(report["budget_ms"], 100.0);
    assert_eq!(report["encoded_ms"], 1.5);
    assert_eq!(report["rung"], "full band");
    assert_eq!(
        report["degradation"],
        "the latency budget left no time for another rung"
    );
    assert_eq!(report["density"], 0.75);
    assert_eq!(report["quality_estimate"].to_string(), "0.9");
}

#[test]
fn the_disparity_and_the_mesh_are_counted() {
    let sample = Sample::colour(Some(CAMERA));
    let body = body(&sample);
    let disparity = &body["disparity"];
    assert_eq!(
        (&disparity["width"], &disparity["height"]),
        (&Value::from(WIDTH), &Value::from(HEIGHT))
    );
    assert_eq!(
        (&disparity["min_disparity_px"], &disparity["max_disparity_px"]),
        (&0.into(), &128.into())
    );
    assert_eq!(disparity["valid_pixels"], WIDTH * HEIGHT * 2 / 3);
    assert!((disparity["valid_share"].as_f64().unwrap() - 2.0 / 3.0).abs() < 1e-9);
    assert_eq!(disparity["smallest_px"], 5.0 + 1.0 / 64.0);
    assert_eq!(disparity["largest_px"], 5.0 + 47.0 / 64.0);
    assert_eq!(disparity["valid_window"]["width"], WIDTH);
    assert_eq!(body["mesh"]["vertices"], 4);
    assert_eq!(body["mesh"]["triangles"], 2);
    assert_eq!(body["mesh"]["space"], "METRES");
}

#[test]
fn an_empty_map_has_no_smallest_disparity() {
    let mut sample = Sample::colour(None);
    sample.map.parts_mut().0.fill(0);
    let body = body(&sample);
    assert_eq!(body["disparity"]["valid_pixels"], 0);
    assert_eq!(body["disparity"]["smallest_px"], Value::Null);
    assert_eq!(body["mesh"]["space"], "PIXELS");
}

#[test]
fn the_report_is_asked_for_once() {
    let calls = Cell::new(0);
    let finish = || {
        calls.set(calls.get() + 1);
        report()
    };
    encode(&Sample::colour(None).frame(), &finish).unwrap();
    assert_eq!(calls.get(), 1);
}
