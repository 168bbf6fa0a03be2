//! Bytes once sent decode for ever: `golden/*.bin` are never changed, only added to.

use std::error::Error;
use std::fs;
use std::path::Path;

use bytes::Bytes;
use prost::Message;
use prost_types::{Duration, Timestamp};
use stereo_proto::v1::{
    self, BatchReply, Calibration, Compression, Density, Depth, Disparity, DisparityEncoding,
    ExecutionReport, Image, ImageEncoding, Mesh, MeshOptions, MeshSpace, Options, Output, PointCloud, Preset,
    PriorityClass, Reason, Region, Status, StereoRequest, StereoResult, batch_reply::Outcome,
};

const TAKEN: Timestamp = Timestamp {
    seconds: 1_763_785_901,
    nanos: 250_000_000,
};
const CAMERA: Calibration = Calibration {
    focal_px: 721.5,
    cx_px: 609.5,
    cy_px: 172.75,
    baseline_m: 0.5375,
    doffs_px: -1.25,
};
const WINDOW: Region = Region {
    x: 1,
    y: 0,
    width: 3,
    height: 2,
};

/// Decodes `golden/{name}.bin`, which must mean `expected` and encode to the same bytes. A file that does not exist is
/// written, and the test fails once.
fn check<M>(name: &str, expected: &M) -> Result<(), Box<dyn Error>>
where
    M: Message + Default + PartialEq + std::fmt::Debug,
{
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("golden")
        .join(format!("{name}.bin"));
    if !path.exists() {
        fs::write(&path, expected.encode_to_vec())?;
        return Err(
            format!("golden/{name}.bin did not exist and has been written: run again and commit it").into(),
        );
    }
    let golden = fs::read(path)?;
    let decoded = M::decode(Bytes::from(golden.clone()))?;
    assert_eq!(
        &decoded, expected,
        "golden/{name}.bin no longer means what it meant"
    );
    assert_eq!(
        decoded.encode_to_vec(),
        golden,
        "golden/{name}.bin encodes differently"
    );
    Ok(())
}

fn image(encoding: ImageEncoding, data: &'static [u8]) -> Image {
    Image {
        timestamp: Some(TAKEN),
        frame_id: "rig/left".into(),
        width: 4,
        height: 2,
        encoding: encoding.into(),
        step: 4,
        data: Bytes::from_static(data),
    }
}

fn ms(ms: i32) -> Option<Duration> {
    Some(Duration {
        seconds: 0,
        nanos: ms * 1_000_000,
    })
}

fn request() -> StereoRequest {
    StereoRequest {
        request_id: "frame 17/a".into(),
        camera_id: "rig-1".into(),
        sequence: Some(0),
        capture_time: Some(TAKEN),
        left: Some(image(ImageEncoding::Mono8, &[0, 1, 2, 3, 4, 5, 6, 255])),
        right: Some(image(ImageEncoding::Jpeg, &[0xff, 0xd8, 0xff])),
        calibration: Some(CAMERA),
        options: Some(Options {
            latency_budget: ms(80),
            max_iterations: Some(4),
            preset: Preset::Paper.into(),
            min_confidence: Some(0.0),
            num_disparities: Some(128),
            min_disparity: Some(0),
            density: Density::Dense.into(),
            roi: Some(WINDOW),
            priority_class: PriorityClass::Background.into(),
            outputs: vec![Output::Disparity.into(), Output::Points.into()],
            disparity_encoding: DisparityEncoding::Png16.into(),
            compression: Compression::Lz4.into(),
            allow_downscale: Some(false),
            mesh: Some(MeshOptions {
                keep_rejected: Some(true),
                max_disparity_step_px: Some(2.5),
                min_valid_share: Some(0.25),
                tolerance_px: None,
                max_triangles: None,
            }),
            colors: Some(true),
            mesh_is_optional: None,
            focus: Vec::new(),
        }),
    }
}

fn report() -> ExecutionReport {
    ExecutionReport {
        budget: ms(80),
        received: ms(1),
        queued: ms(2),
        decoded: ms(3),
        matched: ms(4),
        meshed: ms(5),
        encoded: ms(6),
        total: ms(21),
        iterations_run: 3,
        iterations_asked: 4,
        rung: "mesh-4".into(),
        predicted_cost: ms(17),
        actual_cost: ms(18),
        deadline_met: true,
        quality_estimate: 0.875,
        density: 0.75,
        degradation: "budget".into(),
        worker: 1,
        instance: "server-1".into(),
        queue_depth: 2,
        software_version: "0.1.0".into(),
        has_converged: false,
    }
}

