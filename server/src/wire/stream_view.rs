//! A finished frame as the wire's `StreamView`: for those who watch a camera, whatever it asked for itself.

use prost::Message;
use stereo_proto::v1;

use super::report;
use super::result::without_report;
use crate::decode::{self, Side};
use crate::job::{Compression, DisparityEncoding, ImageEncoding, MatchedFrame, Outputs, PixelFormat, Report};
use crate::status::ServiceError;

/// Everything there is to see of `frame`. `finish` is called for the report when everything else is there.
///
/// # Errors
/// What [`decode::color`] refuses.
pub fn stream_view_body(
    frame: &MatchedFrame<'_>,
    finish: &dyn Fn() -> Report,
) -> Result<Vec<u8>, ServiceError> {
    // The pixels of a request are shared, not copied.
    let mut request = frame.request.clone();
    request.options.outputs = Outputs {
        mesh: frame.mesh.is_some(),
        ..Outputs::default()
    };
    request.options.disparity_encoding = DisparityEncoding::U16;
    request.options.compression = Compression::None;
    let seen = MatchedFrame {
        request: &request,
        ..*frame
    };
    let mut result = without_report(&seen)?;
    let left = Some(left(frame)?);
    result.report = Some(report::to_proto(&finish()));
    let view = v1::StreamView {
        result: Some(result),
        left,
    };
    Ok(view.encode_to_vec())
}

/// The left image as browsers can show it without knowing any camera's formats.
fn left(frame: &MatchedFrame<'_>) -> Result<v1::Image, ServiceError> {
    use v1::ImageEncoding as Wire;
    let left = &frame.request.left;
    let (encoding, bytes_a_pixel, data) = match left.encoding {
        ImageEncoding::Png => (Wire::Png, 0, left.data.clone()),
        ImageEncoding::Jpeg => (Wire::Jpeg, 0, left.data.clone()),
        ImageEncoding::Raw(PixelFormat::Mono8 | PixelFormat::Mono16) => {
            let gray = frame.left_gray;
            let rows: Vec<&[u8]> = (0..gray.height_px()).map(|y| gray.row(y)).collect();
            (Wire::Mono8, 1, rows.concat().into())
        }
        ImageEncoding::Raw(_) => (Wire::Rgb8, 3, decode::color(Side::Left, left)?.rgb.into()),
    };
    Ok(v1::Image {
        timestamp: frame.request.ids.capture_time.map(Into::into),
        frame_id: left.frame_id.clone(),
        width: left.width_px,
        height: left.height_px,
        encoding: encoding.into(),
        step: bytes_a_pixel * left.width_px,
        data,
    })
}
