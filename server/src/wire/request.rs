//! A request of the wire, checked, as the domain's.

use std::time::{Duration, Instant, SystemTime};

use bytes::Bytes;
use prost::Message;
use prost_types::Timestamp;
use stereo_proto::v1::StereoRequest;

use super::{images, options};
use crate::clients::Caller;
use crate::job::{FrameIds, FrameRequest, PriorityClass, ReplyFormat};
use crate::status::ServiceError;

/// Longest request id in characters.
const MAX_REQUEST_ID: usize = 128;
/// Seconds of protobuf's timestamps: the years 1 to 9999.
const TIMESTAMP_SECONDS: std::ops::RangeInclusive<i64> = -62_135_596_800..=253_402_300_799;

/// What a transport knows about a request besides its body.
#[derive(Debug, Clone)]
pub struct Intake {
    /// When its first byte was seen (monotonic).
    pub received_at: Instant,
    /// The smallest latency budget given outside the body.
    pub latency_budget: Option<Duration>,
    /// The request's id if the body has none (`X-Request-Id`), or empty.
    pub request_id: String,
    /// The bodies the reply will have, in this order.
    pub formats: Vec<ReplyFormat>,
    /// Pixels one image may have.
    pub max_image_px: u64,
    /// Who sent it.
    pub caller: Caller,
    /// The class of a request that names none; background = it can't have another.
    pub priority: PriorityClass,
}

/// The message of a body of type `application/x-protobuf`; its pixels stay slices of the body.
///
/// # Errors
/// [`ServiceError::Invalid`] if the body is no `stereo.v1.StereoRequest`.
pub fn decode_request(body: Bytes) -> Result<StereoRequest, ServiceError> {
    StereoRequest::decode(body).map_err(|why| {
        ServiceError::Invalid(format!(
            "the body is not a whole stereo.v1.StereoRequest message ({why}): its schema is at GET /v1/schema.binpb"
        ))
    })
}

/// `message` as a request that can be put to work: everything in it is checked here, and only here.
///
/// # Errors
/// [`ServiceError::Invalid`] naming what is missing, malformed, out of range or not built yet;
/// [`ServiceError::Unmatchable`] if sizes, region of interest and disparities don't go together;
/// [`ServiceError::TooLarge`] if an image has too many pixels; [`ServiceError::Forbidden`] if the camera is not the caller's to use.
pub fn frame_request(message: StereoRequest, intake: Intake) -> Result<FrameRequest, ServiceError> {
    let left_timestamp = message.left.as_ref().and_then(|left| left.timestamp);
    let ids = FrameIds {
        request_id: request_id(message.request_id, intake.request_id)?,
        camera_id: camera_id(message.camera_id)?,
        sequence: message.sequence,
        capture_time: message
            .capture_time
            .or(left_timestamp)
            .map(capture_time)
            .transpose()?,
    };
    intake.caller.check_camera(&ids.camera_id)?;
    let (left, right, shape) = images::pair(message.left, message.right, intake.max_image_px)?;
    let calibration = message.calibration.map(options::calibration).transpose()?;
    let circumstances = options::Circumstances {
        shape,
        is_calibrated: calibration.is_some(),
        formats: &intake.formats,
        latency_budget: intake.latency_budget,
        priority: intake.priority,
    };
    let options = options::validate(&message.options.unwrap_or_default(), &circumstances)?;
    let client = intake.caller.share(&ids.camera_id);
    Ok(FrameRequest {
        ids,
        left,
        right,
        calibration,
        options,
        formats: intake.formats,
        received_at: intake.received_at,
        client,
    })
}

fn request_id(in_body: String, outside: String) -> Result<String, ServiceError> {
    let id = if in_body.is_empty() { outside } else { in_body };
    if is_request_id(&id) {
        return Ok(id);
    }
    Err(ServiceError::Invalid(format!(
        "request_id must be at most {MAX_REQUEST_ID} printable ASCII characters, got {} bytes: {}",
        id.len(),
        excerpt(&id)
    )))
}

/// Whether a request may be called so.
pub(crate) fn is_request_id(id: &str) -> bool {
    id.len() <= MAX_REQUEST_ID && id.bytes().all(|byte| byte == b' ' || byte.is_ascii_graphic())
}

fn camera_id(id: String) -> Result<String, ServiceError> {
    let is_allowed = |byte: u8| byte.is_ascii_alphanumeric() || b"_.-".contains(&byte);
    if id.len() <= 64 && id.bytes().all(is_allowed) {
        return Ok(id);
    }
    Err(ServiceError::Invalid(format!(
        "camera_id must be at most 64 of the characters A-Z a-z 0-9 _ . -, got {}",
        excerpt(&id)
    )))
}

/// The start of a text that came from outside, escaped.
fn excerpt(text: &str) -> String {
    let start: String = text.chars().take(32).collect();
    format!("{start:?}{}", if start.len() < text.len() { ".." } else { "" })
}

fn capture_time(timestamp: Timestamp) -> Result<SystemTime, ServiceError> {
    let is_valid =
        TIMESTAMP_SECONDS.contains(&timestamp.seconds) && (0..1_000_000_000).contains(&timestamp.nanos);
    let time = is_valid.then(|| SystemTime::try_from(timestamp).ok()).flatten();
    time.ok_or_else(|| {
        ServiceError::Invalid(format!(
            "capture_time must lie in the years 1 to 9999 with 0 to 999999999 ns, got {} s and {} ns since 1970",
            timestamp.seconds, timestamp.nanos
        ))
    })
}

#[cfg(test)]
mod tests;
