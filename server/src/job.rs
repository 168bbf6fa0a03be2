//! Domain types that cross threads: what a transport hands in, what a worker hands back.

use std::time::{Duration, Instant, SystemTime};

use bytes::Bytes;

use crate::encode::memory::Encoded;

/// One stereo pair with everything that was said about it.
#[derive(Debug, Clone)]
pub struct FrameRequest {
    /// Names and times the reply echoes.
    pub ids: FrameIds,
    /// Left image.
    pub left: ImageData,
    /// Right image, of the left's size.
    pub right: ImageData,
    /// Camera geometry; without it depth, points and a metric mesh are refused or left in pixels.
    pub calibration: Option<Calibration>,
    /// Validated options.
    pub options: FrameOptions,
    /// The bodies to encode, in this order.
    pub formats: Vec<ReplyFormat>,
    /// When the transport saw the first byte of the request (monotonic).
    pub received_at: Instant,
    /// Whose share of the server it counts against, as [`Caller::share`](crate::clients::Caller::share) names it; empty = nobody's in
    /// particular.
    pub client: String,
}

impl FrameRequest {
    /// When the answer is due; `None` for background requests.
    #[must_use]
    pub fn deadline(&self) -> Option<Instant> {
        self.options
            .latency_budget_from_receipt()
            .map(|budget| self.received_at + budget)
    }
}

/// What the reply echoes.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct FrameIds {
    /// The caller's name for this request, up to 128 characters.
    pub request_id: String,
    /// Camera name, `[A-Za-z0-9_.-]{1,64}`, or empty.
    pub camera_id: String,
    /// Frame number of that camera.
    pub sequence: Option<u64>,
    /// When the pair was taken, by the camera's clock.
    pub capture_time: Option<SystemTime>,
}

/// An image as it arrived; `data` is a slice of the received body.
#[derive(Debug, Clone)]
pub struct ImageData {
    /// How `data` holds the pixels.
    pub encoding: ImageEncoding,
    /// Width in pixels; for PNG and JPEG from the file's header.
    pub width_px: u32,
    /// Height in pixels.
    pub height_px: u32,
    /// Bytes from one row to the next; 0 for PNG and JPEG.
    pub step_bytes: u32,
    /// Frame of reference, echoed in the result.
    pub frame_id: String,
    /// The pixels or the file.
    pub data: Bytes,
}

/// How an image is held.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ImageEncoding {
    /// Rows of pixels.
    Raw(PixelFormat),
    /// A PNG file.
    Png,
    /// A JPEG file.
    Jpeg,
}

/// Pixel layouts of raw images, by their ROS names; 16-bit values are little endian.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PixelFormat {
    /// 8-bit gray.
    Mono8,
    /// 16-bit gray.
    Mono16,
    /// Red, green, blue.
    Rgb8,
    /// Blue, green, red.
    Bgr8,
    /// Red, green, blue, alpha.
    Rgba8,
    /// Blue, green, red, alpha.
    Bgra8,
    /// Y0 U Y1 V; the width is even.
    Yuyv,
}

/// Rectified stereo geometry of the pair as sent: `depth_m = focal_px * baseline_m / (disparity_px + doffs_px)`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Calibration {
    /// Focal length in px, > 0.
    pub focal_px: f64,
    /// Principal point of the left view, column in px.
    pub cx_px: f64,
    /// Principal point, row in px.
    pub cy_px: f64,
    /// Distance of the two cameras in m, > 0.
    pub baseline_m: f64,
    /// `cx_right - cx_left` in px.
    pub doffs_px: f64,
}

/// What the server does with the frames of a camera, checked.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct CameraSettings {
    /// For frames without options of their own.
    pub options: Option<stereo_proto::v1::Options>,
    /// Bounds the budget of every frame.
    pub latency_budget: Option<Duration>,
    /// For frames without a calibration of their own.
    pub calibration: Option<stereo_proto::v1::Calibration>,
    /// How single images are brought together.
    pub pairing: PairingRules,
}

/// What may be a pair of images.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PairingRules {
    /// By what they are brought together.
    pub key: PairingKey,
    /// Largest difference in time; below half the time between two frames no two frames can be mixed.
    pub tolerance: Duration,
    /// How long an image waits for its other half.
    pub patience: Duration,
}

impl Default for PairingRules {
    fn default() -> Self {
        Self {
            key: PairingKey::Either,
            tolerance: Duration::from_millis(10),
            patience: Duration::from_millis(200),
        }
    }
}

