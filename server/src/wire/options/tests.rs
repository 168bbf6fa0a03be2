use stereo_proto::v1::{Compression, Options, Output, PriorityClass, Region};

use super::*;

mod regions;

fn circumstances(formats: &[ReplyFormat]) -> Circumstances<'_> {
    let shape = Shape::new(640, 480).unwrap();
    Circumstances {
        shape,
        is_calibrated: false,
        formats,
        latency_budget: None,
        priority: crate::job::PriorityClass::default(),
    }
}

fn valid(options: &Options) -> FrameOptions {
    validate(options, &circumstances(&[ReplyFormat::Protobuf])).unwrap()
}

fn refusal(options: &Options) -> (u16, String) {
    let error = validate(options, &circumstances(&[ReplyFormat::Protobuf])).unwrap_err();
    (error.http_code(), error.to_string())
}

fn refused_naming(options: &Options, words: &[&str]) {
    let (code, text) = refusal(options);
    assert_eq!(code, 400, "{text}");
    for word in words {
        assert!(text.contains(word), "`{word}` is missing in: {text}");
    }
}

#[test]
fn absent_options_have_their_defaults() {
    assert_eq!(valid(&Options::default()), FrameOptions::default());
}

#[test]
fn every_option_reaches_the_domain() {
    let options = Options {
        latency_budget: Some(prost_types::Duration {
            seconds: 1,
            nanos: 500_000_000,
        }),
        max_iterations: Some(255),
        preset: v1::Preset::Paper.into(),
        min_confidence: Some(0.5),
        num_disparities: Some(64),
        min_disparity: Some(16),
        density: v1::Density::Dense.into(),
        roi: Some(Region {
            x: 600,
            y: 0,
            width: 40,
            height: 480,
        }),
        priority_class: PriorityClass::Deadline.into(),
        outputs: vec![Output::Mesh.into(), Output::Mesh.into(), Output::Depth.into()],
        disparity_encoding: v1::DisparityEncoding::F32.into(),
        compression: Compression::None.into(),
        allow_downscale: Some(false),
        mesh_is_optional: None,
        focus: Vec::new(),
        mesh: Some(v1::MeshOptions {
            keep_rejected: Some(true),
            max_disparity_step_px: Some(0.5),
            tolerance_px: Some(0.25),
            max_triangles: Some(100),
            min_valid_share: Some(1.0),
        }),
        colors: Some(true),
    };
    let calibrated = Circumstances {
        is_calibrated: true,
        ..circumstances(&[ReplyFormat::Protobuf])
    };
    let expected = FrameOptions {
        latency_budget: Duration::from_millis(1500),
        max_iterations: Some(255),
        params: Params {
            preset: Preset::Paper,
            range: DisparityRange {
                min_px: 16,
                count: 64,
            },
            density: Density::Dense,
            min_confidence: 0.5,
            roi: Some(Roi {
                x: 600,
                y: 0,
                width: 40,
                height: 480,
            }),
            focus: Vec::new(),
        },
        mesh: MeshParams {
            keep_rejected: true,
            max_disparity_step_px: 0.5,
            tolerance_px: 0.25,
            max_triangles: 100,
            min_valid_share: 1.0,
        },
        outputs: Outputs {
            disparity: false,
            confidence: false,
            depth: true,
            mesh: true,
            mesh_is_optional: false,
            points: false,
            colors: true,
        },
        disparity_encoding: DisparityEncoding::F32,
        ..FrameOptions::default()
    };
    assert_eq!(validate(&options, &calibrated), Ok(expected));
}

#[test]
fn smallest_budget_counts() {
    let with = |in_body: Option<i64>, outside: Option<u64>| {
        let options = Options {
            latency_budget: in_body.map(|seconds| prost_types::Duration { seconds, nanos: 0 }),
            ..Options::default()
        };
        let latency_budget = outside.map(Duration::from_secs);
        validate(
            &options,
            &Circumstances {
                latency_budget,
                ..circumstances(&[])
            },
        )
        .unwrap()
        .latency_budget
    };
    assert_eq!(with(None, None), Duration::from_millis(100));
    assert_eq!(with(None, Some(3)), Duration::from_secs(3));
    assert_eq!(with(Some(2), None), Duration::from_secs(2));
    assert_eq!(with(Some(2), Some(3)), Duration::from_secs(2));
    assert_eq!(with(Some(4), Some(3)), Duration::from_secs(3));
}

