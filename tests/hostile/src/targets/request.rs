//! A body of type `application/x-protobuf`, all the way to gray pixels.

use std::time::Instant;

use bytes::Bytes;
use stereo_proto::v1::StereoRequest;
use stereod::clients::Caller;
use stereod::decode::Side;
use stereod::job::{FrameRequest, PriorityClass, ReplyFormat};
use stereod::status::ServiceError;
use stereod::wire::{Intake, decode_request, frame_request};

use super::files;
use crate::refusal::is_accepted;

/// Larger images take their time by right.
pub(crate) const MOST_PX: u64 = 1 << 18;

pub(crate) fn request(bytes: &[u8]) -> bool {
    let frame = decode_request(Bytes::copy_from_slice(bytes)).and_then(|message| frame(message, ""));
    is_accepted(&frame) && frame.is_ok_and(|frame| pixels(&frame))
}

/// The message, checked.
pub(crate) fn frame(message: StereoRequest, request_id: &str) -> Result<FrameRequest, ServiceError> {
    let intake = Intake {
        received_at: Instant::now(),
        latency_budget: None,
        request_id: request_id.to_owned(),
        formats: vec![ReplyFormat::Protobuf],
        max_image_px: MOST_PX,
        caller: Caller::Stranger("203.0.113.7".to_owned()),
        priority: PriorityClass::default(),
    };
    frame_request(message, intake)
}

/// Whether both images can be decoded.
pub(crate) fn pixels(frame: &FrameRequest) -> bool {
    files::is_decoded(Side::Left, &frame.left) && files::is_decoded(Side::Right, &frame.right)
}
