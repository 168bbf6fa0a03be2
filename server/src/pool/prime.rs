//! The dummy pair that each worker matches when it starts, in all common ways: memory is touched, and the costs of the stages are known
//! before the first client waits for them.

use std::time::{Duration, Instant};

use bytes::Bytes;
use stereo::{Density, Params, Serial};
use stereo_scheduler::{Stage, Verdict};

use super::climb::{Clock, Guide, Height, Stopped, climb};
use super::worker::Worker;
use crate::dispatch::{Job, Kind, encode_kind, work};
use crate::encode::{self, gray_png};
use crate::job::{
    Compression, FrameIds, FrameOptions, FrameRequest, ImageData, ImageEncoding, MatchedFrame, PixelFormat,
    ReplyFormat, Report,
};
use crate::status::ServiceError;

const WIDTH_PX: u32 = 640;
const HEIGHT_PX: u32 = 480;
/// Everything in the dummy scene is at one distance.
const DISPARITY_PX: u32 = 20;
/// Long enough for the whole ladder on a slow and busy machine.
const BUDGET: Duration = Duration::from_secs(60);
/// Times each setting is measured, after a first time that isn't: its memory is new, and slower than it will ever be again.
const ROUNDS: usize = 2;

/// One way to match the dummy pair.
struct Setting {
    request: FrameRequest,
    is_half: bool,
    /// Rungs, the first included.
    rungs: u8,
}

/// Matches the dummy pair in all common ways. Sizes and options that are not among them are predicted from those that are nearest.
pub(super) fn prime(worker: &mut Worker) -> Result<(), Stopped> {
    for setting in settings()? {
        let job = Job::detached(setting.request);
        for round in 0..=ROUNDS {
            let clock = match_once(worker, &job, setting.is_half, setting.rungs)?;
            if round > 0 {
                learn(worker, &job.request, setting.is_half, &clock);
            }
        }
    }
    // The rig of frames that others make way for is touched as well.
    let job = Job::detached(dummy_request());
    worker.swap_rigs();
    match_once(worker, &job, false, LADDER)?;
    worker.swap_rigs();
    Ok(())
}

/// More rungs than any ladder has.
const LADDER: u8 = u8::MAX;

fn settings() -> Result<Vec<Setting>, ServiceError> {
    let all = dummy_request();
    let mut result = dummy_request();
    result.formats = vec![ReplyFormat::Protobuf];
    let with = |change: fn(&mut FrameRequest)| {
        let mut request = result.clone();
        change(&mut request);
        request
    };
    let setting = |request: &FrameRequest, is_half, rungs| Setting {
        request: request.clone(),
        is_half,
        rungs,
    };
    let fast = with(|request| request.options.params = Params::fast());
    let paper = with(|request| request.options.params = Params::paper());
    let dense = with(|request| request.options.params.density = Density::Dense);
    let zstd = with(|request| request.options.compression = Compression::Zstd);
    let lz4 = with(|request| request.options.compression = Compression::Lz4);
    let mut files = result.clone();
    for image in [&mut files.left, &mut files.right] {
        image.data = gray_png(image.width_px, image.height_px, &image.data)?.into();
        image.encoding = ImageEncoding::Png;
    }
    Ok(vec![
        setting(&all, true, LADDER),
        setting(&result, true, 1),
        setting(&fast, false, 1),
        setting(&fast, false, LADDER),
        setting(&paper, false, 1),
        setting(&paper, false, LADDER),
        setting(&dense, false, 1),
        setting(&dense, false, LADDER),
        setting(&files, false, 1),
        setting(&zstd, false, 1),
        setting(&lz4, false, 1),
        setting(&all, false, LADDER),
        setting(&result, false, 1),
        setting(&result, false, 2),
    ])
}

fn match_once(worker: &mut Worker, job: &Job, is_half: bool, rungs: u8) -> Result<Clock, Stopped> {
    let level = worker.level();
    let rig = worker.rig_mut();
    let request = &job.request;
    let mut clock = Clock::new(rungs);
    let mut guide = Guide::Clock(&mut clock);
    rig.load(level, request, is_half)?;
    guide.decoded()?;
    let go = (Verdict::Continue, true);
    climb(
        (rig, &Serial, None),
        job,
        &mut Height::default(),
        &mut guide,
        go,
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
        encode::body(format, &frame, None, &Report::default)?;
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
            Stage::Mesh(_) => work.mesh,
            Stage::Encode(_) => formats
                .next()
                .map(|&format| encode_kind(&[format], &request.options, size, is_half)),
            Stage::Reply => None,
        };
        if let Some(kind) = kind {
            dispatch.prime(kind, stage, work.units, took);
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
            ReplyFormat::DisparityPart,
            ReplyFormat::MeshPart,
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
