//! The report and statistics as JSON. Names are the protobuf messages' field names; durations are numbers of
//! milliseconds and end in `_ms`.

use std::time::Duration;

use serde::Serialize;
use stereo::FIXED_PER_PX;
use utoipa::ToSchema;

use super::histogram::Histogram;
use super::internal;
use crate::job::{MatchedFrame, Report};
use crate::status::ServiceError;

/// A report as it stands in JSON.
pub(crate) fn report_fields(report: &Report) -> ReportFields<'_> {
    ReportFields::new(report)
}

/// The frame's report; `finish` is called when everything else is known.
pub(super) fn encode(frame: &MatchedFrame<'_>, finish: &dyn Fn() -> Report) -> Result<Vec<u8>, ServiceError> {
    let mesh = frame
        .mesh
        .ok_or_else(|| internal("no mesh was made for a body that needs one"))?;
    let ids = &frame.request.ids;
    let disparity = DisparityStatistics::new(frame);
    let report = finish();
    let body = Body {
        request_id: &ids.request_id,
        camera_id: &ids.camera_id,
        sequence: ids.sequence,
        report: ReportFields::new(&report),
        disparity,
        mesh: MeshStatistics {
            vertices: mesh.vertices.len(),
            triangles: mesh.triangles.len(),
            space: if frame.request.calibration.is_some() {
                "METRES"
            } else {
                "PIXELS"
            },
        },
    };
    serde_json::to_vec(&body).map_err(|why| internal(&format!("writing a report: {why}")))
}

/// What is known about a matched pair, without its pixels.
#[derive(Serialize, ToSchema)]
#[schema(as = Summary)]
pub(crate) struct Body<'a> {
    request_id: &'a str,
    camera_id: &'a str,
    #[serde(skip_serializing_if = "Option::is_none")]
    sequence: Option<u64>,
    report: ReportFields<'a>,
    disparity: DisparityStatistics,
    mesh: MeshStatistics,
}

/// Size of the mesh.
#[derive(Serialize, ToSchema)]
struct MeshStatistics {
    vertices: usize,
    triangles: usize,
    /// `stereo.v1.MeshSpace` without its prefix.
    space: &'static str,
}

/// What became of the request: `stereo.v1.ExecutionReport`, durations in milliseconds.
#[derive(Serialize, ToSchema)]
#[schema(as = Report)]
pub(crate) struct ReportFields<'a> {
    budget_ms: f64,
    received_ms: f64,
    queued_ms: f64,
    decoded_ms: f64,
    matched_ms: f64,
    meshed_ms: f64,
    encoded_ms: f64,
    total_ms: f64,
    iterations_run: u32,
    iterations_asked: u32,
    rung: &'a str,
    predicted_cost_ms: f64,
    actual_cost_ms: f64,
    deadline_met: bool,
    quality_estimate: f32,
    density: f32,
    degradation: String,
    worker: u32,
    instance: &'a str,
    queue_depth: u32,
    software_version: &'a str,
    has_converged: bool,
}

impl<'a> ReportFields<'a> {
    fn new(report: &'a Report) -> Self {
        Self {
            budget_ms: ms(report.budget),
            received_ms: ms(report.received),
            queued_ms: ms(report.queued),
            decoded_ms: ms(report.decoded),
            matched_ms: ms(report.matched),
            meshed_ms: ms(report.meshed),
            encoded_ms: ms(report.encoded),
            total_ms: ms(report.total),
            iterations_run: report.iterations_run,
            iterations_asked: report.iterations_asked,
            rung: report.rung,
            predicted_cost_ms: ms(report.predicted_cost),
            actual_cost_ms: ms(report.actual_cost),
            deadline_met: report.deadline_met,
            quality_estimate: report.quality_estimate,
            density: report.density,
            degradation: report.degradation.to_string(),
            worker: report.worker,
            instance: &report.instance,
            queue_depth: report.queue_depth,
            software_version: report.software_version,
            has_converged: report.has_converged,
        }
    }
}

/// What can be said about a map in a few numbers.
#[derive(Serialize, ToSchema)]
struct DisparityStatistics {
    width: usize,
    height: usize,
    /// First disparity searched.
    min_disparity_px: u16,
    /// End of the search, itself not searched.
    max_disparity_px: u16,
    valid_window: Window,
    valid_pixels: usize,
    /// Valid pixels as a share of the window's, 0 to 1; the report's density is the share of those asked for.
    valid_share: f64,
    /// Smallest, middle and largest valid disparity; null if there is none.
    smallest_px: Option<f64>,
    median_px: Option<f64>,
    largest_px: Option<f64>,
}

/// `stereo.v1.Region`.
#[derive(Serialize, ToSchema)]
struct Window {
    x: usize,
    y: usize,
    width: usize,
    height: usize,
}

impl DisparityStatistics {
    fn new(frame: &MatchedFrame<'_>) -> Self {
        let params = &frame.request.options.params;
        let shape = frame.map.shape();
        let window = params.roi.unwrap_or_else(|| stereo::Roi::full(shape));
        let histogram = Histogram::new(frame.map);
        let count = histogram.valid();
        let ranked_px = |rank| {
            histogram
                .ranked(rank)
                .map(|fixed| f64::from(fixed) / f64::from(FIXED_PER_PX))
        };
        Self {
            width: shape.width_px(),
            height: shape.height_px(),
            min_disparity_px: params.range.min_px,
            max_disparity_px: params.range.min_px.saturating_add(params.range.count),
            valid_window: Window {
                x: window.x,
                y: window.y,
                width: window.width,
                height: window.height,
            },
            valid_pixels: count,
            valid_share: share(count, window.width * window.height),
            smallest_px: ranked_px(0),
            median_px: ranked_px(count / 2),
            largest_px: ranked_px(count.saturating_sub(1)),
        }
    }
}

#[expect(clippy::cast_precision_loss, reason = "pixel counts are far below 2^53")]
fn share(part: usize, whole: usize) -> f64 {
    part as f64 / whole.max(1) as f64
}

fn ms(duration: Duration) -> f64 {
    duration.as_secs_f64() * 1e3
}

#[cfg(test)]
mod tests;