#[test]
fn numbers_out_of_range_are_refused_naming_field_and_range() {
    let default = Options::default;
    for got in [0, 256, u32::MAX] {
        refused_naming(
            &Options {
                max_iterations: Some(got),
                ..default()
            },
            &["max_iterations", "1 to 255"],
        );
    }
    for got in [0, 8, 17, 272, u32::MAX] {
        let options = Options {
            num_disparities: Some(got),
            ..default()
        };
        refused_naming(
            &options,
            &["num_disparities", "16 to 256 in steps of 16", &got.to_string()],
        );
    }
    for got in [-1, 768, i32::MIN, i32::MAX] {
        refused_naming(
            &Options {
                min_disparity: Some(got),
                ..default()
            },
            &["min_disparity", "0 to 767"],
        );
    }
    for got in [-0.1, 1.1, f32::NAN, f32::INFINITY] {
        refused_naming(
            &Options {
                min_confidence: Some(got),
                ..default()
            },
            &["min_confidence", "0 to 1"],
        );
        let mesh = v1::MeshOptions {
            min_valid_share: Some(got),
            ..v1::MeshOptions::default()
        };
        refused_naming(
            &Options {
                mesh: Some(mesh),
                ..default()
            },
            &["mesh.min_valid_share", "0 to 1"],
        );
    }
    for got in [0.0, 0.09, 64.5, f32::NAN] {
        let mesh = v1::MeshOptions {
            tolerance_px: Some(got),
            ..v1::MeshOptions::default()
        };
        refused_naming(
            &Options {
                mesh: Some(mesh),
                ..default()
            },
            &["mesh.tolerance_px", "0.1 to 64"],
        );
    }
    for got in [0, 99, 1_000_001, u32::MAX] {
        let mesh = v1::MeshOptions {
            max_triangles: Some(got),
            ..v1::MeshOptions::default()
        };
        refused_naming(
            &Options {
                mesh: Some(mesh),
                ..default()
            },
            &["mesh.max_triangles", "100 to 1000000"],
        );
    }
    for got in [0.4, 64.5, f32::NAN] {
        let mesh = v1::MeshOptions {
            max_disparity_step_px: Some(got),
            ..v1::MeshOptions::default()
        };
        refused_naming(
            &Options {
                mesh: Some(mesh),
                ..default()
            },
            &["mesh.max_disparity_step_px", "0.5 to 64"],
        );
    }
    let zero = Some(prost_types::Duration::default());
    refused_naming(
        &Options {
            latency_budget: zero,
            ..default()
        },
        &["latency_budget", "60 s"],
    );
}

#[test]
fn unknown_values_are_refused_naming_the_field_and_what_there_is() {
    let default = Options::default;
    refused_naming(
        &Options {
            preset: 99,
            ..default()
        },
        &["preset", "99", "default, fast or paper"],
    );
    refused_naming(
        &Options {
            density: -1,
            ..default()
        },
        &["density", "-1", "semi_dense or dense"],
    );
    refused_naming(
        &Options {
            disparity_encoding: 9,
            ..default()
        },
        &["disparity_encoding", "f32, u16 or png16"],
    );
    refused_naming(
        &Options {
            outputs: vec![0],
            ..default()
        },
        &["outputs", "disparity, confidence"],
    );
    refused_naming(
        &Options {
            outputs: vec![1, 77],
            ..default()
        },
        &["outputs", "77"],
    );
    refused_naming(
        &Options {
            compression: 42,
            ..default()
        },
        &["compression", "42"],
    );
    refused_naming(
        &Options {
            priority_class: 42,
            ..default()
        },
        &["priority_class", "42"],
    );
}

#[test]
fn compression_priority_and_downscaling_are_honoured() {
    let options = Options {
        compression: Compression::Lz4.into(),
        priority_class: PriorityClass::BestEffort.into(),
        allow_downscale: Some(true),
        mesh_is_optional: Some(true),
        ..Options::default()
    };
    let valid = valid(&options);
    assert_eq!(valid.compression, crate::job::Compression::Lz4);
    assert_eq!(valid.priority, crate::job::PriorityClass::BestEffort);
    assert!(valid.allow_downscale && valid.outputs.mesh_is_optional);
}

