//! Payloads over Zenoh: the first byte says as what they come, the second how many bytes of the rest are attached.

use bytes::Bytes;
use stereo_proto::v1::StereoRequest;
use stereod::wire::{
    camera_settings, camera_settings_to_proto, decode_camera_settings, expect_message, single_image,
};

use super::request;
use crate::refusal::is_accepted;

const ENCODINGS: [&str; 6] = [
    "application/protobuf;stereo.v1.Image",
    "image/png",
    "image/jpeg",
    "application/protobuf",
    "application/protobuf;stereo.v1.CameraSettings",
    "zenoh/bytes",
];
const SETTINGS: usize = 4;

pub(crate) fn zenoh(bytes: &[u8]) -> bool {
    let Some((&[kind, attached], rest)) = bytes.split_first_chunk::<2>() else {
        return false;
    };
    let kind = usize::from(kind) % ENCODINGS.len();
    if kind == SETTINGS {
        return settings(rest);
    }
    let (attachment, payload) = rest.split_at(usize::from(attached).min(rest.len()));
    let attachment = (attached > 0).then(|| Bytes::copy_from_slice(attachment));
    let single = single_image(ENCODINGS[kind], Bytes::copy_from_slice(payload), attachment);
    if !is_accepted(&single) {
        return false;
    }
    let Ok(single) = single else { return false };
    let message = StereoRequest {
        sequence: single.sequence,
        left: Some(single.image.clone()),
        right: Some(single.image),
        ..StereoRequest::default()
    };
    let frame = request::frame(message, "zenoh");
    is_accepted(&frame) && frame.is_ok_and(|frame| request::pixels(&frame))
}

fn settings(payload: &[u8]) -> bool {
    is_accepted(&expect_message(ENCODINGS[SETTINGS], "CameraSettings"));
    let settings = decode_camera_settings(Bytes::copy_from_slice(payload)).and_then(camera_settings);
    if let Ok(settings) = &settings {
        // A server that takes a camera over gets them so.
        let passed_on = camera_settings(camera_settings_to_proto(settings, 1));
        assert!(
            passed_on.is_ok(),
            "settings that were accepted are refused when they are passed on"
        );
    }
    is_accepted(&settings)
}
