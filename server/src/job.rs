//! Domain types that cross threads: what a transport hands in, what a worker hands back.

use std::time::{Duration, Instant, SystemTime};

use bytes::Bytes;

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
}

impl FrameRequest {
    /// When the answer is due.
    #[must_use]
    pub fn deadline(&self) -> Instant {
        self.received_at + self.options.latency_budget
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

/// Validated options of one request.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameOptions {
    /// Time from `received_at` to the deadline.
    pub latency_budget: Duration,
    /// Rungs to run at most, the first included; `None` = the whole ladder.
    pub max_iterations: Option<u8>,
    /// Preset, disparity range, density, minimum confidence, region of interest.
    pub params: stereo::Params,
    /// Which triangles the mesh keeps.
    pub mesh: stereo::MeshParams,
    /// Wanted parts of a protobuf result.
    pub outputs: Outputs,
    /// How a protobuf result holds the disparity.
    pub disparity_encoding: DisparityEncoding,
}

impl Default for FrameOptions {
    fn default() -> Self {
        Self {
            latency_budget: Duration::from_millis(100),
            max_iterations: None,
            params: stereo::Params::default(),
            mesh: stereo::MeshParams::default(),
            outputs: Outputs::default(),
            disparity_encoding: DisparityEncoding::default(),
        }
    }
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
}

impl ReplyFormat {
    /// Whether this body needs the mesh.
    #[must_use]
    pub fn needs_mesh(self) -> bool {
        matches!(self, Self::Json | Self::Glb | Self::Ply)
    }
}

/// What a worker hands back.
#[derive(Debug, Clone)]
pub struct FrameReply {
    /// One encoded body for each of the request's formats, in the same order.
    pub bodies: Vec<Bytes>,
    /// What was done, and how long it took.
    pub report: Report,
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
    /// What dispatch expected decode, match, mesh and encode to take; zero if nothing is known yet.
    pub predicted_cost: Duration,
    /// What they took.
    pub actual_cost: Duration,
    /// Whether the report was written before the deadline.
    pub deadline_met: bool,
    /// Estimated share of the mask's pixels that are right within 3 px, 0..=1.
    pub quality_estimate: f32,
    /// Share of the pixels asked for that have a disparity, 0..=1.
    pub density: f32,
    /// Why fewer rungs were run than asked for; empty if none were cut.
    pub degradation: &'static str,
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
