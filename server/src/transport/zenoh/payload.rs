//! Payloads: Zenoh's bytes as ours without a copy where they lie in one piece, and what is said about their type.

use bytes::Bytes;
use zenoh::bytes::{Encoding, ZBytes};

use crate::status::ServiceError;
use crate::wire::expect_message as expect_message_as;

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

/// Whether `given` can be a message of type `message`: said so, or only that it is protobuf.
pub(super) fn expect_message(given: &Encoding, message: &str) -> Result<(), ServiceError> {
    expect_message_as(&given.to_string(), message)
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
}
