//! Payloads: Zenoh's bytes as ours without a copy where they lie in one piece, and what is said about their type.

use bytes::Bytes;
use zenoh::bytes::{Encoding, ZBytes};

use crate::status::ServiceError;

/// How a payload came, or goes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Way {
    /// It lies in memory that its sender shares with whoever receives it.
    SharedMemory,
    /// It goes through a socket.
    Network,
    /// The same, because there is no room in shared memory.
    NoRoom,
}

impl Way {
    /// Its name among the labels of the metrics.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::SharedMemory => "shared_memory",
            Self::Network => "network",
            Self::NoRoom => "no_room",
        }
    }
}

/// How `payload` came.
pub(super) fn way(payload: &ZBytes) -> Way {
    match payload.as_shm() {
        Some(_) => Way::SharedMemory,
        None => Way::Network,
    }
}

/// The bytes of a payload. One that came in several fragments is put together, which is the one copy of its way through the server;
/// one in shared memory stays where it is.
pub(super) fn bytes(payload: &ZBytes) -> Bytes {
    /// A payload in one piece.
    struct Whole(ZBytes);
    impl AsRef<[u8]> for Whole {
        fn as_ref(&self) -> &[u8] {
            self.0.slices().next().unwrap_or_default()
        }
    }
    match payload.slices().nth(1) {
        None => Bytes::from_owner(Whole(payload.clone())),
        Some(_) => Bytes::from(payload.to_bytes().into_owned()),
    }
}

/// The encoding of a message of our package.
pub(super) fn encoding(message: &str) -> Encoding {
    Encoding::APPLICATION_PROTOBUF.with_schema(format!("stereo.v1.{message}"))
}

/// What a payload says that it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Content {
    /// A protobuf message.
    Message,
    /// A PNG file.
    Png,
    /// A JPEG file.
    Jpeg,
}

/// Whether `given` can be a message of type `message`: said so, or only that it is protobuf.
pub(super) fn expect_message(given: &Encoding, message: &str) -> Result<(), ServiceError> {
    content(given, message).and_then(|content| match content {
        Content::Message => Ok(()),
        Content::Png | Content::Jpeg => Err(unsupported(given, message)),
    })
}

/// What `given` says; a message must be of type `message` if a type is said.
pub(super) fn content(given: &Encoding, message: &str) -> Result<Content, ServiceError> {
    let text = given.to_string();
    let (media_type, schema) = text.split_once(';').unwrap_or((&text, ""));
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

fn unsupported(given: &Encoding, message: &str) -> ServiceError {
    ServiceError::UnsupportedMediaType {
        expected: match message {
            "Image" => "the encoding application/protobuf;stereo.v1.Image, image/png or image/jpeg",
            "CameraSettings" => "the encoding application/protobuf;stereo.v1.CameraSettings",
            _ => "the encoding application/protobuf;stereo.v1.StereoRequest",
        },
        got: given.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn payloads_in_one_piece_are_not_copied() {
        let original = Bytes::from(vec![7_u8; 1000]);
        let payload = ZBytes::from(original.clone());
        assert_eq!(bytes(&payload).as_ptr(), original.as_ptr());
        assert_eq!(way(&payload), Way::Network);
        assert!(bytes(&ZBytes::new()).is_empty());
    }

    #[test]
    fn payloads_in_several_pieces_come_out_whole() {
        let mut writer = ZBytes::writer();
        writer.append(ZBytes::from(vec![1_u8; 10]));
        writer.append(ZBytes::from(vec![2_u8; 5]));
        let expected = [[1_u8; 10].as_slice(), &[2; 5]].concat();
        assert_eq!(bytes(&writer.finish()), expected);
    }

    #[test]
    fn only_what_can_be_the_message_is_taken_for_it() {
        let ours = encoding("StereoRequest");
        assert_eq!(ours.to_string(), "application/protobuf;stereo.v1.StereoRequest");
        assert_eq!(expect_message(&ours, "StereoRequest"), Ok(()));
        assert_eq!(
            expect_message(&Encoding::APPLICATION_PROTOBUF, "StereoRequest"),
            Ok(())
        );
        for wrong in [
            Encoding::default(),
            Encoding::IMAGE_PNG,
            encoding("Image"),
            Encoding::from("application/protobuf;other.v1.StereoRequest"),
        ] {
            let error = expect_message(&wrong, "StereoRequest").unwrap_err();
            assert_eq!(error.http_code(), 415, "{wrong}");
        }
        assert_eq!(content(&Encoding::IMAGE_JPEG, "Image"), Ok(Content::Jpeg));
    }
}
