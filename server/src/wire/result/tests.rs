use std::time::{Duration, Instant};

use bytes::Bytes;
use stereo::{DisparityMap, GrayView, Mesh, Roi, Shape, Vertex};
use stereo_proto::v1::{DisparityEncoding as Wire, MeshSpace, StereoResult};

use super::*;
use crate::job::{
    FrameIds, FrameOptions, FrameRequest, ImageData, ImageEncoding, Outputs, PixelFormat, ReplyFormat,
};

const WIDTH: usize = 40;
const HEIGHT: usize = 32;
const CAMERA: Calibration = Calibration {
    focal_px: 100.0,
    cx_px: 20.0,
    cy_px: 16.0,
    baseline_m: 0.5,
    doffs_px: 0.0,
};
const ALL: Outputs = Outputs {
    disparity: true,
    confidence: true,
    depth: true,
    mesh: true,
    mesh_is_optional: false,
    points: true,
    colors: true,
};

/// A frame with three valid pixels and a mesh of two triangles, one of which reaches to infinity.
struct Finished {
    request: FrameRequest,
    gray: Vec<u8>,
    map: DisparityMap,
    mesh: Mesh,
}

impl Finished {
    fn new(calibration: Option<Calibration>, outputs: Outputs) -> Self {
        let rgb: Vec<u8> = (0..WIDTH * HEIGHT)
            .flat_map(|at| [u8::try_from(at % WIDTH).unwrap(), 100, 200])
            .collect();
        let image = ImageData {
            encoding: ImageEncoding::Raw(PixelFormat::Rgb8),
            width_px: u32::try_from(WIDTH).unwrap(),
            height_px: u32::try_from(HEIGHT).unwrap(),
            step_bytes: u32::try_from(3 * WIDTH).unwrap(),
            frame_id: "rig/left".into(),
            data: Bytes::from(rgb),
        };
        let request = FrameRequest {
            ids: FrameIds {
                request_id: "r".into(),
                camera_id: "c".into(),
                sequence: Some(3),
                capture_time: Some(SystemTime::UNIX_EPOCH + Duration::new(1_700_000_000, 250)),
            },
            left: image.clone(),
            right: image,
            calibration,
            options: FrameOptions {
                outputs,
                ..FrameOptions::default()
            },
            formats: vec![ReplyFormat::Protobuf],
            received_at: Instant::now(),
            client: String::new(),
        };
        let mut map = DisparityMap::new(Shape::new(WIDTH, HEIGHT).unwrap());
        let (fixed, confidence) = map.parts_mut();
        fixed[0] = 1;
        fixed[WIDTH + 2] = 10 * 64;
        fixed[WIDTH * HEIGHT - 1] = 100 * 64 + 32;
        confidence[WIDTH + 2] = 254;
        let vertex = |u, v, disparity| Vertex { u, v, disparity };
        let mesh = Mesh {
            vertices: vec![
                vertex(20.0, 16.0, 50.0),
                vertex(20.0, 26.0, 50.0),
                vertex(30.0, 16.0, 50.0),
                vertex(39.0, 31.0, 0.0),
            ],
            triangles: vec![[0, 1, 2], [1, 3, 2]],
        };
        Self {
            request,
            gray: vec![0; WIDTH * HEIGHT],
            map,
            mesh,
        }
    }

    fn frame(&self) -> MatchedFrame<'_> {
        MatchedFrame {
            request: &self.request,
            left_gray: GrayView::new(&self.gray, WIDTH, HEIGHT, WIDTH).unwrap(),
            map: &self.map,
            mesh: Some(&self.mesh),
        }
    }

    fn body(&self) -> StereoResult {
        let frame = self.frame();
        let report = || Report {
            iterations_run: 3,
            matched: Duration::from_micros(1500),
            ..Report::default()
        };
        StereoResult::decode(result_body(&frame, None, &report).unwrap().into_bytes()).unwrap()
    }
}

fn floats(bytes: &[u8]) -> Vec<f32> {
    bytes
        .as_chunks::<4>()
        .0
        .iter()
        .map(|&chunk| f32::from_le_bytes(chunk))
        .collect()
}

#[test]
fn ids_times_and_the_report_come_back() {
    let result = Finished::new(Some(CAMERA), ALL).body();
    assert_eq!(
        (
            result.request_id.as_str(),
            result.camera_id.as_str(),
            result.sequence
        ),
        ("r", "c", Some(3))
    );
    let taken = prost_types::Timestamp {
        seconds: 1_700_000_000,
        nanos: 250,
    };
    assert_eq!(result.capture_time, Some(taken));
    let report = result.report.unwrap();
    assert_eq!(report.iterations_run, 3);
    assert_eq!(
        report.matched,
        Some(prost_types::Duration {
            seconds: 0,
            nanos: 1_500_000
        })
    );
    let disparity = result.disparity.unwrap();
    assert_eq!(
        (disparity.timestamp, disparity.frame_id.as_str()),
        (Some(taken), "rig/left")
    );
    assert_eq!((disparity.min_disparity_px, disparity.max_disparity_px), (0, 128));
    assert_eq!(disparity.calibration.unwrap().baseline_m, 0.5);
}

#[test]
fn only_the_wanted_parts_are_there() {
    let none = Outputs {
        disparity: false,
        confidence: false,
        depth: false,
        mesh: false,
        mesh_is_optional: false,
        points: false,
        colors: true,
    };
    let result = Finished::new(Some(CAMERA), none).body();
    assert!(result.disparity.is_none() && result.depth.is_none() && result.mesh.is_none());
    assert!(result.points.is_none() && result.report.is_some());
    let disparity = Finished::new(
        None,
        Outputs {
            confidence: true,
            ..none
        },
    )
    .body()
    .disparity
    .unwrap();
    assert!(disparity.data.is_empty() && disparity.confidence.len() == WIDTH * HEIGHT);
    assert_eq!(disparity.encoding(), Wire::Unspecified);
    let disparity = Finished::new(
        None,
        Outputs {
            disparity: true,
            ..none
        },
    )
    .body()
    .disparity
    .unwrap();
    assert!(disparity.confidence.is_empty() && !disparity.data.is_empty());
}

