use prost_types::Duration;

use super::*;

fn refusal(json: &str) -> String {
    let error = options_from_json(json.as_bytes()).unwrap_err();
    assert_eq!(error.http_code(), 400, "{error}");
    error.to_string()
}

fn refused_naming(json: &str, words: &[&str]) {
    let text = refusal(json);
    for word in words {
        assert!(text.contains(word), "`{word}` is missing in: {text}");
    }
}

#[test]
fn every_option_has_a_name_in_json() {
    let json = r#"{
        "latency_budget_ms": 12.5, "max_iterations": 4, "preset": "paper", "min_confidence": 0.5, "num_disparities": 64,
        "min_disparity": 16, "density": "dense", "roi": {"x": 1, "y": 2, "width": 30, "height": 40},
        "priority_class": "background", "outputs": ["disparity", "confidence", "depth", "mesh", "points"],
        "disparity_encoding": "png16", "compression": "lz4", "allow_downscale": true,
        "mesh": {"keep_rejected": true, "max_disparity_step_px": 2.5, "min_valid_share": 0.25, "tolerance_px": 1.5,
            "max_triangles": 70000}, "colors": true,
        "focus": [{"x": 5, "y": 6, "width": 7, "height": 8, "weight": 2.5}, {"x": 0, "y": 0, "width": 1, "height": 1}],
        "calibration": {"focal_px": 500.5, "cx_px": 320, "cy_px": 240, "baseline_m": 0.1, "doffs_px": -2},
        "request_id": "r", "camera_id": "c", "sequence": 18446744073709551615,
        "capture_time": "2023-11-14T22:13:20.5Z"
    }"#;
    let expected = v1::StereoRequest {
        request_id: "r".into(),
        camera_id: "c".into(),
        sequence: Some(u64::MAX),
        capture_time: Some(Timestamp {
            seconds: 1_700_000_000,
            nanos: 500_000_000,
        }),
        left: None,
        right: None,
        calibration: Some(v1::Calibration {
            focal_px: 500.5,
            cx_px: 320.0,
            cy_px: 240.0,
            baseline_m: 0.1,
            doffs_px: -2.0,
        }),
        options: Some(v1::Options {
            latency_budget: Some(Duration {
                seconds: 0,
                nanos: 12_500_000,
            }),
            max_iterations: Some(4),
            preset: v1::Preset::Paper.into(),
            min_confidence: Some(0.5),
            num_disparities: Some(64),
            min_disparity: Some(16),
            density: v1::Density::Dense.into(),
            roi: Some(v1::Region {
                x: 1,
                y: 2,
                width: 30,
                height: 40,
            }),
            priority_class: v1::PriorityClass::Background.into(),
            outputs: vec![1, 2, 3, 4, 5],
            disparity_encoding: v1::DisparityEncoding::Png16.into(),
            compression: v1::Compression::Lz4.into(),
            allow_downscale: Some(true),
            mesh: Some(v1::MeshOptions {
                keep_rejected: Some(true),
                max_disparity_step_px: Some(2.5),
                min_valid_share: Some(0.25),
                tolerance_px: Some(1.5),
                max_triangles: Some(70_000),
            }),
            colors: Some(true),
            mesh_is_optional: None,
            focus: vec![
                v1::Focus {
                    region: Some(v1::Region {
                        x: 5,
                        y: 6,
                        width: 7,
                        height: 8,
                    }),
                    weight: Some(2.5),
                },
                v1::Focus {
                    region: Some(v1::Region {
                        x: 0,
                        y: 0,
                        width: 1,
                        height: 1,
                    }),
                    weight: None,
                },
            ],
        }),
    };
    assert_eq!(options_from_json(json.as_bytes()), Ok(expected));
}

#[test]
fn absent_options_and_null_mean_the_defaults() {
    let message = |options: &'static [u8]| {
        let parts = FormParts {
            options: Some(Bytes::from_static(options)),
            ..FormParts::default()
        };
        request_from_form(parts).unwrap()
    };
    let defaults = v1::StereoRequest {
        options: Some(v1::Options::default()),
        ..v1::StereoRequest::default()
    };
    assert_eq!(message(b"{}"), defaults);
    assert_eq!(
        message(br#" {"roi": null, "preset": null, "max_iterations": null} "#),
        defaults
    );
    assert_eq!(
        request_from_form(FormParts::default()),
        Ok(v1::StereoRequest::default())
    );
}

#[test]
fn empty_options_part_is_refused() {
    for json in ["", "  \r\n"] {
        refused_naming(json, &["options part is empty", "leave it out"]);
    }
}

#[test]
fn what_is_not_one_json_object_is_refused() {
    for json in [
        "[]",
        "[80, 4]",
        "80",
        "\"{}\"",
        "null",
        "{",
        "{}{}",
        "{} x",
        "{\"a\"}",
        "\u{feff}{}",
        "{'a': 1}",
    ] {
        refused_naming(json, &["options"]);
    }
    let deep = "[".repeat(100_000);
    refused_naming(&deep, &["options"]);
    refused_naming(&format!("{{\"roi\": {deep}"), &["roi"]);
}