/// By what images are brought together.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum PairingKey {
    /// By sequence where both have one, else by time.
    #[default]
    Either,
    /// By sequence alone.
    Sequence,
    /// By time alone.
    Time,
}

/// Validated options of one request.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameOptions {
    /// Time from `received_at` to the deadline. Of background requests: from the moment a worker takes it, at most
    /// [`UNBOUNDED`](Self::UNBOUNDED).
    pub latency_budget: Duration,
    /// How the request is scheduled.
    pub priority: PriorityClass,
    /// Rungs to run at most, the first included; `None` = the whole ladder.
    pub max_iterations: Option<u8>,
    /// Preset, disparity range, density, minimum confidence, region of interest.
    pub params: stereo::Params,
    /// How fine the mesh is, and which triangles it keeps.
    pub mesh: stereo::MeshParams,
    /// Wanted parts of a protobuf result.
    pub outputs: Outputs,
    /// How a protobuf result holds the disparity.
    pub disparity_encoding: DisparityEncoding,
    /// How the payloads of a protobuf result are compressed.
    pub compression: Compression,
    /// Whether it may be matched at half resolution.
    pub allow_downscale: bool,
}

impl FrameOptions {
    /// The budget of a background request that was given none.
    pub const UNBOUNDED: Duration = Duration::from_secs(24 * 3600);

    /// The latency budget, if it counts from the first byte of the request.
    #[must_use]
    pub fn latency_budget_from_receipt(&self) -> Option<Duration> {
        (self.priority != PriorityClass::Background).then_some(self.latency_budget)
    }
}

impl Default for FrameOptions {
    fn default() -> Self {
        Self {
            latency_budget: Duration::from_millis(100),
            priority: PriorityClass::default(),
            max_iterations: None,
            params: stereo::Params::default(),
            mesh: stereo::MeshParams::default(),
            outputs: Outputs::default(),
            disparity_encoding: DisparityEncoding::default(),
            compression: Compression::default(),
            allow_downscale: false,
        }
    }
}

/// How a request is scheduled.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum PriorityClass {
    /// Answered within its budget or refused.
    #[default]
    Deadline,
    /// As above, but the first to be dropped under overload.
    BestEffort,
    /// No deadline; runs when nothing else has to.
    Background,
}

impl PriorityClass {
    /// As options in JSON and metrics have it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Deadline => "deadline",
            Self::BestEffort => "best_effort",
            Self::Background => "background",
        }
    }
}

/// How payloads are compressed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Compression {
    /// Not.
    #[default]
    None,
    /// A Zstandard frame each.
    Zstd,
    /// An LZ4 frame each.
    Lz4,
}

/// The parts a protobuf result can have.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Outputs {
    /// Disparity map.
    pub disparity: bool,
    /// 8-bit confidence map.
    pub confidence: bool,
    /// Depth map in metres; needs calibration.
    pub depth: bool,
    /// Triangle mesh.
    pub mesh: bool,
    /// Whether the mesh may be left out when time is short.
    pub mesh_is_optional: bool,
    /// One 3D point a valid pixel; needs calibration.
    pub points: bool,
    /// The left image's colours for mesh and points.
    pub colors: bool,
}

impl Default for Outputs {
    fn default() -> Self {
        Self {
            disparity: true,
            confidence: true,
            depth: false,
            mesh: true,
            mesh_is_optional: false,
            points: false,
            colors: false,
        }
    }
}

/// How a disparity map is held.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum DisparityEncoding {
    /// Float pixels, NaN = invalid.
    F32,
    /// Unsigned 16 bit, 1/256 px, 0 = invalid, little endian.
    #[default]
    U16,
    /// The same as a 16-bit PNG (KITTI's convention).
    Png16,
}

/// Bodies a reply can have.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum ReplyFormat {
    /// `StereoResult` protobuf.
    Protobuf,
    /// Report and mesh statistics as JSON.
    Json,
    /// 16-bit disparity PNG, 1/256 px (KITTI's convention).
    DisparityPng,
    /// Disparity in colours, 8-bit RGB PNG.
    ColorPng,
    /// Textured mesh, binary glTF.
    Glb,
    /// Mesh as binary PLY.
    Ply,
    /// The `Disparity` of a protobuf result alone.
    DisparityPart,
    /// The `Mesh` of a protobuf result alone.
    MeshPart,
    /// The `ExecutionReport` of a protobuf result alone.
    ReportPart,
    /// `StreamView` protobuf.
    StreamView,
}