fn result() -> StereoResult {
    StereoResult {
        request_id: "frame 17/a".into(),
        camera_id: "rig-1".into(),
        sequence: Some(17),
        capture_time: Some(TAKEN),
        disparity: Some(Disparity {
            timestamp: Some(TAKEN),
            frame_id: "rig/left".into(),
            width: 2,
            height: 1,
            encoding: DisparityEncoding::U16.into(),
            step: 4,
            data: Bytes::from_static(&[0, 0, 1, 2]),
            calibration: Some(CAMERA),
            min_disparity_px: 16,
            max_disparity_px: 144,
            valid_window: Some(WINDOW),
            confidence: Bytes::from_static(&[0, 254]),
            compression: Compression::Unspecified.into(),
        }),
        depth: Some(Depth {
            timestamp: Some(TAKEN),
            frame_id: "rig/left".into(),
            width: 1,
            height: 1,
            step: 4,
            data: Bytes::from_static(&[0, 0, 128, 63]),
            calibration: Some(CAMERA),
            valid_window: Some(WINDOW),
            compression: Compression::Unspecified.into(),
        }),
        mesh: Some(Mesh {
            timestamp: Some(TAKEN),
            frame_id: "rig/left".into(),
            space: MeshSpace::Metres.into(),
            positions: Bytes::from_static(&[0; 12]),
            indices: Bytes::from_static(&[0; 12]),
            uvs: Bytes::from_static(&[0; 8]),
            disparities: Bytes::from_static(&[0, 0, 128, 63]),
            colors: Bytes::from_static(&[1, 2, 3]),
            compression: Compression::Unspecified.into(),
        }),
        points: Some(PointCloud {
            timestamp: Some(TAKEN),
            frame_id: "rig/left".into(),
            positions: Bytes::from_static(&[0; 12]),
            colors: Bytes::from_static(&[1, 2, 3]),
            compression: Compression::Unspecified.into(),
        }),
        report: Some(report()),
    }
}

fn status() -> Status {
    Status {
        code: 504,
        reason: Reason::DeadlineInfeasible.into(),
        message: "a budget of 5 ms can't be met".into(),
        earliest_feasible: ms(12),
        request_id: "frame 17/a".into(),
    }
}

#[test]
fn request_of_release_1_is_still_understood() -> Result<(), Box<dyn Error>> {
    check("stereo_request", &request())
}

#[test]
fn result_of_release_1_is_still_understood() -> Result<(), Box<dyn Error>> {
    check("stereo_result", &result())
}

#[test]
fn status_of_release_1_is_still_understood() -> Result<(), Box<dyn Error>> {
    check("status", &status())
}

#[test]
fn batch_replies_of_release_1_are_still_understood() -> Result<(), Box<dyn Error>> {
    let reply = |outcome| BatchReply {
        request_id: "frame 17/a".into(),
        outcome: Some(outcome),
    };
    check("batch_reply_result", &reply(Outcome::Result(Box::new(result()))))?;
    check("batch_reply_status", &reply(Outcome::Status(status())))
}

#[test]
fn field_of_a_later_release_is_skipped() -> Result<(), Box<dyn Error>> {
    let mut bytes = status().encode_to_vec();
    // Field 999, wire type 2 (length-delimited), three bytes.
    bytes.extend([0xba, 0x3e, 3, 1, 2, 3]);
    assert_eq!(Status::decode(Bytes::from(bytes))?, status());
    Ok(())
}

#[test]
fn pixels_are_a_slice_of_the_body_they_came_in() -> Result<(), Box<dyn Error>> {
    let body = Bytes::from(request().encode_to_vec());
    let decoded = StereoRequest::decode(body.clone())?;
    let data = decoded.left.ok_or("no left image")?.data;
    assert!(
        body.as_ptr_range().contains(&data.as_ptr()),
        "the pixels were copied"
    );
    Ok(())
}

#[test]
fn regions_to_focus_on_are_still_understood() -> Result<(), Box<dyn Error>> {
    let focus = |weight| v1::Focus {
        region: Some(WINDOW),
        weight,
    };
    let request = StereoRequest {
        options: Some(Options {
            focus: vec![focus(Some(2.5)), focus(None)],
            ..Options::default()
        }),
        ..StereoRequest::default()
    };
    check("stereo_request_focus", &request)
}