#[test]
fn unknown_and_repeated_options_are_refused_by_name() {
    refused_naming(r#"{"latency_ms": 80}"#, &["latency_ms", "latency_budget_ms"]);
    refused_naming(
        r#"{"roi": {"x": 0, "y": 0, "w": 1, "h": 1}}"#,
        &["roi", "`w`", "`width`"],
    );
    refused_naming(
        r#"{"mesh": {"keep": true}}"#,
        &["mesh", "`keep`", "`keep_rejected`"],
    );
    refused_naming(
        r#"{"max_iterations": 1, "max_iterations": 2}"#,
        &["duplicate field `max_iterations`"],
    );
}

#[test]
fn numbers_of_other_types_are_refused_by_name() {
    refused_naming(r#"{"max_iterations": "4"}"#, &["max_iterations", "string"]);
    refused_naming(
        r#"{"latency_budget_ms": "80ms"}"#,
        &["latency_budget_ms", "string"],
    );
    refused_naming(r#"{"sequence": -1}"#, &["sequence", "-1"]);
    refused_naming(
        r#"{"calibration": {"focal_px": null}}"#,
        &["calibration.focal_px", "null"],
    );
    refused_naming(
        r#"{"calibration": {"focal_px": 1}}"#,
        &["calibration", "missing field"],
    );
    refused_naming(r#"{"roi": [0, 0, 10, 10]}"#, &["roi", "object"]);
    refused_naming(r#"{"focus": [[0, 0, 10, 10]]}"#, &["focus", "object"]);
    refused_naming(r#"{"focus": {"x": 0}}"#, &["focus"]);
    refused_naming(r#"{"outputs": "mesh"}"#, &["outputs"]);
    refused_naming(r#"{"preset": 1}"#, &["preset"]);
}

#[test]
fn numbers_out_of_range_are_refused_naming_the_range() {
    refused_naming(
        r#"{"max_iterations": 1.5}"#,
        &["max_iterations", "1 to 255", "1.5"],
    );
    refused_naming(r#"{"max_iterations": -1}"#, &["max_iterations", "1 to 255", "-1"]);
    refused_naming(r#"{"num_disparities": 1e300}"#, &["num_disparities", "16 to 256"]);
    refused_naming(
        r#"{"mesh": {"max_triangles": 99.5}}"#,
        &["mesh.max_triangles", "100 to 1000000", "99.5"],
    );
    refused_naming(
        r#"{"mesh": {"max_triangles": -1}}"#,
        &["mesh.max_triangles", "100 to 1000000"],
    );
    refused_naming(r#"{"min_disparity": -16}"#, &["min_disparity", "0 to 767"]);
    refused_naming(r#"{"latency_budget_ms": 0}"#, &["latency_budget_ms", "above 0"]);
    refused_naming(r#"{"latency_budget_ms": 1e300}"#, &["latency_budget_ms", "60000"]);
    refused_naming(
        r#"{"roi": {"x": -1, "y": 0, "width": 10, "height": 10}}"#,
        &["roi.x", "-1"],
    );
    refused_naming(
        r#"{"roi": {"x": 0.5, "y": 0, "width": 10, "height": 10}}"#,
        &["roi.x", "whole"],
    );
    refused_naming(
        r#"{"focus": [{"x": 0, "y": -2, "width": 10, "height": 10}]}"#,
        &["focus.y", "-2"],
    );
}

#[test]
fn json_has_no_nan() {
    for json in [
        r#"{"min_confidence": NaN}"#,
        r#"{"calibration": {"focal_px": NaN, "cx_px": 0, "cy_px": 0, "baseline_m": 1}}"#,
        r#"{"latency_budget_ms": Infinity}"#,
        r#"{"min_confidence": 1e999}"#,
    ] {
        refused_naming(json, &["options"]);
    }
}

#[test]
fn unknown_names_of_values_are_refused_naming_those_there_are() {
    refused_naming(
        r#"{"preset": "best"}"#,
        &["preset", "default, fast or paper", "best"],
    );
    refused_naming(r#"{"preset": "PAPER"}"#, &["preset"]);
    refused_naming(r#"{"preset": "unspecified"}"#, &["preset"]);
    refused_naming(r#"{"density": "sparse"}"#, &["density", "semi_dense or dense"]);
    refused_naming(
        r#"{"outputs": ["mesh", "normals"]}"#,
        &["outputs", "normals", "points"],
    );
    refused_naming(
        r#"{"disparity_encoding": "u8"}"#,
        &["disparity_encoding", "f32, u16 or png16"],
    );
    refused_naming(r#"{"compression": "gzip"}"#, &["compression", "none"]);
    refused_naming(r#"{"priority_class": "urgent"}"#, &["priority_class", "deadline"]);
    refused_naming(r#"{"capture_time": "yesterday"}"#, &["capture_time", "RFC 3339"]);
    let long = format!(r#"{{"preset": "{}"}}"#, "x".repeat(100_000));
    assert!(refusal(&long).len() < 200);
}

#[test]
fn images_are_files_and_known_by_their_content() {
    let part = |bytes: &'static [u8]| FormParts {
        left: Some(Bytes::from_static(bytes)),
        ..FormParts::default()
    };
    for bytes in [b"".as_slice(), b"P5 64 64 255\n", b"GIF89a"] {
        let error = request_from_form(part(bytes)).unwrap_err();
        assert!(
            error.http_code() == 400 && error.to_string().contains("left"),
            "{error}"
        );
    }
}