impl ReplyFormat {
    /// As people and programs have it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Protobuf => "result",
            Self::Json => "json",
            Self::DisparityPng => "disparity_png",
            Self::ColorPng => "color_png",
            Self::Glb => "glb",
            Self::Ply => "ply",
            Self::DisparityPart => "disparity",
            Self::MeshPart => "mesh",
            Self::ReportPart => "report",
            Self::StreamView => "view",
        }
    }

    /// Whether this body needs the mesh.
    #[must_use]
    pub fn needs_mesh(self) -> bool {
        matches!(self, Self::Json | Self::Glb | Self::Ply | Self::MeshPart)
    }
}

/// What a worker hands back.
#[derive(Debug, Clone)]
pub struct FrameReply {
    /// One encoded body for each of the request's formats, in the same order.
    pub bodies: Vec<Encoded>,
    /// What was done, and how long it took.
    pub report: Report,
    /// What the stages that were run were expected to take, and what they took.
    pub costs: Option<(Duration, Duration)>,
}

/// What was cut of a frame, and why.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Degradation {
    /// Fewer rungs were run than asked for.
    pub rungs: Option<RungsCut>,
    /// It was matched at half resolution.
    pub is_half: bool,
    /// The mesh was left out.
    pub has_no_mesh: bool,
}

/// Why rungs were cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RungsCut {
    /// The next one would not have been done in time.
    Budget,
    /// Other requests needed the worker to keep their budgets.
    Load,
    /// A newer frame of the same camera came.
    Superseded,
}

impl std::fmt::Display for Degradation {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let rungs = self.rungs.map(|why| match why {
            RungsCut::Budget => "the latency budget left no time for another rung",
            RungsCut::Load => "rungs were cut so that other requests keep their budgets",
            RungsCut::Superseded => "rungs were cut because a newer frame of the camera came",
        });
        let half = self.is_half.then_some("matched at half resolution");
        let mesh = self.has_no_mesh.then_some("the mesh was left out");
        let parts: Vec<&str> = [rungs, half, mesh].into_iter().flatten().collect();
        f.write_str(&parts.join("; "))
    }
}

/// What was done for one frame. Durations are of the named stage alone, except `total`.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Report {
    /// The budget the request had.
    pub budget: Duration,
    /// `received_at` until the request was whole and put in the queue.
    pub received: Duration,
    /// Waiting for a worker.
    pub queued: Duration,
    /// Image files and colour to gray views.
    pub decoded: Duration,
    /// Gray views to final disparity and confidence.
    pub matched: Duration,
    /// Triangulation of the output mesh alone.
    pub meshed: Duration,
    /// Result to bytes.
    pub encoded: Duration,
    /// `received_at` until the report was written.
    pub total: Duration,
    /// Rungs finished, the first included.
    pub iterations_run: u32,
    /// Rungs asked for (the ladder's length if nothing was asked).
    pub iterations_asked: u32,
    /// Name of the last rung finished.
    pub rung: &'static str,
    /// What decode, the rungs that were run, mesh and encode were expected to take at dispatch; zero if nothing was known yet.
    pub predicted_cost: Duration,
    /// What they took.
    pub actual_cost: Duration,
    /// Whether the report was written before the deadline.
    pub deadline_met: bool,
    /// Estimated share of the mask's pixels that are right within 3 px, 0..=1.
    pub quality_estimate: f32,
    /// Share of the pixels asked for that have a disparity, 0..=1.
    pub density: f32,
    /// Steps of matching done, the first of the frame included.
    pub steps: u64,
    /// Whether nothing was left worth doing: the ladder's end, or no further rung would have changed 0.1 % of the pixels.
    pub has_converged: bool,
    /// What was cut of what was asked for.
    pub degradation: Degradation,
    /// Index of the worker.
    pub worker: u32,
    /// Name of this server.
    pub instance: String,
    /// Requests waiting when this one was taken.
    pub queue_depth: u32,
    /// The server's version.
    pub software_version: &'static str,
}

/// A finished frame as the encoders see it.
#[derive(Debug, Clone, Copy)]
pub struct MatchedFrame<'a> {
    /// The request, with the left image as it was sent.
    pub request: &'a FrameRequest,
    /// The left view in gray.
    pub left_gray: stereo::GrayView<'a>,
    /// Final disparity and confidence.
    pub map: &'a stereo::DisparityMap,
    /// The mesh, if any wanted body needs it.
    pub mesh: Option<&'a stereo::Mesh>,
}
