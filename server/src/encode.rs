//! Results out: one file a format. Every body is a pure function of the frame, byte for byte.

pub mod disparity_png;
pub mod memory;

mod color_png;
mod glb;
mod histogram;
mod ply;
mod png;
mod report_json;
#[cfg(test)]
mod sample;
pub(crate) mod surface;

use self::memory::{Encoded, Memory};
pub(crate) use self::png::gray_png;
pub(crate) use self::report_json::{Body as Summary, ReportFields, report_fields};
use crate::job::{MatchedFrame, ReplyFormat, Report};
use crate::status::ServiceError;
use crate::wire;

/// `frame` as a body of `format`. Formats that contain the report call `finish` for it as soon as everything else is
/// encoded, so that it can say how long that took. What Zenoh sends is written into `memory` where that has room.
///
/// # Errors
/// [`ServiceError::Internal`] if the mesh that `format` needs was not made or a file gets larger than its format can
/// say; [`ServiceError::Invalid`] if the left image can't be decoded in colour (it was in gray already).
pub fn body(
    format: ReplyFormat,
    frame: &MatchedFrame<'_>,
    memory: Option<&dyn Memory>,
    finish: &dyn Fn() -> Report,
) -> Result<Encoded, ServiceError> {
    let own = match format {
        ReplyFormat::Protobuf => return wire::result_body(frame, memory, finish),
        ReplyFormat::DisparityPart => return wire::disparity_body(frame, memory),
        ReplyFormat::MeshPart => return wire::mesh_body(frame, memory),
        ReplyFormat::Json => report_json::encode(frame, finish),
        ReplyFormat::DisparityPng => disparity_png::encode(frame.map),
        ReplyFormat::ColorPng => color_png::encode(frame.map),
        ReplyFormat::Glb => glb::encode(frame),
        ReplyFormat::Ply => ply::encode(frame),
        ReplyFormat::ReportPart => Ok(wire::report_body(&finish())),
        ReplyFormat::StreamView => wire::stream_view_body(frame, finish),
    }?;
    Ok(own.into())
}

/// A body that outgrew its format, or a fault of ours, never of the request.
fn internal(what: &str) -> ServiceError {
    ServiceError::Internal(what.to_owned())
}
