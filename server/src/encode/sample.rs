//! A small finished frame for the encoders' tests: a slanted plane, the left third near, with a mesh over it.

use std::time::{Duration, Instant};

use bytes::Bytes;
use stereo::{DisparityMap, GrayView, Mesh, Shape, Vertex};

use crate::job::{
    Calibration, Degradation, DisparityEncoding, FrameIds, FrameOptions, FrameRequest, ImageData,
    ImageEncoding, MatchedFrame, Outputs, PixelFormat, Report, RungsCut,
};

pub(super) const WIDTH: usize = 48;
pub(super) const HEIGHT: usize = 32;

pub(super) const CAMERA: Calibration = Calibration {
    focal_px: 40.0,
    cx_px: 23.5,
    cy_px: 15.5,
    baseline_m: 0.25,
    doffs_px: 0.0,
};

/// Everything a [`MatchedFrame`] borrows.
pub(super) struct Sample {
    pub(super) request: FrameRequest,
    pub(super) gray: Vec<u8>,
    pub(super) map: DisparityMap,
    pub(super) mesh: Mesh,
}

impl Sample {
    /// Raw colour pixels, all different from their neighbours.
    pub(super) fn rgb() -> Vec<u8> {
        let byte = |n: usize| u8::try_from(n % 256).unwrap();
        (0..WIDTH * HEIGHT)
            .flat_map(|i| [byte(i % WIDTH * 5), byte(i / WIDTH * 7), byte(i * 31)])
            .collect()
    }

    /// A frame with the left image `data` in `encoding`.
    pub(super) fn new(encoding: ImageEncoding, data: Vec<u8>, calibration: Option<Calibration>) -> Self {
        let step = match encoding {
            ImageEncoding::Raw(PixelFormat::Mono8) => WIDTH,
            ImageEncoding::Raw(PixelFormat::Rgb8) => WIDTH * 3,
            _ => 0,
        };
        let image = ImageData {
            encoding,
            width_px: u32::try_from(WIDTH).unwrap(),
            height_px: u32::try_from(HEIGHT).unwrap(),
            step_bytes: u32::try_from(step).unwrap(),
            frame_id: "left".into(),
            data: Bytes::from(data),
        };
        let request = FrameRequest {
            ids: FrameIds {
                request_id: "r-1".into(),
                sequence: Some(7),
                ..FrameIds::default()
            },
            left: image.clone(),
            right: image,
            calibration,
            options: FrameOptions {
                latency_budget: Duration::from_millis(100),
                max_iterations: None,
                params: stereo::Params::default(),
                mesh: stereo::MeshParams::default(),
                outputs: Outputs {
                    disparity: true,
                    confidence: false,
                    depth: false,
                    mesh: true,
                    mesh_is_optional: false,
                    points: false,
                    colors: false,
                },
                disparity_encoding: DisparityEncoding::U16,
                ..FrameOptions::default()
            },
            formats: Vec::new(),
            received_at: Instant::now(),
            client: String::new(),
        };
        let mut map = DisparityMap::new(Shape::new(WIDTH, HEIGHT).unwrap());
        for (i, fixed) in map.parts_mut().0.iter_mut().enumerate() {
            *fixed = if i % 3 == 0 {
                0
            } else {
                u16::try_from(64 * 5 + i % WIDTH).unwrap()
            };
        }
        let vertex = |u: f32, v: f32, disparity: f32| Vertex { u, v, disparity };
        // Counter-clockwise seen by the camera: down the left side, then to the right, then up.
        let mesh = Mesh {
            vertices: vec![
                vertex(0.0, 0.0, 10.0),
                vertex(0.0, 31.0, 10.0),
                vertex(47.0, 31.0, 5.0),
                vertex(47.0, 0.0, 5.0),
            ],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
        };
        Self {
            request,
            gray: vec![128; WIDTH * HEIGHT],
            map,
            mesh,
        }
    }

    /// A frame with a raw colour image.
    pub(super) fn colour(calibration: Option<Calibration>) -> Self {
        Self::new(ImageEncoding::Raw(PixelFormat::Rgb8), Self::rgb(), calibration)
    }

    pub(super) fn frame(&self) -> MatchedFrame<'_> {
        MatchedFrame {
            request: &self.request,
            left_gray: GrayView::new(&self.gray, WIDTH, HEIGHT, WIDTH).unwrap(),
            map: &self.map,
            mesh: Some(&self.mesh),
        }
    }
}

pub(super) fn report() -> Report {
    Report {
        budget: Duration::from_millis(100),
        encoded: Duration::from_micros(1500),
        iterations_run: 3,
        iterations_asked: 4,
        rung: "full band",
        deadline_met: true,
        quality_estimate: 0.9,
        density: 0.75,
        degradation: Degradation {
            rungs: Some(RungsCut::Budget),
            ..Degradation::default()
        },
        instance: "stereod".into(),
        software_version: "0.1.0",
        ..Report::default()
    }
}