#[test]
fn background_has_a_budget_of_its_own_and_no_deadline() {
    let background = Options {
        priority_class: PriorityClass::Background.into(),
        ..Options::default()
    };
    assert_eq!(valid(&background).latency_budget, FrameOptions::UNBOUNDED);
    let with_header = Circumstances {
        latency_budget: Some(Duration::from_millis(80)),
        ..circumstances(&[ReplyFormat::Protobuf])
    };
    let error = validate(&background, &with_header).unwrap_err().to_string();
    assert!(error.contains("background"), "{error}");
    let batch = Circumstances {
        priority: crate::job::PriorityClass::Background,
        ..circumstances(&[ReplyFormat::Protobuf])
    };
    let plain = Options::default();
    assert_eq!(
        validate(&plain, &batch).unwrap().priority,
        crate::job::PriorityClass::Background
    );
    let urgent = Options {
        priority_class: PriorityClass::Deadline.into(),
        ..plain
    };
    assert!(
        validate(&urgent, &batch)
            .unwrap_err()
            .to_string()
            .contains("priority_class")
    );
}

#[test]
fn depth_and_points_need_a_calibration() {
    for (output, name) in [(Output::Depth, "depth"), (Output::Points, "points")] {
        let options = Options {
            outputs: vec![output.into()],
            ..Options::default()
        };
        refused_naming(&options, &[name, "needs a calibration"]);
    }
}

#[test]
fn disparities_that_16_bits_cannot_say_are_422_only_where_16_bits_are_sent() {
    let mut options = Options {
        min_disparity: Some(144),
        ..Options::default()
    };
    assert_eq!(
        valid(&Options {
            min_disparity: Some(128),
            ..Options::default()
        })
        .params
        .range
        .min_px,
        128
    );
    let (code, text) = refusal(&options);
    assert!(
        code == 422 && text.contains("272") && text.contains("f32"),
        "{text}"
    );
    for (formats, is_valid) in [
        (vec![ReplyFormat::DisparityPng], false),
        (vec![ReplyFormat::Glb, ReplyFormat::DisparityPng], false),
        (
            vec![
                ReplyFormat::Glb,
                ReplyFormat::ColorPng,
                ReplyFormat::Json,
                ReplyFormat::Ply,
            ],
            true,
        ),
    ] {
        assert_eq!(
            validate(&options, &circumstances(&formats)).is_ok(),
            is_valid,
            "{formats:?}"
        );
    }
    options.disparity_encoding = v1::DisparityEncoding::F32.into();
    assert_eq!(valid(&options).params.range.min_px, 144);
    options.disparity_encoding = v1::DisparityEncoding::Png16.into();
    options.outputs = vec![Output::Mesh.into()];
    assert_eq!(valid(&options).params.range.min_px, 144);
}

#[test]
fn calibration_has_to_be_finite_with_focal_length_and_baseline_above_zero() {
    let good = v1::Calibration {
        focal_px: 500.0,
        cx_px: -3.0,
        cy_px: 0.0,
        baseline_m: 0.1,
        doffs_px: -1.0,
    };
    assert!(calibration(good).is_ok());
    let bad = [
        (
            "focal_px",
            v1::Calibration {
                focal_px: 0.0,
                ..good
            },
        ),
        (
            "focal_px",
            v1::Calibration {
                focal_px: f64::NAN,
                ..good
            },
        ),
        (
            "baseline_m",
            v1::Calibration {
                baseline_m: -0.1,
                ..good
            },
        ),
        (
            "baseline_m",
            v1::Calibration {
                baseline_m: f64::INFINITY,
                ..good
            },
        ),
        (
            "cx_px",
            v1::Calibration {
                cx_px: f64::NAN,
                ..good
            },
        ),
        (
            "cy_px",
            v1::Calibration {
                cy_px: f64::NEG_INFINITY,
                ..good
            },
        ),
        (
            "doffs_px",
            v1::Calibration {
                doffs_px: f64::NAN,
                ..good
            },
        ),
    ];
    for (name, wire) in bad {
        let error = calibration(wire).unwrap_err();
        assert_eq!(error.http_code(), 400);
        assert!(
            error.to_string().contains(&format!("calibration.{name} must be")),
            "{error}"
        );
    }
}
