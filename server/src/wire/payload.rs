//! What comes over Zenoh besides whole requests: what a payload says that it is, and single images with their stamps.

use bytes::Bytes;
use prost::{DecodeError, Message};
use prost_types::Timestamp;
use stereo_proto::v1;

use crate::status::ServiceError;

/// What a payload says that it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Content {
    /// A protobuf message.
    Message,
    /// A PNG file.
    Png,
    /// A JPEG file.
    Jpeg,
}

/// A single image of a pair, and what was said about when it was taken.
#[derive(Debug, Clone, PartialEq)]
pub struct SingleImage {
    /// The image as it came, unchecked.
    pub image: v1::Image,
    /// Frame number.
    pub sequence: Option<u64>,
    /// When it was taken, in ns since 1970 by the camera's clock.
    pub time_ns: Option<i128>,
}

/// Whether a payload of the encoding `given` can be a message of type `message`: it says so, or only that it is protobuf.
///
/// # Errors
/// [`ServiceError::UnsupportedMediaType`] if it says that it is anything else.
pub fn expect_message(given: &str, message: &str) -> Result<(), ServiceError> {
    match content(given, message)? {
        Content::Message => Ok(()),
        Content::Png | Content::Jpeg => Err(unsupported(given, message)),
    }
}

/// A single image: a file, or a `stereo.v1.Image`, as `encoding` says, with a `stereo.v1.ImageStamp` attached or not.
///
/// # Errors
/// [`ServiceError::UnsupportedMediaType`] naming what it can be, [`ServiceError::Invalid`] if payload or attachment are no whole messages.
pub fn single_image(
    encoding: &str,
    payload: Bytes,
    attachment: Option<Bytes>,
) -> Result<SingleImage, ServiceError> {
    let malformed = |what: &str, why: DecodeError| {
        ServiceError::Invalid(format!(
            "the {what} message ({why}): its schema is at GET /v1/schema.binpb"
        ))
    };
    let file = |encoding: v1::ImageEncoding, data: Bytes| v1::Image {
        encoding: encoding.into(),
        data,
        ..v1::Image::default()
    };
    let mut image = match content(encoding, "Image")? {
        Content::Message => v1::Image::decode(payload)
            .map_err(|why| malformed("payload is not a whole stereo.v1.Image", why))?,
        Content::Png => file(v1::ImageEncoding::Png, payload),
        Content::Jpeg => file(v1::ImageEncoding::Jpeg, payload),
    };
    let said = match attachment {
        Some(attachment) => v1::ImageStamp::decode(attachment)
            .map_err(|why| malformed("attachment is not a whole stereo.v1.ImageStamp", why))?,
        None => v1::ImageStamp::default(),
    };
    image.timestamp = image.timestamp.or(said.timestamp);
    let nanos = |time: Timestamp| i128::from(time.seconds) * 1_000_000_000 + i128::from(time.nanos);
    Ok(SingleImage {
        sequence: said.sequence,
        time_ns: image.timestamp.map(nanos),
        image,
    })
}

/// What `given` says; a message must be of type `message` if a type is said.
fn content(given: &str, message: &str) -> Result<Content, ServiceError> {
    let (media_type, schema) = given.split_once(';').unwrap_or((given, ""));
    match media_type {
        "application/protobuf" | "application/x-protobuf"
            if schema.is_empty() || schema.strip_prefix("stereo.v1.") == Some(message) =>
        {
            Ok(Content::Message)
        }
        "image/png" => Ok(Content::Png),
        "image/jpeg" => Ok(Content::Jpeg),
        _ => Err(unsupported(given, message)),
    }
}

fn unsupported(given: &str, message: &str) -> ServiceError {
    ServiceError::UnsupportedMediaType {
        expected: match message {
            "Image" => "the encoding application/protobuf;stereo.v1.Image, image/png or image/jpeg",
            "CameraSettings" => "the encoding application/protobuf;stereo.v1.CameraSettings",
            _ => "the encoding application/protobuf;stereo.v1.StereoRequest",
        },
        got: given.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_can_be_the_message_is_taken_for_it() {
        for right in [
            "application/protobuf;stereo.v1.StereoRequest",
            "application/protobuf",
        ] {
            assert_eq!(expect_message(right, "StereoRequest"), Ok(()));
        }
        for wrong in [
            "zenoh/bytes",
            "image/png",
            "application/protobuf;stereo.v1.Image",
            "application/protobuf;other.v1.StereoRequest",
        ] {
            let error = expect_message(wrong, "StereoRequest").unwrap_err();
            assert_eq!(error.http_code(), 415, "{wrong}");
        }
        assert_eq!(content("image/jpeg", "Image"), Ok(Content::Jpeg));
    }

    #[test]
    fn a_file_has_the_stamp_that_is_attached_and_a_message_its_own() {
        let stamp = |seconds| v1::ImageStamp {
            sequence: Some(7),
            timestamp: Some(Timestamp { seconds, nanos: 5 }),
        };
        let attached = Some(Bytes::from(stamp(1).encode_to_vec()));
        let file = single_image("image/png", Bytes::from_static(b"file"), attached.clone()).unwrap();
        assert_eq!((file.sequence, file.time_ns), (Some(7), Some(1_000_000_005)));
        assert_eq!(file.image.data.as_ref(), b"file");
        let message = v1::Image {
            timestamp: stamp(2).timestamp,
            ..v1::Image::default()
        };
        let message = message.encode_to_vec().into();
        let image = single_image("application/protobuf", message, attached).unwrap();
        assert_eq!((image.sequence, image.time_ns), (Some(7), Some(2_000_000_005)));
        assert!(single_image("image/png", Bytes::new(), Some(Bytes::from_static(b"\xff"))).is_err());
        assert!(single_image("application/protobuf", Bytes::from_static(b"\xff"), None).is_err());
    }
}
