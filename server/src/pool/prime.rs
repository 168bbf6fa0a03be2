//! The dummy pair that each worker matches when it starts: memory is touched, and the costs of the stages are known before the
//! first client waits for them.

use std::time::{Duration, Instant};

use bytes::Bytes;
use stereo::Serial;
use stereo_scheduler::Stage;

use super::climb::{Clock, Guide, Height, Stopped, climb};
use super::worker::Worker;
use crate::dispatch::{Job, Kind, encode_kind, work};
use crate::encode;
use crate::job::{
    FrameIds, FrameOptions, FrameRequest, ImageData, ImageEncoding, MatchedFrame, PixelFormat, ReplyFormat,
    Report,
};

const WIDTH_PX: u32 = 640;
const HEIGHT_PX: u32 = 480;
/// Everything in the dummy scene is at one distance.
const DISPARITY_PX: u32 = 20;
/// Long enough for the whole ladder on a slow and busy machine.
const BUDGET: Duration = Duration::from_secs(60);
/// Times the pair is matched at each resolution: the first time is slower than any other, because its memory is new.
const ROUNDS: usize = 3;

/// Matches the dummy pair at both resolutions, and makes every kind of body of it.
pub(super) fn prime(worker: &mut Worker) -> Result<(), Stopped> {
    let job = Job::detached(dummy_request());
    for is_half in [true, false] {
        for round in 0..ROUNDS {
            let clock = match_once(worker, &job, is_half)?;
            if round > 0 {
                learn(worker, &job.request, is_half, &clock);
            }
        }
    }
    Ok(())
}

fn match_once(worker: &mut Worker, job: &Job, is_half: bool) -> Result<Clock, Stopped> {
    let level = worker.level();
    let rig = worker.rig_mut();
    let request = &job.request;
    let mut clock = Clock::new();
    let mut guide = Guide::Clock(&mut clock);
    rig.load(level, request, is_half)?;
    guide.decoded()?;
    climb(
        (rig, &Serial),
        job,
        &mut Height::default(),
        &mut guide,
        true,
        Duration::ZERO,
    )?;
    rig.finish(request, true);
    guide.meshed()?;
    let (left_gray, map) = rig.result(request)?;
    let frame = MatchedFrame {
        request,
        left_gray,
        map,
        mesh: Some(&rig.mesh),
    };
    for &format in &request.formats {
        encode::body(format, &frame, &Report::default)?;
        guide.encoded()?;
    }
    Ok(clock)
}

/// Tells the scheduler what the stages took; bodies are told one by one, as requests ask for them.
fn learn(worker: &Worker, request: &FrameRequest, is_half: bool, clock: &Clock) {
    let work = work(request, is_half);
    let dispatch = &worker.shared().dispatch;
    let Kind::Encode { size, .. } = work.encode else {
        return;
    };
    let mut formats = request.formats.iter();
    for &(stage, took) in &clock.stages {
        let kind = match stage {
            Stage::Decode => Some(work.decode),
            Stage::Rung(_) | Stage::Step => Some(work.matching),
            Stage::Mesh => work.mesh,
            Stage::Encode => formats
                .next()
                .map(|&format| encode_kind(&[format], &request.options, size, is_half)),
        };
        if let Some(kind) = kind {
            dispatch.learn(kind, stage, work.units, took);
        }
    }
}

/// A flat wall with a fine random texture.
pub(crate) fn dummy_request() -> FrameRequest {
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
        client: String::new(),
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
