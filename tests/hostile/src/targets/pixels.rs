//! Raw pixels with what is said about them: encoding, width, height (a byte each), step (two), then data.

use bytes::Bytes;
use stereo_proto::v1::{Image, StereoRequest};

use super::request;
use crate::refusal::is_accepted;

pub(crate) fn pixels(bytes: &[u8]) -> bool {
    let Some((&[encoding, width, height, step_low, step_high], data)) = bytes.split_first_chunk::<5>() else {
        return false;
    };
    let image = Image {
        width: width.into(),
        height: height.into(),
        encoding: i32::from(encoding % 10),
        step: u16::from_le_bytes([step_low, step_high]).into(),
        data: Bytes::copy_from_slice(data),
        ..Image::default()
    };
    let message = StereoRequest {
        left: Some(image.clone()),
        right: Some(image),
        ..StereoRequest::default()
    };
    let frame = request::frame(message, "pixels");
    is_accepted(&frame) && frame.is_ok_and(|frame| request::pixels(&frame))
}