#[test]
fn the_three_disparity_encodings_say_the_same() {
    let mut frame = Finished::new(None, ALL);
    let mut encoded = |encoding| {
        frame.request.options.disparity_encoding = encoding;
        frame.body().disparity.unwrap()
    };
    let u16s = encoded(DisparityEncoding::U16);
    assert_eq!(
        (u16s.encoding(), u16s.step as usize, u16s.data.len()),
        (Wire::U16, 2 * WIDTH, 2 * WIDTH * HEIGHT)
    );
    let values: Vec<u16> = u16s
        .data
        .as_chunks::<2>()
        .0
        .iter()
        .map(|&chunk| u16::from_le_bytes(chunk))
        .collect();
    assert_eq!((values[0], values[1], values[WIDTH + 2]), (4, 0, 2560));

    let f32s = encoded(DisparityEncoding::F32);
    assert_eq!((f32s.encoding(), f32s.step as usize), (Wire::F32, 4 * WIDTH));
    for (px, value) in floats(&f32s.data).into_iter().zip(&values) {
        assert!(if *value == 0 {
            px.is_nan()
        } else {
            px == f32::from(*value) / 256.0
        });
    }

    let png = encoded(DisparityEncoding::Png16);
    assert_eq!((png.encoding(), png.step), (Wire::Png16, 0));
    let image = image::load_from_memory(&png.data).unwrap().into_luma16();
    assert_eq!(image.into_raw(), values);
    assert_eq!(png.confidence[WIDTH + 2], 254);
}

#[test]
fn data_that_is_written_behind_everything_else_is_read_as_what_it_is_a_part_of() {
    let mut finished = Finished::new(Some(CAMERA), ALL);
    for encoding in [
        DisparityEncoding::F32,
        DisparityEncoding::U16,
        DisparityEncoding::Png16,
    ] {
        finished.request.options.disparity_encoding = encoding;
        let whole = without_report(&finished.frame()).unwrap();
        let result = finished.body();
        assert_eq!(result.disparity, whole.disparity, "{encoding:?}");
        let alone = disparity_body(&finished.frame(), None).unwrap();
        let alone = v1::Disparity::decode(alone.into_bytes()).unwrap();
        assert_eq!(Some(alone), whole.disparity, "{encoding:?}");
        let rest = |result: StereoResult| StereoResult {
            report: None,
            ..result
        };
        assert_eq!(rest(result), whole, "{encoding:?}");
    }
}

#[test]
fn depth_is_metres_and_nan_where_nothing_is_known() {
    let depth = Finished::new(Some(CAMERA), ALL).body().depth.unwrap();
    let depth_m = floats(&depth.data);
    assert_eq!(depth_m[WIDTH + 2], 5.0);
    assert_eq!(depth_m[0], 3200.0);
    assert_eq!(depth_m.iter().filter(|depth| depth.is_finite()).count(), 3);
}

#[test]
fn mesh_is_in_metres_when_calibrated_and_leaves_infinity_out() {
    let mesh = Finished::new(Some(CAMERA), ALL).body().mesh.unwrap();
    assert_eq!(mesh.space(), MeshSpace::Metres);
    assert_eq!(
        floats(&mesh.positions),
        [0.0, 0.0, 1.0, 0.0, 0.1, 1.0, 0.1, 0.0, 1.0]
    );
    assert_eq!(floats(&mesh.disparities), [50.0; 3]);
    assert_eq!(
        mesh.indices,
        [0_u32, 1, 2]
            .iter()
            .flat_map(|index| index.to_le_bytes())
            .collect::<Vec<_>>()
    );
    assert_eq!(mesh.colors[..], [20, 100, 200, 20, 100, 200, 30, 100, 200]);
    assert_eq!(floats(&mesh.uvs)[..2], [20.5 / 40.0, 16.5 / 32.0]);
}

#[test]
fn mesh_is_in_pixels_and_disparity_without_a_calibration() {
    let outputs = Outputs {
        depth: false,
        points: false,
        colors: false,
        ..ALL
    };
    let mesh = Finished::new(None, outputs).body().mesh.unwrap();
    assert_eq!(mesh.space(), MeshSpace::Pixels);
    assert_eq!(floats(&mesh.positions)[..6], [20.0, 16.0, 50.0, 20.0, 26.0, 50.0]);
    assert!(mesh.colors.is_empty());
}

#[test]
fn points_are_the_valid_pixels_in_metres_with_their_colours() {
    let points = Finished::new(Some(CAMERA), ALL).body().points.unwrap();
    let positions = floats(&points.positions);
    assert_eq!(positions.len(), 9);
    assert_eq!(positions[3..6], [-0.9, -0.75, 5.0]);
    assert_eq!(points.colors[3..6], [2, 100, 200]);
}

#[test]
fn valid_window_is_the_region_of_interest() {
    let mut frame = Finished::new(None, Outputs::default());
    let window = frame.body().disparity.unwrap().valid_window.unwrap();
    assert_eq!((window.x, window.y, window.width, window.height), (0, 0, 40, 32));
    frame.request.options.params.roi = Some(Roi {
        x: 1,
        y: 2,
        width: 3,
        height: 4,
    });
    let window = frame.body().disparity.unwrap().valid_window.unwrap();
    assert_eq!((window.x, window.y, window.width, window.height), (1, 2, 3, 4));
}
