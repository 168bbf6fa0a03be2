//! The dummy pair that each worker matches when it starts: memory is touched, and the costs of the stages are known before the
//! first client waits for them.

use std::time::{Duration, Instant};

use bytes::Bytes;

use super::worker::{Stopped, Worker};
use crate::dispatch::Job;
use crate::job::{FrameIds, FrameOptions, FrameRequest, ImageData, ImageEncoding, PixelFormat, ReplyFormat};

const WIDTH_PX: u32 = 640;
const HEIGHT_PX: u32 = 480;
/// Everything in the dummy scene is at one distance.
const DISPARITY_PX: u32 = 20;
/// Long enough for the whole ladder on a slow and busy machine.
const BUDGET: Duration = Duration::from_secs(60);

/// Matches the dummy pair and makes every kind of body of it.
pub(super) fn prime(worker: &mut Worker) -> Result<(), Stopped> {
    let (job, _outcome) = Job::detached(dummy_request());
    worker.process(&job, 0).map(drop)
}

/// A flat wall with a fine random texture.
pub(super) fn dummy_request() -> FrameRequest {
    FrameRequest {
        ids: FrameIds::default(),
        left: wall(0),
        right: wall(DISPARITY_PX),
        calibration: None,
        options: FrameOptions {
            latency_budget: BUDGET,
            ..FrameOptions::default()
        },
        formats: vec![
            ReplyFormat::Protobuf,
            ReplyFormat::Json,
            ReplyFormat::DisparityPng,
            ReplyFormat::ColorPng,
            ReplyFormat::Glb,
            ReplyFormat::Ply,
        ],
        received_at: Instant::now(),
    }
}

/// The wall as a camera sees it that stands `shift_px` pixels further to the right.
fn wall(shift_px: u32) -> ImageData {
    let pixel = |x: u32, y: u32| {
        let noise = (x / 2).wrapping_mul(0x9e37_79b9) ^ (y / 2).wrapping_mul(0x85eb_ca6b);
        let mixed = (noise ^ (noise >> 15)).wrapping_mul(0x2c1b_3c6d);
        (mixed >> 24).to_le_bytes()[0]
    };
    let rows = (0..HEIGHT_PX).flat_map(|y| (0..WIDTH_PX).map(move |x| pixel(x + shift_px, y)));
    ImageData {
        encoding: ImageEncoding::Raw(PixelFormat::Mono8),
        width_px: WIDTH_PX,
        height_px: HEIGHT_PX,
        step_bytes: WIDTH_PX,
        frame_id: String::new(),
        data: Bytes::from_iter(rows),
    }
}
